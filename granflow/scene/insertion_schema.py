"""Schema of where particles are put, or come in: regions, faces, and the ways of placing."""

from collections.abc import Callable, Iterator
from pathlib import PurePath
from typing import Annotated, Any, Literal

from pydantic import Field, Tag

from granflow.scene.fields import (
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
from granflow.scene.wall_schema import side_faults

Jitter = Annotated[float, Number(noun="a jitter", at_least=0, at_most=1)]


class Box(Model):
    """A box along the axes."""

    min: Point = Field(description="corner with the smallest coordinates [m]")
    max: Point = Field(description="corner with the largest coordinates [m]")

    def faults(self) -> Iterator[Fault]:
        """A box with room in it."""
        for i, (low, high) in enumerate(zip(self.min, self.max, strict=True)):
            if high <= low:
                yield Fault(("max", i), f"it must be above min, {low:g} m")


class CylinderShape(Model):
    """A round volume about an axis."""

    from_: Point = Field(alias="from", description="one end of the axis [m]")
    to: Point = Field(description="the other end of the axis [m]")
    radius: PositiveLength = Field(description="radius [m]")

    def faults(self) -> Iterator[Fault]:
        """An axis with a length."""
        if self.from_ == self.to:
            yield Fault(("to",), "it is the same point as from: the axis must have a length above 0")


class BoxRegion(Model):
    """Room for particles: a box. Whole particles stay inside."""

    box: Box = Field(description="a box along the axes, {min: [..], max: [..]}")


class CylinderRegion(Model):
    """Room for particles: a cylinder. Whole particles stay inside."""

    cylinder: CylinderShape = Field(description="a cylinder, {from: [..], to: [..], radius: ..}")


def choose_by_field(**models: type[Model]) -> Callable[[Any], str | None]:
    """Choose a model by the key that a mapping has."""

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


class LatticeInsertion(Model):
    """Particles on a regular lattice in a region."""

    kind: Literal["lattice"] = Field(description="way of placing the particles")
    region: Region = Field(description="the room to fill: a box or a cylinder")
    jitter: Jitter = Field(0.0, description="random shift, as a fraction of the free gap")


class PackInsertion(Model):
    """Particles at random in a region, none overlapping."""

    kind: Literal["pack"] = Field(description="way of placing the particles")
    region: Region = Field(description="the room to fill: a box or a cylinder")


class TimedInsertion(Model):
    """Particles that come while the run goes on: so many, or so much mass, a second."""

    rate: Rate | None = Field(None, description="particles per second [1/s]")
    mass_flow: MassFlow | None = Field(None, description="mass per second [kg/s], in place of rate")
    start: Time = Field(0.0, description="time of the first particle [s]")
    end: PositiveTime | None = Field(None, description="time after which none is due any more [s]; left out: never")

    def faults(self) -> Iterator[Fault]:
        """A rate of one kind; an end after the start."""
        if self.rate is None and self.mass_flow is None:
            yield Fault((), "says not how fast they come: give rate in 1/s, or mass_flow in kg/s", whole=True)
        if self.rate is not None and self.mass_flow is not None:
            yield Fault(("mass_flow",), "rate is given too: keep one of them")
        if self.end is not None and self.end <= self.start:
            yield Fault(("end",), f"the stream must end after its start at {self.start:g} s")


class RainInsertion(TimedInsertion):
    """Particles that appear at random in a region, until there are as many as asked, or as heavy, or it ends."""

    kind: Literal["rain"] = Field(description="way of placing the particles")
    region: Region = Field(description="where they appear: a box or a cylinder")


class RectangleOutline(Model):
    """A flat rectangle."""

    corner: Point = Field(description="one corner [m]")
    sides: Annotated[tuple[Point, Point], pair_list("two edge vectors")] = Field(
        description="the two edges from that corner, perpendicular vectors [m]; the first times the second is forward"
    )

    def faults(self) -> Iterator[Fault]:
        """Sides with lengths, at a right angle."""
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


class InletInsertion(TimedInsertion):
    """Particles that enter through a face, whole ones just inside it, on their way with the group's velocity."""

    kind: Literal["inlet"] = Field(description="way of placing the particles")
    face: Face = Field(description="where they enter: a rectangle or a disc")


class FileSummary(Model):
    """What a file of particles holds; filled in when it is read."""

    count: ParticleCount = Field(description="particles taken from the file")
    diameter_min: UnscaledLength = Field(description="smallest diameter [m]")
    diameter_max: UnscaledLength = Field(description="largest diameter [m]")
    speed_max: AnySpeed = Field(description="largest speed [m/s]")
    overlap_max: Share = Field(description="largest overlap of two of them over the smaller radius")


class FileInsertion(Model):
    """Particles from a table: CSV, or a VTU frame."""

    kind: Literal["file"] = Field(description="way of placing the particles")
    file: FileName = Field(description="CSV, text or VTU file in the scene's folder or below it: its path from there")
    found: FileSummary | None = Field(None, description="what the file holds; filled in when it is read")

    def faults(self) -> Iterator[Fault]:
        """A file in the scene's folder, or below it."""
        path = PurePath(self.file)
        if path.is_absolute() or ".." in path.parts or not path.parts:
            yield Fault(("file",), "the file must lie in the scene's folder, or below it; give its path from there")


class PositionsInsertion(Model):
    """Particles at given positions."""

    kind: Literal["positions"] = Field(description="way of placing the particles")
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
