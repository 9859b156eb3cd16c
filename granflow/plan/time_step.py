"""The time step: computed from the stiffest phase of all possible contacts, or given and checked.

`choose_time_step` is the rule, over all possible contacts (`PairCase`). An adaptive time step is the same
rule, applied to the current maximum impact velocity.

The maximum impact velocity is given in the scene, or estimated from free fall through the domain, initial
velocities, and the motions of walls and periodic images.
"""

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np

from granflow.contact.law import NormalLaw
from granflow.contact.material import Solid
from granflow.load import Scene
from granflow.plan.pair_case import PairCase
from granflow.plan.walls import PlannedWall, surface_speed
from granflow.scene.blocks.run import LARGEST_OVERLAP

DEFAULT_SPEED = 1.0
"""Impact velocity [m/s] of a scene without motion and gravity: contacts still require a time step."""


@dataclass(frozen=True)
class ImpactVelocity:
    """Maximum expected impact velocity [m/s] and its origin."""

    value: float
    source: str


def max_impact_velocity(scene: Scene, walls: Sequence[PlannedWall]) -> ImpactVelocity:
    """Read it from the scene, or estimate it from free fall through the domain, initial velocities and moving
    walls.

        v = max(v_fall, v_initial) + max(v_wall, v_image)

    If particles start faster than they fall and faster than walls and images move, two of them approach at
    2 v_initial. Without any motion and gravity, DEFAULT_SPEED. The result is finite and above 0.
    """
    given = scene.run.velocity_max
    if given is not None:
        key, line = "run.velocity_max", scene.where("run", "velocity_max")
        return ImpactVelocity(given, key if line == key else f"{key}, {line}")
    fall = free_fall(scene)
    initial = max((group.initial_speed for group in scene.particles.values()), default=0.0)
    images = scene.image_speed
    surface = max(surface_speed(scene, walls), images)
    if not max(fall, initial, surface) > 0.0:
        return ImpactVelocity(DEFAULT_SPEED, "assumed: no initial motion and no gravity")
    speed = fall
    source = f"a free fall through the domain, {fall:.3g} m/s"
    opposing = surface
    opposing_name = "the speed of the fastest wall"
    if images:
        boundary = "sheared" if scene.domain.lees_edwards else "deforming"
        opposing_name = f"the speed of the images across the {boundary} boundary"
    opposing_source = f"{opposing_name}, {surface:.3g} m/s"
    if initial > fall:
        speed = initial
        source = f"the speed of the fastest particle at the start, {initial:.3g} m/s"
        if initial > surface:
            opposing = initial
            opposing_source = "that of a particle in the opposite direction"
    parts = []
    if speed > 0.0:
        parts.append(source)
    if opposing > 0.0:
        parts.append(opposing_source)
    return ImpactVelocity(speed + opposing, f"estimated from {', plus '.join(parts)}")


def free_fall(scene: Scene) -> float:
    """Velocity [m/s] after free fall from one corner of the domain to the opposite one.

    v = sqrt(2 (|gx| Lx + |gy| Ly + |gz| Lz))        with the largest gravity of the run
    """
    size = np.subtract(scene.domain.max, scene.domain.min)
    return float(np.sqrt(2.0 * scene.drop_energy(size)))


STEP_SHARE = 1.0 - LARGEST_OVERLAP
"""Largest distance per step, of a particle and of a wall, over the smallest radius R.

Rectangles, discs and meshes are two-sided: a center that crosses one is pushed out on the wrong side. With
the overlap limit L, the centers of a run that has not stopped are at a distance g >= (1 - L) R from the wall.
One step with the share f for both takes a center at most 2 f R - g behind the wall, where its overlap over R
is

    1 - (2 f R - g) / R >= 2 - 2 f - L >= L        for f <= 1 - L

so that the overlap limit stops the run. Two particles pass each other only with more than 2 (2 - L) R in a
step. Stable steps are below the limit: v dt < 2 v/w = 2 d_max <= 0.2 R, for overlaps d_max up to the default
L = 0.1.
"""


