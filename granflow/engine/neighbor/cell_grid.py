"""Cell grid over the particles, computed on the device.

Cells are numbered in blocks of 8 x 8 x 8, so that a chunk of consecutive particles is compact and few pairs connect
two chunks.
"""

from typing import Any

from granflow.engine.limits import ABORT_FAR
from granflow.engine.neighbor.cells import BLOCK_SIDE
from granflow.engine.neighbor.phases import is_count
from granflow.engine.state import State
from granflow.kernel_language import ti
from granflow.plan.capacities import BOUNDS
from granflow.plan.plan import BLOCK_CELLS

OUTLIER_SHARE = 1 / 16
"""Share of the parts of the particle list that may be outside the grid at each end; see `_build_lay_grid`."""

VOLUME_RATIO = 1 / 2
"""Ratio of cell volumes below which the grid excludes outliers."""

COARSER = 1.25
"""Factor of the cell side of a grid that would have too many cells."""

MARGIN = 1e-6
"""Relative margin of the cell side above rounding, so that a neighbor is never two cells away."""


def build_lay_grids(state: State) -> Any:
    """Device function (count): the grid for sorting; if particle sizes differ widely, one per size class.

    The cells are at least as wide as the largest diameter of the class plus two of the largest reaches and the range of
    the forces. Aborts if an expanding domain has become too large for the precision.

    Reads:   radius of the size classes; low, high, reach of the cell sort (see `bounds_phases`)
    Writes:  grid_low, cell_side, cells, cell_count, first_cell, reach_largest, abort
    """
    sorting, by_class = state.cell_sort, state.cell_sort.class_order is not None
    lay_grid, expands = _build_lay_grid(state), state.plan.domain.on_exit == "expand"
    class_count, force_range, coordinate_limit = (
        state.parameter(name) for name in ("class_count", "force_range", "coordinate_limit")
    )

    @ti.func
    def lay_grids(count):
        parts = ti.min(count, BOUNDS)
        low, high, reach = sorting.low[0], sorting.high[0], sorting.reach[0]
        part = 0
        while (part < parts) & is_count(reach):
            low, high = ti.min(low, sorting.low[part]), ti.max(high, sorting.high[part])
            reach = ti.max(reach, sorting.reach[part])
            part += 1
        sorting.reach_largest[0] = reach
        if ti.static(expands):
            if ti.max(-low.min(), high.max()) > coordinate_limit():
                ti.atomic_max(state.control.abort[0], ABORT_FAR)
        first_cell = 0
        for grid in range(class_count()):
            if ti.static(by_class):
                sorting.first_cell[grid] = first_cell
            side = (2.0 * sorting.radius[grid] + 2.0 * reach + force_range()) * (1.0 + MARGIN)
            lay_grid(grid, parts, low, high, side)
            first_cell += sorting.cell_count[grid]
        sorting.cell_count[class_count()] = first_cell

    return lay_grids


def _build_lay_grid(state: State) -> Any:
    """Device function (grid, parts, low, high, side): write one grid over all particles.

    low, high:  corners [m] of their bounding box
    side:       smallest cell side [m]

    If a few outliers make the cells much larger than requested, the grid excludes them; an outlier is then assigned to
    the nearest cell at the edge of the grid.

    Reads:   low, high of the cell sort
    Writes:  grid_low, cell_side, cells, cell_count
    """
    sorting, axes = state.cell_sort, state.plan.periodic_box.axes
    grid_over, within = build_grid_over(state), _build_within(state)
    other_axes, cell_capacity = [axis for axis in range(3) if axis not in axes], state.parameter("cell_capacity")

    @ti.func
    def lay_grid(grid, parts, low, high, side):
        limit = cell_capacity() >> grid
        box_low, box_high, is_coarse = low, high, True
        found_low, sides, cells = low, high - low, ti.Vector([0, 0, 0])
        attempt = 0
        while is_coarse & (attempt < 2):  # one call of `grid_over`, which is compiled once
            if attempt == 1:
                box_low, box_high = within(parts, low, high)
            finer_low, finer_sides, finer_cells = grid_over(box_low, box_high, side, limit)
            finer_volume, volume = finer_sides[0] * finer_sides[1] * finer_sides[2], sides[0] * sides[1] * sides[2]
            if (attempt == 0) | (finer_volume < VOLUME_RATIO * volume):
                found_low, sides, cells = finer_low, finer_sides, finer_cells
            is_coarse, attempt = False, attempt + 1
            for axis in ti.static(other_axes):
                is_coarse = is_coarse | (sides[axis] > side)
        sorting.grid_low[grid], sorting.cell_side[grid], sorting.cells[grid] = found_low, sides, cells
        blocks = (cells + BLOCK_SIDE - 1) // BLOCK_SIDE
        sorting.cell_count[grid] = blocks[0] * blocks[1] * blocks[2] * BLOCK_CELLS

    return lay_grid


