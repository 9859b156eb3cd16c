"""Initial particles that overlap each other by more than the limit, with which a run would stop at its start."""

import numpy as np

from granflow.errors import SceneError
from granflow.load import Scene
from granflow.particles.close_pairs import near_pairs
from granflow.particles.particle_data import ParticleData
from granflow.scene.schema.insertion import FileInsertion, PositionsInsertion


def refuse_initial_overlaps(scene: Scene, particles: ParticleData) -> None:
    """Raise SceneError with the pair of the largest overlap if it exceeds `numerics.max_overlap`.

        (R_i + R_j - |x_i - x_j|) / min(R_i, R_j)

    Particles on lattices and in packings do not overlap: only scenes with positions or files are searched. Fixed
    particles overlap each other without a force. Images across periodic faces are included. Scenes with clumps are not
    searched: their radii are those of the spheres around the clumps, which may overlap.
    """
    groups, given = scene.particles.values(), (PositionsInsertion, FileInsertion)
    if not len(particles.radius) or not any(isinstance(each.insert, given) for each in groups):
        return
    if any(each.clump is not None for each in groups):
        return
    box, count = scene.domain.periodic_box(), len(particles.radius)
    position, radius = box.with_images(particles.position, particles.radius)
    first, second = near_pairs(position, radius, 0.0)
    own = np.minimum(first, second) < count  # two images are a pair of particles too
    first, second = first[own], second[own]
    fixed = np.array([group.fixed for group in scene.particles.values()])[particles.group]
    fixed = np.concatenate([fixed, np.zeros(len(radius) - count, bool)])
    mobile = ~(fixed[first] & fixed[second])
    first, second = first[mobile], second[mobile]
    distance = np.linalg.norm(position[first] - position[second], axis=1)
    overlap = (radius[first] + radius[second] - distance) / np.minimum(radius[first], radius[second])
    limit = scene.numerics.max_overlap
    above = np.flatnonzero(overlap > limit)
    if not len(above):
        return
    worst = above[overlap[above].argmax()]
    pair = sorted((int(first[worst]), int(second[worst])))
    names = [_name(scene, particles, each, position[each]) for each in pair]
    group = list(scene.particles)[particles.group[pair[0]]]
    pairs = f"{len(above)} pairs overlap" if len(above) > 1 else "1 pair overlaps"
    raise SceneError(
        f"{scene.locate('particles', group)}: {' and '.join(names)} overlap by {overlap[worst]:.3g} of the smaller "
        f"radius at the start, and the run stops above numerics.max_overlap {limit:g} ({pairs} by more). Move them "
        f"{overlap[worst] * min(radius[pair[0]], radius[pair[1]]):.3g} m apart, or let granflow place them: kind pack."
    )


def _name(scene: Scene, particles: ParticleData, index: int, position: np.ndarray) -> str:
    """Words for a particle or for the image of one at `position` (3,) [m]."""
    place = f"[{', '.join(f'{x:.4g}' for x in position)}] m"
    if index >= len(particles.radius):
        return f"the periodic image of a particle at {place}"
    group = int(particles.group[index])
    number = int((particles.group[:index] == group).sum())
    return f"particles {list(scene.particles)[group]}[{number}] at {place}"
