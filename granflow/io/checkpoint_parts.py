"""A value of a checkpoint with its key path; each check raises CheckpointError with the file, key and value.

A checkpoint may be crafted, including its checksum. No value is used before its type and range are checked.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from math import inf, isnan
from pathlib import Path
from typing import Any

import numpy as np

from granflow.io.checkpoint import Checkpoint, CheckpointError

SHOWN = 60
"""Largest number of characters of a value in a message."""

LARGEST_REAL = float(np.finfo(np.float32).max)
"""Largest magnitude of physical quantities: larger ones overflow in single precision."""

LARGEST_COUNT = 2**53
"""Largest number of steps or of collisions: larger ones are not exact in double precision."""


@dataclass(frozen=True)
class Part:
    """A value in a checkpoint: `file` of the checkpoint, `key` such as engine/particles/id, `value` as read."""

    file: Path
    key: str
    value: Any

    @classmethod
    def of(cls, checkpoint: Checkpoint) -> "Part":
        """Return the complete state in a checkpoint."""
        return cls(checkpoint.path, "", checkpoint.saved)

    def __getitem__(self, name: str) -> "Part":
        """Return the entry `name` of a mapping. Raises CheckpointError if the value is not a mapping or lacks it."""
        values = self.mapping()
        if name not in values:
            raise self.error(f"lacks {name}")
        return self._within(name, values[name])

    def error(self, predicate: str) -> CheckpointError:
        """Return the error to raise; `predicate` follows the key in the message."""
        return CheckpointError(
            f"{self.file}: {self.key or 'the state'} {predicate}, so the file is damaged or belongs to another scene. "
            "Remove it to use the checkpoint before it."
        )

    def mismatch(self, expected: str) -> CheckpointError:
        """Return the error for a value other than `expected`."""
        array = isinstance(self.value, np.ndarray)
        shown = f"an array {self.value.shape} of {self.value.dtype}" if array else repr(self.value)[:SHOWN]
        return self.error(f"is {shown}, but must be {expected}")

    def mapping(self, names: Collection[str] | None = None) -> dict[str, Any]:
        """Return the value, a dictionary; if `names` is given, with exactly these keys. Raises CheckpointError."""
        if not isinstance(self.value, dict):
            raise self.mismatch("a mapping")
        if names is not None and set(self.value) != set(names):
            there, expected = (", ".join(sorted(each))[:200] or "none" for each in (self.value, names))
            raise self.error(f"has the keys {there}, but must have {expected}")
        return self.value

    def parts(self, names: Collection[str] | None = None) -> Iterator["Part"]:
        """Yield the values of a mapping, checked for `names` as in `mapping`. Raises CheckpointError."""
        yield from (self._within(name, value) for name, value in self.mapping(names).items())

    def items(self, length: int | None = None) -> list["Part"]:
        """Return the values of a list, of the given length if not None. Raises CheckpointError."""
        if not isinstance(self.value, list) or length not in (None, len(self.value)):
            raise self.mismatch("a list" if length is None else f"a list of {length}")
        return [self._within(str(index), value) for index, value in enumerate(self.value)]

    def number(self, low: float = -inf, high: float = inf) -> float:
        """Return the value, a number in [low, high], possibly infinite; never NaN. Raises CheckpointError."""
        value = self.value
        if isinstance(value, bool) or not isinstance(value, int | float) or isnan(value) or not low <= value <= high:
            raise self.mismatch(f"a number in [{low:.10g}, {high:.10g}]")
        return value

    def integer(self, low: int = 0, high: int = LARGEST_COUNT) -> int:
        """Return the value, a whole number in [low, high]; true and false are not numbers. Raises CheckpointError."""
        if isinstance(self.value, bool) or not isinstance(self.value, int) or not low <= self.value <= high:
            raise self.mismatch(f"a whole number in [{low}, {high}]")
        return self.value

    def amount(self, kind: type, low: float = -LARGEST_REAL) -> float:
        """Return the value, of `kind` int or float, at least `low` and in single precision. Raises CheckpointError."""
        return self.integer() if kind is int else self.number(low, LARGEST_REAL)

    def flag(self) -> bool:
        """Return the value, true or false. Raises CheckpointError."""
        if not isinstance(self.value, bool):
            raise self.mismatch("true or false")
        return self.value

    def text(self, among: Collection[str] | None = None) -> str:
        """Return the value, a text; if `among` is given, one of these. Raises CheckpointError."""
        if not isinstance(self.value, str) or not (among is None or self.value in among):
            raise self.mismatch("a text" if among is None else f"one of {', '.join(among)[:200] or 'none'}")
        return self.value

    def plain(self) -> None:
        """Check that the value is a number, possibly NaN, or None. Raises CheckpointError."""
        if isinstance(self.value, bool) or not (self.value is None or isinstance(self.value, int | float)):
            raise self.mismatch("a number")

    def floats(self, *shape: int, low: float = -LARGEST_REAL, high: float = LARGEST_REAL) -> np.ndarray:
        """Return the value, an array of floating-point numbers of the given shape in [low, high], without NaN.

        The default bounds are those of single precision. Raises CheckpointError.
        """
        return self._array("f", shape, low, high)

    def integers(self, *shape: int, low: int = 0, high: int = 2**31 - 1) -> np.ndarray:
        """Return the value, an array of signed integers of the given shape in [low, high].

        The default bounds are those of indices on the device (int32, not negative). Raises CheckpointError.
        """
        return self._array("i", shape, low, high)

    def distinct(self, *shape: int, high: int = 2**31 - 1) -> np.ndarray:
        """Return the value, an array of distinct integers of the given shape in [0, high].

        Raises CheckpointError.
        """
        found = self.integers(*shape, low=0, high=high)
        if len(np.unique(found)) < found.size:
            raise self.error("holds a number twice")
        return found

    def _array(self, kind: str, shape: Sequence[int], low: float, high: float) -> np.ndarray:
        """Return the value, an array of the type kind ("f" or "i") and shape with all entries in [low, high]."""
        value, noun = self.value, "floating-point" if kind == "f" else "whole"
        if not isinstance(value, np.ndarray) or value.dtype.kind != kind or value.shape != tuple(shape):
            raise self.mismatch(f"an array {tuple(shape)} of {noun} numbers")
        outside = ~((value >= low) & (value <= high))
        if outside.any():
            raise self.error(f"holds {value[outside][0]:.10g}, but must lie in [{low:.10g}, {high:.10g}]")
        return value

    def _within(self, name: str, value: Any) -> "Part":
        return Part(self.file, f"{self.key}/{name[:SHOWN]}".lstrip("/"), value)
