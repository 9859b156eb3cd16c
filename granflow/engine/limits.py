"""Abort codes and messages: the particle or the bodies in contact, the time, the likely cause and the remedies."""

from dataclasses import dataclass
from math import isfinite

from granflow.engine.abort_bodies import Body, ContactPair
from granflow.engine.overlap_cause import SPEED_MARGIN, overlap_cause
from granflow.plan.plan import Plan
from granflow.plan.resolution import COARSEST, spacing_at
from granflow.plan.travel import remedy, share_of
from granflow.scene.schema.run import LARGEST_OVERLAP

ABORT_FORCE, ABORT_DISPLACEMENT, ABORT_NOT_FINITE, ABORT_OVERLAP, ABORT_LEFT_DOMAIN, ABORT_WALL, ABORT_FAR = range(1, 8)
ABORT_LIQUID = 8
"""Codes: a contact force above the range of the sums, a displacement per step above the limit, a position that is not
finite, an overlap above the limit, a particle outside a domain with `on_exit: error` (set by the host), a
force-controlled wall above its displacement limit, a particle so far from the origin that the precision does not
resolve its position (set by the host), and a film from which bridges have taken more liquid than it had."""

ABORT_REASONS = {
    ABORT_FORCE: "force",
    ABORT_DISPLACEMENT: "displacement",
    ABORT_NOT_FINITE: "not_finite",
    ABORT_OVERLAP: "overlap",
    ABORT_LEFT_DOMAIN: "left_domain",
    ABORT_WALL: "wall",
    ABORT_FAR: "far",
    ABORT_LIQUID: "liquid",
}
"""Reason of each code, as in Diagnosis.reason."""

FORCE_REASONS = frozenset({"force", "displacement", "not_finite", "overlap"})
"""Reasons that a force from Python can have caused."""

NO_PARTICLE = 2**31 - 1
"""Larger than any id: kernels lower it to the smallest id that exceeds a limit."""

INTEGRATION, FORCES = range(2)
"""Phases of a step on a GPU that can halt the following launches."""

NOT_HALTED = 2**31 - 1
"""Larger than the number of any launch on a GPU."""


OVERLAP_MARGIN = 1.4
"""Limit of the overlap that lets an aborted run continue, over the overlap at the abort: it still increases."""


@dataclass(frozen=True)
class Change:
    """Insertion, or change of walls, during a run. `stage`: name of the stage; `appeared`: names of the new walls."""

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
    change: Change | None
    """The change after which the forces were computed; None if a step was taken since then, or before the first one."""


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


def permitted_change(diagnosis: Diagnosis) -> str:
    """KEY=VALUE for a run that continues before the abort: a limit above the overlap; empty if none is known.

    For an initial overlap, the limit is that of the message.
    """
    if diagnosis.reason != "overlap" or diagnosis.pair is None or diagnosis.pair.overlap >= LARGEST_OVERLAP:
        return ""
    if not diagnosis.begun:
        needed = _limit_for_initial(diagnosis.pair.overlap)
        return f"numerics.max_overlap={needed:g}" if needed <= LARGEST_OVERLAP else ""
    return f"numerics.max_overlap={min(OVERLAP_MARGIN * diagnosis.pair.overlap, LARGEST_OVERLAP):.2g}"


def _limit_for_initial(overlap: float) -> float:
    """Smallest limit with two decimals that permits an initial overlap over the radius."""
    return float(f"{overlap + 0.005:.2f}")


