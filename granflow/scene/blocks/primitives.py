"""Geometric primitives that several blocks of a scene share: box, cylinder, rectangle, and a rotation.

Walls, insertion regions, outlets, grids and the domain use them; mesh walls and clumps have rotations.
"""

import math
from collections.abc import Iterator

from pydantic import Field

from granflow.geometry.vectors import are_perpendicular
from granflow.schema import quantities as q
from granflow.schema.faults import Fault
from granflow.schema.model import Model


class Box(Model):
    """A box with edges along the coordinate axes.

    >>> gf.Box(min=[0, 0, 0], max=["10 cm", 0.1, 0.1])
    Box(min=(0.0, 0.0, 0.0), max=(0.1, 0.1, 0.1))
    """

    min: q.Point = Field(description="corner with the smallest coordinates [m]", examples=[[0, 0, 0]])
    max: q.Point = Field(
        description="corner with the largest coordinates [m]", examples=[["40 mm", "40 mm", "80 mm"]]
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault for each axis along which the extent is not positive."""
        yield from super().faults()
        for i, (low, high) in enumerate(zip(self.min, self.max, strict=True)):
            if high <= low:
                yield Fault(("max", i), f"it must be above min, {low:g} m")


class Axial(Model):
    """A shape around the line from `from` to `to` [m]."""

    from_: q.Point = Field(alias="from", description="one end of the axis [m]")
    to: q.Point = Field(description="the other end of the axis [m]")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault if the axis has no length."""
        yield from super().faults()
        if self.from_ == self.to:
            yield Fault(("to",), "it is the same point as from; the end points of the axis must differ")


class CylinderShape(Axial):
    """A solid cylinder around an axis."""

    radius: q.PositiveLength = Field(description="radius [m]")


class Rectangular(Model):
    """A flat rectangle with one corner and two edge vectors [m]."""

    corner: q.Point = Field(description="one corner [m]")
    sides: q.Sides = Field(description="the two edge vectors from that corner, perpendicular [m]")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the edges have lengths above 0 and are perpendicular."""
        yield from super().faults()
        a, b = self.sides
        lengths = [math.hypot(*side) for side in (a, b)]
        for i, length in enumerate(lengths):
            if length == 0:
                yield Fault(("sides", i), "a side must not be the zero vector")
        if all(lengths) and not are_perpendicular(a, b):
            product = sum(x * y for x, y in zip(a, b, strict=True))
            angle = math.degrees(math.acos(product / (lengths[0] * lengths[1])))
            across = [y - product / lengths[0] ** 2 * x for x, y in zip(a, b, strict=True)]
            part = ", ".join(f"{each + 0.0:.4g}" for each in across)
            yield Fault(
                ("sides",),
                f"the two sides must be perpendicular, and their angle is {angle:.4g} deg; the part of the "
                f"second side across the first is [{part}] m",
            )


class RotationStep(Model):
    """A right-handed rotation about an axis through the origin.

    >>> gf.RotationStep(axis=[1, 0, 0], angle="90 deg")
    RotationStep(axis=(1.0, 0.0, 0.0), angle=1.5707963267948966)
    """

    axis: q.Direction = Field(description="direction of the axis; its length does not matter")
    angle: q.Angle = Field(description="angle [rad], such as 90 deg", examples=["90 deg"])
