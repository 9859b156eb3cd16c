"""Mesh walls on the device: nearby triangles, and the triangle that owns a contact.

`walls/mesh_adjacency.py` defines the owner of a contact, `walls/mesh_contact.py` is the numpy reference implementation.
All coordinates are in the frame of the mesh at rest; triangles are numbered consecutively over all meshes.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti

from granflow.engine.state import State
from granflow.geometry.mesh.adjacency import NOT_OWNED, OPEN_EDGE
from granflow.geometry.mesh.contact import ROUNDING
from granflow.geometry.shape import FAR_AWAY

EPSILON = {ti.f64: float(np.finfo(np.float64).eps), ti.f32: float(np.finfo(np.float32).eps)}
"""Relative rounding error of each type."""


@dataclass(frozen=True)
class MeshGeometry:
    """Device functions of a point in the frame of the mesh."""

    cell: Any
    """(wall, point) -> begin and end of the triangles near the point in `cell_triangles`."""
    from_nearest: Any
    """(triangle, point) -> vector [m] from the nearest point of this triangle to the point."""
    may_own: Any
    """(triangle, point, slack) -> 0 if the triangle owns no contact of any point within `slack` [m] of this point."""
    contact: Any
    """(triangle, point) -> (gap [m], normal); FAR_AWAY if another triangle owns the contact."""


def build_mesh_geometry(state: State) -> MeshGeometry:
    """Functions for the meshes of this plan; points are in m, in the precision of positions.

    Reads:  mesh
    """
    return MeshGeometry(_build_cell(state), _build_from_nearest(state), _build_may_own(state), _build_contact(state))


def _build_cell(state: State) -> Any:
    """Device function (wall, point): range of the triangles in the cell of the point; empty outside the grid."""
    mesh = state.mesh

    @ti.func
    def cell(w, point):
        cell_position = ti.floor((point - mesh.low[w]) / mesh.side[w])
        begin, end = 0, 0
        shape = mesh.shape[w]
        inside = cell_position[0] >= 0.0 and cell_position[1] >= 0.0 and cell_position[2] >= 0.0
        inside = inside and cell_position[0] < shape[0] and cell_position[1] < shape[1] and cell_position[2] < shape[2]
        if inside:
            x, y, z = (
                ti.cast(cell_position[0], ti.i32),
                ti.cast(cell_position[1], ti.i32),
                ti.cast(cell_position[2], ti.i32),
            )
            number = mesh.first_cell[w] + (z * shape[1] + y) * shape[0] + x
            begin, end = mesh.cell_start[number], mesh.cell_start[number + 1]
        return begin, end

    return cell


def _build_from_nearest(state: State) -> Any:
    """Device function (triangle, point): vector [m] from the nearest point of the triangle, on face, edge or vertex."""
    mesh, real = state.mesh, state.backend.position_real

    @ti.func
    def from_nearest(t, point):
        normal = mesh.normal[t]
        found = (point - mesh.vertex[3 * t]).dot(normal) * normal
        over, nearest = 1, ti.cast(FAR_AWAY, real)
        from_edge_nearest = found
        for k in range(3):
            from_corner, edge_direction = point - mesh.vertex[3 * t + k], mesh.edge_direction[3 * t + k]
            if normal.cross(edge_direction).dot(from_corner) <= 0.0:
                over = 0
            from_edge = (
                from_corner
                - ti.min(ti.max(from_corner.dot(edge_direction), 0.0), mesh.length[3 * t + k]) * edge_direction
            )
            if from_edge.norm() < nearest:
                nearest, from_edge_nearest = from_edge.norm(), from_edge
        if over == 0:
            found = from_edge_nearest
        return found

    return from_nearest


def _build_may_own(state: State) -> Any:
    """Device function (triangle, point, slack): `contact` with all comparisons relaxed by `slack` [m].

    Each length that `contact` compares changes by at most the displacement of the point. Without this test the neighbor
    list of a sphere would contain all triangles within its radius, although only one or two can own a contact.
    """
    mesh = state.mesh

    @ti.func
    def over_face(t, point, slack):
        over = 1
        for k in range(3):
            edge = 3 * t + k
            if (point - mesh.vertex[3 * t + mesh.base[edge]]).dot(mesh.inward[edge]) < -slack:
                over = 0
        return over

    @ti.func
    def in_edge_region(t, k, point, slack):
        edge, possible = 3 * t + k, 0
        if mesh.role[edge] != NOT_OWNED:
            from_vertex = point - mesh.vertex[edge]
            along, length = from_vertex.dot(mesh.edge_direction[edge]), mesh.length[edge]
            beyond = from_vertex.dot(mesh.inward[edge]) <= slack
            beyond = beyond and (mesh.role[edge] == OPEN_EDGE or from_vertex.dot(mesh.inward_other[edge]) <= slack)
            possible = ti.cast(beyond and along > -slack and along < length + slack, ti.i32)
        return possible

    @ti.func
    def above_vertex(t, k, point, slack):
        vertex_index, above = mesh.point[3 * t + k], 0
        if mesh.owner[vertex_index] == t:
            above = 1
            from_vertex = point - mesh.vertex[3 * t + k]
            for vertex_edge in range(mesh.vertex_edge_start[vertex_index], mesh.vertex_edge_start[vertex_index + 1]):
                if mesh.vertex_edge[vertex_edge].dot(from_vertex) > slack:
                    above = 0
        return above

    @ti.func
    def may_own(t, point, slack):
        possible = over_face(t, point, slack)
        for k in range(3):
            if possible == 0:
                possible = ti.max(in_edge_region(t, k, point, slack), above_vertex(t, k, point, slack))
        return possible

    return may_own


def _build_contact(state: State) -> Any:
    """Device function (triangle, point): gap [m] and normal of a contact that no competing triangle owns."""
    mesh, contact_alone, real = state.mesh, _build_contact_alone(state), state.backend.position_real

    @ti.func
    def height(t, point):
        return (point - mesh.vertex[3 * t]).dot(mesh.normal[t])

    @ti.func
    def contact(t, point):
        gap, gap_alone, normal = ti.cast(FAR_AWAY, real), ti.cast(FAR_AWAY, real), 0.0 * point
        row = 2 * t + ti.cast(height(t, point) < 0.0, ti.i32)
        begin, entry, end = mesh.competitor_start[row], -1, mesh.competitor_start[row + 1] - mesh.competitor_start[row]
        while entry < end:  # this triangle, then its competitors: one loop, so that `contact_alone` is compiled once
            candidate = t
            if entry >= 0:
                candidate = mesh.competitor[begin + entry]
            if entry < 0 or ti.abs(height(candidate, point)) <= gap_alone:
                found, direction = contact_alone(candidate, point)
                if entry < 0:
                    gap, gap_alone, normal = found, found, direction
                    if not found < FAR_AWAY:
                        end = 0
                elif found < gap_alone or (found == gap_alone and candidate < t):
                    gap, end = ti.cast(FAR_AWAY, real), 0
            entry += 1
        return gap, normal

    return contact


def _build_contact_alone(state: State) -> Any:
    """Device function (triangle, point): as `contact`, before the comparison with competing faces."""
    mesh, real = state.mesh, state.backend.position_real
    above_vertex, in_edge_region = _build_above_vertex(state), _build_in_edge_region(state)

    @ti.func
    def contact_alone(t, point):
        height = (point - mesh.vertex[3 * t]).dot(mesh.normal[t])
        normal = ti.select(height < 0.0, -1.0, 1.0) * mesh.normal[t]
        gap = ti.cast(FAR_AWAY, real)
        near, over_count, is_vertex = 0.0 * normal, 0, 0
        for k in range(3):
            over_count += over_edge(t, k, point)
            if above_vertex(t, k, point) == 1:
                is_vertex = 1
                if mesh.owner[mesh.point[3 * t + k]] == t:
                    near = point - mesh.vertex[3 * t + k]
                    gap = near.norm()
        if is_vertex == 0 and over_count == 3:
            gap = ti.abs(height)
        elif is_vertex == 0:
            for k in range(3):
                owns, from_nearest = in_edge_region(t, k, point)
                if owns == 1:
                    near = from_nearest
                    gap = from_nearest.norm()
        if over_count < 3 or is_vertex == 1:
            if gap > 0.0 and gap < FAR_AWAY:
                normal = near / gap
        return gap, normal

    @ti.func
    def over_edge(t, k, point):
        """1 if the point is over the face at edge k, or exactly above an edge whose ties the triangle owns."""
        edge = 3 * t + k
        s = (point - mesh.vertex[3 * t + mesh.base[edge]]).dot(mesh.inward[edge])
        return ti.cast(s > 0.0 or (s == 0.0 and mesh.owns_tie[edge] == 1), ti.i32)

    return contact_alone


def _build_in_edge_region(state: State) -> Any:
    """Device function (t, k, point): whether the triangle owns a contact at edge k, and the vector from it."""
    mesh = state.mesh

    @ti.func
    def in_edge_region(t, k, point):
        edge = 3 * t + k
        from_nearest, owns = point - mesh.vertex[edge], 0
        if mesh.role[edge] != NOT_OWNED:
            along = from_nearest.dot(mesh.edge_direction[edge])
            from_base = point - mesh.vertex[3 * t + mesh.base[edge]]
            beyond = from_base.dot(mesh.inward[edge]) <= 0.0
            beyond = beyond and (mesh.role[edge] == OPEN_EDGE or from_base.dot(mesh.inward_other[edge]) <= 0.0)
            owns = ti.cast(beyond and along > 0.0 and along < mesh.length[edge], ti.i32)
            from_nearest -= along * mesh.edge_direction[edge]
        return owns, from_nearest

    return in_edge_region


def _build_above_vertex(state: State) -> Any:
    """Device function (t, k, point): 1 if no edge at corner k is nearer to the point than the corner."""
    mesh = state.mesh
    rounding = ROUNDING * EPSILON[state.backend.position_real]

    @ti.func
    def above_vertex(t, k, point):
        vertex_index = mesh.point[3 * t + k]
        from_vertex = point - mesh.vertex[3 * t + k]
        slack = rounding * (mesh.longest[vertex_index] + from_vertex.norm())
        above = 1
        if (
            from_vertex.dot(mesh.edge_direction[3 * t + k]) > 2.0 * slack
            or from_vertex.dot(mesh.edge_direction[3 * t + (k + 2) % 3]) < -2.0 * slack
        ):
            above = 0
        if above == 1:
            for vertex_edge in range(mesh.vertex_edge_start[vertex_index], mesh.vertex_edge_start[vertex_index + 1]):
                if mesh.vertex_edge[vertex_edge].dot(from_vertex) > slack:
                    above = 0
        return above

    return above_vertex
