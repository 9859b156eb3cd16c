"""Schema of scene files as immutable models, in SI units after reading.

Physical parameters have no hidden defaults: a scene must give all of them. Numerical parameters have defaults, all
in `RunSettings` and `Numerics`.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, PrivateAttr

from granflow.geometry.periodic_box import AXES, ImageMotion, PeriodicBox
from granflow.scene.document import Document
from granflow.scene.schema.analysis import AnyMetric, FieldGrid
from granflow.scene.schema.contact import Contact
from granflow.scene.schema.fields import (
    AccelerationVector,
    AnyQuantity,
    Auto,
    Count,
    Direction,
    Energy,
    Fault,
    FileName,
    Flag,
    FlagOrNames,
    Model,
    Name,
    NotNegative,
    Number,
    PairName,
    Point,
    Positive,
    PositiveLength,
    PositiveTime,
    Seed,
    Speed,
    Text,
    Time,
    list_of,
    pair_list,
)
from granflow.scene.schema.groups import ClassSizes, Group, LogNormalSizes, NormalSizes, SizeClass, UniformSizes
from granflow.scene.schema.insertion import (
    Box,
    BoxRegion,
    CylinderRegion,
    CylinderShape,
    DiscFace,
    FileInsertion,
    InletInsertion,
    LatticeInsertion,
    PackInsertion,
    PositionsInsertion,
    RainInsertion,
    RectangleFace,
)
from granflow.scene.schema.materials import Material, MaterialPair, RestitutionFit
from granflow.scene.schema.outlets import BoxOutlet, HalfSpaceOutlet, Outlet
from granflow.scene.schema.walls import (
    AnyWall,
    Cone,
    Cylinder,
    Disc,
    FreeWallSpec,
    MeshWall,
    Plane,
    Rectangle,
    RotationSpec,
    ServoSpec,
    TranslationSpec,
    VibrationSpec,
    Wall,
)
from granflow.scene.writer import to_yaml

__all__ = [
    "AnyWall",
    "HalfSpaceOutlet",
    "Box",
    "BoxOutlet",
    "BoxRegion",
    "Checkpoints",
    "ClassSizes",
    "Cone",
    "Contact",
    "Cylinder",
    "CylinderRegion",
    "Disc",
    "DiscFace",
    "Domain",
    "ExpectationSpec",
    "FieldGrid",
    "FileInsertion",
    "FreeWallSpec",
    "Group",
    "InletInsertion",
    "LatticeInsertion",
    "PositionsInsertion",
    "LogNormalSizes",
    "Material",
    "MeshWall",
    "FlowMeterSpec",
    "NormalSizes",
    "Numerics",
    "Output",
    "PackInsertion",
    "MaterialPair",
    "Plane",
    "RainInsertion",
    "Rectangle",
    "RectangleFace",
    "RestitutionFit",
    "RotationSpec",
    "RunSettings",
    "Scene",
    "ServoSpec",
    "LeesEdwards",
    "SizeClass",
    "Stage",
    "TranslationSpec",
    "CylinderShape",
    "UniformSizes",
    "VibrationSpec",
    "Wall",
]

RIGHT_ANGLE_COSINE = 1e-6
"""Largest absolute cosine of an angle that is accepted as 90 deg."""

LARGEST_OVERLAP = 0.8
"""Largest overlap limit: with larger overlaps a center could cross a thin wall in one step (`granflow.plan.travel`)."""

Fraction = Annotated[float, Number(noun="a fraction", above=0, at_most=1)]
"""Fraction above 0 and at most 1."""

OverlapLimit = Annotated[float, Number(noun="an overlap limit", above=0, at_most=LARGEST_OVERLAP)]
"""Overlap over radius, above 0 and at most LARGEST_OVERLAP."""

AdaptiveOrFixedTime = Annotated[float | Auto | Literal["adaptive"], Number("time", above=0, words=("auto", "adaptive"))]
"""Time step [s], above 0, or auto or adaptive."""

ShearRate = Annotated[float, Number("rate", noun="a shear rate")]
"""Shear rate [1/s] of either sign."""

AutoLength = Annotated[float | Auto, Number("length", above=0, words=("auto",))]
"""Length [m], above 0, or auto."""

LARGEST_CHUNK = 1_000_000
"""Largest chunk size: larger chunks leave threads idle, and particle counts rounded up to chunks have 32 bits."""

LARGEST_ANGLE = 0.9
"""Largest unloading angle; stability of a dense bed requires 4 theta^2 < 4 (`granflow.plan.time_step.stable_step`)."""

UnloadingAngle = Annotated[float, Number(noun="an angle", above=0, at_most=LARGEST_ANGLE)]
"""Unloading angle, above 0 and at most LARGEST_ANGLE."""

ChunkSize = Annotated[
    int | Auto, Number(noun="a chunk size", at_least=1, at_most=LARGEST_CHUNK, whole=True, words=("auto",))
]
"""Number of particles per chunk, at most LARGEST_CHUNK, or auto."""


class LeesEdwards(Model):
    """Lees-Edwards boundary conditions: uniform shear without walls; the periodic images move along the flow axis.

        velocity of the image above = rate * width of the box along the gradient axis      [m/s]

    Walls, flow meters and insertion during the run are not supported.
    """

    flow: Literal["x", "y", "z"] = Field(description="flow axis, the direction of the velocity")
    gradient: Literal["x", "y", "z"] = Field(description="gradient axis, along which the velocity changes")
    rate: ShearRate = Field(description="shear rate, change of velocity per length [1/s]; may be negative")
    start: Time = Field(0.0, description="time at which the shear begins [s]")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the flow and gradient axes differ."""
        if self.flow == self.gradient:
            yield Fault(("gradient",), "flow is the same axis; give another axis")


