"""The kinds of wall shapes in a fixed order; the place in it is the code the device switches on."""

import numpy as np

from granflow.walls.plane import HALF_SPACE, RECTANGLE
from granflow.walls.revolved import REVOLVED
from granflow.walls.shape import Shape, ShapeKind

SHAPE_KINDS: tuple[ShapeKind, ...] = (HALF_SPACE, RECTANGLE, REVOLVED)


def kind_code(kind: ShapeKind) -> int:
    """The place of the kind in SHAPE_KINDS."""
    return SHAPE_KINDS.index(kind)


def area_of(shape: Shape) -> float | None:
    """Area [m2] of a shape; None for one without end."""
    return shape.kind.area(shape.parameters)


def triangles(shape: Shape, center: np.ndarray, extent: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (m, 3) [m] and triangles (k, 3) of a shape at rest, for pictures.

    Unbounded shapes show a square of half width `extent` about the foot of `center` (take the middle of the
    domain and half its largest side); others show all of themselves.
    """
    return shape.kind.triangles(shape.parameters, np.asarray(center, dtype=np.float64), extent)


def reach_about(shape: Shape, point: np.ndarray, axis: np.ndarray, farthest: float) -> float:
    """How far from an axis the shape's geometry moves when it turns about it, for `motion.speed_bound` [m].

    At most `farthest`, the largest distance from the axis at which there can be particles. 0 for a surface of
    revolution that turns about its own axis, and for a half space about its normal.
    """
    return min(shape.kind.reach_about(shape.parameters, np.asarray(point), np.asarray(axis)), farthest)
