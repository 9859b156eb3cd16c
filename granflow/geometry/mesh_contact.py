"""Contact of a sphere with a triangle mesh: which triangle owns it, by the adjacency; numpy only.

A contact exists at each local minimum of the distance between particle center and mesh. Exactly one
triangle owns it, and each triangle decides independently. Let `s` be the distance of the center from the
line of an edge, measured in the plane of the triangle and positive over its face:

    face      s > 0 at all three edges
    edge      s <= 0 for both triangles of the edge: the triangle with the lower index owns the contact; an
              open edge belongs to its only triangle
    vertex    no edge at the vertex is nearer to the center: the triangle with the lowest index owns the
              contact

Two coplanar triangles have exactly opposite `s` at their common edge, so that one of them owns the contact
for every position of the center, including positions above the edge. A non-manifold edge (more than two
triangles) can be in contact only if the widest angle between two neighboring triangles exceeds 180 degrees;
these two share it.

If the mesh is slightly concave toward the particle, it approximates a curved wall with a single contact: of
triangles with a common point whose planes enclose at most SMOOTH_ANGLE, only the nearest owns a contact
(competing triangles). Sharper concave edges are treated as corners and give a contact with each side.
"""

from dataclasses import dataclass

import numpy as np

from granflow.geometry.rows import row_entries, starts_of
from granflow.geometry.surface import FAR_AWAY
from granflow.geometry.vectors import unit

COPLANAR_ANGLE = 1e-4
"""Angle [rad] up to which two triangles are coplanar, so that their common edge has no effect on a contact.

A contact point may then lie outside its triangle by up to half this angle times the radius.
"""
SMOOTH_ANGLE = np.radians(30.0)
"""Angle [rad] up to which a concave edge approximates a curved wall: a tube of twelve facets is round, one of
ten is not."""
NOT_OWNED, OPEN_EDGE, SHARED_EDGE = range(3)
"""Role of a triangle at one of its edges: no ownership, owner of an open edge, or owner of a shared edge."""


@dataclass(frozen=True, eq=False)
class MeshAdjacency:
    """Arrays over triangles (t, ...), over their edges and corners (t, 3, ...), and over points (n, ...).

    Edge k of a triangle runs from corner k to the next corner. Lengths are in m, real arrays float64. The
    arrays are computed once; the kernels read the same ones (`engine/mesh.py`) as the reference
    implementation.
    """

    vertex: np.ndarray
    """(t, 3, 3) corners [m]."""
    normal: np.ndarray
    """(t, 3) unit normals."""
    edge_direction: np.ndarray
    """(t, 3, 3) unit vectors along the edges."""
    length: np.ndarray
    """(t, 3) edge lengths [m]."""
    inward: np.ndarray
    """(t, 3, 3) unit vectors in the plane of the triangle, perpendicular to the edge, into the face."""
    base: np.ndarray
    """(t, 3) corner 0 to 2 from which distances at an edge are measured: the same point for all triangles of
    it."""
    owns_tie: np.ndarray
    """(t, 3) whether this triangle owns a contact exactly above the common edge of two coplanar triangles."""
    role: np.ndarray
    """(t, 3) NOT_OWNED, OPEN_EDGE or SHARED_EDGE."""
    inward_other: np.ndarray
    """(t, 3, 3) `inward` of the other triangle of an edge that this triangle owns."""
    owner: np.ndarray
    """(n,) owning triangle of each point."""
    point: np.ndarray
    """(t, 3) point indices of each triangle."""
    vertex_edge_start: np.ndarray
    """(n + 1,) start of the edges of each point in `vertex_edge`."""
    vertex_edge: np.ndarray
    """(e, 3) unit vectors along the edges, away from the points."""
    longest: np.ndarray
    """(n,) length of the longest edge at a point [m]."""
    competitor_start: np.ndarray
    """(2 t + 1,) start of the competing triangles of each triangle: 2 t on the side of its normal, 2 t + 1
    opposite."""
    competitor: np.ndarray
    """(r,) indices of the competing triangles."""
    open_count: int
    """Number of edges with one triangle; 0 for a watertight mesh."""
    nonmanifold_count: int
    """Number of edges with more than two triangles."""
    folded_count: int
    """Number of edges whose two triangles lie on each other, as both sides of a plate without thickness."""