@dataclass(frozen=True)
class TimeStep:
    """A time step [s], the reason for its value, and its limits.

    `stable_below` [s]: stability limit; `stable_limit`: name of the contact that determines it.
    """

    value: float
    limited_by: str
    stable_below: float
    stable_limit: str
    least_restitution: float
    """Smallest restitution that this step can reproduce at the maximum velocity, given the unloading
    limit."""
    is_given: bool
    """Whether the scene gives the step as a number."""
    warnings: tuple[str, ...]
    shortest_phase: float = math.inf
    """Shortest loading or unloading time [s], which `numerics.time_step_fraction` refers to."""

    def remedy(self, step: float) -> str:
        """Key and value that reduce the time step to `step` [s]: that of the step if the scene gives it as a
        number."""
        if self.is_given:
            return f"run.time_step: {step:.3g} s"
        return f"numerics.time_step_fraction: {step / self.shortest_phase:.3g}"


class UnstableStep(ValueError):
    """A given time step is above the stability limit, with the reason and the remedy as sentences."""

    def __init__(self, reason: str, remedy: str) -> None:
        super().__init__(f"{reason}. {remedy}")
        self.reason, self.remedy = reason, remedy


def choose_time_step(
    given: float | None,
    pair_cases: Sequence[PairCase],
    law: NormalLaw,
    velocity: float,
    fraction: float,
    rayleigh_fraction: float,
) -> TimeStep:
    """Compute the time step [s], or check the given one.

    The smallest of: `fraction` of the shortest loading or unloading time, `rayleigh_fraction` of the Rayleigh
    time, the stable step, and STEP_SHARE of the smallest radius at `velocity` [m/s], the maximum expected
    impact velocity. `given` [s]: only the stable step limits it.

    Raises UnstableStep if the given time step exceeds the stable time step.
    """
    resolved, name = min(
        (fraction * pair_case.shortest_phase(law, velocity), pair_case.name) for pair_case in pair_cases
    )
    rayleigh, rayleigh_name = min(
        (rayleigh_fraction * rayleigh_time(case.solid, case.radius), case.name) for case in pair_cases
    )
    stable, stable_name = min(
        (pair_case.stable_step(law, velocity), pair_case.name) for pair_case in pair_cases
    )
    travel = STEP_SHARE * min(pair_case.radius for pair_case in pair_cases) / velocity
    chosen = min(resolved, rayleigh, stable, travel)
    value = given if given is not None else chosen
    limited_by = f"{fraction:g} of the shortest loading or unloading time, {name} at {velocity:.3g} m/s"
    if chosen == rayleigh:
        limited_by = f"{rayleigh_fraction:g} of the Rayleigh time, {rayleigh_name}"
    if chosen == stable:
        limited_by = f"the largest stable step, {stable_name} at {velocity:.3g} m/s"
    if chosen == travel:
        limited_by = f"{STEP_SHARE:.2g} of the smallest radius in one step at {velocity:.3g} m/s"
    if given is not None:
        limited_by = "given in the scene"
    if value > stable:
        raise UnstableStep(
            f"is {value:.3g} s, above the stability limit {stable:.3g} s ({stable_name} at {velocity:.3g} "
            "m/s)",
            f"Lower it to {chosen:.2g} s or remove it.",
        )
    step = TimeStep(
        value=value,
        limited_by=limited_by,
        stable_below=stable,
        stable_limit=stable_name,
        least_restitution=0.0,
        is_given=given is not None,
        warnings=(),
        shortest_phase=resolved / fraction,
    )
    least, warnings = _restitution_reached(step, pair_cases, law, velocity)
    return replace(step, least_restitution=least, warnings=warnings)


def rayleigh_time(solid: Solid, radius: float) -> float:
    """Rayleigh time of a sphere [s]: about the time in which a surface wave crosses it.

        T = pi R sqrt(rho/G) / (0.1631 nu + 0.8766)

    `radius` R [m]; shear modulus G [Pa], density rho [kg/m3] and Poisson ratio nu are those of `solid`.
    """
    nu = solid.poisson_ratio
    return float(np.pi * radius * np.sqrt(solid.density / solid.shear_modulus) / (0.1631 * nu + 0.8766))


