"""Messages of aborts: the particle or the bodies in contact, the time, the likely cause, the remedies."""

from collections.abc import Callable
from dataclasses import dataclass
from math import hypot, isfinite

import numpy as np

from granflow.engine.codes import (
    ABORT_BOX,
    ABORT_DISPLACEMENT,
    ABORT_FORCE,
    ABORT_NOT_FINITE,
    ABORT_OVERLAP,
    ABORT_REASONS,
    ABORT_WALL,
    FORCE_REASONS,
)
from granflow.engine.host import copy_to_host
from granflow.engine.state import State, mobility_mask
from granflow.engine.statistics import candidate_pairs
from granflow.engine.wall_dynamics import controlled_displacements, controlled_velocities
from granflow.engine.walls import walls_of
from granflow.geometry.periodic_box import AXES
from granflow.plan.limits import COARSEST, remedy, share_of, spacing_at
from granflow.plan.overlaps import (
    LIMIT_MARGIN,
    BedPressure,
    ContactForces,
    attraction_share,
    impact_overlap,
    impact_velocity,
    modulus_factor,
    modulus_text,
    required_moduli,
    static_overlap,
    without_modulus,
)
from granflow.plan.pair_case import PairCase
from granflow.plan.plan import Plan
from granflow.scene.blocks.motions import poses_at
from granflow.scene.blocks.run import LARGEST_OVERLAP
from granflow.visible_text import alternatives

AT_REST = 1e-9
"""Speed [m/s] below which messages report `at rest`."""


@dataclass(frozen=True)
class Body:
    """A particle or a wall: name, material, velocity [m/s] at the contact, and position [m] of a particle."""

    name: str
    material: str
    velocity: tuple[float, float, float]
    position: tuple[float, float, float] | None

    @property
    def speed(self) -> float:
        """Speed [m/s]."""
        return hypot(*self.velocity)

    def __str__(self) -> str:
        """Description for messages: particle 7 (glass, 3.2 m/s)."""
        moving = f"{self.speed:.3g} m/s" if isfinite(self.speed) else "velocity not a number"
        return f"{self.name} ({self.material}, {'at rest' if self.speed < AT_REST else moving})"


@dataclass(frozen=True)
class ContactPair:
    """A contact at the time of the abort.

    overlap:          over the smaller radius
    approach:         [m/s] along the normal, negative if the bodies separate
    impact_velocity:  impact velocity [m/s] with the energy of this overlap and approach
    stable_step:      time step [s] that is stable for it
    case:             its bodies, with the radii [m] and masses [kg]
    weight:           pressure [Pa] of the weight of all particles on the section of the present bed
    """

    first: Body
    second: Body
    overlap: float
    approach: float
    impact_velocity: float
    stable_step: float
    case: PairCase
    weight: float


@dataclass(frozen=True)
class WallChange:
    """Insertion, or change of walls, during a run.

    `stage`: name of the stage; `appeared`: names of the new walls.
    """

    stage: str
    appeared: tuple[str, ...]


@dataclass(frozen=True)
class Diagnosis:
    """Cause of an aborted run.

    reason:     one of the values of ABORT_REASONS
    body:       the particle with the smallest id above the limit, or the wall
    pair:       the contact with the largest overlap, None without a contact
    time_step:  [s]
    """

    reason: str
    body: Body
    pair: ContactPair | None
    time_step: float
    begun: bool
    """True if a step was taken; false if only the initial forces were computed."""
    change: WallChange | None
    """The change after which the forces were computed; None if a step was taken since then, or before the
    first one."""


# The message of an abort.


