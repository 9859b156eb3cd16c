"""Splits triangles at hanging points (vertices of other triangles on their edges), so that both sides share edges."""

import numpy as np

from granflow.geometry.mesh.adjacency import classify_edges

MAX_PAIRS = 2 * 10**8
"""Maximum number of (open edge, point) pairs; a mesh with more is not split, because its parts do not match."""

CHUNK_PAIRS = 10**6
"""Number of pairs evaluated at a time."""


def split_at_hanging_points(points: np.ndarray, corners: np.ndarray, tolerance: float) -> tuple[np.ndarray, int]:
    """Split triangles until neighboring triangles share complete edges.

    points:     (n, 3) [m]
    corners:    (t, 3) as indices of the points
    tolerance:  largest distance [m] of a point from an open edge that it splits; points within `tolerance` of the ends
                of the edge do not split it
    Returns:    corners (u, 3), u >= t, the split triangles at the end; number of splits of triangles
    """
    count = 0
    while True:
        triangle, side, on_edge = hanging_points(points, corners, tolerance)
        if not len(triangle):
            return corners, count
        is_first_side = side == side[np.searchsorted(triangle, triangle)]  # other sides follow in the next iteration
        triangle, side, on_edge = triangle[is_first_side], side[is_first_side], on_edge[is_first_side]
        count += len(np.unique(triangle))
        corners = np.concatenate(
            [np.delete(corners, triangle, axis=0), split_triangles(points, corners, triangle, side, on_edge)]
        )


def hanging_points(
    points: np.ndarray, corners: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points that lie on open edges of triangles.

    Returns:  triangles (h,) in ascending order, their sides 0 to 2 (h,), and the points on these sides (h,); empty if
              the mesh has more than MAX_PAIRS pairs of open edges and end points
    """
    _, _, open_edges = classify_edges(corners)
    open_edges = np.sort(open_edges)
    start, end = corners.reshape(-1)[open_edges], np.roll(corners, -1, axis=1).reshape(-1)[open_edges]
    candidate_points = np.unique(start)
    found: list[np.ndarray] = [np.empty((2, 0), dtype=np.int64)]
    if len(open_edges) * len(candidate_points) <= MAX_PAIRS:
        step = max(CHUNK_PAIRS // max(len(candidate_points), 1), 1)
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
    """Triangle fans that replace the split triangles: from the opposite corner to the segments of the split side.

    triangle, side, on_edge:  (h,) as in `hanging_points`, with one side per triangle
    Returns:                  (s, 3) point indices, with the winding of the split triangles
    """
    found = []
    for each in np.unique(triangle):
        is_this = triangle == each
        start, end, opposite = np.roll(corners[each], -int(side[is_this][0]))
        on_side = on_edge[is_this]
        on_side = on_side[np.argsort((points[on_side] - points[start]) @ (points[end] - points[start]), kind="stable")]
        ends = np.array([start, *on_side, end])
        found += [[a, b, opposite] for a, b in zip(ends[:-1], ends[1:], strict=True)]
    return np.array(found)
