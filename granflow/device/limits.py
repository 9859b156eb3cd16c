"""Guards: their codes, and what to say when one stops a run: who is at fault, when, likely why, what to change."""

from dataclasses import dataclass
from math import hypot, isfinite

from granflow.plan import Plan
from granflow.plan.resolution import COARSEST, spacing_at
from granflow.plan.travel import remedy, share_of

ABORT_DISPLACEMENT, ABORT_NOT_FINITE, ABORT_OVERLAP, ABORT_LEFT_DOMAIN, ABORT_WALL, GUARD_FAR = 1, 2, 3, 4, 5, 6
"""Codes: a particle above the largest distance per step, a position that is not a number, an overlap above the limit,
(set by the host) a particle outside a domain with `on_exit: error`, a driven wall above it, (set by the
host) a particle so far from the origin that the precision does not resolve its position."""

ABORT_REASONS = {
    ABORT_DISPLACEMENT: "displacement",
    ABORT_NOT_FINITE: "not_finite",
    ABORT_OVERLAP: "overlap",
    ABORT_LEFT_DOMAIN: "left_domain",
    ABORT_WALL: "wall",
    GUARD_FAR: "far",
}

NO_PARTICLE = 2**31 - 1
"""Larger than any id: kernels lower it to the smallest id that tripped a guard."""

SPEED_MARGIN = 1.2
"""Factor from a speed that was seen to one to plan for."""

AT_REST = 1e-9
"""Speed [m/s] below which a message calls it rest."""


@dataclass(frozen=True)
class Participant:
    """A particle or a wall: its name, its material, its velocity [m/s] where it touches, a particle's position [m]."""

    name: str
    material: str
    velocity: tuple[float, float, float]
    position: tuple[float, float, float] | None

    @property
    def speed(self) -> float:
        """Speed [m/s]."""
        return hypot(*self.velocity)

    def __str__(self) -> str:
        """As messages name it: particle 7 (glass, 3.2 m/s)."""
        moving = f"{self.speed:.3g} m/s" if isfinite(self.speed) else "velocity not a number"
        return f"{self.name} ({self.material}, {'at rest' if self.speed < AT_REST else moving})"


@dataclass(frozen=True)
class ContactPair:
    """Two that touch, as they are when a run stops.

    `overlap` over the smaller radius; `approach` [m/s] along the normal, < 0 parting; `impact_velocity` [m/s]: the
    approach
    that would bring them to this overlap and approach; `stable_step` [s] for it.
    """

    first: Participant
    second: Participant
    overlap: float
    approach: float
    impact_velocity: float
    stable_step: float


@dataclass(frozen=True)
class Diagnosis:
    """Which guard tripped, the particle with the smallest id that tripped it, the pair most at fault, the step [s]."""

    reason: str
    participant: Participant
    pair: ContactPair | None
    time_step: float
    begun: bool
    """Whether any step was taken, not only forces found where the particles begin."""


def diagnosis_of(
    code: int, participant: Participant, pair: ContactPair | None, time_step: float, begun: bool
) -> Diagnosis:
    """The trip that a code stands for."""
    return Diagnosis(ABORT_REASONS[code], participant, pair, time_step, begun)