def _build_within(state: State) -> Any:
    """Device function (parts, low, high): corners [m] of the box without OUTLIER_SHARE of the parts at each end.

    A bisection along each axis: the corner between which and `low` at most that share of the parts begin, ...

    Reads:  low, high of the cell sort
    """
    sorting, bisections = state.cell_sort, 30

    @ti.func
    def within(parts, low, high):
        outliers = ti.cast(OUTLIER_SHARE * ti.cast(parts, ti.f32), ti.i32)
        begin, end = low, high  # at most `outliers` parts are below `begin`
        first, last = low, high  # at most `outliers` parts are above `last`
        below, above, bisection = ti.Vector([0, 0, 0]), ti.Vector([0, 0, 0]), 0
        while (bisection < bisections) & is_count(below[0]):
            bisection += 1
            middle_low, middle_high = 0.5 * (begin + end), 0.5 * (first + last)
            below, above = ti.Vector([0, 0, 0]), ti.Vector([0, 0, 0])
            part = 0
            while (part < parts) & ((below.min() <= outliers) | (above.min() <= outliers)):
                below += ti.cast(sorting.low[part] < middle_low, ti.i32)
                above += ti.cast(sorting.high[part] > middle_high, ti.i32)
                part += 1
            few_below, few_above = below <= outliers, above <= outliers
            begin, end = ti.select(few_below, middle_low, begin), ti.select(few_below, end, middle_low)
            first, last = ti.select(few_above, first, middle_high), ti.select(few_above, middle_high, last)
        return begin, last

    return within


def build_grid_over(state: State) -> Any:
    """Device function (low, high, side, cell limit): low corner [m], cell sides [m] and cells along each axis.

    The smallest grid of cells at least `side` wide over a box clipped to the domain, unless the domain expands,
    coarsened to at most the limit of cells, exceeded only by a grid of one block. Along periodic axes the cells fill
    the domain exactly; along the other axes they are `side` wide, in whole blocks.
    """
    real, domain_low, domain_high = (
        state.backend.position_real,
        state.parameter("domain_low"),
        state.parameter("domain_high"),
    )
    axes, expands = state.plan.periodic_box.axes, state.plan.domain.on_exit == "expand"

    @ti.func
    def grid_over(low, high, side_requested, limit):
        box_low, box_high, side, lows, highs = low, high, side_requested, domain_low(), domain_high()
        for axis in ti.static(range(3)):
            if ti.static(axis in axes):
                box_low[axis], box_high[axis] = lows[axis], highs[axis]
            elif ti.static(not expands):
                box_low[axis] = ti.max(low[axis], lows[axis])
                box_high[axis] = ti.min(high[axis], highs[axis])
        size = ti.max(box_high - box_low, 0.0)
        cells, sides, fits = size, size, False
        while not fits:
            for axis in ti.static(range(3)):
                cells[axis] = BLOCK_SIDE * ti.max(ti.ceil(size[axis] / (side * BLOCK_SIDE) + 1e-9), 1.0)
                sides[axis] = side
                if ti.static(axis in axes):
                    cells[axis] = ti.max(ti.floor(size[axis] / side), 1.0)
                    sides[axis] = size[axis] / cells[axis]
            blocks = ti.ceil(cells / BLOCK_SIDE)
            block_count = blocks[0] * blocks[1] * blocks[2]
            # The negation is also true for NaN.
            fits = not (block_count * BLOCK_CELLS > ti.cast(limit, real) and block_count > 1.0)
            side *= COARSER
        return box_low, sides, ti.cast(cells, ti.i32)

    return grid_over
