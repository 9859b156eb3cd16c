"""Distance and contact of a point with a triangle of a mesh in numpy: reference implementation of `engine/mesh.py`."""

import numpy as np

from granflow.geometry.compressed_rows import row_entries
from granflow.geometry.mesh.adjacency import OPEN_EDGE, SHARED_EDGE, MeshAdjacency
from granflow.geometry.shape import FAR_AWAY

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

    The gap is FAR_AWAY if another triangle owns the contact, or if the nearest point of the triangle is not a local
    minimum of the distance to the mesh.
    """
    gap, normal = reference_contact_alone(adjacency, triangles, points)
    height = _dot(points - adjacency.vertex[triangles, 0], adjacency.normal[triangles])
    key = 2 * triangles + (height < 0.0)
    query, entry = row_entries(adjacency.competitor_start, key)
    competitor = adjacency.competitor[entry]
    competitor_gap, _ = reference_contact_alone(adjacency, competitor, points[query])
    competitor_owns = (competitor_gap < gap[query]) | ((competitor_gap == gap[query]) & (competitor < triangles[query]))
    not_owner = np.zeros(len(points), bool)
    not_owner[query[competitor_owns]] = True
    return np.where(not_owner, FAR_AWAY, gap), normal


def reference_contact_alone(
    adjacency: MeshAdjacency, triangles: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Same as `reference_contact`, without the comparison with competing triangles.

    Device equivalent: `contact_alone` in `engine/mesh.py`.
    """
    gap, normal = np.full(len(points), FAR_AWAY), adjacency.normal[triangles].copy()
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
        t, role = _dot(from_vertex[:, k], adjacency.edge_direction[triangles, k]), adjacency.role[triangles, k]
        owned = (role == OPEN_EDGE) | ((role == SHARED_EDGE) & (s_other[:, k] <= 0.0))
        over_edge = ~above_any_vertex & ~is_inside[:, k] & (t > 0.0) & (t < adjacency.length[triangles, k])
        from_edge = from_vertex[:, k] - t[:, None] * adjacency.edge_direction[triangles, k]
        _set_contact(gap, normal, owned & over_edge & ~on_face, from_edge)
    return gap, normal


def _inward_distances(
    adjacency: MeshAdjacency, triangles: np.ndarray, from_vertex: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Distances `s` (n, 3) at each edge over the face of the triangle, and over the face of the other triangle [m]."""
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
