"""Forecasts of walls that are far outside the domain, of walls that leave it, and of coincident walls."""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from granflow.geometry.catalog import Surface, distance_from, triangles
from granflow.geometry.mesh.mesh import Mesh
from granflow.geometry.motion import pose
from granflow.geometry.plane import HALF_SPACE
from granflow.load import Scene
from granflow.plan.forecast.sizes import oversized
from granflow.plan.forecast.times import present_from
from granflow.plan.size_classes import outer_diameter_range
from granflow.plan.walls import PlannedWall, StageTimes
from granflow.scene.schema.motions import Translation

POINTS_PER_AXIS = 13
"""Points along each axis of the domain at which the distance from a wall is computed."""

SAME_CORNER = 1e-6
"""Distance of corners over the size of a wall below which they are the same."""

TIMES = 40
"""Times of the run at which the position of a moving wall is computed."""


def wall_warnings(scene: Scene, walls: Sequence[PlannedWall], times: StageTimes) -> Iterator[str]:
    """A sentence for each wall that no particle can touch, or that leaves the domain without an end of its motion.

    Domains that expand have no outside. Meshes outside the domain have notes of their own, and walls that are much
    larger than the domain are reported by `size_warnings`.
    """
    if scene.domain.on_exit == "expand":
        return
    for wall in walls:
        if oversized(scene, wall.name, scene.walls[wall.name]):
            continue
        endless = _is_endless(scene, wall)
        if isinstance(wall.shape, Mesh) and not endless:
            continue
        if _gaps(scene, wall, times, 1)[0] <= 0.0 and not endless:
            continue
        gap = _gaps(scene, wall, times, TIMES if wall.motions else 1)
        if (gap > 0.0).all():
            yield _outside(scene, wall, float(gap.min()))
        elif gap[-1] > 0.0 and endless:
            yield _leaves(scene, wall, times, gap)


def coincidence_warnings(scene: Scene, walls: Sequence[PlannedWall]) -> Iterator[str]:
    """A sentence for each wall with the surface of another one that moves and is present like it.

    Particles are in contact with the first one only, see `engine.wall_contact`.
    """
    for first, second in combinations(walls, 2):
        times = [(each.motions, each.stages, each.appears_at, each.vanishes_at) for each in (first, second)]
        if times[0] == times[1] and _are_equal(first.shape, second.shape):
            yield (
                f"walls.{second.name} ({scene.where('walls', second.name)}) has the same surface as walls.{first.name}:"
                f" particles are in contact with walls.{first.name} only, and its material counts. Remove one of the "
                "two."
            )


def _are_equal(one: Surface, other: Surface) -> bool:
    """Whether two surfaces have the same corners, or are the same half space, within rounding."""
    if not isinstance(one, Mesh) and not isinstance(other, Mesh):
        if one.kind is not other.kind:
            return False
        if one.kind is HALF_SPACE:
            normal, distance = one.parameters[3:6], (other.parameters[0:3] - one.parameters[0:3]) @ one.parameters[3:6]
            size = np.abs([one.parameters[0:3], other.parameters[0:3]]).max()
            is_parallel = np.linalg.norm(normal - other.parameters[3:6]) <= SAME_CORNER
            return bool(is_parallel and abs(distance) <= SAME_CORNER * size)
    points, other_points = (triangles(each, np.zeros(3), 1.0)[0] for each in (one, other))
    if points.shape != other_points.shape:
        return False
    size = np.ptp(points, axis=0).max()
    points, other_points = (np.round(each / (SAME_CORNER * size)) for each in (points, other_points))
    return np.array_equal(*(each[np.lexsort(each.T)] for each in (points, other_points)))


def _gaps(scene: Scene, wall: PlannedWall, times: StageTimes, count: int) -> np.ndarray:
    """Lower bound of the gap [m] between the wall and the nearest particle in the domain, at `count` times of the run.

    The centers of particles are anywhere in the domain. Of points at a spacing h, one is within h sqrt(3)/2 of the
    nearest center. The first time is that at which the wall appears, the last one the end of the run.
    """
    low, high = np.array(scene.domain.min), np.array(scene.domain.max)
    axes = [np.linspace(*span, POINTS_PER_AXIS) for span in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    reach = 0.5 * float(np.linalg.norm((high - low) / (POINTS_PER_AXIS - 1)))
    reach += 0.5 * max(outer_diameter_range(group)[1] for group in scene.particles.values())
    end = max(stage_end for _, stage_end in times.values())
    poses = pose([each.at(times) for each in wall.motions], np.linspace(present_from(wall, times), end, count))
    gaps = []
    for offset, rotation in zip(poses.offset, poses.rotation, strict=True):
        local = (points - poses.pivot - offset) @ rotation + poses.pivot
        gaps.append(float(np.abs(distance_from(wall.shape, local, reach)).min()) - reach)
    return np.array(gaps)


def _outside(scene: Scene, wall: PlannedWall, gap: float) -> str:
    low, high = scene.domain.min, scene.domain.max
    size = " x ".join(f"{b - a:.3g}" for a, b in zip(low, high, strict=True))
    return (
        f"walls.{wall.name} ({scene.where('walls', wall.name)}) is at least {gap:.3g} m outside the domain of {size} "
        "m: no particle can be in contact with it. Check the units of its lengths, or enlarge the domain."
    )


def _is_endless(scene: Scene, wall: PlannedWall) -> bool:
    """Whether a wall is present and translates until the run ends, without limits of its time."""
    moves = [each for each in scene.walls[wall.name].motion if isinstance(each, Translation)]
    return wall.is_permanent and any(each.end is None and each.stages is None for each in moves)


def _leaves(scene: Scene, wall: PlannedWall, times: StageTimes, gap: np.ndarray) -> str:
    """Sentence on a wall that leaves the domain; `gap` (k,) [m] at times of the run."""
    end = max(stage_end for _, stage_end in times.values())
    last = int(np.flatnonzero(gap <= 0.0)[-1])
    left = np.linspace(present_from(wall, times), end, len(gap))[min(last + 1, len(gap) - 1)]
    return (
        f"walls.{wall.name} ({scene.where('walls', wall.name, 'motion')}) leaves the domain: after {left:.3g} s of "
        f"{end:.3g} s no particle can be in contact with it. If this is intended, give its motion an end or the "
        "wall vanishes_at."
    )
