"""Surfaces of revolution: cylinder, cone frustum, and disc with or without a round hole.

A straight segment in the (r, z) half plane is revolved about an axis. The surface is thin and two-sided. Each
end of the segment is a circular edge; the last section assigns shared edges to owners.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import dist
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from granflow.device_functions import ti
from granflow.geometry.surface import FAR_AWAY, AnalyticSurface, Surface, Vector
from granflow.geometry.vectors import distance_from_axis, is_parallel, unit
from granflow.scene.blocks.primitives import Axial
from granflow.scene.blocks.walls.wall import Wall
from granflow.schema import quantities as q
from granflow.schema.faults import Fault

FACET_COUNT = 64
"""Number of facets around the axis, for visualization."""


class AxialWall(Axial, Wall):
    """A surface of revolution about the line from `from` to `to` [m]."""

    def dimensions(self) -> Iterator[tuple[str, float]]:
        """Length of the axis."""
        yield "to", dist(self.from_, self.to)


class Cylinder(AxialWall):
    """A thin two-sided cylinder without end faces, with the length of the axis.

    >>> gf.Cylinder(material="steel", from_=[0, 0, 0], to=[0, 0, "20 cm"], radius="5 cm").radius
    0.05
    """

    shape: Literal["cylinder"] = Field("cylinder", description="shape of the wall")
    radius: q.PositiveLength = Field(description="radius [m]")

    def surface(self, folder: Path) -> Surface:
        """See `Wall`."""
        return cylinder(self.from_, self.to, self.radius)

    def dimensions(self) -> Iterator[tuple[str, float]]:
        """Radius, and length of the axis."""
        yield "radius", self.radius
        yield from super().dimensions()


class Cone(AxialWall):
    """A thin two-sided cone frustum without end faces; one radius may be 0.

    >>> axis = {"from_": [0, 0, 0], "to": [0, 0, 0.1]}
    >>> gf.Cone(material="steel", **axis, radius_from="1 cm", radius_to="5 cm").radius_to
    0.05
    """

    shape: Literal["cone"] = Field("cone", description="shape of the wall")
    radius_from: q.NotNegativeLength = Field(description="radius at `from` [m]")
    radius_to: q.NotNegativeLength = Field(description="radius at `to` [m]")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless at least one radius is above 0."""
        yield from super().faults()
        if self.radius_from == self.radius_to == 0:
            yield Fault(("radius_to",), "radius_from is 0 too: one of them must be above 0")

    def surface(self, folder: Path) -> Surface:
        """See `Wall`."""
        return cone(self.from_, self.to, self.radius_from, self.radius_to)

    def dimensions(self) -> Iterator[tuple[str, float]]:
        """Radii, and length of the axis."""
        yield "radius_from", self.radius_from
        yield "radius_to", self.radius_to
        yield from super().dimensions()


