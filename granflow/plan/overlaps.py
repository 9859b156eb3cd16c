"""Largest overlaps of a run: in impacts, and at rest under the weight, walls and cohesion.

A forecast finds the pair of bodies with the largest overlap for one cause: an impact at the forecast
velocity, a static load, or the attraction alone. The overlap of a pair follows from the reference
implementation of its contact model. If it is above the limit, the forecast is a warning with the Young's
moduli that keep it below. The advice of an aborted run uses the same functions.

The second part finds overlaps where particles start: of particles with each other, and of particles and
insertion regions with walls. A run with such an overlap would stop in its first step.
"""

from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from math import log, pi
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np

from granflow.contact.law import ContactState, Law
from granflow.contact.material import Solid
from granflow.contact.registry import ContactLaws
from granflow.errors import SceneError
from granflow.geometry.close_pairs import near_pairs
from granflow.geometry.region import RegionSampler
from granflow.geometry.sphere import sphere_volume
from granflow.load import Scene
from granflow.particles.group import ParticleData, SceneGroup
from granflow.plan.pair_case import PairCase
from granflow.plan.plan import Cause, Forecast, Plan
from granflow.plan.stages import StageTimes, nominal_times
from granflow.plan.time_step import ImpactVelocity
from granflow.plan.wall_control import section
from granflow.plan.walls import PlannedWall
from granflow.scene.blocks.domain import Domain
from granflow.scene.blocks.motions import poses_at
from granflow.scene.blocks.particles import Group
from granflow.scene.blocks.run import LARGEST_OVERLAP

# One contact: its largest overlap in an impact and under a static load.

STEPS_OF_LOADING = 200
"""Steps of the integration of an impact in its loading time; the error of the overlap is below 0.1 %."""
MAX_LOADING_TIMES = 5
"""Longest integration in loading times: with an attraction the loading lasts longer than without."""
MAX_OVERLAP_SHARE = 2.0
"""Largest overlap, over the smaller radius, of the search for a static overlap."""
BISECTIONS = 30
"""Halvings of the interval in which a static overlap lies: resolves it to 2e-9 of the radius."""


class ContactForces:
    """Force of the normal and the cohesion model of a pair, by their reference implementations; keeps the
    history.

    `time_step` [s]: for which models average their damping. At rest, an inelastic contact (restitution 0)
    carries any load up to the loading curve, which does not depend on the restitution: it is evaluated for
    the restitution 1.
    """

    def __init__(self, laws: ContactLaws, pair: PairCase, time_step: float) -> None:
        self.laws: list[tuple[float, Law]] = [(1.0, laws.normal)]
        self.laws += [(-1.0, laws.cohesion)] if laws.cohesion is not None else []
        self.pair = pair
        self.time_step = time_step
        self.reset()
        loading = replace(pair.pair, restitution=1.0) if pair.pair.restitution == 0.0 else pair.pair
        self.constants = [
            SimpleNamespace(**dict(zip(law.constant_names, law.pair_constants(loading), strict=False)))
            for _, law in self.laws
        ]

    def reset(self) -> None:
        """Begin a new contact."""
        self.history = [dict.fromkeys(law.history_names, 0.0) for _, law in self.laws]

    def parts(self, overlap: float, rate: float) -> list[float]:
        """Normal force [N], and minus the attraction of the cohesion model if there is one.

        `overlap` [m], `rate` [m/s]: overlap rate, positive during approach.
        """
        forces = []
        for index, (sign, law) in enumerate(self.laws):
            state = ContactState(
                self.constants[index],
                self.pair.radius_eff,
                self.pair.mass_eff,
                self.time_step,
                overlap,
                rate,
                SimpleNamespace(**self.history[index]),
            )
            force, changed = law.reference(state)  # type: ignore[attr-defined]
            self.history[index] |= changed
            forces.append(sign * float(force))
        return forces

    def total(self, overlap: float, rate: float) -> float:
        """Repulsive force [N], negative if the attraction is larger."""
        return sum(self.parts(overlap, rate))


def impact_overlap(laws: ContactLaws, pair: PairCase, velocity: float, enough: float = 0.0) -> float:
    """Largest overlap over the smaller radius of a head-on impact at `velocity` [m/s].

        M d'' = -F(d, d'),     d(0) = 0,     d'(0) = v,     until d' = 0

    by leapfrog, unless the closed form is below `enough`: without attraction it is an upper bound. For
    elastic loading the energy balance gives d = (5 M v^2 / (4 k))^(2/5) with k = (4/3) E sqrt(R) (Hertz 1882;
    Zhou 2011, Eq. 5); viscous forces lower it, attractions raise it.
    """
    arguments = (pair.pair, pair.radius_eff, pair.mass_eff, velocity)
    elastic = laws.normal.overlap_max(*arguments) / pair.overlap_radius
    if elastic <= enough and not laws.attracts:
        return elastic
    step = laws.normal.phase_durations(*arguments)[0] / STEPS_OF_LOADING
    forces = ContactForces(laws, pair, step)
    overlap = 0.5 * step * velocity
    rate = velocity
    for _ in range(MAX_LOADING_TIMES * STEPS_OF_LOADING):
        rate -= step * forces.total(overlap, rate) / pair.mass_eff
        if rate <= 0.0:
            break
        overlap += step * rate
    return overlap / pair.overlap_radius


