"""Units: text such as "4 mm" or "0.31 GPa" becomes an SI number, with a single rounding.

`DIMENSIONS` lists the units of each dimension with exact factors. `to_si` converts text of a known dimension;
the functions for tables find the unit in a heading, and `GivenNumber` keeps the unit in which a number of any
dimension was given, for studies that print it again.
"""

import difflib
import math
import re
import unicodedata
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from numbers import Real
from typing import Any

from granflow.arguments import shown
from granflow.errors import GranflowError
from granflow.visible_text import alternatives

# Dimensions and their units

_PI = Fraction(math.pi)
_STANDARD_GRAVITY = "9.80665"


@dataclass(frozen=True)
class Dimension:
    """A physical dimension: noun and example for messages, and its units as multiples of the SI unit.

    The factors are exact fractions; the one of the SI unit is 1.
    """

    noun: str
    example: str
    units: Mapping[str, Fraction]

    @property
    def si_unit(self) -> str:
        """The SI unit; empty for a number without a dimension and for any dimension."""
        unit = next(iter(self.units), "")
        return "" if unit == "%" else unit


def _unit_table(text: str) -> dict[str, Fraction]:
    """Exact factors from "m 1, mm 1e-3, ..."; the SI unit is first.

    A unit with an exponent has its other notations, m^3 and m³, one with the prefix u also µ.
    """
    units = {}
    for name, factor in (entry.split() for entry in text.split(",")):
        for written in (name, _EXPONENT.sub("^", name), name.translate(_SUPERSCRIPT)):
            units[written] = Fraction(factor)
        if name.startswith("u"):
            # Keyboards and editors write the Greek letter in place of the micro sign.
            units["µ" + name[1:]] = units["\u03bc" + name[1:]] = Fraction(factor)
    return units


_EXPONENT = re.compile(r"(?<=[a-z])(?=[23])")
_SUPERSCRIPT = str.maketrans("23", "²³")