def abort_message(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    """Message for an abort: body or bodies in contact, time, exceeded limit, likely cause and remedies.

    `time`: simulated time [s] of the abort.
    """
    message = f"Stopped: {_REASONS[diagnosis.reason](diagnosis, plan, time)}"
    if diagnosis.begun and diagnosis.reason in FORCE_REASONS and plan.external_forces:
        names = ", ".join(each.name for each in plan.external_forces)
        noun = "forces" if len(plan.external_forces) > 1 else "force"
        return f"{message} The {noun} from Python may also be the cause: check the values of {names}."
    return message


OVERLAP_MARGIN = 1.4
"""Limit of the overlap that lets an aborted run continue, over the overlap at the abort: it still
increases."""


def permitted_change(diagnosis: Diagnosis, plan: Plan) -> str:
    """KEY=VALUE for a run that continues before the abort: a limit above the overlap; empty if none is known.

    For an initial overlap and an impact, the limit is that of the message.
    """
    if diagnosis.reason != "overlap" or diagnosis.pair is None or diagnosis.pair.overlap >= LARGEST_OVERLAP:
        return ""
    if not diagnosis.begun:
        needed = _limit_for_initial(diagnosis.pair.overlap)
        return f"numerics.max_overlap={needed:g}" if needed <= LARGEST_OVERLAP else ""
    reached = impact_overlap(plan.laws, diagnosis.pair.case, diagnosis.pair.impact_velocity)
    needed = max(OVERLAP_MARGIN * diagnosis.pair.overlap, _limit_above(reached, plan))
    return f"numerics.max_overlap={min(needed, LARGEST_OVERLAP):.2g}"


LIMIT_RATIO = 1.25
"""Next limit over a reported overlap: so precisely the largest overlap of a run is known."""


def next_limit(diagnosis: Diagnosis, plan: Plan) -> float | None:
    """Overlap limit with which a run goes on after its overlap limit was exceeded; None if it must not.

    It goes on if the scene gives no limit, with the overlap of contacts that have formed during its steps:
    not with particles that overlap when they or walls appear, nor with a time step that is too long.
    """
    numerics = plan.scene.numerics
    pair = diagnosis.pair
    if numerics.max_overlap != "auto" or diagnosis.reason != "overlap" or pair is None:
        return None
    if not diagnosis.begun or diagnosis.change is not None or pair.overlap >= numerics.abort_overlap:
        return None
    if plan.step.is_given and diagnosis.time_step > pair.stable_step:
        return None
    return min(LIMIT_RATIO * max(pair.overlap, numerics.intended_overlap), numerics.abort_overlap)


def overlap_warning(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    """Sentences on an overlap with which a run goes on, see `next_limit`: the contact, its cause and remedy.

    `time`: simulated time [s].
    """
    pair = diagnosis.pair
    assert pair is not None
    numerics = plan.scene.numerics
    return (
        f"{_overlapping(pair, time)}, more than {numerics.intended_overlap:g}: contact forces become less "
        f"accurate. {_relative_motion(pair)} {overlap_cause(pair, plan)} The run goes on, and stops above "
        f"{numerics.abort_overlap:g}."
    )


def _overlapping(pair: ContactPair, time: float) -> str:
    """Clause on the contact and its overlap at `time` [s]."""
    return (
        f"{pair.first} at {time:.6g} s overlaps with {pair.second} by {pair.overlap:.3g} times the smaller "
        "radius"
    )


def _limit_for_initial(overlap: float) -> float:
    """Smallest limit with two decimals that permits an initial overlap over the radius."""
    return float(f"{overlap + 0.005:.2f}")


def _overlap(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    """Overlap above `numerics.max_overlap`."""
    pair = diagnosis.pair
    numerics = plan.scene.numerics
    limit = numerics.intended_overlap
    if pair is None:
        return f"{diagnosis.body} at {time:.6g} s overlaps by more than {limit:g} of its radius."
    if pair.overlap >= numerics.abort_overlap:
        limit = numerics.abort_overlap
    key = "numerics.max_overlap"
    named = f"{limit:g} ({key}: auto)" if numerics.max_overlap == "auto" else f"{key} {limit:g}"
    description = f"{_overlapping(pair, time)}, more than {named}."
    if not diagnosis.begun:
        needed = _limit_for_initial(pair.overlap)
        accept = f", or set numerics.max_overlap to {needed:g} if this is intended"
        return (
            f"{description} They overlap initially: move them "
            f"apart{accept if needed <= LARGEST_OVERLAP else ''}."
        )
    if diagnosis.change is not None and pair.second.position is None:
        cause = _appearance_cause(diagnosis.change, pair.second.name, plan)
        if cause:
            return f"{description} {cause}"
    description = f"{description} {_relative_motion(pair)}"
    if diagnosis.time_step > pair.stable_step and plan.step.is_given:
        return f"{description} {_step_or_speed(pair, plan, diagnosis.time_step)}"
    return f"{description} {overlap_cause(pair, plan)}"


def _relative_motion(pair: ContactPair) -> str:
    """Sentence on the approach velocity; empty if it is not finite."""
    if not isfinite(pair.approach):
        return ""
    return f"They {'approach' if pair.approach >= 0.0 else 'separate'} at {abs(pair.approach):.3g} m/s."


def _step_or_speed(pair: ContactPair, plan: Plan, time_step: float) -> str | None:
    """The cause if it is a time step that is too long, or an impact above the planned `velocity_max`."""
    velocity_remedy = f"set run.velocity_max to {SPEED_MARGIN * pair.impact_velocity:.3g} m/s"
    if time_step > pair.stable_step:
        description = (
            f"The time step {time_step:.3g} s exceeds the stable step {pair.stable_step:.3g} s of this "
            "contact"
        )
        return f"{description}: lower run.time_step, or remove it and {velocity_remedy}."
    if pair.impact_velocity > plan.impact_velocity.value:
        description = (
            f"This overlap results from an impact at {pair.impact_velocity:.3g} m/s, above the planned "
            f"{plan.impact_velocity.value:.3g} m/s"
        )
        return f"{description}: {velocity_remedy}, or find the cause of this velocity."
    return None


def _appearance_cause(change: WallChange, wall: str, plan: Plan) -> str:
    """Sentence on a particle where a wall appears; empty for another wall.

    `wall`: its name as in messages.
    """
    name = next((name for name in change.appeared if wall == f"wall {name}"), None)
    if name is None:
        return ""
    planned = next(each for each in plan.walls if each.name == name)
    keys = ([] if planned.spec.stages is None else [f"walls.{name}.stages"]) + (
        [f"walls.{name}.appears_at"] if planned.spec.start_time > 0.0 else []
    )
    remedy = f" Change {' or '.join(keys)}, or let" if keys else " Let"
    return (
        f"Wall {name} appears at this time, in stage {change.stage}, where the "
        f"particle is.{remedy} it appear where there are no particles."
    )


def _force(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    """Contact force above the range of the sums."""
    description = (
        f"the contact force on {diagnosis.body} at {time:.6g} s is above {plan.sum_units.largest_force:.3g} "
        "N, more than 30 times the force at an overlap of "
        f"{plan.scene.numerics.intended_overlap:g} of the radius."
    )
    if diagnosis.pair is None:
        return _advice(
            diagnosis.time_step, f"{description} Likely cause: a velocity far above run.velocity_max"
        )
    cause = _step_or_speed(diagnosis.pair, plan, diagnosis.time_step) or _advice(
        diagnosis.time_step, "Likely cause: a viscous or cohesive force far above the elastic force"
    )
    return f"{description} {_relative_motion(diagnosis.pair)} {cause}"


def _displacement(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    """Displacement in one step above the limit."""
    description = _too_far(diagnosis, plan, time, plan.travel_limit)
    if diagnosis.pair is None:
        speed = diagnosis.body.speed
        if not isfinite(speed):
            return f"{description} Likely cause: a force that is too large or not a number."
        return f"{description} {remedy(plan.step.is_given, speed, SPEED_MARGIN * speed, plan.travel_limit)}"
    cause = _step_or_speed(diagnosis.pair, plan, diagnosis.time_step) or _advice(
        diagnosis.time_step, "Likely cause: the force of this overlap"
    )
    return f"{description} {_overlap_before(diagnosis.pair)} {_relative_motion(diagnosis.pair)} {cause}"


def _overlap_before(pair: ContactPair) -> str:
    """Sentence on the overlap one step earlier."""
    return (
        f"One step earlier {pair.first} and {pair.second} overlapped by {pair.overlap:.3g} times the smaller "
        "radius."
    )


def _advice(time_step: float, cause: str) -> str:
    """Cause and remedies if the time step is stable and the impact is not above `velocity_max`."""
    return (
        f"{cause}. Lower run.time_step (now {time_step:.3g} s), or check for particles that overlap "
        "initially."
    )


def _not_finite(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    """Position that is not a number."""
    description = f"the position of {diagnosis.body} at {time:.6g} s is not a number."
    if diagnosis.pair is None:
        better = "" if plan.scene.run.precision == "f64" else ", or use precision f64"
        return f"{description} It has no contacts: check its initial velocity and angular_velocity{better}."
    cause = _step_or_speed(diagnosis.pair, plan, diagnosis.time_step) or _advice(
        diagnosis.time_step, "Likely cause: the time step is too long for this contact"
    )
    return f"{description} {_overlap_before(diagnosis.pair)} {cause}"


def _left_domain(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    """Particle outside a domain with `on_exit: error`, or one that a wall has moved there."""
    where = plan.scene.where("domain", "on_exit")
    reason = f"domain.on_exit is error ({where})"
    remedy = "Close the gap in the walls, enlarge the domain, or set domain.on_exit to delete."
    if plan.scene.domain.on_exit != "error":
        reason = "it moves with a wall (particles.NAME.fixed), which cannot lose it"
        remedy = "Enlarge the domain, or shorten the path of the wall."
    name, _, rest = str(diagnosis.body).partition(" (")
    x, y, z = diagnosis.body.position or (0.0, 0.0, 0.0)
    return (
        f"{name} at {time:.6g} s is outside the domain, and {reason}; "
        f"it is at [{x:.4g}, {y:.4g}, {z:.4g}] m ({rest}. {remedy}"
    )


def _far(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    """Position that the precision does not resolve."""
    precision = plan.scene.run.precision
    position = diagnosis.body.position or (0.0, 0.0, 0.0)
    farthest = max(map(abs, position))
    better = " Use --precision mixed, or" if precision == "f32" else " Use"
    return (
        f"{diagnosis.body} at {time:.6g} s is {farthest:.4g} m from the origin along an axis, where "
        f"{precision} resolves positions only to {spacing_at(precision, farthest):.3g} m; the required "
        f"resolution is {COARSEST:g} of the smallest radius {plan.radius_min:.3g} m.{better} an outlet, or "
        "domain.on_exit: delete."
    )


def _box(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    """Periodic box that deforms and has become too narrow."""
    return (
        f"{diagnosis.body.name} at {time:.6g} s is narrower than {plan.narrowest_box:.4g} m, which is two "
        "of the largest diameters and twice the skin: a particle could be in contact with two images of "
        "another one. Use a larger box with more particles, or end the compression earlier."
    )


def _liquid(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    """Bridges that formed in one step have taken more liquid than the film had."""
    return (
        f"the bridges that form in one step on {diagnosis.body} at {time:.6g} s take more liquid than its "
        "film has, because it overlaps with particles or walls that overlap with each other. Move them "
        "apart, or start the particles with gaps."
    )


def _flow(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    """A sum that a contact model declares is above the range in which it is exact."""
    return (
        f"one of the flows to {diagnosis.body} at {time:.6g} s, {', '.join(plan.laws.flows)}, is not a "
        "number or more than 30 times the bound that its contact model gives (flow_bounds). Correct the "
        "model, or begin with values nearer to each other."
    )


def _rate(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    """A property that a particle equation integrates is not finite."""
    names = alternatives(tuple(each.name for each in plan.scene.equations))
    return (
        f"the {names} of {diagnosis.body} at {time:.6g} s is not a finite number: its equation gives such a "
        "rate. Correct the function rate, for example a division by zero, or the values that it reads."
    )


def _wall(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    """Displacement of a force-controlled wall in one step above the limit."""
    slower = next(
        controlled.spec.slower
        for controlled in plan.controlled_motions
        if diagnosis.body.name == f"wall {controlled.name}"
    )
    limit = plan.wall_travel_limit
    planned = SPEED_MARGIN * diagnosis.body.speed * plan.travel_limit / limit
    advice = remedy(plan.step.is_given, diagnosis.body.speed, planned, limit)
    return f"{_too_far(diagnosis, plan, time, limit)} {slower} {advice}"


def _too_far(diagnosis: Diagnosis, plan: Plan, time: float, limit: float) -> str:
    """Sentence on a displacement in one step above `limit` [m]."""
    moved = diagnosis.body.speed * diagnosis.time_step
    return (
        f"{diagnosis.body} at {time:.6g} s moves {moved:.3g} m in one step of {diagnosis.time_step:.3g} s, "
        f"above the limit of {limit:.3g} m ({share_of(limit, plan.radius_min)}): beyond it contacts can be "
        "missed."
    )


_REASONS = {
    "force": _force,
    "displacement": _displacement,
    "not_finite": _not_finite,
    "overlap": _overlap,
    "left_domain": _left_domain,
    "wall": _wall,
    "far": _far,
    "liquid": _liquid,
    "flow": _flow,
    "rate": _rate,
    "box": _box,
}

# Cause and remedies of an overlap above the limit: an impact, a static load, a pressing wall, or cohesion.

AT_REST_SHARE = 0.01
"""Kinetic over total energy of a contact below which its load is static: an impact that ends there reaches at
most 1.004 times the limit, because 1 - (limit / dmax)^2.5 of its energy is kinetic at the limit."""
COHESIVE_SHARE = 0.5
"""Attraction over repulsion above which cohesion is the cause of an overlap."""
GROWTH = 1.25
"""Overlap assumed for a static load over the observed one: the run stopped while the load increased."""
SUDDEN = 2.0
"""Largest force of a weight over its static force: the bed is still settling when the run stops."""
EXPLAINED = 0.5
"""Smallest share of an overlap that the largest static overlap under the weight and the walls must
explain."""
TOLERANCE = 1.01
"""Velocity over the planned one up to which an impact is as planned: it follows from the energy of a coarse
step."""
SPEED_MARGIN = 1.2
"""Factor from an observed velocity to the recommended `velocity_max`."""


def overlap_cause(pair: ContactPair, plan: Plan) -> str:
    """Sentences on the cause of an overlap above the limit, with the remedies of the contact model.

    The moduli are those at which the same impact or load stays below the limit, see `plan.overlaps`. For
    static loads the largest of the observed force, the weight of all particles and the walls counts: the load
    may still increase.
    """
    touching = pair.case
    attraction = attraction_share(plan.laws, touching, pair.overlap * touching.overlap_radius)
    if attraction > COHESIVE_SHARE:
        return _cohesion(touching, plan, attraction)
    if pair.approach**2 < AT_REST_SHARE * pair.impact_velocity**2:
        return f"The contact is almost at rest: {_at_rest(touching, plan, pair, is_impact=True)}"
    reached = impact_overlap(plan.laws, touching, pair.impact_velocity)
    if reached < pair.overlap:
        alone = f"An impact at {pair.impact_velocity:.3g} m/s alone reaches {reached:.3g} of the radius"
        return f"{alone}: {_at_rest(touching, plan, pair)}"
    return _impact(touching, plan, pair.impact_velocity, reached)


def _impact(touching: PairCase, plan: Plan, velocity: float, largest: float) -> str:
    """Cause and remedy of an impact at `velocity` [m/s], which reaches the overlap over radius `largest`."""
    remedy = _moduli(
        touching,
        plan,
        lambda pair: impact_overlap(plan.laws, pair, velocity, plan.scene.numerics.intended_overlap),
        largest,
    )
    cause = (
        f"This overlap results from an impact at {velocity:.3g} m/s, which reaches {largest:.3g} of the "
        "radius"
    )
    if velocity <= TOLERANCE * plan.impact_velocity.value:
        return f"{cause}: {remedy}."
    planned = f"set run.velocity_max to {SPEED_MARGIN * velocity:.3g} m/s for the time step"
    return (
        f"{cause}; it is above the planned {plan.impact_velocity.value:.3g} m/s: {planned} and {remedy}, "
        "or find the cause of this velocity."
    )


def _at_rest(touching: PairCase, plan: Plan, contact: ContactPair, is_impact: bool = False) -> str:
    """Cause and remedy of an overlap that no impact of the two bodies alone explains.

    A static load, if the weight, a wall or a deforming box explains at least EXPLAINED of the overlap;
    otherwise other particles that press in motion, such as those that land on a bed or slide down in a drum,
    or the strain of a deforming box, which has no walls.
    """
    weight = BedPressure("weight", "", contact.weight, max(3.0 * plan.particle_capacity, 1.0))
    by_weight = SUDDEN * weight.largest_force(2.0 * touching.overlap_radius)
    by_wall = max((each.force for each in plan.forecasts if each.cause in ("wall", "box")), default=0.0)
    observed = ContactForces(plan.laws, touching, 1.0).total(
        GROWTH * contact.overlap * touching.overlap_radius, 0.0
    )
    force = max(observed, by_weight, by_wall)
    expected = static_overlap(plan.laws, touching, force)
    remedy = _moduli(touching, plan, lambda pair: static_overlap(plan.laws, pair, force), expected)
    if plan.laws.normal.softer_after_slow_onset:
        remedy = f"{_fixed_stiffness(plan)}, or {remedy}"
    if plan.features.deforming_box:
        return _compressed(remedy)
    by_load = static_overlap(plan.laws, touching, max(by_weight, by_wall))
    if by_load < EXPLAINED * contact.overlap:
        possible = is_impact and contact.impact_velocity <= TOLERANCE * plan.impact_velocity.value
        return _moving_load(remedy, by_load, contact.impact_velocity if possible else None)
    pressing = by_wall > by_weight
    names = ", ".join(f"walls.{each.name}" for each in plan.controlled_motions if each.force > 0.0)
    cause = (
        f"the static pressure of {names}"
        if pressing
        else "a static load, such as the weight above these particles"
    )
    less = ", lower the pressure" if pressing else ""
    return f"its cause is {cause}: {remedy}{less}."


def _compressed(remedy: str) -> str:
    """Cause and remedy of an overlap in a deforming box."""
    return (
        "the deforming box presses the particles together: end the compression at a lower box_pressure "
        f"(stages.N.until), lower its strain_rate, max_rate or pressure, or {remedy}."
    )


def _fixed_stiffness(plan: Plan) -> str:
    """Instruction that makes all contacts as stiff as those at the planned velocity."""
    velocity = plan.impact_velocity.value
    return (
        f"set contact.normal.stiffness to {{reference_velocity: {velocity:.3g} m/s}}, because a "
        "contact that begins slowly gets a soft spring with onset"
    )


def _moving_load(remedy: str, by_load: float, velocity: float | None) -> str:
    """Cause and remedy of an overlap that weight and walls do not explain.

    by_load:   the overlap that they explain, over the radius
    velocity:  [m/s] of an impact that explains it; None if none does
    """
    impact = "" if velocity is None else f"an impact at {velocity:.3g} m/s ends here, or "
    return (
        f"{impact}other particles or a moving wall press on it, as particles do that land on a bed; weight "
        f"and walls at rest explain only an overlap of {by_load:.2g} of the radius. Lower the velocity, or "
        f"{remedy}."
    )


def _cohesion(touching: PairCase, plan: Plan, attraction: float) -> str:
    """Cause and remedy of an overlap by cohesion; `attraction`: over the repulsion.

    The remedy also covers impacts at the planned velocity, which the attraction makes deeper.
    """
    assert plan.laws.cohesion is not None

    def overlap(pair: PairCase) -> float:
        return max(
            static_overlap(plan.laws, pair, 0.0), impact_overlap(plan.laws, pair, plan.impact_velocity.value)
        )

    remedy = _moduli(touching, plan, overlap, overlap(touching))
    keys = " or ".join(plan.laws.cohesion.constant_names)
    return f"Its cause is cohesion, {attraction:.2g} of the repulsion: lower {keys}, or {remedy}."


def _moduli(touching: PairCase, plan: Plan, overlap: Callable[[PairCase], float], expected: float) -> str:
    """Instruction that sets the moduli at which the overlap is below the limit, or raises the limit.

    `expected`: overlap over the radius without a change.
    """
    factor = modulus_factor(touching, overlap, plan.scene.numerics.intended_overlap)
    if factor is None:
        first = without_modulus(touching, overlap)
    else:
        first = modulus_text(required_moduli(plan.scene.materials, touching.materials, max(factor, 1.0)))
    needed = _limit_above(expected, plan)
    accept = f", or set numerics.max_overlap to {needed:g} if such overlaps are intended"
    return first + (accept if needed <= LARGEST_OVERLAP else "")


def _limit_above(overlap: float, plan: Plan) -> float:
    """Limit, with two decimals, that permits an expected overlap over the radius."""
    return float(f"{LIMIT_MARGIN * max(overlap, plan.scene.numerics.intended_overlap) + 0.005:.2f}")


# Diagnoses an aborted run on the host: finds the particles or walls that exceeded the limit.

FIELDS = (
    "id",
    "radius",
    "mass",
    "position",
    "position_at_rebuild",
    "velocity",
    "force",
    "material",
    "fixed",
    "clump",
)
"""Particle fields that the diagnosis reads."""
TINY_MASS = 1e-300
"""Mass [kg] of unused array entries."""


@np.errstate(all="ignore")  # velocities may be infinite
def diagnose(
    code: int, particle: int, state: State, time: float, step_taken: bool, change: WallChange | None
) -> Diagnosis:
    """Diagnosis of an abort, with the contact pair of the largest overlap; None without a contact.

    code:        abort code, see `engine.codes`
    particle:    id of the particle that exceeded the limit; unused for walls
    time:        simulated time [s]
    step_taken:  true if a step was taken; false if only the initial forces were computed
    change:      insertion or change of walls since which no step was taken, or None

    Runs on the host in float64. For a position that is not finite or a displacement above its limit, only
    contacts of this particle one step earlier are considered.
    """
    if code == ABORT_WALL:
        return Diagnosis(
            ABORT_REASONS[code], _fastest_wall(state), None, state.clock.time_step, step_taken, None
        )
    if code == ABORT_BOX:
        narrowest = AXES[int(np.nan_to_num(state.periodic_box.width).argmin())]
        body = Body(f"the periodic box along {narrowest}", "", (0.0, 0.0, 0.0), None)
        return Diagnosis(ABORT_REASONS[code], body, None, state.clock.time_step, step_taken, None)
    arrays = copy_to_host(state, FIELDS, 0, state.capacities.particles)
    arrays = {
        name: values.astype(float) if values.dtype.kind == "f" else values for name, values in arrays.items()
    }
    if code == ABORT_OVERLAP and step_taken and change is None:
        # The step is complete: its forces belong to the present positions, half a step after the velocities.
        mass = np.maximum(arrays["mass"], TINY_MASS)
        arrays["velocity"] += (
            0.5 * state.clock.time_step * arrays["force"] * (mobility_mask(arrays) / mass)[:, None]
        )
    found = np.flatnonzero(arrays["id"] == particle)
    index = int(found[0])  # a deleted particle is directly behind the others
    body = _body(state.plan, arrays, index)
    candidates = _candidate_pairs(code, state, arrays, time)
    involved = (candidates.owner == index) | (candidates.partner == index)
    considered = (
        involved if code in (ABORT_NOT_FINITE, ABORT_DISPLACEMENT, ABORT_FORCE) else np.ones_like(involved)
    )
    share = np.where(considered & (candidates.overlap > 0.0), candidates.overlap, 0.0)
    pair = _contact_pair(state.plan, arrays, candidates, int(share.argmax())) if share.any() else None
    return Diagnosis(ABORT_REASONS[code], body, pair, state.clock.time_step, step_taken, change)


def _fastest_wall(state: State) -> Body:
    """The force-controlled wall with the highest velocity."""
    velocities = controlled_velocities(state)
    index = int(np.nan_to_num(np.linalg.norm(velocities, axis=1), nan=np.inf).argmax())
    wall = state.plan.walls[index]
    return Body(f"wall {wall.name}", state.plan.materials[wall.material], _vector(velocities[index]), None)


def _body(plan: Plan, arrays: dict[str, np.ndarray], index: int) -> Body:
    """One particle as messages describe it; `index` in device order."""
    velocity = arrays["velocity"][index]
    material = arrays["material"][index] if "material" in arrays else 0
    clump = arrays["clump"][index] if "clump" in arrays else -1
    return Body(
        f"particle {arrays['id'][index]}{f' of clump {clump}' if clump >= 0 else ''}",
        plan.materials[material],
        _vector(velocity),
        _vector(arrays["position"][index]),
    )


def _vector(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


@dataclass(frozen=True)
class CandidatePairs:
    """The n candidate pairs at their positions.

    owner:     (n,) particle index
    partner:   (n,) particle index, or -1 - wall index
    overlap:   (n,) over the smaller radius, negative for a gap
    approach:  (n,) approach velocity [m/s] along the normal
    surface:   (n, 3) velocity of the partner's surface [m/s]
    """

    owner: np.ndarray
    partner: np.ndarray
    overlap: np.ndarray
    approach: np.ndarray
    surface: np.ndarray


def _candidate_pairs(code: int, state: State, arrays: dict[str, np.ndarray], time: float) -> CandidatePairs:
    """All candidate pairs at their present positions; after a jump, at the positions before it."""
    owner, _list_index, partner = candidate_pairs(state)
    position = arrays["position"]
    velocity = arrays["velocity"]
    if code in (ABORT_NOT_FINITE, ABORT_DISPLACEMENT, ABORT_FORCE):
        position = position - state.clock.time_step * velocity
        position = np.where(np.isfinite(position), position, arrays["position_at_rebuild"])
    partner_index = np.maximum(partner, 0)
    images, surface_velocity = state.periodic_box.nearest_images_with_velocity(
        position[partner_index], velocity[partner_index], position[owner], time
    )
    branch = position[owner] - images
    distance = np.linalg.norm(branch, axis=1)
    overlap = arrays["radius"][owner] + arrays["radius"][partner_index] - distance
    normal = branch / np.maximum(distance, 1e-3 * arrays["radius"][owner])[:, None]
    smaller = np.minimum(arrays["radius"][owner], arrays["radius"][partner_index])
    face = -1 - partner
    partner[partner < 0] = -1 - walls_of(state, partner[partner < 0])
    for index in range(len(state.plan.walls)):
        of_wall = partner == -1 - index
        points = state.periodic_box.wrap(position[owner[of_wall]])
        gap, normal[of_wall], surface_velocity[of_wall] = _wall_gaps(
            state, index, face[of_wall], points, time
        )
        smaller[of_wall] = arrays["radius"][owner[of_wall]]
        overlap[of_wall] = smaller[of_wall] - gap
    approach = -np.sum((velocity[owner] - surface_velocity) * normal, axis=1)
    return CandidatePairs(owner, partner, overlap / smaller, approach, surface_velocity)


def _wall_gaps(
    state: State, index: int, face: np.ndarray, points: np.ndarray, time: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gap and surface velocity of a wall.

    index:    wall index
    face:     (n,) wall index, or wall count + triangle index
    points:   (n, 3) [m], inside the periodic box
    time:     [s]
    Returns:  gap (n,) [m] or FAR_AWAY, unit normal (n, 3), velocity (n, 3) [m/s]
    """
    wall_pose = poses_at(state.wall_motions[index], np.array([time]))
    rotation = wall_pose.rotation[0]
    center = wall_pose.offset[0] + wall_pose.pivot + controlled_displacements(state)[index]
    velocity = wall_pose.velocity[0] + controlled_velocities(state)[index]
    local = (points - center) @ rotation + wall_pose.pivot
    first = len(state.plan.walls) + state.plan.first_triangle(index)
    gap, normal = state.plan.walls[index].surface.contacts(local, face - first)
    return gap, normal @ rotation.T, velocity + np.cross(wall_pose.angular_velocity[0], points - center)


def _contact_pair(
    plan: Plan, arrays: dict[str, np.ndarray], candidates: CandidatePairs, worst: int
) -> ContactPair:
    """The worst candidate pair, and the longest time step that is stable for its present state."""
    owner = int(candidates.owner[worst])
    partner = int(candidates.partner[worst])
    first = _body(plan, arrays, owner)
    radius = float(arrays["radius"][owner])
    mass = float(arrays["mass"][owner])
    radius_eff = radius
    mass_eff = mass
    smaller = radius
    if partner >= 0:
        second = _body(plan, arrays, partner)
        radius_eff = radius * arrays["radius"][partner] / (radius + arrays["radius"][partner])
        both = {name: values[[owner, partner]] for name, values in arrays.items()}
        mass_eff = float(1.0 / (mobility_mask(both) / both["mass"]).sum())
        smaller = min(radius, float(arrays["radius"][partner]))
    else:
        wall = plan.walls[-1 - partner]
        second = Body(
            f"wall {wall.name}", plan.materials[wall.material], _vector(candidates.surface[worst]), None
        )
    overlap = float(candidates.overlap[worst])
    approach = float(candidates.approach[worst])
    material = plan.pair_materials[first.material, second.material]
    touching = PairCase(
        "",
        (first.material, second.material),
        material,
        radius_eff,
        mass_eff,
        radius,
        smaller,
        plan.scene.materials[first.material],
        _contact_count(candidates, owner, partner),
    )
    velocity = impact_velocity(plan.laws, touching, overlap * smaller, approach)
    stable = touching.stable_step(plan.laws.normal, velocity)
    return ContactPair(
        first,
        second,
        overlap,
        approach,
        velocity,
        stable,
        touching,
        _weight_pressure(plan, arrays),
    )


def _weight_pressure(plan: Plan, arrays: dict[str, np.ndarray]) -> float:
    """Pressure [Pa] of the weight of all mobile particles, also of those to be inserted, on the bed.

    The section of the bed is that of its bounding box across gravity; 0 without gravity or mobile particles.
    """
    gravity = np.array(plan.scene.usual_gravity)
    mobile = (mobility_mask(arrays) > 0.0) & (arrays["mass"] > TINY_MASS)
    magnitude = float(np.linalg.norm(gravity))
    if not magnitude or not mobile.any():
        return 0.0
    reach = np.where(mobile, arrays["radius"], 0.0)[mobile, None]
    size = (arrays["position"][mobile] + reach).max(axis=0) - (arrays["position"][mobile] - reach).min(axis=0)
    section = np.abs(gravity) / magnitude @ [size[1] * size[2], size[2] * size[0], size[0] * size[1]]
    planned = sum(group.spec.sphere_count for group in plan.groups if not group.spec.fixed) / mobile.sum()
    return float(magnitude * arrays["mass"][mobile].sum() * planned / section)


def _contact_count(candidates: CandidatePairs, *ends: int) -> int:
    """Number of contacts of the body that has more, of `ends` (negative: wall, not counted)."""
    touching = candidates.overlap > 0.0
    pairs = {
        (min(ends), max(ends))
        for ends in zip(candidates.owner[touching], candidates.partner[touching], strict=True)
    }
    return max(sum(end in pair for pair in pairs) for end in ends if end >= 0)
