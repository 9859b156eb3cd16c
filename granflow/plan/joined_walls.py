"""Walls whose surfaces touch, so that one contact of a particle can be found on several of them.

They are found before the run, from motions, planes and bounding boxes. The kernels look for contacts that are
found twice only at these walls, see `engine.walls.build_wall_contact`.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from granflow.geometry.catalog import Surface, reach_about, triangles
from granflow.geometry.mesh import Mesh
from granflow.geometry.mesh_contact import classify_edges
from granflow.geometry.plane import DIRECTION1, DIRECTION2, HALF_SPACE, NORMAL, POINT, RECTANGLE
from granflow.geometry.revolved import AXIS, FACET_COUNT, REVOLVED
from granflow.geometry.shape import Shape, is_parallel
from granflow.plan.walls import PlannedWall
from granflow.scene.blocks.motions import TableMotion, TimedMotion

ITSELF, OTHERS = 1, 2
"""Bits of `joints_of`: parts of the wall touch each other; the wall touches other walls."""
PLACE_TOLERANCE = 1e-3
"""Distance of surfaces over the largest radius below which they may touch: ten times that of one contact on
both."""
ANGLE_TOLERANCE = 1e-2
"""Sine of the angle below which two half spaces may have the same surface."""
MAX_PARTS = 64
"""Number of parts of a mesh above which they are not compared, but assumed to touch."""
Bounds = tuple[np.ndarray, np.ndarray]
"""Low and high corner (3,) [m] of a bounding box."""


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
        if isinstance(wall.shape, Mesh) and _has_touching_parts(wall.shape, tolerance):
            joints[index] = ITSELF
    for a, b in combinations(range(len(walls)), 2):
        if _may_touch(walls[a], walls[b], tolerance, periodic_axes):
            joints[a] |= OTHERS
            joints[b] |= OTHERS
    return tuple(joints)


def _may_touch(one: PlannedWall, other: PlannedWall, tolerance: float, periodic_axes: Sequence[int]) -> bool:
    """Whether a contact of a particle can be on the surfaces of both walls."""
    planes = [each for each in (one, other) if _is_half_space(each.shape)]
    moves_alike = _motions_of_surface(one) == _motions_of_surface(other)
    if len(planes) == 2:
        return _can_coincide(one, other, tolerance, moves_alike)
    if not moves_alike:
        return True
    if planes:
        bounded = other if planes[0] is one else one
        return _can_end_on(bounded.shape, planes[0].shape, tolerance)
    box = _bounds(_points_of(one.shape))
    other_box = _bounds(_points_of(other.shape))
    return _overlap(box, other_box, tolerance, periodic_axes)


def _is_half_space(surface: Surface) -> bool:
    return isinstance(surface, Shape) and surface.kind is HALF_SPACE


def _motions_of_surface(wall: PlannedWall) -> tuple[object, ...]:
    """What moves the surface of a wall: a belt does not, nor does the rotation of a drum about its own axis.

    A force-controlled motion is that of its wall only.
    """
    moving = tuple(each for each in wall.motions if not each.is_belt)
    if any(each.force_controlled for each in moving):
        return (wall.name,)
    turning = [each for each in moving if each.rotates]
    reaches = [reach_about(wall.shape, *each.point_and_axis, np.inf) for each in turning]
    only_turns_in_place = len(turning) == len(moving) and all(reach == 0.0 for reach in reaches)
    if only_turns_in_place:
        return ()
    # Rows of tables are not compared.
    return (wall.name,) if any(isinstance(each, TableMotion) for each in moving) else moving


def _can_coincide(one: PlannedWall, other: PlannedWall, tolerance: float, moves_alike: bool) -> bool:
    """Whether two half spaces have the same surface on the same side, or could have it after a motion."""
    surface = one.shape
    other_surface = other.shape
    assert isinstance(surface, Shape) and isinstance(other_surface, Shape)
    turns = any(each.rotates for wall in (one, other) for each in _motions_in(wall))
    normal = surface.parameters[NORMAL]
    other_normal = other_surface.parameters[NORMAL]
    is_parallel = bool(np.linalg.norm(normal - other_normal) <= ANGLE_TOLERANCE)
    if moves_alike:
        distance = abs((other_surface.parameters[POINT] - surface.parameters[POINT]) @ normal)
        return is_parallel and bool(distance <= tolerance)
    return turns or is_parallel


def _motions_in(wall: PlannedWall) -> tuple[TimedMotion, ...]:
    """The motions of a wall, none if they do not move its surface."""
    return wall.motions if _motions_of_surface(wall) else ()


def _can_end_on(bounded: Surface, plane: Surface, tolerance: float) -> bool:
    """Whether a particle above a half space can be in contact with a bounded surface at the plane.

    It cannot with an upright rectangle, cylinder or part of a mesh that rises from the plane: the contact is
    as high as its center.
    """
    assert isinstance(plane, Shape)
    normal = plane.parameters[NORMAL]
    height = (_points_of(bounded) - plane.parameters[POINT]) @ normal
    if height.min() > tolerance:
        return False
    if height.max() <= tolerance:
        return True
    if isinstance(bounded, Mesh):
        of_triangles = height[bounded.corners]
        is_near = of_triangles.min(axis=1) <= tolerance
        is_upright = np.abs(bounded.adjacency.normal @ normal) <= ANGLE_TOLERANCE
        rises = of_triangles.max(axis=1) > tolerance
        return not bool(np.all((is_upright & rises)[is_near]))
    if bounded.kind is RECTANGLE:
        return not any(is_parallel(bounded.parameters[each], normal) for each in (DIRECTION1, DIRECTION2))
    is_cylinder = bounded["direction_r"] == 0.0
    return not (is_cylinder and is_parallel(bounded.parameters[AXIS], normal))


def _points_of(surface: Surface) -> np.ndarray:
    """Points (n, 3) [m] whose bounding box contains a bounded surface."""
    if isinstance(surface, Mesh):
        return surface.points
    points = triangles(surface, np.zeros(3), 1.0)[0]
    if surface.kind is not REVOLVED:
        return points
    # The facets of a surface of revolution lie inside of it.
    middle = points.mean(axis=0)
    return middle + (points - middle) / np.cos(np.pi / FACET_COUNT)


def _bounds(points: np.ndarray) -> Bounds:
    return points.min(axis=0), points.max(axis=0)


def _overlap(one: Bounds, other: Bounds, tolerance: float, periodic_axes: Sequence[int] = ()) -> bool:
    """Whether two boxes overlap within a tolerance [m]; along periodic axes they always do, by their
    images."""
    is_near = (one[0] <= other[1] + tolerance) & (other[0] <= one[1] + tolerance)
    is_near[list(periodic_axes)] = True
    return bool(is_near.all())


def _has_touching_parts(mesh: Mesh, tolerance: float) -> bool:
    """Whether parts of a mesh that share no edge may touch, or edges have more than two triangles."""
    if mesh.adjacency.nonmanifold_count:
        return True
    pairs = classify_edges(mesh.corners)[0] // 3
    count = mesh.triangle_count
    from scipy.sparse import coo_array  # imported here: most scenes have no mesh
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    part_count, part = connected_components(graph, directed=False)
    if part_count > MAX_PARTS:
        return True
    boxes = [_bounds(mesh.points[np.unique(mesh.corners[part == k])]) for k in range(part_count)]
    return any(_overlap(one, other, tolerance) for one, other in combinations(boxes, 2))
