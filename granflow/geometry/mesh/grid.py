"""Grid of one mesh at rest: for each cell the triangles that a particle centered there can touch. numpy only.

A triangle is listed in all cells within its reach, so that a particle reads a single cell and finds each triangle once.
The cost per particle depends on the number of triangles near it, not on the total number of triangles.
"""

from dataclasses import dataclass

import numpy as np

from granflow.geometry.compressed_rows import expanded, row_entries, starts_of
from granflow.geometry.mesh.contact import triangle_distances
from granflow.geometry.shape import FAR_AWAY

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
    np.minimum.at(found, inside[query], triangle_distances(vertex[grid.triangle[entry]], points[inside[query]]))
    return found


def side_of(vertex: np.ndarray, reach: float, low: np.ndarray, high: np.ndarray) -> float:
    """Smallest cell size [m], at least `reach`, that satisfies the limits on cells and candidates.

    vertex:     (t, 3, 3) corners [m]
    low, high:  (3,) [m] corners of the grid
    """
    size = np.ptp(vertex, axis=1) + 2.0 * reach
    count, side = len(vertex), reach
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
    vertex: np.ndarray, reach: float, low: np.ndarray, side: float, shape: np.ndarray, cell: np.ndarray,
    triangle: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Candidates whose cell, replaced by its circumscribed sphere, is within `reach` [m] of the triangle.

    cell, triangle:  (p,) candidates of `overlaps`
    Returns:         cell numbers and triangles of the remaining candidates (q,)
    """
    is_near = np.ones(len(cell), bool)
    for begin in range(0, len(cell), CHUNK_PAIRS):
        part = slice(begin, begin + CHUNK_PAIRS)
        x, y, z = cell[part] % shape[0], cell[part] // shape[0] % shape[1], cell[part] // (shape[0] * shape[1])
        center = low + side * (np.stack([x, y, z], axis=1) + 0.5)
        is_near[part] = triangle_distances(vertex[triangle[part]], center) <= reach + 0.5 * np.sqrt(3.0) * side
    return cell[is_near], triangle[is_near]
