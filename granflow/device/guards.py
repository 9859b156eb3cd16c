"""Guards: their codes, and what to say when one stops a run: who is at fault, when, likely why, what to change."""

from dataclasses import dataclass
from math import hypot, isfinite

from granflow.plan import Plan
from granflow.plan.resolution import COARSEST, spacing_at
from granflow.plan.travel import remedy, share_of

GUARD_TRAVEL, GUARD_LOST, GUARD_OVERLAP, GUARD_LEFT, GUARD_WALL, GUARD_FAR = 1, 2, 3, 4, 5, 6
"""Codes: a particle above the largest distance per step, a position that is not a number, an overlap above the limit,
(set by the host) a particle outside a domain with `leaving: error`, a driven wall above it, (set by the
host) a particle so far from the origin that the precision does not resolve its position."""

GUARDS = {
    GUARD_TRAVEL: "travel", GUARD_LOST: "lost", GUARD_OVERLAP: "overlap", GUARD_LEFT: "left", GUARD_WALL: "wall",
    GUARD_FAR: "far",
}  # fmt: skip

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


def guard_message(trip: Trip, plan: Plan, time: float) -> str:
    """A few sentences for a tripped guard: who and when, the number at fault, the likely cause, two remedies."""
    return f"Stopped: {_REASONS[trip.guard](trip, plan, time)}"


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
    what = _too_far(trip, plan, time, plan.travel_limit)
    if trip.pair is None:
        return f"{what} {remedy(plan.scene, trip.party.speed, SPARE_SPEED * trip.party.speed, plan.travel_limit)}"
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


def _far(trip: Trip, plan: Plan, time: float) -> str:
    precision, position = plan.scene.run.precision, trip.party.position or (0.0, 0.0, 0.0)
    farthest = max(map(abs, position))
    better = " Use --precision mixed, or" if precision == "f32" else " Use"
    return (
        f"{trip.party} at {time:.6g} s is {farthest:.4g} m from the origin along an axis, where {precision} resolves "
        f"positions only to {spacing_at(precision, farthest):.3g} m; needed is {COARSEST:g} of the smallest radius "
        f"{plan.radius_min:.3g} m.{better} an outlet, or domain.leaving: delete."
    )


def _wall(trip: Trip, plan: Plan, time: float) -> str:
    kind = next(drive.kind for drive in plan.drives if trip.party.name == f"wall {drive.name}")
    slower = "Lower its velocity_max." if kind == "servo" else "Give it more mass or damping."
    limit = plan.wall_travel_limit
    planned = SPARE_SPEED * trip.party.speed * plan.travel_limit / limit
    return f"{_too_far(trip, plan, time, limit)} {slower} {remedy(plan.scene, trip.party.speed, planned, limit)}"


def _too_far(trip: Trip, plan: Plan, time: float, limit: float) -> str:
    moved = trip.party.speed * trip.time_step
    return (
        f"{trip.party} at {time:.6g} s moves {moved:.3g} m in one step of {trip.time_step:.3g} s, above the limit of "
        f"{limit:.3g} m ({share_of(limit, plan.radius_min)}): beyond it contacts can be missed."
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


_REASONS = {"travel": _travel, "lost": _lost, "overlap": _overlap, "left": _left, "wall": _wall, "far": _far}
