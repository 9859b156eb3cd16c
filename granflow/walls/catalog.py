"""The kinds of wall shapes in a fixed order; the place in it is the code the device switches on."""

import numpy as np

from granflow.walls.mesh import Mesh
from granflow.walls.mesh_grid import distances, grid_over
from granflow.walls.plane import HALF_SPACE, RECTANGLE
from granflow.walls.revolved import REVOLVED
from granflow.walls.shape import Shape, ShapeKind

SHAPE_KINDS: tuple[ShapeKind, ...] = (HALF_SPACE, RECTANGLE, REVOLVED)


Surface = Shape | Mesh
"""What a wall is at rest."""


def kind_code(kind: ShapeKind) -> int:
    """The place of the kind in SHAPE_KINDS."""
    return SHAPE_KINDS.index(kind)


def area_of(surface: Surface) -> float | None:
    """Area [m2] of a surface; None for one without end."""
    return surface.area if isinstance(surface, Mesh) else surface.kind.area(surface.parameters)


def surface_code(surface: Surface) -> int:
    """The code of a wall's kind: that of its shape, or one more for all meshes."""
    return len(SHAPE_KINDS) if isinstance(surface, Mesh) else kind_code(surface.kind)


def triangles(surface: Surface, center: np.ndarray, extent: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (m, 3) [m] and triangles (k, 3) of a surface at rest, for pictures.

    Unbounded shapes show a square of half width `extent` about the foot of `center` (take the middle of the
    domain and half its largest side); others show all of themselves.
    """
    if isinstance(surface, Mesh):
        return surface.points, surface.corners
    return surface.kind.triangles(surface.parameters, np.asarray(center, dtype=np.float64), extent)


def distance_from(surface: Surface, points: np.ndarray, reach: float) -> np.ndarray:
    """Distance (n,) [m] of points (n, 3) from a surface; of meshes only that within `reach`."""
    if isinstance(surface, Mesh):
        vertex = surface.adjacency.vertex
        return distances(grid_over(vertex, reach), vertex, points)
    return surface.kind.reference_closest(points, surface.parameters)[0]


def reach_about(surface: Surface, point: np.ndarray, axis: np.ndarray, farthest: float) -> float:
    """How far from an axis the surface's geometry moves when it turns about it, for `motion.speed_bound` [m].

    At most `farthest`, the largest distance from the axis at which there can be particles. 0 for a surface of
    revolution that turns about its own axis, and for a half space about its normal.
    """
    point, axis = np.asarray(point), np.asarray(axis)
    if isinstance(surface, Mesh):
        return min(surface.reach_about(point, axis), farthest)
    return min(surface.kind.reach_about(surface.parameters, point, axis), farthest)
