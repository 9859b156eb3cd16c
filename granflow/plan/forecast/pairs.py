"""The pairs of bodies of a plan that can be in contact, for the forecasts of overlaps."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from granflow.geometry.sphere import sphere_mass
from granflow.load import Scene
from granflow.plan.forecast.contact import TouchingPair
from granflow.plan.forecast.pressures import SOLID_FRACTION, solid_volume, weight_pressure
from granflow.plan.plan import Plan
from granflow.plan.scene_parts import PlannedGroup

SUPPORTED_RATIO = 3.0
"""Smallest ratio of radii at which a particle hits small ones as a bed: particles of similar size move each other."""

SHALLOW = 0.5
"""Largest depth of a bed that supports its particles, over the radius of the large particle.

In runs with a bed of 2.3 mm (1 mm particles of 10 MPa, 0.3 m/s), a particle of 5 mm overlaps by 0.06 of the small
radius, 0.3 times the value for a supported bed; those of 10 and 20 mm by 0.16 and 0.46, 0.4 and 0.8 times this value.
"""

LAYER_FRACTION = 0.8
"""Share of an area that a layer of spheres covers."""


def touching_pairs(plan: Plan) -> Iterator[TouchingPair]:
    """All pairs of groups, and of groups and wall materials, with the sizes of the largest relative overlaps.

    Two groups: smallest and largest sizes in all combinations, because the overlap refers to the smaller particle, and
    a small one that hits a large one overlaps most. Walls have an infinite radius and mass, as have fixed particles
    concerning their mass.
    """
    walls = dict.fromkeys(plan.materials[wall.material] for wall in plan.walls)
    for index, group in enumerate(plan.groups):
        for other in plan.groups[index:]:
            if _collide(plan, group, other):
                for sizes in dict.fromkeys(product(group.diameters, other.diameters)):
                    yield _of_particles(plan, group, other, sizes)
        for wall in walls if not group.fixed else ():
            yield _of_wall(plan, group, wall)


def supported_pairs(scene: Scene, plan: Plan) -> Iterator[tuple[TouchingPair, float]]:
    """Pairs of a particle and of much smaller ones in a shallow bed below it, and the weight [N] on one of these.

    A bed is shallow if it is not deeper than SHALLOW times the radius R of the large particle; small ones, radius r, in
    a deeper bed give way. The floor supports those in a shallow bed. At the overlap limit d the large particle, mass M,
    touches those within the radius a of its contact area,

        N = phi a^2 / r^2,   a^2 = 2 R d,     at least 1

    each of which carries M |g| / N. An impact compresses 2 N contacts, those with the large particle and those below:
    for each the effective mass is M / (2 N). Without gravity there is no bed.
    """
    magnitude = float(np.linalg.norm(plan.gravity))
    for large, small in product(plan.groups, plan.groups):
        if large.fixed or small.fixed or not magnitude or not _collide(plan, large, small):
            continue
        radius, radius_small = 0.5 * max(large.diameters), 0.5 * min(small.diameters)
        count = max(2.0 * LAYER_FRACTION * radius * plan.max_overlap / radius_small, 1.0)
        if radius < SUPPORTED_RATIO * radius_small or small.count <= count:
            continue
        if _depth(scene, plan, radius) > SHALLOW * radius:
            continue
        pair = _of_particles(plan, large, small, (2.0 * radius, 2.0 * radius_small))
        mass = _mass(plan, large, radius)
        name = f"particles of {large.name} on the smallest of {small.name}"
        supported = replace(pair, name=name, mass_eff=max(mass / (2.0 * count), pair.mass_eff))
        yield supported, magnitude * mass / count


def _depth(scene: Scene, plan: Plan, radius: float) -> float:
    """Depth [m] of a bed at rest of all mobile particles of groups without a radius of at least `radius` [m]."""
    names = [each.name for each in plan.groups if not each.fixed and 0.5 * max(each.diameters) < radius]
    volume = solid_volume({name: scene.particles[name] for name in names})
    return volume / (SOLID_FRACTION * weight_pressure(scene, plan.solids)[1])


def _collide(plan: Plan, group: PlannedGroup, other: PlannedGroup) -> bool:
    """Whether particles of two groups can be in contact."""
    alone = group is other and group.count < 2
    materials = (group.material, other.material)
    return not alone and not (group.fixed and other.fixed) and materials in plan.pair_materials


def _of_particles(plan: Plan, group: PlannedGroup, other: PlannedGroup, sizes: tuple[float, float]) -> TouchingPair:
    """Two particles with the diameters `sizes` [m]; a fixed one has an infinite mass."""
    radii, materials = np.array(sizes) / 2.0, (group.material, other.material)
    masses = [_mass(plan, each, radius) for each, radius in zip((group, other), radii, strict=True)]
    inverse = sum(0.0 if each.fixed else 1.0 / mass for each, mass in zip((group, other), masses, strict=True))
    radius_eff = float(1.0 / (1.0 / radii).sum())
    name = f"particles of {group.name if group is other else f'{group.name} and {other.name}'}"
    pair = plan.pair_materials[materials]
    return TouchingPair(name, materials, pair, float(radii.min()), radius_eff, float(1.0 / inverse))


def _of_wall(plan: Plan, group: PlannedGroup, wall: str) -> TouchingPair:
    """A particle at a wall of the material `wall`; the relative overlap does not depend on its size (Hertz)."""
    radius, materials = 0.5 * group.diameters[0], (group.material, wall)
    name, mass = f"particles of {group.name} and walls of {wall}", _mass(plan, group, radius)
    return TouchingPair(name, materials, plan.pair_materials[materials], radius, radius, mass)


def _mass(plan: Plan, group: PlannedGroup, radius: float) -> float:
    """Mass [kg] of a sphere of a group with a radius [m], or of the clump to which it belongs."""
    density = plan.solids[group.material].density
    return sphere_mass(radius, density) if group.clump is None else group.clump.volume * density
