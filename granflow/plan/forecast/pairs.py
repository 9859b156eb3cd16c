"""The pairs of bodies of a plan that can be in contact, for the forecasts of overlaps."""

from collections.abc import Iterator
from itertools import product

import numpy as np

from granflow.geometry.sphere import sphere_mass
from granflow.plan.forecast.contact import TouchingPair
from granflow.plan.plan import Plan
from granflow.plan.scene_parts import PlannedGroup


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
