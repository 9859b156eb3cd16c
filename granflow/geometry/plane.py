"""Flat walls: half space (one-sided) and rectangle (two-sided).

Where rectangles touch each other or other walls, `engine.walls.build_wall_contact` finds the one that has a
contact.
"""

from collections.abc import Sequence

import numpy as np

from granflow.device_functions import ti
from granflow.geometry.shape import (
    Shape,
    ShapeKind,
    are_perpendicular,
    distance_from_axis,
    is_parallel,
    make_shape,
    unit,
)

HALF_SPACE_PARAMETER_NAMES = ("point_x", "point_y", "point_z", "normal_x", "normal_y", "normal_z")
"""Parameters of a half space, in this order: a point of the plane [m] and the unit normal."""
POINT_X, POINT_Y, POINT_Z, NORMAL_X, NORMAL_Y, NORMAL_Z = range(len(HALF_SPACE_PARAMETER_NAMES))
"""Indices of the parameters of a half space."""
POINT = slice(POINT_X, POINT_Z + 1)
NORMAL = slice(NORMAL_X, NORMAL_Z + 1)
"""Parts of the parameters of a half space on the host."""
RECTANGLE_PARAMETER_NAMES = (
    "corner_x",
    "corner_y",
    "corner_z",
    "direction1_x",
    "direction1_y",
    "direction1_z",
    "direction2_x",
    "direction2_y",
    "direction2_z",
    "normal_x",
    "normal_y",
    "normal_z",
    "length1",
    "length2",
)
"""Parameters of a rectangle, in this order: a corner [m], three perpendicular unit vectors, lengths [m]."""
(
    CORNER_X,
    CORNER_Y,
    CORNER_Z,
    DIRECTION1_X,
    DIRECTION1_Y,
    DIRECTION1_Z,
    DIRECTION2_X,
    DIRECTION2_Y,
    DIRECTION2_Z,
    FACE_X,
    FACE_Y,
    FACE_Z,
    LENGTH1,
    LENGTH2,
) = range(len(RECTANGLE_PARAMETER_NAMES))
"""Indices of the parameters of a rectangle; FACE is its normal, since NORMAL is that of a half space."""
CORNER = slice(CORNER_X, CORNER_Z + 1)
DIRECTION1 = slice(DIRECTION1_X, DIRECTION1_Z + 1)
DIRECTION2 = slice(DIRECTION2_X, DIRECTION2_Z + 1)
DIRECTIONS = slice(DIRECTION1_X, DIRECTION2_Z + 1)
LENGTHS = slice(LENGTH1, LENGTH2 + 1)
"""Parts of the parameters of a rectangle on the host."""


def half_space(point: object, normal: object) -> Shape:
    """Half space: solid behind the plane through `point`; particles are on the side of `normal`.

    point:   (3,) [m]
    normal:  (3,), any length above 0
    Raises:  ValueError if the normal has no direction or a number is not finite
    """
    return make_shape(HALF_SPACE, point, unit(normal))


def rectangle(corner: object, side1: Sequence[float], side2: Sequence[float]) -> Shape:
    """Two-sided thin plate from a corner along two perpendicular edge vectors.

    corner:        (3,) [m]
    side1, side2:  (3,) [m] edge vectors
    Raises:        ValueError if the sides are not perpendicular (RIGHT_ANGLE_COSINE), or if a side has no
                   length

    The second direction is made exactly perpendicular to the first; the lengths remain those of the edge
    vectors.
    """
    if not are_perpendicular(side1, side2):
        raise ValueError("The sides of a rectangle must be perpendicular.")
    direction1 = unit(side1)
    direction2 = unit(side2)
    direction2 = unit(direction2 - float(direction1 @ direction2) * direction1)
    normal = np.cross(direction1, direction2)
    lengths = np.linalg.norm(np.asarray(side1, dtype=float)), np.linalg.norm(np.asarray(side2, dtype=float))
    return make_shape(RECTANGLE, corner, direction1, direction2, normal, *lengths)


# A half space: device functions, reference implementation, and kind


