"""Deletion and order of the particles at a neighbor-list rebuild: the grid of cells, and a counting sort.

A particle is deleted if it is outside the domain or in an outlet, or if a program has marked it. The sort
puts the deleted particles behind the others, and the host lowers the particle count.

`bounds_phases` finds the box around all particles and lays the grid over it, `sort_phases` orders the
particles by cell. Cells are numbered in blocks of 8 x 8 x 8, so that a chunk of consecutive particles is
compact and few pairs connect two chunks. If particle sizes differ widely, `class_phases` orders the sorted
particles once more, by size class and the cell of a grid of the class.

In device functions, `sorting` is `State.cell_sort`; cell coordinates are 3-vectors of integers, from 0.
"""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np

from granflow.engine.codes import ABORT_FAR, REMOVED_BELOW
from granflow.engine.neighbor.phases import (
    Phase,
    all_particles,
    granularity,
    is_count,
    part_range,
    task_count,
)
from granflow.engine.state import State
from granflow.kernel_language import ti
from granflow.plan.capacities import BOUNDS, SCAN_BLOCK, SUBPARTS
from granflow.plan.plan import BLOCK_CELLS


def build_remains(state: State) -> Any:
    """Device function (i): true if particle i is in the domain, not in an outlet, and not removed from
    Python.

    The spheres of a clump remain if its center of mass does.

    Reads:  position, radius, fixed, clump, clump_position
    """
    particles = state.particles
    fixed_particles = state.plan.features.fixed_particles
    remains_at = _build_remains_at(state)
    clumps = state.plan.features.clumps

    @ti.func
    def remains(i):
        fixed = 0
        if ti.static(fixed_particles):
            fixed = particles.fixed[i]
        return remains_at(particles.position[i], particles.radius[i], fixed)

    @ti.func
    def clump_remains(i):
        found = remains(i)
        if particles.clump[i] >= 0:
            found = remains_at(particles.clump_position[i], particles.radius[i], 0)
        return found

    return clump_remains if clumps else remains


