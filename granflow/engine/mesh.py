"""Mesh walls on the device: the contact of a point with a triangle, nearby triangles, and their arrays.

`geometry/mesh_contact.py` defines which triangle owns a contact and has the numpy reference implementation.
All coordinates are in the frame of the mesh at rest, lengths in m, in the precision of positions.

The names of the arrays are those of MeshAdjacency and MeshGrid; `wall` is the wall of each triangle,
`first_cell` the first cell of each wall. Triangles, points and cells are numbered consecutively over all
meshes; edge k of triangle t is 3 t + k.
"""

import numpy as np

from granflow.engine.backend import Backend
from granflow.engine.fields import FieldBlock, Fields, write_padded
from granflow.geometry.mesh_contact import NOT_OWNED, OPEN_EDGE, ROUNDING, MeshAdjacency
from granflow.geometry.surface import FAR_AWAY
from granflow.kernel_language import ti
from granflow.plan.arrays import mesh_arrays
from granflow.plan.plan import Plan

EPSILON = {ti.f64: float(np.finfo(np.float64).eps), ti.f32: float(np.finfo(np.float32).eps)}
"""Relative rounding error of each type."""
SAME_DIRECTION = 1e-6
"""Largest sine of the angle between two normals that count as equal; above rounding in float32."""