def _overlap(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    """Overlap above `numerics.max_overlap`."""
    pair = diagnosis.pair
    if pair is None:
        return f"{diagnosis.body} at {time:.6g} s overlaps by more than {plan.max_overlap:g} of its radius."
    limit = f"numerics.max_overlap {plan.max_overlap:g}"
    description = (
        f"{pair.first} at {time:.6g} s overlaps with {pair.second} by {pair.overlap:.3g} times the smaller "
        f"radius, more than {limit}."
    )
    if not diagnosis.begun:
        needed = _limit_for_initial(pair.overlap)
        accept = f", or set numerics.max_overlap to {needed:g} if this is intended"
        return f"{description} They overlap initially: move them apart{accept if needed <= LARGEST_OVERLAP else ''}."
    if diagnosis.change is not None and pair.second.position is None:
        return f"{description} {_change_cause(diagnosis.change, pair.second.name, plan)}"
    description = f"{description} {_relative_motion(pair)}"
    if diagnosis.time_step > pair.stable_step and plan.step.is_given:
        return f"{description} {_step_or_speed(pair, plan, diagnosis.time_step)}"
    return f"{description} {overlap_cause(pair, plan)}"


def _change_cause(change: Change, wall: str, plan: Plan) -> str:
    """Sentence on a particle that is in a wall since an insertion, or since the wall exists; `wall`: as in messages."""
    name = next((name for name in change.appeared if wall == f"wall {name}"), None)
    if name is None:
        return (
            "The particle was inserted there at this time: choose a region for the insertion that does not intersect "
            f"{wall}."
        )
    planned = next(each for each in plan.walls if each.name == name)
    keys = ([] if planned.stages is None else [f"walls.{name}.stages"]) + (
        [f"walls.{name}.appears_at"] if planned.appears_at > 0.0 else []
    )
    remedy = f" Change {' or '.join(keys)}, or let" if keys else " Let"
    return (
        f"Wall {name} appears at this time, in stage {change.stage}, where the "
        f"particle is.{remedy} it appear where there are no particles."
    )


def _force(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    """Contact force above the range of the sums."""
    description = (
        f"the contact force on {diagnosis.body} at {time:.6g} s is above {plan.sum_units.largest_force:.3g} N, more "
        f"than 30 times the force at the overlap limit numerics.max_overlap {plan.max_overlap:g}."
    )
    if diagnosis.pair is None:
        return _advice(diagnosis.time_step, f"{description} Likely cause: a velocity far above run.velocity_max")
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


def _not_finite(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    """Position that is not a number."""
    description = f"the position of {diagnosis.body} at {time:.6g} s is not a number."
    if diagnosis.pair is None:
        better = "" if plan.precision == "f64" else ", or use precision f64"
        return f"{description} It has no contacts: check its initial velocity and angular_velocity{better}."
    cause = _step_or_speed(diagnosis.pair, plan, diagnosis.time_step) or _advice(
        diagnosis.time_step, "Likely cause: the time step is too long for this contact"
    )
    return f"{description} {_overlap_before(diagnosis.pair)} {cause}"


def _left_domain(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    """Particle outside a domain with `on_exit: error`."""
    where = plan.sources["domain.on_exit"]
    name, _, rest = str(diagnosis.body).partition(" (")
    x, y, z = diagnosis.body.position or (0.0, 0.0, 0.0)
    return (
        f"{name} at {time:.6g} s is outside the domain, and domain.on_exit is error ({where}); "
        f"it is at [{x:.4g}, {y:.4g}, {z:.4g}] m ({rest}. "
        "Close the gap in the walls, enlarge the domain, or set domain.on_exit to delete."
    )


def _far(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    """Position that the precision does not resolve."""
    precision, position = plan.precision, diagnosis.body.position or (0.0, 0.0, 0.0)
    farthest = max(map(abs, position))
    better = " Use --precision mixed, or" if precision == "f32" else " Use"
    return (
        f"{diagnosis.body} at {time:.6g} s is {farthest:.4g} m from the origin along an axis, where "
        f"{precision} resolves positions only to {spacing_at(precision, farthest):.3g} m; the required resolution is "
        f"{COARSEST:g} of the smallest radius {plan.radius_min:.3g} m.{better} an outlet, or domain.on_exit: delete."
    )


def _liquid(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    """Bridges that formed in one step have taken more liquid than the film had."""
    return (
        f"the bridges that form in one step on {diagnosis.body} at {time:.6g} s take more liquid than its film has, "
        "because it overlaps with particles or walls that overlap with each other. Move them apart, or start the "
        "particles with gaps."
    )


def _wall(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    """Displacement of a force-controlled wall in one step above the limit."""
    kind = next(
        controlled.kind for controlled in plan.controlled_motions if diagnosis.body.name == f"wall {controlled.name}"
    )
    slower = "Lower its velocity_max." if kind == "servo" else "Increase its mass or damping."
    limit = plan.wall_travel_limit
    planned = SPEED_MARGIN * diagnosis.body.speed * plan.travel_limit / limit
    advice = remedy(plan.step.is_given, diagnosis.body.speed, planned, limit)
    return f"{_too_far(diagnosis, plan, time, limit)} {slower} {advice}"


def _too_far(diagnosis: Diagnosis, plan: Plan, time: float, limit: float) -> str:
    """Sentence on a displacement in one step above `limit` [m]."""
    moved = diagnosis.body.speed * diagnosis.time_step
    return (
        f"{diagnosis.body} at {time:.6g} s moves {moved:.3g} m in one step of {diagnosis.time_step:.3g} s, "
        f"above the limit of {limit:.3g} m ({share_of(limit, plan.radius_min)}): beyond it contacts can be missed."
    )


def _overlap_before(pair: ContactPair) -> str:
    """Sentence on the overlap one step earlier."""
    return f"One step earlier {pair.first} and {pair.second} overlapped by {pair.overlap:.3g} times the smaller radius."


def _relative_motion(pair: ContactPair) -> str:
    """Sentence on the approach velocity; empty if it is not finite."""
    if not isfinite(pair.approach):
        return ""
    return f"They {'approach' if pair.approach >= 0.0 else 'separate'} at {abs(pair.approach):.3g} m/s."


def _step_or_speed(pair: ContactPair, plan: Plan, time_step: float) -> str | None:
    """The likely cause if it is a time step that is too long, or an impact above the planned `velocity_max`."""
    velocity_remedy = f"set run.velocity_max to {SPEED_MARGIN * pair.impact_velocity:.3g} m/s"
    if time_step > pair.stable_step:
        description = (
            f"The time step {time_step:.3g} s exceeds the stable step {pair.stable_step:.3g} s of this contact"
        )
        return f"{description}: lower run.time_step, or remove it and {velocity_remedy}."
    if pair.impact_velocity > plan.velocity_max:
        description = (
            f"This overlap results from an impact at {pair.impact_velocity:.3g} m/s, above the planned "
            f"{plan.velocity_max:.3g} m/s"
        )
        return f"{description}: {velocity_remedy}, or find the cause of this velocity."
    return None


def _advice(time_step: float, cause: str) -> str:
    """Cause and remedies if the time step is stable for the contact and the impact is not above `velocity_max`."""
    return f"{cause}. Lower run.time_step (now {time_step:.3g} s), or check for particles that overlap initially."


_REASONS = {
    "force": _force,
    "displacement": _displacement,
    "not_finite": _not_finite,
    "overlap": _overlap,
    "left_domain": _left_domain,
    "wall": _wall,
    "far": _far,
    "liquid": _liquid,
}