def impact_velocity(laws: ContactLaws, pair: PairCase, overlap: float, approach: float) -> float:
    """Velocity [m/s] of an impact that has reached `overlap` [m] and approaches at `approach` [m/s], without
    losses.

        v^2 = approach^2 + (2 / M) int_0^d F(x, 0) dx     e.g. (4/5) (k/M) d^2.5, k = (4/3) E sqrt(R) (Hertz
        1882)

    The work of attractions, which act before contact too, is not included.
    """
    width = overlap / STEPS_OF_LOADING
    forces = ContactForces(laws, pair, 1.0)
    work = width * sum(forces.parts((k + 0.5) * width, 0.0)[0] for k in range(STEPS_OF_LOADING))
    return float(np.hypot(approach, np.sqrt(2.0 * work / pair.mass_eff)))


def static_overlap(laws: ContactLaws, pair: PairCase, load: float) -> float:
    """Overlap over the smaller radius at which a contact carries `load` [N] at rest; 2 if no smaller one
    does.

        F(d, 0) = load       e.g. d = (load / k)^(2/3), k = (4/3) E sqrt(R), without attraction (Hertz 1882)

    The contact has no history: it is loaded for the first time.
    """
    forces = ContactForces(laws, pair, 1.0)

    def excess(overlap: float) -> float:
        forces.reset()
        return forces.total(overlap, 0.0) - load

    low = 0.0
    high = MAX_OVERLAP_SHARE * pair.overlap_radius
    if excess(high) < 0.0:
        return MAX_OVERLAP_SHARE
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if excess(middle) > 0.0:
            high = middle
        else:
            low = middle
    return high / pair.overlap_radius


def attraction_share(laws: ContactLaws, pair: PairCase, overlap: float) -> float:
    """Attraction over normal force at an overlap [m] at rest; 0 without a cohesion model."""
    if laws.cohesion is None:
        return 0.0
    normal, attraction = ContactForces(laws, pair, 1.0).parts(overlap, 0.0)
    return float(-attraction / normal) if normal > 0.0 else np.inf


# The pairs of bodies of a plan that can be in contact.

SUPPORTED_RATIO = 3.0
"""Smallest ratio of radii at which a particle hits small ones as a bed: particles of similar size move each
other."""
SHALLOW = 0.5
"""Largest depth of a bed that supports its particles, over the radius of the large particle.

In runs with a bed of 2.3 mm (1 mm particles of 10 MPa, 0.3 m/s), a particle of 5 mm overlaps by 0.06 of the
small radius, 0.3 times the value for a supported bed; those of 10 and 20 mm by 0.16 and 0.46, 0.4 and 0.8
times this value.
"""
LAYER_FRACTION = 0.8
"""Share of an area that a layer of spheres covers."""


def touching_pairs(plan: Plan) -> Iterator[PairCase]:
    """All pairs of groups, and of groups and wall materials, with the sizes of the largest relative overlaps.

    Two groups: smallest and largest sizes in all combinations, because the overlap refers to the smaller
    particle, and a small one that hits a large one overlaps most. Walls have an infinite radius and mass, as
    have fixed particles concerning their mass.
    """
    for index, group in enumerate(plan.groups):
        for other in plan.groups[index:]:
            if _collide(plan, group, other):
                for sizes in dict.fromkeys(product(group.spec.diameters, other.spec.diameters)):
                    yield _of_particles(plan, group, other, sizes)
        touched = [wall for wall in plan.walls if wall.spec.holds(group.name)]
        walls = dict.fromkeys(plan.materials[wall.material] for wall in touched)
        for wall in walls if not group.spec.fixed else ():
            yield _of_wall(plan, group, wall)


def supported_pairs(plan: Plan) -> Iterator[tuple[PairCase, float]]:
    """Pairs of a particle and of much smaller ones in a shallow bed below it, and the weight [N] on one of
    these.

    A bed is shallow if it is not deeper than SHALLOW times the radius R of the large particle; small ones,
    radius r, in a deeper bed give way. The floor supports those in a shallow bed. At the overlap limit d the
    large particle, mass M, touches those within the radius a of its contact area,

        N = phi a^2 / r^2,   a^2 = 2 R d,     at least 1

    each of which carries M |g| / N. An impact compresses 2 N contacts, those with the large particle and
    those below: for each the effective mass is M / (2 N). Without gravity there is no bed.
    """
    magnitude = plan.scene.largest_gravity
    mobile = {name: each for name, each in plan.scene.particles.items() if not each.fixed}
    for large, small in product(plan.groups, plan.groups):
        if large.spec.fixed or small.spec.fixed or not magnitude or not _collide(plan, large, small):
            continue
        radius = 0.5 * max(large.spec.diameters)
        radius_small = 0.5 * min(small.spec.diameters)
        count = max(2.0 * LAYER_FRACTION * radius * plan.scene.numerics.intended_overlap / radius_small, 1.0)
        if radius < SUPPORTED_RATIO * radius_small or small.spec.count <= count:
            continue
        below = {name: each for name, each in mobile.items() if 0.5 * max(each.diameters) < radius}
        depth = solid_volume(below) / (SOLID_FRACTION * weight_pressure(plan.scene)[1])
        if depth > SHALLOW * radius:
            continue
        pair = _of_particles(plan, large, small, (2.0 * radius, 2.0 * radius_small))
        mass = _mass(plan, large, radius)
        name = f"particles of {large.name} on the smallest of {small.name}"
        supported = replace(pair, name=name, mass_eff=max(mass / (2.0 * count), pair.mass_eff))
        yield supported, magnitude * mass / count


