"""Points that the camera must show: the outermost points of particles and walls, or the domain."""

from collections.abc import Sequence

import numpy as np

from granflow import Scene
from granflow.studies.render.frames import Frame, FrameParticles, FrameWalls, read_particles, read_walls

SAMPLED_FRAMES = 12
"""Number of frames of the whole run that determine the camera, so that all pictures of a run have the same camera."""

PLANE_MARGIN = 0.5
"""Margin of a plane around the particles, relative to their largest extent."""


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


def bounding_points(fit: str, scene: Scene | None, frames: Sequence[Frame], domain: np.ndarray | None) -> np.ndarray:
    """Points (n, 3) [m] that the camera must show: the domain, or the outermost points of particles and walls.

    `fit`: "all", "particles" or "domain"; `domain` (2, 3) [m], or None. At most SAMPLED_FRAMES frames are read. Never
    empty.
    """
    if fit == "domain" and domain is not None:
        return corners_of(domain)
    sampled_frames = sampled(frames, SAMPLED_FRAMES)
    points = np.concatenate([outermost_points(read_particles(frame)) for frame in sampled_frames])
    if fit != "particles":
        walls = [each for each in map(read_walls, sampled_frames) if each is not None]
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
    kinds = [getattr(wall, "shape", "") for wall in scene.walls.values()] if scene is not None else []
    numbers = {int(number) for each in walls.walls for number in np.unique(each)}
    planes = {number for number in numbers if number < len(kinds) and kinds[number] == "plane"}
    planes_near, other_corners = walls.points_of(sorted(planes)), walls.points_of(sorted(numbers - planes))
    if domain is not None:
        planes_near, other_corners = np.clip(planes_near, *domain), np.clip(other_corners, *domain)
    if len(particles):
        low, high = particles.min(axis=0), particles.max(axis=0)
        margin = PLANE_MARGIN * np.max(high - low)
        planes_near = np.clip(planes_near, low - margin, high + margin)
    return np.concatenate([planes_near, other_corners])


def corners_of(box: np.ndarray) -> np.ndarray:
    """Corners (8, 3) of a box (2, 3)."""
    return np.array([[box[i][0], box[j][1], box[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
