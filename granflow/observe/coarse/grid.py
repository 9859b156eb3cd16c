"""A box cut into equal cells, over which points are spread with a kernel."""

from dataclasses import dataclass
from functools import cached_property

import meshio
import numpy as np

from granflow.observe.coarse.kernel import Kernel
from granflow.observe.frames import mesh_of_cells
from granflow.scene.analysis import CellGrid
from granflow.scene.border import AXES
from granflow.scene.schema import Domain

PIECE = 2**17
"""Points that are spread at a time, which bounds the memory in work."""

LARGEST_PRODUCT = 2**18
"""Multiplications in one product of matrices: OpenBLAS starts threads above that, which fight for busy cores."""

BLOCK = 16
"""Cells along x whose points go into one product of matrices."""

CORNERS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
"""Corners of a hexahedron in the order of VTK."""


@dataclass(frozen=True)
class Grid:
    """A box from `low` to `high` (3,) [m] with `counts` cells along x, y and z.

    Cells are numbered with x fastest, as in VTK. Along a `periodic` axis the box is one period.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    counts: tuple[int, int, int]
    periodic: tuple[bool, bool, bool] = (False, False, False)

    @cached_property
    def cell(self) -> np.ndarray:
        """Edges of a cell (3,) [m]."""
        return (np.array(self.high) - self.low) / self.counts

    @property
    def cell_volume(self) -> float:
        """Volume of a cell [m3]."""
        return float(np.prod(self.cell))

    @property
    def cell_count(self) -> int:
        """Number of cells."""
        return int(np.prod(self.counts))

    def centers(self) -> np.ndarray:
        """Middle of every cell (cells, 3) [m]."""
        x, y, z = (low + (np.arange(n) + 0.5) * h for low, n, h in zip(self.low, self.counts, self.cell, strict=True))
        grid = np.meshgrid(z, y, x, indexing="ij")
        return np.stack([axis.ravel() for axis in grid[::-1]], axis=1)

    def spread(self, kernel: Kernel, points: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Integral over every cell of what points (n, 3) [m] carry, values (n, k): (cells, k).

        What falls outside the grid is left out, or wraps around along periodic axes; the rest is exact, so that the
        cells add up to all that the points carry where the grid holds the whole reach of the kernel about them.
        """
        low, width = np.array(self.low), np.array(self.high) - self.low
        points = np.where(self.periodic, low + np.mod(points - low, width), points)
        first = np.floor((points - kernel.reach - self.low) / self.cell).astype(np.int64)
        reached = np.ceil(2.0 * kernel.reach / self.cell).astype(np.int64) + 1
        near = np.flatnonzero(((first + reached > 0) & (first < self.counts)).all(axis=1))
        around = _Padded(self, reached, values.shape[1])
        for begin in range(0, len(near), PIECE):
            piece = near[begin : begin + PIECE]
            around.add(kernel, points[piece], values[piece], first[piece])
        return around.folded()

    def cells_of(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Number of the cell that each of the points (n, 3) [m] lies in, and whether it is one of the grid."""
        index = np.floor((points - np.array(self.low)) / self.cell).astype(np.int64)
        inside = ((index >= 0) & (index < self.counts)).all(axis=1)
        return index @ np.array([1, self.counts[0], self.counts[0] * self.counts[1]]), inside

    def mesh(self, arrays: dict[str, np.ndarray]) -> meshio.Mesh:
        """Hexahedra with arrays (cells,) or (cells, k) on them."""
        nx, ny, nz = self.counts
        axes = [np.linspace(low, high, n + 1) for low, high, n in zip(self.low, self.high, self.counts, strict=True)]
        z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
        points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
        k, j, i = (part.ravel() for part in np.meshgrid(*(np.arange(n) for n in (nz, ny, nx)), indexing="ij"))
        corners = [(i + a) + (nx + 1) * ((j + b) + (ny + 1) * (k + c)) for a, b, c in CORNERS]
        return mesh_of_cells("hexahedron", points, np.stack(corners, axis=1), arrays)


def grid_in(domain: Domain, asked: CellGrid) -> Grid:
    """The grid that a scene asks for in its domain."""
    box = asked.region or domain
    x, y, z = (axis in domain.periodic for axis in AXES)
    return Grid(box.min, box.max, asked.counts_in(domain), (x, y, z))


class _Padded:
    """The cells of a grid and as many around them as kernels reach: (z, y, x, k).

    Points whose kernels begin in the same cells along y and z, and in the same block of cells along x, are added with
    one product of matrices.
    """

    def __init__(self, grid: Grid, reached: np.ndarray, width: int) -> None:
        self.grid, self.reached, self.width = grid, reached, width
        self.window = reached + np.array([BLOCK - 1, 0, 0])
        self.total = np.zeros((*(reached + grid.counts + self.window)[::-1], width))

    def add(self, kernel: Kernel, points: np.ndarray, values: np.ndarray, first: np.ndarray) -> None:
        """Add points, given the `first` cell (n, 3) that each one reaches."""
        base = first + self.reached
        base[:, 0] -= base[:, 0] % BLOCK
        order = np.lexsort(base.T)
        base, points, values = base[order], points[order], values[order]
        x, y, z = (self._shares(kernel, points[:, axis], base[:, axis], axis) for axis in range(3))
        most = max(LARGEST_PRODUCT // (y.shape[1] * x.shape[1] * self.width), 1)
        changes = (np.diff(base, axis=0) != 0).any(axis=1)
        starts = np.flatnonzero(np.append(True, changes) | (np.arange(len(base)) % most == 0))
        for begin, end in zip(starts, [*starts[1:], len(base)], strict=True):
            along = (x[begin:end, :, None] * values[begin:end, None, :]).reshape(end - begin, -1)
            i, j, k = base[begin]
            for layer, weight in enumerate(z[begin:end].T):
                there = self.total[k + layer, j : j + y.shape[1], i : i + x.shape[1]]
                there += ((weight[:, None] * y[begin:end]).T @ along).reshape(there.shape)

    def _shares(self, kernel: Kernel, place: np.ndarray, base: np.ndarray, axis: int) -> np.ndarray:
        """Share of each point along one axis in the cells of its window, (n, cells)."""
        edges = base[:, None] - self.reached[axis] + np.arange(self.window[axis] + 1)
        return np.diff(kernel.share_below(self.grid.low[axis] + self.grid.cell[axis] * edges - place[:, None]), axis=1)

    def folded(self) -> np.ndarray:
        """The cells of the grid alone (cells, k), those around it added to them along periodic axes."""
        total = self.total
        for axis, (count, pad) in enumerate(zip(self.grid.counts[::-1], self.reached[::-1], strict=True)):
            total = np.moveaxis(total, axis, 0)
            inner = total[pad : pad + count].copy()
            if self.grid.periodic[2 - axis]:
                inner[:] = 0.0
                np.add.at(inner, (np.arange(len(total)) - pad) % count, total)
            total = np.moveaxis(inner, 0, axis)
        return np.ascontiguousarray(total).reshape(-1, self.width)
