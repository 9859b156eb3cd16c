"""Walls of triangles on the device: which triangles are near, and whether one of them answers for a contact.

`walls/mesh_links.py` says how a contact is chosen, `walls/mesh_contact.py` is the numpy twin. Everything here is in the
frame of the mesh at rest; triangles of all meshes are numbered through.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti

from granflow.device.state import State
from granflow.walls.mesh_contact import ROUNDING
from granflow.walls.mesh_links import OPEN, SILENT
from granflow.walls.shape import FAR_AWAY

EPSILON = {ti.f64: float(np.finfo(np.float64).eps), ti.f32: float(np.finfo(np.float32).eps)}


@dataclass(frozen=True)
class MeshGeometry:
    """Device functions of a point in the frame of the mesh."""

    cell: Any
    """(wall, point) -> where the triangles that could be near begin and end in `MeshFields.listed`."""
    away: Any
    """(triangle, point) -> the way from the nearest point of the triangle alone to the point [m]."""
    may_answer: Any
    """(triangle, point, slack) -> 1 unless the triangle cannot answer for any point within `slack` [m] of this one."""
    contact: Any
    """(triangle, point) -> (gap [m], normal); FAR_AWAY where another triangle answers."""


def build_mesh_geometry(state: State) -> MeshGeometry:
    """Functions over the meshes of this plan."""
    return MeshGeometry(_build_cell(state), _build_away(state), _build_may_answer(state), _build_contact(state))


def _build_cell(state: State) -> Any:
    mesh = state.mesh

    @ti.func
    def cell(w, point):
        place = ti.floor((point - mesh.low[w]) / mesh.side[w])
        begin, end = 0, 0
        shape = mesh.shape[w]
        inside = place[0] >= 0.0 and place[1] >= 0.0 and place[2] >= 0.0
        inside = inside and place[0] < shape[0] and place[1] < shape[1] and place[2] < shape[2]
        if inside:
            x, y, z = ti.cast(place[0], ti.i32), ti.cast(place[1], ti.i32), ti.cast(place[2], ti.i32)
            number = mesh.first_cell[w] + (z * shape[1] + y) * shape[0] + x
            begin, end = mesh.cell_start[number], mesh.cell_start[number + 1]
        return begin, end

    return cell


def _build_away(state: State) -> Any:
    mesh, real = state.mesh, state.backend.position_real

    @ti.func
    def away(t, point):
        normal = mesh.normal[t]
        found = (point - mesh.vertex[3 * t]).dot(normal) * normal
        over, nearest = 1, ti.cast(FAR_AWAY, real)
        beside = found
        for k in range(3):
            from_corner, along = point - mesh.vertex[3 * t + k], mesh.along[3 * t + k]
            if normal.cross(along).dot(from_corner) <= 0.0:
                over = 0
            from_edge = from_corner - ti.min(ti.max(from_corner.dot(along), 0.0), mesh.length[3 * t + k]) * along
            if from_edge.norm() < nearest:
                nearest, beside = from_edge.norm(), from_edge
        if over == 0:
            found = beside
        return found

    return away


def _build_may_answer(state: State) -> Any:
    """Every length that `contact` decides by changes by no more than the point moves.

    Without this a sphere would list all triangles within its radius, where it can touch one or two of them.
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
    def beside_edge(t, k, point, slack):
        edge, beside = 3 * t + k, 0
        if mesh.role[edge] != SILENT:
            away = point - mesh.vertex[edge]
            along, length = away.dot(mesh.along[edge]), mesh.length[edge]
            off = away.dot(mesh.inward[edge]) <= slack
            off = off and (mesh.role[edge] == OPEN or away.dot(mesh.beyond[edge]) <= slack)
            beside = ti.cast(off and along > -slack and along < length + slack, ti.i32)
        return beside

    @ti.func
    def above_corner(t, k, point, slack):
        corner, above = mesh.point[3 * t + k], 0
        if mesh.owner[corner] == t:
            above = 1
            away = point - mesh.vertex[3 * t + k]
            for spoke in range(mesh.spoke_start[corner], mesh.spoke_start[corner + 1]):
                if mesh.spoke[spoke].dot(away) > slack:
                    above = 0
        return above

    @ti.func
    def may_answer(t, point, slack):
        possible = over_face(t, point, slack)
        for k in range(3):
            if possible == 0:
                possible = ti.max(beside_edge(t, k, point, slack), above_corner(t, k, point, slack))
        return possible

    return may_answer


