"""Adjacency of a triangle mesh: determines the owning triangle of each contact. Computed once. numpy only.

A contact exists at each local minimum of the distance between particle center and mesh. Exactly one triangle owns it,
and each triangle decides independently. Let `s` be the distance of the center from the line of an edge, measured in the
plane of the triangle and positive over its face:

    face      s > 0 at all three edges
    edge      s <= 0 for both triangles of the edge: the triangle with the lower index owns the contact; an open edge
              belongs to its only triangle
    vertex    no edge at the vertex is nearer to the center: the triangle with the lowest index owns the contact

Two coplanar triangles have exactly opposite `s` at their common edge, so that one of them owns the contact for every
position of the center, including positions above the edge. A non-manifold edge (more than two triangles) can be in
contact only if the widest angle between two neighboring triangles exceeds 180 degrees; these two share it.

If the mesh is slightly concave toward the particle, it approximates a curved wall with a single contact: of triangles
with a common point whose planes enclose at most SMOOTH_ANGLE, only the nearest owns a contact (competing triangles).
Sharper concave edges are treated as corners and give a contact with each side.
"""

from dataclasses import dataclass

import numpy as np

from granflow.geometry.shape import unit

COPLANAR_ANGLE = 1e-4
"""Angle [rad] up to which two triangles are coplanar, so that their common edge has no effect on a contact.

A contact point may then lie outside its triangle by up to half this angle times the radius.
"""

SMOOTH_ANGLE = np.radians(30.0)
"""Angle [rad] up to which a concave edge approximates a curved wall: a tube of twelve facets is round, one of ten is
not."""

NOT_OWNED, OPEN_EDGE, SHARED_EDGE = range(3)
"""Role of a triangle at one of its edges: no ownership, owner of an open edge, or owner of a shared edge."""