def remaining(state: State, arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Which of n particles on the host remain (n,), as `build_remains` decides.

    arrays:  position (n, 3), radius (n,) and, with fixed particles, fixed (n,), in the types of the fields
    """
    count = len(arrays["radius"])
    found = np.zeros(count, np.int32)
    if count:
        position = np.ascontiguousarray(arrays["position"])
        radius = np.ascontiguousarray(arrays["radius"])
        fixed = np.ascontiguousarray(arrays.get("fixed", np.zeros(count, np.int32)))
        state.built(_build_remaining)(position, radius, fixed, found)
    return found.astype(bool)


def _build_remaining(state: State) -> Any:
    """Kernel (position, radius, fixed, found): the result of `remaining`."""
    remains_at = _build_remains_at(state)
    real = state.backend.position_real
    external: Any = ti.types.ndarray()

    @ti.kernel
    def remaining_particles(position: external, radius: external, fixed: external, found: external):
        for i in range(found.shape[0]):
            p = ti.Vector([position[i, 0], position[i, 1], position[i, 2]], dt=real)
            found[i] = ti.cast(remains_at(p, radius[i], fixed[i]), ti.i32)

    return remaining_particles


def _build_remains_at(state: State) -> Any:
    """Device function (position, radius, fixed): true if such a particle remains.

    Along periodic axes, and in an expanding domain, only the outlets delete. A position that is NaN is
    outside; an outlet does not delete fixed particles. `host.remove_particles` marks particles by a
    negative radius.
    """
    in_one_outlet = []
    for index, outlet in enumerate(state.plan.scene.outlets.values()):
        readers = {name: state.parameter(f"outlet.{index}.{name}") for name in outlet.numbers()}
        in_one_outlet.append(outlet.build_contains(SimpleNamespace(**readers)))
    low = state.parameter("domain_low")
    high = state.parameter("domain_high")
    unchecked_axes = range(3) if state.plan.scene.domain.on_exit == "expand" else state.plan.periodic_box.axes

    @ti.func
    def in_outlet(p):
        out = False
        for d in ti.static(range(len(in_one_outlet))):
            out = out or in_one_outlet[d](p)
        return out

    @ti.func
    def remains_at(p, radius, fixed):
        inside = radius > REMOVED_BELOW
        lows = low()
        highs = high()
        for axis in ti.static(range(3)):
            if ti.static(axis in unchecked_axes):
                inside = inside & (p[axis] == p[axis])  # false for NaN
            else:
                inside = inside & (p[axis] >= lows[axis]) & (p[axis] <= highs[axis])
        if ti.static(state.plan.features.outlets):
            inside = inside and not (in_outlet(p) and fixed == 0)
        return inside

    return remains_at


def find_farthest(state: State) -> None:
    """Set the particle of an abort because of a coordinate above `plan.coordinate_limit` [m].

    Reads:   position, id
    Writes:  abort_particle
    """
    position = np.nan_to_num(np.abs(state.particles.position.to_numpy()[: state.count]), nan=0.0)
    state.control.abort_particle[0] = int(state.particles.id[int(position.max(axis=1).argmax())])


# Reach and bounding box of the particles

KEPT_REACH = -1.0
"""Time of the reach for which the particles keep the reach that they have."""


def bounds_phases(state: State) -> list[Phase]:
    """Reach of all particles, bounds of BOUNDS parts of the particle list, and the grids.

        reach = min(skin / 2 + |v| time, reach_max)

    A part holds consecutive particles; its bounds are those of the positions, and the largest reach. A fast
    particle looks further, so that it does not make the rebuilds of all others more frequent. With the time
    KEPT_REACH, the reach is that of an earlier rebuild. On a GPU, SUBPARTS threads first share a part.

    Reads:   position, velocity, reach
    Writes:  reach of the particles; low, high, reach of the cell sort and of the subparts; the grids
    """
    sorting = state.cell_sort
    lay_grids = build_lay_grids(state)
    bounds_of = _build_bounds_of(state)

    @ti.func
    def bounds(task: ti.template(), rebuild: ti.template()):
        low, high, reach = bounds_of(task.begin, task.begin, task.end, rebuild)
        sorting.low[task.index] = low
        sorting.high[task.index] = high
        sorting.reach[task.index] = reach

    @ti.func
    def lay(rebuild: ti.template()):
        lay_grids(rebuild.count)

    if state.backend.on_cpu or sorting.subpart_low is None:
        return [Phase(bounds, BOUNDS, serial=lay)]
    subpart_count, subpart_bounds, joined = _build_subparts(state, bounds_of)
    return [
        Phase(subpart_bounds, BOUNDS * SUBPARTS, subpart_count, per_task=1),
        Phase(joined, BOUNDS, serial=lay),
    ]


def _build_bounds_of(state: State) -> Any:
    """Device function (first, begin, end, rebuild): low and high corner [m] and largest reach [m] of begin to
    end.

    first:  a particle within the bounds, which counts also if the range is empty

    Writes:  reach of the particles
    """
    particles = state.particles
    reach_max = state.parameter("reach_max")
    real = state.backend.position_real
    position = particles.position

    @ti.func
    def bounds_of(first, begin, end, rebuild: ti.template()):
        smallest = position[first]
        largest = position[first]
        reach_largest = 0.5 * rebuild.skin
        limit = reach_max()
        i = begin
        while (i < end) & is_count(reach_largest):
            smallest = ti.min(smallest, position[i])
            largest = ti.max(largest, position[i])
            speed = ti.cast(particles.velocity[i].norm(), real)
            reach = ti.min(0.5 * rebuild.skin + speed * rebuild.reach_time, limit)
            if rebuild.reach_time < 0.0:
                reach = particles.reach[i]
            particles.reach[i] = reach
            reach_largest = ti.max(reach_largest, reach)
            i += 1
        return smallest, largest, reach_largest

    return bounds_of


def _build_subparts(state: State, bounds_of: Any) -> tuple[Any, Any, Any]:
    """Device functions: number of subparts; bounds of a subpart; bounds of a part from those of its
    subparts."""
    sorting = state.cell_sort

    @ti.func
    def subpart_count(rebuild: ti.template()):
        return ti.min(rebuild.count, BOUNDS) * SUBPARTS

    @ti.func
    def subpart_bounds(task: ti.template(), rebuild: ti.template()):
        subpart = task.index
        first, end = part_range(subpart // SUBPARTS, ti.min(rebuild.count, BOUNDS), rebuild.count)
        begin, last = part_range(subpart % SUBPARTS, SUBPARTS, end - first)
        low, high, reach = bounds_of(first, first + begin, first + last, rebuild)
        sorting.subpart_low[subpart] = low
        sorting.subpart_high[subpart] = high
        sorting.subpart_reach[subpart] = reach

    @ti.func
    def joined(task: ti.template(), rebuild: ti.template()):
        part = task.index
        first = task.index * SUBPARTS
        low = sorting.subpart_low[first]
        high = sorting.subpart_high[first]
        reach = sorting.subpart_reach[first]
        for subpart in range(first + 1, first + SUBPARTS):
            low = ti.min(low, sorting.subpart_low[subpart])
            high = ti.max(high, sorting.subpart_high[subpart])
            reach = ti.max(reach, sorting.subpart_reach[subpart])
        sorting.low[part] = low
        sorting.high[part] = high
        sorting.reach[part] = reach

    return subpart_count, subpart_bounds, joined


# Grids

MARGIN = 1e-6
"""Relative margin of the cell side above rounding, so that a neighbor is never two cells away."""


def build_lay_grids(state: State) -> Any:
    """Device function (count): the grid for sorting; if particle sizes differ widely, one per size class.

    The cells are at least as wide as the largest diameter of the class plus two of the largest reaches and
    the range of the forces. Aborts if an expanding domain has become too large for the precision.

    Reads:   radius of the size classes; low, high, reach of the cell sort (see `bounds_phases`)
    Writes:  grid_low, cell_side, cells, cell_count, first_cell, reach_largest, abort
    """
    sorting = state.cell_sort
    by_class = state.cell_sort.class_order is not None
    lay_grid = _build_lay_grid(state)
    expands = state.plan.scene.domain.on_exit == "expand"
    class_count = state.parameter("class_count")
    force_range = state.parameter("force_range")
    coordinate_limit = state.parameter("coordinate_limit")

    @ti.func
    def lay_grids(count):
        parts = ti.min(count, BOUNDS)
        low = sorting.low[0]
        high = sorting.high[0]
        reach = sorting.reach[0]
        part = 0
        while (part < parts) & is_count(reach):
            low = ti.min(low, sorting.low[part])
            high = ti.max(high, sorting.high[part])
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


OUTLIER_SHARE = 1 / 16
"""Share of the parts of the particle list that may be outside the grid at each end; see `_build_lay_grid`."""
VOLUME_RATIO = 1 / 2
"""Ratio of cell volumes below which the grid excludes outliers."""


def _build_lay_grid(state: State) -> Any:
    """Device function (grid, parts, low, high, side): write one grid over all particles.

    low, high:  corners [m] of their bounding box
    side:       smallest cell side [m]

    If a few outliers make the cells much larger than requested, the grid excludes them; an outlier is then
    assigned to the nearest cell at the edge of the grid.

    Reads:   low, high of the cell sort
    Writes:  grid_low, cell_side, cells, cell_count
    """
    sorting = state.cell_sort
    axes = state.plan.periodic_box.axes
    grid_over = build_grid_over(state)
    within = _build_within(state)
    other_axes = [axis for axis in range(3) if axis not in axes]
    cell_capacity = state.parameter("cell_capacity")

    @ti.func
    def lay_grid(grid, parts, low, high, side):
        limit = cell_capacity() >> grid
        box_low = low
        box_high = high
        is_coarse = True
        found_low = low
        sides = high - low
        cells = ti.Vector([0, 0, 0])
        attempt = 0
        while is_coarse & (attempt < 2):  # one call of `grid_over`, which is compiled once
            if attempt == 1:
                box_low, box_high = within(parts, low, high)
            finer_low, finer_sides, finer_cells = grid_over(box_low, box_high, side, limit)
            finer_volume = finer_sides[0] * finer_sides[1] * finer_sides[2]
            volume = sides[0] * sides[1] * sides[2]
            if (attempt == 0) | (finer_volume < VOLUME_RATIO * volume):
                found_low = finer_low
                sides = finer_sides
                cells = finer_cells
            is_coarse = False
            attempt = attempt + 1
            for axis in ti.static(other_axes):
                is_coarse = is_coarse | (sides[axis] > side)
        sorting.grid_low[grid] = found_low
        sorting.cell_side[grid] = sides
        sorting.cells[grid] = cells
        blocks = (cells + BLOCK_SIDE - 1) // BLOCK_SIDE
        sorting.cell_count[grid] = blocks[0] * blocks[1] * blocks[2] * BLOCK_CELLS

    return lay_grid


def _build_within(state: State) -> Any:
    """Device function (parts, low, high): corners [m] of the box without OUTLIER_SHARE of the parts at each
    end.

    A bisection along each axis finds the corner below which at most that share of the parts begins, and the
    one above which at most that share ends.

    Reads:  low, high of the cell sort
    """
    sorting = state.cell_sort
    bisections = 30

    @ti.func
    def within(parts, low, high):
        outliers = ti.cast(OUTLIER_SHARE * ti.cast(parts, ti.f32), ti.i32)
        begin = low  # at most `outliers` parts are below `begin`
        end = high
        first = low
        last = high  # at most `outliers` parts are above `last`
        below = ti.Vector([0, 0, 0])
        above = ti.Vector([0, 0, 0])
        bisection = 0
        while (bisection < bisections) & is_count(below[0]):
            bisection += 1
            middle_low = 0.5 * (begin + end)
            middle_high = 0.5 * (first + last)
            below = ti.Vector([0, 0, 0])
            above = ti.Vector([0, 0, 0])
            part = 0
            while (part < parts) & ((below.min() <= outliers) | (above.min() <= outliers)):
                below += ti.cast(sorting.low[part] < middle_low, ti.i32)
                above += ti.cast(sorting.high[part] > middle_high, ti.i32)
                part += 1
            few_below = below <= outliers
            few_above = above <= outliers
            begin = ti.select(few_below, middle_low, begin)
            end = ti.select(few_below, end, middle_low)
            first = ti.select(few_above, first, middle_high)
            last = ti.select(few_above, middle_high, last)
        return begin, last

    return within


COARSER = 1.25
"""Factor of the cell side of a grid that would have too many cells."""


def build_grid_over(state: State) -> Any:
    """Device function (low, high, side, cell limit): low corner [m], cell sides [m] and cells along each
    axis.

    The smallest grid of cells at least `side` wide over a box clipped to the domain, unless the domain
    expands, coarsened to at most the limit of cells, exceeded only by a grid of one block. Along periodic
    axes the cells fill the domain exactly; along the other axes they are `side` wide, in whole blocks.
    """
    real = state.backend.position_real
    domain_low = state.parameter("domain_low")
    domain_high = state.parameter("domain_high")
    axes = state.plan.periodic_box.axes
    expands = state.plan.scene.domain.on_exit == "expand"

    @ti.func
    def grid_over(low, high, side_requested, limit):
        box_low = low
        box_high = high
        side = side_requested
        lows = domain_low()
        highs = domain_high()
        for axis in ti.static(range(3)):
            if ti.static(axis in axes):
                box_low[axis] = lows[axis]
                box_high[axis] = highs[axis]
            elif ti.static(not expands):
                box_low[axis] = ti.max(low[axis], lows[axis])
                box_high[axis] = ti.min(high[axis], highs[axis])
        size = ti.max(box_high - box_low, 0.0)
        cells = size
        sides = size
        fits = False
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


# Cells: that of a point, and those that can contain neighbors

BLOCK_SIDE = 8
"""Number of cells along each edge of a block."""


@ti.func
def cell_number(cell, cells):
    """Number of a cell in a grid of `cells` cells along each axis, in block order.

    Blocks are numbered with x fastest, and so are the cells within a block.
    """
    blocks_x = (cells[0] + BLOCK_SIDE - 1) // BLOCK_SIDE
    blocks_y = (cells[1] + BLOCK_SIDE - 1) // BLOCK_SIDE
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
    """Begin and end of the ranges of cells adjacent to a cell, which may extend beyond the grid along
    periodic axes.

    periodic:  axes along which the first and the last cell are adjacent; with fewer than three cells, all are
    """
    first = cell - 1
    end = cell + 2
    for axis in ti.static(range(3)):
        if ti.static(axis in periodic):
            if cells[axis] < 3:
                first[axis] = 0
                end[axis] = cells[axis]
        else:
            first[axis] = ti.max(first[axis], 0)
            end[axis] = ti.min(end[axis], cells[axis])
    return first, end


ROUNDING = 1e-5
"""Relative margin of the cell range within a radius, because cell coordinates are rounded."""


@ti.func
def cells_within(
    sorting: ti.template(), periodic: ti.template(), gradient: ti.template(), grid, point, search_radius
):
    """Begin and end of the ranges of cells of a grid that a sphere intersects.

    periodic:       axes that are periodic without shear
    gradient:       axis of the gradient of a sheared box, or -1
    search_radius:  radius of the sphere [m], enlarged by ROUNDING

    Along a periodic axis the range may extend beyond the grid, but contains no cell twice. Images along a
    sheared gradient are searched separately, and the range ends at the grid.

    Reads:  grid_low, cell_side, cells
    """
    middle = (point - sorting.grid_low[grid]) / sorting.cell_side[grid]
    radius_in_cells = ti.static(1.0 + ROUNDING) * search_radius / sorting.cell_side[grid]
    last = ti.cast(sorting.cells[grid], sorting.cell_side.dtype) - 1.0
    lowest = ti.floor(middle - radius_in_cells)
    highest = ti.floor(middle + radius_in_cells)
    for axis in ti.static(range(3)):
        if ti.static(axis in periodic):
            if highest[axis] - lowest[axis] >= last[axis]:
                lowest[axis] = 0.0
                highest[axis] = last[axis]
        elif ti.static(axis == gradient):
            lowest[axis] = ti.max(lowest[axis], 0.0)
            highest[axis] = ti.min(highest[axis], last[axis])
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


# Counting sort, in phases; integers determine the order, so that it is the same for any number of threads


def sort_phases(state: State) -> list[Phase]:
    """Order of the particles by cell, by id within a cell; deleted particles come last, in any order.

    Reads:   position, id
    Writes:  cell_start, order, block_sum; coordination_number, as memory for the cell of each particle
    """
    particles = state.particles
    sorting = state.cell_sort
    remains = build_remains(state)

    @ti.func
    def cell_of(i, cell_count):
        cell = cell_count
        if remains(i):
            cell = cell_number(cell_of_point(sorting, 0, particles.position[i]), sorting.cells[0])
        return cell

    @ti.func
    def cells_of_all():
        return sorting.cell_count[0]

    @ti.func
    def key(i):
        return particles.id[i]

    return _counting_sort(state, cell_of, cells_of_all, all_particles, key, sorting.cell_start, sorting.order)


def class_phases(state: State) -> list[Phase]:
    """Order of the sorted particles, and of ghosts, by size class and cell of its grid.

    Within a cell the particles keep their order. Entries between the owned particles and the ghosts are
    unused.

    Reads:   position, radius, owned_count, ghost_first
    Writes:  class_start, class_order
    """
    particles = state.particles
    sorting = state.cell_sort
    has_ghosts = state.plan.has_ghosts
    class_count = state.parameter("class_count")

    @ti.func
    def class_cell(i):
        group = 0
        for smaller in range(class_count() - 1):
            group += ti.cast(particles.radius[i] > sorting.radius[smaller], ti.i32)
        cell = cell_number(cell_of_point(sorting, group, particles.position[i]), sorting.cells[group])
        return sorting.first_cell[group] + cell

    @ti.func
    def cell_of(i, cell_count):
        cell = class_cell(i)
        if ti.static(has_ghosts):
            if i >= sorting.owned_count[0] and i < sorting.ghost_first[0]:
                cell = cell_count
        return cell

    @ti.func
    def cells_of_all():
        return sorting.cell_count[class_count()]

    @ti.func
    def key(i):
        return i

    @ti.func
    def present_count(rebuild: ti.template()):
        present = rebuild.count
        if ti.static(not has_ghosts):
            present = sorting.cell_start[sorting.cell_count[0]]
        return present

    return _counting_sort(
        state, cell_of, cells_of_all, present_count, key, sorting.class_start, sorting.class_order
    )


def _counting_sort(
    state: State, cell_of: Any, cells_of_all: Any, count_of: Any, key: Any, start: Any, order: Any
) -> list[Phase]:
    """Phases that write `order` of particles by `cell_of(i, cells)`, by `key(i)` within a cell but the last.

    cell_of:       device function, 0 to `cells`
    cells_of_all:  device function, number of cells
    count_of:      device function, number of particles
    key:           device function, different for all particles
    start:         field, written; the particles of cell c are order[start[c]:start[c + 1]]
    order:         field, written

    Cell `cells` collects the deleted particles. Counts are added atomically, which is exact for integers. The
    scan makes `start` the end of each cell; each particle that is placed there decreases it by 1, so that the
    begin remains.

    Writes:  start, order, coordination_number (the cell of each particle until it is placed), block_sum
    """
    particles_per_task, cells_per_task = granularity(state)
    most_cells = start.shape[0]
    most_particles = order.shape[0]

    @ti.func
    def cells_to_order(rebuild: ti.template()):
        return cells_of_all()

    @ti.func
    def counts_of_cells(rebuild: ti.template()):
        return cells_of_all() + 2

    clear, order_cells = _build_cell_tasks(key, start, order)
    count_particles, place = _build_particle_parts(state, count_of, cell_of, cells_of_all, start, order)
    return [
        Phase(clear, most_cells, counts_of_cells, cells_per_task),
        Phase(count_particles, most_particles, count_of, particles_per_task),
        *_scan_phases(state, counts_of_cells, start),
        Phase(place, most_particles, count_of, particles_per_task),
        Phase(order_cells, most_cells, cells_to_order, cells_per_task),
    ]


def _build_cell_tasks(key: Any, start: Any, order: Any) -> tuple[Any, Any]:
    """Device functions (task, rebuild): set the counts of some cells to 0; order their particles by key."""

    @ti.func
    def clear(task: ti.template(), rebuild: ti.template()):
        for c in range(task.begin, task.end):
            start[c] = 0

    # The ranks of the atomic additions depend on the threads; ordering each cell by key removes that. The
    # cell of the deleted particles can hold many of them: the host orders these.
    @ti.func
    def order_cells(task: ti.template(), rebuild: ti.template()):
        for c in range(task.begin, task.end):
            _order_by_key(order, key, start[c], start[c + 1])

    return clear, order_cells


@ti.func
def _order_by_key(order: ti.template(), key: ti.template(), begin, end):
    """Insertion sort of order[begin:end] by key; a cell holds few particles.

    Writes:  order
    """
    for k in range(begin + 1, end):
        moving = order[k]
        rank = k
        # The index is clamped in case both sides of `and` are evaluated.
        while rank > begin and key(order[ti.max(rank - 1, 0)]) > key(moving):
            order[rank] = order[rank - 1]
            rank -= 1
        order[rank] = moving


def _build_particle_parts(
    state: State, count_of: Any, cell_of: Any, cells_of_all: Any, start: Any, order: Any
) -> tuple[Any, Any]:
    """Device functions (task, rebuild): count some particles in their cells; place them there.

    Cells are filled from their ends, so that the last particles are placed first: a cell that is nearly in
    order takes the least time to sort.
    """
    cells = state.particles.coordination_number

    @ti.func
    def count_particles(task: ti.template(), rebuild: ti.template()):
        cell = 0
        i = task.begin
        while (i < task.end) & is_count(cell):
            cell = cell_of(i, cells_of_all())
            cells[i] = cell
            ti.atomic_add(start[cell], 1)
            i += 1

    @ti.func
    def place(task: ti.template(), rebuild: ti.template()):
        last = count_of(rebuild) - 1
        cell = 0
        k = task.begin
        while (k < task.end) & is_count(cell):
            i = last - k
            cell = cells[i]
            order[ti.atomic_sub(start[cell], 1) - 1] = i
            k += 1

    return count_particles, place


def _scan_phases(state: State, counts_of_cells: Any, start: Any) -> list[Phase]:
    """Phases that replace the counts of the cells in `start` by their sums up to and including each cell.

    counts_of_cells:  device function (rebuild), number of counts
    """
    sorting = state.cell_sort
    most_blocks = state.cell_sort.block_sum.shape[0]

    @ti.func
    def sum_block(task: ti.template(), rebuild: ti.template()):
        total = 0
        c = task.begin
        while (c < task.end) & is_count(total):
            total += start[c]
            c += 1
        sorting.block_sum[task.index] = total

    @ti.func
    def sum_blocks(rebuild: ti.template()):
        total = 0
        blocks = task_count(counts_of_cells(rebuild), SCAN_BLOCK)
        block = 0
        while (block < blocks) & is_count(total):
            here = sorting.block_sum[block]
            sorting.block_sum[block] = total
            total += here
            block += 1

    @ti.func
    def scan_block(task: ti.template(), rebuild: ti.template()):
        total = sorting.block_sum[task.index]
        c = task.begin
        while (c < task.end) & is_count(total):
            total += start[c]
            start[c] = total
            c += 1

    return [
        Phase(sum_block, most_blocks, counts_of_cells, SCAN_BLOCK, sum_blocks),
        Phase(scan_block, most_blocks, counts_of_cells, SCAN_BLOCK),
    ]
