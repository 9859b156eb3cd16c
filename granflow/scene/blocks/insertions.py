"""Schema of the key `insert` of a group: the kinds of insertion.

A kind is one class: its keys, its checks, the region or face in which it inserts, the positions of its
particles at the start, or the times of those that enter during the run. `Insertion` at the end is the union
of all kinds. `particles.file` reads particle files, `particles.insertion` inserts particles during a run.
"""

from collections.abc import Callable, Iterator
from math import hypot, inf, sqrt
from typing import Annotated, ClassVar, Literal, get_args

import numpy as np
from pydantic import Field

from granflow.geometry.packing import Spheres, fill_lattice, pack_at_random
from granflow.geometry.region import BoxSampler, CylinderSampler, FilledRegion, RegionSampler, SlabSampler
from granflow.scene.blocks.primitives import Box, CylinderShape, Rectangular
from granflow.schema import quantities as q
from granflow.schema.faults import Fault, redundant, whole
from granflow.schema.model import (
    FileName,
    ListOf,
    Model,
    StageNames,
    choose_by_first_key,
    choose_by_key,
    optional,
)
from granflow.schema.quantities import Number, Vector3

# Regions and faces

Extent = tuple[float, float]
"""Smallest and largest coordinate [m] along one axis."""


def round_extent(a: Vector3, b: Vector3, axis: Vector3, radius: float) -> Iterator[Extent]:
    """Extent along each axis of two circles around the points a and b [m], perpendicular to `axis`.

    With the unit axis a, a radius R extends by R sqrt(1 - a_k^2) along axis k from each end.
    """
    length = hypot(*axis) or 1.0
    for start, end, along in zip(a, b, axis, strict=True):
        reach = radius * sqrt(max(0.0, 1 - (along / length) ** 2))
        yield min(start, end) - reach, max(start, end) + reach


class Place(Model):
    """A region or face in which particles are inserted. Base class.

    The checks of the scene ask for `extent`, the warnings of the plan for the rest.

    reversal:  what turns the normal of a face around, as an instruction
    """

    reversal: ClassVar[str] = ""

    @property
    def sampler(self) -> FilledRegion | None:
        """The region in SI units; None for a face."""
        return None

    @property
    def opening(self) -> float:
        """Diameter of the largest sphere that fits through a face [m]; infinite for a region."""
        return inf

    def extent(self) -> Iterator[Extent]:
        """Smallest and largest coordinate [m] along each axis."""
        raise NotImplementedError


class BoxRegion(Place):
    """An insertion region: a box. Particles lie entirely inside.

    >>> gf.BoxRegion(box=gf.Box(min=[0, 0, 0], max=["10 cm", 0.1, 0.1])).box.max
    (0.1, 0.1, 0.1)
    """

    box: Box = Field(description="a box along the coordinate axes, {min: [..], max: [..]}")

    @property
    def sampler(self) -> FilledRegion:
        """The region in SI units."""
        return BoxSampler(np.array(self.box.min), np.array(self.box.max))

    def extent(self) -> Iterator[Extent]:
        """Smallest and largest coordinate [m] along each axis."""
        yield from zip(self.box.min, self.box.max, strict=True)


class CylinderRegion(Place):
    """An insertion region: a cylinder. Particles lie entirely inside.

    >>> gf.CylinderRegion(cylinder={"from": [0, 0, 0], "to": [0, 0, 0.1], "radius": "5 cm"}).cylinder.radius
    0.05
    """

    cylinder: CylinderShape = Field(description="a cylinder, {from: [..], to: [..], radius: ..}")

    @property
    def sampler(self) -> FilledRegion:
        """The region in SI units."""
        return CylinderSampler(
            np.array(self.cylinder.from_), np.array(self.cylinder.to), self.cylinder.radius
        )

    def extent(self) -> Iterator[Extent]:
        """Smallest and largest coordinate [m] along each axis."""
        a, b = self.cylinder.from_, self.cylinder.to
        yield from round_extent(a, b, (b[0] - a[0], b[1] - a[1], b[2] - a[2]), self.cylinder.radius)


