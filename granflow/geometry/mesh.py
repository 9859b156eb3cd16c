"""Triangle mesh of a wall at rest, from the triangles of a file, with a cell grid; numpy only.

`mesh_of` merges points, removes triangles without area and duplicates, and splits triangles until neighbors
share complete edges, so that the adjacency of `mesh_contact` holds. `grid_over` lists for each cell the
triangles that a particle centered there can touch.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product
from math import ceil, sqrt
from typing import ClassVar

import numpy as np

from granflow.geometry.connected_parts import connected_parts
from granflow.geometry.mesh_contact import (
    MeshAdjacency,
    adjacency_of,
    classify_edges,
    triangle_contacts,
    triangle_distances,
)
from granflow.geometry.mesh_file import RawTriangles
from granflow.geometry.rows import expanded, row_entries, starts_of
from granflow.geometry.surface import FAR_AWAY, Surface, Vector, boxes_overlap

ANGLE_TOLERANCE = 1e-2
"""Sine of the angle below which a triangle counts as upright on a plane."""
MAX_PARTS = 64
"""Number of parts of a mesh above which they are not compared, but assumed to touch."""


@dataclass(frozen=True, eq=False)
class Mesh(Surface):
    """Triangles of one wall at rest, and counts of the triangles that `mesh_of` removed or split.

    points:            (n, 3) float64 [m], each used by at least one triangle
    corners:           (t, 3) as indices of the points; triangles are two-sided, their winding does not matter
    degenerate_count:  number of removed triangles without area
    duplicate_count:   number of removed triangles with the corners of another triangle
    quad_count:        number of quadrilaterals that were split into two triangles
    divided_count:     number of triangles that were split at hanging points
    """

    kind: ClassVar[str] = "mesh"

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

    def contacts(
        self, points: np.ndarray, triangles: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `Surface`."""
        assert triangles is not None
        return triangle_contacts(self.adjacency, triangles, points)

    def distances(self, points: np.ndarray, reach: float) -> np.ndarray:
        """See `Surface`."""
        return distances_near(self.adjacency.vertex, reach, points)

    def encloses(self, points: np.ndarray) -> np.ndarray:
        """See `Surface`."""
        edges = np.sort(np.concatenate([self.corners[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1)
        is_closed = bool((np.unique(edges, axis=0, return_counts=True)[1] == 2).all())
        return crossed_above(self.points[self.corners], points) if is_closed else super().encloses(points)

    def triangles(self, center: Vector, extent: float) -> tuple[np.ndarray, np.ndarray]:
        """All triangles."""
        return self.points, self.corners

    def is_upright(self, point: Vector, normal: Vector, tolerance: float) -> bool:
        """See `Surface`: whether all triangles near the plane are upright and rise from it."""
        of_triangles = ((self.points - point) @ normal)[self.corners]
        is_near = of_triangles.min(axis=1) <= tolerance
        is_upright = np.abs(self.adjacency.normal @ normal) <= ANGLE_TOLERANCE
        rises = of_triangles.max(axis=1) > tolerance
        return bool(np.all((is_upright & rises)[is_near]))

    def has_touching_parts(self, tolerance: float) -> bool:
        """See `Surface`; also if an edge has more than two triangles, or two that lie on each other."""
        if self.adjacency.nonmanifold_count or self.adjacency.folded_count:
            return True
        part = connected_parts(classify_edges(self.corners)[0] // 3, self.triangle_count)
        part_count = part.max() + 1
        if part_count > MAX_PARTS:
            return True
        parts = [self.points[np.unique(self.corners[part == k])] for k in range(part_count)]
        return any(boxes_overlap(one, other, tolerance) for one, other in combinations(parts, 2))

    def placed(self, scale: float, rotation: np.ndarray, offset: np.ndarray) -> "Mesh":
        """The mesh after scaling, rotation by a matrix (3, 3), and translation (3,) [m], in this order."""
        points = self.points * scale
        if not np.array_equal(rotation, np.eye(3)):
            points = points @ rotation.T
        return replace(self, points=points + offset)


def triangle_areas(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Areas (t,) [m2] of triangles (t, 3), indices of the points (n, 3) [m]."""
    sides = points[corners[:, 1:]] - points[corners[:, :1]]
    return 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)


# A mesh from the triangles of a file.

WELD_TOLERANCE = 1e-6
"""Points closer than this fraction of the mesh size are merged: ten times the rounding error of float32
files."""


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


def welded(points: np.ndarray, tolerance: float) -> np.ndarray:
    """Index (n,) of the point that replaces each point (n, 3) [m]: the lowest of those within a tolerance.

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
    """Number (n,) of the cubic cell of each point (n, 3) [m]; the grid is shifted by `shift`."""
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


def first_occurrences(rows: np.ndarray) -> np.ndarray:
    """Indices (k,), in ascending order, of the rows (n, 3) that do not repeat a previous row."""
    order = np.lexsort(rows.T[::-1])
    new = np.ones(len(rows), bool)
    new[1:] = np.any(rows[order][1:] != rows[order][:-1], axis=1)
    return np.sort(order[new])


# Hanging points: vertices of other triangles on the edge of a triangle, at which it is split.

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
        # Other sides of the same triangle follow in the next iteration.
        is_first_side = side == side[np.searchsorted(triangle, triangle)]
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
    start = corners.reshape(-1)[open_edges]
    end = np.roll(corners, -1, axis=1).reshape(-1)[open_edges]
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
    """Triangle fans that replace the split triangles, from the corner opposite to the split side.

    triangle, side, on_edge:  (h,) as in `hanging_points`, with one side per triangle
    Returns:                  (s, 3) point indices, with the winding of the split triangles
    """
    found = []
    for each in np.unique(triangle):
        is_this = triangle == each
        start, end, opposite = np.roll(corners[each], -int(side[is_this][0]))
        on_side = on_edge[is_this]
        along = (points[on_side] - points[start]) @ (points[end] - points[start])
        ends = np.array([start, *on_side[np.argsort(along, kind="stable")], end])
        found += [[a, b, opposite] for a, b in zip(ends[:-1], ends[1:], strict=True)]
    return np.array(found)


# Cell grid of one mesh at rest.
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
    low = vertex.min(axis=(0, 1)) - reach
    high = vertex.max(axis=(0, 1)) + reach
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


MAX_COMPARED = 4_000_000
"""Largest number of pairs of a point and a triangle whose boxes are compared directly: 0.1 s."""


def distances_near(vertex: np.ndarray, reach: float, points: np.ndarray) -> np.ndarray:
    """Distance (n,) [m] of points (n, 3) [m] from triangles (t, 3, 3) [m], exact up to `reach` [m].

    Only triangles near the points take part, because the grid of a large mesh takes seconds. Points farther
    than `reach` get a larger distance or FAR_AWAY.
    """
    found = np.full(len(points), FAR_AWAY)
    if not len(points):
        return found
    low, high = vertex.min(axis=1) - reach, vertex.max(axis=1) + reach
    near = np.all((high >= points.min(axis=0)) & (low <= points.max(axis=0)), axis=1)
    vertex, low, high = vertex[near], low[near], high[near]
    if not len(vertex):
        return found
    if len(points) * len(vertex) > MAX_COMPARED:
        return distances(grid_over(vertex, reach), vertex, points)
    inside = np.ones((len(points), len(vertex)), dtype=bool)
    for axis in range(3):
        coordinate = points[:, axis, None]
        inside &= (coordinate >= low[:, axis]) & (coordinate <= high[:, axis])
    point, triangle = np.nonzero(inside)
    np.minimum.at(found, point, triangle_distances(vertex[triangle], points[point]))
    return found


OFF_EDGES = np.array([0.577e-7, 0.331e-7])
"""Shift of a vertical line in x and y, over the size of the mesh: coordinates are often multiples of its
dimensions, and a line through an edge would cross two triangles or none."""


def crossed_above(vertex: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Whether the line upward from each point (n, 3) [m] crosses an odd number of triangles (t, 3, 3) [m]:
    for a closed mesh, whether the point is inside."""
    low, high = vertex.min(axis=(0, 1)), vertex.max(axis=(0, 1))
    own = np.flatnonzero(np.all((points >= low) & (points <= high), axis=1))
    odd = np.zeros(len(points), dtype=bool)
    # A grid of columns along z: each lists the triangles above or below it.
    side = float((high - low)[:2].max()) / ceil(sqrt(len(vertex)))
    shape = np.array([*np.maximum(np.ceil((high - low)[:2] / side), 1), 1]).astype(np.int64)
    column, triangle = overlaps(vertex, 0.0, low, side, shape)
    order = np.argsort(column, kind="stable")
    start = starts_of(column[order], int(np.prod(shape)))
    at = points[own, :2] + OFF_EDGES * (high - low).max()
    x, y = np.clip(np.floor((at - low[:2]) / side).astype(np.int64), 0, shape[:2] - 1).T
    point, entry = row_entries(start, y * shape[0] + x)
    triangle = triangle[order][entry]
    corners = [vertex[triangle, k, :2] - at[point] for k in range(3)]
    areas = np.array([_cross(corners[(k + 1) % 3], corners[(k + 2) % 3]) for k in range(3)])
    total = areas.sum(axis=0)
    crosses = (np.sign(areas) == np.sign(total)).all(axis=0) & (total != 0.0)
    height = (areas * vertex[triangle, :, 2].T).sum(axis=0) / np.where(crosses, total, 1.0)
    above = crosses & (height > points[own[point], 2])
    odd[own] = np.bincount(point[above], minlength=len(own)) % 2 == 1
    return odd


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """z component (n,) of the cross products of vectors (n, 2)."""
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


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
    span_x = spans[triangle, 0]
    span_y = spans[triangle, 1]
    x = first[triangle, 0] + rank % span_x
    y = first[triangle, 1] + rank // span_x % span_y
    z = first[triangle, 2] + rank // (span_x * span_y)
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
        x = cell[part] % shape[0]
        y = cell[part] // shape[0] % shape[1]
        z = cell[part] // (shape[0] * shape[1])
        center = low + side * (np.stack([x, y, z], axis=1) + 0.5)
        is_near[part] = (
            triangle_distances(vertex[triangle[part]], center) <= reach + 0.5 * np.sqrt(3.0) * side
        )
    return cell[is_near], triangle[is_near]
