"""The spheres of particles: of a clump all of its spheres, of other particles the particle itself."""

import numpy as np

from granflow.load import Scene
from granflow.particles.particle_data import ParticleData, orientations
from granflow.scene.schema.particles import Group


def spheres_by_particle(
    group: Group, points: np.ndarray, radius: np.ndarray, orientation: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Centers (n, k, 3) [m] and radii (n, k) [m] of the k spheres of each particle at `points` (n, 3) [m].

    `radius` (n,) [m]: of spheres. `orientation` (n, 4): of clumps; None for those of new clumps.
    """
    if group.clump is None:
        return points[:, None], radius[:, None]
    shape = group.clump.shape
    if orientation is None:
        orientation = orientations(group.clump, len(points), lambda: np.random.default_rng(1))
    return shape.spheres(points, orientation), np.broadcast_to(shape.radius, (len(points), len(shape)))


def spheres_of(scene: Scene, particles: ParticleData) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centers (m, 3) [m] and radii (m,) [m] of the spheres of all particles, and the index (m,) of their particle."""
    centers, radii = [np.empty((0, 3))], [np.empty(0)]
    owners: list[np.ndarray] = [np.empty(0, dtype=np.int64)]
    for number, group in enumerate(scene.particles.values()):
        own = np.flatnonzero(particles.group == number)
        turns = None if particles.orientation is None else particles.orientation[own]
        center, radius = spheres_by_particle(group, particles.position[own], particles.radius[own], turns)
        centers.append(center.reshape(-1, 3))
        radii.append(radius.reshape(-1))
        owners.append(np.repeat(own, radius.shape[1]))
    return np.concatenate(centers), np.concatenate(radii), np.concatenate(owners)
