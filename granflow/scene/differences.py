"""Differences between two scenes, key by key, and the keys that may change when a run is resumed.

Scenes are compared after resolution, in SI units: a value with another unit or a default written out is no
difference.
"""

import re
from collections.abc import Iterator
from typing import Any, NamedTuple

from granflow.scene.blocks.scene import SceneInput

ALLOWED_CHANGES: dict[str, str] = {
    r"title|description|expect(\.|$).*": "title, description and expectations",
    r"output\.((timeseries_)?interval|particles|contacts|walls)": "selection and interval of output",
    r"output\.(frames_per_rank|compression)": "files of frames",
    r"output\.checkpoint\..*": "interval and number of checkpoints",
    r"run\.duration|stages\.\d+\.(duration|kinetic_energy_below|(min|max)_duration|until.*)": (
        "end of run or stage"
    ),
    r"walls\.\w+(\.\w+)?\.(stages|appears_at|vanishes_at)": "presence of a wall, such as opening a gate",
    r"walls\.\w+(\.\w+)?\.motion(\.|$).*": "motion of a wall from now on",
    r"pairs\.[\w-]+\.(friction|rolling_friction)": "friction, if it is above 0 before and after",
    r"numerics\.max_overlap": "overlap limit at which the run is aborted",
    r"run\.(time_step|velocity_max)|numerics\.(skin|chunk_size)": "only to the values used by the run so far",
}
"""Keys that may change when a run is resumed, with a description. Changes of all other keys are rejected."""


class Difference(NamedTuple):
    """A key whose value differs; None if the key is missing.

    `key`: path with dots, such as walls.floor.material. `str()` is the beginning of a sentence.
    """

    key: str
    before: Any
    now: Any

    @property
    def is_allowed(self) -> bool:
        """Whether a run can be resumed with this change."""
        return any(re.fullmatch(pattern, self.key) for pattern in ALLOWED_CHANGES)

    def __str__(self) -> str:
        shown = ["not given" if value is None else _shown(value) for value in (self.before, self.now)]
        return f"{self.key} was {shown[0]} and is {shown[1]}"


def differences(before: SceneInput, now: SceneInput) -> tuple[Difference, ...]:
    """All keys that differ, in the order of the scenes, with defaults included.

    Lists of numbers are compared as a whole, lists of mappings entry by entry.
    """
    first = dict(_leaves(before.model_dump(by_alias=True, exclude_none=True)))
    second = dict(_leaves(now.model_dump(by_alias=True, exclude_none=True)))
    keys = dict.fromkeys([*first, *second])
    return tuple(
        Difference(key, first.get(key), second.get(key)) for key in keys if first.get(key) != second.get(key)
    )


def forbidden(before: SceneInput, now: SceneInput, stages_over: int) -> tuple[Difference, ...]:
    """Differences that prevent a resume of a run whose first `stages_over` stages have ended.

    A difference is permitted if its key is in ALLOWED_CHANGES and not in an ended stage, or adds a stage.
    """
    return tuple(
        each for each in differences(before, now) if not _allowed(each, len(before.stages), stages_over)
    )


def _allowed(difference: Difference, stages_before: int, stages_over: int) -> bool:
    """Whether a run can be resumed with a difference.

    `stages_before`: number of stages in the earlier scene; `stages_over`: number of those that have ended.
    """
    stage = re.match(r"stages\.(\d+)\.", difference.key)
    if stage and int(stage[1]) >= stages_before:
        return True
    return difference.is_allowed and not (stage and int(stage[1]) < stages_over)


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Path and value of each entry that is neither a mapping nor a list of mappings."""
    if isinstance(value, dict) and value:
        for key, each in value.items():
            yield from _leaves(each, f"{path}.{key}".lstrip("."))
    elif isinstance(value, list | tuple) and any(isinstance(each, dict) for each in value):
        for index, each in enumerate(value):
            yield from _leaves(each, f"{path}.{index}")
    else:
        yield path, value


def _shown(value: Any) -> str:
    """The value as text; lists as in a scene file."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_shown, value))}]"
    return str(value)
