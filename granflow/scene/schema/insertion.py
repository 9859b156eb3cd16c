"""Schema of the key `insert` of particle groups: regions, faces, and the kinds of insertion."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from granflow.scene.schema import quantities as q
from granflow.scene.schema.faults import Fault, redundant, whole
from granflow.scene.schema.fields import FileName, ListOf, Model, choose_by_first_key, choose_by_key
from granflow.scene.schema.numbers import Number
from granflow.scene.schema.shapes import Box, CylinderShape, Rectangular

Jitter = Annotated[float, Number(noun="a jitter", at_least=0, at_most=1)]
"""Random displacement over the free gap: 0 to 1."""


class BoxRegion(Model):
    """An insertion region: a box. Particles lie entirely inside.

    >>> gf.BoxRegion(box=gf.Box(min=[0, 0, 0], max=["10 cm", 0.1, 0.1])).box.max
    (0.1, 0.1, 0.1)
    """

    box: Box = Field(description="a box along the coordinate axes, {min: [..], max: [..]}")


class CylinderRegion(Model):
    """An insertion region: a cylinder. Particles lie entirely inside.

    >>> gf.CylinderRegion(cylinder={"from": [0, 0, 0], "to": [0, 0, 0.1], "radius": "5 cm"}).cylinder.radius
    0.05
    """

    cylinder: CylinderShape = Field(description="a cylinder, {from: [..], to: [..], radius: ..}")


Region = Annotated[
    BoxRegion | CylinderRegion,
    choose_by_first_key("it must be {box: {min: [..], max: [..]}} or {cylinder: {from: [..], to: [..], radius: ..}}"),
]
"""A box or a cylinder, in which particles lie entirely inside."""


class LatticeInsertion(Model):
    """Particles on a regular lattice in a region, in layers from the bottom, with the widest spacing that fits.

    >>> region = gf.BoxRegion(box=gf.Box(min=[0, 0, 0], max=[0.1, 0.1, 0.1]))
    >>> gf.LatticeInsertion(region=region, jitter=0.2).jitter
    0.2
    """

    kind: Literal["lattice"] = Field("lattice", description="kind of insertion")
    region: Region = Field(description="region to fill: a box or a cylinder")
    jitter: Jitter = Field(0.0, description="random displacement, as a fraction of the free gap")


class PackInsertion(Model):
    """Particles in a random packing without overlap in a region; solid fraction up to about 0.55.

    >>> region = gf.CylinderRegion(cylinder={"from": [0, 0, 0], "to": [0, 0, 0.1], "radius": "5 cm"})
    >>> gf.PackInsertion(region=region).region.cylinder.radius
    0.05
    """

    kind: Literal["pack"] = Field("pack", description="kind of insertion")
    region: Region = Field(description="region to fill: a box or a cylinder")


class TimedInsertion(Model):
    """Insertion during the run at a constant number or mass per second.

    It ends when the count or mass of the group is inserted, or at `end`. Sizes are in a fixed order, so that each size
    class has its fraction at any time.
    """

    rate: q.Rate | None = Field(None, description="insertion rate, particles per second [1/s]")
    mass_flow: q.MassFlow | None = Field(None, description="insertion rate, mass per second [kg/s]; instead of rate")
    start: q.Time = Field(0.0, description="time of the first particle [s]")
    end: q.PositiveTime | None = Field(
        None, description="end of the insertion [s]; default: when all particles are inserted"
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless exactly one of rate and mass_flow is given, and the end is after the start."""
        if self.rate is None and self.mass_flow is None:
            yield whole((), "has no insertion rate: give rate in 1/s, or mass_flow in kg/s")
        if self.rate is not None and self.mass_flow is not None:
            yield redundant("mass_flow", "rate")
        if self.end is not None and self.end <= self.start:
            yield Fault(("end",), f"the insertion must end after its start at {self.start:g} s")


class RainInsertion(TimedInsertion):
    """Insertion at random free positions in a region, until the count, the mass or the end time is reached.

    Particles without a free position are queued and inserted first in the next batch. Walls are not considered.

    >>> region = gf.BoxRegion(box=gf.Box(min=[0, 0, 0.1], max=[0.1, 0.1, 0.2]))
    >>> gf.RainInsertion(region=region, mass_flow="2 t/h", end="1 s").end
    1.0
    """

    kind: Literal["rain"] = Field("rain", description="kind of insertion")
    region: Region = Field(description="region of the insertion: a box or a cylinder")


