"""Initial particles that overlap each other by more than the limit, with which a run would stop at its start."""

import numpy as np

from granflow.errors import SceneError
from granflow.load import Scene
from granflow.particles.close_pairs import near_pairs
from granflow.particles.particle_data import ParticleData
from granflow.plan.forecast.spheres import spheres_of
from granflow.scene.schema.insertion import FileInsertion, PositionsInsertion


def refuse_initial_overlaps(scene: Scene, particles: ParticleData) -> None:
    """Raise SceneError with the pair of the largest overlap if it exceeds `numerics.max_overlap`.

        (R_i + R_j - |x_i - x_j|) / min(R_i, R_j)

    Particles on lattices and in packings do not overlap: only scenes with positions or files are searched. Fixed
    particles overlap each other without a force, as do the spheres of one clump. Images across periodic faces are
    included.
    """
    given = (PositionsInsertion, FileInsertion)
    if not any(isinstance(each.insert, given) for each in scene.particles.values()):
        return
    spheres, radii, owners = spheres_of(scene, particles)
    position, radius, sphere = scene.domain.periodic_box().images(spheres, radii)
    owner = owners[sphere]
    first, second = _mobile_pairs(scene, particles, len(radii), owner, near_pairs(position, radius, 0.0))
    smaller = np.minimum(radius[first], radius[second])
    depth = radius[first] + radius[second] - np.linalg.norm(position[first] - position[second], axis=1)
    limit = scene.numerics.max_overlap
    above = np.flatnonzero(depth > limit * smaller)
    if not len(above):
        return
    worst = above[(depth[above] / smaller[above]).argmax()]
    pair = sorted((int(first[worst]), int(second[worst])))
    names = [_name(scene, particles, int(owner[k]), position[k] - spheres[sphere[k]]) for k in pair]
    group = list(scene.particles)[particles.group[owner[pair[0]]]]
    count = len(np.unique(np.sort([owner[first[above]], owner[second[above]]], axis=0), axis=1).T)
    pairs = f"{count} pairs overlap" if count > 1 else "1 pair overlaps"
    raise SceneError(
        f"{scene.locate('particles', group)}: {' and '.join(names)} overlap by {depth[worst] / smaller[worst]:.3g} of "
        f"the smaller radius at the start, and the run stops above numerics.max_overlap {limit:g} ({pairs} by more). "
        f"Move them {depth[worst]:.3g} m apart, or let granflow place them: kind pack."
    )


def _mobile_pairs(
    scene: Scene, particles: ParticleData, count: int, owner: np.ndarray, pairs: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """The pairs (p,), (p,) of spheres of two particles that are not both fixed.

    `owner` (m,): index of the particle of each sphere, first of the `count` spheres, then of their images. Pairs of two
    images are left out: they are pairs of spheres too.
    """
    first, second = pairs
    fixed = np.array([group.fixed for group in scene.particles.values()])[particles.group][owner]
    counts = (np.minimum(first, second) < count) & (owner[first] != owner[second]) & ~(fixed[first] & fixed[second])
    return first[counts], second[counts]


def _name(scene: Scene, particles: ParticleData, index: int, shift: np.ndarray) -> str:
    """Words for a particle or, if `shift` (3,) [m] is not zero, for its image displaced by it."""
    place = f"[{', '.join(f'{x:.4g}' for x in particles.position[index] + shift)}] m"
    group = int(particles.group[index])
    number = int((particles.group[:index] == group).sum())
    image = "the periodic image of " if np.any(shift) else ""
    return f"{image}particles {list(scene.particles)[group]}[{number}] at {place}"
