"""Schema of particle insertion: regions, faces, and the kinds of insertion."""

from collections.abc import Callable, Iterator
from pathlib import PurePath
from typing import Annotated, Any, Literal

from pydantic import Field, Tag

from granflow.scene.schema.fields import (
    AngularVelocity,
    AnySpeed,
    Direction,
    Fault,
    FileName,
    MassFlow,
    Model,
    Number,
    ParticleCount,
    Point,
    PositiveLength,
    PositiveTime,
    Rate,
    Share,
    Time,
    UnscaledLength,
    choose_by,
    choose_by_key,
    list_of,
    pair_list,
)
from granflow.scene.schema.walls import side_faults

Jitter = Annotated[float, Number(noun="a jitter", at_least=0, at_most=1)]
"""Random displacement over the free gap: 0 to 1."""


class Box(Model):
    """A box with edges along the coordinate axes."""

    min: Point = Field(description="corner with the smallest coordinates [m]")
    max: Point = Field(description="corner with the largest coordinates [m]")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault for each axis along which the extent is not positive."""
        for i, (low, high) in enumerate(zip(self.min, self.max, strict=True)):
            if high <= low:
                yield Fault(("max", i), f"it must be above min, {low:g} m")


class CylinderShape(Model):
    """A solid cylinder around an axis."""

    from_: Point = Field(alias="from", description="one end of the axis [m]")
    to: Point = Field(description="the other end of the axis [m]")
    radius: PositiveLength = Field(description="radius [m]")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault if the axis has no length."""
        if self.from_ == self.to:
            yield Fault(("to",), "it is the same point as from; the end points of the axis must differ")


class BoxRegion(Model):
    """An insertion region: a box. Particles lie entirely inside."""

    box: Box = Field(description="a box along the coordinate axes, {min: [..], max: [..]}")


class CylinderRegion(Model):
    """An insertion region: a cylinder. Particles lie entirely inside."""

    cylinder: CylinderShape = Field(description="a cylinder, {from: [..], to: [..], radius: ..}")


def choose_by_field(**models: type[Model]) -> Callable[[Any], str | None]:
    """Choose a member of a union by a key of the mapping.

    `models`: key -> model with this key; the tag is the key in angle brackets. The result is the argument of
    `choose_by`.
    """

    def tag(value: Any) -> str | None:
        for name, model in models.items():
            if isinstance(value, model) or (isinstance(value, dict) and name in value):
                return f"<{name}>"
        return None

    return tag


Region = Annotated[
    Annotated[BoxRegion, Tag("<box>")] | Annotated[CylinderRegion, Tag("<cylinder>")],
    choose_by(
        choose_by_field(box=BoxRegion, cylinder=CylinderRegion),
        "it must be {box: {min: [..], max: [..]}} or {cylinder: {from: [..], to: [..], radius: ..}}",
    ),
]
"""A box or a cylinder, in which particles lie entirely inside."""


class LatticeInsertion(Model):
    """Particles on a regular lattice in a region, in layers from the bottom, with the widest spacing that fits."""

    kind: Literal["lattice"] = Field(description="kind of insertion")
    region: Region = Field(description="region to fill: a box or a cylinder")
    jitter: Jitter = Field(0.0, description="random displacement, as a fraction of the free gap")


class PackInsertion(Model):
    """Particles in a random packing without overlap in a region; solid fraction up to about 0.55."""

    kind: Literal["pack"] = Field(description="kind of insertion")
    region: Region = Field(description="region to fill: a box or a cylinder")


