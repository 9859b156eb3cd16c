"""The contact of a particle with one face of a wall, unless it is found on another face as well.

Where surfaces touch, one contact is found several times: two flush blocks have an edge in the surface of each other,
patches can overlap, a plate can end on another wall. The distance of the particle from all surfaces together has one
minimum there, and the nearest face has the contact. With the distances h >= h' of two faces from the center and the
angle theta between the directions, the farther contact point is in the tangent plane of the nearer contact if

    |h' - h cos(theta)| <= tolerance

It is no contact of its own then: along the nearer surface, the distance decreases from there. Where the farther surface
rises from that plane, as at a bend, it is left alone. Corners and grooves have contact points outside of both planes.
"""

from typing import Any

from granflow.engine.state import State
from granflow.engine.walls import WallGeometry, build_wall_of
from granflow.geometry.catalog import SHAPE_KINDS
from granflow.geometry.revolved import REVOLVED
from granflow.geometry.shape import FAR_AWAY
from granflow.kernel_language import ti
from granflow.plan.joined_walls import ITSELF, OTHERS

SAME_PLACE = 1e-4
"""Tolerance over the radius of the particle: above rounding in float32 and of mesh files, below usual overlaps."""

SAME_DISTANCE = 1e-11
"""Distances of a particle from two faces are equal within this part of its radius: the face with the lower number is
the nearer one."""

LEAST_COSINE = 0.5
"""Cosine of the angle between two directions above which they can belong to one contact."""


def build_wall_contact(state: State, geometry: WallGeometry) -> Any:
    """Device function (i, j, pose) -> (gap [m], direction) of particle i and partner j < 0, see `WallGeometry.closest`.

    The gap is FAR_AWAY if a nearer face in the neighbor list of the particle has the same contact.

    Reads:  position, radius, neighbor lists, walls, mesh
    """
    particles, neighbors, walls, real = state.particles, state.neighbors, state.walls, state.backend.position_real
    wall_of, force_range, joined = (
        build_wall_of(state),
        state.parameter("force_range"),
        state.plan.features.joined_walls,
    )
    revolved = SHAPE_KINDS.index(REVOLVED) if SHAPE_KINDS.index(REVOLVED) in geometry.kinds else -1

    @ti.func
    def is_same(j, other, pose, point, radius, gap, direction, other_gap, other_direction):
        """Whether the contact with face j at `gap` is that with another face at `other_gap`, and this one has it."""
        unit, same = SAME_DISTANCE * radius, False
        rank, other_rank = ti.floor(gap / unit), ti.floor(other_gap / unit)
        cosine = direction.dot(other_direction)
        if (other_rank < rank or (other_rank == rank and other > j)) and cosine > LEAST_COSINE:
            contact_point = point - gap * direction
            # A point that the farther surface would be nearer to, if it rose from the tangent plane.
            face, probe = -1 - j, contact_point + gap * other_direction
            in_plane = ti.abs(other_gap - gap * cosine) <= SAME_PLACE * radius
            on_curve = False
            if ti.static(revolved >= 0):
                if not in_plane and walls.kind[wall_of(other)] == revolved:
                    on_curve, face, probe = True, -1 - other, contact_point
            if in_plane or on_curve:
                distance = geometry.surface_distance(face, pose, probe)
                same = (in_plane and distance >= gap - SAME_PLACE * radius) or (
                    on_curve and distance <= SAME_PLACE * radius
                )
        return same

    @ti.func
    def may_be_same(w, j, other):
        wanted = OTHERS
        if wall_of(other) == w:
            wanted = ITSELF
        return other != j and (walls.joints[wall_of(other)] & wanted) != 0

    @ti.func
    def joined_contact(i, j, pose):
        point, radius, w = particles.position[i], ti.cast(particles.radius[i], real), wall_of(j)
        gap, direction = ti.cast(FAR_AWAY, real), 0.0 * point
        first, list_index, end = True, neighbors.list_begin[i], neighbors.list_walls_end[i]
        while first or list_index < end:  # this face, then the others: one loop, so that `closest` is compiled once
            other = j
            if not first:
                other = neighbors.partner[list_index]
                list_index += 1
            if first or may_be_same(w, j, other):
                # The distance without regard to shared edges is cheaper, and at most that of a contact.
                if first or geometry.surface_distance(-1 - other, pose, point) <= gap + SAME_DISTANCE * radius:
                    other_gap, other_direction = geometry.closest(-1 - other, pose, point)
                    if first:
                        gap, direction = other_gap, other_direction
                        if walls.joints[w] == 0 or gap > radius + force_range():
                            end = list_index
                    elif is_same(j, other, pose, point, radius, gap, direction, other_gap, other_direction):
                        gap, end = ti.cast(FAR_AWAY, real), list_index
            first = False
        return gap, direction

    @ti.func
    def wall_contact(i, j, pose):
        gap, direction = 0.0 * particles.position[i][0], 0.0 * particles.position[i]
        if ti.static(joined):
            gap, direction = joined_contact(i, j, pose)
        else:
            gap, direction = geometry.closest(-1 - j, pose, particles.position[i])
        return gap, direction

    return wall_contact
