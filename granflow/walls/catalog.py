"""Kinds of wall shapes in a fixed order; the index is the code that device functions switch on."""

import numpy as np

from granflow.walls.mesh import Mesh
from granflow.walls.mesh_grid import distances, grid_over
from granflow.walls.plane import HALF_SPACE, RECTANGLE
from granflow.walls.revolved import REVOLVED
from granflow.walls.shape import Shape, ShapeKind

SHAPE_KINDS: tuple[ShapeKind, ...] = (HALF_SPACE, RECTANGLE, REVOLVED)


Surface = Shape | Mesh
"""Geometry of a wall in its rest pose."""


def kind_code(kind: ShapeKind) -> int:
    """Index of the kind in SHAPE_KINDS."""
    return SHAPE_KINDS.index(kind)


def area_of(surface: Surface) -> float | None:
    """Area [m2] of a surface; None if it is unbounded."""
    return surface.area if isinstance(surface, Mesh) else surface.kind.area(surface.parameters)


def surface_code(surface: Surface) -> int:
    """Code of the kind of a wall: that of its shape; all meshes have the next code."""
    return len(SHAPE_KINDS) if isinstance(surface, Mesh) else kind_code(surface.kind)


def triangles(surface: Surface, center: np.ndarray, extent: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (m, 3) [m] and triangles (k, 3) of a surface at rest, for visualization.

    An unbounded shape is shown as a square of half width `extent` about the projection of `center` (use the center of
    the domain and half its largest side); other shapes are shown completely.
    """
    if isinstance(surface, Mesh):
        return surface.points, surface.corners
    return surface.kind.triangles(surface.parameters, np.asarray(center, dtype=np.float64), extent)


def distance_from(surface: Surface, points: np.ndarray, reach: float) -> np.ndarray:
    """Distance (n,) [m] of points (n, 3) from a surface; for meshes limited to `reach`."""
    if isinstance(surface, Mesh):
        vertex = surface.adjacency.vertex
        return distances(grid_over(vertex, reach), vertex, points)
    return surface.kind.reference_closest(points, surface.parameters)[0]


def reach_about(surface: Surface, point: np.ndarray, axis: np.ndarray, farthest: float) -> float:
    """Largest distance [m] from an axis of geometry that moves when the wall rotates, for `motion.speed_bound`.

    At most `farthest`, the largest distance of a particle from the axis. 0 for a surface of revolution that rotates
    about its own axis, and for a half space that rotates about its normal.
    """
    point, axis = np.asarray(point), np.asarray(axis)
    if isinstance(surface, Mesh):
        return min(surface.reach_about(point, axis), farthest)
    return min(surface.kind.reach_about(surface.parameters, point, axis), farthest)
