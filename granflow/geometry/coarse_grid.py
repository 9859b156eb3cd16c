"""A box of equal cells, and the Gaussian kernel that distributes points to them.

Coarse-grained fields use both; metrics of two components use the cells only.
"""

from dataclasses import dataclass
from functools import cache, cached_property
from math import erf, sqrt

import numpy as np

from granflow.fields import FIELD_QUANTITIES, units
from granflow.io.vtu import VtuMesh

# Kernel: a truncated and normalized Gaussian along each axis

NODES = 2**14
"""Nodes in the table of the distribution function; linear interpolation has an error of 1e-8."""


class GaussianKernel:
    """The weight of a point at r [1/m3]: W(r) = g(x) g(y) g(z), which integrates to 1.

        g(s) = exp(-s^2 / 2 w^2) / (sqrt(2 pi) w erf(c / sqrt(2)))      |s| < c w, else 0

    `width`: w [m]; `cutoff`: c, in widths; `reach`: c w [m], half the edge of the cube outside which W is 0.
    Within the cutoff, W depends only on the distance, since the product of the three Gaussians does.
    """

    def __init__(self, width: float, cutoff: float) -> None:
        self.width = width
        self.cutoff = cutoff
        self.reach = cutoff * width
        self._table = _distribution(cutoff)

    def cumulative(self, distance: np.ndarray) -> np.ndarray:
        """The integral of g from minus infinity to `distance` [m], an array of any shape; from 0 to 1.

        A cell gets the share cumulative(upper edge) - cumulative(lower edge) along each axis.
        """
        nodes, shares = self._table
        return np.interp(distance / self.width, nodes, shares)


