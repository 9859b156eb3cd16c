"""Cells of the grids on the device: cell of a point, and the cells that can contain neighbors.

`sorting` is `State.cell_sort`; cell coordinates are 3-vectors of integers, from 0.
"""

from granflow.kernel_language import ti
from granflow.plan.plan import BLOCK_CELLS

BLOCK_SIDE = 8
"""Number of cells along each edge of a block."""

ROUNDING = 1e-5
"""Relative margin of the cell range within a radius, because cell coordinates are rounded."""


@ti.func
def cell_number(cell, cells):
    """Number of a cell in a grid of `cells` cells along each axis, in block order.

    Blocks are numbered with x fastest, and so are the cells within a block.
    """
    blocks_x, blocks_y = (cells[0] + BLOCK_SIDE - 1) // BLOCK_SIDE, (cells[1] + BLOCK_SIDE - 1) // BLOCK_SIDE
    block = ((cell[2] // BLOCK_SIDE) * blocks_y + cell[1] // BLOCK_SIDE) * blocks_x + cell[0] // BLOCK_SIDE
    inside = ((cell[2] % BLOCK_SIDE) * BLOCK_SIDE + cell[1] % BLOCK_SIDE) * BLOCK_SIDE + cell[0] % BLOCK_SIDE
    return block * BLOCK_CELLS + inside


@ti.func
def cell_of_point(sorting: ti.template(), grid, point):
    """Cell of a grid that contains the point [m], or the nearest cell of the grid.

    Reads:  grid_low, cell_side, cells
    """
    cell_position = (point - sorting.grid_low[grid]) / sorting.cell_side[grid]
    last = ti.cast(sorting.cells[grid], sorting.cell_side.dtype) - 1.0
    # Clamped before the conversion, which is undefined for a coordinate far outside the grid.
    return ti.cast(ti.max(ti.min(cell_position, last), 0.0), ti.i32)


@ti.func
def adjacent_cells(periodic: ti.template(), cell, cells):
    """Begin and end of the ranges of cells adjacent to a cell, which may extend beyond the grid along periodic axes.

    periodic:  axes along which the first and the last cell are adjacent; with fewer than three cells, all are
    """
    first, end = cell - 1, cell + 2
    for axis in ti.static(range(3)):
        if ti.static(axis in periodic):
            if cells[axis] < 3:
                first[axis], end[axis] = 0, cells[axis]
        else:
            first[axis], end[axis] = ti.max(first[axis], 0), ti.min(end[axis], cells[axis])
    return first, end


@ti.func
def cells_within(sorting: ti.template(), periodic: ti.template(), gradient: ti.template(), grid, point, reach):
    """Begin and end of the ranges of cells of a grid that a sphere intersects.

    periodic:  axes that are periodic without shear
    gradient:  axis of the gradient of a sheared box, or -1
    reach:     radius of the sphere [m], enlarged by ROUNDING

    Along a periodic axis the range may extend beyond the grid, but contains no cell twice. Images along a sheared
    gradient are searched separately, and the range ends at the grid.

    Reads:  grid_low, cell_side, cells
    """
    middle = (point - sorting.grid_low[grid]) / sorting.cell_side[grid]
    reach_in_cells = ti.static(1.0 + ROUNDING) * reach / sorting.cell_side[grid]
    last = ti.cast(sorting.cells[grid], sorting.cell_side.dtype) - 1.0
    lowest, highest = ti.floor(middle - reach_in_cells), ti.floor(middle + reach_in_cells)
    for axis in ti.static(range(3)):
        if ti.static(axis in periodic):
            if highest[axis] - lowest[axis] >= last[axis]:
                lowest[axis], highest[axis] = 0.0, last[axis]
        elif ti.static(axis == gradient):
            lowest[axis], highest[axis] = ti.max(lowest[axis], 0.0), ti.min(highest[axis], last[axis])
        else:
            lowest[axis] = ti.max(ti.min(lowest[axis], last[axis]), 0.0)
            highest[axis] = ti.max(ti.min(highest[axis], last[axis]), 0.0)
    return ti.cast(lowest, ti.i32), ti.cast(highest, ti.i32) + 1


@ti.func
def wrapped_cell(periodic: ti.template(), cell, cells):
    """The cell of coordinates outside the grid, along the periodic axes."""
    wrapped = cell
    for axis in ti.static(range(3)):
        if ti.static(axis in periodic):
            wrapped[axis] = (cell[axis] + cells[axis]) % cells[axis]
    return wrapped