def adjacency_of(points: np.ndarray, corners: np.ndarray) -> MeshAdjacency:
    """Adjacency of a mesh.

    points:   (n, 3) float64 [m]
    corners:  (t, 3) as indices of the points; every triangle must have an area above 0 (see `mesh.mesh_of`)
    """
    vertex = points[corners]
    sides = np.roll(vertex, -1, axis=1) - vertex
    length = np.linalg.norm(sides, axis=2)
    edge_direction = sides / length[:, :, None]
    normal = normalized(np.cross(sides[:, 0], -sides[:, 2]))
    inward = normalized(np.cross(normal[:, None, :], edge_direction)).reshape(-1, 3)
    pairs, nonmanifold, open_edges = classify_edges(corners)
    count = 3 * len(corners)
    is_folded = np.linalg.norm(inward[pairs[:, 0]] - inward[pairs[:, 1]], axis=1) <= COPLANAR_ANGLE
    edges = _Edges(inward, np.zeros(count, bool), np.full(count, NOT_OWNED), np.zeros_like(inward))
    edges.role[open_edges] = OPEN_EDGE
    edges.share(*pairs.T)
    for edge_group in nonmanifold:
        edges.share_nonmanifold(edge_group)
    vertex_edge_start, vertex_edge, longest = vertex_edges_of(points, corners)
    competitor_start, competitor = competitors_of(points, corners, normal)
    owner = np.full(len(points), len(corners))
    np.minimum.at(owner, corners.reshape(-1), np.repeat(np.arange(len(corners)), 3))
    by_edge = (len(corners), 3)
    return MeshAdjacency(
        vertex=vertex,
        normal=normal,
        edge_direction=edge_direction,
        length=length,
        inward=edges.inward.reshape(*by_edge, 3),
        base=([0, 1, 2] + (np.roll(corners, -1, axis=1) < corners)) % 3,
        owns_tie=edges.owns_tie.reshape(by_edge),
        role=edges.role.reshape(by_edge),
        inward_other=edges.inward_other.reshape(*by_edge, 3),
        owner=owner,
        point=corners,
        vertex_edge_start=vertex_edge_start,
        vertex_edge=vertex_edge,
        longest=longest,
        competitor_start=competitor_start,
        competitor=competitor,
        open_count=len(open_edges),
        nonmanifold_count=len(nonmanifold),
        folded_count=int(is_folded.sum()),
    )


@dataclass(frozen=True, eq=False)
class _Edges:
    """The 3 t edges of all triangles, numbered 3 triangle + edge, with their roles as in MeshAdjacency."""

    inward: np.ndarray
    owns_tie: np.ndarray
    role: np.ndarray
    inward_other: np.ndarray

    def share(self, first: np.ndarray, second: np.ndarray) -> None:
        """Assign edges of two triangles, (p,) and (p,), to the first.

        Edges of coplanar triangles have no contact.
        """
        coplanar = is_coplanar(self.inward[first], self.inward[second])
        self.make_coplanar(first[coplanar], second[coplanar])
        first = first[~coplanar]
        second = second[~coplanar]
        self.role[first] = SHARED_EDGE
        self.inward_other[first] = self.inward[second]

    def share_nonmanifold(self, edges: np.ndarray) -> None:
        """Assign an edge of k > 2 triangles (k,) to the two at the widest free angle.

        The edge has no contact unless this angle exceeds 180 degrees.
        """
        for position, one in enumerate(edges):
            for other in edges[position + 1 :]:
                if is_coplanar(self.inward[one], self.inward[other]) and not self.owns_tie[edges].any():
                    self.make_coplanar(np.array([one]), np.array([other]))
        inward = self.inward[edges]
        first = inward[0]
        non_parallel = [each for each in inward if np.linalg.norm(np.cross(first, each)) > COPLANAR_ANGLE]
        axis = unit(np.cross(first, [*non_parallel, np.roll(first, 1) + 0.5 * np.roll(first, 2)][0]))
        angle = np.arctan2(inward @ np.cross(axis, first), inward @ first) % (2 * np.pi)
        ordered = edges[np.argsort(angle, kind="stable")]
        gaps = np.diff(np.sort(angle), append=np.sort(angle)[0] + 2 * np.pi)
        widest = int(np.argmax(gaps))
        if gaps[widest] > np.pi + COPLANAR_ANGLE:
            one, other = sorted((ordered[widest], ordered[(widest + 1) % len(ordered)]))
            self.role[one], self.inward_other[one] = SHARED_EDGE, self.inward[other]

    def make_coplanar(self, first: np.ndarray, second: np.ndarray) -> None:
        """Make `inward` of both triangles of each edge exactly opposite.

        Ties on the edge belong to the first.
        """
        mean = normalized(self.inward[first] - self.inward[second])
        self.inward[first], self.inward[second] = mean, -mean
        self.owns_tie[first] = True


def normalized(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) scaled to length 1; not finite for a zero vector."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def is_coplanar(inward_a: np.ndarray, inward_b: np.ndarray) -> np.ndarray:
    """Whether (...,) two triangles at an edge are coplanar and do not overlap.

    The arguments (..., 3) are as `inward`.
    """
    return np.linalg.norm(inward_a + inward_b, axis=-1) <= COPLANAR_ANGLE


