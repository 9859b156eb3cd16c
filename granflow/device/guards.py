"""Guards: their codes, and what to say when one stops a run: which particle, when, likely why, what to change."""

from dataclasses import dataclass
from pathlib import Path

from granflow.plan import Plan

GUARD_TRAVEL, GUARD_LOST, GUARD_OVERLAP, GUARD_LEFT = 1, 2, 3, 4
"""Codes: a step longer than half the skin, a position that is no number, an overlap too large, and (raised by the host)
a particle outside a domain that none may leave."""

GUARDS = {GUARD_TRAVEL: "travel", GUARD_LOST: "lost", GUARD_OVERLAP: "overlap", GUARD_LEFT: "left"}

NO_PARTICLE = 2**31 - 1
"""Larger than any id: kernels lower it to the smallest id that tripped a guard."""


@dataclass(frozen=True)
class Trip:
    """Which guard tripped, and the particle with the smallest id that tripped it."""

    guard: str
    particle: int


def guard_message(trip: Trip, plan: Plan, time: float, out: Path | None) -> str:
    """One or two sentences for a tripped guard."""
    seen = f" The state is written to {out}." if out is not None else ""
    place = f"particle {trip.particle} at {time:.6g} s"
    return f"{_REASONS[trip.guard](place, plan)}{seen}"


def _travel(place: str, plan: Plan) -> str:
    speed = 0.5 * plan.skin / plan.time_step
    return (
        f"Stopped: {place} moved farther than half the neighbour skin of {plan.skin:.3g} m in one step, "
        f"that is faster than {speed:.3g} m/s. Likely it was shot out of an overlap: lower run.time_step "
        f"(now {plan.time_step:.3g} s), or raise numerics.skin if such speeds are right."
    )


def _lost(place: str, plan: Plan) -> str:
    return (
        f"Stopped: the position of {place} is not a number. Likely the contact was integrated too coarsely: lower "
        f"run.time_step (now {plan.time_step:.3g} s), or look for grains made on top of each other."
    )


def _overlap(place: str, plan: Plan) -> str:
    return (
        f"Stopped: {place} overlaps by more than {plan.overlap_limit:g} of its radius. Likely the material is too soft "
        f"for the load or the impact (fastest approach planned for: {plan.velocity_max:.3g} m/s): raise young_modulus, "
        "set run.velocity_max, or raise numerics.overlap_limit if such overlaps are wanted."
    )


def _left(place: str, plan: Plan) -> str:
    where = plan.scene.where("domain", "leaving")
    return (
        f"Stopped: {place} is outside the domain, and domain.leaving is error ({where}). Close the gap in the walls, "
        "widen the domain, or write delete."
    )


_REASONS = {"travel": _travel, "lost": _lost, "overlap": _overlap, "left": _left}
