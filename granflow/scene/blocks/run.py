"""Schema of the blocks `stages`, `run`, `numerics` and `damping`: how a run proceeds.

All defaults of numerical parameters are in `RunSettings` and `Numerics`; no physical parameter has one.
"""

from collections.abc import Iterator
from math import inf
from typing import Annotated, Literal

from pydantic import Field

from granflow.scene.blocks.deformation import Deformation
from granflow.scene.blocks.deletions import StageDeletion
from granflow.scene.blocks.gravity import Gravity
from granflow.scene.blocks.output import QuantityBound
from granflow.scene.blocks.settings import StageSetting
from granflow.schema import quantities as q
from granflow.schema.faults import Fault, missing, redundant, whole
from granflow.schema.model import ListOf, Model, Name, StageNames, Text, optional
from granflow.schema.quantities import Number

# Block `stages`: the parts of a run


class StageCondition(Model):
    """A condition that ends a stage: a column of timeseries.csv is above or below a value.

    It is evaluated at each row of the time series: wall forces and flow rates are means since the previous
    row.

    >>> gf.StageCondition(quantity="wall_pressure.lid", above="100 kPa").above
    100000.0
    """

    quantity: Text = Field(
        description="column of timeseries.csv, such as wall_force_z.lid, deleted_mass or mass_flow.outlet",
        examples=["wall_pressure.lid"],
    )
    above: QuantityBound | None = Field(
        None, description="the stage ends if the quantity is above this value", examples=["100 kPa"]
    )
    below: QuantityBound | None = Field(
        None, description="the stage ends if the quantity is below this value", examples=["5 kPa"]
    )
    hold: q.Time = Field(0.0, description="time during which all rows must satisfy the condition [s]")

    def is_met(self, value: float) -> bool:
        """Whether a value satisfies the condition; NaN does not."""
        return (self.above is not None and value > self.above) or (
            self.below is not None and value < self.below
        )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless exactly one bound is given."""
        if (self.above is None) == (self.below is None):
            found = "has no bound" if self.above is None else "has above and below"
            yield whole((), f"{found}; give exactly one of above and below")


class Stage(Model):
    """A part of the run that ends after a duration, on a quantity, or when the particles are at rest.

    Walls and motions may be limited to stages. At its start, gravity can change, and particles can be deleted
    or take other values of their properties.

    >>> gf.Stage(name="settle", kinetic_energy_below="1 nJ", max_duration="2 s").max_duration
    2.0
    """

    name: Name = Field(description="name of the stage")
    duration: q.PositiveTime | None = Field(None, description="duration [s]")
    kinetic_energy_below: q.Energy | None = Field(
        None,
        description=(
            "the stage ends at rest: the mean kinetic energy per particle is below this value [J], and the "
            "net force on the particles is below 20 % of their weight"
        ),
    )
    until: Annotated[tuple[StageCondition, ...], ListOf(one=True)] = Field(
        (),
        description=(
            "the stage ends if a quantity is above or below a value: one condition, or a list, any of which"
        ),
        examples=[{"quantity": "wall_pressure.lid", "above": "100 kPa"}],
    )
    min_duration: q.Time = Field(
        0.0,
        description="with kinetic_energy_below or until: shortest duration [s]",
        examples=["50 ms"],
    )
    max_duration: q.PositiveTime | None = Field(
        None, description="with kinetic_energy_below or until: longest duration [s]"
    )

    delete: Annotated[tuple[StageDeletion, ...], ListOf(one=True)] = Field(
        (),
        description=(
            "particles that are deleted at the start of the stage, before its walls appear, such as {region: "
            "{half_space: {point: [0, 0, 10 cm], normal: [0, 0, 1]}}}: one deletion, or a list"
        ),
        examples=[{"groups": ["beads"]}],
    )
    set_: Annotated[tuple[StageSetting, ...], ListOf(one=True)] = Field(
        (),
        alias="set",
        description=(
            "properties that particles take at the start of the stage, such as {temperature: 800 K, groups: "
            "[beads]}: one setting, or a list, applied in its order"
        ),
        examples=[{"temperature": "800 K"}],
    )
    gravity: Gravity | None = optional(
        "gravity from the start of this stage on [m/s2], a vector or what the key gravity of a scene accepts",
        "that of the stage before",
        examples=[[0, 0, -9.81]],
    )
    deformation: Deformation | None = optional(
        "deformation of the periodic box from the start of this stage on, in place of that of the domain",
        "that of the stage before",
        examples=[{"z": {"strain_rate": "-1 1/s"}}],
    )

    @property
    def longest(self) -> float:
        """Longest duration [s]; 0 without one."""
        return self.duration or self.max_duration or 0.0

    @property
    def has_condition(self) -> bool:
        """Whether the stage can end before its longest duration."""
        return self.kinetic_energy_below is not None or bool(self.until)

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the stage has either a duration, or a condition with a maximum duration."""
        condition = ""
        if self.kinetic_energy_below is not None:
            condition = "kinetic_energy_below"
        elif self.until:
            condition = "until"
        if self.duration is None and not condition:
            yield whole((), "has no end: give duration, or kinetic_energy_below or until with max_duration")
        elif self.duration is not None and condition:
            yield redundant("duration", condition, keep="one, or replace duration by max_duration")
        elif condition and self.max_duration is None:
            yield missing(("max_duration",), f"a stage with {condition} requires its maximum duration")
        elif self.duration is not None and self.max_duration is not None:
            yield Fault(("max_duration",), "it requires kinetic_energy_below or until; remove max_duration")
        longest = self.max_duration or inf
        for index, each in enumerate(self.until):
            if self.min_duration < longest < self.min_duration + each.hold:
                least = f"min_duration {self.min_duration:g} s and hold" if self.min_duration else "hold"
                reason = f"{least} must fit into max_duration, {longest:g} s"
                yield Fault(("until", index, "hold"), f"the condition can never end the stage: {reason}")
        if self.min_duration and not condition:
            yield Fault(("min_duration",), "it requires kinetic_energy_below or until; remove min_duration")
        elif self.max_duration is not None and self.min_duration >= self.max_duration:
            yield Fault(("min_duration",), f"it must be shorter than max_duration, {self.max_duration:g} s")