def abort_message(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    """A few sentences for a tripped guard: who and when, the number at fault, the likely cause, two remedies."""
    return f"Stopped: {_REASONS[diagnosis.reason](diagnosis, plan, time)}"


def _overlap(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    pair = diagnosis.pair
    if pair is None:
        return f"{diagnosis.participant} at {time:.6g} s overlaps by more than {plan.max_overlap:g} of its radius."
    limit = f"numerics.max_overlap {plan.max_overlap:g}"
    description = (
        f"{pair.first} at {time:.6g} s overlaps by more than {limit} of the smaller radius: by {pair.overlap:.3g}, "
        f"with {pair.second}."
    )
    if not diagnosis.begun:
        return (
            f"{description} They begin so: move them apart, or raise numerics.max_overlap if such overlaps are wanted."
        )
    description = f"{description} {_relative_motion(pair)}"
    if cause := _step_or_speed(pair, plan, diagnosis.time_step):
        return f"{description} {cause}"
    soft_materials = " and ".join(dict.fromkeys((pair.first.material, pair.second.material)))
    return (
        f"{description} Likely they are too soft for this load: raise young_modulus of {soft_materials}, "
        "or raise numerics.max_overlap if such overlaps are wanted."
    )


def _displacement(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    description = _too_far(diagnosis, plan, time, plan.travel_limit)
    if diagnosis.pair is None:
        speed = diagnosis.participant.speed
        return f"{description} {remedy(plan.scene, speed, SPEED_MARGIN * speed, plan.travel_limit)}"
    cause = _step_or_speed(diagnosis.pair, plan, diagnosis.time_step) or _advice(
        diagnosis.time_step, "Likely it was shot out of this overlap"
    )
    return f"{description} {_overlap_before(diagnosis.pair)} {_relative_motion(diagnosis.pair)} {cause}"


def _not_finite(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    description = f"the position of {diagnosis.participant} at {time:.6g} s is not a number."
    if diagnosis.pair is None:
        return (
            f"{description} It touches nothing: look at the velocity and spin it was "
            f"given, or compute with precision f64."
        )
    cause = _step_or_speed(diagnosis.pair, plan, diagnosis.time_step) or _advice(
        diagnosis.time_step, "Likely this contact was integrated too coarsely"
    )
    return f"{description} {_overlap_before(diagnosis.pair)} {cause}"


def _left_domain(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    where = plan.scene.where("domain", "on_exit")
    name, _, rest = str(diagnosis.participant).partition(" (")
    x, y, z = diagnosis.participant.position or (0.0, 0.0, 0.0)
    return (
        f"{name} at {time:.6g} s is outside the domain, and domain.on_exit is error ({where}); "
        f"it is at [{x:.4g}, {y:.4g}, {z:.4g}] m ({rest}. "
        "Close the gap in the walls, widen the domain, or write delete."
    )


def _far(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    precision, position = plan.scene.run.precision, diagnosis.participant.position or (0.0, 0.0, 0.0)
    farthest = max(map(abs, position))
    better = " Use --precision mixed, or" if precision == "f32" else " Use"
    return (
        f"{diagnosis.participant} at {time:.6g} s is {farthest:.4g} m from the origin along an axis, where "
        f"{precision} resolves "
        f"positions only to {spacing_at(precision, farthest):.3g} m; needed is {COARSEST:g} of the smallest radius "
        f"{plan.radius_min:.3g} m.{better} an outlet, or domain.on_exit: delete."
    )


def _wall(diagnosis: Diagnosis, plan: Plan, time: float) -> str:
    kind = next(
        controlled.kind
        for controlled in plan.controlled_motions
        if diagnosis.participant.name == f"wall {controlled.name}"
    )
    slower = "Lower its velocity_max." if kind == "servo" else "Give it more mass or damping."
    limit = plan.wall_travel_limit
    planned = SPEED_MARGIN * diagnosis.participant.speed * plan.travel_limit / limit
    return (
        f"{_too_far(diagnosis, plan, time, limit)} {slower} "
        f"{remedy(plan.scene, diagnosis.participant.speed, planned, limit)}"
    )


def _too_far(diagnosis: Diagnosis, plan: Plan, time: float, limit: float) -> str:
    moved = diagnosis.participant.speed * diagnosis.time_step
    return (
        f"{diagnosis.participant} at {time:.6g} s moves {moved:.3g} m in one step of {diagnosis.time_step:.3g} s, "
        f"above the limit of "
        f"{limit:.3g} m ({share_of(limit, plan.radius_min)}): beyond it contacts can be missed."
    )


def _overlap_before(pair: ContactPair) -> str:
    return f"Before that step {pair.first} and {pair.second} overlapped by {pair.overlap:.3g} of the smaller radius."


def _relative_motion(pair: ContactPair) -> str:
    if not isfinite(pair.approach):
        return ""
    return f"They {'approach' if pair.approach >= 0.0 else 'part'} at {abs(pair.approach):.3g} m/s."


def _step_or_speed(pair: ContactPair, plan: Plan, time_step: float) -> str | None:
    """The likely cause where it is a step too long, or an approach faster than planned for."""
    velocity_remedy = f"set run.velocity_max to {SPEED_MARGIN * pair.impact_velocity:.3g} m/s"
    if time_step > pair.stable_step:
        description = f"The time step {time_step:.3g} s is above the stable {pair.stable_step:.3g} s of this pair"
        return f"{description} at such an impact: lower run.time_step, or leave it out and {velocity_remedy}."
    if pair.impact_velocity > plan.velocity_max:
        description = (
            f"Such an overlap takes an impact at {pair.impact_velocity:.3g} m/s, but "
            f"{plan.velocity_max:.3g} m/s is planned for"
        )
        return f"{description}: {velocity_remedy}, or look for what made them so fast."
    return None


def _advice(time_step: float, cause: str) -> str:
    return f"{cause}: lower run.time_step (now {time_step:.3g} s), or look for grains made on top of each other."


_REASONS = {
    "displacement": _displacement,
    "not_finite": _not_finite,
    "overlap": _overlap,
    "left_domain": _left_domain,
    "wall": _wall,
    "far": _far,
}