class Domain(Box):
    """The simulated box: particles outside are deleted, wrapped (periodic axes) or followed, or end the run.

    Walls may extend beyond it.
    """

    periodic: Annotated[tuple[Literal["x", "y", "z"], ...], list_of(one=True)] = Field(
        (), description="axes with periodic boundary conditions, such as [x, y]"
    )
    lees_edwards: LeesEdwards | None = Field(
        None, description="uniform shear with Lees-Edwards boundary conditions; both axes must be periodic"
    )
    on_exit: Literal["delete", "error", "expand"] = Field(
        description="action if the center of a particle leaves the domain: delete (and count), error (abort the run), "
        "or expand (enlarge the domain)"
    )

    def periodic_box(self) -> PeriodicBox:
        """The periodic box of the domain at the start."""
        low, width, given = np.array(self.min), np.subtract(self.max, self.min), self.lees_edwards
        image_motion = None
        if given is not None:
            flow, gradient = AXES.index(given.flow), AXES.index(given.gradient)
            image_motion = ImageMotion(flow, gradient, given.rate * float(width[gradient]), given.start)
        return PeriodicBox(tuple(AXES.index(axis) for axis in self.periodic), low, width, image_motion)

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the volume is positive and the periodic axes are unique.

        Both axes of Lees-Edwards shear must be periodic.
        """
        yield from super().faults()
        for index, axis in enumerate(self.periodic):
            if axis in self.periodic[:index]:
                yield Fault(("periodic", index), "this axis is a duplicate; give each axis once")
        for key in ("flow", "gradient") if self.lees_edwards else ():
            if getattr(self.lees_edwards, key) not in self.periodic:
                yield Fault(
                    ("lees_edwards", key), "domain.periodic does not contain this axis; both axes must be periodic"
                )


class Stage(Model):
    """A part of the run that ends after a duration, or when the particles are at rest.

    Walls and motions may be limited to stages.
    """

    name: Name = Field(description="name of the stage")
    duration: PositiveTime | None = Field(None, description="duration [s]")
    kinetic_energy_below: Energy | None = Field(
        None, description="the stage ends if the mean kinetic energy per particle is below this value [J]"
    )
    max_duration: PositiveTime | None = Field(None, description="with kinetic_energy_below: longest duration [s]")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the stage has either a duration, or an energy with a maximum duration."""
        if self.duration is None and self.kinetic_energy_below is None:
            yield Fault((), "has no end: give duration, or kinetic_energy_below with max_duration", whole=True)
        elif self.duration is not None and self.kinetic_energy_below is not None:
            yield Fault(
                ("duration",), "kinetic_energy_below is given too: keep one, or replace duration by max_duration"
            )
        elif self.kinetic_energy_below is not None and self.max_duration is None:
            yield Fault(
                ("max_duration",), "is missing: the longest duration of a stage with kinetic_energy_below", whole=True
            )
        elif self.duration is not None and self.max_duration is not None:
            yield Fault(("max_duration",), "it requires kinetic_energy_below; remove max_duration")