class Disc(Wall):
    """A thin, two-sided disc, optionally with a circular hole at its center.

    >>> place = {"center": [0, 0, 0], "normal": [0, 0, 1]}
    >>> gf.Disc(material="steel", **place, radius="5 cm", hole_radius="1 cm").hole_radius
    0.01
    """

    shape: Literal["disc"] = Field("disc", description="shape of the wall")
    center: q.Point = Field(description="center [m]")
    normal: q.Direction = Field(description="normal; its length and sign do not matter")
    radius: q.PositiveLength = Field(description="outer radius [m]")
    hole_radius: q.NotNegativeLength = Field(0.0, description="radius of the hole [m]; 0: no hole")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the hole is smaller than the disc."""
        yield from super().faults()
        if self.hole_radius >= self.radius:
            yield Fault(
                ("hole_radius",), f"the hole must be smaller than the disc of radius {self.radius:g} m"
            )

    def surface(self, folder: Path) -> Surface:
        """See `Wall`."""
        return disc(self.center, self.normal, self.radius, self.hole_radius)

    def dimensions(self) -> Iterator[tuple[str, float]]:
        """Radius."""
        yield "radius", self.radius


def cone(a: object, b: object, radius_a: float, radius_b: float) -> "Revolved":
    """Cone frustum with `radius_a` [m] at point `a` and `radius_b` [m] at point `b`; one radius may be 0.

    a, b:    (3,) [m], different points on the axis
    Raises:  ValueError as in `revolved`
    """
    axis = np.asarray(b, dtype=float) - np.asarray(a, dtype=float)
    return revolved(a, axis, radius_a, radius_b, float(np.linalg.norm(axis)))


def cylinder(a: object, b: object, radius: float) -> "Revolved":
    """Cylinder from point `a` (3,) [m] to point `b` (3,) [m] with a radius [m], open at both ends.

    Raises ValueError as in `revolved`.
    """
    return cone(a, b, radius, radius)


def disc(center: object, normal: object, radius: float, hole_radius: float = 0.0) -> "Revolved":
    """Flat disc, with a round hole if `hole_radius` [m] is above zero.

    center:  (3,) [m]
    normal:  (3,), any length above 0; the disc is two-sided
    Raises:  ValueError if the hole is not smaller than the disc, or as in `revolved`
    """
    if not radius > hole_radius:
        raise ValueError("The hole of a disc must be smaller than the disc.")
    return revolved(center, normal, hole_radius, radius, 0.0)


def revolved(origin: object, axis: object, start_r: float, end_r: float, end_z: float) -> "Revolved":
    """Segment from (start_r, 0) to (end_r, end_z) [m] revolved about the axis; neither edge is shared.

    origin:  (3,) [m], point on the axis at z = 0
    axis:    (3,), any length above 0
    Raises:  ValueError for a negative radius, a segment without length, both radii 0, or an axis without
             direction
    """
    if start_r < 0 or end_r < 0:
        raise ValueError("A radius must not be negative.")
    length = float(np.hypot(end_r - start_r, end_z))
    if not length > 0 or max(start_r, end_r) == 0:
        raise ValueError("A surface of revolution requires a length and a radius above zero.")
    return Revolved(
        origin=np.asarray(origin),
        axis=unit(axis),
        start_r=start_r,
        length=length,
        direction_r=(end_r - start_r) / length,
        direction_z=end_z / length,
    )


@dataclass(frozen=True, eq=False)
class Revolved(AnalyticSurface):
    """Origin and axis; radius at the start, length and direction (r, z) of the segment; and for each end the
    direction (r, z) of the competing face and 1 if this surface owns the edge.
    """

    kind: ClassVar[str] = "revolved"
    is_curved: ClassVar[bool] = True

    origin: Vector
    axis: Vector
    start_r: float
    length: float
    direction_r: float
    direction_z: float
    start_neighbor_r: float = 0.0
    start_neighbor_z: float = 0.0
    start_owned: float = 1.0
    end_neighbor_r: float = 0.0
    end_neighbor_z: float = 0.0
    end_owned: float = 1.0

    @staticmethod
    @ti.func
    def contact(point, numbers):
        """Distance [m] from the surface and unit vector from its nearest point to the point.

        The distance is FAR_AWAY if the nearest point is on an edge that another wall owns. On the surface the
        unit vector is the face normal.
        """
        r, z, radial = Revolved.half_plane_coordinates(point, numbers)
        along, beyond, height = Revolved.segment_coordinates(r, z, numbers)
        gap = ti.sqrt(beyond * beyond + height * height)
        on_surface = gap == 0.0
        divisor = ti.select(on_surface, 1.0, gap)
        tangential = beyond / divisor
        perpendicular = ti.select(on_surface, 1.0, height / divisor)
        normal_r = tangential * numbers.direction_r + perpendicular * numbers.direction_z
        normal_z = tangential * numbers.direction_z - perpendicular * numbers.direction_r
        normal = normal_r * radial + normal_z * numbers.axis
        distance = ti.select(Revolved.owns_contact(along, height, numbers), gap, FAR_AWAY)
        return distance, normal

    @staticmethod
    @ti.func
    def owns_contact(along, height, numbers):
        """Whether this surface owns the contact.

        True on its face. On an edge true only if the surface owns the edge and the point lies beyond the end
        of the competing face as well; otherwise that face is nearer.

        along, height:  of `segment_coordinates` [m]
        """
        before_start = along <= 0.0
        after_end = along >= numbers.length
        from_start = along
        from_end = along - numbers.length
        r_start = from_start * numbers.direction_r + height * numbers.direction_z
        z_start = from_start * numbers.direction_z - height * numbers.direction_r
        r_end = from_end * numbers.direction_r + height * numbers.direction_z
        z_end = from_end * numbers.direction_z - height * numbers.direction_r
        owns_start = (numbers.start_owned > 0.0) & (
            r_start * numbers.start_neighbor_r + z_start * numbers.start_neighbor_z <= 0.0
        )
        owns_end = (numbers.end_owned > 0.0) & (
            r_end * numbers.end_neighbor_r + z_end * numbers.end_neighbor_z <= 0.0
        )
        return ((not before_start) | owns_start) & ((not after_end) | owns_end)

    @staticmethod
    @ti.func
    def distance(point, numbers):
        """Distance [m] from the surface, at least 0.

        Shared edges have no effect on it.
        """
        r, z, _ = Revolved.half_plane_coordinates(point, numbers)
        _, beyond, height = Revolved.segment_coordinates(r, z, numbers)
        return ti.sqrt(beyond * beyond + height * height)

    @staticmethod
    @ti.func
    def face_normal(point, numbers):
        """Normal of the face in the half plane of the point."""
        _, _, radial = Revolved.half_plane_coordinates(point, numbers)
        return numbers.direction_z * radial - numbers.direction_r * numbers.axis

    @staticmethod
    @ti.func
    def half_plane_coordinates(point, numbers):
        """Coordinates (r, z) of the point in its half plane, and the radial unit vector.

            radial = axis x (offset x axis)

        r is the distance from the axis [m], z the height above the start of the segment [m]. On the axis the
        radial direction is a fixed vector. The double cross product keeps the radial vector perpendicular to
        the axis even if it consists of rounding errors only.
        """
        offset = point - numbers.origin
        axis = numbers.axis
        z = offset.dot(axis)
        radial = axis.cross(offset.cross(axis))
        r = radial.norm()
        on_axis = r == 0.0
        near_z = ti.abs(axis[2]) > 0.5
        zero = axis[0] * 0.0
        any_radial = ti.select(
            near_z, ti.Vector([axis[2], zero, -axis[0]]), ti.Vector([-axis[1], axis[0], zero])
        )
        direction = ti.select(on_axis, any_radial, radial)
        divisor = ti.select(on_axis, any_radial.norm(), r)
        return r, z, direction / divisor

    @staticmethod
    @ti.func
    def segment_coordinates(r, z, numbers):
        """Position along the segment, distance beyond the nearer end (0 above the face), and height [m].

            t = (r - r0) ur + z uz,    h = (r - r0) uz - z ur

        (ur, uz): direction of the segment; r0: radius at its start
        """
        outward = r - numbers.start_r
        along = outward * numbers.direction_r + z * numbers.direction_z
        height = outward * numbers.direction_z - z * numbers.direction_r
        beyond = along - ti.min(ti.max(along, 0.0), numbers.length)
        return along, beyond, height

    def contacts(
        self, points: np.ndarray, triangles: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The nearest point on the section through the point."""
        axis = self.axis
        start, end = self.profile
        from_origin = points - self.origin
        radial = radial_directions(from_origin, axis)
        edge_start = start[0] * radial + start[1] * axis
        chord = (end[0] - start[0]) * radial + (end[1] - start[1]) * axis
        fraction = np.sum((from_origin - edge_start) * chord, axis=1) / np.sum(chord * chord, axis=1)
        foot = edge_start + np.clip(fraction, 0.0, 1.0)[:, None] * chord
        from_surface = from_origin - foot
        distance = np.linalg.norm(from_surface, axis=1)
        on_surface = distance == 0.0
        face_normal = np.cross(chord, np.cross(axis, radial)) / np.linalg.norm(chord, axis=1)[:, None]
        normal = from_surface / np.where(on_surface, 1.0, distance)[:, None]
        normal[on_surface] = face_normal[on_surface]
        start_neighbor = self.start_neighbor_r * radial + self.start_neighbor_z * axis
        end_neighbor = self.end_neighbor_r * radial + self.end_neighbor_z * axis
        owns_start = (self.start_owned > 0) & (np.sum(from_surface * start_neighbor, axis=1) <= 0)
        owns_end = (self.end_owned > 0) & (np.sum(from_surface * end_neighbor, axis=1) <= 0)
        is_owned = ((fraction > 0) | owns_start) & ((fraction < 1) | owns_end)
        return np.where(is_owned, distance, FAR_AWAY), normal

    @property
    def profile(self) -> tuple[np.ndarray, np.ndarray]:
        """Ends of the segment as (r, z), each (2,) [m]; the start has z = 0."""
        start = np.array([self.start_r, 0.0])
        return start, start + self.length * np.array([self.direction_r, self.direction_z])

    @property
    def area(self) -> float:
        """Area [m2]: length of the segment times the path of its midpoint about the axis (Pappus).

        A = pi (r_start + r_end) length
        """
        start, end = self.profile
        return float(np.pi * (start[0] + end[0]) * self.length)

    def sides(self, points: np.ndarray) -> np.ndarray:
        """See `Surface`; 0 for a disc."""
        (start_r, _), (end_r, end_z) = self.profile
        along = (points - self.origin) @ self.axis
        radius = distance_from_axis(points, self.origin, self.axis)
        share = along / end_z if end_z > 0.0 else np.full(len(points), np.nan)
        side = np.where(radius < start_r + share * (end_r - start_r), 1, -1)
        return np.where((share >= 0.0) & (share <= 1.0), side, 0)

    def farthest_from(self, point: Vector, axis: Vector) -> float:
        """Distance [m] of the farthest point of both edges from the axis.

        It is an upper bound if the two axes are not parallel.
        """
        centers = np.array([self.origin + end[1] * self.axis for end in self.profile])
        radii = np.array([end[0] for end in self.profile])
        return float((distance_from_axis(centers, point, axis) + radii).max())

    def turns_in_place(self, point: Vector, axis: Vector) -> bool:
        """Whether the axis is its own."""
        centers = np.array([self.origin + end[1] * self.axis for end in self.profile])
        size = max(end[0] for end in self.profile) + self.length
        offset = distance_from_axis(centers, point, axis).max()
        return is_parallel(self.axis, axis) and bool(offset <= 1e-9 * size)

    def triangles(self, center: Vector, extent: float) -> tuple[np.ndarray, np.ndarray]:
        """Points (2 FACET_COUNT, 3) [m] and triangles (2 FACET_COUNT, 3) of facets around the axis.

        If an edge has the radius 0, half as many: those with an edge on it would have no area.
        """
        axis = self.axis
        angle = 2 * np.pi * np.arange(FACET_COUNT) / FACET_COUNT
        radial = radial_directions(np.zeros((1, 3)), axis)[0]
        around = np.outer(np.cos(angle), radial) + np.outer(np.sin(angle), np.cross(axis, radial))
        rings = [self.origin + r * around + z * axis for r, z in self.profile]
        index = np.arange(FACET_COUNT)
        next_index = (index + 1) % FACET_COUNT
        at_start = np.stack([index, next_index, next_index + FACET_COUNT], axis=1)
        at_end = np.stack([index, next_index + FACET_COUNT, index + FACET_COUNT], axis=1)
        parts = [part for part, (r, _) in zip((at_start, at_end), self.profile, strict=True) if r > 0.0]
        return np.concatenate(rings), np.concatenate(parts)

    def enclosing_points(self) -> np.ndarray:
        """See `Surface`; the facets lie inside of the surface."""
        points = self.triangles(np.zeros(3), 1.0)[0]
        middle = points.mean(axis=0)
        return middle + (points - middle) / np.cos(np.pi / FACET_COUNT)

    def is_upright(self, point: Vector, normal: Vector, tolerance: float) -> bool:
        """Whether it is a cylinder along the normal."""
        return self.direction_r == 0.0 and is_parallel(self.axis, normal)

    def with_edge_owners(self, surfaces: Sequence[Surface], index: int) -> "Revolved":
        """See `Surface`: both edges, with coaxial surfaces of revolution."""
        partners = {
            k: each
            for k, each in enumerate(surfaces)
            if isinstance(each, Revolved) and is_coaxial(self, each)
        }
        at_start = edge_numbers(rays_at_edge(self, "start", partners), index, "start")
        at_end = edge_numbers(rays_at_edge(self, "end", partners), index, "end")
        numbers: dict[str, Any] = at_start | at_end
        return replace(self, **numbers)


