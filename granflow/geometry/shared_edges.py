"""Circular edges shared by several surfaces of revolution: a single contact instead of one per surface.

Where a cone joins its outlet tube, both segments end in the same circle. For a particle outside that circle the nearest
point lies on both surfaces, so one of them must own the edge. In the half plane through the point, let `w` be the
vector from the edge to the point and `u`, `v` the directions of the segments from the edge:

    w.u <= 0 and w.v <= 0    edge contact, counted for the owner only
    w.u <= 0 and w.v >  0    face of v, which is nearer than the edge: no contact with u
    w.u >  0 and w.v >  0    a concave corner: contacts with both faces, none with the edge

If more segments share an edge, the points in contact with the edge form one wedge (an intersection of half planes),
bounded by the two directions on either side of the widest free angle. One of these two owns the edge, with the other as
competing face; the remaining segments have no contact there. If no free angle exceeds 180 degrees, the edge has no
contacts. A segment whose face passes through the edge (a tube on a plate) counts as two directions, so that the end of
the tube has no contacts.

A contact that slides from a face onto an edge owned by another surface continues as a contact of that surface.
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np

from granflow.geometry.revolved import REVOLVED, profile
from granflow.geometry.shape import Shape, is_parallel

TOLERANCE = 1e-9
"""Largest distance of coincident points over the size of the segments, and sine of the angle of parallel axes."""

EDGE_PARAMETERS = ("neighbor_r", "neighbor_z", "owned")
"""Parameters of one end of a surface of revolution, without the prefix "start_" or "end_"."""

Profile = tuple[np.ndarray, np.ndarray]
"""Ends (2,) of a segment as (r, z) [m]."""


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


def join_shared_edges(shapes: Sequence[Shape], groups: Sequence[Hashable]) -> list[Shape]:
    """The same shapes with each shared edge of surfaces of revolution assigned to one owner.

    shapes:  active shapes; shapes of other kinds are returned unchanged
    groups:  wall motion of each shape: only shapes with the same motion share edges

    Call the function again with the active shapes when a wall is added or removed; repeated calls are idempotent.
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
    origin_offset = other.parameters[0:3] - shape.parameters[0:3]
    axis = shape.parameters[3:6]
    off_axis = np.linalg.norm(np.cross(origin_offset, axis))
    size = profile_size(shape) + profile_size(other)
    return is_parallel(axis, other.parameters[3:6], TOLERANCE) and bool(off_axis <= TOLERANCE * size)


def profile_size(shape: Shape) -> float:
    """Length scale [m] of a segment, for relative tolerances."""
    return float(np.abs(np.array(profile(shape.parameters))).max())


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
    axis = shape.parameters[3:6]
    shift = np.array([0.0, (other.parameters[0:3] - shape.parameters[0:3]) @ axis])
    flip = np.array([1.0, np.sign(other.parameters[3:6] @ axis)])
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

    The owner is the surface with the lowest index among the bounds of the wedge, if both bounds are ends of segments.
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
    """The two rays on either side of the widest free angle if it is at least 180 degrees; a single ray itself.

    Empty if no free angle is that wide.
    """
    if len(rays) == 1:
        return list(rays)
    ordered = sorted(rays, key=lambda ray: ray.angle)
    successors = ordered[1:] + ordered[:1]
    gaps = [(after.angle - before.angle) % (2 * np.pi) for before, after in zip(ordered, successors, strict=True)]
    widest = int(np.argmax(gaps))
    return [ordered[widest], successors[widest]] if gaps[widest] >= np.pi * (1 - TOLERANCE) else []