Region = Annotated[
    BoxRegion | CylinderRegion,
    choose_by_first_key(
        "it must be {box: {min: [..], max: [..]}} or {cylinder: {from: [..], to: [..], radius: ..}}"
    ),
]
"""A box or a cylinder, in which particles lie entirely inside."""


class RectangleOutline(Rectangular):
    """A flat rectangle."""

    sides: q.Sides = Field(
        description=(
            "the two edge vectors from that corner, perpendicular [m]; particles enter along first x second"
        ),
        examples=[[["40 mm", 0, 0], [0, "20 mm", 0]]],
    )


class DiscOutline(Model):
    """A flat disc."""

    center: q.Point = Field(description="center [m]")
    normal: q.Direction = Field(description="direction in which particles enter; its length does not matter")
    radius: q.PositiveLength = Field(description="radius [m]")


class RectangleFace(Place):
    """A rectangle through which particles enter.

    >>> outline = {"corner": [0, 0, 0], "sides": [[0.1, 0, 0], [0, 0.1, 0]]}
    >>> gf.RectangleFace(rectangle=outline).rectangle.corner
    (0.0, 0.0, 0.0)
    """

    rectangle: RectangleOutline = Field(description="{corner: [..], sides: [[..], [..]]}")
    reversal = "exchange the two sides of face.rectangle"

    @property
    def opening(self) -> float:
        """See `Place`."""
        return min(hypot(*each) for each in self.rectangle.sides)

    @property
    def normal(self) -> np.ndarray:
        """Unit vector (3,) along which particles enter."""
        first, second = np.array(self.rectangle.sides, float)
        return np.asarray(np.cross(first, second) / np.linalg.norm(np.cross(first, second)))

    def behind(self, depth: float) -> RegionSampler:
        """The space downstream of the face to a depth [m]."""
        first, second = np.array(self.rectangle.sides, float)
        return SlabSampler(np.array(self.rectangle.corner), first, second, depth)

    def extent(self) -> Iterator[Extent]:
        """Smallest and largest coordinate [m] along each axis."""
        for c, first, second in zip(self.rectangle.corner, *self.rectangle.sides, strict=True):
            corners = (c, c + first, c + second, c + first + second)
            yield min(corners), max(corners)


class DiscFace(Place):
    """A disc through which particles enter.

    >>> gf.DiscFace(disc={"center": [0, 0, 0.2], "normal": [0, 0, -1], "radius": "3 cm"}).disc.radius
    0.03
    """

    disc: DiscOutline = Field(description="{center: [..], normal: [..], radius: ..}")
    reversal = "reverse face.disc.normal"

    @property
    def opening(self) -> float:
        """See `Place`."""
        return 2.0 * self.disc.radius

    @property
    def normal(self) -> np.ndarray:
        """Unit vector (3,) along which particles enter."""
        return np.array(self.disc.normal) / hypot(*self.disc.normal)

    def behind(self, depth: float) -> RegionSampler:
        """The space downstream of the face to a depth [m]."""
        end = self.disc.center + depth * self.normal
        return CylinderSampler(np.array(self.disc.center), end, self.disc.radius)

    def extent(self) -> Iterator[Extent]:
        """Smallest and largest coordinate [m] along each axis."""
        yield from round_extent(self.disc.center, self.disc.center, self.disc.normal, self.disc.radius)


Face = Annotated[
    RectangleFace | DiscFace,
    choose_by_first_key(
        "it must be {rectangle: {corner: [..], sides: [..]}} or {disc: {center: [..], normal: [..], radius: "
        "..}}"
    ),
]
"""A rectangle or a disc through which particles enter along its normal."""


# What a kind answers