class TimedInsertion(Model):
    """Insertion during the run at a constant number or mass per second.

    It ends when the count or mass of the group is inserted, or at `end`. Sizes are in a fixed order, so that each size
    class has its fraction at any time.
    """

    rate: Rate | None = Field(None, description="insertion rate, particles per second [1/s]")
    mass_flow: MassFlow | None = Field(None, description="insertion rate, mass per second [kg/s]; instead of rate")
    start: Time = Field(0.0, description="time of the first particle [s]")
    end: PositiveTime | None = Field(
        None, description="end of the insertion [s]; default: when all particles are inserted"
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless exactly one of rate and mass_flow is given, and the end is after the start."""
        if self.rate is None and self.mass_flow is None:
            yield Fault((), "has no insertion rate: give rate in 1/s, or mass_flow in kg/s", whole=True)
        if self.rate is not None and self.mass_flow is not None:
            yield Fault(("mass_flow",), "rate is given too: keep one of them")
        if self.end is not None and self.end <= self.start:
            yield Fault(("end",), f"the insertion must end after its start at {self.start:g} s")


class RainInsertion(TimedInsertion):
    """Insertion at random free positions in a region, until the count, the mass or the end time is reached.

    Particles without a free position are queued and inserted first in the next batch. Walls are not considered.
    """

    kind: Literal["rain"] = Field(description="kind of insertion")
    region: Region = Field(description="region of the insertion: a box or a cylinder")


class RectangleOutline(Model):
    """A flat rectangle."""

    corner: Point = Field(description="one corner [m]")
    sides: Annotated[tuple[Point, Point], pair_list("two edge vectors")] = Field(
        description="the two edge vectors from that corner, perpendicular [m]; particles enter along first x second"
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the edges have lengths above 0 and are perpendicular."""
        yield from side_faults(self.sides)


class DiscOutline(Model):
    """A flat disc."""

    center: Point = Field(description="center [m]")
    normal: Direction = Field(description="direction in which particles enter; its length does not matter")
    radius: PositiveLength = Field(description="radius [m]")


class RectangleFace(Model):
    """A rectangle through which particles enter."""

    rectangle: RectangleOutline = Field(description="{corner: [..], sides: [[..], [..]]}")


class DiscFace(Model):
    """A disc through which particles enter."""

    disc: DiscOutline = Field(description="{center: [..], normal: [..], radius: ..}")


Face = Annotated[
    Annotated[RectangleFace, Tag("<rectangle>")] | Annotated[DiscFace, Tag("<disc>")],
    choose_by(
        choose_by_field(rectangle=RectangleFace, disc=DiscFace),
        "it must be {rectangle: {corner: [..], sides: [..]}} or {disc: {center: [..], normal: [..], radius: ..}}",
    ),
]
"""A rectangle or a disc through which particles enter along its normal."""


class InletInsertion(TimedInsertion):
    """Insertion through a face: particles appear directly downstream of it with the velocity of the group.

    The positions are random; particles without a free position are queued.
    """

    kind: Literal["inlet"] = Field(description="kind of insertion")
    face: Face = Field(description="face of the inlet: a rectangle or a disc")


class FileSummary(Model):
    """Summary of the particles in a file; granflow fills it in when it reads the file."""

    count: ParticleCount = Field(description="number of particles read from the file")
    diameter_min: UnscaledLength = Field(description="smallest diameter [m]")
    diameter_max: UnscaledLength = Field(description="largest diameter [m]")
    speed_max: AnySpeed = Field(description="largest speed [m/s]")
    angular_velocity_max: AngularVelocity = Field(description="largest angular velocity [rad/s]")
    overlap_max: Share = Field(description="largest overlap of two particles over the smaller radius")


class FileInsertion(Model):
    """Particles from a table: CSV, or a VTU frame.

    Required columns: x, y, z and r (or diameter); optional: velocity, angular velocity, material. With a material
    column, the group gets the rows of its material.
    """

    kind: Literal["file"] = Field(description="kind of insertion")
    file: FileName = Field(description="CSV, text or VTU file; path relative to the folder of the scene, without ..")
    found: FileSummary | None = Field(None, description="summary of the file; granflow fills it in")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the file lies in the folder of the scene, or below it."""
        path = PurePath(self.file)
        if path.is_absolute() or ".." in path.parts or not path.parts:
            yield Fault(("file",), "the file must be in the folder of the scene or below it; give a relative path")


class PositionsInsertion(Model):
    """Particles at given positions."""

    kind: Literal["positions"] = Field(description="kind of insertion")
    positions: Annotated[tuple[Point, ...], list_of(some="[[0, 0, 0]]")] = Field(description="centers [m]")


Insertion = Annotated[
    Annotated[LatticeInsertion, Tag("<lattice>")]
    | Annotated[PackInsertion, Tag("<pack>")]
    | Annotated[RainInsertion, Tag("<rain>")]
    | Annotated[InletInsertion, Tag("<inlet>")]
    | Annotated[PositionsInsertion, Tag("<positions>")]
    | Annotated[FileInsertion, Tag("<file>")],
    choose_by_key("kind"),
]
"""Any kind of insertion; the key `kind` selects it."""
