"""Surfaces of revolution: a straight segment in the (r, z) half plane revolved about an axis.

Cylinder, cone frustum and disc (with or without a round hole) are surfaces of this kind. The surface is thin
and two-sided. Each end of the segment is a circular edge; `join_shared_edges` assigns shared edges to owners.

The parameters are PARAMETER_NAMES: origin, axis, radius at the start, length and direction (r, z) of the
segment, and for each end the direction (r, z) of the competing face and 1 if this surface owns the edge.
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np

from granflow.device_functions import ti
from granflow.geometry.shape import (
    FAR_AWAY,
    Shape,
    ShapeKind,
    distance_from_axis,
    is_parallel,
    make_shape,
    unit,
)

PARAMETER_NAMES = (
    "origin_x",
    "origin_y",
    "origin_z",
    "axis_x",
    "axis_y",
    "axis_z",
    "start_r",
    "length",
    "direction_r",
    "direction_z",
    "start_neighbor_r",
    "start_neighbor_z",
    "start_owned",
    "end_neighbor_r",
    "end_neighbor_z",
    "end_owned",
)
"""Parameters of a surface of revolution, in this order: lengths [m], unit vectors, and 1 or 0."""
(
    ORIGIN_X,
    ORIGIN_Y,
    ORIGIN_Z,
    AXIS_X,
    AXIS_Y,
    AXIS_Z,
    START_R,
    LENGTH,
    DIRECTION_R,
    DIRECTION_Z,
    START_NEIGHBOR_R,
    START_NEIGHBOR_Z,
    START_OWNED,
    END_NEIGHBOR_R,
    END_NEIGHBOR_Z,
    END_OWNED,
) = range(len(PARAMETER_NAMES))
"""Indices of the parameters."""
ORIGIN = slice(ORIGIN_X, ORIGIN_Z + 1)
AXIS = slice(AXIS_X, AXIS_Z + 1)
DIRECTION = slice(DIRECTION_R, DIRECTION_Z + 1)
START_EDGE = slice(START_NEIGHBOR_R, START_OWNED + 1)
END_EDGE = slice(END_NEIGHBOR_R, END_OWNED + 1)
"""Parts of the parameters on the host."""
FACET_COUNT = 64
"""Number of facets around the axis, for visualization."""


def revolved(origin: object, axis: object, start_r: float, end_r: float, end_z: float) -> Shape:
    """Segment from (start_r, 0) to (end_r, end_z) [m] revolved about the axis; neither edge is shared.

    origin:  (3,) [m], point on the axis at z = 0
    axis:    (3,), any length above 0
    Raises:  ValueError for a negative radius, a segment without length, both radii 0, or an axis without
             direction
    """
    if start_r < 0 or end_r < 0:
        raise ValueError("A radius must not be negative.")
    length = np.hypot(end_r - start_r, end_z)
    if not length > 0 or max(start_r, end_r) == 0:
        raise ValueError("A surface of revolution requires a length and a radius above zero.")
    free_edge = (0.0, 0.0, 1.0)
    direction = (end_r - start_r) / length, end_z / length
    return make_shape(REVOLVED, origin, unit(axis), start_r, length, *direction, *free_edge, *free_edge)


def cone(a: object, b: object, radius_a: float, radius_b: float) -> Shape:
    """Cone frustum with `radius_a` [m] at point `a` and `radius_b` [m] at point `b`; one radius may be 0.

    a, b:    (3,) [m], different points on the axis
    Raises:  ValueError as in `revolved`
    """
    axis = np.asarray(b, dtype=float) - np.asarray(a, dtype=float)
    return revolved(a, axis, radius_a, radius_b, float(np.linalg.norm(axis)))


def cylinder(a: object, b: object, radius: float) -> Shape:
    """Cylinder from point `a` (3,) [m] to point `b` (3,) [m] with a radius [m], open at both ends.

    Raises ValueError as in `revolved`.
    """
    return cone(a, b, radius, radius)


def disc(center: object, normal: object, radius: float, hole_radius: float = 0.0) -> Shape:
    """Flat disc, with a round hole if `hole_radius` [m] is above zero.

    center:  (3,) [m]
    normal:  (3,), any length above 0; the disc is two-sided
    Raises:  ValueError if the hole is not smaller than the disc, or as in `revolved`
    """
    if not radius > hole_radius:
        raise ValueError("The hole of a disc must be smaller than the disc.")
    return revolved(center, normal, hole_radius, radius, 0.0)


# Device functions


@ti.func
def closest_on_revolved(point, parameters):
    """Distance [m] from the surface and unit vector from its nearest point to the point (ShapeKind.closest).

    The distance is FAR_AWAY if the nearest point is on an edge that another wall owns. On the surface the
    unit vector is the face normal.
    """
    r, z, radial = half_plane_coordinates(point, parameters)
    along, beyond, height = segment_coordinates(r, z, parameters)
    gap = ti.sqrt(beyond * beyond + height * height)
    on_surface = gap == 0.0
    divisor = ti.select(on_surface, 1.0, gap)
    tangential = beyond / divisor
    perpendicular = ti.select(on_surface, 1.0, height / divisor)
    normal_r = tangential * parameters[DIRECTION_R] + perpendicular * parameters[DIRECTION_Z]
    normal_z = tangential * parameters[DIRECTION_Z] - perpendicular * parameters[DIRECTION_R]
    normal = normal_r * radial + normal_z * ti.Vector(
        [parameters[AXIS_X], parameters[AXIS_Y], parameters[AXIS_Z]]
    )
    distance = ti.select(owns_contact(along, height, parameters), gap, FAR_AWAY)
    return distance, normal


@ti.func
def owns_contact(along, height, parameters):
    """Whether this surface owns the contact.

    True on its face. On an edge true only if the surface owns the edge and the point lies beyond the end of
    the competing face as well; otherwise that face is nearer.

    along, height:  of `segment_coordinates` [m]
    """
    before_start = along <= 0.0
    after_end = along >= parameters[LENGTH]
    from_start = along
    from_end = along - parameters[LENGTH]
    r_start = from_start * parameters[DIRECTION_R] + height * parameters[DIRECTION_Z]
    z_start = from_start * parameters[DIRECTION_Z] - height * parameters[DIRECTION_R]
    r_end = from_end * parameters[DIRECTION_R] + height * parameters[DIRECTION_Z]
    z_end = from_end * parameters[DIRECTION_Z] - height * parameters[DIRECTION_R]
    owns_start = (parameters[START_OWNED] > 0.0) & (
        r_start * parameters[START_NEIGHBOR_R] + z_start * parameters[START_NEIGHBOR_Z] <= 0.0
    )
    owns_end = (parameters[END_OWNED] > 0.0) & (
        r_end * parameters[END_NEIGHBOR_R] + z_end * parameters[END_NEIGHBOR_Z] <= 0.0
    )
    return ((not before_start) | owns_start) & ((not after_end) | owns_end)


@ti.func
def revolved_distance(point, parameters):
    """Distance [m] from the surface, at least 0 (ShapeKind.surface_distance).

    Shared edges have no effect on it.
    """
    r, z, _ = half_plane_coordinates(point, parameters)
    _, beyond, height = segment_coordinates(r, z, parameters)
    return ti.sqrt(beyond * beyond + height * height)


@ti.func
def revolved_normal(point, parameters):
    """Normal of the face in the half plane of the point (ShapeKind.face_normal)."""
    _, _, radial = half_plane_coordinates(point, parameters)
    return parameters[DIRECTION_Z] * radial - parameters[DIRECTION_R] * ti.Vector(
        [parameters[AXIS_X], parameters[AXIS_Y], parameters[AXIS_Z]]
    )


@ti.func
def half_plane_coordinates(point, parameters):
    """Coordinates (r, z) of the point in its half plane, and the radial unit vector.

        radial = axis x (offset x axis)

    r is the distance from the axis [m], z the height above the start of the segment [m]. On the axis the
    radial direction is a fixed vector. The double cross product keeps the radial vector perpendicular to the
    axis even if it consists of rounding errors only.
    """
    offset = ti.Vector(
        [point[0] - parameters[ORIGIN_X], point[1] - parameters[ORIGIN_Y], point[2] - parameters[ORIGIN_Z]]
    )
    axis = ti.Vector([parameters[AXIS_X], parameters[AXIS_Y], parameters[AXIS_Z]])
    z = offset[0] * axis[0] + offset[1] * axis[1] + offset[2] * axis[2]
    radial = axis.cross(offset.cross(axis))
    r = radial.norm()
    on_axis = r == 0.0
    near_z = ti.abs(axis[2]) > 0.5
    zero = axis[0] * 0.0
    any_radial = ti.select(near_z, ti.Vector([axis[2], zero, -axis[0]]), ti.Vector([-axis[1], axis[0], zero]))
    direction = ti.select(on_axis, any_radial, radial)
    divisor = ti.select(on_axis, any_radial.norm(), r)
    return r, z, direction / divisor


@ti.func
def segment_coordinates(r, z, parameters):
    """Position along the segment, distance beyond the nearer end (0 above the face), and height above it [m].

    t = (r - r0) ur + z uz,    h = (r - r0) uz - z ur        (ur, uz) direction of the segment, r0 its start
    """
    outward = r - parameters[START_R]
    along = outward * parameters[DIRECTION_R] + z * parameters[DIRECTION_Z]
    height = outward * parameters[DIRECTION_Z] - z * parameters[DIRECTION_R]
    beyond = along - ti.min(ti.max(along, 0.0), parameters[LENGTH])
    return along, beyond, height


# The kind of these shapes: reference implementation, triangles, reach and area


def reference_closest_on_revolved(
    points: np.ndarray, parameters: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Reference implementation of `closest_on_revolved`: nearest point on the section through the point.

    points:   (n, 3) [m]
    Returns:  distance (n,) [m] or FAR_AWAY, unit vector (n, 3)
    """
    axis = parameters[AXIS]
    start, end = profile(parameters)
    from_origin = points - parameters[ORIGIN]
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
    not_owned = (fraction <= 0) & ~reference_owns_edge(from_surface, radial, axis, parameters[START_EDGE])
    not_owned |= (fraction >= 1) & ~reference_owns_edge(from_surface, radial, axis, parameters[END_EDGE])
    return np.where(not_owned, FAR_AWAY, distance), normal