DIMENSIONS: dict[str, Dimension] = {
    "number": Dimension("a number", "0.5", _unit_table("% 1/100")),
    "length": Dimension("a length", "4 mm", _unit_table("m 1, km 1e3, cm 1e-2, mm 1e-3, um 1e-6, nm 1e-9")),
    "time": Dimension("a time", "10 ms", _unit_table("s 1, ms 1e-3, us 1e-6, ns 1e-9, min 60, h 3600")),
    "velocity": Dimension(
        "a velocity", "3 m/s", _unit_table("m/s 1, cm/s 1e-2, mm/s 1e-3, km/h 1000/3600, m/min 1/60")
    ),
    "acceleration": Dimension(
        "an acceleration",
        "9.81 m/s2",
        _unit_table(f"m/s2 1, mm/s2 1e-3, g {_STANDARD_GRAVITY}"),
    ),
    "angle": Dimension(
        "an angle", "30 deg", {"rad": Fraction(1), "deg": _PI / 180, "°": _PI / 180, "turn": 2 * _PI}
    ),
    "frequency": Dimension("a frequency", "25 Hz", _unit_table("Hz 1, kHz 1e3, 1/s 1, 1/min 1/60")),
    "angular_velocity": Dimension(
        "an angular velocity",
        "30 rpm",
        {"rad/s": Fraction(1), "deg/s": _PI / 180, "°/s": _PI / 180, "rpm": 2 * _PI / 60, "1/s": Fraction(1)},
    ),
    "pressure": Dimension(
        "a pressure", "1 GPa", _unit_table("Pa 1, kPa 1e3, MPa 1e6, GPa 1e9, N/m2 1, N/mm2 1e6, bar 1e5")
    ),
    "viscosity": Dimension(
        "a viscosity",
        "1 mPa s",
        {
            "Pa s": Fraction(1),
            "mPa s": Fraction(1, 1000),
            **_unit_table("Pa*s 1, mPa*s 1e-3, kg/m/s 1, P 0.1, cP 1e-3"),
        },
    ),
    "density": Dimension(
        "a density",
        "2500 kg/m3",
        _unit_table("kg/m3 1, g/cm3 1e3, t/m3 1e3"),
    ),
    "energy": Dimension(
        "an energy",
        "1 nJ",
        _unit_table("J 1, kJ 1e3, mJ 1e-3, uJ 1e-6, nJ 1e-9, pJ 1e-12, aJ 1e-18, zJ 1e-21"),
    ),
    "energy_density": Dimension(
        "an energy density",
        "1e4 J/m3",
        _unit_table("J/m3 1, mJ/m3 1e-3, kJ/m3 1e3, MJ/m3 1e6"),
    ),
    "surface_energy": Dimension(
        "a surface energy",
        "50 mJ/m2",
        _unit_table("J/m2 1, mJ/m2 1e-3, uJ/m2 1e-6, N/m 1, mN/m 1e-3"),
    ),
    "volume": Dimension(
        "a volume",
        "10 nl",
        _unit_table(
            "m3 1, cm3 1e-6, mm3 1e-9, l 1e-3, ml 1e-6, ul 1e-9, nl 1e-12, pl 1e-15, "
            "L 1e-3, mL 1e-6, uL 1e-9, nL 1e-12, pL 1e-15"
        ),
    ),
    "stiffness": Dimension("a stiffness", "1e4 N/m", _unit_table("N/m 1, kN/m 1e3, N/mm 1e3, N/cm 100")),
    "torsion_stiffness": Dimension(
        "a twisting stiffness", "1 mNm/rad", _unit_table("Nm/rad 1, mNm/rad 1e-3, uNm/rad 1e-6, N*m/rad 1")
    ),
    "torsion_damping": Dimension(
        "a twisting dashpot", "1 uNms", _unit_table("Nms 1, mNms 1e-3, uNms 1e-6, N*m*s 1")
    ),
    "granular_temperature": Dimension(
        "a granular temperature",
        "1e-4 m2/s2",
        _unit_table("m2/s2 1, J/kg 1, cm2/s2 1e-4, mm2/s2 1e-6"),
    ),
    "rate": Dimension("a rate", "800 1/s", _unit_table("1/s 1, /s 1, 1/min 1/60, 1/h 1/3600")),
    "mass": Dimension("a mass", "2 g", _unit_table("kg 1, g 1e-3, mg 1e-6, t 1e3")),
    "mass_flow": Dimension(
        "a mass flow rate", "2 t/h", _unit_table("kg/s 1, g/s 1e-3, kg/min 1/60, kg/h 1/3600, t/h 1000/3600")
    ),
    "damping": Dimension("a damping constant", "5 kg/s", _unit_table("kg/s 1, g/s 1e-3, Ns/m 1")),
    "force": Dimension("a force", "1 N", _unit_table("N 1, kN 1e3, mN 1e-3")),
    "temperature": Dimension("a temperature", "300 K", _unit_table("K 1, mK 1e-3, degC 1, °C 1")),
    "heat_capacity": Dimension(
        "a specific heat capacity",
        "500 J/kg/K",
        _unit_table("J/kg/K 1, J/(kg*K) 1, kJ/kg/K 1e3, kJ/(kg*K) 1e3, J/g/K 1e3, J/(g*K) 1e3"),
    ),
    "thermal_conductivity": Dimension(
        "a thermal conductivity",
        "50 W/m/K",
        _unit_table("W/m/K 1, W/(m*K) 1, mW/m/K 1e-3, mW/(m*K) 1e-3"),
    ),
    "power": Dimension("a power", "1 W", _unit_table("W 1, kW 1e3, mW 1e-3, uW 1e-6")),
    "velocity_per_force": Dimension(
        "a velocity per force",
        "0.01 m/(s N)",
        {"m/(s N)": Fraction(1), **_unit_table("m/(s*N) 1, m/s/N 1, mm/s/N 1e-3")},
    ),
    "rate_per_pressure": Dimension(
        "a strain rate per pressure",
        "1e-4 1/(Pa s)",
        {"1/(Pa s)": Fraction(1), **_unit_table("1/(Pa*s) 1, 1/Pa/s 1, 1/kPa/s 1e-3")},
    ),
    "heat_flux": Dimension("a heat flux", "1 kW/m2", _unit_table("W/m2 1, kW/m2 1e3")),
}
"""Dimensions by name; the first unit of each is the SI unit."""
ZERO_POINTS = {"degC": Fraction("273.15"), "°C": Fraction("273.15")}
"""SI values of the zero points of units that do not begin at 0; they apply to values, not to differences."""
_ANY = Dimension("a number or text with a unit", "2 t/h", {})


def dimension_of(name: str) -> Dimension:
    """The dimension with the given name; "any" accepts all units. Raises KeyError for an unknown name."""
    return _ANY if name == "any" else DIMENSIONS[name]


def dimensions_with(unit: str) -> dict[str, Dimension]:
    """The dimensions that have a unit, by name; none for an unknown unit."""
    return {name: each for name, each in DIMENSIONS.items() if unit in each.units}


def si_unit_of(unit: str) -> str:
    """The SI unit that all dimensions of a unit share, "rad" for "deg"; empty for "%" and without a unit."""
    units = [
        [name for name, factor in each.units.items() if factor == 1 and name not in ZERO_POINTS]
        for each in dimensions_with(unit).values()
    ]
    common = [name for name in (units[0] if units else ()) if all(name in each for each in units)]
    return unit if unit in common else next(iter(common), "")


# Text with a unit

_NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_AMOUNT = re.compile(rf"\s*({_NUMBER}|[-+]?(?:\.?inf|\.?nan))\s*(.*?)\s*", re.IGNORECASE | re.DOTALL)
_COMMA = re.compile(r"^\s*[-+]?[0-9]+,[0-9]+(\D|$)")
_GROUPS = re.compile(r"^(\s*[-+]?[0-9]{1,3})((?:[ _'’,][0-9]{3})+)(?![0-9])")
_UNIT = re.compile(r"[^\W\d_]|[%°]|1?/\(?[a-z]", re.IGNORECASE)  # begins a unit
_LONGEST_EXACT = 100  # characters; longer numbers are rounded before the unit is applied
_LARGEST = Fraction(10) ** 300


class UnitError(ValueError):
    """Text that is not a quantity of the expected dimension; the message follows "X is Y, but "."""


def to_si(text: str, dimension: str) -> float:
    """Convert text such as "4 mm" to an SI number of the given dimension; text without a unit is SI.

    The product of number and factor is rounded once, so "4 mm" is the same float as 0.004. The result may be
    infinite or NaN (".inf", ".nan", or a magnitude above 1e300).

    Raises UnitError if the text is not a number, or the unit is unknown or of another dimension.
    """
    exact = exact_si(text, dimension)
    if isinstance(exact, float):
        return exact
    if abs(exact) < _LARGEST:
        return float(exact)
    return math.inf if exact > 0 else -math.inf


def exact_si(text: str, dimension: str) -> Fraction | float:
    """The number of `to_si` without rounding; a float if it is zero, infinite or NaN. Raises UnitError.

    The zero of a unit in ZERO_POINTS is not zero in SI.
    """
    expected = dimension_of(dimension)
    if groups := _GROUPS.search(text):
        whole = groups[1] + re.sub("[^0-9]", "", groups[2]) + text[groups.end() :]
        decimal = f", or {text.replace(',', '.')}" if _COMMA.search(text) else ""
        raise UnitError(f"digits are not grouped in thousands: {whole}{decimal}")
    if _COMMA.search(text):
        raise UnitError(f"a decimal point is expected, not a comma: {text.replace(',', '.')}")
    match = _AMOUNT.fullmatch(text)
    if match is None or (match[2] and not _UNIT.match(match[2])):
        raise UnitError(f"{expected.noun} is expected, such as {expected.example}{_foreign(text)}")
    number, unit = match.groups()
    plain = float(number.lower().replace(".inf", "inf").replace(".nan", "nan"))
    factor = _factor(unit, dimension)
    zero = ZERO_POINTS.get(unit, 0)
    if not math.isfinite(plain) or (plain == 0 and not zero):
        return plain
    return (Fraction(number) if len(number) < _LONGEST_EXACT else Fraction(plain)) * factor + zero


def _is_usual(unit: str) -> bool:
    """Whether messages list a unit: not one of the other notations of `_unit_table`."""
    return unit.isascii() and "^" not in unit


def _foreign(text: str) -> str:
    """Which character of a text that is no number only looks like a digit or a sign; empty without one."""
    for character in text:
        if not character.isascii() and (
            character.isdecimal() or unicodedata.category(character) in ("Pd", "Sm")
        ):
            kind = "digit" if character.isdecimal() else "minus sign -"
            return f"; {character} (U+{ord(character):04X}) is not the {kind} of a keyboard"
    return ""


def factor_of(unit: str, dimension: str) -> float:
    """Factor of a unit to SI, by which numbers are multiplied; 1 without a unit.

    Raises UnitError if the unit is unknown, of another dimension, or one of ZERO_POINTS.
    """
    if unit in ZERO_POINTS and dimension in ("any", "temperature"):
        raise UnitError(f"{unit} has its own zero point and applies to single values only; give K")
    return float(_factor(unit, dimension))


def _factor(unit: str, dimension: str) -> Fraction:
    """Exact factor of a unit to SI; 1 without a unit. Raises UnitError."""
    if not unit:
        return Fraction(1)
    if dimension == "any":
        return _any_factor(unit)
    known = DIMENSIONS[dimension].units
    if unit in known:
        return known[unit]
    raise UnitError(_wrong_unit(unit, DIMENSIONS[dimension]))


def _any_factor(unit: str) -> Fraction:
    """Exact factor of a unit of any dimension. Raises UnitError if it is unknown or ambiguous."""
    factors = {each.units[unit] for each in dimensions_with(unit).values()}
    if len(factors) == 1:
        return factors.pop()
    trouble = "is ambiguous" if factors else "is not a known unit"
    raise UnitError(f"{unit} {trouble}; give the value in SI without a unit")