class RunSettings(Model):
    """Duration, time step and precision of a run.

    An automatic time step follows from the stiffest contact at `velocity_max`, with the fractions in `numerics`.
    """

    duration: PositiveTime | None = Field(None, description="simulated time [s]; only without stages")
    time_step: AdaptiveOrFixedTime = Field(
        "auto",
        description="time step [s]; auto: for the stiffest possible contact; adaptive: for the stiffest current one",
    )
    velocity_max: Speed | None = Field(
        None, description="largest expected impact velocity [m/s]; default: estimate from drop heights and speeds"
    )
    precision: Literal["f64", "f32", "mixed"] = Field(
        "f64", description="floating-point precision: f64, f32, or mixed (positions in f64, all else in f32)"
    )


class Numerics(Model):
    """Numerical parameters, all with defaults.

    They limit numerical errors and do not represent physical properties.
    """

    time_step_fraction: Fraction = Field(
        0.05, description="largest time step over the shortest loading or unloading time"
    )
    rayleigh_fraction: Fraction = Field(0.2, description="largest time step over the Rayleigh time")
    skin: AutoLength = Field("auto", description="skin of the neighbor list [m], or auto")
    chunk_size: ChunkSize = Field("auto", description="particles per chunk of the neighbor list, or auto")
    max_overlap: OverlapLimit = Field(0.1, description="overlap over radius above which the run is aborted")
    unloading_angle: UnloadingAngle = Field(
        0.5, description="theta in the bound theta^2 M/dt^2 on the unloading tangent (restitution near 0)"
    )