@cache
def _distribution(cutoff: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes from -cutoff to cutoff, in widths, and the integral of the kernel up to each, from 0 to 1."""
    nodes = np.linspace(-cutoff, cutoff, NODES)
    full = erf(cutoff / sqrt(2.0))
    return nodes, np.array([0.5 + 0.5 * erf(node / sqrt(2.0)) / full for node in nodes])


# Grid: a box of equal cells to which points are distributed with a kernel

CHUNK_POINTS = 2**17
"""Points processed at a time, which limits the temporary memory."""
LARGEST_PRODUCT = 2**18
"""Largest number of multiplications in a matrix product: above it, OpenBLAS starts threads that compete for
cores."""
BLOCK = 16
"""Cells along x whose points are processed in one matrix product."""
CORNERS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
"""Corners of a hexahedron in the order of VTK."""


@dataclass(frozen=True)
class CoarseGrid:
    """A box from `low` to `high` (3,) [m] with `counts` cells along x, y and z.

    Cell (i, j, k) has the index i + nx (j + ny k): x fastest, as in VTK. Along a `periodic` axis the box is
    one period.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    counts: tuple[int, int, int]
    periodic: tuple[bool, bool, bool] = (False, False, False)

    @cached_property
    def cell_size(self) -> np.ndarray:
        """Edge lengths of a cell (3,) [m]."""
        return (np.array(self.high) - self.low) / self.counts

    @property
    def cell_volume(self) -> float:
        """Volume of a cell [m3]."""
        return float(np.prod(self.cell_size))

    @property
    def cell_count(self) -> int:
        """Number of cells."""
        return int(np.prod(self.counts))

    def centers(self) -> np.ndarray:
        """The centers of all cells (cells, 3) [m], in the order of the cell indices."""
        x, y, z = (
            low + (np.arange(n) + 0.5) * h
            for low, n, h in zip(self.low, self.counts, self.cell_size, strict=True)
        )
        grid = np.meshgrid(z, y, x, indexing="ij")
        return np.stack([axis.ravel() for axis in grid[::-1]], axis=1)

    def deposit(self, kernel: GaussianKernel, points: np.ndarray, values: np.ndarray) -> np.ndarray:
        """The integrals (cells, k) over each cell of the values (n, k) distributed around points (n, 3) [m].

        Contributions outside the grid are omitted, or wrap around along periodic axes. The integrals are
        exact: if the grid contains the whole support of the kernels, the sum over the cells is the sum of the
        values. Division by `cell_volume` gives densities [1/m3]. The memory is bounded: CHUNK_POINTS points
        are processed at a time.
        """
        low = np.array(self.low)
        width = np.array(self.high) - self.low
        points = np.where(self.periodic, low + np.mod(points - low, width), points)
        first = np.floor((points - kernel.reach - self.low) / self.cell_size).astype(np.int64)
        reached_cells = np.ceil(2.0 * kernel.reach / self.cell_size).astype(np.int64) + 1
        near = np.flatnonzero(((first + reached_cells > 0) & (first < self.counts)).all(axis=1))
        padded_grid = _Padded(self, reached_cells, values.shape[1])
        for begin in range(0, len(near), CHUNK_POINTS):
            piece = near[begin : begin + CHUNK_POINTS]
            padded_grid.add(kernel, points[piece], values[piece], first[piece])
        return padded_grid.fold()

    def cells_of(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The cell index (n,) of points (n, 3) [m], and whether each point is inside the grid (n,).

        The index of a point outside the grid is meaningless. Points are not wrapped along periodic axes.
        """
        index = np.floor((points - np.array(self.low)) / self.cell_size).astype(np.int64)
        inside = ((index >= 0) & (index < self.counts)).all(axis=1)
        return index @ np.array([1, self.counts[0], self.counts[0] * self.counts[1]]), inside

    def mesh(self, arrays: dict[str, np.ndarray]) -> VtuMesh:
        """Return a mesh of hexahedra with cell arrays (cells,) or (cells, k), in the order of the cell
        indices."""
        nx, ny, nz = self.counts
        axes = [
            np.linspace(low, high, n + 1)
            for low, high, n in zip(self.low, self.high, self.counts, strict=True)
        ]
        z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
        points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
        k, j, i = (part.ravel() for part in np.meshgrid(*(np.arange(n) for n in (nz, ny, nx)), indexing="ij"))
        corners = [(i + a) + (nx + 1) * ((j + b) + (ny + 1) * (k + c)) for a, b, c in CORNERS]
        return VtuMesh.of_cells(
            "hexahedron", points, np.stack(corners, axis=1), arrays, units(FIELD_QUANTITIES)
        )


class _Padded:
    """The cells of a grid with a margin as wide as the kernels: array (z, y, x, k).

    Points whose kernels begin in the same cells along y and z, and in the same block of cells along x, are
    added with one matrix product.
    """

    def __init__(self, grid: CoarseGrid, reached_cells: np.ndarray, width: int) -> None:
        self.grid = grid
        self.reached_cells = reached_cells
        self.width = width
        self.window = reached_cells + np.array([BLOCK - 1, 0, 0])
        self.total = np.zeros((*(reached_cells + grid.counts + self.window)[::-1], width))

    def add(self, kernel: GaussianKernel, points: np.ndarray, values: np.ndarray, first: np.ndarray) -> None:
        """Add points (n, 3) [m] with values (n, k); `first` (n, 3): first cell within the kernel of each
        point."""
        base = first + self.reached_cells
        base[:, 0] -= base[:, 0] % BLOCK
        order = np.lexsort(base.T)
        base = base[order]
        points = points[order]
        values = values[order]
        x, y, z = (self._shares(kernel, points[:, axis], base[:, axis], axis) for axis in range(3))
        max_points = max(LARGEST_PRODUCT // (y.shape[1] * x.shape[1] * self.width), 1)
        changes = (np.diff(base, axis=0) != 0).any(axis=1)
        starts = np.flatnonzero(np.append(True, changes) | (np.arange(len(base)) % max_points == 0))
        for begin, end in zip(starts, [*starts[1:], len(base)], strict=True):
            along = (x[begin:end, :, None] * values[begin:end, None, :]).reshape(end - begin, -1)
            i, j, k = base[begin]
            for layer, weight in enumerate(z[begin:end].T):
                target = self.total[k + layer, j : j + y.shape[1], i : i + x.shape[1]]
                target += ((weight[:, None] * y[begin:end]).T @ along).reshape(target.shape)

    def _shares(
        self, kernel: GaussianKernel, position: np.ndarray, base: np.ndarray, axis: int
    ) -> np.ndarray:
        """The share (n, cells) of each point in the cells of its window along one axis."""
        edges = base[:, None] - self.reached_cells[axis] + np.arange(self.window[axis] + 1)
        distance = self.grid.low[axis] + self.grid.cell_size[axis] * edges - position[:, None]
        return np.diff(kernel.cumulative(distance), axis=1)

    def fold(self) -> np.ndarray:
        """The cells of the grid (cells, k); along periodic axes, the margin is added to them.

        Along other axes, the margin is dropped.
        """
        total = self.total
        for axis in range(3):  # z, y, x
            count = self.grid.counts[2 - axis]
            pad = self.reached_cells[2 - axis]
            total = np.moveaxis(total, axis, 0)
            inner = total[pad : pad + count].copy()
            if self.grid.periodic[2 - axis]:
                inner[:] = 0.0
                np.add.at(inner, (np.arange(len(total)) - pad) % count, total)
            total = np.moveaxis(inner, 0, axis)
        return np.ascontiguousarray(total).reshape(-1, self.width)