def _wrong_unit(unit: str, expected: Dimension) -> str:
    """Message for a unit of another dimension, or an unknown one with the closest known unit."""
    matching = [each.noun for each in dimensions_with(unit).values()]
    if not expected.units or expected is DIMENSIONS["number"]:
        return f"{expected.noun} without a unit is expected, such as {expected.example}"
    if matching:
        meaning = f"{unit} is a unit of {alternatives([_without_article(noun) for noun in matching])}"
        return f"{meaning} and {expected.noun} is expected, such as {expected.example}"
    near = [name for name in expected.units if name.lower() == unit.lower()]
    near = near or difflib.get_close_matches(unit, list(expected.units), n=1, cutoff=0.6)
    known = ", ".join(filter(_is_usual, expected.units))
    hint = f" (did you mean {near[0]}?)" if near else ""
    units = f"units of {_without_article(expected.noun)} are {known}, such as {expected.example}"
    return f"{unit} is not a known unit{hint}; {units}"


def _without_article(noun: str) -> str:
    return noun.partition(" ")[2]


def unit_in(text: str) -> str:
    """Return the unit in a text such as "4 mm"; empty without one."""
    match = _AMOUNT.fullmatch(text)
    return (match.group(2) or "").strip() if match else ""


def seconds_of(name: str, time: float | str) -> float:
    """The argument `name` of a function in s: a number, or text with a unit. Raises GranflowError."""
    try:
        if isinstance(time, str):
            return to_si(time, "time")
        if isinstance(time, bool) or not isinstance(time, Real):
            raise GranflowError(
                f'{name} is {shown(time)}, but must be a number [s] or text with a unit ("1 ms").'
            )
        return float(time)
    except UnitError as error:
        raise GranflowError(f"{name} is {time}, but {error}.") from None


# Columns of tables

_HEADING = re.compile(r"\s*(.*?)\s*([\[(])([^\])]*)[\])]\s*", re.DOTALL)


def split_heading(heading: str) -> tuple[str, str]:
    """Name and unit of a column of a table: "time [ms]" is ("time", "ms"); the unit is empty without one.

    What is in square brackets is a unit, what is in round ones only if it is a known unit.
    """
    match = _HEADING.fullmatch(heading)
    if match is None or (match[2] == "(" and not dimensions_with(match[3].strip())):
        return heading.strip(), ""
    return match[1], match[3].strip()


def with_unit(cell: str, unit: str) -> str:
    """A cell of a table as text with a unit: its own, otherwise that of its column, which may be empty."""
    return f"{cell} {unit}" if cell and unit and not unit_in(cell) else cell


def column_factor(unit: str, si_unit: str) -> float:
    """Factor of a column with a unit to the SI unit of its quantity ("" for a number); 1 without a unit.

    Raises UnitError for a unit that is unknown or of another dimension.
    """
    if unit in ("", si_unit):
        return 1.0
    known = [each for each in DIMENSIONS.values() if next(iter(each.units)) == si_unit]
    if not si_unit:
        known = [DIMENSIONS["number"]]
    for each in known:
        if unit in each.units and unit not in ZERO_POINTS:
            return float(each.units[unit])
    if not si_unit:
        raise UnitError(f"{unit} is no unit of a number; the only one is %")
    names = dict.fromkeys(name for each in known for name in each.units if _is_usual(name))
    names = {name: None for name in names if name not in ZERO_POINTS}
    raise UnitError(f"{unit} is no unit of it; give {', '.join(names) or si_unit}")


# Numbers of any dimension that keep the unit in which they are given


class GivenNumber(float):
    """An SI number; `text`: as given; `unit`: that of the text, "" for a plain number; `exact`: before it is
    rounded.

    The exact number is that of the decimals: 1/10 for 0.1, and for "10 deg" 10 pi / 180 with pi in double
    precision.
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
    """Why values are not of one dimension: their units, or a unit beside plain numbers other than 0; or "".

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
    is_relative = first not in ZERO_POINTS
    plain = next((each for each in numbers if not each.unit and not (is_relative and each == 0.0)), None)
    return (
        "" if plain is None else f"{plain.text} has no unit; give all values in {first}, or all in SI units"
    )


def unit_conflict(given: str, expected: str) -> str:
    """Why a unit does not fit another, as "in rad, and mm is no unit of an angle"; or "".

    Without a known unit on both sides, there is no conflict.
    """
    dimensions = dimensions_with(expected)
    if not dimensions or not given or dimensions.keys() & dimensions_with(given).keys():
        return ""
    return f"in {expected}, and {given} is no unit of {next(iter(dimensions.values())).noun}"


def in_unit(value: float, unit: str) -> float:
    """An SI number in a unit; unchanged without one."""
    return (value - float(ZERO_POINTS.get(unit, 0))) / float(_factor(unit, "any")) if unit else value


def in_si(value: float, unit: str) -> float | str:
    """An SI number as a value of a scene: text with the SI unit of the dimension of `unit`."""
    si_unit = si_unit_of(unit)
    return f"{float(value)!r} {si_unit}" if si_unit else float(value)