class InsertionKind(Model):
    """A kind of insertion: its keys and what follows from them. Base class of the kinds.

    A kind is required to have either `order` and `centers` (particles at the start), or the methods of
    `TimedInsertion` (particles during the run). `particles.insertion` calls them: `centers` once for each
    group, in the order of `order`; `region_for` when it makes the inserter of a group. Everything else has a
    default: a kind declares what applies to it.

    order:          place among the kinds that are inserted at the start, from 0: given positions first,
                    random packings last, so that each kind can avoid the particles before it; None if no
                    particle exists at the start
    place_key:      key of the region or face in which particles are inserted; empty without one
    has_rows:       whether a row of data defines each particle, so that neither mass nor scale change them
    defines_sizes:  whether the data contain the sizes
    from_program:   whether only a program adds particles
    """

    order: ClassVar[int | None] = None
    place_key: ClassVar[str] = ""
    has_rows: ClassVar[bool] = False
    defines_sizes: ClassVar[bool] = False
    from_program: ClassVar[bool] = False

    @property
    def place(self) -> Place | None:
        """The region or face in which particles are inserted; None without one."""
        return getattr(self, self.place_key) if self.place_key else None

    def centers(self, radius: np.ndarray, existing: Spheres, random: np.random.Generator) -> np.ndarray:
        """Centers (n, 3) [m] of the particles at the start, of radii (n,) [m], without overlap with
        `existing`; given centers are not checked.

        Raises RegionFullError if the particles do not fit.
        """
        raise NotImplementedError

    def region_for(self, radius: float, velocity: np.ndarray, gathered: float = 0.0) -> RegionSampler | None:
        """Region in which particles are inserted; None for those of a file or a program, or given centers.

        Besides the inserter, the forecasts of the plan ask for it: heights of fall, weight of the bed, and
        flow out of the region. `radius` [m]: largest; `velocity` (3,) [m/s] of the group; `gathered` [s]:
        time of one batch.
        """
        return None

    @property
    def points(self) -> tuple[Vector3, ...]:
        """Given centers [m], for checks of the scene and forecasts; empty without."""
        return ()

    @property
    def source(self) -> str | None:
        """Path of the file with the particles, which `particles.file` reads; None without one."""
        return None

    @property
    def summary(self) -> "FileSummary | None":
        """Summary of the file, once it is read; None without a file."""
        return None

    def with_source(self, path: str) -> "InsertionKind":
        """This insertion with another path of its file; a run saves a copy of the file."""
        raise NotImplementedError


# Kinds whose particles exist from the start


Jitter = Annotated[float, Number(noun="a jitter", at_least=0, at_most=1)]
"""Random displacement over the free gap: 0 to 1."""


class LatticeInsertion(InsertionKind):
    """Particles on a regular lattice in a region, in layers from the bottom, with the widest spacing that
    fits.

    >>> region = gf.BoxRegion(box=gf.Box(min=[0, 0, 0], max=[0.1, 0.1, 0.1]))
    >>> gf.LatticeInsertion(region=region, jitter=0.2).jitter
    0.2
    """

    kind: Literal["lattice"] = Field("lattice", description="kind of insertion")
    region: Region = Field(description="region to fill: a box or a cylinder")
    jitter: Jitter = Field(0.0, description="random displacement, as a fraction of the free gap")
    order: ClassVar[int | None] = 2
    place_key: ClassVar[str] = "region"

    def region_for(self, radius: float, velocity: np.ndarray, gathered: float = 0.0) -> RegionSampler:
        """The region as given."""
        return self.region.sampler

    def centers(self, radius: np.ndarray, existing: Spheres, random: np.random.Generator) -> np.ndarray:
        """Centers (n, 3) [m] on the lattice."""
        return fill_lattice(self.region.sampler, radius, self.jitter, existing, random)


class PackInsertion(InsertionKind):
    """Particles in a random packing without overlap in a region; solid fraction up to about 0.55.

    >>> region = gf.CylinderRegion(cylinder={"from": [0, 0, 0], "to": [0, 0, 0.1], "radius": "5 cm"})
    >>> gf.PackInsertion(region=region).region.cylinder.radius
    0.05
    """

    kind: Literal["pack"] = Field("pack", description="kind of insertion")
    region: Region = Field(description="region to fill: a box or a cylinder")
    order: ClassVar[int | None] = 3
    place_key: ClassVar[str] = "region"

    def region_for(self, radius: float, velocity: np.ndarray, gathered: float = 0.0) -> RegionSampler:
        """The region as given."""
        return self.region.sampler

    def centers(self, radius: np.ndarray, existing: Spheres, random: np.random.Generator) -> np.ndarray:
        """Centers (n, 3) [m] of the packing."""
        return pack_at_random(self.region.sampler, radius, existing, random)


