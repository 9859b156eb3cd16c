"""Adaptive time step: the rule of the fixed time step, applied to the current maximum impact velocity."""

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

from granflow.contact.normal_law import NormalLaw
from granflow.plan.time_step import PairCase, choose_time_step

STEPS_BETWEEN_UPDATES = 128
"""Number of steps between two updates of the maximum impact velocity; a contact lasts about as long."""

VELOCITY_MARGIN = 2.0
"""Factor applied to the current maximum impact velocity: a light particle hit by a much heavier one rebounds at up to
twice the velocity of the heavy one."""

LEVELS_PER_DOUBLING = 2
"""Velocity levels per factor of 2: a time step is about proportional to v^(-1/5), so that it is at most 7 % below the
ideal one."""

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
        """Time step [s] for the current maximum impact velocity [m/s].

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

    `pair_cases`: possible contacts; `law`: normal contact model; `fraction`: of the shortest loading or unloading time;
    `rayleigh_fraction`: of the Rayleigh time. Each entry is `choose_time_step` at one velocity between 2^-24 and 2^6
    times `velocity`. VELOCITY_MARGIN times `wall_speed` is the lower limit of the velocity for which a step is chosen.
    """
    low, high = (LEVELS_PER_DOUBLING * doublings for doublings in DOUBLINGS)
    velocities = tuple(velocity * 2.0 ** (level / LEVELS_PER_DOUBLING) for level in range(low, high + 1))
    steps = [choose_time_step(None, pair_cases, law, each, fraction, rayleigh_fraction).value for each in velocities]
    return AdaptiveTimeStep(velocities, tuple(accumulate(steps, min)), VELOCITY_MARGIN * wall_speed)
