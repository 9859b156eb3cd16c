"""Rims that several surfaces of revolution share: one contact there, not one from each.

Where a cone meets its outlet tube both segments end in the same circle. A grain hanging over that circle
from outside has its nearest point on both, so one of them must own the rim. In the half plane through the
point, with `w` from the rim to the point and `u`, `v` the directions in which the segments run from the rim:

    w.u <= 0 and w.v <= 0    edge contact, counted by the owner alone
    w.u <= 0 and w.v >  0    face of v, which is nearer than the rim: u stays silent
    w.u >  0 and w.v >  0    a concave corner: both faces, no edge

With more segments at one rim the points that touch the rim itself form one wedge (an intersection of half
planes), bounded by the two directions on either side of the widest free angle: one of those two owns the rim
with the other as its neighbor, everybody else is silent there. If no free angle is above 180 degrees no point
touches the rim. A segment that passes through the rim with its face (a tube standing on a plate) counts as two
directions, so the tube's end is silent.

A contact that slides off a face onto a rim owned by the neighbor continues as a contact of that neighbor.
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np

from granflow.walls.revolved import REVOLVED, profile
from granflow.walls.shape import Shape, is_parallel

TOLERANCE = 1e-9

EDGE_PARAMETERS = ("neighbor_r", "neighbor_z", "owned")

Profile = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Ray:
    """One direction in which a segment runs from a rim, in the (r, z) frame of the segment asked about.

    `end` is "start" or "end" if the segment ends at the rim, None if it passes through.
    """

    index: int
    end: str | None
    direction: np.ndarray

    @property
    def angle(self) -> float:
        """Angle in [0, 2 pi) from outward towards the axis."""
        return float(np.arctan2(self.direction[1], self.direction[0]) % (2 * np.pi))


def join_shared_edges(shapes: Sequence[Shape], groups: Sequence[Hashable]) -> list[Shape]:
    """The same shapes with the rims that surfaces of revolution share assigned to one owner each.

    `groups` names for each shape the wall motion it follows: only shapes that move alike share rims. Call it
    again with the shapes that are present whenever a wall appears or vanishes; joining twice is harmless.
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
    """Whether the other shape is a surface of revolution about the same line, either way up."""
    if other.kind is not REVOLVED:
        return False
    between = other.parameters[0:3] - shape.parameters[0:3]
    axis = shape.parameters[3:6]
    off_axis = np.linalg.norm(np.cross(between, axis))
    size = profile_size(shape) + profile_size(other)
    return is_parallel(axis, other.parameters[3:6], TOLERANCE) and bool(off_axis <= TOLERANCE * size)


def profile_size(shape: Shape) -> float:
    """Length scale [m] of a segment for relative tolerances."""
    return float(np.abs(np.array(profile(shape.parameters))).max())


def rays_at_edge(shapes: Sequence[Shape], index: int, end: str, partners: Sequence[int]) -> list[Ray]:
    """Every direction in which a partner (the shape itself among them) runs from the given rim."""
    shape = shapes[index]
    edge = profile(shape.parameters)[0 if end == "start" else 1]
    rays: list[Ray] = []
    for k in partners:
        tolerance = TOLERANCE * (profile_size(shape) + profile_size(shapes[k]))
        rays += rays_of_segment(k, profile_in_frame_of(shape, shapes[k]), edge, tolerance)
    return rays


def profile_in_frame_of(shape: Shape, other: Shape) -> Profile:
    """The ends of the other segment as (r, z) in this shape's frame."""
    axis = shape.parameters[3:6]
    shift = np.array([0.0, (other.parameters[0:3] - shape.parameters[0:3]) @ axis])
    flip = np.array([1.0, np.sign(other.parameters[3:6] @ axis)])
    start, end = profile(other.parameters)
    return start * flip + shift, end * flip + shift


def rays_of_segment(index: int, ends: Profile, edge: np.ndarray, tolerance: float) -> list[Ray]:
    """How one segment runs from the rim: from one of its ends, through it, or not at all."""
    start, end = ends
    length = np.linalg.norm(end - start)
    along = (end - start) / length
    if np.linalg.norm(start - edge) <= tolerance:
        return [Ray(index, "start", along)]
    if np.linalg.norm(end - edge) <= tolerance:
        return [Ray(index, "end", -along)]
    position = (edge - start) @ along
    aside = np.linalg.norm(edge - start - position * along)
    passes = aside <= tolerance and 0 < position < length
    return [Ray(index, None, along), Ray(index, None, -along)] if passes else []


def edge_parameters(rays: Sequence[Ray], index: int, end: str) -> dict[str, float]:
    """The three rim parameters of one end of one shape, from all rays at that rim."""
    bounds = wedge_bounds(rays)
    own_rays = [ray for ray in bounds if ray.index == index and ray.end == end]
    neighbors = [ray for ray in bounds if ray not in own_rays]
    neighbor = neighbors[0].direction if neighbors else np.zeros(2)
    ends = [(ray.index, ray.end) for ray in bounds if ray.end is not None]
    owned = 0 < len(ends) == len(bounds) and min(ends) == (index, end)
    values = neighbor[0], neighbor[1], float(owned)
    return {f"{end}_{name}": value for name, value in zip(EDGE_PARAMETERS, values, strict=True)}


def wedge_bounds(rays: Sequence[Ray]) -> list[Ray]:
    """The two rays on either side of the widest free angle, if that is 180 degrees or more; a lone ray itself."""
    if len(rays) == 1:
        return list(rays)
    ordered = sorted(rays, key=lambda ray: ray.angle)
    following = ordered[1:] + ordered[:1]
    gaps = [(after.angle - before.angle) % (2 * np.pi) for before, after in zip(ordered, following, strict=True)]
    widest = int(np.argmax(gaps))
    return [ordered[widest], following[widest]] if gaps[widest] >= np.pi * (1 - TOLERANCE) else []