# Block `run`

TimeStep = Annotated[float | Literal["auto", "adaptive"], Number("time", above=0, words=("auto", "adaptive"))]
Precision = Literal["f64", "f32", "mixed"]
"""Floating-point precision of a run."""


class RunSettings(Model):
    """Duration, time step and precision of a run.

    An automatic time step follows from the stiffest contact at `velocity_max`, with the fractions in
    `numerics`.

    >>> gf.RunSettings(duration="50 ms", precision="mixed")
    RunSettings(duration=0.05, precision='mixed')
    """

    duration: q.PositiveTime | None = Field(None, description="simulated time [s]; only without stages")
    time_step: TimeStep = Field(
        "auto",
        description=(
            "time step [s]; auto: for the stiffest possible contact; adaptive: for the stiffest current one"
        ),
        examples=["2 us"],
    )
    velocity_max: q.Speed | None = optional(
        "largest expected impact velocity [m/s]", "estimate from drop heights and speeds"
    )
    precision: Precision = Field(
        "f64", description="floating-point precision: f64, f32, or mixed (positions in f64, all else in f32)"
    )


# Block `numerics`

TIME_STEP_FRACTION = 0.05
"""Default of `time_step_fraction`: 40 steps per collision of an elastic contact. The restitution is then
within 0.3 % of the given one for every contact model and every restitution from 0.5 up, with dashpots within
1.4 % at 0.05. Large scenes use up to 0.3 where a few tenths of a percent are enough: table in the
documentation, Accuracy."""
LARGEST_OVERLAP = 0.8
"""Largest overlap limit: with larger overlaps a center could cross a thin wall in one step
(`granflow.plan.limits`)."""
LARGEST_CHUNK = 1_000_000
"""Largest chunk size: larger chunks leave threads idle, and particle counts rounded up to chunks have 32
bits."""
LARGEST_ANGLE = 0.9
"""Largest unloading angle; stability of a dense bed requires 4 theta^2 < 4
(`granflow.plan.pair_case.PairCase.stable_step`)."""
Fraction = Annotated[float, Number(noun="a fraction", above=0, at_most=1)]
ACCURATE_OVERLAP = 0.1
"""Overlap over the smaller radius up to which the contact laws are used without a remark."""
ABORT_OVERLAP_AUTO = 0.5
"""Overlap over the smaller radius above which a run is aborted if no limit is given."""
OverlapLimit = Annotated[
    float | Literal["auto"],
    Number(noun="an overlap limit", above=0, at_most=LARGEST_OVERLAP, words=("auto",)),
]
ChunkSize = Annotated[
    int | Literal["auto"],
    Number(noun="a chunk size", at_least=1, at_most=LARGEST_CHUNK, whole=True, words=("auto",)),
]
UnloadingAngle = Annotated[float, Number(noun="an angle", above=0, at_most=LARGEST_ANGLE)]