def _collide(plan: Plan, group: SceneGroup, other: SceneGroup) -> bool:
    """Whether particles of two groups can be in contact."""
    alone = group is other and group.spec.count < 2
    materials = (group.spec.material, other.spec.material)
    return not alone and not (group.spec.fixed and other.spec.fixed) and materials in plan.pair_materials


def _of_particles(plan: Plan, group: SceneGroup, other: SceneGroup, sizes: tuple[float, float]) -> PairCase:
    """Two particles with the diameters `sizes` [m]; a fixed one has an infinite mass."""
    radii = np.array(sizes) / 2.0
    materials = (group.spec.material, other.spec.material)
    inverse_mass = 0.0
    for each, radius in zip((group, other), radii, strict=True):
        if not each.spec.fixed:
            inverse_mass += 1.0 / _mass(plan, each, radius)
    names = group.name if group is other else f"{group.name} and {other.name}"
    return PairCase(
        name=f"particles of {names}",
        materials=materials,
        pair=plan.pair_materials[materials],
        radius_eff=float(1.0 / (1.0 / radii).sum()),
        mass_eff=float(1.0 / inverse_mass),
        radius=float(radii[0]),
        overlap_radius=float(radii.min()),
        solid=group.material,
    )


def _of_wall(plan: Plan, group: SceneGroup, wall: str) -> PairCase:
    """A particle at a wall of the material `wall`; the relative overlap does not depend on its size
    (Hertz)."""
    radius = 0.5 * group.spec.diameters[0]
    materials = (group.spec.material, wall)
    name = f"particles of {group.name} and walls of {wall}"
    mass = _mass(plan, group, radius)
    pair = plan.pair_materials[materials]
    return PairCase(name, materials, pair, radius, mass, radius, radius, group.material)


def _mass(plan: Plan, group: SceneGroup, radius: float) -> float:
    """Mass [kg] that moves with a sphere of a group with a radius [m]: that of the particle."""
    return group.spec.shape.mass_of_sphere(radius, group.density)


# Static pressures of the weight of the bed and of force-controlled walls, and their contact forces.

SOLID_FRACTION = 0.6
"""Solid fraction of a settled bed of spheres."""
COORDINATION = 6.0
"""Mean number of contacts of a sphere: 6 in an isostatic packing without friction, 4 to 6 with friction."""
FORCE_DECAY = 1.5
"""Decay beta of the distribution of contact forces over their mean, P(f) ~ exp(-beta f) for f > 1.

(D. M. Mueth, H. M. Jaeger & S. R. Nagel, Phys. Rev. E 57 (1998) 3164: beta = 1.5 +- 0.1.)
"""
SAMPLED_DIAMETERS = 1000
"""Number of diameters of which the mean mass of a group is computed; lists have one diameter per particle."""


def mean_force(pressure: float, diameter: float) -> float:
    """Mean normal force [N] in a packing of equal spheres under a pressure [Pa].

    F = pi d^2 p / (phi Z)      (H. Rumpf, Chem. Ing. Tech. 42 (1970) 538)
    """
    return pi * diameter**2 * pressure / (SOLID_FRACTION * COORDINATION)


def packing_stiffness(plan: Plan, pressure: float, axes: int) -> float:
    """Change of the pressure [Pa] along an axis over the strain of a packing under a pressure [Pa], if the
    strains of `axes` of the three axes are equal and the others 0; 0 without contacts.

        K = phi Z k / (pi R) (2 + axes) / 10        k = dF/d(overlap) at the mean force F

    All contacts follow the strain, in all directions alike: with central forces, C11 = 3 C12 = 0.3 phi Z k /
    (pi R) (K. Walton, J. Mech. Phys. Solids 35 (1987) 213). Real packings are softer, with friction stiffer.
    """
    found = [0.0]
    for pair in touching_pairs(plan):
        force = mean_force(pressure, 2.0 * pair.overlap_radius)
        low, high = (static_overlap(plan.laws, pair, share * force) for share in (0.99, 1.01))
        if low < high:
            found.append(0.02 * force / ((high - low) * pair.overlap_radius) / pair.overlap_radius)
    return SOLID_FRACTION * COORDINATION / pi * 0.1 * (2.0 + axes) * max(found)


PressureKind = Literal["weight", "wall", "box"]
_OF_PRESSURE = {"weight": "the weight", "wall": "a wall", "box": "the box"}


@dataclass(frozen=True)
class BedPressure:
    """A pressure [Pa] in the bed at rest, its cause in words, and the number of contacts that carry it.

    whole_force:  force [N] of a wall on a single particle, which carries all of it; None for a bed
    """

    kind: PressureKind
    cause: str
    pressure: float
    contact_count: float
    whole_force: float | None = None

    def largest_force(self, diameter: float) -> float:
        """Largest contact force [N] of spheres with a diameter [m].

            F = f F_mean,      f = ln(2 N) / beta

        Of N forces with the tail exp(-beta f), the largest is about ln(2 N) / beta times the mean.
        """
        mean = mean_force(self.pressure, diameter)
        return max(log(2.0 * self.contact_count) / FORCE_DECAY, 1.0) * mean

    def force_on(self, pair: PairCase) -> float:
        """Largest contact force [N] of a pair: the pressure acts on its smaller particle."""
        if self.whole_force is not None:
            return self.whole_force
        return self.largest_force(2.0 * pair.overlap_radius)


