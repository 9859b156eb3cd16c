"""A time step that follows the scene: the plan's own rule, at the fastest approach there is now."""

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

from granflow.laws.law import NormalLaw
from granflow.plan.time_step import PairCase, choose_time_step

STEPS_BETWEEN_UPDATES = 128
"""Steps after which the fastest approach is looked for anew; a contact lasts about as long."""

VELOCITY_MARGIN = 2.0
"""Velocity reckoned with over the fastest approach seen: what is hit by something heavier leaves twice as fast."""

LEVELS_PER_DOUBLING = 2
"""Velocities in the table for every doubling: a step goes with about v^(-1/5), so that it is 7 % too small at most."""

DOUBLINGS = (-24, 6)
"""The table reaches from so many doublings below the fastest approach planned for to so many above."""


@dataclass(frozen=True)
class AdaptiveTimeStep:
    """Time steps [s] for approach velocities [m/s] from small to large, and the velocity reckoned with at least."""

    velocities: tuple[float, ...]
    steps: tuple[float, ...]
    least_velocity: float

    def step_for(self, impact_velocity: float, gravity_gain: float) -> float:
        """Step [s] for the fastest approach seen [m/s].

        `gravity_gain` is what gravity may add in one such step [m/s].
        """
        velocity = max(VELOCITY_MARGIN * impact_velocity + STEPS_BETWEEN_UPDATES * gravity_gain, self.least_velocity)
        return self.steps[min(bisect_left(self.velocities, velocity), len(self.steps) - 1)]

    @property
    def longest(self) -> float:
        """The step [s] for a scene in which nothing but the walls moves."""
        return self.step_for(0.0, 0.0)


def adaptive_time_step_for(
    pair_cases: Sequence[PairCase],
    law: NormalLaw,
    velocity: float,
    wall_speed: float,
    fraction: float,
    rayleigh_fraction: float,
) -> AdaptiveTimeStep:
    """The table for a scene whose plan reckons with approaches up to `velocity` and walls up to `wall_speed` [m/s]."""
    low, high = (LEVELS_PER_DOUBLING * doublings for doublings in DOUBLINGS)
    velocities = tuple(velocity * 2.0 ** (level / LEVELS_PER_DOUBLING) for level in range(low, high + 1))
    steps = [choose_time_step(None, pair_cases, law, each, fraction, rayleigh_fraction).value for each in velocities]
    return AdaptiveTimeStep(velocities, tuple(accumulate(steps, min)), VELOCITY_MARGIN * wall_speed)
