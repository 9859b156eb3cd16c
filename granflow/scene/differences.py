"""How two scenes differ, key by key, and which keys may differ when a run goes on with another scene than it began."""

import re
from collections.abc import Iterator
from typing import Any, NamedTuple

from granflow.scene.schema import Scene

ALLOWED_CHANGES: dict[str, str] = {
    r"title|description|expect(\.|$).*": "words, and what the run is held to",
    r"output\.(interval|timeseries_interval|particles|contacts|walls)": "what is written, and how often",
    r"output\.checkpoint\..*": "how often the state is written, and how many are kept",
    r"run\.duration|stages\.\d+\.(duration|kinetic_energy_below|max_duration)": "when the run, or a stage, ends",
    r"walls\.\w+\.(stages|appears_at|vanishes_at)": "when a wall is there: opening a gate",
    r"walls\.\w+\.motion(\.|$).*": "how a wall moves from now on",
    r"pairs\.[\w-]+\.(friction|rolling_friction)": "friction, where there was some and stays some",
    r"numerics\.max_overlap": "at which overlap the guard stops the run",
    r"run\.(time_step|velocity_max)|numerics\.(skin|chunk_size)": "only to the numbers that the run has had so far",
}
"""Keys, and what may change with them in a run that goes on. All else is refused by name."""


class Difference(NamedTuple):
    """A key whose value differs; None stands for a key that is not there."""

    key: str
    before: Any
    now: Any

    @property
    def is_allowed(self) -> bool:
        """Whether a run may go on with this change."""
        return any(re.fullmatch(pattern, self.key) for pattern in ALLOWED_CHANGES)

    def __str__(self) -> str:
        shown = ["left out" if value is None else _shown(value) for value in (self.before, self.now)]
        return f"{self.key} was {shown[0]} and is {shown[1]}"


def differences(before: Scene, now: Scene) -> tuple[Difference, ...]:
    """Every key that differs, in the order of the scenes."""
    first, second = (dict(_leaves(scene.model_dump(by_alias=True, exclude_none=True))) for scene in (before, now))
    keys = dict.fromkeys([*first, *second])
    return tuple(Difference(key, first.get(key), second.get(key)) for key in keys if first.get(key) != second.get(key))


def forbidden(before: Scene, now: Scene, stages_over: int) -> tuple[Difference, ...]:
    """The differences with which a run cannot go on, of whose stages the first `stages_over` have ended."""
    return tuple(each for each in differences(before, now) if not _allowed(each, len(before.stages), stages_over))


def _allowed(difference: Difference, stages_before: int, stages_over: int) -> bool:
    stage = re.match(r"stages\.(\d+)\.", difference.key)
    if stage and int(stage[1]) >= stages_before:
        return True
    return difference.is_allowed and not (stage and int(stage[1]) < stages_over)


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Path and value of all that is neither a mapping nor a list of mappings."""
    if isinstance(value, dict) and value:
        for key, each in value.items():
            yield from _leaves(each, f"{path}.{key}".lstrip("."))
    elif isinstance(value, list | tuple) and any(isinstance(each, dict) for each in value):
        for index, each in enumerate(value):
            yield from _leaves(each, f"{path}.{index}")
    else:
        yield path, value


def _shown(value: Any) -> str:
    return f"[{', '.join(map(_shown, value))}]" if isinstance(value, list | tuple) else f"{value}"