def bed_pressures(plan: Plan) -> Iterator[BedPressure]:
    """The pressures of a scene: the weight of its particles, the walls that press on them, one for those with
    the same force and pressure, and the largest target pressure of a deforming box."""
    diameter = 2.0 * plan.radius_max
    count = sum(group.count for group in plan.scene.particles.values() if not group.fixed)
    weight, area = weight_pressure(plan.scene)
    if weight > 0.0:
        contacts = min(3.0 * count, max(3.0 * area / diameter**2, 1.0))
        yield BedPressure(
            "weight", f"the weight of the bed ({pressure_words(weight)} at its bottom)", weight, contacts
        )
    pressing: dict[str, tuple[list[str], float, float]] = {}
    for motion in plan.controlled_motions:
        area = motion.area_at(plan.walls) or section(plan.scene.domain, motion.direction)
        if motion.force > 0.0 and count > 0:
            pressure = motion.force / area
            load = f"with {motion.force:.3g} N ({pressure_words(pressure)})"
            pressing.setdefault(load, ([], motion.force, pressure))[0].append(f"walls.{motion.name}")
    for load, (names, force, pressure) in pressing.items():
        which = "which presses" if len(names) == 1 else "each of which presses"
        cause = f"{', '.join(names)}, {which} {load}"
        yield BedPressure("wall", cause, pressure, 3.0 * count, force if count == 1 else None)
    targets = [
        (axis.pressure or 0.0, ".".join(map(str, path)))
        for path, deformation in plan.scene.deformations()
        for axis in deformation.by_axis.values()
    ]
    pressure, key = max(targets, key=lambda each: each[0], default=(0.0, ""))
    if pressure > 0.0 and count > 1:
        yield BedPressure("box", f"the {pressure_words(pressure)} of {key}", pressure, 3.0 * count)


def weight_pressure(scene: Scene) -> tuple[float, float]:
    """Pressure [Pa] of the weight of all mobile particles at the bottom of the bed, and the section of the
    bed [m2].

        p = |g| sum M_i / A_i,       at most 0.64 rho |g| H

    A lattice or a packing has the section A of its region, given positions that of their bounding box; other
    particles can fill the domain. With H, the height of the domain, and the density of the random close
    packing, the pressure is not above that of a full domain. The walls carry a part of the weight (Janssen
    1895), which is not considered: the pressure is an upper bound for a bed that keeps its section.
    """
    gravity = np.array(scene.usual_gravity)
    size = np.subtract(scene.domain.max, scene.domain.min)
    total = 0.0
    largest_section = 0.0
    densest = 0.0
    magnitude = float(np.linalg.norm(gravity))
    for group in scene.particles.values():
        if group.fixed or not magnitude:
            continue
        area = section_of(scene.domain, group, gravity / magnitude)
        density = scene.materials[group.material].density
        total += magnitude * group.count * mean_volume(group) * density / area
        largest_section = max(largest_section, area)
        densest = max(densest, density)
    return min(total, 0.64 * densest * float(np.abs(gravity) @ size)), largest_section


def section_of(domain: Domain, group: Group, down: np.ndarray) -> float:
    """Section [m2] of the region of a group across the unit vector `down`; that of the domain for other
    insertions."""
    if group.insert.points:
        x, y, z = np.ptp(np.array(group.insert.points), axis=0) + group.diameters[1]
        return float(np.abs(down) @ [y * z, z * x, x * y])
    place = group.insert.place
    region = None if place is None or group.insert.order is None else place.sampler
    return section(domain, down) if region is None else region.section(down)


def mean_volume(group: Group) -> float:
    """Mean volume [m3] of the particles of a group, of clumps or of a sample of at most SAMPLED_DIAMETERS
    spheres."""
    if group.shape.body is not None:
        return group.shape.body.volume
    if group.insert.defines_sizes:
        diameters = np.array(group.diameters)
    else:
        count = min(group.count, SAMPLED_DIAMETERS)
        diameters = group.sizes.sample(count, np.random.default_rng(0))
    return float(np.mean(sphere_volume(0.5 * diameters)))


def solid_volume(particles: Mapping[str, Group]) -> float:
    """Volume [m3] of all particles."""
    return sum(group.count * mean_volume(group) for group in particles.values())


# Remedies of overlaps that are too large: Young's moduli that keep them below the limit.

LARGEST_FACTOR = 1e12
"""Largest factor on the moduli that is searched; no modulus helps a model whose stiffness is given as a
number."""
HARDEST = 1.2e12
"""Young's modulus [Pa] of diamond: if more is required, a unit is probably wrong."""
MODULUS_MARGIN = 1.1
"""Recommended over required modulus: of rounding, and of several contacts at a time."""
FACTOR_BISECTIONS = 60
"""Bisections of the factor."""
Overlap = Callable[[PairCase], float]
"""Function from a pair to its largest relative overlap."""


