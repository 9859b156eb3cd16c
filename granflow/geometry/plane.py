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
    normal = ti.Vector([parameters[3], parameters[4], parameters[5]])
    distance = half_space_distance(point, parameters)
    return distance, normal


@ti.func
def half_space_normal(point, parameters):
    """Normal of the plane (ShapeKind.face_normal)."""
    return ti.Vector([parameters[3], parameters[4], parameters[5]])


@ti.func
def half_space_distance(point, parameters):
    """Signed distance from the plane [m] (ShapeKind.surface_distance)."""
    return (
        (point[0] - parameters[0]) * parameters[3]
        + (point[1] - parameters[1]) * parameters[4]
        + (point[2] - parameters[2]) * parameters[5]
    )


def reference_closest_on_half_space(
    points: np.ndarray, parameters: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Reference implementation of `closest_on_half_space`: project the point, measure along the normal.

    points:   (n, 3) [m]
    Returns:  signed distance (n,) [m], normal (n, 3)
    """
    origin = parameters[0:3]
    normal = parameters[3:6]
    distance = (points - origin) @ normal
    return distance, np.broadcast_to(normal, points.shape).copy()


def half_space_triangles(
    parameters: np.ndarray, center: np.ndarray, extent: float
) -> tuple[np.ndarray, np.ndarray]:
    """Square of half width `extent` [m] about the projection of `center` (3,) [m] on the plane.

    Returns points (4, 3) [m] and triangles (2, 3).
    """
    origin = parameters[0:3]
    normal = parameters[3:6]
    foot = np.asarray(center) - ((np.asarray(center) - origin) @ normal) * normal
    side1 = unit(np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))]))
    side2 = np.cross(normal, side1)
    return quadrilateral(foot - extent * (side1 + side2), 2 * extent * side1, 2 * extent * side2)


def half_space_reach(parameters: np.ndarray, point: np.ndarray, axis: np.ndarray) -> float:
    """Infinite; 0 for rotation about an axis along the normal, which maps the plane onto itself."""
    return 0.0 if is_parallel(parameters[3:6], axis) else float("inf")


HALF_SPACE = ShapeKind(
    name="half_space",
    parameter_names=("point_x", "point_y", "point_z", "normal_x", "normal_y", "normal_z"),
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
            component1 * parameters[3] + component2 * parameters[6] + component3 * parameters[9],
            component1 * parameters[4] + component2 * parameters[7] + component3 * parameters[10],
            component1 * parameters[5] + component2 * parameters[8] + component3 * parameters[11],
        ]
    )
    return distance, normal


@ti.func
def rectangle_normal(point, parameters):
    """Normal of the plane of the rectangle (ShapeKind.face_normal)."""
    return ti.Vector([parameters[9], parameters[10], parameters[11]])


@ti.func
def rectangle_distance(point, parameters):
    """Distance from the rectangle [m], at least 0 (ShapeKind.surface_distance)."""
    return rectangle_coordinates(point, parameters).norm()


@ti.func
def rectangle_coordinates(point, parameters):
    """Vector from the nearest point of the rectangle to the point, in the frame of the rectangle [m].

    Components: distance beyond the edges along both sides (0 above the face), and height above the face.
    """
    offset = ti.Vector([point[0] - parameters[0], point[1] - parameters[1], point[2] - parameters[2]])
    along1 = offset[0] * parameters[3] + offset[1] * parameters[4] + offset[2] * parameters[5]
    along2 = offset[0] * parameters[6] + offset[1] * parameters[7] + offset[2] * parameters[8]
    height = offset[0] * parameters[9] + offset[1] * parameters[10] + offset[2] * parameters[11]
    beyond1 = along1 - ti.min(ti.max(along1, 0.0), parameters[12])
    beyond2 = along2 - ti.min(ti.max(along2, 0.0), parameters[13])
    return ti.Vector([beyond1, beyond2, height])


def reference_closest_on_rectangle(
    points: np.ndarray, parameters: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Reference implementation of `closest_on_rectangle`: the nearest point, then the vector from it.

    points:   (n, 3) [m]
    Returns:  distance (n,) [m], unit vector (n, 3)
    """
    corner = parameters[0:3]
    frame = parameters[3:9].reshape(2, 3)
    lengths = parameters[12:14]
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
    return quadrilateral(parameters[0:3], *rectangle_sides(parameters))


def rectangle_reach(parameters: np.ndarray, point: np.ndarray, axis: np.ndarray) -> float:
    """Distance [m] of the farthest corner from the axis: `point` (3,) [m], unit vector `axis` (3,)."""
    corners, _ = quadrilateral(parameters[0:3], *rectangle_sides(parameters))
    return float(distance_from_axis(corners, point, axis).max())


def rectangle_sides(parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The two edge vectors (3,) [m]."""
    return parameters[3:6] * parameters[12], parameters[6:9] * parameters[13]


def quadrilateral(corner: np.ndarray, side1: np.ndarray, side2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (4, 3) [m] and triangles (2, 3) of the parallelogram with a corner and two sides, each (3,)."""
    points = np.array([corner, corner + side1, corner + side1 + side2, corner + side2])
    return points, np.array([[0, 1, 2], [0, 2, 3]])


RECTANGLE = ShapeKind(
    name="rectangle",
    parameter_names=(
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
    ),
    closest=closest_on_rectangle,
    face_normal=rectangle_normal,
    surface_distance=rectangle_distance,
    reference_closest=reference_closest_on_rectangle,
    triangles=rectangle_triangles,
    reach_about=rectangle_reach,
    area=lambda parameters: float(parameters[12] * parameters[13]),
)
