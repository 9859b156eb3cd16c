"""Points that the camera must show: the outermost points of particles and walls, or the domain."""

from collections.abc import Sequence

import numpy as np

from granflow import Scene
from granflow.studies.render.frames import Frame, FrameParticles, FrameWalls, read_particles, read_walls

SAMPLED_FRAMES = 12
"""Number of frames of the whole run that determine the camera, so that all pictures of a run have the same camera."""

PLANE_MARGIN = 0.5
"""Largest distance of a shown plane from the particles, relative to their largest extent."""

PLANE_OVERHANG = 0.05
"""Overhang of the shown part of a plane over the particles, relative to their largest extent."""

FLAT = 1e-6
"""Extent of a plane along its normal, relative to its size, up to which it is normal to an axis."""


EMPTY_BOX = np.array([[-0.5] * 3, [0.5] * 3])
"""Box (2, 3) [m] shown if there are neither particles nor a scene."""


def domain_of(scene: Scene | None) -> np.ndarray | None:
    """Domain (2, 3) [m] of the simulation; None if it expands or if the scene is unknown."""
    if scene is None or scene.domain.on_exit == "expand":
        return None
    return np.array([scene.domain.min, scene.domain.max])


def sampled(frames: Sequence[Frame], count: int) -> list[Frame]:
    """At most `count` evenly spaced frames, including the first and the last one."""
    return [frames[k] for k in np.unique(np.linspace(0, len(frames) - 1, count).astype(int))]


def particle_points(frames: Sequence[Frame]) -> np.ndarray:
    """Outermost points (n, 3) [m] of the particles of at most SAMPLED_FRAMES frames; (0, 3) without particles."""
    return np.concatenate([outermost_points(read_particles(frame)) for frame in sampled(frames, SAMPLED_FRAMES)])


def bounding_points(
    fit: str, scene: Scene | None, frames: Sequence[Frame], domain: np.ndarray | None, particles: np.ndarray
) -> np.ndarray:
    """Points (n, 3) [m] that the camera must show: the domain, or the outermost points of particles and walls.

    `fit`: "all", "particles" or "domain"; `domain` (2, 3) [m], or None; `particles` (k, 3) [m]: see `particle_points`.
    At most SAMPLED_FRAMES frames are read. Never empty.
    """
    if fit == "domain" and domain is not None:
        return corners_of(domain)
    points = particles
    if fit != "particles":
        walls = [each for each in map(read_walls, sampled(frames, SAMPLED_FRAMES)) if each is not None]
        points = np.concatenate([points, *(wall_points(each, scene, points, domain) for each in walls)])
    if len(points):
        return points
    return corners_of(domain if domain is not None else EMPTY_BOX)


def outermost_points(particles: FrameParticles) -> np.ndarray:
    """Points (n, 3) [m] on the surface of the bed: the farthest point in each of a set of directions."""
    if not len(particles.radius):
        return np.zeros((0, 3))
    directions = np.array([ray for ray in np.ndindex(3, 3, 3) if ray != (1, 1, 1)]) - 1.0
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    farthest = np.argmax(particles.position @ directions.T + particles.radius[:, None], axis=0)
    return particles.position[farthest] + particles.radius[farthest, None] * directions


def wall_points(walls: FrameWalls, scene: Scene | None, particles: np.ndarray, domain: np.ndarray | None) -> np.ndarray:
    """Corners (n, 3) [m] of the walls, clipped to the domain; unbounded planes are clipped to the particles.

    `particles` (k, 3) [m]: outermost points of the particles; `domain` (2, 3) [m], or None.
    """
    planes = planes_of(walls, scene)
    corners = [walls.points_of([number for number in walls.numbers if number not in planes])]
    corners += [np.clip(each, *plane_box(each, particles)) for each in map(walls.points_of, ([k] for k in planes))]
    points = np.concatenate(corners)
    return points if domain is None else np.clip(points, *domain)


def planes_of(walls: FrameWalls, scene: Scene | None) -> list[int]:
    """Numbers of the shown walls that are unbounded planes."""
    kinds = [getattr(wall, "shape", "") for wall in scene.walls.values()] if scene is not None else []
    return [number for number in walls.numbers if number < len(kinds) and kinds[number] == "plane"]


def plane_box(plane: np.ndarray, particles: np.ndarray) -> np.ndarray:
    """Box (2, 3) [m] of the shown part of a plane: around the particles, wider along the normal of the plane.

    `plane` (m, 3) [m]: its corners in the frame; `particles` (k, 3) [m]: outermost points of the particles. All of the
    plane without particles.
    """
    if not len(particles) or not len(plane):
        return np.array([[-np.inf] * 3, [np.inf] * 3])
    low, high = particles.min(axis=0), particles.max(axis=0)
    extent = np.ptp(plane, axis=0)
    margin = np.where(extent > FLAT * extent.max(), PLANE_OVERHANG, PLANE_MARGIN) * np.max(high - low)
    return np.array([low - margin, high + margin])


def drawn_box(plane: np.ndarray, particles: np.ndarray) -> np.ndarray:
    """Box (2, 3) [m] to which the drawing of a plane is clipped: `plane_box`, unbounded along the normal."""
    low, high = plane_box(plane, particles)
    extent = np.ptp(plane, axis=0)
    is_normal = extent <= FLAT * extent.max()
    return np.array([np.where(is_normal, -np.inf, low), np.where(is_normal, np.inf, high)])


def corners_of(box: np.ndarray) -> np.ndarray:
    """Corners (8, 3) of a box (2, 3)."""
    return np.array([[box[i][0], box[j][1], box[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
