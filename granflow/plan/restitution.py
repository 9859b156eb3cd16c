"""Given restitution of the material pairs of a scene, and that which the time step of its plan results in.

`restitution_warnings` are those of `granflow check`, and of runs and programs that write files. They
integrate a few collisions with the reference implementation of the contact model, which takes about 0.1 s and
requires no compilation. The study of `granflow restitution` simulates the collisions of the same `pairings`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from granflow.contact.material import PairMaterial
from granflow.contact.theory import LOSS_TOLERANCE, loss_error
from granflow.geometry.sphere import sphere_mass
from granflow.load import Scene
from granflow.plan.plan import Plan

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
LONGEST = 20.0
"""Maximum length of a collision in units of its expected duration; longer collisions count as sticking."""


def restitution_warnings(plan: Plan) -> list[str]:
    """Warnings for all material pairs whose collisions lose another energy than with the given restitution.

    Each describes the collision of the pair with the largest error, if that is above LOSS_TOLERANCE, and a
    sufficient time step [s] if one is found.
    """
    return [_sentence(plan, each) for each in estimates(plan) if each.error > LOSS_TOLERANCE]


def restitution_remarks(plan: Plan) -> list[str]:
    """One sentence for each material pair: its restitution at the time step of the plan."""
    return [
        f"{each.name}: the restitution is {each.reached:.4g} in place of {each.impact.requested:.4g} at "
        f"{each.impact.velocity:.3g} m/s; the energy lost in this collision has an error of {each.error:.1%}."
        for each in estimates(plan)
    ]


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
            impact = impact_of(plan, pair, share * plan.impact_velocity.value)
            steps += len(QUICK_PHASES) * int(impact.duration / plan.time_step)
            if steps > QUICK_STEPS or _unreachable(plan, impact):
                break
            found.append(Estimate(name_of(pair), impact, _simulated(plan, impact)))
        key = scene.pair_key(pair.first, pair.second)
        for each in found:
            if key not in worst or each.error > worst[key].error:
                worst[key] = each
    yield from worst.values()


# Pairs of materials that can collide

Impact = tuple[PairMaterial, float, float, float]
"""Arguments of contact models: pair of materials, effective radius [m] and mass [kg], approach velocity
[m/s]."""


@dataclass(frozen=True)
class Collision:
    """One collision of a sphere with another sphere or with a wall, in SI units.

    first, second:   names of the materials
    radius:          of the first sphere
    other_radius:    of the second sphere; None for a wall
    velocity:        approach velocity; `share` of it is that of the first sphere, 1 toward a wall
    along, spin:     velocity of the first sphere along y, and angular velocity about -z; the surface of the
                     sphere slides at the velocity along - radius * spin
    first_contact:   time of first contact
    """

    first: str
    second: str
    radius: float
    other_radius: float | None
    velocity: float
    share: float = 0.5
    along: float = 0.0
    spin: float = 0.0
    first_contact: float = 0.0

    def reduced(self, scene: Scene) -> tuple[float, float]:
        """Effective radius [m] and mass [kg]; a wall has infinite radius and mass."""
        mass = sphere_mass(self.radius, scene.materials[self.first].density)
        if self.other_radius is None:
            return self.radius, mass
        other = sphere_mass(self.other_radius, scene.materials[self.second].density)
        radius_eff = self.radius * self.other_radius / (self.radius + self.other_radius)
        return radius_eff, mass * other / (mass + other)


def pairings(plan: Plan) -> list[Collision]:
    """All pairs of materials that can be in contact in a scene, sphere pairs first, with their smallest radii
    [m].

    Fixed particles count only for a material without mobile ones: a mobile particle hits one of infinite mass
    for longer than its like. The collisions have no velocity yet.
    """
    scene = plan.scene
    groups = scene.particles.values()
    mobile = {group.material for group in groups if not group.fixed}
    smallest: dict[str, float] = {}
    for group in groups:
        if not group.fixed or group.material not in mobile:
            radius = 0.5 * group.diameters[0]
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


def impact_of(plan: Plan, pair: Collision, velocity: float) -> _Impact:
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
    found = [reference_restitution(plan, impact, step, phase) for phase in QUICK_PHASES]
    return max(found, key=lambda e: abs(e - impact.requested))


def reference_restitution(plan: Plan, impact: _Impact, step: float, phase: float) -> float:
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
