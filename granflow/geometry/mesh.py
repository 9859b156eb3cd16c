"""Triangle mesh of a wall at rest: merged points, valid triangles, and counts of removed triangles. numpy
only."""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from granflow.geometry.mesh_file import RawTriangles
from granflow.geometry.shape import FAR_AWAY, distance_from_axis, unit

# Compressed rows: row k of a table has the entries start[k] to start[k + 1] - 1.


def starts_of(sorted_numbers: np.ndarray, count: int) -> np.ndarray:
    """Start (count + 1,) of each of the numbers 0 to `count` - 1 in a sorted array."""
    return np.searchsorted(sorted_numbers, np.arange(count + 1))


def row_entries(start: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All entries of the rows `wanted` (n,): positions in `wanted` (r,), ascending, and entries (r,)."""
    return expanded(start[wanted], start[wanted + 1] - start[wanted])


def expanded(first: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The numbers of n ranges (n,), (n,): indices of the ranges (r,), ascending, and numbers (r,) from
    `first` on."""
    index = np.repeat(np.arange(len(count)), count)
    rank = np.arange(len(index)) - np.repeat(np.cumsum(count) - count, count)
    return index, first[index] + rank


# Adjacency of a triangle mesh: determines the owning triangle of each contact. Computed once. numpy only.
#
# A contact exists at each local minimum of the distance between particle center and mesh. Exactly one
# triangle owns it, and each triangle decides independently. Let `s` be the distance of the center from the
# line of an edge, measured in the plane of the triangle and positive over its face:
#
#     face      s > 0 at all three edges
#     edge      s <= 0 for both triangles of the edge: the triangle with the lower index owns the contact; an
#               open edge belongs to its only triangle
#     vertex    no edge at the vertex is nearer to the center: the triangle with the lowest index owns the
#               contact
#
# Two coplanar triangles have exactly opposite `s` at their common edge, so that one of them owns the
# contact for every position of the center, including positions above the edge. A non-manifold edge (more
# than two triangles) can be in contact only if the widest angle between two neighboring triangles exceeds
# 180 degrees; these two share it.
#
# If the mesh is slightly concave toward the particle, it approximates a curved wall with a single contact:
# of triangles with a common point whose planes enclose at most SMOOTH_ANGLE, only the nearest owns a
# contact (competing triangles). Sharper concave edges are treated as corners and give a contact with each
# side.

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
    kernels read the same arrays (`engine/state.py`); `contact.py` is the reference implementation that uses
    them.
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


@dataclass(frozen=True, eq=False)
class _Edges:
    """The 3 t edges of all triangles, numbered 3 triangle + edge, with their roles as in MeshAdjacency."""

    inward: np.ndarray
    owns_tie: np.ndarray
    role: np.ndarray
    inward_other: np.ndarray

    def share(self, first: np.ndarray, second: np.ndarray) -> None:
        """Assign edges of two triangles, (p,) and (p,), to the first; edges of coplanar triangles have no
        contact."""
        coplanar = is_coplanar(self.inward[first], self.inward[second])
        self.make_coplanar(first[coplanar], second[coplanar])
        first = first[~coplanar]
        second = second[~coplanar]
        self.role[first] = SHARED_EDGE
        self.inward_other[first] = self.inward[second]

    def share_nonmanifold(self, edges: np.ndarray) -> None:
        """Assign an edge of k > 2 triangles (k,) to the two at the widest free angle, if it exceeds 180
        degrees."""
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
        """Make `inward` of both triangles of each edge exactly opposite; ties on the edge belong to the
        first."""
        mean = normalized(self.inward[first] - self.inward[second])
        self.inward[first], self.inward[second] = mean, -mean
        self.owns_tie[first] = True


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
    )


