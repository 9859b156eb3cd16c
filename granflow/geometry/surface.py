"""Surfaces of walls at rest: what plan, device and pictures ask of every surface.

A surface is a triangle mesh (`mesh.Mesh`) or an `AnalyticSurface`, a closed form with a few numbers, which
device functions read by name. The kinds of analytic surfaces are in `granflow.scene.blocks.walls`, each in
one file with the walls of a scene that have it.
"""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np

from granflow.device_functions import DeviceObject, at_compile_time, ti
from granflow.geometry.vectors import distance_from_axis

FAR_AWAY = 1e9
"""Distance [m] returned if a surface does not own the contact, see `Surface.with_edge_owners`: larger than
any radius plus skin, and small enough for its square to be finite in float32."""
SAME_CORNER = 1e-6
"""Tolerance of equal surfaces: of corners over the size of the surface, and of components of normals."""
Vector = np.ndarray
"""A vector (3,), float64."""


class Surface:
    """A surface at rest; points and lengths are in m in its frame.

    A `contact` is a distance and a normal, and belongs to one surface or triangle: it is FAR_AWAY at an edge
    that another one owns. A `distance` has no regard to shared edges. On the device both are functions of one
    point, on the host `contacts` and `distances` are those of many.

    `kind`: name of the kind. `is_curved`: its face has different normals.
    """

    kind: ClassVar[str]
    is_curved: ClassVar[bool] = False

    @property
    def plane(self) -> tuple[Vector, Vector] | None:
        """A point and the unit normal of a half space, which is solid behind its plane; None for others."""
        return None

    @property
    def area(self) -> float | None:
        """Area [m2] of one side; None if it is unbounded."""
        raise NotImplementedError

    def contacts(
        self, points: np.ndarray, triangles: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Distance (n,) from points (n, 3), and unit normals (n, 3) toward them.

        `triangles` (n,): index of the triangle of each point, needed for a mesh. FAR_AWAY if the nearest
        point of the surface, or of the triangle, is on an edge that another one owns.
        """
        raise NotImplementedError

    def distances(self, points: np.ndarray, reach: float) -> np.ndarray:
        """Distance (n,) of points (n, 3), for a mesh without regard to shared edges.

        `reach`: distance up to which the result is exact for a mesh; farther points get a larger distance or
        FAR_AWAY.
        """
        raise NotImplementedError

    def encloses(self, points: np.ndarray) -> np.ndarray:
        """Whether points (n, 3) are inside a closed mesh; False for others."""
        return np.zeros(len(points), dtype=bool)

    def sides(self, points: np.ndarray) -> np.ndarray:
        """1 for points (n, 3) inside of a hollow surface of revolution and -1 for points outside, between its
        ends; 0 for others."""
        return np.zeros(len(points), dtype=int)

    def farthest_from(self, point: Vector, axis: Vector) -> float:
        """Largest distance of its points from an axis; infinite for an unbounded surface.

        `point`: on the axis; `axis`: unit vector.
        """
        return float(distance_from_axis(self.triangles(np.zeros(3), 0.0)[0], point, axis).max())

    def turns_in_place(self, point: Vector, axis: Vector) -> bool:
        """Whether a rotation about an axis through `point` maps the surface onto itself."""
        return False

    def reach_about(self, point: Vector, axis: Vector) -> float:
        """Largest distance from an axis of geometry that moves when the wall rotates; may be infinite.

        0 if the rotation maps the surface onto itself.
        """
        return 0.0 if self.turns_in_place(point, axis) else self.farthest_from(point, axis)

    def triangles(self, center: Vector, extent: float) -> tuple[np.ndarray, np.ndarray]:
        """Points (m, 3) and triangles (k, 3), indices of points, for visualization.

        An unbounded surface is a square of half width `extent` about the projection of `center`; others are
        complete.
        """
        raise NotImplementedError

    def enclosing_points(self) -> np.ndarray:
        """Points (n, 3) whose bounding box contains a bounded surface."""
        return self.triangles(np.zeros(3), 1.0)[0]

    def is_upright(self, point: Vector, normal: Vector, tolerance: float) -> bool:
        """Whether it rises at a right angle from a plane wherever it is at most a tolerance above it.

        A particle on the plane is then in contact with it at the height of its center. False if that is not
        known.
        """
        return False

    def has_touching_parts(self, tolerance: float) -> bool:
        """Whether parts of the surface may be nearer to each other than a tolerance, without common edges."""
        return False

    def with_edge_owners(self, surfaces: Sequence["Surface"], index: int) -> "Surface":
        """This surface with the numbers that say which of its shared edges it owns.

        `surfaces`: all that move alike; this one is at `index`. Touching surfaces without common edges are
        joined walls (`plan.joined_walls`) instead, whose contacts are compared during the run.
        """
        return self

    def has_same_place(self, other: "Surface") -> bool:
        """Whether both are the same half space, or have the same corners, within rounding."""
        if self.plane is not None and other.plane is not None:
            (point, normal), (other_point, other_normal) = self.plane, other.plane
            distance = (other_point - point) @ normal
            size = np.abs([point, other_point]).max()
            is_parallel = np.linalg.norm(normal - other_normal) <= SAME_CORNER
            return bool(is_parallel and abs(distance) <= SAME_CORNER * size)
        if self.plane is not None or other.plane is not None:
            return False
        points = self.triangles(np.zeros(3), 1.0)[0]
        other_points = other.triangles(np.zeros(3), 1.0)[0]
        if points.shape != other_points.shape:
            return False
        tolerance = SAME_CORNER * np.ptp(points, axis=0).max()
        rounded = np.round(points / tolerance)
        other_rounded = np.round(other_points / tolerance)
        return np.array_equal(rounded[np.lexsort(rounded.T)], other_rounded[np.lexsort(other_rounded.T)])


def assign_shared_edges(surfaces: Sequence[Surface], groups: Sequence[Hashable]) -> list[Surface]:
    """The same surfaces with an owner of each shared edge; see `Surface.with_edge_owners`.

    `groups`: wall motion of each surface: only surfaces with the same motion share edges. Repeated calls are
    idempotent.
    """
    found = []
    for surface, group in zip(surfaces, groups, strict=True):
        alike = [each for each, its_group in zip(surfaces, groups, strict=True) if its_group == group]
        index = next(k for k, each in enumerate(alike) if each is surface)
        found.append(surface.with_edge_owners(alike, index))
    return found


def boxes_overlap(
    points: np.ndarray, others: np.ndarray, tolerance: float, periodic_axes: Sequence[int] = ()
) -> bool:
    """Whether the bounding boxes of points (n, 3) and others overlap within a tolerance [m].

    Along periodic axes they always do, by their images.
    """
    is_near = (points.min(axis=0) <= others.max(axis=0) + tolerance) & (
        others.min(axis=0) <= points.max(axis=0) + tolerance
    )
    is_near[list(periodic_axes)] = True
    return bool(is_near.all())


# Surfaces in closed form, which the device evaluates from a few numbers.


@dataclass(frozen=True, eq=False)
class AnalyticSurface(Surface):
    """A surface in closed form. Its fields are its numbers, lengths in m: `float`, or `Vector`.

    Device functions read the numbers by name. Raises ValueError for a number that is not finite.
    """

    contact: ClassVar[Callable[..., Any]]
    """Device function (point, numbers) -> (distance, normal): distance [m] of a point, and unit normal from
    the surface to it. Only a half space has negative distances. FAR_AWAY as in `contacts`."""
    face_normal: ClassVar[Callable[..., Any]]
    """Device function (point, numbers) -> unit normal of the face, extended beyond its edges, where it is
    nearest to the point; either side."""
    distance: ClassVar[Callable[..., Any]]
    """Device function (point, numbers) -> distance [m] without regard to shared edges. Neighbor lists use it,
    because a point beyond an edge can be above the face in the next step."""

    def __post_init__(self) -> None:
        for each in fields(self):
            value = np.array(getattr(self, each.name), dtype=np.float64)
            if not np.all(np.isfinite(value)):
                raise ValueError(f"{self.kind} got a number that is not finite.")
            value.setflags(write=False)
            object.__setattr__(self, each.name, float(value) if each.type is float else value)

    @classmethod
    def widths(cls) -> dict[str, int]:
        """Count of numbers of each field, in the order in which the device has them."""
        return {each.name: 1 if each.type is float else 3 for each in fields(cls)}

    @classmethod
    def count(cls) -> int:
        """Count of all numbers."""
        return sum(cls.widths().values())

    @property
    def numbers(self) -> np.ndarray:
        """All numbers (`count`,)."""
        return np.concatenate([np.atleast_1d(getattr(self, name)) for name in self.widths()])

    def distances(self, points: np.ndarray, reach: float) -> np.ndarray:
        """See `Surface`; unlike `distance`, FAR_AWAY at an edge that another surface owns."""
        return self.contacts(points)[0]


class DeviceNumbers(DeviceObject):
    """The numbers of an analytic surface in a device function, by name: scalars and vectors."""


def reader_of_numbers(kind: type[AnalyticSurface]) -> Callable[[Sequence[Any]], DeviceNumbers]:
    """Function in device functions: the numbers of a surface by name, from the values of all its numbers.

    Not a function of the kind and the values: Quadrants would take the kind, a dataclass, apart.
    """

    @at_compile_time
    def numbers_by_name(values: Sequence[Any]) -> DeviceNumbers:
        found = DeviceNumbers()
        begin = 0
        for name, width in kind.widths().items():
            own = list(values[begin : begin + width])
            setattr(found, name, own[0] if width == 1 else ti.Vector(own))
            begin += width
        return found

    return numbers_by_name


def surface_kinds(surfaces: Sequence[Surface]) -> tuple[type[AnalyticSurface], ...]:
    """The kinds of analytic surfaces by name; the index of a kind is the code by which kernels select it."""
    found = {type(each) for each in surfaces if isinstance(each, AnalyticSurface)}
    return tuple(sorted(found, key=lambda kind: kind.kind))
