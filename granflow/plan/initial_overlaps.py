"""Overlaps where particles start: of particles with each other, and of particles and insertion regions with
walls.

A run with such an overlap would stop in its first step. Initial particles are checked when they are known;
regions of insertion are sampled before.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from granflow.errors import SceneError
from granflow.geometry.catalog import distance_from
from granflow.geometry.motion import pose
from granflow.load import Scene
from granflow.particles.close_pairs import near_pairs
from granflow.particles.group import ParticleData, orientations
from granflow.plan.falls import region_of
from granflow.plan.groups import outer_diameter_range
from granflow.plan.plan import Plan
from granflow.plan.stages import StageTimes, nominal_times
from granflow.plan.walls import PlannedWall
from granflow.scene.blocks.particles import FileInsertion, Group, PositionsInsertion

# Initial particles that overlap each other by more than the limit, with which a run would stop at its start.


def refuse_initial_overlaps(scene: Scene, particles: ParticleData) -> None:
    """Raise SceneError with the pair of the largest overlap if it exceeds `numerics.max_overlap`.

        (R_i + R_j - |x_i - x_j|) / min(R_i, R_j)

    Particles on lattices and in packings do not overlap: only scenes with positions or files are searched.
    Fixed particles overlap each other without a force, as do the spheres of one clump. Images across periodic
    faces are included.
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
        f"{scene.locate('particles', group)}: {' and '.join(names)} overlap by "
        f"{depth[worst] / smaller[worst]:.3g} of the smaller radius at the start, and the run stops above "
        f"numerics.max_overlap {limit:g} ({pairs} by more). Move them {depth[worst]:.3g} m apart, or let "
        "granflow place them: kind pack."
    )


def _mobile_pairs(
    scene: Scene, particles: ParticleData, count: int, owner: np.ndarray, pairs: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """The pairs (p,), (p,) of spheres of two particles that are not both fixed.

    `owner` (m,): index of the particle of each sphere, first of the `count` spheres, then of their images.
    Pairs of two images are left out: they are pairs of spheres too.
    """
    first, second = pairs
    fixed = np.array([group.fixed for group in scene.particles.values()])[particles.group][owner]
    counts = (
        (np.minimum(first, second) < count)
        & (owner[first] != owner[second])
        & ~(fixed[first] & fixed[second])
    )
    return first[counts], second[counts]


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


def region_warnings(scene: Scene, plan: Plan, times: StageTimes) -> Iterator[str]:
    """A sentence for each region and wall where particles would be inserted with overlaps above the limit."""
    for name, group in scene.particles.items():
        region = region_of(group)
        if region is None or group.fixed:
            continue
        radius = 0.5 * outer_diameter_range(group)[0]
        if radius > region.radius_max:
            continue  # the particles do not fit: reported when they are generated
        points = region.sample(np.full(SAMPLES, radius), np.random.default_rng(0))
        bodies = spheres_by_particle(group, points, np.full(SAMPLES, radius), None)
        start = getattr(group.insert, "start", 0.0)
        for wall, overlap in _overlaps(plan.walls, bodies, start, times):
            share = float(np.mean(overlap > plan.max_overlap))
            if share > 0.0:
                yield (
                    f"particles.{name}.insert ({scene.where('particles', name, 'insert')}): "
                    f"{100 * share:.3g} % of the positions in the region are inside or behind "
                    f"walls.{wall.name}, and particles there stop the run. Choose a region that does not "
                    "intersect the wall."
                )


def particle_warnings(scene: Scene, plan: Plan, particles: ParticleData) -> Iterator[str]:
    """A sentence for each group and wall whose initial particles overlap the wall by more than the limit.

    Groups in regions are compared with walls by `region_warnings`.
    """
    times = nominal_times(plan.stages)
    for number, (name, group) in enumerate(scene.particles.items()):
        own = np.flatnonzero(particles.group == number)
        if group.fixed or not len(own) or region_of(group) is not None:
            continue
        points = particles.position[own]
        turns = particles.orientation
        bodies = spheres_by_particle(
            group, points, particles.radius[own], None if turns is None else turns[own]
        )
        for wall, overlap in _overlaps(plan.walls, bodies, 0.0, times):
            count = int((overlap > plan.max_overlap).sum())
            if count:
                worst = int(overlap.argmax())
                x, y, z = points[worst]
                yield (
                    f"particles.{name} ({scene.where('particles', name)}): {count} of {len(own)} particles "
                    f"are inside walls.{wall.name} at the start, by up to {overlap[worst]:.3g} of the "
                    f"radius, at [{x:.4g}, {y:.4g}, {z:.4g}] m. Move them out, or move the wall."
                )


def _overlaps(
    walls: Sequence[PlannedWall], bodies: tuple[np.ndarray, np.ndarray], time: float, times: StageTimes
) -> Iterator[tuple[PlannedWall, np.ndarray]]:
    """For each wall that is present at `time` [s]: largest overlap over the radius (n,) of the spheres of a
    particle.

    `bodies`: centers (n, k, 3) [m] and radii (n, k) [m] of spheres.
    """
    points = bodies[0].reshape(-1, 3)
    radius = bodies[1].reshape(-1)
    for wall in walls:
        if not is_present(wall, time, times):
            continue
        at = pose([each.at(_started(times, time)) for each in wall.motions], np.array([time]))
        local = (points - at.pivot - at.offset[0]) @ at.rotation[0] + at.pivot
        overlap = 1.0 - distance_from(wall.shape, local, float(radius.max())) / radius
        yield wall, overlap.reshape(bodies[1].shape).max(axis=1)


def is_present(wall: PlannedWall, time: float, times: StageTimes) -> bool:
    """Whether a wall is present at `time` [s]."""
    stage = next((name for name, (start, end) in times.items() if start <= time < end), None)
    return stage is not None and wall.is_present(stage, time)


def _started(times: StageTimes, time: float) -> Mapping[str, tuple[float, float]]:
    """The stages that have begun at `time` [s]."""
    return {name: span for name, span in times.items() if span[0] <= time}


# The spheres of particles: of a clump all of its spheres, of other particles the particle itself.


def spheres_of(scene: Scene, particles: ParticleData) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centers (m, 3) [m] and radii (m,) [m] of the spheres of all particles, and the index (m,) of their
    particle."""
    centers = [np.empty((0, 3))]
    radii = [np.empty(0)]
    owners: list[np.ndarray] = [np.empty(0, dtype=np.int64)]
    for number, group in enumerate(scene.particles.values()):
        own = np.flatnonzero(particles.group == number)
        turns = None if particles.orientation is None else particles.orientation[own]
        center, radius = spheres_by_particle(group, particles.position[own], particles.radius[own], turns)
        centers.append(center.reshape(-1, 3))
        radii.append(radius.reshape(-1))
        owners.append(np.repeat(own, radius.shape[1]))
    return np.concatenate(centers), np.concatenate(radii), np.concatenate(owners)


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