def _build_contact(state: State) -> Any:
    mesh, own, real = state.mesh, _build_own_contact(state), state.backend.position_real

    @ti.func
    def height(t, point):
        return (point - mesh.vertex[3 * t]).dot(mesh.normal[t])

    @ti.func
    def contact(t, point):
        gap, mine, normal = ti.cast(FAR_AWAY, real), ti.cast(FAR_AWAY, real), 0.0 * point
        row = 2 * t + ti.cast(height(t, point) < 0.0, ti.i32)
        begin, turn, end = mesh.rival_start[row], -1, mesh.rival_start[row + 1] - mesh.rival_start[row]
        while turn < end:  # this triangle itself, then its rivals: one loop, so that `own` is compiled once
            one = t
            if turn >= 0:
                one = mesh.rival[begin + turn]
            if turn < 0 or ti.abs(height(one, point)) <= mine:
                found, direction = own(one, point)
                if turn < 0:
                    gap, mine, normal = found, found, direction
                    if not found < FAR_AWAY:
                        end = 0
                elif found < mine or (found == mine and one < t):
                    gap, end = ti.cast(FAR_AWAY, real), 0
            turn += 1
        return gap, normal

    return contact


def _build_own_contact(state: State) -> Any:
    """As `contact`, before rivals are asked."""
    mesh, real = state.mesh, state.backend.position_real
    above_corner, beside_edge = _build_above_corner(state), _build_beside_edge(state)

    @ti.func
    def own(t, point):
        height = (point - mesh.vertex[3 * t]).dot(mesh.normal[t])
        normal = ti.select(height < 0.0, -1.0, 1.0) * mesh.normal[t]
        gap = ti.cast(FAR_AWAY, real)
        near, over_count, lost = 0.0 * normal, 0, 0
        for k in range(3):
            over_count += over_edge(t, k, point)
            if above_corner(t, k, point) == 1:
                lost = 1
                if mesh.owner[mesh.point[3 * t + k]] == t:
                    near = point - mesh.vertex[3 * t + k]
                    gap = near.norm()
        if lost == 0 and over_count == 3:
            gap = ti.abs(height)
        elif lost == 0:
            for k in range(3):
                answers, away = beside_edge(t, k, point)
                if answers == 1:
                    near = away
                    gap = away.norm()
        if over_count < 3 or lost == 1:
            if gap > 0.0 and gap < FAR_AWAY:
                normal = near / gap
        return gap, normal

    @ti.func
    def over_edge(t, k, point):
        edge = 3 * t + k
        s = (point - mesh.vertex[3 * t + mesh.base[edge]]).dot(mesh.inward[edge])
        return ti.cast(s > 0.0 or (s == 0.0 and mesh.tie[edge] == 1), ti.i32)

    return own


def _build_beside_edge(state: State) -> Any:
    """Device function (t, k, point): whether the triangle answers for its edge, and the way from there to the point."""
    mesh = state.mesh

    @ti.func
    def beside_edge(t, k, point):
        edge = 3 * t + k
        away, answers = point - mesh.vertex[edge], 0
        if mesh.role[edge] != SILENT:
            along = away.dot(mesh.along[edge])
            from_base = point - mesh.vertex[3 * t + mesh.base[edge]]
            off = from_base.dot(mesh.inward[edge]) <= 0.0
            off = off and (mesh.role[edge] == OPEN or from_base.dot(mesh.beyond[edge]) <= 0.0)
            answers = ti.cast(off and along > 0.0 and along < mesh.length[edge], ti.i32)
            away -= along * mesh.along[edge]
        return answers, away

    return beside_edge


def _build_above_corner(state: State) -> Any:
    """Device function (t, k, point): whether no edge that leaves a corner comes nearer to the point."""
    mesh = state.mesh
    rounding = ROUNDING * EPSILON[state.backend.position_real]

    @ti.func
    def above_corner(t, k, point):
        corner = mesh.point[3 * t + k]
        away = point - mesh.vertex[3 * t + k]
        slack = rounding * (mesh.longest[corner] + away.norm())
        above = 1
        if away.dot(mesh.along[3 * t + k]) > 2.0 * slack or away.dot(mesh.along[3 * t + (k + 2) % 3]) < -2.0 * slack:
            above = 0
        if above == 1:
            for spoke in range(mesh.spoke_start[corner], mesh.spoke_start[corner + 1]):
                if mesh.spoke[spoke].dot(away) > slack:
                    above = 0
        return above

    return above_corner