def radial_directions(offsets: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Unit vectors (n, 3) from the axis to points at `offsets` (n, 3) [m] from a point on the axis.

    A fixed vector for points on the axis. The projection is repeated, because near the axis the first result
    is mostly rounding error.
    """
    radial = offsets - np.outer(offsets @ axis, axis)
    on_axis = np.linalg.norm(radial, axis=1) <= 1e-12 * np.linalg.norm(offsets, axis=1)
    radial[on_axis] = np.cross(np.eye(3)[1 if abs(axis[2]) > 0.5 else 2], axis)
    radial /= np.linalg.norm(radial, axis=1)[:, None]
    radial -= np.outer(radial @ axis, axis)
    return radial / np.linalg.norm(radial, axis=1)[:, None]


# Circular edges shared by several surfaces of revolution: a single contact instead of one per surface.
#
# Where a cone joins its outlet tube, both segments end in the same circle. For a particle outside that
# circle the nearest point lies on both surfaces, so one of them must own the edge. In the half plane
# through the point, let `w` be the vector from the edge to the point and `u`, `v` the directions of the
# segments from the edge:
#
#     w.u <= 0 and w.v <= 0    edge contact, counted for the owner only
#     w.u <= 0 and w.v >  0    face of v, which is nearer than the edge: no contact with u
#     w.u >  0 and w.v >  0    a concave corner: contacts with both faces, none with the edge
#
# If more segments share an edge, the points in contact with the edge form one wedge (an intersection of
# half planes), bounded by the two directions on either side of the widest free angle. One of these two owns
# the edge, with the other as competing face; the remaining segments have no contact there. If no free angle
# exceeds 180 degrees, the edge has no contacts. A segment whose face passes through the edge (a tube on a
# plate) counts as two directions, so that the end of the tube has no contacts.
#
# A contact that slides from a face onto an edge owned by another surface continues as a contact of that
# surface.

TOLERANCE = 1e-9
"""Largest distance of coincident points over the size of the segments, and sine of the angle of parallel
axes."""
EDGE_NUMBERS = ("neighbor_r", "neighbor_z", "owned")
"""Numbers of one end of a surface of revolution, without the prefix "start_" or "end_"."""
Profile = tuple[np.ndarray, np.ndarray]
"""Ends (2,) of a segment as (r, z) [m]."""


def is_coaxial(surface: Revolved, other: Revolved) -> bool:
    """Whether the other surface is about the same line, in either direction."""
    off_axis = np.linalg.norm(np.cross(other.origin - surface.origin, surface.axis))
    size = profile_size(surface) + profile_size(other)
    return is_parallel(surface.axis, other.axis, TOLERANCE) and bool(off_axis <= TOLERANCE * size)


def profile_size(surface: Revolved) -> float:
    """Length scale [m] of a segment, for relative tolerances."""
    return float(np.abs(np.array(surface.profile)).max())


@dataclass(frozen=True)
class Ray:
    """Direction of a segment from an edge, in the (r, z) frame of the surface that has the edge.

    index:      index of the surface of the segment
    end:        "start" or "end" if the segment ends at the edge, None if it passes through
    direction:  (2,) unit vector (r, z)
    """

    index: int
    end: str | None
    direction: np.ndarray

    @property
    def angle(self) -> float:
        """Angle [rad] in [0, 2 pi) from the outward radial direction toward the axis direction."""
        return float(np.arctan2(self.direction[1], self.direction[0]) % (2 * np.pi))


def rays_at_edge(surface: Revolved, end: str, partners: Mapping[int, Revolved]) -> list[Ray]:
    """Directions of all partners (including the surface itself) from the edge at an end, "start" or "end".

    `partners`: the coaxial surfaces that move alike, by index.
    """
    edge = surface.profile[0 if end == "start" else 1]
    rays: list[Ray] = []
    for k, partner in partners.items():
        tolerance = TOLERANCE * (profile_size(surface) + profile_size(partner))
        rays += rays_of_segment(k, profile_in_frame_of(surface, partner), edge, tolerance)
    return rays


def profile_in_frame_of(surface: Revolved, other: Revolved) -> Profile:
    """Ends of the segment of `other` as (r, z) [m] in the frame of `surface`."""
    shift = np.array([0.0, (other.origin - surface.origin) @ surface.axis])
    flip = np.array([1.0, np.sign(other.axis @ surface.axis)])
    start, end = other.profile
    return start * flip + shift, end * flip + shift


def rays_of_segment(index: int, ends: Profile, edge: np.ndarray, tolerance: float) -> list[Ray]:
    """Directions of one segment from the edge: one at an end, two if it passes through, none otherwise.

    ends:       ends of the segment as (r, z) [m]
    edge:       (2,), the edge as (r, z) [m]
    tolerance:  largest distance [m] of coincident points
    """
    start, end = ends
    length = np.linalg.norm(end - start)
    along = (end - start) / length
    if np.linalg.norm(start - edge) <= tolerance:
        return [Ray(index, "start", along)]
    if np.linalg.norm(end - edge) <= tolerance:
        return [Ray(index, "end", -along)]
    position = (edge - start) @ along
    off_line = np.linalg.norm(edge - start - position * along)
    passes = off_line <= tolerance and 0 < position < length
    return [Ray(index, None, along), Ray(index, None, -along)] if passes else []


def edge_numbers(rays: Sequence[Ray], index: int, end: str) -> dict[str, float]:
    """The three numbers of the edge at one end of the surface with an index, from all rays at that edge.

    The owner is the surface with the lowest index among the bounds of the wedge, if both bounds are ends of
    segments.
    """
    bounds = wedge_bounds(rays)
    rays_of_end = [ray for ray in bounds if ray.index == index and ray.end == end]
    neighbors = [ray for ray in bounds if ray not in rays_of_end]
    neighbor = neighbors[0].direction if neighbors else np.zeros(2)
    ends = [(ray.index, ray.end) for ray in bounds if ray.end is not None]
    owned = 0 < len(ends) == len(bounds) and min(ends) == (index, end)
    values = neighbor[0], neighbor[1], float(owned)
    return {f"{end}_{name}": value for name, value in zip(EDGE_NUMBERS, values, strict=True)}


def wedge_bounds(rays: Sequence[Ray]) -> list[Ray]:
    """The two rays beside the widest free angle, if it is at least 180 degrees; a single ray itself.

    Empty if no free angle is that wide.
    """
    if len(rays) == 1:
        return list(rays)
    ordered = sorted(rays, key=lambda ray: ray.angle)
    successors = ordered[1:] + ordered[:1]
    gaps = [
        (after.angle - before.angle) % (2 * np.pi) for before, after in zip(ordered, successors, strict=True)
    ]
    widest = int(np.argmax(gaps))
    return [ordered[widest], successors[widest]] if gaps[widest] >= np.pi * (1 - TOLERANCE) else []