class Numerics(Model):
    """Numerical parameters, all with defaults.

    They limit numerical errors and do not represent physical properties.

    >>> gf.Numerics(time_step_fraction=0.1)
    Numerics(time_step_fraction=0.1)
    """

    time_step_fraction: Fraction = Field(
        TIME_STEP_FRACTION,
        description=(
            "largest time step over the shortest loading or unloading time; with the default the restitution "
            "is within 0.02 % for zhou, for viscous models within 0.3 % from 0.5 on and 1.4 % at 0.05; 0.2 "
            "is within 0.3 % for zhou, 0.1 within 1 % for viscous models from 0.5 on"
        ),
    )
    rayleigh_fraction: Fraction = Field(0.2, description="largest time step over the Rayleigh time")
    skin: q.AutoLength = Field("auto", description="skin of the neighbor list [m], or auto")
    chunk_size: ChunkSize = Field(
        "auto",
        description="particles per chunk of the neighbor list, or auto: from their number and the threads",
    )
    max_overlap: OverlapLimit = Field(
        "auto",
        description=(
            "overlap over radius above which the run is aborted; auto: overlaps above 0.1 are reported in a "
            "warning, and the run is aborted above 0.5"
        ),
    )
    unloading_angle: UnloadingAngle = Field(
        0.5, description="theta in the bound theta^2 M/dt^2 on the unloading tangent (restitution near 0)"
    )

    @property
    def intended_overlap(self) -> float:
        """Overlap over the smaller radius up to which nothing is reported."""
        return ACCURATE_OVERLAP if self.max_overlap == "auto" else self.max_overlap

    @property
    def abort_overlap(self) -> float:
        """Overlap over the smaller radius above which the run is aborted."""
        return ABORT_OVERLAP_AUTO if self.max_overlap == "auto" else self.max_overlap


# Block `damping`: damping of all motion, for settling

LARGEST_CUNDALL = 0.95
"""Largest Cundall ratio: at 1 the force on a moving particle never accelerates it."""
CundallRatio = Annotated[float, Number(noun="a damping ratio", above=0, at_most=LARGEST_CUNDALL)]
DragRate = Annotated[float, Number("rate", noun="a drag rate", above=0)]


class Damping(Model):
    """Damping of the translation and rotation of all particles, to bring a packing to rest faster.

    Not part of the physics of a granular material: limit it to the stages in which particles settle.

        F_k = -cundall |F_k| sign(v_k) - drag m v_k      for each component k; the same for torques

    >>> gf.Damping(cundall=0.5, stages=["settle"])
    Damping(cundall=0.5, stages=('settle',))
    """

    cundall: CundallRatio | None = Field(
        None, description="ratio of the non-viscous damping force (Cundall) to the total force, by component"
    )
    drag: DragRate | None = Field(
        None,
        description="rate of a viscous background drag [1/s]: velocities decay as exp(-drag t)",
        examples=["5 1/s"],
    )
    stages: StageNames | None = optional("stages in which the damping acts", "all", examples=[["settle"]])

    def values(self, stage: str) -> tuple[float, float]:
        """Cundall ratio and drag rate [1/s] in a stage."""
        acts = self.stages is None or stage in self.stages
        return (self.cundall or 0.0, self.drag or 0.0) if acts else (0.0, 0.0)

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless one kind of damping is given."""
        if self.cundall is None and self.drag is None:
            yield whole((), "has no effect: give cundall, such as 0.5, or drag, such as 20 1/s")
