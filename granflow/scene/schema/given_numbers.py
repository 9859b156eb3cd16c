"""Numbers of any dimension that keep the unit in which they are given, such as the bounds of a varied key."""

from collections.abc import Iterable, Iterator
from fractions import Fraction
from typing import Annotated, Any

from granflow.scene.schema.faults import Fault
from granflow.scene.schema.numbers import Number
from granflow.scene.schema.units import UnitError, dimensions_with, exact_si, si_unit_of, to_si, unit_in


class GivenNumber(float):
    """An SI number; `text`: as given; `unit`: that of the text, "" for a plain number; `exact`: before it is rounded.

    The exact number is that of the decimals: 1/10 for 0.1, and for "10 deg" 10 pi / 180 with pi in double precision.
    """

    text: str
    unit: str
    exact: Fraction

    def __new__(cls, given: float | str) -> "GivenNumber":
        """The number of a text with or without a unit, or of a plain number. Raises UnitError."""
        text = given if isinstance(given, str) else repr(float(given))
        number = super().__new__(cls, to_si(text, "any"))
        number.text = given.strip() if isinstance(given, str) else f"{given:g}"
        number.unit = unit_in(text)
        number.exact = Fraction(exact_si(text, "any"))
        return number


class NumberWithUnit(Number):
    """Reads a number of any dimension that keeps its unit."""

    def read(self, value: Any) -> GivenNumber:
        """Convert a value from the file. Raises PydanticCustomError as `Number.read`."""
        if isinstance(value, GivenNumber):
            return value
        number = super().read(value)
        return GivenNumber(value if isinstance(value, str) else number)


GivenQuantity = Annotated[GivenNumber, NumberWithUnit("any")]


def number_of(value: Any) -> GivenNumber | None:
    """The number of a value from a file, a plain number or text with a unit; None for other values."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    if isinstance(value, GivenNumber):
        return value
    try:
        return GivenNumber(value)
    except (UnitError, OverflowError, ValueError):
        return None


def common_unit(values: Iterable[Any]) -> str:
    """The unit of all values that have one, if it is the same; otherwise empty."""
    units = {number.unit for value in values if (number := number_of(value)) is not None} - {""}
    return units.pop() if len(units) == 1 else ""


def mixed_units(values: Iterable[Any]) -> str:
    """Why values are not of one dimension: units of different ones, or a unit with plain numbers other than 0; or "".

    Values that are no numbers are ignored.
    """
    numbers = [number for value in values if (number := number_of(value)) is not None]
    with_unit = [each for each in numbers if each.unit]
    if not with_unit:
        return ""
    first = with_unit[0].unit
    for each in with_unit:
        if not dimensions_with(first).keys() & dimensions_with(each.unit).keys():
            return f"{first} and {each.unit} are units of different dimensions"
    plain = next((each for each in numbers if not each.unit and each != 0.0), None)
    return "" if plain is None else f"{plain.text} has no unit; give all values in {first}, or all in SI units"


def unit_conflict(given: str, expected: str) -> str:
    """Why a value with the unit `given` is not one in `expected`, as "in rad, and mm is no unit of an angle"; or "".

    Without a known unit on both sides, there is no conflict.
    """
    dimensions = dimensions_with(expected)
    if not dimensions or not given or dimensions.keys() & dimensions_with(given).keys():
        return ""
    return f"in {expected}, and {given} is no unit of {next(iter(dimensions.values())).noun}"


def in_unit(value: float, unit: str) -> float:
    """An SI number in a unit; unchanged without one."""
    return value / to_si(f"1 {unit}", "any") if unit else value


def in_si(value: float, unit: str) -> float | str:
    """An SI number as a value of a scene: text with the SI unit of the dimension of `unit`, so that it is checked."""
    si_unit = si_unit_of(unit)
    return f"{float(value)!r} {si_unit}" if si_unit else float(value)


def bound_faults(start: GivenNumber, stop: GivenNumber, scale: str) -> Iterator[Fault]:
    """Faults of the bounds `from` and `to`: not ascending, of different units, or not positive on the scale "log"."""
    if reason := mixed_units((start, stop)):
        yield Fault(("to",), reason)
    elif not start < stop:
        yield Fault(("to",), f"it must be larger than from, {start.text}")
    if scale == "log" and start <= 0.0:
        yield Fault(("from",), "it must be above 0 on a logarithmic scale, such as 1e-3")