class FlowMeterSpec(Model):
    """A flow meter: the mass through a plane, a disc or a rectangle, including particles deleted there.

    Net values: backward crossings count negative. Particles are tracked between the rows of timeseries.csv.
    """

    point: Point = Field(description="a point on the plane [m]: the center of the disc, or a corner of the rectangle")
    normal: Direction = Field(description="direction of positive flow; its length does not matter")
    radius: PositiveLength | None = Field(None, description="radius of the disc [m]; default: the whole plane")
    sides: Annotated[tuple[Point, Point], pair_list("two edge vectors")] | None = Field(
        None,
        description="the two edge vectors of the rectangle [m], perpendicular to each other and to the normal",
    )
    group_by: Literal["material", "group"] | None = Field(
        None, description="additional separate counts for each material or group"
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the area is a disc or a rectangle, with perpendicular sides and normal."""
        if self.sides is None:
            return
        if self.radius is not None:
            yield Fault(("sides",), "radius is given too: keep one of them")
        (a, b), lengths = self.sides, [math.hypot(*each) for each in (*self.sides, self.normal)]
        if not all(lengths):
            yield Fault(("sides",), "a side must not be the zero vector")
            return
        cosines = [
            abs(sum(x * y for x, y in zip(first, second, strict=True))) / (lengths[i] * lengths[j])
            for first, second, i, j in ((a, b, 0, 1), (a, self.normal, 0, 2), (b, self.normal, 1, 2))
        ]
        if max(cosines) > RIGHT_ANGLE_COSINE:
            yield Fault(("sides",), "the two sides must be perpendicular to each other and to the normal")


class Checkpoints(Model):
    """Interval and number of checkpoints for `granflow resume`; a run always writes one at its end.

    A checkpoint is due at simulated or wall-clock times, whichever is first.
    """

    wall_clock: PositiveTime = Field(600.0, description="wall-clock time between checkpoints [s]")
    interval: PositiveTime | None = Field(
        None, description="simulated time between additional checkpoints [s]; default: none"
    )
    keep: Count = Field(2, description="number of checkpoints that are kept, the newest ones")


class Output(Model):
    """Selection and intervals of the output.

    Times are simulated times [s]; the energy budget and wall forces cost time in each step.
    """

    interval: PositiveTime = Field(description="time between VTU frames [s]")
    timeseries_interval: PositiveTime = Field(
        default_factory=lambda given: given.get("interval"),  # None if the interval is invalid
        description="time between rows of timeseries.csv [s]; default: interval",
    )
    particles: Flag = Field(True, description="write particles_*.vtu")
    contacts: Flag = Field(False, description="write contacts_*.vtu")
    walls: Flag = Field(True, description="write walls_*.vtu")
    energy_budget: Flag = Field(False, description="compute the energy budget")
    wall_forces: FlagOrNames = Field(
        False,
        description="measure force, torque and pressure of the particles on all walls (true) or on those in a list",
    )
    flow_meters: dict[Name, FlowMeterSpec] = Field({}, description="flow meters by name")
    fields: dict[Name, FieldGrid] = Field({}, description="fields on grids by name, written as fields_NAME_*.vtu")
    metrics: dict[Name, AnyMetric] = Field({}, description="metrics of the bed by name, for timeseries.csv and expect")
    checkpoint: Checkpoints = Field(Checkpoints(), description="interval and number of checkpoints")


class ExpectationSpec(Model):
    """An expectation for the results of a run: one comparison of one quantity, in SI units.

    The names are those of the totals in timeseries.csv, and NAME.PART for flow meters, walls, metrics and groups.
    """

    quantity: Text = Field(description="quantity to compare, such as mass_flow.outlet")
    between: Annotated[tuple[AnyQuantity, AnyQuantity], pair_list("[smallest, largest]")] | None = Field(
        None, description="smallest and largest value"
    )
    below: AnyQuantity | None = Field(None, description="upper limit of the quantity")
    above: AnyQuantity | None = Field(None, description="lower limit of the quantity")
    equals: AnyQuantity | None = Field(None, description="expected value, within the tolerance")
    tolerance: NotNegative | None = Field(None, description="with equals: largest relative difference")
    any_scale: Flag = Field(False, description="true: evaluate at every scale of the scene; false: only at scale 1")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the expectation has exactly one comparison, with a tolerance for equals."""
        given = [key for key in ("between", "below", "above", "equals") if getattr(self, key) is not None]
        if len(given) != 1:
            found = f"has {' and '.join(given)}" if given else "has no comparison"
            yield Fault((), f"{found}; give exactly one of between, below, above and equals", whole=True)
            return
        if self.equals is not None and self.tolerance is None:
            yield Fault(("tolerance",), "is missing: the largest relative difference from equals", whole=True)
        if self.equals is None and self.tolerance is not None:
            yield Fault(("tolerance",), "it requires equals; remove tolerance")
        if self.between is not None and self.between[0] > self.between[1]:
            yield Fault(("between",), "the first value must be the smaller one")


class Scene(Model):
    """A complete scene, the input of a run, in SI units.

    Immutable. `load` reads it from a file; `text` writes it with all defaults. Methods `locate` and `where` give source
    positions for messages.
    """

    title: Text = Field(description="title of the scene, one line")
    description: Text | None = Field(None, description="description of the scene and its expected behavior")
    seed: Seed = Field(1, description="seed of all random numbers")
    scale: Positive = Field(
        1.0,
        description="factor of equipment lengths; particle counts scale with its cube, particle sizes do not change",
    )
    gravity: AccelerationVector = Field(description="gravity [m/s2], such as [0, 0, -9.81]")
    materials: dict[Name, Material] = Field(description="materials by name")
    pairs: dict[PairName, MaterialPair] = Field(
        description="contact properties of material pairs; each key is two names joined by a hyphen"
    )
    contact: Contact = Field(description="contact models, such as {normal: zhou, tangential: mindlin, rolling: none}")
    walls: dict[Name, AnyWall] = Field({}, description="walls by name")
    particles: dict[Name, Group] = Field(description="groups of particles by name")
    start_from: FileName | None = Field(
        None, description="directory of an earlier run; its last particles replace those of groups with the same name"
    )
    outlets: dict[Name, Outlet] = Field(
        {}, description="outlets by name: regions in which particles are deleted and counted"
    )
    domain: Domain = Field(description="the simulated box")
    stages: Annotated[tuple[Stage, ...], list_of()] = Field((), description="stages of the run, in order")
    run: RunSettings = Field(RunSettings(), description="duration, time step and precision")
    numerics: Numerics = Field(Numerics(), description="numerical parameters, all with defaults")
    output: Output = Field(description="selection and intervals of the output")
    expect: Annotated[tuple[ExpectationSpec, ...], list_of()] = Field(
        (), description="expectations for the results of the finished run"
    )

    _path: Path = PrivateAttr(Path())
    _folder: Path = PrivateAttr(Path())
    _document: Document | None = PrivateAttr(None)
    _remarks: tuple[str, ...] = PrivateAttr(())

    def __eq__(self, other: object) -> bool:
        """Equality of the values; the source of the scenes does not matter."""
        return isinstance(other, Scene) and self.__dict__ == other.__dict__

    __hash__ = None  # type: ignore[assignment]

    @property
    def path(self) -> Path:
        """The file of this scene; an empty path without a file."""
        return self._path

    @property
    def folder(self) -> Path:
        """The folder to which paths in the scene are relative; without a file, the working directory."""
        return self._folder

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks of the reader, one sentence each: a scale other than 1, overlaps in particle files."""
        return self._remarks

    @property
    def schedule(self) -> tuple[Stage, ...]:
        """The stages; for a scene without stages, one stage "run" of `run.duration`."""
        return self.stages or (Stage(name="run", duration=self.run.duration),)

    def flow_meter_parts(self, name: str) -> tuple[str, ...]:
        """Names of the materials or groups with separate counts in a flow meter; empty without `group_by`.

        Raises KeyError if the scene has no such flow meter.
        """
        group_by = self.output.flow_meters[name].group_by
        return () if group_by is None else tuple(self.materials if group_by == "material" else self.particles)

    @property
    def measured_walls(self) -> tuple[str, ...]:
        """Names of the walls with measured forces, in the order of the walls."""
        requested = self.output.wall_forces
        return tuple(name for name in self.walls if requested is True or (requested and name in requested))

    def pair(self, first: str, second: str) -> MaterialPair:
        """The pair of two materials in either order. Raises KeyError if the scene does not have it."""
        return self.pairs[self.pair_key(first, second)]

    def pair_key(self, first: str, second: str) -> str:
        """The key in `pairs` for two materials in either order; "second-first" if the scene does not have the pair."""
        key = f"{first}-{second}"
        return key if key in self.pairs else f"{second}-{first}"

    def text(self) -> str:
        """The resolved scene as YAML with all defaults, in SI units; the text loads to an equal scene."""
        return to_yaml(self.model_dump(by_alias=True, exclude_none=True))

    def is_given(self, *key_path: str | int) -> bool:
        """Whether the file or an override gives this key; False for values from a default or a preset.

        `key_path`: keys and list indices, such as ("stages", 0, "duration").
        """
        return self._document is not None and self._document.find(key_path) is not None

    def locate(self, *key_path: str | int) -> str:
        """Source position of the value of a key, as `file:line:column`, for error messages.

        For a missing key, that of the nearest existing parent key; without a file, the name of the scene file or
        "scene".
        """
        if self._document is None:
            return self.path.name or "scene"
        return str(self._document.value_position(key_path))

    def where(self, *key_path: str | int) -> str:
        """Source position of a key, as `file:line`; for a missing key, of the nearest existing parent key."""
        if self._document is None:
            return self.path.name or "scene"
        return self._document.where(key_path)