def normalized(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) scaled to length 1; not finite for a zero vector."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def is_coplanar(inward_a: np.ndarray, inward_b: np.ndarray) -> np.ndarray:
    """Whether (...,) two triangles at an edge are coplanar and do not overlap; arguments (..., 3) as
    `inward`."""
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
    """Competing triangles by triangle and side: common point, angle up to SMOOTH_ANGLE, concave toward the
    particle.

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


# Distance and contact of a point with a triangle of a mesh in numpy: reference implementation of
# `engine/walls.py`.

ROUNDING = 16.0
"""Tolerance, in units in the last place of the lengths at a vertex, for a center above the vertex."""


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


def reference_contact(
    adjacency: MeshAdjacency, triangles: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gap and normal of the contact of points with triangles, one point per triangle.

    adjacency:  adjacency of the mesh
    triangles:  (n,) indices of the triangles
    points:     (n, 3) centers [m] in the frame of the mesh at rest
    Returns:    gap (n,) [m]; unit normal (n, 3) from the mesh to the point

    The gap is FAR_AWAY if another triangle owns the contact, or if the nearest point of the triangle is not a
    local minimum of the distance to the mesh.
    """
    gap, normal = reference_contact_alone(adjacency, triangles, points)
    height = _dot(points - adjacency.vertex[triangles, 0], adjacency.normal[triangles])
    key = 2 * triangles + (height < 0.0)
    query, entry = row_entries(adjacency.competitor_start, key)
    competitor = adjacency.competitor[entry]
    competitor_gap, _ = reference_contact_alone(adjacency, competitor, points[query])
    competitor_owns = (competitor_gap < gap[query]) | (
        (competitor_gap == gap[query]) & (competitor < triangles[query])
    )
    not_owner = np.zeros(len(points), bool)
    not_owner[query[competitor_owns]] = True
    return np.where(not_owner, FAR_AWAY, gap), normal


