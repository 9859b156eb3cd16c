"""Cause and remedies of an overlap above the limit: an impact, a static load, a pressing wall, or cohesion."""

from collections.abc import Callable

from granflow.engine.abort_bodies import ContactPair
from granflow.plan.forecast.advice import modulus_factor, modulus_text, required_moduli, without_modulus
from granflow.plan.forecast.contact import ContactForces, TouchingPair, attraction_share, impact_overlap, static_overlap
from granflow.plan.forecast.overlaps import ENOUGH
from granflow.plan.forecast.pressures import BedPressure
from granflow.plan.plan import Plan
from granflow.scene.schema.run import LARGEST_OVERLAP

AT_REST_SHARE = 0.01
"""Kinetic over total energy of a contact below which its load is static: an impact that ends there reaches at most
1.004 times the limit, because 1 - (limit / dmax)^2.5 of its energy is kinetic at the limit."""

COHESIVE_SHARE = 0.5
"""Attraction over repulsion above which cohesion is the cause of an overlap."""

GROWTH = 1.25
"""Overlap assumed for a static load over the observed one: the run stopped while the load increased."""

SUDDEN = 2.0
"""Largest force of a weight over its static force: the bed is still settling when the run stops."""

EXPLAINED = 0.5
"""Smallest share of an overlap that the largest static overlap under the weight and the walls must explain."""

TOLERANCE = 1.01
"""Velocity over the planned one up to which an impact is as planned: it follows from the energy of a coarse step."""

SPEED_MARGIN = 1.2
"""Factor from an observed velocity to the recommended `velocity_max`."""


def overlap_cause(pair: ContactPair, plan: Plan) -> str:
    """Sentences on the cause of an overlap above the limit, with the remedies that follow from the contact model.

    The moduli are those at which the same impact or load stays below the limit, see `forecast.advice`. For static loads
    the largest of the observed force, the weight of all particles and the walls counts: the load may still increase.
    """
    touching = TouchingPair(
        "", (pair.first.material, pair.second.material), plan.pair(pair.first.material, pair.second.material),
        pair.radius, pair.radius_eff, pair.mass_eff,
    )  # fmt: skip
    attraction = attraction_share(plan.laws, touching, pair.overlap * pair.radius)
    if attraction > COHESIVE_SHARE:
        return _cohesion(touching, plan, attraction)
    if pair.approach**2 < AT_REST_SHARE * pair.impact_velocity**2:
        return f"The contact is almost at rest: {_at_rest(touching, plan, pair)}"
    reached = impact_overlap(plan.laws, touching, pair.impact_velocity)
    if reached < pair.overlap:
        alone = f"An impact at {pair.impact_velocity:.3g} m/s alone reaches {reached:.3g} of the radius"
        return f"{alone}, other particles or walls press as well: {_at_rest(touching, plan, pair)}"
    return _impact(touching, plan, pair.impact_velocity, reached)


def _impact(touching: TouchingPair, plan: Plan, velocity: float, largest: float) -> str:
    """Cause and remedy of an impact at `velocity` [m/s], which reaches the overlap over radius `largest`."""
    remedy = _moduli(touching, plan, lambda pair: impact_overlap(plan.laws, pair, velocity, plan.max_overlap), largest)
    cause = f"This overlap results from an impact at {velocity:.3g} m/s, which reaches {largest:.3g} of the radius"
    if velocity <= TOLERANCE * plan.velocity_max:
        return f"{cause}: {remedy}."
    planned = f"set run.velocity_max to {SPEED_MARGIN * velocity:.3g} m/s for the time step"
    return (
        f"{cause}; it is above the planned {plan.velocity_max:.3g} m/s: {planned} and {remedy}, or find the cause of "
        "this velocity."
    )


def _at_rest(touching: TouchingPair, plan: Plan, contact: ContactPair) -> str:
    """Cause and remedy of an overlap that no impact of the two bodies alone explains.

    A static load, if the weight or a wall explains at least EXPLAINED of the overlap; otherwise other particles that
    press in motion, such as those that land on a bed or slide down in a drum.
    """
    weight = BedPressure("weight", "", contact.weight, max(3.0 * plan.particle_capacity, 1.0))
    by_weight = SUDDEN * weight.largest_force(2.0 * touching.radius)
    by_wall = max((each.force for each in plan.forecasts if each.cause == "wall"), default=0.0)
    observed = ContactForces(plan.laws, touching, 1.0).total(GROWTH * contact.overlap * touching.radius, 0.0)
    force = max(observed, by_weight, by_wall)
    expected = static_overlap(plan.laws, touching, force)
    remedy = _moduli(touching, plan, lambda pair: static_overlap(plan.laws, pair, force), expected)
    if plan.laws.normal.softer_after_slow_onset:
        remedy = f"{_fixed_stiffness(plan)}, or {remedy}"
    by_load = static_overlap(plan.laws, touching, max(by_weight, by_wall))
    if by_load < EXPLAINED * contact.overlap:
        return _moving_load(remedy, by_load)
    pressing = by_wall > by_weight
    names = ", ".join(f"walls.{each.name}" for each in plan.controlled_motions if each.force > 0.0)
    cause = f"the static pressure of {names}" if pressing else "a static load, such as the weight above these particles"
    less = ", lower the pressure" if pressing else ""
    return f"its cause is {cause}: {remedy}{less}."


def _fixed_stiffness(plan: Plan) -> str:
    """Instruction that makes all contacts as stiff as those at the planned velocity."""
    return (
        f"set contact.normal.stiffness to {{reference_velocity: {plan.velocity_max:.3g} m/s}}, because a contact that "
        "begins slowly gets a soft spring with onset"
    )


def _moving_load(remedy: str, by_load: float) -> str:
    """Cause and remedy of an overlap that weight and walls do not explain; `by_load`: their overlap over the radius."""
    return (
        f"weight and walls at rest explain only an overlap of {by_load:.2g} of the radius, so its cause is not a "
        "static load, but other particles or a moving wall that press on this contact, as particles do that land on a "
        f"bed: lower their velocity, or {remedy}."
    )


def _cohesion(touching: TouchingPair, plan: Plan, attraction: float) -> str:
    """Cause and remedy of an overlap by cohesion; `attraction`: over the repulsion.

    The remedy also covers impacts at the planned velocity, which the attraction makes deeper.
    """
    assert plan.laws.cohesion is not None

    def overlap(pair: TouchingPair) -> float:
        return max(static_overlap(plan.laws, pair, 0.0), impact_overlap(plan.laws, pair, plan.velocity_max))

    remedy = _moduli(touching, plan, overlap, overlap(touching))
    keys = " or ".join(plan.laws.cohesion.constant_names)
    return f"Its cause is cohesion, {attraction:.2g} of the repulsion: lower {keys}, or {remedy}."


def _moduli(touching: TouchingPair, plan: Plan, overlap: Callable[[TouchingPair], float], expected: float) -> str:
    """Instruction that sets the moduli at which the overlap is below the limit, or raises the limit if that is allowed.

    `expected`: overlap over the radius without a change.
    """
    factor = modulus_factor(touching, overlap, plan.max_overlap)
    if factor is None:
        first = without_modulus(touching, overlap)
    else:
        first = modulus_text(required_moduli(plan.solids, touching.materials, max(factor, 1.0)))
    needed = float(f"{ENOUGH * max(expected, plan.max_overlap) + 0.005:.2f}")
    accept = f", or set numerics.max_overlap to {needed:g} if such overlaps are intended"
    return first + (accept if needed <= LARGEST_OVERLAP else "")
