"""One value of a checkpoint with its key path: every check raises CheckpointError with the file, the key and the value.

A checkpoint may be crafted, and its checksum with it. Nothing in it is used before its type and range are known.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from math import inf, isnan
from pathlib import Path
from typing import Any

import numpy as np

from granflow.observe.checkpoint import Checkpoint, CheckpointError

SHOWN = 60
"""Characters of a value in a message."""

LARGEST_REAL = float(np.finfo(np.float32).max)
"""Physical quantities beyond this overflow in single precision."""

MOST_STEPS = 2**53
"""Step numbers are exact in double precision up to here."""


@dataclass(frozen=True)
class Part:
    """A value in a checkpoint: `file` of the checkpoint, `key` such as engine/particles/id, `value` as read."""

    file: Path
    key: str
    value: Any

    @classmethod
    def of(cls, checkpoint: Checkpoint) -> "Part":
        """Everything a checkpoint holds."""
        return cls(checkpoint.path, "", checkpoint.saved)

    def __getitem__(self, name: str) -> "Part":
        values = self.mapping()
        if name not in values:
            raise self.wrong(f"lacks {name}")
        return self._within(name, values[name])

    def wrong(self, what: str) -> CheckpointError:
        """The error to raise: `what` follows the key."""
        return CheckpointError(
            f"{self.file}: {self.key or 'the state'} {what}, so the file is damaged or belongs to another scene. "
            "Remove it to use the checkpoint before it."
        )

    def unlike(self, expected: str) -> CheckpointError:
        """The error for a value other than `expected`."""
        array = isinstance(self.value, np.ndarray)
        shown = f"an array {self.value.shape} of {self.value.dtype}" if array else repr(self.value)[:SHOWN]
        return self.wrong(f"is {shown}, but must be {expected}")

    def mapping(self, names: Collection[str] | None = None) -> dict[str, Any]:
        """A dictionary with texts as keys; with exactly those `names`, if given."""
        if not isinstance(self.value, dict):
            raise self.unlike("a mapping")
        if names is not None and set(self.value) != set(names):
            there, expected = (", ".join(sorted(each))[:200] or "none" for each in (self.value, names))
            raise self.wrong(f"has the keys {there}, but must have {expected}")
        return self.value

    def parts(self, names: Collection[str] | None = None) -> Iterator["Part"]:
        """The values of a mapping."""
        yield from (self._within(name, value) for name, value in self.mapping(names).items())

    def items(self, length: int | None = None) -> list["Part"]:
        """The values of a list, of that length if given."""
        if not isinstance(self.value, list) or length not in (None, len(self.value)):
            raise self.unlike("a list" if length is None else f"a list of {length}")
        return [self._within(str(index), value) for index, value in enumerate(self.value)]

    def number(self, low: float = -inf, high: float = inf) -> float:
        """A number in [low, high], both possibly infinite; never NaN."""
        value = self.value
        if isinstance(value, bool) or not isinstance(value, int | float) or isnan(value) or not low <= value <= high:
            raise self.unlike(f"a number in [{low:.10g}, {high:.10g}]")
        return value

    def whole(self, low: int = 0, high: int = MOST_STEPS) -> int:
        """A whole number in [low, high]."""
        if isinstance(self.value, bool) or not isinstance(self.value, int) or not low <= self.value <= high:
            raise self.unlike(f"a whole number in [{low}, {high}]")
        return self.value

    def flag(self) -> bool:
        """True or false."""
        if not isinstance(self.value, bool):
            raise self.unlike("true or false")
        return self.value

    def text(self, among: Collection[str] | None = None) -> str:
        """A text; one of those given, if there are any."""
        if not isinstance(self.value, str) or not (among is None or self.value in among):
            raise self.unlike("a text" if among is None else f"one of {', '.join(among)[:200] or 'none'}")
        return self.value

    def plain(self) -> None:
        """A number, NaN included, or nothing."""
        if isinstance(self.value, bool) or not (self.value is None or isinstance(self.value, int | float)):
            raise self.unlike("a number")

    def reals(self, *shape: int, low: float = -LARGEST_REAL, high: float = LARGEST_REAL) -> np.ndarray:
        """An array of floating-point numbers of that shape, all in [low, high]."""
        return self._array("f", shape, low, high)

    def wholes(self, *shape: int, low: int = 0, high: int = 2**31 - 1) -> np.ndarray:
        """An array of whole numbers of that shape, all in [low, high]."""
        return self._array("i", shape, low, high)

    def distinct(self, *shape: int, low: int = 0, high: int = 2**31 - 1) -> np.ndarray:
        """An array of whole numbers as above, all different."""
        found = self.wholes(*shape, low=low, high=high)
        if len(np.unique(found)) < found.size:
            raise self.wrong("holds a number twice")
        return found

    def _array(self, kind: str, shape: Sequence[int], low: float, high: float) -> np.ndarray:
        value, noun = self.value, "floating-point" if kind == "f" else "whole"
        if not isinstance(value, np.ndarray) or value.dtype.kind != kind or value.shape != tuple(shape):
            raise self.unlike(f"an array {tuple(shape)} of {noun} numbers")
        outside = ~((value >= low) & (value <= high))
        if outside.any():
            raise self.wrong(f"holds {value[outside][0]:.10g}, but must lie in [{low:.10g}, {high:.10g}]")
        return value

    def _within(self, name: str, value: Any) -> "Part":
        return Part(self.file, f"{self.key}/{name[:SHOWN]}".lstrip("/"), value)