def reference_owns_edge(
    from_surface: np.ndarray, radial: np.ndarray, axis: np.ndarray, edge: np.ndarray
) -> np.ndarray:
    """Whether a surface owns the contacts of points beyond one of its edges.

    from_surface:  (n, 3) [m], from the edge to the points
    radial:        (n, 3) radial unit vectors
    axis:          (3,) unit vector
    edge:          (3,), direction r, z of the competing face, owner flag
    Returns:       (n,) bool
    """
    neighbor = edge[0] * radial + edge[1] * axis
    return (edge[2] > 0) & (np.sum(from_surface * neighbor, axis=1) <= 0)


def revolved_triangles(
    parameters: np.ndarray, center: np.ndarray, extent: float
) -> tuple[np.ndarray, np.ndarray]:
    """Points (2 FACET_COUNT, 3) [m] and triangles (2 FACET_COUNT, 3) of facets around the axis.

    `center` and `extent` are unused. One of the edges may have the radius 0.
    """
    axis = parameters[AXIS]
    angle = 2 * np.pi * np.arange(FACET_COUNT) / FACET_COUNT
    radial = radial_directions(np.zeros((1, 3)), axis)[0]
    around = np.outer(np.cos(angle), radial) + np.outer(np.sin(angle), np.cross(axis, radial))
    rings = [parameters[ORIGIN] + r * around + z * axis for r, z in profile(parameters)]
    index = np.arange(FACET_COUNT)
    next_index = (index + 1) % FACET_COUNT
    lower = np.stack([index, next_index, next_index + FACET_COUNT], axis=1)
    upper = np.stack([index, next_index + FACET_COUNT, index + FACET_COUNT], axis=1)
    return np.concatenate(rings), np.concatenate([lower, upper])