class PositionsInsertion(InsertionKind):
    """Particles at given positions.

    >>> gf.PositionsInsertion(positions=[[0, 0, 0], ["1 cm", 0, 0]]).positions
    ((0.0, 0.0, 0.0), (0.01, 0.0, 0.0))
    """

    kind: Literal["positions"] = Field("positions", description="kind of insertion")
    positions: Annotated[tuple[q.Point, ...], ListOf(some="[[0, 0, 0]]")] = Field(description="centers [m]")
    order: ClassVar[int | None] = 0
    has_rows: ClassVar[bool] = True

    @property
    def points(self) -> tuple[Vector3, ...]:
        """Given centers [m]."""
        return self.positions

    def centers(self, radius: np.ndarray, existing: Spheres, random: np.random.Generator) -> np.ndarray:
        """The given centers (n, 3) [m]."""
        return np.array(self.positions, dtype=np.float64).reshape(-1, 3)


class FileSummary(Model):
    """Summary of the particles in a file; granflow fills it in when it reads the file."""

    count: q.ParticleCount = Field(description="number of particles read from the file")
    diameter_min: q.UnscaledLength = Field(description="smallest diameter [m]", examples=["3 mm"])
    diameter_max: q.UnscaledLength = Field(description="largest diameter [m]")
    speed_max: q.AnySpeed = Field(description="largest speed [m/s]", examples=["0.5 m/s"])
    angular_velocity_max: q.AngularVelocity = Field(description="largest angular velocity [rad/s]")
    overlap_max: q.Share = Field(
        description="largest overlap of two particles over the smaller radius", examples=[0.01]
    )
    overlap_rows: str = Field(
        "", description="lines or points of the file with the largest overlap", examples=["lines 12 and 40"]
    )


class FileInsertion(InsertionKind):
    """Particles from a table: CSV, or a VTU frame.

    Required columns: x, y, z and r (or diameter); optional: velocity, angular velocity, material. With a
    material column, the group gets the rows of its material.

    >>> gf.FileInsertion(file="start.csv")
    FileInsertion(file='start.csv')
    """

    kind: Literal["file"] = Field("file", description="kind of insertion")
    file: FileName = Field(
        description="CSV, text or VTU file; path relative to the folder of the scene",
        examples=["particles.csv"],
    )
    found: FileSummary | None = Field(None, description="summary of the file; granflow fills it in")
    order: ClassVar[int | None] = 1
    has_rows: ClassVar[bool] = True
    defines_sizes: ClassVar[bool] = True

    @property
    def source(self) -> str:
        """Path of the file with the particles."""
        return self.file

    @property
    def summary(self) -> FileSummary | None:
        """Summary of the file, once it is read."""
        return self.found

    def with_source(self, path: str) -> "FileInsertion":
        """See `InsertionKind`."""
        return self.model_copy(update={"file": path})


class PythonInsertion(InsertionKind):
    """No particles from the scene: a Python program adds them, with `simulation.particles.add` or from
    arrays.

    `count` of the group is the number of particles for which arrays and chunks are sized; more can be added.

    >>> sizes = gf.UniformSizes(min="3 mm", max="4 mm")
    >>> gf.Group(material="glass", count=5000, diameter=sizes, insert=gf.PythonInsertion()).insert.kind
    'python'
    """

    kind: Literal["python"] = Field("python", description="kind of insertion")
    from_program: ClassVar[bool] = True


# Kinds whose particles enter during the run