def reference_contact_alone(
    adjacency: MeshAdjacency, triangles: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Same as `reference_contact`, without the comparison with competing triangles.

    Device equivalent: `contact_alone` in `engine/walls.py`.
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
    """Distances `s` (n, 3) at each edge over the face of the triangle, and over the face of the other
    triangle [m]."""
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


def _dot(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.sum(one * other, axis=-1)


# Grid of one mesh at rest: for each cell the triangles that a particle centered there can touch. numpy
# only.
#
# A triangle is listed in all cells within its reach, so that a particle reads a single cell and finds each
# triangle once. The cost per particle depends on the number of triangles near it, not on the total number
# of triangles.

CELLS_PER_TRIANGLE, MIN_CELLS = 8.0, 4096
"""Maximum number of cells of a grid."""
ENTRIES_PER_TRIANGLE, MIN_ENTRIES = 64.0, 65536
"""Maximum total number of (cell, triangle) candidates; a large triangle lies in many cells."""
REACH_FACTOR = 1.0 + 1e-5
"""Factor of the reach that allows for rounding of positions on the device, including float32."""
CHUNK_PAIRS = 200_000
"""Number of (cell, triangle) candidates evaluated at a time."""


@dataclass(frozen=True, eq=False)
class MeshGrid:
    """Cell grid of one mesh in its rest frame.

    low:       (3,) [m] low corner
    side:      edge length [m] of the cubic cells
    shape:     (3,) number of cells along each axis; the cell number is (z shape[1] + y) shape[0] + x
    start:     (cells + 1,) start of each cell in `triangle`
    triangle:  (r,) triangles of all cells, ascending within a cell
    """

    low: np.ndarray
    side: float
    shape: np.ndarray
    start: np.ndarray
    triangle: np.ndarray


def grid_over(vertex: np.ndarray, reach: float) -> MeshGrid:
    """Grid of triangles for particle centers near them.

    vertex:  (t, 3, 3) corners [m]
    reach:   largest distance [m] of a center from a triangle that a cell must list
    """
    reach = reach * REACH_FACTOR
    low, high = vertex.min(axis=(0, 1)) - reach, vertex.max(axis=(0, 1)) + reach
    side = side_of(vertex, reach, low, high)
    shape = np.maximum(np.ceil((high - low) / side), 1).astype(np.int64)
    cell, triangle = overlaps(vertex, reach, low, side, shape)
    cell, triangle = within_reach(vertex, reach, low, side, shape, cell, triangle)
    order = np.lexsort((triangle, cell))
    start = starts_of(cell[order], int(np.prod(shape)))
    return MeshGrid(low, side, shape, start, triangle[order])


def distances(grid: MeshGrid, vertex: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance of points from the mesh of a grid.

    vertex:   (t, 3, 3) corners [m] of the mesh of the grid
    points:   (n, 3) [m]
    Returns:  (n,) [m]; FAR_AWAY if the cell of the point lists no triangle, or outside the grid
    """
    cell = np.floor((points - grid.low) / grid.side).astype(np.int64)
    inside = np.flatnonzero(np.all((cell >= 0) & (cell < grid.shape), axis=1))
    x, y, z = cell[inside].T
    query, entry = row_entries(grid.start, (z * grid.shape[1] + y) * grid.shape[0] + x)
    found = np.full(len(points), FAR_AWAY)
    np.minimum.at(
        found, inside[query], triangle_distances(vertex[grid.triangle[entry]], points[inside[query]])
    )
    return found


def side_of(vertex: np.ndarray, reach: float, low: np.ndarray, high: np.ndarray) -> float:
    """Smallest cell size [m], at least `reach`, that satisfies the limits on cells and candidates.

    vertex:     (t, 3, 3) corners [m]
    low, high:  (3,) [m] corners of the grid
    """
    size = np.ptp(vertex, axis=1) + 2.0 * reach
    count = len(vertex)
    side = reach
    while True:
        cells = np.prod(np.ceil((high - low) / side))
        entries = np.prod(size / side + 1.0, axis=1).sum()
        few_cells = cells <= CELLS_PER_TRIANGLE * count + MIN_CELLS
        if few_cells and entries <= ENTRIES_PER_TRIANGLE * count + MIN_ENTRIES:
            return side
        side *= 1.25


def overlaps(
    vertex: np.ndarray, reach: float, low: np.ndarray, side: float, shape: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Candidates: cells within `reach` [m] of the bounding box of a triangle.

    vertex:            (t, 3, 3) corners [m]
    low, side, shape:  those of MeshGrid
    Returns:           cell numbers (p,) and triangles (p,)
    """
    first = np.clip(np.floor((vertex.min(axis=1) - reach - low) / side).astype(np.int64), 0, shape - 1)
    last = np.clip(np.floor((vertex.max(axis=1) + reach - low) / side).astype(np.int64), 0, shape - 1)
    spans = last - first + 1
    triangle, rank = expanded(np.zeros(len(vertex), np.int64), np.prod(spans, axis=1))
    span_x, span_y = spans[triangle, 0], spans[triangle, 1]
    x, y, z = rank % span_x, rank // span_x % span_y, rank // (span_x * span_y)
    x, y, z = x + first[triangle, 0], y + first[triangle, 1], z + first[triangle, 2]
    return (z * shape[1] + y) * shape[0] + x, triangle


def within_reach(
    vertex: np.ndarray,
    reach: float,
    low: np.ndarray,
    side: float,
    shape: np.ndarray,
    cell: np.ndarray,
    triangle: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Candidates whose cell, replaced by its circumscribed sphere, is within `reach` [m] of the triangle.

    cell, triangle:  (p,) candidates of `overlaps`
    Returns:         cell numbers and triangles of the remaining candidates (q,)
    """
    is_near = np.ones(len(cell), bool)
    for begin in range(0, len(cell), CHUNK_PAIRS):
        part = slice(begin, begin + CHUNK_PAIRS)
        x, y, z = (
            cell[part] % shape[0],
            cell[part] // shape[0] % shape[1],
            cell[part] // (shape[0] * shape[1]),
        )
        center = low + side * (np.stack([x, y, z], axis=1) + 0.5)
        is_near[part] = (
            triangle_distances(vertex[triangle[part]], center) <= reach + 0.5 * np.sqrt(3.0) * side
        )
    return cell[is_near], triangle[is_near]


# Splits triangles at hanging points (vertices of other triangles on their edges), so that both sides share
# edges.

MAX_PAIRS = 2 * 10**8
"""Maximum number of (open edge, point) pairs; a mesh with more is not split, because its parts do not
match."""
SPLIT_CHUNK_PAIRS = 10**6
"""Number of pairs evaluated at a time."""


def split_at_hanging_points(
    points: np.ndarray, corners: np.ndarray, tolerance: float
) -> tuple[np.ndarray, int]:
    """Split triangles until neighboring triangles share complete edges.

    points:     (n, 3) [m]
    corners:    (t, 3) as indices of the points
    tolerance:  largest distance [m] of a point from an open edge that it splits; points within `tolerance` of
                the ends of the edge do not split it
    Returns:    corners (u, 3), u >= t, the split triangles at the end; number of splits of triangles
    """
    count = 0
    while True:
        triangle, side, on_edge = hanging_points(points, corners, tolerance)
        if not len(triangle):
            return corners, count
        is_first_side = (
            side == side[np.searchsorted(triangle, triangle)]
        )  # other sides follow in the next iteration
        triangle = triangle[is_first_side]
        side = side[is_first_side]
        on_edge = on_edge[is_first_side]
        count += len(np.unique(triangle))
        corners = np.concatenate(
            [np.delete(corners, triangle, axis=0), split_triangles(points, corners, triangle, side, on_edge)]
        )


def hanging_points(
    points: np.ndarray, corners: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points that lie on open edges of triangles.

    Returns:  triangles (h,) in ascending order, their sides 0 to 2 (h,), and the points on these sides (h,);
              empty if the mesh has more than MAX_PAIRS pairs of open edges and end points
    """
    _, _, open_edges = classify_edges(corners)
    open_edges = np.sort(open_edges)
    start, end = corners.reshape(-1)[open_edges], np.roll(corners, -1, axis=1).reshape(-1)[open_edges]
    candidate_points = np.unique(start)
    found: list[np.ndarray] = [np.empty((2, 0), dtype=np.int64)]
    if len(open_edges) * len(candidate_points) <= MAX_PAIRS:
        step = max(SPLIT_CHUNK_PAIRS // max(len(candidate_points), 1), 1)
        for first in range(0, len(open_edges), step):
            part = slice(first, first + step)
            edge, point = np.nonzero(lies_on(points, start[part], end[part], candidate_points, tolerance))
            found.append(np.stack([open_edges[part][edge], candidate_points[point]]))
    edge, point = np.concatenate(found, axis=1)
    return edge // 3, edge % 3, point


def lies_on(
    points: np.ndarray, start: np.ndarray, end: np.ndarray, candidate_points: np.ndarray, tolerance: float
) -> np.ndarray:
    """Whether each point lies on each edge, excluding its ends.

    points:            (n, 3) [m]
    start, end:        (e,) point indices of the edges
    candidate_points:  (p,) point indices
    Returns:           (e, p) bool
    """
    along = points[end] - points[start]
    length = np.linalg.norm(along, axis=1)
    from_start = points[candidate_points][None, :, :] - points[start][:, None, :]
    height = np.einsum("epx,ex->ep", from_start, along / length[:, None])
    distance = np.sqrt(np.maximum(np.einsum("epx,epx->ep", from_start, from_start) - height**2, 0.0))
    return (distance <= tolerance) & (height > tolerance) & (height < length[:, None] - tolerance)


def split_triangles(
    points: np.ndarray, corners: np.ndarray, triangle: np.ndarray, side: np.ndarray, on_edge: np.ndarray
) -> np.ndarray:
    """Triangle fans that replace the split triangles: from the opposite corner to the segments of the split
    side.

    triangle, side, on_edge:  (h,) as in `hanging_points`, with one side per triangle
    Returns:                  (s, 3) point indices, with the winding of the split triangles
    """
    found = []
    for each in np.unique(triangle):
        is_this = triangle == each
        start, end, opposite = np.roll(corners[each], -int(side[is_this][0]))
        on_side = on_edge[is_this]
        on_side = on_side[
            np.argsort((points[on_side] - points[start]) @ (points[end] - points[start]), kind="stable")
        ]
        ends = np.array([start, *on_side, end])
        found += [[a, b, opposite] for a, b in zip(ends[:-1], ends[1:], strict=True)]
    return np.array(found)


WELD_TOLERANCE = 1e-6
"""Points closer than this fraction of the mesh size are merged: ten times the rounding error of float32
files."""


def triangle_areas(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Areas (t,) [m2] of triangles (t, 3), indices of the points (n, 3) [m]."""
    sides = points[corners[:, 1:]] - points[corners[:, :1]]
    return 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of one wall at rest, and counts of the triangles that `mesh_of` removed or split.

    points:            (n, 3) float64 [m], each used by at least one triangle
    corners:           (t, 3) as indices of the points; triangles are two-sided, their winding does not matter
    degenerate_count:  number of removed triangles without area
    duplicate_count:   number of removed triangles with the corners of another triangle
    quad_count:        number of quadrilaterals that were split into two triangles
    divided_count:     number of triangles that were split at hanging points
    """

    points: np.ndarray
    corners: np.ndarray
    degenerate_count: int = 0
    duplicate_count: int = 0
    quad_count: int = 0
    divided_count: int = 0

    @cached_property
    def adjacency(self) -> MeshAdjacency:
        return adjacency_of(self.points, self.corners)

    @property
    def triangle_count(self) -> int:
        return len(self.corners)

    @property
    def size(self) -> np.ndarray:
        """Extent (3,) along the axes [m]."""
        return np.ptp(self.points, axis=0)

    @property
    def areas(self) -> np.ndarray:
        """Area (t,) of each triangle [m2]."""
        return triangle_areas(self.points, self.corners)

    @property
    def area(self) -> float:
        """Area of one side [m2]."""
        return float(self.areas.sum())

    @property
    def typical_edge(self) -> float:
        """Leg [m] of an isosceles right triangle with the median area."""
        return float(np.sqrt(2.0 * np.median(self.areas)))

    def reach_about(self, point: np.ndarray, axis: np.ndarray) -> float:
        """Largest distance [m] of a point of the mesh from an axis: `point` (3,) [m] on it, unit vector
        `axis` (3,)."""
        return float(distance_from_axis(self.points, point, axis).max())

    def placed(self, scale: float, rotation: np.ndarray, offset: np.ndarray) -> "Mesh":
        """The mesh after scaling, rotation by a matrix (3, 3), and translation (3,) [m], in this order."""
        points = self.points * scale
        if not np.array_equal(rotation, np.eye(3)):
            points = points @ rotation.T
        return replace(self, points=points + offset)


def mesh_of(triangles_read: RawTriangles) -> Mesh:
    """Merge points, remove triangles without area and duplicates, and split triangles at hanging points.

    The mesh is in the unit of the file and has contiguous point indices. Raises ValueError if no triangle
    remains.

    The tolerance is WELD_TOLERANCE times the diagonal of the bounding box: points within it are one point
    (see `welded`), and a triangle whose smallest height is not above it has no area.
    """
    used, corners = np.unique(triangles_read.corners, return_inverse=True)
    points = triangles_read.points[used]
    tolerance = WELD_TOLERANCE * float(np.linalg.norm(np.ptp(points, axis=0)))
    label = welded(points, tolerance)
    corners = label[corners.reshape(-1, 3)]
    is_valid = heights(points[corners]) > tolerance
    corners = corners[is_valid]
    degenerate = int((~is_valid).sum())
    first = first_occurrences(np.sort(corners, axis=1))
    duplicate = len(corners) - len(first)
    corners = corners[first]
    if not len(corners):
        raise ValueError("has no triangle with nonzero area")
    corners, split = split_at_hanging_points(points, corners, tolerance)
    kept, corners = np.unique(corners, return_inverse=True)
    return Mesh(points[kept], corners.reshape(-1, 3), degenerate, duplicate, triangles_read.quad_count, split)


def first_occurrences(rows: np.ndarray) -> np.ndarray:
    """Indices (k,), in ascending order, of the rows (n, 3) that do not repeat a previous row."""
    order = np.lexsort(rows.T[::-1])
    new = np.ones(len(rows), bool)
    new[1:] = np.any(rows[order][1:] != rows[order][:-1], axis=1)
    return np.sort(order[new])


def welded(points: np.ndarray, tolerance: float) -> np.ndarray:
    """Index (n,) of the point that replaces each point (n, 3) [m]: the lowest of those nearer than a
    tolerance [m].

    Chains of such points become one point. All points that share a cell of at least one of eight grids are
    merged: cell size 2 `tolerance`, shifted by half a cell along each axis. This includes all pairs of points
    within `tolerance`.
    """
    label = np.arange(len(points))
    if tolerance == 0.0:
        return np.zeros_like(label)
    cells = [
        cell_labels(points, 2.0 * tolerance, tolerance * np.array(shift))
        for shift in product((0, 1), repeat=3)
    ]
    while True:
        before = label.copy()
        for cell in cells:
            lowest = np.full(int(cell.max()) + 1, len(points))
            np.minimum.at(lowest, cell, label)
            label = lowest[cell]
        if np.array_equal(label, before):
            return label


def cell_labels(points: np.ndarray, side: float, shift: np.ndarray) -> np.ndarray:
    """Number (n,) of the cubic cell with this side [m] around each point (n, 3) [m]; the grid is shifted by
    `shift`."""
    cells = np.floor((points - points.min(axis=0) + shift) / side).astype(np.int64)
    spans = cells.max(axis=0) + 1
    keys = (cells[:, 0] * spans[1] + cells[:, 1]) * spans[2] + cells[:, 2]
    return np.unique(keys, return_inverse=True)[1].reshape(-1)


def heights(triangles: np.ndarray) -> np.ndarray:
    """Smallest height (t,) [m] of triangles (t, 3, 3); 0 for those without area."""
    sides = np.roll(triangles, -1, axis=1) - triangles
    longest = np.linalg.norm(sides, axis=2).max(axis=1)
    double_area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return double_area / np.where(longest > 0.0, longest, 1.0)
