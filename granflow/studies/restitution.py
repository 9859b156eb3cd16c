"""Given and simulated restitution of all material pairs of a scene, at its time step and precision.

`measure` is the study of `granflow restitution`: it simulates head-on collisions of all pairs in one run of
the collision bench, and `write_restitution` writes `restitution.csv` and `restitution.png`. `warnings` gives
the warnings of `granflow run` and `granflow check`: it integrates a few collisions with the reference
implementation of the contact model instead, which takes about 0.1 s and requires no compilation. Both
begin with the `pairings` of the scene.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any

import numpy as np

from granflow import Plan, Scene, plan_for
from granflow.contact.theory import LOSS_TOLERANCE, loss_error
from granflow.studies.bench import LONGEST, Collision, CollisionBench, Impact
from granflow.studies.figures import COLORS, MARKERS, POINTS, draw_to, write_columns


def pairings(plan: Plan) -> list[Collision]:
    """All pairs of materials that can be in contact in a scene, sphere pairs first, with their smallest radii
    [m].

    The collisions have no velocity yet.
    """
    scene = plan.scene
    smallest: dict[str, float] = {}
    for name, group in scene.particles.items():
        radius = 0.5 * plan.scene.particles[name].diameters[0]
        smallest[group.material] = min(radius, smallest.get(group.material, radius))
    walls = dict.fromkeys(wall.material for wall in scene.walls.values())
    spheres = [(a, b, smallest[b]) for a, b in combinations_with_replacement(smallest, 2)]
    combinations = [*spheres, *((a, b, None) for a in smallest for b in walls)]
    return [
        Collision(a, b, smallest[a], other, 0.0, share=1.0 if other is None else 0.5)
        for a, b, other in combinations
        if scene.pair_key(a, b) in scene.pairs
    ]


def name_of(pairing: Collision) -> str:
    """The two materials, followed by "wall" if the second is that of a wall."""
    return f"{pairing.first}-{pairing.second}" + (" wall" if pairing.other_radius is None else "")


# ---------------------------------------------------------------- on the device

VELOCITIES_PER_DECADE = 4
"""Velocities of the collisions per decade."""
DECADES = 3
"""Decades of velocity below the largest expected one."""
PHASES = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Phases of first contact within a time step."""
TOLERANCE = 0.01
"""Relative difference that is marked in the table."""
HEIGHT = 5.2
"""Height of the figure [inch]."""


@dataclass(frozen=True)
class RestitutionRow:
    """One pair at one velocity [m/s]: given restitution, and smallest and largest simulated value over the
    phases."""

    pair: str
    velocity: float
    requested: float
    min_reached: float
    max_reached: float

    @property
    def reached(self) -> float:
        """Smallest or largest simulated value, whichever differs more from the given one."""
        return max(self.min_reached, self.max_reached, key=lambda e: abs(e - self.requested))

    @property
    def difference(self) -> float:
        """Relative difference of simulated and given value; infinite if 0 is given and not reached."""
        if self.requested == 0.0:
            return 0.0 if self.reached == 0.0 else np.inf
        return self.reached / self.requested - 1.0


def measure(scene: Scene, arch: str = "cpu") -> tuple[list[RestitutionRow], float]:
    """Simulate head-on collisions of all material pairs of a scene at velocities up to the largest expected
    one.

    All collisions are at the far side of the domain, where single precision is coarsest; each velocity is
    repeated for several phases of first contact. The velocities span DECADES decades. Also returns the time
    step [s].

    Raises SceneError if the scene has no valid plan.
    """
    plan = plan_for(scene)
    pairs = pairings(plan)
    count = DECADES * VELOCITIES_PER_DECADE + 1
    velocities = plan.impact_velocity.value * np.logspace(-DECADES, 0, count)
    described = scene.model_dump(by_alias=True, exclude_none=True)
    for pair in described["pairs"].values():
        pair["friction"] = 0.0
        pair.pop("rolling_friction", None)
    bench = CollisionBench(
        materials=described["materials"],
        pairs=described["pairs"],
        contact=described["contact"] | {"tangential": "none", "rolling": "none"},
        collisions=[
            replace(pair, velocity=float(velocity), first_contact=phase * plan.time_step)
            for pair in pairs
            for velocity in velocities
            for phase in PHASES
        ],
        run={"duration": 1.0, "velocity_max": plan.impact_velocity.value, "precision": scene.run.precision},
        numerics={key: value for key, value in described["numerics"].items() if key != "max_overlap"},
        contact_x=float(np.abs([scene.domain.min, scene.domain.max]).max()),
        arch=arch,
    )
    with bench:
        # The bench has more contacts than the scene, which would limit a time step given in its scene.
        bench.restart(bench.collisions, plan.time_step)
        reached = bench.rebound().reshape(len(pairs), count, len(PHASES)) / velocities[:, None]
    rows = []
    for pair, per_velocity in zip(pairs, reached, strict=True):
        for velocity, found in zip(velocities, per_velocity, strict=True):
            requested = _impact(plan, pair, velocity).requested
            extremes = float(found.min()), float(found.max())
            rows.append(RestitutionRow(name_of(pair), float(velocity), requested, *extremes))
    return rows, plan.time_step