def modulus_factor(pair: PairCase, overlap: Overlap, limit: float) -> float | None:
    """Smallest factor on the effective modulus at which the overlap is at most `limit`; None if no factor
    suffices.

    For Hertz contacts it is (d/limit)^(5/2) for an impact, and (d/limit)^(3/2) for a static load, because
    d ~ E^(-2/5) at a given energy and d ~ E^(-2/3) at a given force. Solved by bisection for any contact
    model.
    """
    low = 1.0
    high = LARGEST_FACTOR
    if overlap(pair.stiffer(high)) > limit:
        return None
    for _ in range(FACTOR_BISECTIONS):
        if high < 1.001 * low:
            break
        middle = (low * high) ** 0.5
        if overlap(pair.stiffer(middle)) > limit:
            low = middle
        else:
            high = middle
    return high


def without_modulus(pair: PairCase, overlap: Overlap) -> str:
    """Instruction for an overlap that no modulus reduces enough: the stiffness is a number, or a unit is
    wrong."""
    if overlap(pair.stiffer(LARGEST_FACTOR)) > 0.99 * overlap(pair):
        return "raise the stiffness of contact.normal"
    return (
        "check the units of densities, sizes, velocities and forces, because no Young's modulus is high "
        "enough"
    )


def required_moduli(
    solids: Mapping[str, Solid], materials: tuple[str, str], factor: float
) -> dict[str, float]:
    """Young's moduli [Pa] by material that raise the effective modulus of two materials by `factor`.

        1/E = (1 - nu1^2)/E1 + (1 - nu2^2)/E2

    Only the softer material changes if it stays softer than the other one; otherwise both get the same
    modulus. Rounded up to two digits, with MODULUS_MARGIN.
    """
    names = sorted(dict.fromkeys(materials), key=lambda name: solids[name].young_modulus)
    soft = solids[names[0]]
    hard = solids[names[-1]]
    of_soft = 1.0 - soft.poisson_ratio**2
    of_hard = 1.0 - hard.poisson_ratio**2
    target = (of_soft / soft.young_modulus + of_hard / hard.young_modulus) / (MODULUS_MARGIN * factor)
    both = (of_soft + of_hard) / target
    if both >= hard.young_modulus:
        return {name: rounded_up(both) for name in names}
    return {names[0]: rounded_up(of_soft / (target - of_hard / hard.young_modulus))}


def rounded_up(value: float) -> float:
    """A value rounded up to two digits."""
    text = f"{value:.1e}"
    return float(text) if float(text) >= value else float(f"{value * 1.05:.1e}")


def modulus_text(moduli: Mapping[str, float]) -> str:
    """Instruction that sets Young's moduli [Pa]: `set materials.rubber.young_modulus to 2.6e+07 Pa`."""
    highest = max(moduli.values(), default=0.0)
    if highest > HARDEST:
        return (
            "check the units of lengths, velocities, densities and forces: a modulus of "
            f"{pressure_words(highest)} would be required"
        )
    parts = [f"materials.{name}.young_modulus to {pressure_words(value)}" for name, value in moduli.items()]
    return f"set {' and '.join(parts)}"


def pressure_words(value: float) -> str:
    """A pressure or modulus [Pa] in GPa, MPa, kPa or Pa."""
    for unit, size in (("GPa", 1e9), ("MPa", 1e6), ("kPa", 1e3)):
        if value >= size:
            return f"{value / size:.3g} {unit}"
    return f"{value:.3g} Pa"


# The forecasts.

LIMIT_MARGIN = 1.3
"""Recommended overlap limit over a forecast overlap of two bodies: others press as well while a bed forms."""


def _forecast(
    plan: Plan,
    name: str,
    cause: Cause,
    pairs: Iterable[PairCase],
    overlap: Overlap,
    words: tuple[str, str],
    ends: tuple[str, str] = ("", "."),
    force: Callable[[PairCase], float] = lambda pair: 0.0,
) -> Forecast | None:
    """The pair with the largest overlap for one cause, with a warning and its remedy if the run would stop;
    None without pairs.

    words:  remark on the pair, and the verb of the warning up to the overlap
    ends:   what the warning proposes before and after the moduli that reduce the overlaps of all pairs to the
            limit
    force:  largest static contact force [N] of a pair
    """
    found = [(overlap(pair), pair) for pair in pairs]
    if not found:
        return None
    scene = plan.scene
    limit = scene.numerics.intended_overlap
    largest, pair = max(found, key=lambda each: each[0])
    amount = f"{largest:.3g} of the radius" if largest < 1.0 else "more than the radius"
    if cause in _OF_PRESSURE and largest < 1.0:
        amount = f"up to {amount}"
    warning = None
    if largest > limit:
        needed = float(f"{LIMIT_MARGIN * largest + 0.005:.2f}")
        accept = f", or set numerics.max_overlap to {needed:g} if such overlaps are intended"
        remedy = (
            f"{ends[0]}{_stiffer(plan, found, overlap, pair)}{accept if needed <= LARGEST_OVERLAP else ''}"
        )
        materials = {group.spec.material for group in plan.groups}
        of_groups = pair.materials[1] in materials and not pair.name.endswith(f"walls of {pair.materials[1]}")
        made_of = (
            f" ({' and '.join(dict.fromkeys(pair.materials))})" if of_groups and len(materials) > 1 else ""
        )
        warning = (
            f"{pair.name}{made_of}: {words[1]} {amount}; {_consequence(scene, largest)}. "
            f"{remedy[0].upper()}{remedy[1:]}{ends[1]}"
        )
    return Forecast(name, amount, f"{pair.name}{words[0]}", warning, cause, largest, force(pair))


