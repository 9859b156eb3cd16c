"""Which triangle of a mesh answers for a contact: what every edge and corner must know, found once. numpy only.

A sphere touches a mesh wherever its center has a nearest point that no point of the mesh around it outdoes. Each such
place has one triangle that answers for it, and finds out alone. With `s` the center's distance from the line of an
edge, along the face of a triangle and positive over it:

    face      s > 0 at all three edges
    edge      s <= 0 for both triangles of the edge: the one with the lower number answers; of an open edge the one
              there is
    corner    no edge that leaves the corner comes nearer to the center: the lowest triangle there answers

Two triangles in one plane have exactly opposite `s` at the edge between them, so that one of them answers wherever the
center is, also on the seam. A fold of more than two triangles has an edge to touch only where the widest angle between
two neighbors is above 180 degrees; those two share it.

Where the mesh bends towards the sphere by little, it stands for a curved wall, which would be touched once: of
triangles that meet at a point and whose planes enclose at most SMOOTH, only the nearest answers (`rivals`). Sharper
corners are meant as corners and give a contact with each side.
"""

from dataclasses import dataclass

import numpy as np

from granflow.walls.shape import unit

FLAT = 1e-4
"""Angle [rad] up to which two triangles count as one plane: the edge between them cannot be felt. Half of it times the
radius is how far a contact point may then lie beside its triangle."""

SMOOTH = np.radians(30.0)
"""Up to this angle a hollow edge is a facet's, not a corner's: a tube of twelve facets is round, one of ten is not."""

NOT_OWNED, OPEN_EDGE, SHARED_EDGE = range(3)
"""What a triangle does at one of its edges: nothing, answer for an open edge, or answer for two triangles."""


@dataclass(frozen=True, eq=False)
class MeshAdjacency:
    """Arrays over triangles (t, ...), over their edges and corners (t, 3, ...), and over points (n, ...).

    Edge k of a triangle runs from its corner k to the next.
    """

    vertex: np.ndarray
    """(t, 3, 3) corners [m]."""
    normal: np.ndarray
    """(t, 3) unit normals."""
    edge_direction: np.ndarray
    """(t, 3, 3) unit vectors along the edges."""
    length: np.ndarray
    """(t, 3) of the edges [m]."""
    inward: np.ndarray
    """(t, 3, 3) unit vectors in the face, at a right angle to the edge."""
    base: np.ndarray
    """(t, 3) corner 0 to 2 from which distances at an edge are taken: the same point for all triangles of the edge."""
    owns_tie: np.ndarray
    """(t, 3) whether a center exactly above the edge between two triangles in one plane is this one's."""
    role: np.ndarray
    """(t, 3) SILENT, OPEN or SHARED."""
    inward_other: np.ndarray
    """(t, 3, 3) `inward` of the other triangle of an edge that this one answers for."""
    owner: np.ndarray
    """(n,) the triangle that answers for a point."""
    point: np.ndarray
    """(t, 3) the points of a triangle."""
    vertex_edge_start: np.ndarray
    """(n + 1,) where the edges that leave a point begin in `vertex_edge`."""
    vertex_edge: np.ndarray
    """(e, 3) unit vectors away from the points."""
    longest: np.ndarray
    """(n,) longest edge at a point [m]."""
    competitor_start: np.ndarray
    """(2 t + 1,) where the rivals of a triangle begin: 2 t on the side of its normal, 2 t + 1 on the other."""
    competitor: np.ndarray
    """(r,) numbers of triangles."""
    open_count: int
    """Edges of one triangle."""
    fold_count: int
    """Edges of more than two triangles."""


@dataclass(frozen=True, eq=False)
class _Edges:
    """Every edge of every triangle, 3 t of them, grouped by the two points it runs between."""

    number: np.ndarray
    """(3 t,) of the edge between two points."""
    count: int
    base: np.ndarray
    """(3 t,) corner 0 to 2 that is the lower of the two points."""