class TimedInsertion(InsertionKind):
    """Insertion during the run at a constant number or mass per second.

    It ends when the count or mass of the group is inserted, at `end` or with its `stages`, otherwise with the
    run. Sizes are in
    a fixed order, so that each size class has its fraction at any time. A kind is required to have
    `region_for`; the inserter (`particles.insertion`) calls `interval` and `delays`.

    one_way:  whether particles leave the region along the normal of a face only
    """

    one_way: ClassVar[bool] = False
    rate: q.Rate | None = Field(
        None, description="insertion rate, particles per second [1/s]", examples=["2000 1/s"]
    )
    mass_flow: q.MassFlow | None = Field(
        None, description="insertion rate, mass per second [kg/s]; instead of rate"
    )
    start: q.Time = Field(0.0, description="time of the first particle [s]", examples=[0])
    end: q.PositiveTime | None = optional(
        "end of the insertion [s]", "when all particles are inserted, or with the run", examples=["1 s"]
    )
    stages: StageNames | None = Field(
        None,
        description="stages with the insertion, from the start of the first of them to the end of the last",
        examples=[["fill"]],
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless exactly one of rate and mass_flow is given, the end is after the start, and
        either times or stages are given."""
        if self.rate is None and self.mass_flow is None:
            yield whole((), "has no insertion rate: give rate in 1/s, or mass_flow in kg/s")
        if self.rate is not None and self.mass_flow is not None:
            yield redundant("mass_flow", "rate")
        if self.stages is not None and (self.start or self.end is not None):
            yield redundant("stages", "start or end", keep="either the times or the stages")
        elif self.end is not None and self.end <= self.start:
            yield Fault(("end",), f"the insertion must end after its start at {self.start:g} s")

    @property
    def flow_key(self) -> str:
        """The key that gives the flow."""
        return "rate" if self.rate else "mass_flow"

    def interval(self, mean_mass: float) -> float:
        """Mean time [s] between two particles of a mean mass [kg]."""
        return 1.0 / self.rate if self.rate else mean_mass / (self.mass_flow or inf)

    def delays(self, mass: np.ndarray) -> np.ndarray:
        """Due times (n,) [s] after the start, for the masses (n,) [kg] in the order of insertion."""
        if self.rate is not None:
            return np.arange(len(mass)) / self.rate
        assert self.mass_flow is not None
        return np.asarray((np.cumsum(mass) - mass) / self.mass_flow)

    def region_for(self, radius: float, velocity: np.ndarray, gathered: float = 0.0) -> RegionSampler:
        """Region in which particles are inserted, see `InsertionKind`."""
        raise NotImplementedError


class RainInsertion(TimedInsertion):
    """Insertion at random free positions in a region, until the count, the mass, the end time or the end of
    the run is reached.

    Particles without a free position are queued and inserted first in the next batch, until the end. Walls
    are not considered.

    >>> region = gf.BoxRegion(box=gf.Box(min=[0, 0, 0.1], max=[0.1, 0.1, 0.2]))
    >>> gf.RainInsertion(region=region, mass_flow="2 t/h", end="1 s").end
    1.0
    """

    kind: Literal["rain"] = Field("rain", description="kind of insertion")
    region: Region = Field(description="region of the insertion: a box or a cylinder")
    place_key: ClassVar[str] = "region"

    def region_for(self, radius: float, velocity: np.ndarray, gathered: float = 0.0) -> RegionSampler:
        """The region as given."""
        return self.region.sampler


class InletInsertion(TimedInsertion):
    """Insertion through a face: particles appear directly downstream of it with the velocity of the group.

    The positions are random; particles without a free position are queued.

    >>> face = gf.DiscFace(disc={"center": [0, 0, 0.2], "normal": [0, 0, -1], "radius": "3 cm"})
    >>> gf.InletInsertion(face=face, rate="800 1/s").rate
    800.0
    """

    kind: Literal["inlet"] = Field("inlet", description="kind of insertion")
    face: Face = Field(description="face of the inlet: a rectangle or a disc")
    one_way: ClassVar[bool] = True
    place_key: ClassVar[str] = "face"

    def region_for(self, radius: float, velocity: np.ndarray, gathered: float = 0.0) -> RegionSampler:
        """The volume behind the face that particles cross in the time of one batch.

        The depth is one diameter plus the normal velocity times that time.
        """
        return self.face.behind(2.0 * radius + max(float(velocity @ self.face.normal), 0.0) * gathered)


# All kinds

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


def kinds(accepted: Callable[[type[InsertionKind]], bool]) -> list[str]:
    """Names of the kinds that satisfy a condition."""
    members: tuple[type[InsertionKind], ...] = get_args(get_args(Insertion)[0])
    return [each.model_fields["kind"].default for each in members if accepted(each)]