def _consequence(scene: Scene, overlap: float) -> str:
    """Clause on what a run does at an overlap over the radius above the intended one."""
    numerics = scene.numerics
    if numerics.max_overlap != "auto":
        place = scene.where("numerics", "max_overlap")
        return f"the run stops above numerics.max_overlap {numerics.max_overlap:g} ({place})"
    if overlap > numerics.abort_overlap:
        return f"the run stops above {numerics.abort_overlap:g} (numerics.max_overlap: auto)"
    return f"contact forces become less accurate above {numerics.intended_overlap:g}"


def _stiffer(plan: Plan, found: Iterable[tuple[float, PairCase]], overlap: Overlap, worst: PairCase) -> str:
    """The instruction that reduces the overlaps of all pairs to the limit.

    The largest overlap of two materials usually needs the largest factor; for all smaller ones it is only
    verified.
    """
    limit = plan.scene.numerics.intended_overlap
    factors: dict[tuple[str, str], float] = {}
    for size, pair in sorted(found, key=lambda each: -each[0]):
        if size <= limit:
            break
        known = factors.get(pair.materials)
        if known is not None and overlap(pair.stiffer(known)) <= limit:
            continue
        factor = modulus_factor(pair, overlap, limit)
        if factor is None:
            return without_modulus(worst, overlap)
        factors[pair.materials] = max(factor, known or 1.0)
    moduli: dict[str, float] = {}
    for materials, factor in factors.items():
        for name, value in required_moduli(plan.scene.materials, materials, factor).items():
            moduli[name] = max(moduli.get(name, 0.0), value)
    return modulus_text(moduli)


def overlap_forecasts(plan: Plan, velocity: ImpactVelocity) -> Iterator[Forecast]:
    """The largest overlap for each cause that occurs: impacts at a velocity, cohesion alone, each load on the
    bed, and large particles on small ones.

    A warning of a load is omitted if cohesion alone exceeds the limit.
    """
    laws = plan.laws
    pairs = list(touching_pairs(plan))
    supported = list(supported_pairs(plan))
    weights = {pair.name: weight for pair, weight in supported}  # also of pairs with another modulus
    on_small = [pair for pair, _weight in supported]

    known: dict[tuple[Any, ...], float] = {}

    def impact(pair: PairCase) -> float:
        """Groups often differ in their name alone, and the integration of an impact takes milliseconds."""
        key = (*pair.materials, pair.pair.modulus_eff, pair.radius_eff, pair.mass_eff, pair.overlap_radius)
        if key not in known:
            enough = plan.scene.numerics.intended_overlap
            known[key] = impact_overlap(laws, pair, velocity.value, enough)
        return known[key]

    def unloaded(pair: PairCase) -> float:
        return static_overlap(laws, pair, 0.0)

    at = f"at {velocity.value:.3g} m/s ({velocity.source})"
    slower = ", or set run.velocity_max lower if all impacts are slower."
    words = (f" {at}", f"an impact {at} causes an overlap of")
    found = [
        _forecast(plan, "overlap of impacts", "impact", [*pairs, *on_small], impact, words, ("", slower))
    ]
    is_drawn = False
    if laws.cohesion is not None:
        lower = f"lower {' or '.join(laws.cohesion.constant_names)}, or "
        words = (", without load", "cohesion alone causes an overlap of")
        cohesive = _forecast(plan, "overlap by cohesion", "cohesion", pairs, unloaded, words, (lower, "."))
        is_drawn = cohesive is not None and cohesive.warning is not None
        found.append(cohesive)
    for load in bed_pressures(plan):
        name = f"overlap under {_OF_PRESSURE[load.kind]}"
        words = (f" under {load.cause}", f"under {load.cause} contacts overlap by")
        loaded = partial(_loaded_overlap, laws, load.force_on)
        each = _forecast(plan, name, load.kind, pairs, loaded, words, force=load.force_on)
        found.append(replace(each, warning=None) if each is not None and is_drawn else each)
    words = (", at rest", "under the weight of one particle the contacts below it overlap by")

    def weight(pair: PairCase) -> float:
        return weights[pair.name]

    carried = partial(_loaded_overlap, laws, weight)
    found.append(
        _forecast(plan, "overlap under a particle", "weight", on_small, carried, words, force=weight)
    )
    yield from (each for each in found if each is not None)


def _loaded_overlap(laws: ContactLaws, force: Callable[[PairCase], float], pair: PairCase) -> float:
    """Largest relative overlap of a pair under a static force [N], which depends on the pair."""
    return static_overlap(laws, pair, force(pair))


# Initial particles that overlap each other by more than the limit, with which a run would stop at its start.


