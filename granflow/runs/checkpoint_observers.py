"""Checks the saved state of observers and inserters against the structure of the state of new ones."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from granflow.io.checkpoint import Checkpoint
from granflow.io.checkpoint_parts import LARGEST_COUNT, LARGEST_REAL, Part

LIST_TYPES: dict[str, tuple[str, ...]] = {
    "frames": ("number", "text"), "history": ("number", "text", "number"), "columns": ("text",),
}  # fmt: skip
"""Lists that grow during a run, by key, with the types of the values of each entry."""

SAMPLE_ARRAYS = ("id", "mass", "position", "distance", "insertion_time", "part")
"""Arrays of the previous sample of a flow meter."""


def check_observers(checkpoint: Checkpoint, fresh: Mapping[str, Mapping[str, Any]]) -> None:
    """Check the state of each saved observer against that of a new one.

    `fresh`: state of each new observer by name, which defines the keys and types; saved observers that are not in
    `fresh` are ignored. Raises CheckpointError.
    """
    observers = Part.of(checkpoint)["observers"]
    for name, template in fresh.items():
        if name in observers.mapping():
            _check_like(observers[name], template)


def check_streams(checkpoint: Checkpoint, fresh: Mapping[str, Mapping[str, Any]], counts: Mapping[str, int]) -> None:
    """Check the state of each inserter by group.

    `fresh`: states of new inserters by group; `counts`: number of particles of each group, an upper bound of the
    particles due. Raises CheckpointError.
    """
    insertion = Part.of(checkpoint)["insertion"]
    insertion.mapping(fresh)
    for name, template in fresh.items():
        insertion[name].mapping(template)
        due = insertion[name]["due_count"].integer(0, counts[name])
        queued = insertion[name]["queued"]
        size = queued.value.size if isinstance(queued.value, np.ndarray) else 0
        queued.distinct(size, high=due - 1)
        insertion[name]["batch_count"].integer()
        insertion[name]["next_time"].number(0.0)


def _check_like(part: Part, template: Any) -> None:
    """Check for the keys and types of `template`; values that are empty or None there may have grown.

    Lists, the previous sample of a flow meter and accumulated fields grow during a run and have separate checks.
    Raises CheckpointError.
    """
    key = part.key.rsplit("/", 1)[-1]
    if key == "last" and isinstance(part.value, dict) and any(name in part.value for name in SAMPLE_ARRAYS):
        _check_sample(part)
    elif key == "total":
        _check_sums(part)
    elif isinstance(template, dict) and template:
        for each in part.parts(template):
            _check_like(each, template[each.key.rsplit("/", 1)[-1]])
    elif isinstance(template, dict):
        for each in part.parts():
            each.plain()
    elif isinstance(template, list):
        for row in part.items():
            _check_row(row, LIST_TYPES.get(key, ()))
    elif isinstance(template, np.ndarray) and template.dtype.kind == "i":
        part.integers(*template.shape, high=LARGEST_COUNT)
    elif isinstance(template, np.ndarray):
        part.floats(*template.shape)
    elif template is None:
        part.plain()
    else:
        _check_plain(part, template)


def _check_row(row: Part, kinds: tuple[str, ...]) -> None:
    """Check one entry of a list: a value, or a list with one value for each of `kinds` ("number" or "text")."""
    cells = [row] if len(kinds) == 1 else row.items(len(kinds))
    for cell, kind in zip(cells, kinds, strict=True):
        check: Callable[[], object] = cell.number if kind == "number" else cell.text
        check()


def _check_plain(part: Part, template: Any) -> None:
    """Check a value that is not a container; `count` may be negative: the net number of particles of a flow meter."""
    if isinstance(template, bool):
        part.flag()
    elif isinstance(template, int):
        part.integer(-(2**53) if part.key.endswith("/count") else 0)
    elif isinstance(template, float):
        part.plain()
    else:
        part.text()


def _check_sample(part: Part) -> None:
    """Check the previous sample of a flow meter: arrays (n,), `position` (n, 3)."""
    part.mapping(SAMPLE_ARRAYS)
    ids = part["id"].value
    count = len(ids) if isinstance(ids, np.ndarray) and ids.ndim == 1 else 0
    part["id"].distinct(count)
    part["part"].integers(count)
    for name in ("mass", "distance", "insertion_time"):
        part[name].floats(count)
    part["position"].floats(count, 3)


def _check_sums(part: Part) -> None:
    """Check the accumulated fields: arrays (cells, numbers) for the cells of one grid."""
    lengths = {
        len(each.value) if isinstance(each.value, np.ndarray) and each.value.ndim else -1 for each in part.parts()
    }
    for each in part.parts():
        width = each.value.shape[-1] if isinstance(each.value, np.ndarray) and each.value.ndim else 0
        each.floats(*(lengths if len(lengths) == 1 else (0,)), width, high=LARGEST_REAL)
