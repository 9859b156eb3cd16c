"""Stages of a run in numeric form: their durations and conditions, and the damping that acts in them.

A stage ends after its longest duration, or earlier when a condition is met, so that its times are known
only during the run. Checks before a run use the times of `nominal_times`, or those of `always`, during
which every motion is possible.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf

import numpy as np

from granflow.errors import SceneError
from granflow.load import Scene
from granflow.scene.blocks.run import Damping, Stage


@dataclass(frozen=True)
class StageCondition:
    """A condition that ends a stage: a quantity is above or below a value, one of which is None, during
    `hold` [s]."""

    quantity: str
    above: float | None
    below: float | None
    hold: float

    def is_met(self, value: float) -> bool:
        """Whether a value satisfies the condition; NaN does not."""
        return (self.above is not None and value > self.above) or (
            self.below is not None and value < self.below
        )


@dataclass(frozen=True)
class PlannedStage:
    """One stage of a run: name, and longest duration [s].

    `kinetic_energy_below` [J]: mean kinetic energy per particle at which it ends earlier, or None. `key`,
    `source`: key of the duration in the scene, and its position in the file. `until`: conditions, any of
    which ends the stage, from its `shortest` duration [s] on.
    """

    name: str
    longest: float
    kinetic_energy_below: float | None
    key: str
    source: str
    until: tuple[StageCondition, ...] = ()
    shortest: float = 0.0

    @property
    def has_condition(self) -> bool:
        """Whether the stage can end before its longest duration."""
        return self.kinetic_energy_below is not None or bool(self.until)


def planned_stages(scene: Scene) -> tuple[PlannedStage, ...]:
    """The stages in the order of the scene; a scene without stages has one, "run"."""
    stages = []
    for index, stage in enumerate(scene.schedule):
        key = "max_duration" if stage.duration is None else "duration"
        path = ("stages", index, key) if scene.stages else ("run", "duration")
        stages.append(
            PlannedStage(
                name=stage.name,
                longest=stage.longest,
                kinetic_energy_below=stage.kinetic_energy_below,
                key=".".join(map(str, path)),
                source=scene.locate(*path),
                until=tuple(
                    StageCondition(each.quantity, each.above, each.below, each.hold) for each in stage.until
                ),
                shortest=stage.min_duration,
            )
        )
    return tuple(stages)


# Times of the stages.

StageTimes = Mapping[str, tuple[float, float]]
"""Start and end [s] of each stage that has begun; the end is infinite during the stage."""


def always(schedule: Sequence[Stage]) -> StageTimes:
    """Times of stages that never end: all motions of the scene are possible at any time."""
    return {stage.name: (0.0, inf) for stage in schedule}


def nominal_times(stages: Sequence[PlannedStage]) -> StageTimes:
    """Start and end [s] of each stage if all stages take their longest duration."""
    edges = np.concatenate([[0.0], np.cumsum([stage.longest for stage in stages])]).tolist()
    return {stage.name: span for stage, span in zip(stages, pairwise(edges), strict=True)}


# Damping of all motion, for settling.


@dataclass(frozen=True)
class PlannedDamping:
    """Damping of all particles: Cundall ratio, drag rate [1/s], and the stages in which it acts (None:
    all)."""

    cundall: float
    drag: float
    stages: tuple[str, ...] | None

    def values(self, stage: str) -> tuple[float, float]:
        """Cundall ratio and drag rate [1/s] in a stage."""
        acts = self.stages is None or stage in self.stages
        return (self.cundall, self.drag) if acts else (0.0, 0.0)


def planned_damping(damping: Damping | None) -> PlannedDamping | None:
    """The damping of the scene; None without."""
    if damping is None:
        return None
    return PlannedDamping(damping.cundall or 0.0, damping.drag or 0.0, damping.stages)


RESOLVED_DECAY = 0.2
"""Largest product of drag rate and time step g dt: the decay rate of the scheme is wrong by (g dt)^2 / 12 =
0.3 %."""


def refuse_unresolved_drag(scene: Scene, time_step: float) -> None:
    """Raise SceneError if a time step [s] does not resolve the decay of the velocities."""
    damping = planned_damping(scene.damping)
    if damping is not None and damping.drag * time_step > RESOLVED_DECAY:
        raise SceneError(
            f"{scene.locate('damping', 'drag')}: damping.drag is {damping.drag:g} 1/s, but the time step of "
            f"{time_step:.3g} s does not resolve the decay; give at most {RESOLVED_DECAY / time_step:.2g} "
            "1/s, or a smaller time step."
        )
