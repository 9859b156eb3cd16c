"""Joined walls: their surfaces touch, so that one contact of a particle can be found on several of them.

They are found before the run, from motions, planes and bounding boxes. With the feature `joined_walls`, the
kernels look for contacts that are found twice, only at these walls, see `engine.walls.JoinedWalls`.

Edges that surfaces have in common are another matter: each has an owner before the run, without a search
during it (`geometry.surface.assign_shared_edges`).
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from granflow.geometry.surface import Surface, Vector, boxes_overlap
from granflow.plan.walls import PlannedWall
from granflow.scene.blocks.motions import TimedMotion

ITSELF, OTHERS = 1, 2
"""Bits of `joints_of`: parts of the wall touch each other; the wall touches other walls."""
PLACE_TOLERANCE = 1e-3
"""Distance of surfaces over the largest radius below which they may touch: ten times that of one contact on
both."""
ANGLE_TOLERANCE = 1e-2
"""Sine of the angle below which two half spaces may have the same surface."""


def joints_of(
    walls: Sequence[PlannedWall], radius_max: float, periodic_axes: Sequence[int]
) -> tuple[int, ...]:
    """For each wall a sum of ITSELF and OTHERS, or 0.

    `radius_max` [m]: largest radius of the particles. Bounding boxes decide for bounded walls, so that some
    of the walls found do not touch. Walls that move differently are assumed to touch at some time.
    """
    tolerance = PLACE_TOLERANCE * radius_max
    joints = [0] * len(walls)
    for index, wall in enumerate(walls):
        if wall.surface.has_touching_parts(tolerance):
            joints[index] = ITSELF
    for a, b in combinations(range(len(walls)), 2):
        if _may_touch(walls[a], walls[b], tolerance, periodic_axes):
            joints[a] |= OTHERS
            joints[b] |= OTHERS
    return tuple(joints)


def _may_touch(one: PlannedWall, other: PlannedWall, tolerance: float, periodic_axes: Sequence[int]) -> bool:
    """Whether a contact of a particle can be on the surfaces of both walls."""
    plane = one.surface.plane
    other_plane = other.surface.plane
    moves_alike = _motions_of_surface(one) == _motions_of_surface(other)
    if plane is not None and other_plane is not None:
        turns = any(each.rotates for wall in (one, other) for each in _motions_in(wall))
        return _can_coincide(plane, other_plane, tolerance, moves_alike, turns)
    if not moves_alike:
        return True
    if plane is not None:
        return _can_end_on(other.surface, *plane, tolerance)
    if other_plane is not None:
        return _can_end_on(one.surface, *other_plane, tolerance)
    points = one.surface.enclosing_points()
    return boxes_overlap(points, other.surface.enclosing_points(), tolerance, periodic_axes)


def _motions_of_surface(wall: PlannedWall) -> tuple[object, ...]:
    """What moves the surface of a wall: a belt does not, nor does the rotation of a drum about its own axis.

    A force-controlled motion is that of its wall only.
    """
    moving = tuple(each for each in wall.motions if not each.is_belt)
    if any(each.force_controlled for each in moving):
        return (wall.name,)
    turning = [each for each in moving if each.rotates]
    reaches = [wall.surface.reach_about(*each.point_and_axis) for each in turning]
    only_turns_in_place = len(turning) == len(moving) and all(reach == 0.0 for reach in reaches)
    if only_turns_in_place:
        return ()
    # Rows of tables are not compared.
    return (wall.name,) if any(each.is_table for each in moving) else moving


def _motions_in(wall: PlannedWall) -> tuple[TimedMotion, ...]:
    """The motions of a wall, none if they do not move its surface."""
    return wall.motions if _motions_of_surface(wall) else ()


def _can_coincide(
    plane: tuple[Vector, Vector],
    other_plane: tuple[Vector, Vector],
    tolerance: float,
    moves_alike: bool,
    turns: bool,
) -> bool:
    """Whether two half spaces have the same surface on the same side, or could have it after a motion.

    A half space is a point and a normal; `turns`: one of them rotates.
    """
    (point, normal), (other_point, other_normal) = plane, other_plane
    is_parallel = bool(np.linalg.norm(normal - other_normal) <= ANGLE_TOLERANCE)
    if moves_alike:
        distance = abs((other_point - point) @ normal)
        return is_parallel and bool(distance <= tolerance)
    return turns or is_parallel


def _can_end_on(bounded: Surface, point: Vector, normal: Vector, tolerance: float) -> bool:
    """Whether a particle above a half space can be in contact with a bounded surface at the plane.

    It cannot with an upright rectangle, cylinder or part of a mesh that rises from the plane: the contact is
    as high as its center.
    """
    height = (bounded.enclosing_points() - point) @ normal
    if height.min() > tolerance:
        return False
    return height.max() <= tolerance or not bounded.is_upright(point, normal, tolerance)
