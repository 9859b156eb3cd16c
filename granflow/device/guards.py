"""Guards: their codes, and what to say when one stops a run: who is at fault, when, likely why, what to change."""

from dataclasses import dataclass
from math import hypot, isfinite
from pathlib import Path

from granflow.plan import Plan

GUARD_TRAVEL, GUARD_LOST, GUARD_OVERLAP, GUARD_LEFT, GUARD_WALL = 1, 2, 3, 4, 5
"""Codes: a step longer than half the skin, a position that is no number, an overlap too large, (raised by the host) a
particle outside a domain that none may leave, and a driven wall that goes farther in a step than half the skin."""

GUARDS = {GUARD_TRAVEL: "travel", GUARD_LOST: "lost", GUARD_OVERLAP: "overlap", GUARD_LEFT: "left", GUARD_WALL: "wall"}

NO_PARTICLE = 2**31 - 1
"""Larger than any id: kernels lower it to the smallest id that tripped a guard."""

SPARE_SPEED = 1.2
"""Factor from a speed that was seen to one to plan for."""

AT_REST = 1e-9
"""Speed [m/s] below which a message calls it rest."""


@dataclass(frozen=True)
class Party:
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
class Pair:
    """Two that touch, as they are when a run stops.

    `overlap` over the smaller radius; `approach` [m/s] along the normal, < 0 parting; `impact` [m/s]: the approach
    that would bring them to this overlap and approach; `stable_step` [s] for it.
    """

    first: Party
    second: Party
    overlap: float
    approach: float
    impact: float
    stable_step: float


@dataclass(frozen=True)
class Trip:
    """Which guard tripped, the particle with the smallest id that tripped it, the pair most at fault, the step [s]."""

    guard: str
    party: Party
    pair: Pair | None
    time_step: float
    begun: bool
    """Whether any step was taken, not only forces found where the particles begin."""


def trip_of(code: int, party: Party, pair: Pair | None, time_step: float, begun: bool) -> Trip:
    """The trip that a code stands for."""
    return Trip(GUARDS[code], party, pair, time_step, begun)


def guard_message(trip: Trip, plan: Plan, time: float, out: Path | None) -> str:
    """A few sentences for a tripped guard: who and when, the number at fault, the likely cause, two remedies."""
    seen = f" The state is written to {out}." if out is not None else ""
    return f"Stopped: {_REASONS[trip.guard](trip, plan, time)}{seen}"


def _overlap(trip: Trip, plan: Plan, time: float) -> str:
    pair = trip.pair
    if pair is None:
        return f"{trip.party} at {time:.6g} s overlaps by more than {plan.overlap_limit:g} of its radius."
    limit = f"numerics.overlap_limit {plan.overlap_limit:g}"
    what = (
        f"{pair.first} at {time:.6g} s overlaps by more than {limit} of the smaller radius: by {pair.overlap:.3g}, "
        f"with {pair.second}."
    )
    if not trip.begun:
        return f"{what} They begin so: move them apart, or raise numerics.overlap_limit if such overlaps are wanted."
    what = f"{what} {_going(pair)}"
    if cause := _step_or_speed(pair, plan, trip.time_step):
        return f"{what} {cause}"
    soft = " and ".join(dict.fromkeys((pair.first.material, pair.second.material)))
    return (
        f"{what} Likely they are too soft for this load: raise young_modulus of {soft}, "
        "or raise numerics.overlap_limit if such overlaps are wanted."
    )


def _travel(trip: Trip, plan: Plan, time: float) -> str:
    moved = trip.party.speed * trip.time_step
    what = (
        f"{trip.party} at {time:.6g} s moved farther than half the neighbour skin in one step: "
        f"{moved:.3g} m, with a skin of {plan.skin:.3g} m."
    )
    if trip.pair is None:
        return (
            f"{what} It touches nothing, so it was as fast before: set run.velocity_max to "
            f"{SPARE_SPEED * trip.party.speed:.3g} m/s, or raise numerics.skin."
        )
    cause = _step_or_speed(trip.pair, plan, trip.time_step) or _lower(
        trip.time_step, "Likely it was shot out of this overlap"
    )
    return f"{what} {_touching(trip.pair)} {_going(trip.pair)} {cause}"


def _lost(trip: Trip, plan: Plan, time: float) -> str:
    what = f"the position of {trip.party} at {time:.6g} s is not a number."
    if trip.pair is None:
        return f"{what} It touches nothing: look at the velocity and spin it was given, or compute with precision f64."
    cause = _step_or_speed(trip.pair, plan, trip.time_step) or _lower(
        trip.time_step, "Likely this contact was integrated too coarsely"
    )
    return f"{what} {_touching(trip.pair)} {cause}"


def _left(trip: Trip, plan: Plan, time: float) -> str:
    where = plan.scene.where("domain", "leaving")
    name, _, rest = str(trip.party).partition(" (")
    x, y, z = trip.party.position or (0.0, 0.0, 0.0)
    return (
        f"{name} at {time:.6g} s is outside the domain, and domain.leaving is error ({where}); "
        f"it is at [{x:.4g}, {y:.4g}, {z:.4g}] m ({rest}. "
        "Close the gap in the walls, widen the domain, or write delete."
    )


def _wall(trip: Trip, plan: Plan, time: float) -> str:
    kind = next(drive.kind for drive in plan.drives if trip.party.name == f"wall {drive.name}")
    remedy = "lower its velocity_max" if kind == "servo" else "give it more mass or damping"
    return (
        f"{trip.party} at {time:.6g} s moved {trip.party.speed * trip.time_step:.3g} m in one step, with a skin of "
        f"{plan.skin:.3g} m: {remedy}, or set run.velocity_max to {SPARE_SPEED * trip.party.speed:.3g} m/s."
    )


def _touching(pair: Pair) -> str:
    return f"Before that step {pair.first} and {pair.second} overlapped by {pair.overlap:.3g} of the smaller radius."


def _going(pair: Pair) -> str:
    if not isfinite(pair.approach):
        return ""
    return f"They {'approach' if pair.approach >= 0.0 else 'part'} at {abs(pair.approach):.3g} m/s."


def _step_or_speed(pair: Pair, plan: Plan, time_step: float) -> str | None:
    """The likely cause where it is a step too long, or an approach faster than planned for."""
    faster = f"set run.velocity_max to {SPARE_SPEED * pair.impact:.3g} m/s"
    if time_step > pair.stable_step:
        what = f"The time step {time_step:.3g} s is above the stable {pair.stable_step:.3g} s of this pair"
        return f"{what} at such an impact: lower run.time_step, or leave it out and {faster}."
    if pair.impact > plan.velocity_max:
        what = (
            f"Such an overlap takes an impact at {pair.impact:.3g} m/s, but {plan.velocity_max:.3g} m/s is planned for"
        )
        return f"{what}: {faster}, or look for what made them so fast."
    return None


def _lower(time_step: float, cause: str) -> str:
    return f"{cause}: lower run.time_step (now {time_step:.3g} s), or look for grains made on top of each other."


_REASONS = {"travel": _travel, "lost": _lost, "overlap": _overlap, "left": _left, "wall": _wall}