def restitution_rows(rows: Sequence[RestitutionRow]) -> list[tuple[str, str, str, str, str]]:
    """Table rows: pair, velocity [m/s], given restitution, simulated restitution, difference in percent."""
    found = []
    for before, row in zip([None, *rows], rows, strict=False):
        name = row.pair if before is None or before.pair != row.pair else ""
        difference = f"{100.0 * row.difference:+.3f}" + (" *" if abs(row.difference) > TOLERANCE else "")
        found.append((name, f"{row.velocity:.4g}", f"{row.requested:.5f}", f"{row.reached:.5f}", difference))
    return found


def write_restitution(out: Path, rows: Sequence[RestitutionRow], title: str) -> None:
    """Write `restitution.csv`, then `restitution.png`. Raises GranflowError if matplotlib is not
    installed."""
    out.mkdir(parents=True, exist_ok=True)
    names = ("pair", "velocity", "requested", "min_reached", "max_reached", "difference")
    write_columns(
        out / "restitution.csv", {name: np.array([getattr(row, name) for row in rows]) for name in names}
    )
    draw_to(out / "restitution.png", lambda figure: _draw(figure, rows, title), HEIGHT)


LEAST_RANGE = 0.05
"""Smallest range of the restitution coefficient in the figure: a constant one does not fill it with rounding
errors."""


def _draw(figure: Any, rows: Sequence[RestitutionRow], title: str) -> None:
    """Plot restitution (top) and difference in percent (bottom) against velocity; bars span the phases."""
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    below.axhspan(-100.0 * TOLERANCE, 100.0 * TOLERANCE, color="0.93", zorder=0)
    for number, name in enumerate(dict.fromkeys(row.pair for row in rows)):
        is_pair = [row for row in rows if row.pair == name]
        velocity, requested, min_reached, max_reached = (
            np.array([getattr(row, key) for row in is_pair])
            for key in ("velocity", "requested", "min_reached", "max_reached")
        )
        color = COLORS[number % len(COLORS)]
        middle = 0.5 * (min_reached + max_reached)
        half = 0.5 * (max_reached - min_reached)
        style = POINTS | {"marker": MARKERS[number % len(MARKERS)], "color": color}
        above.semilogx(velocity, requested, color=color)
        above.errorbar(velocity, middle, half, label=name, **style)
        known = requested > 0.0
        percent = 100.0 / requested[known]
        below.errorbar(velocity[known], (middle - requested)[known] * percent, half[known] * percent, **style)
    low, high = above.get_ylim()
    margin = max(0.0, 0.5 * (LEAST_RANGE - (high - low)))
    above.set_ylim(low - margin, high + margin)
    above.set(ylabel="restitution coefficient $e$", title=f"{title}: given (lines) and simulated (points)")
    above.legend(loc="best", title="bars: phases of the first step")
    below.set(xlabel="approach velocity $v$ [m/s]", ylabel="relative difference [%]")


# ---------------------------------------------------------------- with the reference implementation

QUICK_VELOCITIES = (1.0, 0.3, 0.1)
"""Velocities of the warning relative to the largest velocity, in the order of evaluation."""
QUICK_PHASES = (0.25, 0.75)
"""Phases of first contact within a time step for the warning."""
QUICK_STEPS = 8000
"""Maximum number of steps of the reference implementation for the warning."""
FINE_STEPS = 100
"""Steps per collision with which the warning begins if the time step is smaller: smaller steps are more
accurate."""
HALVINGS = 6
"""Number of halvings in the search for a sufficient time step (down to 1/64)."""


def estimates(plan: Plan) -> Iterator["Estimate"]:
    """The collision of each material pair whose lost energy differs most from that of the given restitution.

    Collisions that cannot occur, and collisions for which the plan has a warning already, are excluded.
    QUICK_STEPS limits the total number of steps of all collisions.
    """
    scene = plan.scene
    worst: dict[str, Estimate] = {}
    steps = 0
    for pair in pairings(plan):
        if not _occurs(scene, pair):
            continue
        found: list[Estimate] = []
        for share in QUICK_VELOCITIES:
            impact = _impact(plan, pair, share * plan.impact_velocity.value)
            steps += len(QUICK_PHASES) * int(impact.duration / plan.time_step)
            if steps > QUICK_STEPS or _unreachable(plan, impact):
                break
            found.append(Estimate(name_of(pair), impact, _simulated(plan, impact)))
        key = scene.pair_key(pair.first, pair.second)
        for each in found:
            if key not in worst or each.error > worst[key].error:
                worst[key] = each
    yield from worst.values()


def warnings(plan: Plan) -> list[str]:
    """Warnings for all material pairs whose collisions lose another energy than with the given restitution.

    Each describes the collision of the pair with the largest error, if that is above LOSS_TOLERANCE, and a
    sufficient time step [s] if one is found.
    """
    return [_sentence(plan, each) for each in estimates(plan) if each.error > LOSS_TOLERANCE]


