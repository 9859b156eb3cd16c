"""Shapes that several blocks of a scene share: box, cylinder, sides of a rectangle."""

import math
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from granflow.geometry.shape import are_perpendicular
from granflow.scene.model import Model, list_of_length, pair_list, require
from granflow.units import Fault, Number

# Types of the numbers and vectors in a scene, in SI units after reading.
#
# Lengths of the equipment scale with `scale` of a scene, numbers of particles with its cube; sizes of one
# particle or contact do not.

_vector = list_of_length(3, "a vector of three numbers is expected, [x, y, z]")
Plain = Annotated[float, Number()]
NotNegative = Annotated[float, Number(at_least=0)]
Positive = Annotated[float, Number(above=0)]
Share = Annotated[float, Number(noun="a fraction", at_least=0)]
Count = Annotated[int, Number(noun="a count", at_least=1, whole=True)]
Counts = Annotated[tuple[Count, Count, Count], _vector]
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
AnyQuantity = Annotated[float, Number("any")]
"""Number in SI units, or text with a unit that has the same factor in all dimensions that know it."""
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
    AfterValidator(
        require(
            lambda vector: max(map(abs, vector)) >= 1e-100,
            "the largest component of a direction must be at least 1e-100; give one such as [0, 0, 1]",
        )
    ),
]
"""Vector (3,), not the zero vector; its length does not matter, but the square of the length must not
underflow."""


class Box(Model):
    """A box with edges along the coordinate axes.

    >>> gf.Box(min=[0, 0, 0], max=["10 cm", 0.1, 0.1])
    Box(min=(0.0, 0.0, 0.0), max=(0.1, 0.1, 0.1))
    """

    min: Point = Field(description="corner with the smallest coordinates [m]")
    max: Point = Field(description="corner with the largest coordinates [m]")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault for each axis along which the extent is not positive."""
        for i, (low, high) in enumerate(zip(self.min, self.max, strict=True)):
            if high <= low:
                yield Fault(("max", i), f"it must be above min, {low:g} m")


class Axial(Model):
    """A shape around the line from `from` to `to` [m]."""

    from_: Point = Field(alias="from", description="one end of the axis [m]")
    to: Point = Field(description="the other end of the axis [m]")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault if the axis has no length."""
        yield from super().faults()
        if self.from_ == self.to:
            yield Fault(("to",), "it is the same point as from; the end points of the axis must differ")


class CylinderShape(Axial):
    """A solid cylinder around an axis."""

    radius: PositiveLength = Field(description="radius [m]")


class Rectangular(Model):
    """A flat rectangle with one corner and two edge vectors [m]."""

    corner: Point = Field(description="one corner [m]")
    sides: Sides = Field(description="the two edge vectors from that corner, perpendicular [m]")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the edges have lengths above 0 and are perpendicular."""
        yield from super().faults()
        a, b = self.sides
        lengths = math.hypot(*a), math.hypot(*b)
        for i, length in enumerate(lengths):
            if length == 0:
                yield Fault(("sides", i), "a side must not be the zero vector")
        if all(lengths) and not are_perpendicular(a, b):
            angle = math.degrees(math.acos(dot(a, b) / (lengths[0] * lengths[1])))
            yield Fault(
                ("sides",), f"the two sides must be perpendicular, and their angle is {angle:.4g} deg"
            )


def dot(a: Vector3, b: Vector3) -> float:
    """Scalar product of two vectors."""
    return sum(x * y for x, y in zip(a, b, strict=True))
