"""The time step: from the stiffest phase of any contact the scene can have, or given and then checked."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from granflow.laws import theory
from granflow.laws.law import NormalLaw
from granflow.laws.material import PairMaterial, Solid
from granflow.plan.travel import STEP_SHARE

MOST_CONTACTS = 12
"""Equal spheres that one of them can touch at once."""

NORMAL_MODES, SLIDING_MODES = 4.0, 20.0
"""Square of the highest frequency of densely packed equal spheres, 12 contacts each, over K/M and Kt/M of a contact."""

STABLE_SHARE = 0.99
"""Largest step over the one at which the stiffest mode begins to grow."""

STEPS_OF_RESOLUTION = 1000
"""An overlap should be this many times what the precision resolves, so that its force is good to 0.15 %."""


@dataclass(frozen=True)
class Meeting:
    """The stiffest way in which two groups, or a group and a wall, can meet."""

    name: str
    pair: PairMaterial
    radius_eff: float
    mass_eff: float
    radius: float
    solid: Solid
    contact_count: int = MOST_CONTACTS
    """Contacts that a grain can have at once: as many as there are other grains and walls."""
    pair_key: str | None = None
    """Key of the material pair under `pairs`; None for a contact that bounds the time step but cannot occur."""


@dataclass(frozen=True)
class TimeStep:
    """A time step [s], what limits it, and what it can carry."""

    value: float
    limited_by: str
    stable_below: float
    stable_limit: str
    least_restitution: float
    """Smallest restitution that the unloading bound lets this step reach, at the largest velocity."""
    warnings: tuple[str, ...]


def choose_time_step(
    given: float | None,
    meetings: Sequence[Meeting],
    law: NormalLaw,
    velocity: float,
    safety: float,
    rayleigh_fraction: float,
) -> TimeStep:
    """Pick the step, or check the one given [s]; `velocity` is the fastest approach expected [m/s].

    Raises ValueError with one sentence where the given step is above the stable one.
    """
    resolved, name = min((safety * shortest_phase(meeting, law, velocity), meeting.name) for meeting in meetings)
    rayleigh, rayleigh_name = min((rayleigh_fraction * rayleigh_time(m.solid, m.radius), m.name) for m in meetings)
    stable, stable_name = min((stable_step(meeting, law, velocity), meeting.name) for meeting in meetings)
    travel = STEP_SHARE * min(meeting.radius for meeting in meetings) / velocity
    chosen = min(resolved, rayleigh, stable, travel)
    value = given if given is not None else chosen
    limited = f"{safety:g} of the shortest contact phase, {name} at {velocity:.3g} m/s"
    if chosen == rayleigh:
        limited = f"{rayleigh_fraction:g} of the Rayleigh time, {rayleigh_name}"
    if chosen == stable:
        limited = f"the largest stable step, {stable_name} at {velocity:.3g} m/s"
    if chosen == travel:
        limited = f"{STEP_SHARE:.2g} of the smallest radius in one step at {velocity:.3g} m/s"
    if given is not None:
        limited = "given in the scene"
    if value > stable:
        raise ValueError(
            f"is {value:.3g} s, above the stable {stable:.3g} s ({stable_name} at {velocity:.3g} m/s). "
            f"Lower it to {chosen:.2g} s or leave it out."
        )
    least, warnings = _restitution_reached(value, meetings, law, velocity)
    return TimeStep(value, limited, stable, stable_name, least, warnings)


def resolution_warning(meetings: Sequence[Meeting], velocity: float, precision: str, reach: float) -> tuple[str, ...]:
    """A sentence if the overlaps of a collision at `velocity` [m/s] fall under what the precision resolves.

    An overlap is a difference of lengths up to `reach` [m]: coordinates of the domain in f32, two radii in mixed.
    """
    if precision == "f64":
        return ()
    resolved = float(np.finfo(np.float32).eps) * reach
    overlaps = []
    for meeting in meetings:
        k = theory.hertz_stiffness(meeting.pair.modulus_eff, meeting.radius_eff)
        overlaps.append((float(theory.overlap_max(k, meeting.mass_eff, velocity)), meeting.name))
    smallest, name = min(overlaps)
    if smallest > STEPS_OF_RESOLUTION * resolved:
        return ()
    better = "mixed or f64" if precision == "f32" else "f64"
    return (
        f"{precision} resolves lengths to {resolved:.2g} m here, but {name} overlap by only {smallest:.2g} m at "
        f"{velocity:.3g} m/s: forces will be coarse. Use --precision {better}.",
    )


def shortest_phase(meeting: Meeting, law: NormalLaw, velocity: float) -> float:
    """Shorter of loading and unloading [s] at an approach velocity, unloading no faster than resolved."""
    loading, unloading = law.phase_durations(meeting.pair, meeting.radius_eff, meeting.mass_eff, velocity)
    return min(loading, max(unloading, law.unresolved_unloading * loading))


def stable_step(meeting: Meeting, law: NormalLaw, velocity: float) -> float:
    """Step [s] above which a grain held by others can gain energy, in the stiffest way it can be held.

    The leapfrog carries a mode x'' = -w^2 x - 2 b x' up to w^2 dt^2 + 8 b dt = 4, its viscous force being half a step
    late. Masses M on z contacts of stiffness K and viscosity c, and Kt = 4 G/E K across where there is friction, have

        w^2 = S (K + 2 Kt)/M,   2 b = S c/M,   S = min(z, 4)      where neighbours move against each other
        w^2 = S Kt/M,   S = min(2.5 z + 1, 20)                    where all turn the same way, and contacts slip

    at most; the second is the higher one with friction, and halves the step. A law that bounds its unloading has
    K dt^2 = theta^2 M there.
    """
    bodies = (meeting.pair, meeting.radius_eff, meeting.mass_eff, velocity)
    count, mass = min(meeting.contact_count, MOST_CONTACTS), meeting.mass_eff
    pushing, sliding = min(count, NORMAL_MODES), min(2.5 * count + 1.0, SLIDING_MODES)
    sticks = meeting.pair.friction > 0.0 or meeting.pair.rolling_friction > 0.0
    share = 4.0 * meeting.pair.shear_modulus_eff / meeting.pair.modulus_eff if sticks else 0.0
    lateral, viscosity = share * law.loading_stiffness(*bodies), law.viscosity(*bodies)
    room = 4.0 - pushing * law.unloading_angle**2
    steps = (
        _largest_step(law.stable_stiffness(*bodies) + 2.0 * lateral, viscosity, mass / pushing, 4.0),
        _largest_step(2.0 * lateral, viscosity, mass / pushing, room),
        _largest_step(lateral, 0.0, mass / sliding, 4.0),
    )
    return STABLE_SHARE * min(steps)


def _largest_step(stiffness: float, viscosity: float, mass: float, room: float) -> float:
    """The step [s] at which K/M dt^2 + 4 c/M dt comes to `room`."""
    if stiffness == viscosity == 0.0:
        return math.inf
    held = 0.25 * mass * room
    return 2.0 * held / (viscosity + math.sqrt(viscosity**2 + stiffness * held))


def rayleigh_time(solid: Solid, radius: float) -> float:
    """Rayleigh time pi R sqrt(rho/G) / (0.1631 nu + 0.8766) [s] of a sphere."""
    nu = solid.poisson_ratio
    return float(np.pi * radius * np.sqrt(solid.density / solid.shear_modulus) / (0.1631 * nu + 0.8766))


def _restitution_reached(
    step: float, meetings: Sequence[Meeting], law: NormalLaw, velocity: float
) -> tuple[float, tuple[str, ...]]:
    """Smallest restitution that the step can reach, and a sentence for each material pair that requires less.

    The sentence of a pair names its contact with the largest shortfall; contacts that cannot occur are left out.
    """
    if law.least_restitution is None:
        return 0.0, ()
    least, worst = 0.0, dict[str, tuple[float, float, str]]()
    for meeting in meetings:
        bodies = (meeting.pair, meeting.radius_eff, meeting.mass_eff, velocity)
        bound, required = law.least_restitution(*bodies, step), law.restitution(*bodies)
        least = max(least, bound)
        key = meeting.pair_key
        if key is not None and required < bound and (key not in worst or bound > worst[key][0]):
            worst[key] = (bound, required, meeting.name)
    return least, tuple(_shortfall(key, *found, velocity, step) for key, found in worst.items())


def _shortfall(pair: str, bound: float, required: float, contact: str, velocity: float, step: float) -> str:
    """One sentence on a material pair whose restitution the step cannot reach; at restitution 0 no step can."""
    remedy = 0.99 * step * required / bound
    advice = f" A run.time_step of {remedy:.3g} s can." if remedy > 0.0 else ""
    return (
        f"{pair}: the restitution at {velocity:.3g} m/s is {required:.3g}, but a time step of {step:.3g} s reaches "
        f"no less than {bound:.3g} ({contact}).{advice}"
    )