def remarks(plan: Plan) -> list[str]:
    """One sentence for each material pair: its restitution at the time step of the plan."""
    return [
        f"{each.name}: the restitution is {each.reached:.4g} in place of {each.impact.requested:.4g} at "
        f"{each.impact.velocity:.3g} m/s; the energy lost in this collision has an error of {each.error:.1%}."
        for each in estimates(plan)
    ]


def _occurs(scene: Scene, pair: Collision) -> bool:
    """Whether the collision is possible: not for two fixed particles, nor for a single particle with
    itself."""
    groups = [group for group in scene.particles.values() if group.material in (pair.first, pair.second)]
    mobile = {group.material for group in groups if not group.fixed}
    if pair.other_radius is None:
        return pair.first in mobile
    return bool(mobile) and (pair.first != pair.second or sum(group.count for group in groups) > 1)


@dataclass(frozen=True)
class _Impact:
    """One collision: arguments of the contact model, given restitution, and expected duration [s]."""

    arguments: Impact
    requested: float
    duration: float

    @property
    def velocity(self) -> float:
        """Approach velocity [m/s]."""
        return self.arguments[3]


@dataclass(frozen=True)
class Estimate:
    """A collision at the time step of a plan: the material pair, and its simulated restitution."""

    name: str
    impact: _Impact
    reached: float

    @property
    def error(self) -> float:
        """Relative error of the lost energy."""
        return loss_error(self.reached, self.impact.requested)


def _impact(plan: Plan, pair: Collision, velocity: float) -> _Impact:
    """Collision of a pair at an approach velocity [m/s] with the properties of the contact model."""
    arguments = (plan.pair(pair.first, pair.second), *pair.reduced(plan.scene), velocity)
    return _Impact(
        arguments, plan.laws.normal.restitution(*arguments), sum(plan.laws.normal.phase_durations(*arguments))
    )


def _unreachable(plan: Plan, impact: _Impact) -> bool:
    """Whether the given restitution is 0 or below the minimum of the time step, for which the plan has a
    warning."""
    if not plan.laws.normal.limits_restitution or impact.requested == 0.0:
        return impact.requested == 0.0
    return impact.requested < plan.laws.normal.least_restitution(*impact.arguments, plan.time_step)


def _simulated(plan: Plan, impact: _Impact) -> float:
    """Simulated restitution; that of FINE_STEPS for a finer time step, if its error is within a fifth of
    LOSS_TOLERANCE."""
    fine = impact.duration / FINE_STEPS
    if plan.time_step < fine:
        reached = _worst_restitution(plan, impact, fine)
        if loss_error(reached, impact.requested) <= 0.2 * LOSS_TOLERANCE:
            return reached
    return _worst_restitution(plan, impact, plan.time_step)


def _worst_restitution(plan: Plan, impact: _Impact, step: float) -> float:
    """Reference restitution that differs most from the given one, over QUICK_PHASES of a time step [s]."""
    found = [_reference_restitution(plan, impact, step, phase) for phase in QUICK_PHASES]
    return max(found, key=lambda e: abs(e - impact.requested))


def _reference_restitution(plan: Plan, impact: _Impact, step: float, phase: float) -> float:
    """Restitution of one collision with the reference implementation, in the leapfrog scheme of the device.

    `step` [s]; `phase`: time of first contact before the first force, over the step. 0 if the spheres stick.
    """
    law = plan.laws.normal
    material, radius_eff, mass, velocity = impact.arguments
    constants = np.array(law.pair_constants(material))
    history = np.zeros(max(law.history_count, 1))
    rate = velocity
    rate_now = velocity
    overlap = phase * rate * step
    for _ in range(int(LONGEST * impact.duration / step)):
        rate_seen = rate_now if law.rate_dependent else rate
        force, history = law.reference_force(constants, radius_eff, mass, step, overlap, rate_seen, history)
        kick = force / mass * step
        rate -= kick
        rate_now = rate - 0.5 * kick
        overlap += step * rate
        if rate < 0.0 and (overlap <= 0.0 or force == 0.0):
            return -rate / velocity
    return 0.0


def _sentence(plan: Plan, estimate: "Estimate") -> str:
    """Warning with the given and the simulated restitution, and the remedy."""
    impact = estimate.impact
    remedy = next(_remedies(plan, impact), None)
    advice = f"Use {plan.step.remedy(remedy)}." if remedy else "A smaller time step reduces the difference."
    return (
        f"{estimate.name}: the given restitution is {impact.requested:.4g} at {impact.velocity:.3g} m/s, but "
        f"the time step of {plan.time_step:.3g} s results in {estimate.reached:.4g}, which changes the "
        f"energy lost in a collision by {estimate.error:.0%}. {advice}"
    )


def _remedies(plan: Plan, impact: _Impact) -> Iterator[float]:
    """Time steps [s], successively halved, at which the error of the lost energy is within the tolerance."""
    for halvings in range(1, HALVINGS + 1):
        step = plan.time_step / 2.0**halvings
        if loss_error(_worst_restitution(plan, impact, step), impact.requested) <= LOSS_TOLERANCE:
            yield step
