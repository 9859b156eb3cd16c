"""What a wall shape is: one record per kind of shape, one record per shape."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

PARAMETER_COUNT = 16
"""Every shape of every kind is described by this many floats, so that all of them fit one device field."""

FAR_AWAY = 1e9
"""Distance [m] reported where a surface has no contact to offer (see `edges`): beyond any radius plus skin,
and small enough for its square to be finite in f32."""


@dataclass(frozen=True)
class ShapeKind:
    """A kind of surface: its device functions, their numpy twin, its triangles.

    closest            ti.func (point: 3-vector, parameters: 16-vector) -> (distance, normal)
                       Distance [m] from the surface to the point and unit normal from the surface to the
                       point. Negative distances exist for `half_space` only. FAR_AWAY where the nearest
                       point is an edge that another wall answers for.
    surface_distance   ti.func (point, parameters) -> distance of the surface alone, shared rims not
                       considered: what a list of near walls must be built from, because a point beyond a
                       rim can be above the face a moment later.
    reference_closest  numpy twin of `closest`, over points (n, 3): -> (distance (n,), normal (n, 3))
    triangles          (parameters, center (3,), extent) -> (points (m, 3), triangles (k, 3)): for pictures;
                       unbounded kinds show a square patch of half width `extent` about the foot of `center`.
    reach_about        (parameters, point (3,), unit axis (3,)) -> largest distance [m] from the axis of any
                       point of the surface, 0 where turning about the axis maps the surface onto itself.
    area               (parameters) -> area [m2] of the surface, None where it has no end.
    """

    name: str
    parameter_names: tuple[str, ...]
    closest: Callable
    surface_distance: Callable
    reference_closest: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
    triangles: Callable[[np.ndarray, np.ndarray, float], tuple[np.ndarray, np.ndarray]]
    reach_about: Callable[[np.ndarray, np.ndarray, np.ndarray], float]
    area: Callable[[np.ndarray], float | None]


@dataclass(frozen=True, eq=False)
class Shape:
    """One surface at rest: its kind and its parameters, (16,) float64, read-only, unused ones 0."""

    kind: ShapeKind
    parameters: np.ndarray

    def __getitem__(self, name: str) -> float:
        """The parameter called `name` in the kind's `parameter_names`."""
        return float(self.parameters[self.kind.parameter_names.index(name)])

    def with_parameters(self, **values: float) -> "Shape":
        """A copy in which the named parameters have new values."""
        parameters = self.parameters.copy()
        for name, value in values.items():
            parameters[self.kind.parameter_names.index(name)] = value
        return replace(self, parameters=read_only(parameters))


def make_shape(kind: ShapeKind, *values: object) -> Shape:
    """A shape from scalars and 3-vectors in the order of the kind's parameter names."""
    flat = np.concatenate([np.atleast_1d(np.asarray(value, dtype=np.float64)) for value in values])
    if len(flat) != len(kind.parameter_names):
        raise ValueError(f"{kind.name} takes {len(kind.parameter_names)} numbers, got {len(flat)}.")
    if not np.all(np.isfinite(flat)):
        raise ValueError(f"{kind.name} got a number that is not finite.")
    return Shape(kind, read_only(np.pad(flat, (0, PARAMETER_COUNT - len(flat)))))


def read_only(array: np.ndarray) -> np.ndarray:
    """The same array, locked against writing."""
    array.setflags(write=False)
    return array


def unit(vector: object) -> np.ndarray:
    """The (3,) vector scaled to length 1; ValueError if it has no direction."""
    array = np.asarray(vector, dtype=np.float64)
    length = np.linalg.norm(array)
    if array.shape != (3,) or not length > 0:
        raise ValueError(f"{vector} has no direction.")
    return array / length


def distance_from_axis(points: np.ndarray, point: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Distance (n,) of points (n, 3) from the line through `point` along the unit vector `axis`."""
    return np.linalg.norm(np.cross(np.atleast_2d(points) - point, axis), axis=1)


def is_parallel(first: np.ndarray, second: np.ndarray, tolerance: float = 1e-9) -> bool:
    """Whether two unit vectors lie along one line, either way round."""
    return bool(np.linalg.norm(np.cross(first, second)) <= tolerance)
