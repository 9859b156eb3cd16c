"""Facets of walls at rest, and the first wall on the path of a falling particle."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from granflow.geometry.catalog import triangles
from granflow.geometry.mesh.mesh import Mesh
from granflow.geometry.plane import HALF_SPACE
from granflow.geometry.revolved import REVOLVED
from granflow.plan.walls import PlannedWall

PATH_SEGMENTS = 48
"""Straight segments of the parabola of a particle with a horizontal velocity."""

EDGE = 1e-9
"""Tolerance of the barycentric coordinates of a point in a triangle: no gap between triangles with a common edge."""

SAMPLES = 32
"""Largest number of points on the lowest edges of a wall."""


@dataclass(frozen=True)
class Hit:
    """Where a path ends at a wall: index of the wall, point (3,) [m], velocity (3,) [m/s], unit normal (3,)."""

    wall: int
    point: np.ndarray
    velocity: np.ndarray
    normal: np.ndarray

    @property
    def tangential_velocity(self) -> np.ndarray:
        """The velocity (3,) [m/s] along the wall."""
        return np.asarray(self.velocity - (self.velocity @ self.normal) * self.normal)


class WallFacets:
    """Triangles of walls at rest; planes are squares that are larger than the domain.

    walls:      with their numbers in the list
    low, high:  corners (3,) [m] of the domain
    """

    def __init__(self, walls: Sequence[PlannedWall], low: np.ndarray, high: np.ndarray) -> None:
        center, extent = 0.5 * (low + high), 4.0 * float(np.linalg.norm(high - low))
        self.walls = list(walls)
        self.points = [triangles(wall.shape, center, extent) for wall in walls]
        corners = [points[each] for points, each in self.points]
        self.corners = np.concatenate([np.empty((0, 3, 3)), *corners])
        self.wall = np.repeat(np.arange(len(corners)), [len(each) for each in corners])
        self.low, self.high = self.corners.min(axis=1).T.copy(), self.corners.max(axis=1).T.copy()

    def near(self, path: np.ndarray, within: np.ndarray | None = None) -> np.ndarray:
        """Numbers (k,) of the triangles whose bounding box intersects that of points (n, 3) [m].

        `within`: numbers of the triangles to search, by default all.
        """
        index = np.arange(len(self.wall)) if within is None else within
        for axis in range(3):
            coordinate = path[:, axis]
            index = index[self.low[axis, index] <= coordinate.max()]
            index = index[self.high[axis, index] >= coordinate.min()]
        return index

    def first_on_segment(self, start: np.ndarray, end: np.ndarray, within: np.ndarray) -> tuple[float, int] | None:
        """Share of the segment (3,) to (3,) [m] at which it meets the first triangle, and the triangle; or None.

        By Moeller and Trumbore (1997). `within`: numbers of the triangles to search.
        """
        index = self.near(np.array([start, end]), within)
        first, second = (self.corners[index, k] - self.corners[index, 0] for k in (1, 2))
        along, offset = end - start, start - self.corners[index, 0]
        across = np.cross(along, second)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1.0 / np.sum(first * across, axis=1)
            u = scale * np.sum(offset * across, axis=1)
            turned = np.cross(offset, first)
            v, share = scale * (turned @ along), scale * np.sum(second * turned, axis=1)
            inside = (u >= -EDGE) & (v >= -EDGE) & (u + v <= 1.0 + EDGE) & (share >= 0.0) & (share <= 1.0)
        if not inside.any():
            return None
        best = int(np.flatnonzero(inside)[share[inside].argmin()])
        return float(share[best]), int(index[best])

    def first_hit(self, start: np.ndarray, velocity: np.ndarray, gravity: np.ndarray, fall: float) -> Hit | None:
        """The first wall on a parabola from `start` (3,) [m] with `velocity` (3,) [m/s]; None if there is none.

        gravity:  (3,) [m/s2]
        fall:     height [m] below the start at which the path ends
        """
        strength = float(np.linalg.norm(gravity))
        down = float(velocity @ gravity) / strength
        duration = (-down + np.sqrt(down**2 + 2.0 * strength * fall)) / strength
        is_straight = np.linalg.norm(np.cross(velocity, gravity)) == 0.0 and down >= 0.0
        times = np.linspace(0.0, duration, 2 if is_straight else PATH_SEGMENTS + 1)[:, None]
        path = start + times * velocity + 0.5 * times**2 * gravity
        within = self.near(path)
        for number in range(len(path) - 1):
            found = self.first_on_segment(path[number], path[number + 1], within)
            if found is not None:
                point = path[number] + found[0] * (path[number + 1] - path[number])
                return self._hit(found[1], start, point, velocity, gravity)
        return None

    def is_free(self, start: np.ndarray, end: np.ndarray, without: int) -> bool:
        """Whether no wall except number `without` is between two points (3,) [m]."""
        within = self.near(np.array([start, end]))
        return self.first_on_segment(start, end, within[self.wall[within] != without]) is None

    def _hit(self, facet: int, start: np.ndarray, point: np.ndarray, velocity: np.ndarray, gravity: np.ndarray) -> Hit:
        """The hit of a triangle; the velocity across gravity is constant, the energy gives that along gravity."""
        strength = float(np.linalg.norm(gravity))
        down = gravity / strength
        along = float(velocity @ down)
        fallen = np.sqrt(max(along**2 + 2.0 * strength * float((point - start) @ down), 0.0))
        normal = np.cross(*(self.corners[facet, k] - self.corners[facet, 0] for k in (1, 2)))
        rising = along < 0.0 and float((point - start) @ down) < 0.0
        reached = velocity + ((-fallen if rising else fallen) - along) * down
        return Hit(int(self.wall[facet]), point, reached, normal / np.linalg.norm(normal))

    def lowest(self, wall: int, up: np.ndarray) -> float:
        """Smallest height [m] of a wall along `up` (3,)."""
        return float((self.points[wall][0] @ up).min())

    def edges(self, wall: int, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (n, 3) [m] on the lowest edges of a wall, and horizontal unit vectors (n, 3) away from its center.

        Surfaces of revolution and meshes, which may have openings, also have vectors toward the center. Planes, which
        have no edges, have no points.
        """
        shape = self.walls[wall].shape
        if not isinstance(shape, Mesh) and shape.kind is HALF_SPACE:
            return np.empty((0, 3)), np.empty((0, 3))
        points, corners = self.points[wall]
        height = points @ up
        is_low = height <= height.min() + 1e-6 * float(np.ptp(points, axis=0).max())
        pairs = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
        pairs = np.unique(np.sort(pairs[is_low[pairs].all(axis=1)], axis=1), axis=0)
        found = np.concatenate([points[is_low], points[pairs].mean(axis=1)])
        found = found[np.linspace(0, len(found) - 1, min(SAMPLES, len(found))).astype(int)]
        outward = found - 0.5 * (points.min(axis=0) + points.max(axis=0))
        outward -= np.outer(outward @ up, up)
        length = np.linalg.norm(outward, axis=1)
        found, outward = found[length > 0.0], outward[length > 0.0] / length[length > 0.0][:, None]
        if isinstance(shape, Mesh) or shape.kind is REVOLVED:
            return np.concatenate([found, found]), np.concatenate([outward, -outward])
        return found, outward
