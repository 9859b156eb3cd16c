"""Numbers in a scene: plain in SI, or text with a unit, within bounds; and errors of values."""

import math
import re
from dataclasses import dataclass
from typing import Any

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from granflow.scene.schema.units import UnitError, dimension_of, to_si

LARGEST = 1e30  # limit of the magnitude of SI numbers in a scene
SMALLEST = 1e-30  # lower limit of numbers that must be positive
LARGEST_COUNT = 2**31 - 1  # particle numbers have 32 bits


def value_error(reason: str, *at: str) -> PydanticCustomError:
    """The error "key.path is VALUE, but REASON."; `at` is the path of a key within the value."""
    return PydanticCustomError("but", "{reason}", {"reason": reason, "at": at})


def whole_error(reason: str) -> PydanticCustomError:
    """The error "key.path REASON."."""
    return PydanticCustomError("whole", "{reason}", {"reason": reason})


@dataclass(frozen=True)
class Number:
    """Reads one number: a plain one in SI, or text with a unit of `dimension`; rejects values out of range.

    `noun`: for messages, default is that of the dimension. `above`, `at_least`, `at_most`: bounds in SI units. `words`:
    texts that are accepted in place of a number. `whole`: the number is an int without a unit. Used as metadata of a
    pydantic field.
    """

    dimension: str = "number"
    noun: str = ""
    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    words: tuple[str, ...] = ()
    whole: bool = False
    scaling: int = 0
    """Exponent of `scale` of a scene in this number."""

    def read(self, value: Any) -> float | int | str:
        """Convert a value from the file to a number within the bounds (SI), or to one of the words.

        Raises PydanticCustomError for another type, an unknown unit, a value that is not finite or out of bounds.
        """
        if isinstance(value, str) and value in self.words:
            return value
        number = self._number(value)
        if not math.isfinite(number):
            raise value_error("a finite number is expected")
        if not self._inside(number):
            raise value_error(f"{self._noun} {self._bounds()}")
        if abs(number) > LARGEST or (number != 0 and self.above == 0 and number < SMALLEST):
            raise value_error(f"{self._noun} of this magnitude is out of range")
        return self._count(number) if self.whole else number

    def _number(self, value: Any) -> float:
        """The SI value of a number or text; infinite for an integer beyond the range of float.

        Raises PydanticCustomError.
        """
        if isinstance(value, str) and not self.whole:
            try:
                return to_si(value, self.dimension)
            except UnitError as error:
                raise value_error(f"{error}{self._word_hint()}") from None
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise value_error(f"{self._noun} is expected{self._example()}{self._word_hint()}")
        try:
            return float(value)
        except OverflowError:
            return math.inf

    def _count(self, number: float) -> int:
        """The number as an int. Raises PydanticCustomError if it has a fraction or exceeds 32 bits."""
        if number != int(number):
            raise value_error(f"{self._noun} must be a whole number")
        if number > LARGEST_COUNT:
            raise value_error(f"{self._noun} must be at most {LARGEST_COUNT}")
        return int(number)

    def _inside(self, number: float) -> bool:
        """Whether a number satisfies the bounds; False for NaN if there are any."""
        return (
            (self.above is None or number > self.above)
            and (self.at_least is None or number >= self.at_least)
            and (self.at_most is None or number <= self.at_most)
        )

    @property
    def _noun(self) -> str:
        return self.noun or dimension_of(self.dimension).noun

    def _example(self) -> str:
        """An example value; for whole numbers not that of the dimension."""
        if self.whole:
            return ", a whole number such as 10"
        return f", such as {dimension_of(self.dimension).example}"

    def _word_hint(self) -> str:
        return f", or {' or '.join(self.words)}" if self.words else ""

    def _bounds(self) -> str:
        """Text of the bounds for a message."""
        if self.at_least is not None and self.at_most is not None:
            return f"must be in [{self.at_least:g}, {self.at_most:g}]"
        parts = [
            f"{word} {bound:g}"
            for word, bound in (("above", self.above), ("at least", self.at_least), ("at most", self.at_most))
            if bound is not None
        ]
        return f"must be {' and '.join(parts)}"

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Validation by `read`; serialization without change."""
        return core_schema.no_info_plain_validator_function(self.read)

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        """JSON Schema of the valid input: a number within the bounds, text with a unit, or a word.

        Text must match a pattern of a number and one of the units of the dimension.
        """
        number: dict[str, Any] = {"type": "integer" if self.whole else "number"}
        bounds = {"exclusiveMinimum": self.above, "minimum": self.at_least, "maximum": self.at_most}
        number.update({key: bound for key, bound in bounds.items() if bound is not None})
        choices: list[dict[str, Any]] = [number]
        units = dimension_of(self.dimension).units
        if not self.whole:
            unit = "|".join(re.escape(name) for name in units) if units else ".*"
            choices.append({"type": "string", "pattern": rf"^\s*[-+]?[0-9.]+([eE][-+]?[0-9]+)?\s*({unit})?\s*$"})
        if self.words:
            choices.append({"enum": list(self.words)})
        return {"anyOf": choices} if len(choices) > 1 else number
