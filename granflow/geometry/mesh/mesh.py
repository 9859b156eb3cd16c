"""Triangle mesh of a wall at rest: merged points, valid triangles, and counts of removed triangles. numpy only."""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from granflow.geometry.mesh.adjacency import MeshAdjacency, adjacency_of
from granflow.geometry.mesh.file import RawTriangles
from granflow.geometry.mesh.split import split_at_hanging_points
from granflow.geometry.shape import distance_from_axis

WELD_TOLERANCE = 1e-6
"""Points closer than this fraction of the mesh size are merged: ten times the rounding error of float32 files."""


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
        """Largest distance [m] of a point of the mesh from an axis: `point` (3,) [m] on it, unit vector `axis` (3,)."""
        return float(distance_from_axis(self.points, point, axis).max())

    def placed(self, scale: float, rotation: np.ndarray, offset: np.ndarray) -> "Mesh":
        """The mesh after scaling, rotation by a matrix (3, 3), and translation (3,) [m], in this order."""
        points = self.points * scale
        if not np.array_equal(rotation, np.eye(3)):
            points = points @ rotation.T
        return replace(self, points=points + offset)


def mesh_of(triangles_read: RawTriangles) -> Mesh:
    """Merge points, remove triangles without area and duplicates, and split triangles at hanging points.

    The mesh is in the unit of the file and has contiguous point indices. Raises ValueError if no triangle remains.

    The tolerance is WELD_TOLERANCE times the diagonal of the bounding box: points within it are one point (see
    `welded`), and a triangle whose smallest height is not above it has no area.
    """
    used, corners = np.unique(triangles_read.corners, return_inverse=True)
    points = triangles_read.points[used]
    tolerance = WELD_TOLERANCE * float(np.linalg.norm(np.ptp(points, axis=0)))
    label = welded(points, tolerance)
    corners = label[corners.reshape(-1, 3)]
    is_valid = heights(points[corners]) > tolerance
    corners, degenerate = corners[is_valid], int((~is_valid).sum())
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
    """Index (n,) of the point that replaces each point (n, 3) [m]: the lowest of those nearer than a tolerance [m].

    Chains of such points become one point. All points that share a cell of at least one of eight grids are merged: cell
    size 2 `tolerance`, shifted by half a cell along each axis. This includes all pairs of points within `tolerance`.
    """
    label = np.arange(len(points))
    if tolerance == 0.0:
        return np.zeros_like(label)
    cells = [cell_labels(points, 2.0 * tolerance, tolerance * np.array(shift)) for shift in product((0, 1), repeat=3)]
    while True:
        before = label.copy()
        for cell in cells:
            lowest = np.full(int(cell.max()) + 1, len(points))
            np.minimum.at(lowest, cell, label)
            label = lowest[cell]
        if np.array_equal(label, before):
            return label


def cell_labels(points: np.ndarray, side: float, shift: np.ndarray) -> np.ndarray:
    """Number (n,) of the cubic cell with this side [m] around each point (n, 3) [m]; the grid is shifted by `shift`."""
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