@dataclass(frozen=True, eq=False)
class MeshAdjacency:
    """Arrays over triangles (t, ...), over their edges and corners (t, 3, ...), and over points (n, ...).

    Edge k of a triangle runs from corner k to the next corner. Lengths are in m, real arrays float64. The device reads
    the same arrays (`device/mesh_fields.py`) and `mesh_contact.py` is the reference implementation that uses them.
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
    """(t, 3) corner 0 to 2 from which distances at an edge are measured: the same point for all triangles of it."""
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
    """(2 t + 1,) start of the competing triangles of each triangle: 2 t on the side of its normal, 2 t + 1 opposite."""
    competitor: np.ndarray
    """(r,) indices of the competing triangles."""
    open_count: int
    """Number of edges with one triangle; 0 for a watertight mesh."""
    nonmanifold_count: int
    """Number of edges with more than two triangles."""


@dataclass(frozen=True, eq=False)
class _Edges:
    """The 3 t edges of all triangles, grouped by their two end points."""

    number: np.ndarray
    """(3 t,) index of the edge between two points."""
    count: int
    """Number of different edges."""
    base: np.ndarray
    """(3 t,) corner 0 to 2 with the lower index of the two points."""


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
    inward = normalized(np.cross(normal[:, None, :], edge_direction))
    edges = edges_of(corners)
    pairs, nonmanifold, open_edges = classify_edges(edges)
    owns_tie, role, inward_other = (
        np.zeros((3 * len(corners)), bool),
        np.full(3 * len(corners), NOT_OWNED),
        np.zeros_like(inward),
    )
    inward, inward_other = inward.reshape(-1, 3), inward_other.reshape(-1, 3)
    role[open_edges] = OPEN_EDGE
    assign_shared_edges(pairs, inward, owns_tie, role, inward_other)
    for edge_group in nonmanifold:
        assign_nonmanifold_edge(edge_group, inward, owns_tie, role, inward_other)
    vertex_edge_start, vertex_edge, longest = vertex_edges_of(points, corners)
    competitor_start, competitor = competitors_of(points, corners, normal)
    by_edge = (len(corners), 3)
    return MeshAdjacency(
        vertex,
        normal,
        edge_direction,
        length,
        inward.reshape(*by_edge, 3),
        edges.base.reshape(by_edge),
        owns_tie.reshape(by_edge),
        role.reshape(by_edge),
        inward_other.reshape(*by_edge, 3),
        owners_of(corners, len(points)),
        corners,
        vertex_edge_start,
        vertex_edge,
        longest,
        competitor_start,
        competitor,
        len(open_edges),
        len(nonmanifold),
    )


def normalized(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) scaled to length 1; not finite for a zero vector."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def edges_of(corners: np.ndarray) -> _Edges:
    """Edges of triangles (t, 3), numbered by their unordered pairs of points."""
    following = np.roll(corners, -1, axis=1)
    ends = np.sort(np.stack([corners, following], axis=2).reshape(-1, 2), axis=1)
    keys = ends[:, 0] * (int(corners.max()) + 1) + ends[:, 1]
    found, number = np.unique(keys, return_inverse=True)
    lower_is_second = (following < corners).reshape(-1)
    base = (np.tile([0, 1, 2], len(corners)) + lower_is_second) % 3
    return _Edges(number.reshape(-1), len(found), base)


def classify_edges(edges: _Edges) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
    """Group the 3 t triangle edges by the number of triangles that have the same end points.

    Returns:  pairs (p, 2) of edges with two triangles; one array (k,) for each non-manifold edge; open edges (o,).
              Entries are 3 triangle + edge.
    """
    order = np.argsort(edges.number, kind="stable")
    sizes = np.bincount(edges.number, minlength=edges.count)
    starts = np.cumsum(sizes) - sizes
    pairs = order[starts[sizes == 2][:, None] + np.arange(2)]
    nonmanifold = [order[start : start + size] for start, size in zip(starts[sizes > 2], sizes[sizes > 2], strict=True)]
    return pairs, nonmanifold, order[starts[sizes == 1]]


def assign_shared_edges(
    pairs: np.ndarray, inward: np.ndarray, owns_tie: np.ndarray, role: np.ndarray, inward_other: np.ndarray
) -> None:
    """Assign the edges (p, 2) of two triangles to one owner each; edges of coplanar triangles have none.

    pairs:         (p, 2), entries 3 triangle + edge
    inward:        (3 t, 3) unit vectors, made exactly opposite for coplanar triangles
    owns_tie:      (3 t,) bool, set for the first of two coplanar triangles
    role:          (3 t,), set to SHARED_EDGE for the owner, the triangle with the lower index
    inward_other:  (3 t, 3), set to `inward` of the other triangle
    """
    first, second = pairs[:, 0], pairs[:, 1]
    coplanar = is_coplanar(inward[first], inward[second])
    make_coplanar(first[coplanar], second[coplanar], inward, owns_tie)
    first, second = first[~coplanar], second[~coplanar]
    role[first] = SHARED_EDGE
    inward_other[first] = inward[second]


def assign_nonmanifold_edge(
    edge_group: np.ndarray, inward: np.ndarray, owns_tie: np.ndarray, role: np.ndarray, inward_other: np.ndarray
) -> None:
    """Assign an edge of more than two triangles to the two triangles at the widest free angle.

    edge_group:  (k,), entries 3 triangle + edge of one non-manifold edge

    The other arguments are those of `assign_shared_edges`. If no free angle exceeds 180 degrees, the edge has no
    contact.
    """
    for position, one in enumerate(edge_group):
        for other in edge_group[position + 1 :]:
            if is_coplanar(inward[one], inward[other]) and not owns_tie[edge_group].any():
                make_coplanar(np.array([one]), np.array([other]), inward, owns_tie)
    first = inward[edge_group[0]]
    axis = next(unit(np.cross(first, each)) for each in _non_parallel_directions(first, inward[edge_group]))
    angle = np.arctan2(inward[edge_group] @ np.cross(axis, first), inward[edge_group] @ first) % (2 * np.pi)
    ordered = edge_group[np.argsort(angle, kind="stable")]
    gaps = np.diff(np.sort(angle), append=np.sort(angle)[0] + 2 * np.pi)
    widest = int(np.argmax(gaps))
    if gaps[widest] > np.pi + COPLANAR_ANGLE:
        one, other = sorted((ordered[widest], ordered[(widest + 1) % len(ordered)]))
        role[one], inward_other[one] = SHARED_EDGE, inward[other]


def _non_parallel_directions(first: np.ndarray, directions: np.ndarray) -> list[np.ndarray]:
    """Directions of (k, 3) that are not parallel to `first` (3,), followed by one arbitrary direction."""
    non_parallel = [each for each in directions if np.linalg.norm(np.cross(first, each)) > COPLANAR_ANGLE]
    return [*non_parallel, np.roll(first, 1) + 0.5 * np.roll(first, 2)]


def is_coplanar(inward_a: np.ndarray, inward_b: np.ndarray) -> np.ndarray:
    """Whether two triangles at an edge are coplanar and do not overlap.

    inward_a, inward_b:  (..., 3) unit vectors into the faces, perpendicular to the edge
    Returns:             (...,) bool
    """
    return np.linalg.norm(inward_a + inward_b, axis=-1) <= COPLANAR_ANGLE


def make_coplanar(first: np.ndarray, second: np.ndarray, inward: np.ndarray, owns_tie: np.ndarray) -> None:
    """Make `inward` of both triangles of each edge exactly opposite; ties on the edge belong to the first triangle.

    first, second:  (p,), entries 3 triangle + edge
    inward:         (3 t, 3), changed in place
    owns_tie:       (3 t,) bool, changed in place
    """
    inward_mean = normalized(inward[first] - inward[second])
    inward[first], inward[second] = inward_mean, -inward_mean
    owns_tie[first] = True


def owners_of(corners: np.ndarray, point_count: int) -> np.ndarray:
    """Owner (n,) of the contacts at each point: the triangle with the lowest index that has the point as a corner."""
    owner = np.full(point_count, len(corners))
    np.minimum.at(owner, corners.reshape(-1), np.repeat(np.arange(len(corners)), 3))
    return owner


def vertex_edges_of(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges at each point.

    points:   (n, 3) [m]
    corners:  (t, 3) as indices of the points
    Returns:  start (n + 1,) of the edges of each point; unit vectors (e, 3) away from the points; length (n,) [m] of
              the longest edge at each point
    """
    ends = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2)
    both = np.concatenate([ends, ends[:, ::-1]])
    start_point, end_point = np.divmod(np.unique(both[:, 0] * len(points) + both[:, 1]), len(points))
    along = points[end_point] - points[start_point]
    length, start = np.linalg.norm(along, axis=1), starts_of(start_point, len(points))
    return start, along / length[:, None], np.maximum.reduceat(length, start[:-1])