def classify_edges(corners: np.ndarray) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
    """Group the edges of triangles (t, 3) by the number of triangles with the same end points.

    Returns:  pairs (p, 2) of edges with two triangles; one array (k,) for each non-manifold edge; open edges
              (o,). Entries are 3 triangle + edge.
    """
    ends = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    keys = ends[:, 0] * (int(corners.max()) + 1) + ends[:, 1]
    order = np.argsort(keys, kind="stable")
    _, sizes = np.unique(keys, return_counts=True)
    starts = np.cumsum(sizes) - sizes
    pairs = order[starts[sizes == 2][:, None] + np.arange(2)]
    nonmanifold = [
        order[start : start + size] for start, size in zip(starts[sizes > 2], sizes[sizes > 2], strict=True)
    ]
    return pairs, nonmanifold, order[starts[sizes == 1]]


def vertex_edges_of(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges at each point: `vertex_edge_start`, `vertex_edge` and `longest` of MeshAdjacency."""
    ends = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2)
    both = np.concatenate([ends, ends[:, ::-1]])
    start_point, end_point = np.divmod(np.unique(both[:, 0] * len(points) + both[:, 1]), len(points))
    along = points[end_point] - points[start_point]
    length = np.linalg.norm(along, axis=1)
    start = starts_of(start_point, len(points))
    return start, along / length[:, None], np.maximum.reduceat(length, start[:-1])


def competitors_of(
    points: np.ndarray, corners: np.ndarray, normal: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Competing triangles by triangle and side.

    They have a common point, an angle up to SMOOTH_ANGLE, and are concave toward the particle.

    normal:   (t, 3) unit normals
    Returns:  `competitor_start` and `competitor` of MeshAdjacency

    A triangle completely behind the plane of another cannot be nearer to a particle in front of that plane.
    """
    one, other = neighbors_of(corners, len(points))
    normal_cosine = np.abs(np.sum(normal[one] * normal[other], axis=1))
    smooth = (normal_cosine >= np.cos(SMOOTH_ANGLE) - COPLANAR_ANGLE) & (
        normal_cosine < np.cos(COPLANAR_ANGLE)
    )
    one = one[smooth]
    other = other[smooth]
    height = np.sum(
        (points[corners[other]] - points[corners[one, 0]][:, None, :]) * normal[one][:, None, :], axis=2
    )
    size = np.abs(height).max(axis=1)
    concave = [above > COPLANAR_ANGLE * size for above in (height.max(axis=1), -height.min(axis=1))]
    key = np.concatenate([2 * one[is_concave] + side for side, is_concave in enumerate(concave)])
    competitor = np.concatenate([other[is_concave] for is_concave in concave])
    order = np.lexsort((competitor, key))
    return starts_of(key[order], 2 * len(corners)), competitor[order]


def neighbors_of(corners: np.ndarray, point_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Ordered pairs (p,), (p,) of different triangles with a common point, without duplicates."""
    corner_points = corners.reshape(-1)
    order = np.argsort(corner_points, kind="stable")
    corner, entry = row_entries(starts_of(corner_points[order], point_count), corner_points)
    first = corner // 3
    second = order[entry] // 3
    pairs = np.unique(first[first != second] * len(corners) + second[first != second])
    return pairs // len(corners), pairs % len(corners)


# Distance and contact of a point with a triangle: reference implementation of `engine/mesh.py`.

ROUNDING = 16.0
"""Tolerance, in units in the last place of the lengths at a vertex, for a center above the vertex."""


def triangle_contacts(
    adjacency: MeshAdjacency, triangles: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gap and normal of the contact of points with triangles, one point per triangle.

    Reference of `triangle_contact` in `engine/mesh.py`.

    adjacency:  adjacency of the mesh
    triangles:  (n,) indices of the triangles
    points:     (n, 3) centers [m] in the frame of the mesh at rest
    Returns:    gap (n,) [m]; unit normal (n, 3) from the mesh to the point

    The gap is FAR_AWAY if another triangle owns the contact, or if the nearest point of the triangle is not a
    local minimum of the distance to the mesh.
    """
    gap, normal = contacts_alone(adjacency, triangles, points)
    height = _dot(points - adjacency.vertex[triangles, 0], adjacency.normal[triangles])
    key = 2 * triangles + (height < 0.0)
    query, entry = row_entries(adjacency.competitor_start, key)
    competitor = adjacency.competitor[entry]
    competitor_gap, _ = contacts_alone(adjacency, competitor, points[query])
    competitor_owns = (competitor_gap < gap[query]) | (
        (competitor_gap == gap[query]) & (competitor < triangles[query])
    )
    not_owner = np.zeros(len(points), bool)
    not_owner[query[competitor_owns]] = True
    return np.where(not_owner, FAR_AWAY, gap), normal


def contacts_alone(
    adjacency: MeshAdjacency, triangles: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Same as `triangle_contacts`, without the comparison with competing triangles.

    Device equivalent: `_contact_alone` in `engine/mesh.py`.
    """
    gap = np.full(len(points), FAR_AWAY)
    normal = adjacency.normal[triangles].copy()
    from_vertex = points[:, None, :] - adjacency.vertex[triangles]
    height = _dot(from_vertex[:, 0], normal)
    normal[height < 0.0] *= -1.0
    above = _above_vertex(adjacency, triangles, points)
    above_any_vertex = above.any(axis=1)
    s, s_other = _inward_distances(adjacency, triangles, from_vertex)
    is_inside = (s > 0.0) | ((s == 0.0) & adjacency.owns_tie[triangles])
    on_face = ~above_any_vertex & is_inside.all(axis=1)
    gap[on_face] = np.abs(height[on_face])
    for k in range(3):
        is_owner = above[:, k] & (adjacency.owner[adjacency.point[triangles, k]] == triangles)
        _set_contact(gap, normal, is_owner & ~on_face, from_vertex[:, k])
        t = _dot(from_vertex[:, k], adjacency.edge_direction[triangles, k])
        role = adjacency.role[triangles, k]
        owned = (role == OPEN_EDGE) | ((role == SHARED_EDGE) & (s_other[:, k] <= 0.0))
        over_edge = ~above_any_vertex & ~is_inside[:, k] & (t > 0.0) & (t < adjacency.length[triangles, k])
        from_edge = from_vertex[:, k] - t[:, None] * adjacency.edge_direction[triangles, k]
        _set_contact(gap, normal, owned & over_edge & ~on_face, from_edge)
    return gap, normal


def _inward_distances(
    adjacency: MeshAdjacency, triangles: np.ndarray, from_vertex: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Distances `s` (n, 3) [m] at each edge over the face of the triangle, and over that of the other one."""
    from_base = np.take_along_axis(from_vertex, adjacency.base[triangles][:, :, None], axis=1)
    return _dot(from_base, adjacency.inward[triangles]), _dot(from_base, adjacency.inward_other[triangles])


def _above_vertex(adjacency: MeshAdjacency, triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Whether (n, 3) no edge at a vertex is nearer to the point than the vertex, within ROUNDING."""
    found = np.zeros((len(points), 3), bool)
    eps = np.finfo(points.dtype).eps
    for k in range(3):
        corner = adjacency.point[triangles, k]
        from_vertex = points - adjacency.vertex[triangles, k]
        slack = ROUNDING * eps * (adjacency.longest[corner] + np.linalg.norm(from_vertex, axis=1))
        point, vertex_edge = row_entries(adjacency.vertex_edge_start, corner)
        height = np.full(len(points), -np.inf)
        np.maximum.at(height, point, _dot(adjacency.vertex_edge[vertex_edge], from_vertex[point]))
        found[:, k] = height <= slack
    return found


def _set_contact(gap: np.ndarray, normal: np.ndarray, where: np.ndarray, from_vertex: np.ndarray) -> None:
    """Set gap and normal of contacts with an edge or vertex.

    gap, normal:  (n,) [m] and (n, 3), changed in place
    where:        (n,) bool, contacts to set
    from_vertex:  (n, 3) [m] from the nearest point to the center; a zero vector leaves the normal unchanged
    """
    distance = np.linalg.norm(from_vertex, axis=1)
    gap[where] = distance[where]
    nonzero = where & (distance > 0.0)
    normal[nonzero] = from_vertex[nonzero] / distance[nonzero, None]


def triangle_distances(vertex: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance of points from triangles, one point per triangle: from the face or from the nearest edge.

    vertex:   (n, 3, 3) corners [m]
    points:   (n, 3) [m]
    Returns:  (n,) [m]; without the comparison of owners
    """
    sides = np.roll(vertex, -1, axis=1) - vertex
    from_vertex = points[:, None, :] - vertex
    share = np.clip(_dot(from_vertex, sides) / _dot(sides, sides), 0.0, 1.0)
    to_edges = np.linalg.norm(from_vertex - share[:, :, None] * sides, axis=2).min(axis=1)
    normal = np.cross(sides[:, 0], -sides[:, 2])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    is_inside = np.all(_dot(np.cross(normal[:, None, :], sides), from_vertex) > 0.0, axis=1)
    return np.where(is_inside, np.abs(_dot(from_vertex[:, 0], normal)), to_edges)


def _dot(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.sum(one * other, axis=-1)
