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
    distance: Any
    """(triangle, point) -> distance [m] of the triangle alone, for the list of near triangles."""
    contact: Any
    """(triangle, point) -> (gap [m], normal); FAR_AWAY where another triangle answers."""


def build_mesh_geometry(state: State) -> MeshGeometry:
    """Functions over the meshes of this plan."""
    contact = _build_contact(state)
    return MeshGeometry(_build_cell(state), _build_distance(state), contact)


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


def _build_distance(state: State) -> Any:
    mesh = state.mesh

    @ti.func
    def distance(t, point):
        found = ti.abs((point - mesh.vertex[3 * t]).dot(mesh.normal[t]))
        over = 1
        nearest = ti.cast(FAR_AWAY, found.dtype)
        for k in range(3):
            away = point - mesh.vertex[3 * t + k]
            along, length = mesh.along[3 * t + k], mesh.length[3 * t + k]
            if mesh.normal[t].cross(along).dot(away) <= 0.0:
                over = 0
            beside = away - ti.min(ti.max(away.dot(along), 0.0), length) * along
            nearest = ti.min(nearest, beside.norm())
        return ti.select(over == 1, found, nearest)

    return distance


def _build_contact(state: State) -> Any:
    mesh, own = state.mesh, _build_own_contact(state)

    @ti.func
    def contact(t, point):
        gap, normal = own(t, point)
        side = ti.cast((point - mesh.vertex[3 * t]).dot(mesh.normal[t]) < 0.0, ti.i32)
        if gap < FAR_AWAY:
            mine = gap
            for k in range(mesh.rival_start[2 * t + side], mesh.rival_start[2 * t + side + 1]):
                rival = mesh.rival[k]
                if ti.abs((point - mesh.vertex[3 * rival]).dot(mesh.normal[rival])) <= mine:
                    other, _direction = own(rival, point)
                    if other < mine or (other == mine and rival < t):
                        gap = ti.cast(FAR_AWAY, gap.dtype)
        return gap, normal

    return contact


def _build_own_contact(state: State) -> Any:
    """As `contact`, before rivals are asked."""
    mesh = state.mesh
    above_corner, beside_edge = _build_above_corner(state), _build_beside_edge(state)

    @ti.func
    def own(t, point):
        height = (point - mesh.vertex[3 * t]).dot(mesh.normal[t])
        normal = ti.select(height < 0.0, -1.0, 1.0) * mesh.normal[t]
        gap = ti.cast(FAR_AWAY, height.dtype)
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
