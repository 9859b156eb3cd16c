"""Wall shapes: one record per kind of shape, one record per shape; vectors, and the volume of spheres.

A kind contains the device functions, the reference implementation and the triangles of its shapes;
`catalog` lists the kinds.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import pi
from typing import TypeVar

import numpy as np

PARAMETER_COUNT = 16
"""Number of parameters of every shape, so that all shapes fit one device field."""
RIGHT_ANGLE_COSINE = 1e-6
"""Largest absolute cosine of an angle that is accepted as 90 deg."""
FAR_AWAY = 1e9
"""Distance [m] returned if a surface does not own the contact (see `revolved.join_shared_edges`): larger than
any radius plus skin, and small enough for its square to be finite in float32."""


@dataclass(frozen=True)
class ShapeKind:
    """A kind of surface: device functions, reference implementation and triangles.

        closest            ti.func (point: 3-vector, parameters: 16-vector) -> (distance, normal)
                           Distance [m] from the surface to the point and unit normal from the surface to the
                           point. Only `half_space` has negative distances. FAR_AWAY if the nearest point is
                           on an edge that another wall owns.
        face_normal        ti.func (point, parameters) -> unit normal of the face, extended beyond its edges,
                           where it is nearest to the point; either side
        surface_distance   ti.func (point, parameters) -> distance [m] without regard to shared edges. Wall
                           neighbor lists use it, because a point beyond an edge can be above the face in the
                           next step.
        reference_closest  reference implementation of `closest` for points (n, 3) [m]:
                           -> (distance (n,), normal (n, 3))
        triangles          (parameters, center (3,), extent) -> (points (m, 3), triangles (k, 3)) for
                           visualization; an unbounded kind is a square of half width `extent` about the
                           projection of `center`.
        reach_about        (parameters, point (3,), unit axis (3,)) -> largest distance [m] of a point of the
                           surface from the axis, 0 if rotation about the axis maps the surface onto itself.
        area               (parameters) -> area [m2] of the surface, None if it is unbounded.

    Points are in the frame of the wall at rest.
    """

    name: str
    parameter_names: tuple[str, ...]
    closest: Callable
    face_normal: Callable
    surface_distance: Callable
    reference_closest: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
    triangles: Callable[[np.ndarray, np.ndarray, float], tuple[np.ndarray, np.ndarray]]
    reach_about: Callable[[np.ndarray, np.ndarray, np.ndarray], float]
    area: Callable[[np.ndarray], float | None]


@dataclass(frozen=True, eq=False)
class Shape:
    """One surface at rest: kind and parameters (16,), float64, read-only, unused ones 0.

    `parameters` are in the order of `kind.parameter_names`; lengths in m, directions are unit vectors.
    """

    kind: ShapeKind
    parameters: np.ndarray

    def __getitem__(self, name: str) -> float:
        """Parameter with a name of `kind.parameter_names`. Raises ValueError for another name."""
        return float(self.parameters[self.kind.parameter_names.index(name)])

    def with_parameters(self, **values: float) -> "Shape":
        """Copy with new values of the named parameters. Raises ValueError for an unknown name."""
        parameters = self.parameters.copy()
        for name, value in values.items():
            parameters[self.kind.parameter_names.index(name)] = value
        return replace(self, parameters=read_only(parameters))


def make_shape(kind: ShapeKind, *values: object) -> Shape:
    """Build a shape from scalars and 3-vectors in the order of `kind.parameter_names`.

    Raises ValueError for another count of numbers, or a number that is not finite.
    """
    flat = np.concatenate([np.atleast_1d(np.asarray(value, dtype=np.float64)) for value in values])
    if len(flat) != len(kind.parameter_names):
        raise ValueError(f"{kind.name} takes {len(kind.parameter_names)} numbers, got {len(flat)}.")
    if not np.all(np.isfinite(flat)):
        raise ValueError(f"{kind.name} got a number that is not finite.")
    return Shape(kind, read_only(np.pad(flat, (0, PARAMETER_COUNT - len(flat)))))


def read_only(array: np.ndarray) -> np.ndarray:
    """The same array, set to read-only."""
    array.setflags(write=False)
    return array


def unit(vector: object) -> np.ndarray:
    """Vector (3,) scaled to length 1, float64.

    Raises ValueError for another shape or a vector of length 0.
    """
    array = np.asarray(vector, dtype=np.float64)
    length = np.linalg.norm(array)
    if array.shape != (3,) or not length > 0:
        raise ValueError(f"{vector} has no direction.")
    return array / length


def are_perpendicular(*vectors: Sequence[float]) -> bool:
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


# Volume and mass of spheres.

Number = TypeVar("Number", float, np.ndarray)


def sphere_volume(radius: Number) -> Number:
    """Volume 4/3 pi R^3 [m3] of spheres with radii [m]."""
    return 4.0 / 3.0 * pi * radius**3


def sphere_mass(radius: Number, density: Number | float) -> Number:
    """Mass [kg] of spheres with radii [m] and density [kg/m3]."""
    return sphere_volume(radius) * density
