"""Kinds of wall shapes in a fixed order; the index is the code that device functions switch on."""

import numpy as np

from granflow.geometry.mesh import Mesh, distances, grid_over
from granflow.geometry.plane import HALF_SPACE, RECTANGLE
from granflow.geometry.revolved import REVOLVED
from granflow.geometry.shape import Shape, ShapeKind

SHAPE_KINDS: tuple[ShapeKind, ...] = (HALF_SPACE, RECTANGLE, REVOLVED)
"""Kinds of shapes other than meshes."""
Surface = Shape | Mesh
"""Geometry of a wall in its rest pose."""


def surface_code(surface: Surface) -> int:
    """Code of the kind of a wall: that of its shape; all meshes have the next code."""
    return len(SHAPE_KINDS) if isinstance(surface, Mesh) else kind_code(surface.kind)


def kind_code(kind: ShapeKind) -> int:
    """Index of the kind in SHAPE_KINDS."""
    return SHAPE_KINDS.index(kind)


def distance_from(surface: Surface, points: np.ndarray, reach: float) -> np.ndarray:
    """Distance of points from a surface at rest, without regard to shared edges of a mesh.

    points:   (n, 3) float64 [m]
    reach:    distance [m] up to which the result is exact for a mesh; farther points get a larger distance or
              FAR_AWAY
    Returns:  distance (n,) [m]; FAR_AWAY at the edge of a surface of revolution that another wall owns
    """
    if isinstance(surface, Mesh):
        vertex = surface.adjacency.vertex
        return distances(grid_over(vertex, reach), vertex, points)
    return surface.kind.reference_closest(points, surface.parameters)[0]


def reach_about(surface: Surface, point: np.ndarray, axis: np.ndarray, farthest: float) -> float:
    """Largest distance [m] from an axis of geometry that moves when the wall rotates.

    `motion.speed_bound` uses it.

    point:     (3,) [m], a point on the axis
    axis:      (3,), unit vector along the axis
    farthest:  largest distance [m] of a particle from the axis; the result is at most this value
    Returns:   0 for a surface of revolution that rotates about its own axis, and for a half space that
               rotates about its normal
    """
    point = np.asarray(point)
    axis = np.asarray(axis)
    if isinstance(surface, Mesh):
        return min(surface.reach_about(point, axis), farthest)
    return min(surface.kind.reach_about(surface.parameters, point, axis), farthest)


def area_of(surface: Surface) -> float | None:
    """Area [m2] of one side of a surface; None if it is unbounded."""
    return surface.area if isinstance(surface, Mesh) else surface.kind.area(surface.parameters)


def triangles(surface: Surface, center: np.ndarray, extent: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (m, 3) [m] and triangles (k, 3) of a surface at rest, for visualization.

    surface:  shape or mesh in its rest pose
    center:   (3,) [m], center of the domain
    extent:   half width [m] of the square that shows an unbounded shape, half the largest side of the domain
    Returns:  points (m, 3) float64 [m]; triangles (k, 3) as indices of the points

    An unbounded shape is shown as a square about the projection of `center`; other shapes are shown
    completely.
    """
    if isinstance(surface, Mesh):
        return surface.points, surface.corners
    return surface.kind.triangles(surface.parameters, np.asarray(center, dtype=np.float64), extent)