class DeviceMesh(Fields):
    """The triangles of all meshes, and device functions of them at a point.

    t is the index of a triangle, w that of a wall.
    """

    def __init__(self, block: FieldBlock, plan: Plan, backend: Backend) -> None:
        super().__init__(block.arrays(mesh_arrays(plan), backend))

    def fill(self, plan: Plan) -> None:
        """Write all arrays; they do not change during a run."""
        meshes = plan.meshes
        arrays = _of_triangles([mesh.adjacency for mesh in meshes.values()]) | _of_grids(plan)
        arrays["wall"] = np.repeat(list(meshes), [mesh.triangle_count for mesh in meshes.values()])
        for name, values in arrays.items():
            write_padded(getattr(self, name), values)

    @ti.func
    def triangle_range(self, w, point):
        """Range of the triangles near the point in `cell_triangles`; empty outside the grid of wall w.

        Reads:  low, side, shape, first_cell, cell_start
        """
        cell_position = ti.floor((point - self.low[w]) / self.side[w])
        begin = 0
        end = 0
        shape = self.shape[w]
        inside = (cell_position[0] >= 0.0) & (cell_position[1] >= 0.0) & (cell_position[2] >= 0.0)
        inside = (
            inside
            & (cell_position[0] < shape[0])
            & (cell_position[1] < shape[1])
            & (cell_position[2] < shape[2])
        )
        if inside:
            x = ti.cast(cell_position[0], ti.i32)
            y = ti.cast(cell_position[1], ti.i32)
            z = ti.cast(cell_position[2], ti.i32)
            number = self.first_cell[w] + (z * shape[1] + y) * shape[0] + x
            begin = self.cell_start[number]
            end = self.cell_start[number + 1]
        return begin, end

    @ti.func
    def may_own(self, t, point, slack):
        """0 if triangle t owns no contact of any point within `slack` [m] of this point.

        This is `triangle_contact` with all comparisons relaxed by `slack`: each length that it compares
        changes by at most the displacement of the point. Without this test the neighbor list of a sphere
        would contain all triangles within its radius, although only one or two can own a contact.

        Reads:  edges, vertices and their adjacency
        """
        possible = self._may_be_over_face(t, point, slack)
        k = 0
        while possible == 0 and k < 3:
            possible = ti.max(
                self._may_be_in_edge_region(t, k, point, slack), self._may_be_above_vertex(t, k, point, slack)
            )
            k += 1
        return possible

    @ti.func
    def _may_be_over_face(self, t, point, slack):
        over = 1
        for k in range(3):
            edge = 3 * t + k
            if (point - self.vertex[3 * t + self.base[edge]]).dot(self.inward[edge]) < -slack:
                over = 0
        return over

    @ti.func
    def _may_be_in_edge_region(self, t, k, point, slack):
        edge = 3 * t + k
        possible = 0
        if self.role[edge] != NOT_OWNED:
            from_vertex = point - self.vertex[edge]
            along = from_vertex.dot(self.edge_direction[edge])
            length = self.length[edge]
            beyond = from_vertex.dot(self.inward[edge]) <= slack
            beyond = beyond and (
                self.role[edge] == OPEN_EDGE or from_vertex.dot(self.inward_other[edge]) <= slack
            )
            possible = ti.cast(beyond and along > -slack and along < length + slack, ti.i32)
        return possible

    @ti.func
    def _may_be_above_vertex(self, t, k, point, slack):
        vertex_index = self.point[3 * t + k]
        above = 0
        if self.owner[vertex_index] == t:
            above = self._is_before_edges(vertex_index, point - self.vertex[3 * t + k], slack)
        return above

    @ti.func
    def _is_before_edges(self, vertex_index, from_vertex, slack):
        """1 if a vector from a vertex points along none of the edges that begin there, up to `slack` [m]."""
        before = 1
        vertex_edge = self.vertex_edge_start[vertex_index]
        while before == 1 and vertex_edge < self.vertex_edge_start[vertex_index + 1]:
            if self.vertex_edge[vertex_edge].dot(from_vertex) > slack:
                before = 0
            vertex_edge += 1
        return before

    @ti.func
    def triangle_contact(self, t, point):
        """Gap [m] and normal of the contact of a point with triangle t.

        The gap is FAR_AWAY if another triangle owns the contact.

        Reads:  faces, edges, vertices and their adjacency, competitor_start, competitor
        """
        gap = ti.cast(FAR_AWAY, self.length.dtype)
        gap_alone = ti.cast(FAR_AWAY, self.length.dtype)
        normal = 0.0 * point
        row = 2 * t + ti.cast(self._height(t, point) < 0.0, ti.i32)
        begin = self.competitor_start[row]
        entry = -1
        end = self.competitor_start[row + 1] - self.competitor_start[row]
        # This triangle, then its competitors: one loop, so that `_contact_alone` is compiled once.
        while entry < end:
            candidate = t
            if entry >= 0:
                candidate = self.competitor[begin + entry]
            if entry < 0 or ti.abs(self._height(candidate, point)) <= gap_alone:
                found, direction = self._contact_alone(candidate, point)
                if entry < 0:
                    gap = found
                    gap_alone = found
                    normal = direction
                    if not found < FAR_AWAY:
                        end = 0
                elif found < gap_alone or (found == gap_alone and candidate < t):
                    gap = ti.cast(FAR_AWAY, self.length.dtype)
                    end = 0
            entry += 1
        return gap, normal

    @ti.func
    def _contact_alone(self, t, point):
        """As `triangle_contact`, before the comparison with competing faces."""
        height = (point - self.vertex[3 * t]).dot(self.normal[t])
        normal = ti.select(height < 0.0, -1.0, 1.0) * self.normal[t]
        gap = ti.cast(FAR_AWAY, self.length.dtype)
        near = 0.0 * normal
        over_count = 0
        is_vertex = 0
        for k in range(3):
            over_count += self._over_edge(t, k, point)
            if self._above_vertex(t, k, point) == 1:
                is_vertex = 1
                if self.owner[self.point[3 * t + k]] == t:
                    near = point - self.vertex[3 * t + k]
                    gap = near.norm()
        if is_vertex == 0 and over_count == 3:
            gap = ti.abs(height)
        elif is_vertex == 0:
            for k in range(3):
                owns, from_nearest = self._in_edge_region(t, k, point)
                if owns == 1:
                    near = from_nearest
                    gap = from_nearest.norm()
        if over_count < 3 or is_vertex == 1:
            if gap > 0.0 and gap < FAR_AWAY:
                normal = near / gap
        return gap, normal

    @ti.func
    def _height(self, t, point):
        return (point - self.vertex[3 * t]).dot(self.normal[t])

    @ti.func
    def _over_edge(self, t, k, point):
        """1 if the point is over the face at edge k, or exactly above an edge whose ties it owns."""
        edge = 3 * t + k
        s = (point - self.vertex[3 * t + self.base[edge]]).dot(self.inward[edge])
        return ti.cast(s > 0.0 or (s == 0.0 and self.owns_tie[edge] == 1), ti.i32)

    @ti.func
    def _in_edge_region(self, t, k, point):
        """Whether the triangle owns a contact at edge k, and the vector [m] from the edge."""
        edge = 3 * t + k
        from_nearest = point - self.vertex[edge]
        owns = 0
        if self.role[edge] != NOT_OWNED:
            along = from_nearest.dot(self.edge_direction[edge])
            from_base = point - self.vertex[3 * t + self.base[edge]]
            beyond = from_base.dot(self.inward[edge]) <= 0.0
            beyond = beyond and (
                self.role[edge] == OPEN_EDGE or from_base.dot(self.inward_other[edge]) <= 0.0
            )
            owns = ti.cast(beyond and along > 0.0 and along < self.length[edge], ti.i32)
            from_nearest -= along * self.edge_direction[edge]
        return owns, from_nearest

    @ti.func
    def _above_vertex(self, t, k, point):
        """1 if no edge at corner k is nearer to the point than the corner."""
        vertex_index = self.point[3 * t + k]
        from_vertex = point - self.vertex[3 * t + k]
        slack = ti.static(ROUNDING * EPSILON[self.length.dtype]) * (
            self.longest[vertex_index] + from_vertex.norm()
        )
        above = 1
        if (
            from_vertex.dot(self.edge_direction[3 * t + k]) > 2.0 * slack
            or from_vertex.dot(self.edge_direction[3 * t + (k + 2) % 3]) < -2.0 * slack
        ):
            above = 0
        if above == 1:
            above = self._is_before_edges(vertex_index, from_vertex, slack)
        return above

    @ti.func
    def from_nearest(self, t, point):
        """Vector [m] to the point from the nearest point of triangle t, on its face, an edge or a vertex.

        Reads:  normal, vertex, edge_direction, length
        """
        normal = self.normal[t]
        found = (point - self.vertex[3 * t]).dot(normal) * normal
        over = 1
        nearest = ti.cast(FAR_AWAY, self.length.dtype)
        from_edge_nearest = found
        for k in range(3):
            from_corner = point - self.vertex[3 * t + k]
            edge_direction = self.edge_direction[3 * t + k]
            if normal.cross(edge_direction).dot(from_corner) <= 0.0:
                over = 0
            from_edge = (
                from_corner
                - ti.min(ti.max(from_corner.dot(edge_direction), 0.0), self.length[3 * t + k])
                * edge_direction
            )
            if from_edge.norm() < nearest:
                nearest = from_edge.norm()
                from_edge_nearest = from_edge
        if over == 0:
            found = from_edge_nearest
        return found

    @ti.func
    def normal_near(self, t, point, normal):
        """Unit normal at a point near a contact of triangle t with this normal.

        On the face it is that of the contact, although the triangle may own no contact of the point: the next
        triangle of a flat surface has the same normal. Near an edge or a vertex it is the direction from the
        triangle.

        Reads:  as `from_nearest`
        """
        found = normal
        if normal.cross(self.normal[t]).norm_sqr() > ti.static(SAME_DIRECTION * SAME_DIRECTION):
            separation = self.from_nearest(t, point)
            distance = separation.norm()
            if distance > 0.0:
                found = separation / distance
        return found


