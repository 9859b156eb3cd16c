"""Cell grid over the particles.

Cells are numbered in blocks of 8 x 8 x 8, so that a chunk of consecutive particles is compact and few pairs connect
two chunks.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from granflow.engine.state import State
from granflow.plan.capacities import BOUNDS
from granflow.plan.plan import BLOCK_CELLS

BLOCK_SIDE = 8
"""Number of cells along each edge of a block."""

OUTLIER_SHARE = 1 / 16
"""Share of the parts of the particle list that may be outside the grid at each end; see `_grid_for_particles`."""

VOLUME_RATIO = 1 / 2
"""Ratio of cell volumes below which the grid excludes outliers."""


@dataclass(frozen=True)
class CellGrid:
    """Grid of cells over a box; cell numbers are assigned in whole blocks.

    low:    (3,) [m], low corner
    side:   (3,) [m], cell sides
    cells:  number of cells along each axis
    """

    low: np.ndarray
    side: np.ndarray
    cells: tuple[int, int, int]

    @property
    def blocks(self) -> tuple[int, ...]:
        """Number of blocks along each axis."""
        return tuple(-(-cells // BLOCK_SIDE) for cells in self.cells)

    @property
    def cell_count(self) -> int:
        """Number of cells in all blocks."""
        return int(np.prod(self.blocks, dtype=np.int64)) * BLOCK_CELLS

    @classmethod
    def over(
        cls, low: np.ndarray, high: np.ndarray, side: float, cell_limit: int, periodic: Sequence[int] = ()
    ) -> "CellGrid":
        """Smallest grid of cells at least `side` wide over a box, coarsened to at most `cell_limit` cells.

        low, high:   (3,) [m], corners of the box
        side:        smallest cell side [m]; a limit on the cells increases it in steps of 25 %
        cell_limit:  maximum number of cells, exceeded only by a grid of one block
        periodic:    axes along which the cells fill the box exactly

        Along the other axes the cells are `side` wide, in whole blocks.
        """
        is_periodic = np.isin(np.arange(3), periodic)
        while True:
            blocks = np.maximum(np.ceil((high - low) / (side * BLOCK_SIDE) + 1e-9), 1.0)
            cells = np.where(is_periodic, np.maximum(np.floor((high - low) / side), 1.0), BLOCK_SIDE * blocks)
            sides = np.where(is_periodic, (high - low) / cells, side)
            blocks = np.ceil(cells / BLOCK_SIDE)
            if np.prod(blocks) * BLOCK_CELLS <= cell_limit or np.all(blocks == 1.0):
                return cls(low, sides, (int(cells[0]), int(cells[1]), int(cells[2])))
            side *= 1.25


def update_cell_grids(state: State, reach: float) -> list[CellGrid]:
    """Write the grid for sorting. If particle sizes differ widely, write one per size class; the first is for sorting.

    reach:    largest reach [m] of a particle
    Returns:  grids by size class; the cells are at least as wide as the largest diameter of the class plus two reaches

    Reads:   low, high (see `build_bounds`)
    Writes:  grid_low, cell_side, cells, first_cell, radius
    """
    plan, sorting = state.plan, state.cell_sort
    lows, highs = (
        np.sort(field.to_numpy()[: min(state.count, BOUNDS)].astype(float), axis=0)
        for field in (sorting.low, sorting.high)
    )
    grids: list[CellGrid] = []
    for class_index, radius in enumerate(plan.size_classes):
        # The margin is above rounding, so that a neighbor is never two cells away.
        side, limit = (2.0 * radius + 2.0 * reach) * (1.0 + 1e-6), sorting.cell_capacity >> class_index
        grid = _grid_for_particles(state, lows, highs, side, limit)
        if sorting.class_order is not None:
            sorting.radius[class_index], sorting.first_cell[class_index] = (
                radius,
                sum(each.cell_count for each in grids),
            )
        sorting.grid_low[class_index], sorting.cell_side[class_index] = list(grid.low), list(grid.side)
        sorting.cells[class_index] = list(grid.cells)
        grids.append(grid)
    return grids


def _grid_for_particles(state: State, lows: np.ndarray, highs: np.ndarray, side: float, limit: int) -> CellGrid:
    """A grid over all particles.

    lows, highs:  (parts, 3) [m], sorted corners of the bounding boxes of the parts of the particle list
    side:         smallest cell side [m]
    limit:        maximum number of cells

    If a few outliers make the cells much larger than requested, the grid excludes them; an outlier is then assigned to
    the nearest cell at the edge of the grid.
    """
    grid = _grid_over(state, lows[0], highs[-1], side, limit)
    if np.any(np.delete(grid.side, state.plan.periodic_box.axes) > side):
        outliers = int(OUTLIER_SHARE * len(lows))
        finer = _grid_over(state, lows[outliers], highs[-1 - outliers], side, limit)
        grid = finer if np.prod(finer.side) < VOLUME_RATIO * np.prod(grid.side) else grid
    return grid


def _grid_over(state: State, low: np.ndarray, high: np.ndarray, side: float, limit: int) -> CellGrid:
    """The grid over a box clipped to the domain, unless the domain expands; the whole domain along periodic axes."""
    plan, periodic_axes = state.plan, list(state.plan.periodic_box.axes)
    if plan.domain.on_exit != "expand":
        low, high = np.maximum(low, plan.domain_low), np.minimum(high, plan.domain_high)
    low, high = low.copy(), np.maximum(high, low)
    low[periodic_axes], high[periodic_axes] = plan.domain_low[periodic_axes], plan.domain_high[periodic_axes]
    return CellGrid.over(low, high, side, limit, periodic_axes)