def adjacency_of(points: np.ndarray, corners: np.ndarray) -> MeshAdjacency:
    """Links of the triangles `corners` (t, 3) of points (n, 3) [m]."""
    vertex = points[corners]
    sides = np.roll(vertex, -1, axis=1) - vertex
    length = np.linalg.norm(sides, axis=2)
    edge_direction = sides / length[:, :, None]
    normal = normalized(np.cross(sides[:, 0], -sides[:, 2]))
    inward = normalized(np.cross(normal[:, None, :], edge_direction))
    edges = edges_of(corners)
    pairs, folds, open_edges = pairs_of(edges)
    owns_tie, role, inward_other = (
        np.zeros((3 * len(corners)), bool),
        np.full(3 * len(corners), NOT_OWNED),
        np.zeros_like(inward),
    )
    inward, inward_other = inward.reshape(-1, 3), inward_other.reshape(-1, 3)
    role[open_edges] = OPEN_EDGE
    join_pairs(pairs, inward, owns_tie, role, inward_other)
    for fold in folds:
        join_fold(fold, inward, owns_tie, role, inward_other)
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
        len(folds),
    )


def normalized(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) at length 1."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def edges_of(corners: np.ndarray) -> _Edges:
    """The edges of triangles (t, 3)."""
    following = np.roll(corners, -1, axis=1)
    ends = np.sort(np.stack([corners, following], axis=2).reshape(-1, 2), axis=1)
    keys = ends[:, 0] * (int(corners.max()) + 1) + ends[:, 1]
    found, number = np.unique(keys, return_inverse=True)
    second = (following < corners).reshape(-1)
    base = (np.tile([0, 1, 2], len(corners)) + second) % 3
    return _Edges(number.reshape(-1), len(found), base)


def pairs_of(edges: _Edges) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
    """Triangle edges that lie on each other: two of them (p, 2), more (k,) each, and those alone (o,)."""
    order = np.argsort(edges.number, kind="stable")
    sizes = np.bincount(edges.number, minlength=edges.count)
    starts = np.cumsum(sizes) - sizes
    pairs = order[starts[sizes == 2][:, None] + np.arange(2)]
    folds = [order[start : start + size] for start, size in zip(starts[sizes > 2], sizes[sizes > 2], strict=True)]
    return pairs, folds, order[starts[sizes == 1]]


def join_pairs(
    pairs: np.ndarray, inward: np.ndarray, owns_tie: np.ndarray, role: np.ndarray, inward_other: np.ndarray
) -> None:
    """Share out edges (p, 2) of two triangles: those in one plane need no edge."""
    first, second = pairs[:, 0], pairs[:, 1]
    flat = is_flat(inward[first], inward[second])
    flatten(first[flat], second[flat], inward, owns_tie)
    first, second = first[~flat], second[~flat]
    role[first] = SHARED_EDGE
    inward_other[first] = inward[second]


def join_fold(
    fold: np.ndarray, inward: np.ndarray, owns_tie: np.ndarray, role: np.ndarray, inward_other: np.ndarray
) -> None:
    """Share out an edge of more than two triangles (k,): the two beside the widest free angle have it."""
    for position, one in enumerate(fold):
        for other in fold[position + 1 :]:
            if is_flat(inward[one], inward[other]) and not owns_tie[fold].any():
                flatten(np.array([one]), np.array([other]), inward, owns_tie)
    first = inward[fold[0]]
    axis = next(unit(np.cross(first, each)) for each in _crossing_directions(first, inward[fold]))
    angle = np.arctan2(inward[fold] @ np.cross(axis, first), inward[fold] @ first) % (2 * np.pi)
    ordered = fold[np.argsort(angle, kind="stable")]
    gaps = np.diff(np.sort(angle), append=np.sort(angle)[0] + 2 * np.pi)
    widest = int(np.argmax(gaps))
    if gaps[widest] > np.pi + FLAT:
        one, other = sorted((ordered[widest], ordered[(widest + 1) % len(ordered)]))
        role[one], inward_other[one] = SHARED_EDGE, inward[other]