@ti.func
def closest_on_half_space(point, parameters):
    """Signed distance from the plane and normal of the plane (ShapeKind.closest).

        d = (x - p) . n

    Returns:  d [m], negative behind the plane; n
    """
    normal = ti.Vector([parameters[NORMAL_X], parameters[NORMAL_Y], parameters[NORMAL_Z]])
    distance = half_space_distance(point, parameters)
    return distance, normal


@ti.func
def half_space_normal(point, parameters):
    """Normal of the plane (ShapeKind.face_normal)."""
    return ti.Vector([parameters[NORMAL_X], parameters[NORMAL_Y], parameters[NORMAL_Z]])


@ti.func
def half_space_distance(point, parameters):
    """Signed distance from the plane [m] (ShapeKind.surface_distance)."""
    return (
        (point[0] - parameters[POINT_X]) * parameters[NORMAL_X]
        + (point[1] - parameters[POINT_Y]) * parameters[NORMAL_Y]
        + (point[2] - parameters[POINT_Z]) * parameters[NORMAL_Z]
    )


def reference_closest_on_half_space(
    points: np.ndarray, parameters: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Reference implementation of `closest_on_half_space`: project the point, measure along the normal.

    points:   (n, 3) [m]
    Returns:  signed distance (n,) [m], normal (n, 3)
    """
    origin = parameters[POINT]
    normal = parameters[NORMAL]
    distance = (points - origin) @ normal
    return distance, np.broadcast_to(normal, points.shape).copy()


def half_space_triangles(
    parameters: np.ndarray, center: np.ndarray, extent: float
) -> tuple[np.ndarray, np.ndarray]:
    """Square of half width `extent` [m] about the projection of `center` (3,) [m] on the plane.

    Returns points (4, 3) [m] and triangles (2, 3).
    """
    origin = parameters[POINT]
    normal = parameters[NORMAL]
    foot = np.asarray(center) - ((np.asarray(center) - origin) @ normal) * normal
    side1 = unit(np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))]))
    side2 = np.cross(normal, side1)
    return quadrilateral(foot - extent * (side1 + side2), 2 * extent * side1, 2 * extent * side2)


def half_space_reach(parameters: np.ndarray, point: np.ndarray, axis: np.ndarray) -> float:
    """Infinite; 0 for rotation about an axis along the normal, which maps the plane onto itself."""
    return 0.0 if is_parallel(parameters[NORMAL], axis) else float("inf")


HALF_SPACE = ShapeKind(
    name="half_space",
    parameter_names=HALF_SPACE_PARAMETER_NAMES,
    closest=closest_on_half_space,
    face_normal=half_space_normal,
    surface_distance=half_space_distance,
    reference_closest=reference_closest_on_half_space,
    triangles=half_space_triangles,
    reach_about=half_space_reach,
    area=lambda parameters: None,
)

# A rectangle, likewise


@ti.func
def closest_on_rectangle(point, parameters):
    """Distance [m] from the rectangle and unit vector from its nearest point (ShapeKind.closest).

    At distance 0 the unit vector is the normal of the plane.
    """
    beyond = rectangle_coordinates(point, parameters)
    distance = beyond.norm()
    on_surface = distance == 0.0
    divisor = ti.select(on_surface, 1.0, distance)
    component1 = beyond[0] / divisor
    component2 = beyond[1] / divisor
    component3 = ti.select(on_surface, 1.0, beyond[2] / divisor)
    normal = ti.Vector(
        [
            component1 * parameters[DIRECTION1_X]
            + component2 * parameters[DIRECTION2_X]
            + component3 * parameters[FACE_X],
            component1 * parameters[DIRECTION1_Y]
            + component2 * parameters[DIRECTION2_Y]
            + component3 * parameters[FACE_Y],
            component1 * parameters[DIRECTION1_Z]
            + component2 * parameters[DIRECTION2_Z]
            + component3 * parameters[FACE_Z],
        ]
    )
    return distance, normal


@ti.func
def rectangle_normal(point, parameters):
    """Normal of the plane of the rectangle (ShapeKind.face_normal)."""
    return ti.Vector([parameters[FACE_X], parameters[FACE_Y], parameters[FACE_Z]])


@ti.func
def rectangle_distance(point, parameters):
    """Distance from the rectangle [m], at least 0 (ShapeKind.surface_distance)."""
    return rectangle_coordinates(point, parameters).norm()


@ti.func
def rectangle_coordinates(point, parameters):
    """Vector from the nearest point of the rectangle to the point, in the frame of the rectangle [m].

    Components: distance beyond the edges along both sides (0 above the face), and height above the face.
    """
    offset = ti.Vector(
        [point[0] - parameters[CORNER_X], point[1] - parameters[CORNER_Y], point[2] - parameters[CORNER_Z]]
    )
    along1 = (
        offset[0] * parameters[DIRECTION1_X]
        + offset[1] * parameters[DIRECTION1_Y]
        + offset[2] * parameters[DIRECTION1_Z]
    )
    along2 = (
        offset[0] * parameters[DIRECTION2_X]
        + offset[1] * parameters[DIRECTION2_Y]
        + offset[2] * parameters[DIRECTION2_Z]
    )
    height = offset[0] * parameters[FACE_X] + offset[1] * parameters[FACE_Y] + offset[2] * parameters[FACE_Z]
    beyond1 = along1 - ti.min(ti.max(along1, 0.0), parameters[LENGTH1])
    beyond2 = along2 - ti.min(ti.max(along2, 0.0), parameters[LENGTH2])
    return ti.Vector([beyond1, beyond2, height])


def reference_closest_on_rectangle(
    points: np.ndarray, parameters: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Reference implementation of `closest_on_rectangle`: the nearest point, then the vector from it.

    points:   (n, 3) [m]
    Returns:  distance (n,) [m], unit vector (n, 3)
    """
    corner = parameters[CORNER]
    frame = parameters[DIRECTIONS].reshape(2, 3)
    lengths = parameters[LENGTHS]
    along = np.clip((points - corner) @ frame.T, 0.0, lengths)
    from_surface = points - (corner + along @ frame)
    distance = np.linalg.norm(from_surface, axis=1)
    on_surface = distance == 0.0
    normal = from_surface / np.where(on_surface, 1.0, distance)[:, None]
    normal[on_surface] = np.cross(frame[0], frame[1])
    return distance, normal


def rectangle_triangles(
    parameters: np.ndarray, center: np.ndarray, extent: float
) -> tuple[np.ndarray, np.ndarray]:
    """Points (4, 3) [m] and triangles (2, 3) of the rectangle; `center` and `extent` are unused."""
    return quadrilateral(parameters[CORNER], *rectangle_sides(parameters))


def rectangle_reach(parameters: np.ndarray, point: np.ndarray, axis: np.ndarray) -> float:
    """Distance [m] of the farthest corner from the axis: `point` (3,) [m], unit vector `axis` (3,)."""
    corners, _ = quadrilateral(parameters[CORNER], *rectangle_sides(parameters))
    return float(distance_from_axis(corners, point, axis).max())


def rectangle_sides(parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The two edge vectors (3,) [m]."""
    return parameters[DIRECTION1] * parameters[LENGTH1], parameters[DIRECTION2] * parameters[LENGTH2]


def quadrilateral(corner: np.ndarray, side1: np.ndarray, side2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (4, 3) [m] and triangles (2, 3) of the parallelogram with a corner and two sides, each (3,)."""
    points = np.array([corner, corner + side1, corner + side1 + side2, corner + side2])
    return points, np.array([[0, 1, 2], [0, 2, 3]])


RECTANGLE = ShapeKind(
    name="rectangle",
    parameter_names=RECTANGLE_PARAMETER_NAMES,
    closest=closest_on_rectangle,
    face_normal=rectangle_normal,
    surface_distance=rectangle_distance,
    reference_closest=reference_closest_on_rectangle,
    triangles=rectangle_triangles,
    reach_about=rectangle_reach,
    area=lambda parameters: float(parameters[LENGTH1] * parameters[LENGTH2]),
)