def refuse_initial_overlaps(scene: Scene, particles: ParticleData) -> None:
    """Raise SceneError with the pair of the largest overlap if it exceeds `numerics.max_overlap`.

        (R_i + R_j - |x_i - x_j|) / min(R_i, R_j)

    Particles on lattices and in packings do not overlap: only scenes with positions or files are searched.
    Fixed particles overlap each other without a force, as do the spheres of one clump. Images across periodic
    faces are included.
    """
    if not any(each.insert.has_rows for each in scene.particles.values()):
        return
    spheres, radii, owners = _spheres_of(scene, particles)
    position, radius, sphere = scene.domain.periodic_box().images(spheres, radii)
    owner = owners[sphere]
    fixed = np.array([group.fixed for group in scene.particles.values()])[particles.group][owner]
    first, second = near_pairs(position, radius, 0.0)
    depth = radius[first] + radius[second] - np.linalg.norm(position[first] - position[second], axis=1)
    limit = scene.numerics.intended_overlap
    above = np.flatnonzero(
        (depth > limit * np.minimum(radius[first], radius[second]))
        & (np.minimum(first, second) < len(radii))  # pairs of two images are pairs of spheres too
        & (owner[first] != owner[second])
        & ~(fixed[first] & fixed[second])
    )
    if not len(above):
        return
    overlap = depth[above] / np.minimum(radius[first[above]], radius[second[above]])
    worst = above[overlap.argmax()]
    pair = sorted((int(first[worst]), int(second[worst])))
    names = [_name(scene, particles, int(owner[k]), position[k] - spheres[sphere[k]]) for k in pair]
    group = list(scene.particles)[particles.group[owner[pair[0]]]]
    count = len(np.unique(np.sort([owner[first[above]], owner[second[above]]], axis=0), axis=1).T)
    pairs = f"{count} pairs overlap" if count > 1 else "1 pair overlaps"
    raise SceneError(
        f"{scene.locate('particles', group)}: {' and '.join(names)} overlap by {overlap.max():.3g} of the "
        f"smaller radius at the start, and at most {limit:g} is permitted (numerics.max_overlap; {pairs} by "
        f"more). Move them {depth[worst]:.3g} m apart, or let granflow place them: kind pack."
    )