def _restitution_reached(
    step: TimeStep, pair_cases: Sequence[PairCase], law: NormalLaw, velocity: float
) -> tuple[float, tuple[str, ...]]:
    """Smallest restitution that the step can reproduce, and a sentence per material pair that requires less.

    `step` without both results, `velocity` [m/s]. The sentence of a pair names its contact with the largest
    difference; contacts that cannot occur are ignored. (0, ()) for a contact model that reproduces every
    restitution.
    """
    if not law.limits_restitution:
        return 0.0, ()
    least = 0.0
    worst = dict[str, tuple[float, float, str]]()
    for pair_case in pair_cases:
        pair_arguments = (*pair_case.dashpot_arguments, velocity)
        bound = law.least_restitution(*pair_arguments, step.value)
        required = law.restitution(*pair_arguments)
        least = max(least, bound)
        key = pair_case.pair_key
        if key is not None and required < bound and (key not in worst or bound > worst[key][0]):
            worst[key] = (bound, required, pair_case.name)
    return least, tuple(_shortfall(key, *found, velocity, step) for key, found in worst.items())


def _shortfall(
    pair: str, bound: float, required: float, contact: str, velocity: float, step: TimeStep
) -> str:
    """Sentences on a material pair whose restitution the step cannot reproduce; no step can for e(v) = 0."""
    remedy = step.remedy(0.99 * step.value * required / bound)
    if required == 0.0:
        return (
            f"{pair}: the restitution at {velocity:.3g} m/s is 0, and no time step reproduces 0 of a "
            f"restitution that depends on the velocity: the smallest is {bound:.3g} at a time step of "
            f"{step.value:.3g} s ({contact}). A constant restitution of 0 is exact."
        )
    return (
        f"{pair}: the restitution at {velocity:.3g} m/s is {required:.3g}, but a time step of "
        f"{step.value:.3g} s reproduces no restitution below {bound:.3g} ({contact}). Use {remedy}."
    )


STEPS_BETWEEN_UPDATES = 128
"""Number of steps between two updates of the maximum impact velocity; a contact lasts about as long."""
VELOCITY_MARGIN = 2.0
"""Factor applied to the current maximum impact velocity: a light particle hit by a much heavier one rebounds
at up to twice the velocity of the heavy one."""
LEVELS_PER_DOUBLING = 2
"""Velocity levels per factor of 2: a time step is about proportional to v^(-1/5), so that it is at most 7 %
below the ideal one."""
DOUBLINGS = (-24, 6)
"""Range of the table in powers of 2, relative to the planned maximum impact velocity."""


@dataclass(frozen=True)
class AdaptiveTimeStep:
    """Time steps [s] for impact velocities [m/s] in ascending order, and the lower limit of the velocity
    [m/s].

    `velocities` and `steps` have the same length; `steps` does not increase with the velocity.
    """

    velocities: tuple[float, ...]
    steps: tuple[float, ...]
    least_velocity: float

    def step_for(self, impact_velocity: float, gravity_gain: float) -> float:
        """Time step [s] for the current maximum impact velocity [m/s].

            v = max(VELOCITY_MARGIN * impact_velocity + STEPS_BETWEEN_UPDATES * gravity_gain, least_velocity)

        `gravity_gain` [m/s]: increase of the velocity by gravity in one such step. The result is the step of
        the next higher velocity in the table; above the table, that of the highest velocity.
        """
        velocity = max(
            VELOCITY_MARGIN * impact_velocity + STEPS_BETWEEN_UPDATES * gravity_gain, self.least_velocity
        )
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
    """The table for planned impact velocities up to `velocity` [m/s] and wall velocities up to `wall_speed`
    [m/s].

    `pair_cases`: possible contacts; `law`: normal contact model; `fraction`: of the shortest loading or
    unloading time; `rayleigh_fraction`: of the Rayleigh time. Each entry is `choose_time_step` at one
    velocity between 2^-24 and 2^6 times `velocity`. VELOCITY_MARGIN times `wall_speed` is the lower limit of
    the velocity for which a step is chosen.
    """
    low, high = (LEVELS_PER_DOUBLING * doublings for doublings in DOUBLINGS)
    velocities = tuple(velocity * 2.0 ** (level / LEVELS_PER_DOUBLING) for level in range(low, high + 1))
    steps = [
        choose_time_step(None, pair_cases, law, each, fraction, rayleigh_fraction).value
        for each in velocities
    ]
    return AdaptiveTimeStep(velocities, tuple(accumulate(steps, min)), VELOCITY_MARGIN * wall_speed)
