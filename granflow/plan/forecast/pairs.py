"""The pairs of bodies of a scene that can be in contact, for the forecasts of overlaps."""

from collections.abc import Iterator
from itertools import product

import numpy as np

from granflow.load import Scene
from granflow.plan.forecast.contact import TouchingPair
from granflow.plan.pair_cases import pair_material, solid
from granflow.plan.size_classes import diameter_range
from granflow.scene.schema.particles import Group


def touching_pairs(scene: Scene) -> Iterator[TouchingPair]:
    """All pairs of groups, and of groups and wall materials, with the sizes of the largest relative overlaps.

    Two groups: smallest and largest sizes in all combinations, because the overlap refers to the smaller particle, and
    a small one that hits a large one overlaps most. Walls have an infinite radius and mass, as have fixed particles
    concerning their mass.
    """
    groups = list(scene.particles.items())
    walls = dict.fromkeys(wall.material for wall in scene.walls.values())
    for index, (name, group) in enumerate(groups):
        for other_name, other in groups[index:]:
            if not _collide(scene, name, group, other_name, other):
                continue
            for sizes in dict.fromkeys(product(diameter_range(group), diameter_range(other))):
                yield _of_particles(scene, f"particles of {_both(name, other_name)}", group, other, sizes)
        for wall in walls if not group.fixed else ():
            yield _of_wall(scene, name, group, wall)


def _collide(scene: Scene, name: str, group: Group, other_name: str, other: Group) -> bool:
    """Whether particles of two groups can be in contact."""
    alone = name == other_name and group.count < 2
    return (
        not alone
        and not (group.fixed and other.fixed)
        and scene.pair_key(group.material, other.material) in scene.pairs
    )


def _both(first: str, second: str) -> str:
    return first if first == second else f"{first} and {second}"


def _of_particles(scene: Scene, name: str, group: Group, other: Group, sizes: tuple[float, float]) -> TouchingPair:
    """Two particles with the diameters `sizes` [m]; a fixed one has an infinite mass."""
    radii = np.array(sizes) / 2.0
    masses = [_mass(scene, each, radius) for each, radius in zip((group, other), radii, strict=True)]
    inverse = sum(0.0 if each.fixed else 1.0 / mass for each, mass in zip((group, other), masses, strict=True))
    pair = pair_material(scene, group.material, other.material)
    radius_eff = float(1.0 / (1.0 / radii).sum())
    return TouchingPair(
        name, (group.material, other.material), pair, float(radii.min()), radius_eff, float(1.0 / inverse)
    )


def _mass(scene: Scene, group: Group, radius: float) -> float:
    """Mass [kg] of a sphere with a radius [m], or of the clump to which it belongs."""
    volume = 4.0 / 3.0 * np.pi * radius**3 if group.clump is None else group.clump.shape.volume
    return float(volume * solid(scene.materials, group.material).density)


def _of_wall(scene: Scene, name: str, group: Group, wall: str) -> TouchingPair:
    """A particle at a wall of the material `wall`; the relative overlap does not depend on its size (Hertz)."""
    radius = 0.5 * diameter_range(group)[0]
    mass = _mass(scene, group, radius)
    pair = pair_material(scene, group.material, wall)
    return TouchingPair(f"particles of {name} and walls of {wall}", (group.material, wall), pair, radius, radius, mass)