def _spheres_of(scene: Scene, particles: ParticleData) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centers (m, 3) [m] and radii (m,) [m] of the spheres of all particles, and the index (m,) of their
    particle."""
    centers = [np.empty((0, 3))]
    radii = [np.empty(0)]
    owners: list[np.ndarray] = [np.empty(0, dtype=np.int64)]
    for own, center, radius in _placed_groups(scene, particles):
        centers.append(center.reshape(-1, 3))
        radii.append(radius.reshape(-1))
        owners.append(np.repeat(own, radius.shape[1]))
    return np.concatenate(centers), np.concatenate(radii), np.concatenate(owners)


def _placed_groups(
    scene: Scene, particles: ParticleData
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """For each group: indices (n,) of its particles, centers (n, k, 3) [m] and radii (n, k) [m] of their
    spheres."""
    for number, group in enumerate(scene.particles.values()):
        own = np.flatnonzero(particles.group == number)
        turns = None if particles.orientation is None else particles.orientation[own]
        yield own, *group.shape.placed_spheres(particles.position[own], particles.radius[own], turns)


def _name(scene: Scene, particles: ParticleData, index: int, shift: np.ndarray) -> str:
    """Words for a particle or, if `shift` (3,) [m] is not zero, for its image displaced by it."""
    place = f"[{', '.join(f'{x:.4g}' for x in particles.position[index] + shift)}] m"
    group = int(particles.group[index])
    number = int((particles.group[:index] == group).sum())
    image = "the periodic image of " if np.any(shift) else ""
    return f"{image}particles {list(scene.particles)[group]}[{number}] at {place}"


# Insertion regions that walls cut, and initial particles inside walls.

SAMPLES = 2000
"""Number of random positions at which a region is compared with the walls."""
MOST_INSIDE = 0.9
"""Share of the positions inside a wall above which a warning appears: an inserter tries 64 for a particle,
and 0.9^64 = 0.1 % of the particles find none."""


def region_of(group: Group) -> RegionSampler | None:
    """The region in which particles of a group are inserted at random or on a lattice; None for given
    positions."""
    return group.insert.region_for(0.5 * group.outer_diameters[1], np.array(group.velocity, float))


def region_findings(plan: Plan, times: StageTimes) -> Iterator[tuple[tuple[str, ...], str]]:
    """Key and rest of the sentence for each region of an insertion during the run and each wall that leaves
    few positions in it at its start.

    Positions inside walls are not used (`Inserter`); those of lattices and packings are left out one by one
    (`without_overlaps_of_walls`).
    """
    for name, group in plan.scene.particles.items():
        region = region_of(group)
        radius = 0.5 * group.outer_diameters[0]
        # Particles that do not fit into the region are reported when they are generated.
        if region is None or group.insert.order is not None or radius > region.radius_max:
            continue
        points = region.sample(np.full(SAMPLES, radius), np.random.default_rng(0))
        bodies = group.shape.placed_spheres(points, np.full(SAMPLES, radius), None)
        start = getattr(group.insert, "start", 0.0)
        for wall, overlap, _ in _overlaps(plan.walls, name, bodies, start, times):
            share = float(np.mean(overlap > plan.scene.numerics.intended_overlap))
            if share > MOST_INSIDE:
                yield (
                    ("particles", name, "insert"),
                    f": {100 * share:.3g} % of the positions in the region are inside or behind "
                    f"walls.{wall.name}, where no particle is inserted. Choose a region that does not "
                    "intersect the wall.",
                )


CONTAINED = 0.5
"""Share of the particles of a group inside a wall above which it is their container, such as a drum; below, a
closed mesh is a solid body, such as an impeller."""


def without_overlaps_of_walls(
    plan: Plan, particles: ParticleData, given: Container[str] = ()
) -> tuple[ParticleData, list[str]]:
    """The initial particles without those of lattices and packings that overlap walls by more than the limit
    or are inside closed meshes, and a sentence for each group and wall.

    given:   groups whose particles come from an earlier run or a program, which remain complete
    Raises:  SceneError if no particle of a group remains
    """
    scene = plan.scene
    times = nominal_times(plan.stages)
    remains = np.ones(len(particles), dtype=bool)
    sentences, problems = list[str](), list[str]()
    placed = _placed_groups(scene, particles)
    for (name, group), (own, *bodies) in zip(scene.particles.items(), placed, strict=True):
        if group.fixed or name in given or not len(own) or region_of(group) is None:
            continue
        count = len(own)
        place = f"particles.{name} ({scene.where('particles', name)})"
        left_out = dict[str, int]()
        for wall, overlap, local in _overlaps(plan.walls, name, (bodies[0], bodies[1]), 0.0, times):
            enclosed = wall.surface.encloses(local[:, 0])
            if enclosed.mean() > CONTAINED:
                enclosed[:] = False
            inside = own[enclosed | (overlap > scene.numerics.intended_overlap)]
            if remains[inside].any():
                left_out[f"walls.{wall.name}"] = int(remains[inside].sum())
            remains[inside] = False
            sides = wall.surface.sides(local[:, 0])
            outside = int((sides < 0).sum())
            if outside and (sides > 0).mean() > CONTAINED:
                sentences.append(
                    f"{place}: {outside} of {count} particles start outside walls.{wall.name} and "
                    f"{int((sides > 0).sum())} inside. If it is their container, choose a region inside it, "
                    "such as region: {cylinder: ..}."
                )
        left = int(remains[own].sum())
        if not left:
            problems.append(
                f"{scene.locate('particles', name, 'insert')}: particles.{name} has no particle left, "
                f"because all are inside or behind {' and '.join(left_out)}. Choose a region that does not "
                "intersect them."
            )
        elif left_out:
            walls = " and ".join(f"{wall} ({number})" for wall, number in left_out.items())
            sentences.append(
                f"{place}: {count - left} of {count} particles are left out because they overlap {walls} at "
                f"the start; {left} remain. For the full number, multiply its count or mass by "
                f"{count / left:.3g}, or choose a region without the walls."
            )
    if problems:
        raise SceneError(problems)
    return (particles if remains.all() else particles.chosen(remains)), sentences


def particle_warnings(plan: Plan, particles: ParticleData) -> Iterator[str]:
    """A sentence for each group and wall whose initial particles overlap the wall by more than the limit.

    Particles of groups in regions that overlap walls are left out, see `without_overlaps_of_walls`.
    """
    scene = plan.scene
    times = nominal_times(plan.stages)
    placed = _placed_groups(scene, particles)
    for (name, group), (own, *bodies) in zip(scene.particles.items(), placed, strict=True):
        if group.fixed or not len(own) or region_of(group) is not None:
            continue
        for wall, overlap, _ in _overlaps(plan.walls, name, (bodies[0], bodies[1]), 0.0, times):
            count = int((overlap > scene.numerics.intended_overlap).sum())
            if count:
                worst = int(overlap.argmax())
                x, y, z = particles.position[own[worst]]
                yield (
                    f"particles.{name} ({scene.where('particles', name)}): {count} of {len(own)} particles "
                    f"are inside walls.{wall.name} at the start, by up to {overlap[worst]:.3g} of the "
                    f"radius, at [{x:.4g}, {y:.4g}, {z:.4g}] m. Move them out, or move the wall."
                )


def _overlaps(
    walls: Sequence[PlannedWall],
    group: str,
    bodies: tuple[np.ndarray, np.ndarray],
    time: float,
    times: StageTimes,
) -> Iterator[tuple[PlannedWall, np.ndarray, np.ndarray]]:
    """For each wall that is present at `time` [s] and holds a group: largest overlap over the radius (n,) of
    the spheres of a particle, and their centers (n, k, 3) [m] in the frame of the wall at rest.

    `bodies`: centers (n, k, 3) [m] and radii (n, k) [m] of spheres.
    """
    points = bodies[0].reshape(-1, 3)
    radius = bodies[1].reshape(-1)
    begun = {name: span for name, span in times.items() if span[0] <= time}
    stage = next((name for name, (_, end) in begun.items() if time < end), None)
    for wall in walls:
        if stage is not None and wall.spec.holds(group) and wall.spec.is_present(stage, time):
            at = poses_at([each.at(begun) for each in wall.motions], np.array([time]))
            local = (points - at.pivot - at.offset[0]) @ at.rotation[0] + at.pivot
            overlap = 1.0 - wall.surface.distances(local, float(radius.max())) / radius
            yield wall, overlap.reshape(bodies[1].shape).max(axis=1), local.reshape(bodies[0].shape)