def revolved_reach(parameters: np.ndarray, point: np.ndarray, axis: np.ndarray) -> float:
    """Distance [m] of the farthest point of both edges from the axis; 0 for rotation about its own axis.

    point:    (3,) [m], a point on the axis of the motion
    axis:     (3,) unit vector along the axis of the motion
    Returns:  an upper bound if the two axes are not parallel
    """
    origin = parameters[ORIGIN]
    axis_of_shape = parameters[AXIS]
    radius = max(end[0] for end in profile(parameters))
    centers = np.array([origin + end[1] * axis_of_shape for end in profile(parameters)])
    from_surface = distance_from_axis(centers, point, axis).max()
    size = radius + parameters[LENGTH]
    if is_parallel(axis_of_shape, axis) and from_surface <= 1e-9 * size:
        return 0.0
    return float(from_surface + radius)


def revolved_area(parameters: np.ndarray) -> float:
    """Area [m2]: length of the segment times the path of its midpoint about the axis (Pappus).

    A = pi (r_start + r_end) length
    """
    start, end = profile(parameters)
    return float(np.pi * (start[0] + end[0]) * parameters[LENGTH])


def profile(parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the segment as (r, z), each (2,) [m], in the frame of the shape; the start has z = 0."""
    start = np.array([parameters[START_R], 0.0])
    return start, start + parameters[LENGTH] * parameters[DIRECTION]


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


REVOLVED = ShapeKind(
    name="revolved",
    parameter_names=PARAMETER_NAMES,
    closest=closest_on_revolved,
    face_normal=revolved_normal,
    surface_distance=revolved_distance,
    reference_closest=reference_closest_on_revolved,
    triangles=revolved_triangles,
    reach_about=revolved_reach,
    area=revolved_area,
)
"""Kind of all surfaces of revolution."""

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
EDGE_PARAMETERS = ("neighbor_r", "neighbor_z", "owned")
"""Parameters of one end of a surface of revolution, without the prefix "start_" or "end_"."""
Profile = tuple[np.ndarray, np.ndarray]
"""Ends (2,) of a segment as (r, z) [m]."""


def join_shared_edges(shapes: Sequence[Shape], groups: Sequence[Hashable]) -> list[Shape]:
    """The same shapes with each shared edge of surfaces of revolution assigned to one owner.

    shapes:  active shapes; shapes of other kinds are returned unchanged
    groups:  wall motion of each shape: only shapes with the same motion share edges

    Call the function again with the active shapes when a wall is added or removed; repeated calls are
    idempotent.
    """
    joined = list(shapes)
    for index, shape in enumerate(shapes):
        if shape.kind is REVOLVED:
            partners = [k for k, group in enumerate(groups) if group == groups[index]]
            partners = [k for k in partners if is_coaxial(shape, shapes[k])]
            for end in ("start", "end"):
                rays = rays_at_edge(shapes, index, end, partners)
                joined[index] = joined[index].with_parameters(**edge_parameters(rays, index, end))
    return joined


def is_coaxial(shape: Shape, other: Shape) -> bool:
    """Whether the other shape is a surface of revolution about the same line, in either direction."""
    if other.kind is not REVOLVED:
        return False
    origin_offset = other.parameters[ORIGIN] - shape.parameters[ORIGIN]
    axis = shape.parameters[AXIS]
    off_axis = np.linalg.norm(np.cross(origin_offset, axis))
    size = profile_size(shape) + profile_size(other)
    return is_parallel(axis, other.parameters[AXIS], TOLERANCE) and bool(off_axis <= TOLERANCE * size)


def profile_size(shape: Shape) -> float:
    """Length scale [m] of a segment, for relative tolerances."""
    return float(np.abs(np.array(profile(shape.parameters))).max())


@dataclass(frozen=True)
class Ray:
    """Direction of a segment from an edge, in the (r, z) frame of the shape that has the edge.

    index:      index of the shape of the segment
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


def rays_at_edge(shapes: Sequence[Shape], index: int, end: str, partners: Sequence[int]) -> list[Ray]:
    """Directions of all partners (including the shape itself) from the given edge.

    index:     index of the shape that has the edge
    end:       "start" or "end"
    partners:  indices of the coaxial shapes with the same motion
    """
    shape = shapes[index]
    edge = profile(shape.parameters)[0 if end == "start" else 1]
    rays: list[Ray] = []
    for k in partners:
        tolerance = TOLERANCE * (profile_size(shape) + profile_size(shapes[k]))
        rays += rays_of_segment(k, profile_in_frame_of(shape, shapes[k]), edge, tolerance)
    return rays


def profile_in_frame_of(shape: Shape, other: Shape) -> Profile:
    """Ends of the segment of `other` as (r, z) [m] in the frame of `shape`."""
    axis = shape.parameters[AXIS]
    shift = np.array([0.0, (other.parameters[ORIGIN] - shape.parameters[ORIGIN]) @ axis])
    flip = np.array([1.0, np.sign(other.parameters[AXIS] @ axis)])
    start, end = profile(other.parameters)
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


def edge_parameters(rays: Sequence[Ray], index: int, end: str) -> dict[str, float]:
    """The three edge parameters of one end of a shape, from all rays at that edge.

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
    return {f"{end}_{name}": value for name, value in zip(EDGE_PARAMETERS, values, strict=True)}


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