def _crossing_directions(first: np.ndarray, directions: np.ndarray) -> list[np.ndarray]:
    """Those of the directions (k, 3) that do not lie on the first one's line; or any, where all do."""
    crossing = [each for each in directions if np.linalg.norm(np.cross(first, each)) > FLAT]
    return [*crossing, np.roll(first, 1) + 0.5 * np.roll(first, 2)]


def is_flat(inward_a: np.ndarray, inward_b: np.ndarray) -> np.ndarray:
    """Whether triangles with those `inward` (..., 3) at an edge lie in one plane, side by side."""
    return np.linalg.norm(inward_a + inward_b, axis=-1) <= FLAT


def flatten(first: np.ndarray, second: np.ndarray, inward: np.ndarray, owns_tie: np.ndarray) -> None:
    """Make `inward` of both triangles of each edge exactly opposite; what is right on the edge is the first one's."""
    inward_mean = normalized(inward[first] - inward[second])
    inward[first], inward[second] = inward_mean, -inward_mean
    owns_tie[first] = True


def owners_of(corners: np.ndarray, point_count: int) -> np.ndarray:
    """The lowest triangle (n,) at every point."""
    owner = np.full(point_count, len(corners))
    np.minimum.at(owner, corners.reshape(-1), np.repeat(np.arange(len(corners)), 3))
    return owner


def vertex_edges_of(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Start (n + 1,) and directions (e, 3) of the edges that leave each point, and the longest (n,) [m]."""
    ends = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2)
    both = np.concatenate([ends, ends[:, ::-1]])
    there, back = np.divmod(np.unique(both[:, 0] * len(points) + both[:, 1]), len(points))
    away = points[back] - points[there]
    length, start = np.linalg.norm(away, axis=1), starts_of(there, len(points))
    return start, away / length[:, None], np.maximum.reduceat(length, start[:-1])


def starts_of(sorted_numbers: np.ndarray, count: int) -> np.ndarray:
    """Where each of `count` numbers begins (count + 1,) among sorted ones."""
    return np.searchsorted(sorted_numbers, np.arange(count + 1))


def competitors_of(points: np.ndarray, corners: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles at a common point, bent by less than SMOOTH towards the sphere: by triangle and side of it.

    One that lies wholly behind the plane of another cannot be nearer to a sphere before that plane.
    """
    one, other = neighbors_of(corners, len(points))
    folded = np.abs(np.sum(normal[one] * normal[other], axis=1))
    smooth = (folded >= np.cos(SMOOTH) - FLAT) & (folded < np.cos(FLAT))
    one, other = one[smooth], other[smooth]
    height = np.sum((points[corners[other]] - points[corners[one, 0]][:, None, :]) * normal[one][:, None, :], axis=2)
    size = np.abs(height).max(axis=1)
    keys, rivals = [], []
    for side, heights_above in enumerate((height.max(axis=1), -height.min(axis=1))):
        towards = heights_above > FLAT * size
        keys.append(2 * one[towards] + side)
        rivals.append(other[towards])
    key, competitor = np.concatenate(keys), np.concatenate(rivals)
    order = np.lexsort((competitor, key))
    return starts_of(key[order], 2 * len(corners)), competitor[order]


def neighbors_of(corners: np.ndarray, point_count: int) -> tuple[np.ndarray, np.ndarray]:
    """All ordered pairs (p,), (p,) of different triangles that share a point, each once."""
    triangle = np.repeat(np.arange(len(corners)), 3)
    order = np.argsort(corners.reshape(-1), kind="stable")
    start = starts_of(corners.reshape(-1)[order], point_count)
    at = corners.reshape(-1)
    size = np.diff(start)[at]
    first = np.repeat(triangle, size)
    within = np.arange(len(first)) - np.repeat(np.cumsum(size) - size, size)
    second = triangle[order[np.repeat(start[at], size) + within]]
    pairs = np.unique(first[first != second] * len(corners) + second[first != second])
    return pairs // len(corners), pairs % len(corners)
