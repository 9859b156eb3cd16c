"""The scene file as frozen models: what a user may write, in SI once read.

Physics has no hidden defaults: what the outcome rests on must be written. What only the computation rests on has
defaults, all of them in `RunSettings` and `Numerics`.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, PrivateAttr

from granflow.scene.analysis import AnyMetric, FieldGrid
from granflow.scene.document import Document
from granflow.scene.fields import (
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
from granflow.scene.groups import (
    ClassSizes,
    Group,
    LogNormalSizes,
    NormalSizes,
    SizeClass,
    UniformSizes,
)
from granflow.scene.insertion_schema import (
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
from granflow.scene.materials import (
    Contact,
    Material,
    MaterialPair,
    RestitutionFit,
)
from granflow.scene.outlets import BoxOutlet, HalfSpaceOutlet, Outlet
from granflow.scene.wall_schema import (
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
"""Largest cosine of an angle that counts as a right one."""

LARGEST_OVERLAP = 0.8
"""Largest overlap limit: beyond it a center could cross a thin wall between two steps (`granflow.plan.travel`)."""

Fraction = Annotated[float, Number(noun="a fraction", above=0, at_most=1)]
OverlapLimit = Annotated[float, Number(noun="an overlap limit", above=0, at_most=LARGEST_OVERLAP)]
AdaptiveOrFixedTime = Annotated[float | Auto | Literal["adaptive"], Number("time", above=0, words=("auto", "adaptive"))]
ShearRate = Annotated[float, Number("rate", noun="a rate of shear")]
AutoLength = Annotated[float | Auto, Number("length", above=0, words=("auto",))]
LARGEST_CHUNK = 1_000_000
"""Larger chunks give other threads nothing to do; and numbers of particles, rounded up to chunks, have 32 bits."""

LARGEST_ANGLE = 0.9
"""The bound on unloading must be stable: 4 theta^2 < 4 in a dense bed (`granflow.plan.time_step.stable_step`)."""

UnloadingAngle = Annotated[float, Number(noun="an angle", above=0, at_most=LARGEST_ANGLE)]
ChunkSize = Annotated[
    int | Auto, Number(noun="a chunk size", at_least=1, at_most=LARGEST_CHUNK, whole=True, words=("auto",))
]


class LeesEdwards(Model):
    """The images of the box across two periodic faces move along them: uniform shear without walls (Lees-Edwards)."""

    flow: Literal["x", "y", "z"] = Field(description="axis of the velocity")
    gradient: Literal["x", "y", "z"] = Field(description="axis across which the velocity changes")
    rate: ShearRate = Field(description="velocity over height [1/s]; negative: the other way")
    start: Time = Field(0.0, description="time from which on the images move [s]")

    def faults(self) -> Iterator[Fault]:
        """Two axes."""
        if self.flow == self.gradient:
            yield Fault(("gradient",), "flow is the same axis; give another")


class Domain(Box):
    """The box that is simulated."""

    periodic: Annotated[tuple[Literal["x", "y", "z"], ...], list_of(one=True)] = Field(
        (), description="axes along which opposite faces are one, such as [x, y]"
    )
    lees_edwards: LeesEdwards | None = Field(None, description="uniform shear through two periodic axes")
    on_exit: Literal["delete", "error", "expand"] = Field(
        description="what becomes of particles whose center leaves the domain: delete (and count), error, or expand: "
        "nothing, the domain grows with them"
    )

    def faults(self) -> Iterator[Fault]:
        """A box with room in it, each axis once."""
        yield from super().faults()
        for index, axis in enumerate(self.periodic):
            if axis in self.periodic[:index]:
                yield Fault(("periodic", index), "it is there already; name each axis once")
        for key in ("flow", "gradient") if self.lees_edwards else ():
            if getattr(self.lees_edwards, key) not in self.periodic:
                yield Fault(
                    ("lees_edwards", key), "domain.periodic does not have it; both axes of a shear are periodic"
                )


class Stage(Model):
    """A part of the run: it ends after a duration, or when the particles have come to rest."""

    name: Name = Field(description="name of the stage")
    duration: PositiveTime | None = Field(None, description="how long it lasts [s]")
    kinetic_energy_below: Energy | None = Field(
        None, description="ends when the mean kinetic energy per particle is below this [J]"
    )
    max_duration: PositiveTime | None = Field(None, description="with kinetic_energy_below: longest duration [s]")

    def faults(self) -> Iterator[Fault]:
        """A duration, or an energy with a longest duration."""
        if self.duration is None and self.kinetic_energy_below is None:
            yield Fault((), "has no end: give duration, or kinetic_energy_below with max_duration", whole=True)
        elif self.duration is not None and self.kinetic_energy_below is not None:
            yield Fault(
                ("duration",), "kinetic_energy_below is given too: keep one, or write max_duration for duration"
            )
        elif self.kinetic_energy_below is not None and self.max_duration is None:
            yield Fault(
                ("max_duration",), "is missing: the longest duration of a stage that waits for rest", whole=True
            )
        elif self.duration is not None and self.max_duration is not None:
            yield Fault(("max_duration",), "it goes only with kinetic_energy_below; leave it out")


class RunSettings(Model):
    """How long and how finely to compute."""

    duration: PositiveTime | None = Field(None, description="simulated time [s]; only without stages")
    time_step: AdaptiveOrFixedTime = Field(
        "auto",
        description="time step [s]; auto: from the stiffest contact; adaptive: from the stiffest contact there is now",
    )
    velocity_max: Speed | None = Field(
        None, description="fastest approach expected [m/s]; left out: estimated from drop heights and speeds"
    )
    precision: Literal["f64", "f32", "mixed"] = Field(
        "f64", description="f64, f32, or mixed (positions in f64, the rest in f32)"
    )


class Numerics(Model):
    """What the computation rests on; every value has a default."""

    time_step_fraction: Fraction = Field(0.05, description="time step over the shortest phase of a contact")
    rayleigh_fraction: Fraction = Field(0.2, description="largest time step over the Rayleigh time")
    skin: AutoLength = Field("auto", description="how much further than contact neighbors are listed [m], or auto")
    chunk_size: ChunkSize = Field("auto", description="particles per chunk of the contact list, or auto")
    max_overlap: OverlapLimit = Field(0.1, description="overlap over radius above which the run is aborted")
    unloading_angle: UnloadingAngle = Field(
        0.5, description="theta in the bound theta^2 M/dt^2 on the unloading tangent (restitution near 0)"
    )


class FlowMeterSpec(Model):
    """A flow meter: the mass through a plane, or a disc or rectangle of it, with what was deleted there."""

    point: Point = Field(
        description="a point on the plane; the center, if there is a radius, a corner, if there are sides [m]"
    )
    normal: Direction = Field(description="direction counted as forward; its length does not matter")
    radius: PositiveLength | None = Field(None, description="radius around the point [m]; left out: the whole plane")
    sides: Annotated[tuple[Point, Point], pair_list("two edge vectors")] | None = Field(
        None, description="the two edges of a rectangle from the point, perpendicular to each other and the normal [m]"
    )
    group_by: Literal["material", "group"] | None = Field(
        None, description="count every material, or group of particles, by itself too"
    )

    def faults(self) -> Iterator[Fault]:
        """A disc or a rectangle; sides at right angles to each other and to the normal."""
        if self.sides is None:
            return
        if self.radius is not None:
            yield Fault(("sides",), "radius is given too: keep one of them")
        (a, b), lengths = self.sides, [math.hypot(*each) for each in (*self.sides, self.normal)]
        if not all(lengths):
            yield Fault(("sides",), "a side must have a length above 0")
            return
        cosines = [
            abs(sum(x * y for x, y in zip(first, second, strict=True))) / (lengths[i] * lengths[j])
            for first, second, i, j in ((a, b, 0, 1), (a, self.normal, 0, 2), (b, self.normal, 1, 2))
        ]
        if max(cosines) > RIGHT_ANGLE_COSINE:
            yield Fault(("sides",), "the two sides must be perpendicular to each other and to the normal")


class Checkpoints(Model):
    """How often the whole state is written, from which `granflow resume` goes on; at the end it always is."""

    wall_clock: PositiveTime = Field(600.0, description="wall clock between checkpoints [s]")
    interval: PositiveTime | None = Field(None, description="simulated time between checkpoints [s], besides those")
    keep: Count = Field(2, description="how many are kept, the newest ones")


class Output(Model):
    """What is written, and how often."""

    interval: PositiveTime = Field(description="time between VTU frames [s]")
    timeseries_interval: PositiveTime = Field(
        default_factory=lambda given: given.get("interval"),  # none where the interval itself is wrong
        description="time between rows of timeseries.csv [s]; left out: interval",
    )
    particles: Flag = Field(True, description="write particles_*.vtu")
    contacts: Flag = Field(False, description="write contacts_*.vtu")
    walls: Flag = Field(True, description="write walls_*.vtu")
    energy_budget: Flag = Field(False, description="keep the energy ledger")
    wall_forces: FlagOrNames = Field(
        False, description="measure force, torque and pressure of the grains on the walls: all, or those of a list"
    )
    flow_meters: dict[Name, FlowMeterSpec] = Field({}, description="flow meters by name")
    fields: dict[Name, FieldGrid] = Field({}, description="fields on grids by name, written as fields_NAME_*.vtu")
    metrics: dict[Name, AnyMetric] = Field({}, description="indices of the bed by name, for timeseries.csv and expect")
    checkpoint: Checkpoints = Field(Checkpoints(), description="how often the whole state is written")


class ExpectationSpec(Model):
    """What the finished run is held to: one comparison of one quantity, in SI."""

    quantity: Text = Field(description="what is compared, such as mass_flow.outlet")
    between: Annotated[tuple[AnyQuantity, AnyQuantity], pair_list("[smallest, largest]")] | None = Field(
        None, description="smallest and largest value"
    )
    below: AnyQuantity | None = Field(None, description="it must be below this")
    above: AnyQuantity | None = Field(None, description="it must be above this")
    equals: AnyQuantity | None = Field(None, description="it must equal this, within the tolerance")
    tolerance: NotNegative | None = Field(None, description="with equals: largest relative difference")
    any_scale: Flag = Field(False, description="judge it whatever the size of the scene, not only at scale 1")

    def faults(self) -> Iterator[Fault]:
        """Exactly one comparison, with a tolerance for equals."""
        given = [key for key in ("between", "below", "above", "equals") if getattr(self, key) is not None]
        if len(given) != 1:
            found = f"has {' and '.join(given)}" if given else "has no comparison"
            yield Fault((), f"{found}; give exactly one of between, below, above and equals", whole=True)
            return
        if self.equals is not None and self.tolerance is None:
            yield Fault(("tolerance",), "is missing: the largest relative difference from equals", whole=True)
        if self.equals is None and self.tolerance is not None:
            yield Fault(("tolerance",), "it goes only with equals; leave it out")
        if self.between is not None and self.between[0] > self.between[1]:
            yield Fault(("between",), "the smaller value comes first")


class Scene(Model):
    """Everything a run rests on, in SI units."""

    title: Text = Field(description="one line that says what this is")
    description: Text | None = Field(None, description="what should be seen")
    seed: Seed = Field(1, description="seed of everything random")
    scale: Positive = Field(
        1.0, description="makes equipment so many times larger, and particles more by its cube; they stay as they are"
    )
    gravity: AccelerationVector = Field(description="gravity [m/s2], such as [0, 0, -9.81]")
    materials: dict[Name, Material] = Field(description="materials by name")
    pairs: dict[PairName, MaterialPair] = Field(
        description="pairs of materials, each key two names with a dash between"
    )
    contact: Contact = Field(description="the laws of contact, {normal: zhou, tangential: mindlin, rolling: none}")
    walls: dict[Name, AnyWall] = Field({}, description="walls by name")
    particles: dict[Name, Group] = Field(description="groups of particles by name")
    start_from: FileName | None = Field(
        None, description="directory of an earlier run, whose last particles stand in for those of groups named alike"
    )
    outlets: dict[Name, Outlet] = Field({}, description="where particles are deleted and counted, by name")
    domain: Domain = Field(description="the box that is simulated")
    stages: Annotated[tuple[Stage, ...], list_of()] = Field((), description="parts of the run, in order")
    run: RunSettings = Field(RunSettings(), description="how long and how finely to compute")
    numerics: Numerics = Field(Numerics(), description="settings of the computation, all with defaults")
    output: Output = Field(description="what is written, and how often")
    expect: Annotated[tuple[ExpectationSpec, ...], list_of()] = Field(
        (), description="what the finished run is held to"
    )

    _path: Path = PrivateAttr(Path())
    _folder: Path = PrivateAttr(Path())
    _document: Document | None = PrivateAttr(None)
    _remarks: tuple[str, ...] = PrivateAttr(())

    def __eq__(self, other: object) -> bool:
        """Scenes are equal that say the same, wherever they were read."""
        return isinstance(other, Scene) and self.__dict__ == other.__dict__

    __hash__ = None  # type: ignore[assignment]

    @property
    def path(self) -> Path:
        """The file this scene was read from; an empty path if there is none."""
        return self._path

    @property
    def folder(self) -> Path:
        """The folder that paths in the scene count from; where the scene comes from no file, the present one."""
        return self._folder

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was made of the scene as it was written, a sentence each: another size, overlaps in files."""
        return self._remarks

    @property
    def schedule(self) -> tuple[Stage, ...]:
        """The stages; where the scene has none, one stage "run" that lasts `run.duration`."""
        return self.stages or (Stage(name="run", duration=self.run.duration),)

    def flow_meter_parts(self, name: str) -> tuple[str, ...]:
        """Names of the materials, or groups, that a flow meter counts by themselves."""
        group_by = self.output.flow_meters[name].group_by
        return () if group_by is None else tuple(self.materials if group_by == "material" else self.particles)

    @property
    def measured_walls(self) -> tuple[str, ...]:
        """Names of the walls whose loads are measured, in the order of the walls."""
        requested = self.output.wall_forces
        return tuple(name for name in self.walls if requested is True or (requested and name in requested))

    def pair(self, first: str, second: str) -> MaterialPair:
        """The pair of two materials, named in either order. Raises KeyError where the scene has none."""
        return self.pairs[self.pair_key(first, second)]

    def pair_key(self, first: str, second: str) -> str:
        """The key under `pairs` for two materials, named in either order."""
        key = f"{first}-{second}"
        return key if key in self.pairs else f"{second}-{first}"

    def text(self) -> str:
        """The scene as it is run, as YAML with every default filled in; it loads again to an equal scene."""
        return to_yaml(self.model_dump(by_alias=True, exclude_none=True))

    def is_given(self, *key_path: str | int) -> bool:
        """Whether the file, or an override, says this key itself; False for what a default or a preset filled in."""
        return self._document is not None and self._document.find(key_path) is not None

    def locate(self, *key_path: str | int) -> str:
        """Where the value of that key stood, as `file:line:column`, for the head of a problem."""
        if self._document is None:
            return self.path.name or "scene"
        return str(self._document.value_position(key_path))

    def where(self, *key_path: str | int) -> str:
        """Where that key stood, as `file:line`; for what the file left out, where the part around it stood."""
        if self._document is None:
            return self.path.name or "scene"
        return self._document.where(key_path)