def starts_of(sorted_numbers: np.ndarray, count: int) -> np.ndarray:
    """Start (count + 1,) of each of the numbers 0 to `count` - 1 in a sorted array (compressed rows)."""
    return np.searchsorted(sorted_numbers, np.arange(count + 1))


def competitors_of(points: np.ndarray, corners: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Competing triangles by triangle and side: common point, angle up to SMOOTH_ANGLE, concave toward the particle.

    points:   (n, 3) [m]
    corners:  (t, 3) as indices of the points
    normal:   (t, 3) unit normals
    Returns:  start (2 t + 1,) and indices (r,) as in MeshAdjacency

    A triangle completely behind the plane of another cannot be nearer to a particle in front of that plane.
    """
    one, other = neighbors_of(corners, len(points))
    normal_cosine = np.abs(np.sum(normal[one] * normal[other], axis=1))
    smooth = (normal_cosine >= np.cos(SMOOTH_ANGLE) - COPLANAR_ANGLE) & (normal_cosine < np.cos(COPLANAR_ANGLE))
    one, other = one[smooth], other[smooth]
    height = np.sum((points[corners[other]] - points[corners[one, 0]][:, None, :]) * normal[one][:, None, :], axis=2)
    size = np.abs(height).max(axis=1)
    keys, competitors = [], []
    for side, heights_above in enumerate((height.max(axis=1), -height.min(axis=1))):
        is_concave = heights_above > COPLANAR_ANGLE * size
        keys.append(2 * one[is_concave] + side)
        competitors.append(other[is_concave])
    key, competitor = np.concatenate(keys), np.concatenate(competitors)
    order = np.lexsort((competitor, key))
    return starts_of(key[order], 2 * len(corners)), competitor[order]


def neighbors_of(corners: np.ndarray, point_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Ordered pairs (p,), (p,) of different triangles with a common point, without duplicates.

    corners:      (t, 3) as indices of the points
    point_count:  number of points
    """
    triangle = np.repeat(np.arange(len(corners)), 3)
    order = np.argsort(corners.reshape(-1), kind="stable")
    start = starts_of(corners.reshape(-1)[order], point_count)
    corner_points = corners.reshape(-1)
    size = np.diff(start)[corner_points]
    first = np.repeat(triangle, size)
    rank = np.arange(len(first)) - np.repeat(np.cumsum(size) - size, size)
    second = triangle[order[np.repeat(start[corner_points], size) + rank]]
    pairs = np.unique(first[first != second] * len(corners) + second[first != second])
    return pairs // len(corners), pairs % len(corners)