class RectangleOutline(Rectangular):
    """A flat rectangle."""

    sides: q.Sides = Field(
        description="the two edge vectors from that corner, perpendicular [m]; particles enter along first x second"
    )


class DiscOutline(Model):
    """A flat disc."""

    center: q.Point = Field(description="center [m]")
    normal: q.Direction = Field(description="direction in which particles enter; its length does not matter")
    radius: q.PositiveLength = Field(description="radius [m]")


class RectangleFace(Model):
    """A rectangle through which particles enter.

    >>> gf.RectangleFace(rectangle={"corner": [0, 0, 0], "sides": [[0.1, 0, 0], [0, 0.1, 0]]}).rectangle.corner
    (0.0, 0.0, 0.0)
    """

    rectangle: RectangleOutline = Field(description="{corner: [..], sides: [[..], [..]]}")


class DiscFace(Model):
    """A disc through which particles enter.

    >>> gf.DiscFace(disc={"center": [0, 0, 0.2], "normal": [0, 0, -1], "radius": "3 cm"}).disc.radius
    0.03
    """

    disc: DiscOutline = Field(description="{center: [..], normal: [..], radius: ..}")


Face = Annotated[
    RectangleFace | DiscFace,
    choose_by_first_key(
        "it must be {rectangle: {corner: [..], sides: [..]}} or {disc: {center: [..], normal: [..], radius: ..}}"
    ),
]
"""A rectangle or a disc through which particles enter along its normal."""


class InletInsertion(TimedInsertion):
    """Insertion through a face: particles appear directly downstream of it with the velocity of the group.

    The positions are random; particles without a free position are queued.

    >>> face = gf.DiscFace(disc={"center": [0, 0, 0.2], "normal": [0, 0, -1], "radius": "3 cm"})
    >>> gf.InletInsertion(face=face, rate="800 1/s").rate
    800.0
    """

    kind: Literal["inlet"] = Field("inlet", description="kind of insertion")
    face: Face = Field(description="face of the inlet: a rectangle or a disc")


class FileSummary(Model):
    """Summary of the particles in a file; granflow fills it in when it reads the file."""

    count: q.ParticleCount = Field(description="number of particles read from the file")
    diameter_min: q.UnscaledLength = Field(description="smallest diameter [m]")
    diameter_max: q.UnscaledLength = Field(description="largest diameter [m]")
    speed_max: q.AnySpeed = Field(description="largest speed [m/s]")
    angular_velocity_max: q.AngularVelocity = Field(description="largest angular velocity [rad/s]")
    overlap_max: q.Share = Field(description="largest overlap of two particles over the smaller radius")
    overlap_rows: str = Field("", description="lines or points of the file with the largest overlap")


class FileInsertion(Model):
    """Particles from a table: CSV, or a VTU frame.

    Required columns: x, y, z and r (or diameter); optional: velocity, angular velocity, material. With a material
    column, the group gets the rows of its material.

    >>> gf.FileInsertion(file="start.csv")
    FileInsertion(file='start.csv')
    """

    kind: Literal["file"] = Field("file", description="kind of insertion")
    file: FileName = Field(description="CSV, text or VTU file; path relative to the folder of the scene")
    found: FileSummary | None = Field(None, description="summary of the file; granflow fills it in")


class PositionsInsertion(Model):
    """Particles at given positions.

    >>> gf.PositionsInsertion(positions=[[0, 0, 0], ["1 cm", 0, 0]]).positions
    ((0.0, 0.0, 0.0), (0.01, 0.0, 0.0))
    """

    kind: Literal["positions"] = Field("positions", description="kind of insertion")
    positions: Annotated[tuple[q.Point, ...], ListOf(some="[[0, 0, 0]]")] = Field(description="centers [m]")


class PythonInsertion(Model):
    """No particles from the scene: a Python program adds them, with `simulation.particles.add` or from arrays.

    `count` of the group is the number of particles for which arrays and chunks are sized; more can be added.

    >>> sizes = gf.UniformSizes(min="3 mm", max="4 mm")
    >>> gf.Group(material="glass", count=5000, diameter=sizes, insert=gf.PythonInsertion()).insert.kind
    'python'
    """

    kind: Literal["python"] = Field("python", description="kind of insertion")


Insertion = Annotated[
    LatticeInsertion
    | PackInsertion
    | RainInsertion
    | InletInsertion
    | PositionsInsertion
    | FileInsertion
    | PythonInsertion,
    choose_by_key("kind"),
]
"""Any kind of insertion; the key `kind` selects it."""
