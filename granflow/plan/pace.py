"""A time step that follows the scene: the plan's own rule, at the fastest approach there is now."""

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

from granflow.laws.law import NormalLaw
from granflow.plan.time_step import Meeting, choose_time_step

STEPS_BETWEEN_LOOKS = 128
"""Steps after which the fastest approach is looked for anew; a contact lasts about as long."""

MARGIN = 2.0
"""Velocity reckoned with over the fastest approach seen: what is hit by something heavier leaves twice as fast."""

RUNGS_TO_DOUBLE = 2
"""Velocities in the table for every doubling: a step goes with about v^(-1/5), so that it is 7 % too small at most."""

DOUBLINGS = (-24, 6)
"""The table reaches from so many doublings below the fastest approach planned for to so many above."""


@dataclass(frozen=True)
class Pace:
    """Time steps [s] for approach velocities [m/s] from small to large, and the velocity reckoned with at least."""

    velocities: tuple[float, ...]
    steps: tuple[float, ...]
    least_velocity: float

    def step_for(self, approach: float, gain: float) -> float:
        """Step [s] for the fastest approach seen [m/s]; `gain` is what gravity may add in one such step [m/s]."""
        velocity = max(MARGIN * approach + STEPS_BETWEEN_LOOKS * gain, self.least_velocity)
        return self.steps[min(bisect_left(self.velocities, velocity), len(self.steps) - 1)]

    @property
    def longest(self) -> float:
        """The step [s] for a scene in which nothing but the walls moves."""
        return self.step_for(0.0, 0.0)


def pace_of(
    meetings: Sequence[Meeting],
    law: NormalLaw,
    velocity: float,
    wall_speed: float,
    safety: float,
    rayleigh_fraction: float,
) -> Pace:
    """The table for a scene whose plan reckons with approaches up to `velocity` and walls up to `wall_speed` [m/s]."""
    low, high = (RUNGS_TO_DOUBLE * doublings for doublings in DOUBLINGS)
    velocities = tuple(velocity * 2.0 ** (rung / RUNGS_TO_DOUBLE) for rung in range(low, high + 1))
    steps = [choose_time_step(None, meetings, law, each, safety, rayleigh_fraction).value for each in velocities]
    return Pace(velocities, tuple(accumulate(steps, min)), MARGIN * wall_speed)
