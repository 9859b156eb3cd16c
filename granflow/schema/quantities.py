"""Numbers and vectors in a scene: the types of its keys, in SI units after reading.

`Number` reads one number, plain in SI units or text with a unit, and checks its bounds. The types below are
pydantic annotations with one `Number` or a vector of three. Lengths of the equipment scale with `scale` of a
scene, numbers of particles with its cube; sizes of one particle or contact do not.
"""

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, GetCoreSchemaHandler
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, core_schema

from granflow.errors import GranflowError
from granflow.schema.faults import Fault, value_error
from granflow.schema.model import DIMENSION, list_of_length, pair_list, require
from granflow.units import DIMENSIONS, GivenNumber, UnitError, dimension_of, mixed_units, to_si

LARGEST = 1e30
"""Largest magnitude of an SI number in a scene."""
SMALLEST = 1e-30
"""Smallest number that must be positive."""
LARGEST_COUNT = 2**31 - 1
"""Largest number of particles: indices on the device have 32 bits."""


@dataclass(frozen=True)
class Number:
    """Reads one number, plain in SI units or text with a unit of `dimension`, and checks its bounds.

    It is metadata of a pydantic type, such as `Annotated[float, Number("length", above=0)]`.

    noun:     for messages; default: that of the dimension
    bounds:   `above`, `at_least`, `at_most`, in SI units; None: no limit
    words:    texts that are accepted in place of a number
    whole:    the number is an int without a unit
    scaling:  exponent of `scale` of a scene in this number
    """

    dimension: str = "number"
    noun: str = ""
    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    words: tuple[str, ...] = ()
    whole: bool = False
    scaling: int = 0

    def __post_init__(self) -> None:
        """Raises GranflowError for an unknown dimension."""
        if self.dimension not in (*DIMENSIONS, "any"):
            known = ", ".join(DIMENSIONS)
            raise GranflowError(f"the dimension {self.dimension} is not one of {known}.")

    def read(self, value: Any) -> float | int | str:
        """Convert a value from the file to a number within the bounds (SI), or to one of the words.

        Magnitudes below SMALLEST are 0. Raises PydanticCustomError for another type, an unknown unit, a value
        that is not finite or out of bounds.
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
        if abs(number) < SMALLEST:  # its square may be 0, so that a vector has no direction
            number = 0.0
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
            choices.append(
                {
                    "type": "string",
                    "pattern": rf"^\s*[-+]?[0-9.]+([eE][-+]?[0-9]+)?\s*({unit})?\s*$",
                    DIMENSION: self.dimension,
                }
            )
        if self.words:
            choices.append({"enum": list(self.words)})
        return {"anyOf": choices} if len(choices) > 1 else number


def unit_of(field: FieldInfo) -> str:
    """SI unit of the numbers of a key, from its type; empty without one."""
    return next(filter(None, (dimension_of(each.dimension).si_unit for each in numbers_of(field))), "")


def numbers_of(field: FieldInfo) -> list[Number]:
    """The numbers in the type of a key: one, or those of a vector, list or union."""
    return list(_numbers_in(field.annotation, field.metadata))


def _numbers_in(annotation: Any, metadata: Iterable[Any] = ()) -> Iterator[Number]:
    """The numbers in a type with its metadata: of unions, lists and vectors those of their items."""
    yield from (each for each in metadata if isinstance(each, Number))
    for inner in get_args(annotation):
        yield from _numbers_in(inner, getattr(inner, "__metadata__", ()))


# Numbers and counts

Plain = Annotated[float, Number()]
NotNegative = Annotated[float, Number(at_least=0)]
Positive = Annotated[float, Number(above=0)]
Share = Annotated[float, Number(noun="a fraction", at_least=0)]
Count = Annotated[int, Number(noun="a count", at_least=1, whole=True)]
ParticleCount = Annotated[int, Number(noun="a count", at_least=1, whole=True, scaling=3)]
"""Number of particles, proportional to the cube of `scale`; at most LARGEST_COUNT."""
ParticleId = Annotated[int, Number(noun="a particle id", at_least=0, whole=True)]
Length = Annotated[float, Number("length", scaling=1)]
PositiveLength = Annotated[float, Number("length", above=0, scaling=1)]
NotNegativeLength = Annotated[float, Number("length", at_least=0, scaling=1)]
UnscaledLength = Annotated[float, Number("length", above=0)]
"""Length [m] of one particle or contact, independent of `scale`."""
AutoLength = Annotated[float | Literal["auto"], Number("length", above=0, words=("auto",))]
Diameter = Annotated[float, Number("length", noun="a diameter", above=0)]
"""Diameter [m] of a particle, independent of `scale`."""
Radius = Annotated[float, Number("length", noun="a radius", above=0)]
"""Radius [m] of a particle, independent of `scale`."""
Time = Annotated[float, Number("time", at_least=0)]
PositiveTime = Annotated[float, Number("time", above=0)]
Velocity = Annotated[float, Number("velocity")]
Speed = Annotated[float, Number("velocity", noun="a speed", above=0)]
AnySpeed = Annotated[float, Number("velocity", noun="a speed", at_least=0)]
GranularTemperature = Annotated[float, Number("granular_temperature", above=0)]
Acceleration = Annotated[float, Number("acceleration")]
Angle = Annotated[float, Number("angle")]
Frequency = Annotated[float, Number("frequency", above=0)]
AngularVelocity = Annotated[float, Number("angular_velocity")]
PositiveAngularVelocity = Annotated[float, Number("angular_velocity", above=0)]
Mass = Annotated[float, Number("mass", above=0)]
ParticleMass = Annotated[float, Number("mass", above=0, scaling=3)]
Rate = Annotated[float, Number("rate", above=0, scaling=3)]
"""Insertion rate [1/s], proportional to the cube of `scale`."""
MassFlow = Annotated[float, Number("mass_flow", above=0, scaling=3)]
Force = Annotated[float, Number("force")]
PositiveForce = Annotated[float, Number("force", above=0)]
Damping = Annotated[float, Number("damping", at_least=0)]
Pressure = Annotated[float, Number("pressure", above=0)]
Density = Annotated[float, Number("density", above=0)]
Energy = Annotated[float, Number("energy", above=0)]
Temperature = Annotated[float, Number("temperature", above=0)]
HeatCapacity = Annotated[float, Number("heat_capacity", above=0)]
ThermalConductivity = Annotated[float, Number("thermal_conductivity", above=0)]
VelocityPerForce = Annotated[float, Number("velocity_per_force", noun="a gain", above=0)]
RatePerPressure = Annotated[float, Number("rate_per_pressure", noun="a gain", above=0)]
HeatFlux = Annotated[float, Number("heat_flux")]
AnyQuantity = Annotated[float, Number("any")]
"""Number in SI units, or text with a unit that has the same factor in all dimensions that know it."""

# Vectors

_vector = list_of_length(3, "a vector of three numbers is expected, [x, y, z]")
Counts = Annotated[tuple[Count, Count, Count], _vector]
Vector3 = tuple[float, float, float]
"""Three components along x, y and z."""
Point = Annotated[tuple[Length, Length, Length], _vector]
"""Position or edge vector (3,) [m], proportional to `scale`."""
UnscaledPoint = Annotated[
    tuple[
        Annotated[float, Number("length")],
        Annotated[float, Number("length")],
        Annotated[float, Number("length")],
    ],
    _vector,
]
"""Position (3,) [m] within a particle, independent of `scale`."""
Sides = Annotated[tuple[Point, Point], pair_list("two edge vectors")]
"""The two edge vectors of a rectangle [m]."""
VelocityVector = Annotated[tuple[Velocity, Velocity, Velocity], _vector]
AngularVelocityVector = Annotated[tuple[AngularVelocity, AngularVelocity, AngularVelocity], _vector]
AccelerationVector = Annotated[tuple[Acceleration, Acceleration, Acceleration], _vector]
Direction = Annotated[
    tuple[Plain, Plain, Plain],
    _vector,
    AfterValidator(require(any, "a direction must not be the zero vector; give one such as [0, 0, 1]")),
]
"""Vector (3,), not the zero vector; its length does not matter."""


# Numbers that keep the unit in which they are given: the bounds of a varied key, measured values


class NumberWithUnit(Number):
    """Reads a number of any dimension that keeps its unit."""

    def read(self, value: Any) -> GivenNumber:
        """Convert a value from the file. Raises PydanticCustomError as `Number.read`."""
        if isinstance(value, GivenNumber):
            return value
        number = super().read(value)
        return GivenNumber(value if isinstance(value, str) else number)


GivenQuantity = Annotated[GivenNumber, NumberWithUnit("any")]


def bound_faults(start: GivenNumber, stop: GivenNumber, scale: str) -> Iterator[Fault]:
    """Faults of bounds that do not ascend, have different units, or are not positive on the scale "log"."""
    if reason := mixed_units((start, stop)):
        yield Fault(("to",), reason)
    elif not start < stop:
        yield Fault(("to",), f"it must be larger than from, {start.text}")
    if scale == "log" and start <= 0.0:
        yield Fault(("from",), "it must be above 0 on a logarithmic scale, such as 1e-3")
