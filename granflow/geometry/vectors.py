"""Vectors in numpy: directions, angles and distances."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

RIGHT_ANGLE_COSINE = 1e-6
"""Largest absolute cosine of an angle that is accepted as 90 deg."""


def unit(vector: object) -> np.ndarray:
    """Vector (3,) scaled to length 1, float64.

    Raises ValueError for another shape or a vector of length 0.
    """
    array = np.asarray(vector, dtype=np.float64)
    length = np.linalg.norm(array)
    if array.shape != (3,) or not length > 0:
        raise ValueError(f"{vector} has no direction.")
    return array / length


def are_perpendicular(*vectors: Sequence[float] | np.ndarray) -> bool:
    """Whether each two of the vectors (3,) are perpendicular.

    Their lengths are above 0 and do not matter.
    """
    directions = [unit(np.asarray(vector, dtype=np.float64) / np.max(np.abs(vector))) for vector in vectors]
    return all(abs(float(a @ b)) <= RIGHT_ANGLE_COSINE for a, b in combinations(directions, 2))


def distance_from_axis(points: np.ndarray, point: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Distance of points from an axis.

    points:   (n, 3) [m], or one point (3,)
    point:    (3,) [m], a point on the axis
    axis:     (3,) unit vector
    Returns:  (n,) [m]
    """
    return np.linalg.norm(np.cross(np.atleast_2d(points) - point, axis), axis=1)


def is_parallel(first: np.ndarray, second: np.ndarray, tolerance: float = 1e-9) -> bool:
    """Whether two unit vectors (3,) are parallel or antiparallel, up to the sine `tolerance`."""
    return bool(np.linalg.norm(np.cross(first, second)) <= tolerance)


def frame_along(axis: np.ndarray) -> np.ndarray:
    """Right-handed orthonormal frame (3, 3) as rows; the last row is the given axis, a unit vector (3,).

    `frame @ v` gives the components of a vector v in the frame.
    """
    first = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(axis, first), axis])