# The arrays of all meshes


def _of_triangles(adjacency: list[MeshAdjacency]) -> dict[str, np.ndarray]:
    """Concatenated arrays of all meshes; indices are shifted by the number of preceding entries."""
    triangles = np.cumsum([0, *(len(each.normal) for each in adjacency)])
    points = np.cumsum([0, *(len(each.owner) for each in adjacency)])

    def joined(name: str, *width: int) -> np.ndarray:
        return np.concatenate([getattr(each, name).reshape(-1, *width) for each in adjacency])

    def shifted(name: str, before: np.ndarray) -> np.ndarray:
        return np.concatenate(
            [getattr(each, name).reshape(-1) + n for each, n in zip(adjacency, before, strict=False)]
        )

    vectors = ("normal", "vertex", "edge_direction", "inward", "inward_other", "vertex_edge")
    numbers = ("length", "base", "owns_tie", "role")
    found = {name: joined(name, 3) for name in vectors} | {
        name: joined(name) for name in (*numbers, "longest")
    }
    found["point"] = shifted("point", points)
    found |= {name: shifted(name, triangles) for name in ("owner", "competitor")}
    for name in ("vertex_edge_start", "competitor_start"):
        found[name] = _starts([getattr(each, name) for each in adjacency])
    return found


def _of_grids(plan: Plan) -> dict[str, np.ndarray]:
    """Arrays of all grids; walls without a mesh have no cells."""
    wall_count = len(plan.walls)
    low = np.zeros((wall_count, 3))
    side = np.ones(wall_count)
    shape = np.zeros((wall_count, 3), np.int64)
    first_cell = np.zeros(wall_count, np.int64)
    cells = 0
    triangles = 0
    cell_triangles = []
    for w, grid in plan.mesh_grids.items():
        low[w], side[w], shape[w], first_cell[w] = grid.low, grid.side, grid.shape, cells
        cell_triangles.append(grid.triangle + triangles)
        cells = cells + len(grid.start) - 1
        triangles = triangles + plan.meshes[w].triangle_count
    start = _starts([grid.start for grid in plan.mesh_grids.values()])
    return {
        "low": low,
        "side": side,
        "shape": shape,
        "first_cell": first_cell,
        "cell_start": start,
        "cell_triangles": np.concatenate(cell_triangles),
    }


def _starts(starts: list[np.ndarray]) -> np.ndarray:
    """Row starts of concatenated tables; each given array has one entry more than rows."""
    counts = np.concatenate([np.diff(each) for each in starts])
    return np.concatenate([[0], np.cumsum(counts)])
