"""Adaptive time step: the rule of the fixed time step, applied to the present maximum impact velocity."""

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

from granflow.laws.law import NormalLaw
from granflow.plan.time_step import PairCase, choose_time_step

STEPS_BETWEEN_UPDATES = 128
"""Number of steps between two updates of the maximum impact velocity; a contact lasts about as long."""

VELOCITY_MARGIN = 2.0
"""Factor on the present maximum impact velocity: a particle hit by a much heavier one leaves twice as fast."""

LEVELS_PER_DOUBLING = 2
"""Velocity levels per factor of 2: a time step is proportional to about v^(-1/5), so it is at most 7 % too small."""

DOUBLINGS = (-24, 6)
"""Range of the table in powers of 2, relative to the planned maximum impact velocity."""


@dataclass(frozen=True)
class AdaptiveTimeStep:
    """Time steps [s] for impact velocities [m/s] in ascending order, and the lower limit of the velocity [m/s].

    `velocities` and `steps` have the same length; `steps` does not increase with the velocity.
    """

    velocities: tuple[float, ...]
    steps: tuple[float, ...]
    least_velocity: float

    def step_for(self, impact_velocity: float, gravity_gain: float) -> float:
        """Time step [s] for the present maximum impact velocity [m/s].

            v = max(VELOCITY_MARGIN * impact_velocity + STEPS_BETWEEN_UPDATES * gravity_gain, least_velocity)

        `gravity_gain` [m/s]: increase of the velocity by gravity in one such step. The result is the step of the next
        higher velocity in the table; above the table, that of the highest velocity.
        """
        velocity = max(VELOCITY_MARGIN * impact_velocity + STEPS_BETWEEN_UPDATES * gravity_gain, self.least_velocity)
        return self.steps[min(bisect_left(self.velocities, velocity), len(self.steps) - 1)]

    @property
    def longest(self) -> float:
        """Time step [s] for a scene in which only the walls move."""
        return self.step_for(0.0, 0.0)


def adaptive_time_step_for(
    pair_cases: Sequence[PairCase],
    law: NormalLaw,
    velocity: float,
    wall_speed: float,
    fraction: float,
    rayleigh_fraction: float,
) -> AdaptiveTimeStep:
    """The table for planned impact velocities up to `velocity` [m/s] and wall velocities up to `wall_speed` [m/s].

    `pair_cases`: possible contacts; `law`: normal contact model; `fraction`: of the shortest contact phase;
    `rayleigh_fraction`: of the Rayleigh time. Each entry is `choose_time_step` at one velocity between 2^-24 and 2^6
    times `velocity`. VELOCITY_MARGIN times `wall_speed` is the lower limit of the velocity for which a step is chosen.
    """
    low, high = (LEVELS_PER_DOUBLING * doublings for doublings in DOUBLINGS)
    velocities = tuple(velocity * 2.0 ** (level / LEVELS_PER_DOUBLING) for level in range(low, high + 1))
    steps = [choose_time_step(None, pair_cases, law, each, fraction, rayleigh_fraction).value for each in velocities]
    return AdaptiveTimeStep(velocities, tuple(accumulate(steps, min)), VELOCITY_MARGIN * wall_speed)
