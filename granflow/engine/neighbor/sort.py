"""Deletion and order of the particles at a neighbor-list rebuild: the grid of cells, and a counting sort.

A particle is deleted if it is outside the domain or in an outlet, or if a program has marked it. The sort
puts the deleted particles behind the others, and the host lowers the particle count.

`Bounds` finds the box around all particles, `CellGrids` lays the grid over it, `SortByCell` orders the
particles by cell. Cells are numbered in blocks of 8 x 8 x 8, so that a chunk of consecutive particles is
compact and few pairs connect two chunks. If particle sizes differ widely, `SortByClass` orders the sorted
particles once more, by size class and the cell of a grid of the class.

In device functions, `sorting` is `State.cell_sort`; cell coordinates are 3-vectors of integers, from 0.
"""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np

from granflow.engine.box import DeviceBox
from granflow.engine.clumps import body_positions
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


class Remaining:
    """Which particles remain at a rebuild: those in the domain, in no outlet, and not removed from Python.

    Along periodic axes, and in an expanding domain, only the outlets delete. A position that is NaN is
    outside; an outlet does not delete fixed particles. `host.remove_particles` marks particles by a negative
    radius.

    Reads:  position, radius, fixed, clump, clump_position
    """

    def __init__(self, state: State) -> None:
        plan = state.plan
        self.particles = state.particles
        self.features = plan.features
        self.low = state.parameter("domain_low")
        self.high = state.parameter("domain_high")
        self.unchecked_axes = range(3) if plan.scene.domain.on_exit == "expand" else plan.periodic_box.axes
        self.outlets = []
        for index, outlet in enumerate(plan.scene.outlets.values()):
            readers = {name: state.parameter(f"outlet.{index}.{name}") for name in outlet.numbers()}
            self.outlets.append(outlet.build_contains(SimpleNamespace(**readers)))

    @ti.func
    def remains(self, i):
        """True if particle i remains. The spheres of a clump remain if its center of mass does."""
        fixed = 0
        if ti.static(self.features.fixed_particles):
            fixed = self.particles.fixed[i]
        found = self.remains_at(self.particles.position[i], self.particles.radius[i], fixed)
        if ti.static(self.features.clumps):
            if self.particles.clump[i] >= 0:
                found = self.remains_at(self.particles.clump_position[i], self.particles.radius[i], fixed)
        return found

    @ti.func
    def remains_at(self, position, radius, fixed):
        """True if a particle remains at this position [m]."""
        inside = radius > REMOVED_BELOW
        lows = self.low()
        highs = self.high()
        for axis in ti.static(range(3)):
            if ti.static(axis in self.unchecked_axes):
                inside = inside & (position[axis] == position[axis])  # false for NaN
            else:
                inside = inside & (position[axis] >= lows[axis]) & (position[axis] <= highs[axis])
        if ti.static(self.features.outlets):
            inside = inside and not (self._in_outlet(position) and fixed == 0)
        return inside

    @ti.func
    def _in_outlet(self, position):
        found = False
        for contains in ti.static(self.outlets):
            found = found or contains(position)
        return found


def remaining(state: State, arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Which of n particles on the host remain (n,), as `Remaining` decides.

    arrays:  position (n, 3), radius (n,), with fixed particles fixed (n,), and with clumps clump (n,) and
             clump_position (n, 3), in the types of the fields
    """
    count = len(arrays["radius"])
    found = np.zeros(count, np.int32)
    if count:
        position = np.ascontiguousarray(body_positions(arrays))
        radius = np.ascontiguousarray(arrays["radius"])
        fixed = np.ascontiguousarray(arrays.get("fixed", np.zeros(count, np.int32)))
        state.built(_build_remaining)(position, radius, fixed, found)
    return found.astype(bool)


def _build_remaining(state: State) -> Any:
    """Kernel (position, radius, fixed, found): the result of `remaining`."""
    remaining_particles = state.built(Remaining)
    real = state.backend.position_real
    external: Any = ti.types.ndarray()

    @ti.kernel
    def find_remaining(position: external, radius: external, fixed: external, found: external):
        for i in range(found.shape[0]):
            p = ti.Vector([position[i, 0], position[i, 1], position[i, 2]], dt=real)
            found[i] = ti.cast(remaining_particles.remains_at(p, radius[i], fixed[i]), ti.i32)

    return find_remaining


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


class Bounds:
    """Reach of all particles, and bounds of BOUNDS parts of the particle list.

        reach = min(skin / 2 + |v| time, reach_max)

    A part holds consecutive particles; its bounds are those of the positions, and the largest reach. A fast
    particle looks further, so that it does not make the rebuilds of all others more frequent. With the time
    KEPT_REACH, the reach is that of an earlier rebuild. On a GPU, SUBPARTS threads first share a part.

    Reads:   position, velocity, reach
    Writes:  reach of the particles; low, high, reach of the cell sort and of the subparts
    """

    def __init__(self, state: State) -> None:
        self.particles = state.particles
        self.sorting = state.cell_sort
        self.reach_max = state.parameter("reach_max")
        self.real = state.backend.position_real

    @ti.func
    def of_part(self, task: ti.template(), rebuild: ti.template()):
        """Bounds of a part."""
        low, high, reach = self._bounds_of(task.begin, task.begin, task.end, rebuild)
        self._store(task.index, low, high, reach)

    @ti.func
    def subpart_count(self, rebuild: ti.template()):
        """Number of subparts of all parts."""
        return ti.min(rebuild.count, BOUNDS) * SUBPARTS

    @ti.func
    def of_subpart(self, task: ti.template(), rebuild: ti.template()):
        """Bounds of a subpart."""
        subpart = task.index
        first, end = part_range(subpart // SUBPARTS, ti.min(rebuild.count, BOUNDS), rebuild.count)
        begin, last = part_range(subpart % SUBPARTS, SUBPARTS, end - first)
        low, high, reach = self._bounds_of(first, first + begin, first + last, rebuild)
        self.sorting.subpart_low[subpart] = low
        self.sorting.subpart_high[subpart] = high
        self.sorting.subpart_reach[subpart] = reach

    @ti.func
    def of_part_from_subparts(self, task: ti.template(), rebuild: ti.template()):
        """Bounds of a part from those of its subparts."""
        first = task.index * SUBPARTS
        low = self.sorting.subpart_low[first]
        high = self.sorting.subpart_high[first]
        reach = self.sorting.subpart_reach[first]
        for subpart in range(first + 1, first + SUBPARTS):
            low = ti.min(low, self.sorting.subpart_low[subpart])
            high = ti.max(high, self.sorting.subpart_high[subpart])
            reach = ti.max(reach, self.sorting.subpart_reach[subpart])
        self._store(task.index, low, high, reach)

    @ti.func
    def _store(self, part, low, high, reach):
        self.sorting.low[part] = low
        self.sorting.high[part] = high
        self.sorting.reach[part] = reach

    @ti.func
    def _bounds_of(self, first, begin, end, rebuild: ti.template()):
        """Low and high corner [m] and largest reach [m] of the particles `begin` to `end`, whose reach it
        writes.

        first:  a particle within the bounds, which counts also if the range is empty
        """
        smallest = self.particles.position[first]
        largest = self.particles.position[first]
        reach_largest = 0.5 * rebuild.skin
        limit = self.reach_max()
        i = begin
        while (i < end) & is_count(reach_largest):
            smallest = ti.min(smallest, self.particles.position[i])
            largest = ti.max(largest, self.particles.position[i])
            speed = ti.cast(self.particles.velocity[i].norm(), self.real)
            reach = ti.min(0.5 * rebuild.skin + speed * rebuild.reach_time, limit)
            if rebuild.reach_time < 0.0:
                reach = self.particles.reach[i]
            self.particles.reach[i] = reach
            reach_largest = ti.max(reach_largest, reach)
            i += 1
        return smallest, largest, reach_largest


def bounds_phases(state: State) -> list[Phase]:
    """Reach and bounds of the particles, and the grids; as `Bounds` and `CellGrids.lay`."""
    bounds = Bounds(state)
    lay = state.built(CellGrids).lay
    if state.backend.on_cpu or state.cell_sort.subpart_low is None:
        return [Phase(bounds.of_part, BOUNDS, serial=lay)]
    return [
        Phase(bounds.of_subpart, BOUNDS * SUBPARTS, bounds.subpart_count, per_task=1),
        Phase(bounds.of_part_from_subparts, BOUNDS, serial=lay),
    ]


# Grids

BLOCK_SIDE = 8
"""Number of cells along each edge of a block."""
MARGIN = 1e-6
"""Relative margin of the cell side above rounding, so that a neighbor is never two cells away."""
OUTLIER_SHARE = 1 / 16
"""Share of the parts of the particle list that may be outside the grid at each end; see `CellGrids`."""
VOLUME_RATIO = 1 / 2
"""Ratio of cell volumes below which the grid excludes outliers."""
BISECTIONS = 30
"""Number of bisections that find the box without outliers."""
COARSER = 1.25
"""Factor of the cell side of a grid that would have too many cells."""
ROUNDING = 1e-5
"""Relative margin of the cell range within a radius, because cell coordinates are rounded."""


class CellGrids:
    """The grids of the cells: their place, the cell of a point, and the cells that can contain neighbors."""

    def __init__(self, state: State) -> None:
        periodic_box = state.plan.periodic_box
        self.sorting = state.cell_sort
        self.control = state.control
        self.real = state.backend.position_real
        self.axes = periodic_box.axes
        self.other_axes = [axis for axis in range(3) if axis not in self.axes]
        self.gradient = -1 if periodic_box.image_motion is None else periodic_box.image_motion.gradient
        self.unsheared_axes = tuple(axis for axis in self.axes if axis != self.gradient)
        self.by_class = state.cell_sort.class_order is not None
        self.expands = state.plan.scene.domain.on_exit == "expand"
        self.domain_low = state.parameter("domain_low")
        deforming = state.plan.features.deforming_box
        self.domain_high = state.built(DeviceBox).high if deforming else state.parameter("domain_high")
        self.class_count = state.parameter("class_count")
        self.cell_capacity = state.parameter("cell_capacity")
        self.force_range = state.parameter("force_range")
        self.coordinate_limit = state.parameter("coordinate_limit")

    @ti.func
    def lay(self, rebuild: ti.template()):
        """Lay the grid for sorting; if particle sizes differ widely, one per size class.

        The cells are at least as wide as the largest diameter of the class plus two of the largest reaches
        and the range of the forces. Aborts if an expanding domain has become too large for the precision.

        Reads:   radius of the size classes; low, high, reach of the cell sort (see `Bounds`)
        Writes:  grid_low, cell_side, cells, cell_count, first_cell, reach_largest, abort
        """
        parts = ti.min(rebuild.count, BOUNDS)
        low = self.sorting.low[0]
        high = self.sorting.high[0]
        reach = self.sorting.reach[0]
        part = 0
        while (part < parts) & is_count(reach):
            low = ti.min(low, self.sorting.low[part])
            high = ti.max(high, self.sorting.high[part])
            reach = ti.max(reach, self.sorting.reach[part])
            part += 1
        self.sorting.reach_largest[0] = reach
        if ti.static(self.expands):
            if ti.max(-low.min(), high.max()) > self.coordinate_limit():
                ti.atomic_max(self.control.abort[0], ABORT_FAR)
        first_cell = 0
        for grid in range(self.class_count()):
            if ti.static(self.by_class):
                self.sorting.first_cell[grid] = first_cell
            side = (2.0 * self.sorting.radius[grid] + 2.0 * reach + self.force_range()) * (1.0 + MARGIN)
            self._lay_grid(grid, parts, low, high, side)
            first_cell += self.sorting.cell_count[grid]
        self.sorting.cell_count[self.class_count()] = first_cell

    @ti.func
    def _lay_grid(self, grid, parts, low, high, side):
        """Write one grid over all particles.

        low, high:  corners [m] of their bounding box
        side:       smallest cell side [m]

        If a few outliers make the cells much larger than requested, the grid excludes them; an outlier is
        then assigned to the nearest cell at the edge of the grid.
        """
        limit = self.cell_capacity() >> grid
        box_low = low
        box_high = high
        is_coarse = True
        found_low = low
        sides = high - low
        cells = ti.Vector([0, 0, 0])
        attempt = 0
        while is_coarse & (attempt < 2):  # one call of `over`, which is compiled once
            if attempt == 1:
                box_low, box_high = self._without_outliers(parts, low, high)
            finer_low, finer_sides, finer_cells = self.over(box_low, box_high, side, limit)
            finer_volume = finer_sides[0] * finer_sides[1] * finer_sides[2]
            volume = sides[0] * sides[1] * sides[2]
            if (attempt == 0) | (finer_volume < VOLUME_RATIO * volume):
                found_low = finer_low
                sides = finer_sides
                cells = finer_cells
            is_coarse = False
            attempt = attempt + 1
            for axis in ti.static(self.other_axes):
                is_coarse = is_coarse | (sides[axis] > side)
        self.sorting.grid_low[grid] = found_low
        self.sorting.cell_side[grid] = sides
        self.sorting.cells[grid] = cells
        blocks = (cells + BLOCK_SIDE - 1) // BLOCK_SIDE
        self.sorting.cell_count[grid] = blocks[0] * blocks[1] * blocks[2] * BLOCK_CELLS

    @ti.func
    def _without_outliers(self, parts, low, high):
        """Corners [m] of the box without OUTLIER_SHARE of the parts at each end.

        A bisection along each axis finds the corner below which at most that share of the parts begins, and
        the one above which at most that share ends.
        """
        outliers = ti.cast(OUTLIER_SHARE * ti.cast(parts, ti.f32), ti.i32)
        begin = low  # at most `outliers` parts are below `begin`
        end = high
        first = low
        last = high  # at most `outliers` parts are above `last`
        below = ti.Vector([0, 0, 0])
        above = ti.Vector([0, 0, 0])
        bisection = 0
        while (bisection < BISECTIONS) & is_count(below[0]):
            bisection += 1
            middle_low = 0.5 * (begin + end)
            middle_high = 0.5 * (first + last)
            below = ti.Vector([0, 0, 0])
            above = ti.Vector([0, 0, 0])
            part = 0
            while (part < parts) & ((below.min() <= outliers) | (above.min() <= outliers)):
                below += ti.cast(self.sorting.low[part] < middle_low, ti.i32)
                above += ti.cast(self.sorting.high[part] > middle_high, ti.i32)
                part += 1
            few_below = below <= outliers
            few_above = above <= outliers
            begin = ti.select(few_below, middle_low, begin)
            end = ti.select(few_below, end, middle_low)
            first = ti.select(few_above, first, middle_high)
            last = ti.select(few_above, middle_high, last)
        return begin, last

    @ti.func
    def over(self, low, high, side_requested, limit):
        """Low corner [m], cell sides [m] and cells along each axis of a grid over a box.

        The smallest grid of cells at least as wide as requested over a box clipped to the domain, unless the
        domain expands, coarsened to at most the limit of cells, exceeded only by a grid of one block. Along
        periodic axes the cells fill the domain exactly; along the other axes they are in whole blocks.
        """
        box_low = low
        box_high = high
        side = side_requested
        lows = self.domain_low()
        highs = self.domain_high()
        for axis in ti.static(range(3)):
            if ti.static(axis in self.axes):
                box_low[axis] = lows[axis]
                box_high[axis] = highs[axis]
            elif ti.static(not self.expands):
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
                if ti.static(axis in self.axes):
                    cells[axis] = ti.max(ti.floor(size[axis] / side), 1.0)
                    sides[axis] = size[axis] / cells[axis]
            blocks = ti.ceil(cells / BLOCK_SIDE)
            block_count = blocks[0] * blocks[1] * blocks[2]
            # The negation is also true for NaN.
            fits = not (block_count * BLOCK_CELLS > ti.cast(limit, self.real) and block_count > 1.0)
            side *= COARSER
        return box_low, sides, ti.cast(cells, ti.i32)

    @ti.func
    def cell_of_point(self, grid, point):
        """Cell of a grid that contains the point [m], or the nearest cell of the grid.

        Reads:  grid_low, cell_side, cells
        """
        cell_position = (point - self.sorting.grid_low[grid]) / self.sorting.cell_side[grid]
        last = ti.cast(self.sorting.cells[grid], self.sorting.cell_side.dtype) - 1.0
        # Clamped before the conversion, which is undefined for a coordinate far outside the grid.
        return ti.cast(ti.max(ti.min(cell_position, last), 0.0), ti.i32)

    @ti.func
    def adjacent_cells(self, grid, point):
        """Begin and end of the ranges of cells adjacent to that of a point, which may extend beyond the grid
        along periodic axes.

        Along periodic axes the first and the last cell are adjacent; with fewer than three cells, all are.
        """
        cell = self.cell_of_point(grid, point)
        cells = self.sorting.cells[grid]
        first = cell - 1
        end = cell + 2
        for axis in ti.static(range(3)):
            if ti.static(axis in self.axes):
                if cells[axis] < 3:
                    first[axis] = 0
                    end[axis] = cells[axis]
            else:
                first[axis] = ti.max(first[axis], 0)
                end[axis] = ti.min(end[axis], cells[axis])
        return first, end

    @ti.func
    def cells_within(self, grid, point, search_radius):
        """Begin and end of the ranges of cells of a grid that a sphere intersects.

        search_radius:  radius of the sphere [m], enlarged by ROUNDING

        Along a periodic axis the range may extend beyond the grid, but contains no cell twice. Images along a
        sheared gradient are searched separately, and the range ends at the grid.

        Reads:  grid_low, cell_side, cells
        """
        middle = (point - self.sorting.grid_low[grid]) / self.sorting.cell_side[grid]
        radius_in_cells = ti.static(1.0 + ROUNDING) * search_radius / self.sorting.cell_side[grid]
        last = ti.cast(self.sorting.cells[grid], self.sorting.cell_side.dtype) - 1.0
        lowest = ti.floor(middle - radius_in_cells)
        highest = ti.floor(middle + radius_in_cells)
        for axis in ti.static(range(3)):
            if ti.static(axis in self.unsheared_axes):
                if highest[axis] - lowest[axis] >= last[axis]:
                    lowest[axis] = 0.0
                    highest[axis] = last[axis]
            elif ti.static(axis == self.gradient):
                lowest[axis] = ti.max(lowest[axis], 0.0)
                highest[axis] = ti.min(highest[axis], last[axis])
            else:
                lowest[axis] = ti.max(ti.min(lowest[axis], last[axis]), 0.0)
                highest[axis] = ti.max(ti.min(highest[axis], last[axis]), 0.0)
        return ti.cast(lowest, ti.i32), ti.cast(highest, ti.i32) + 1

    @ti.func
    def wrapped_cell(self, cell, cells):
        """The cell of coordinates outside the grid, along the periodic axes."""
        wrapped = cell
        for axis in ti.static(range(3)):
            if ti.static(axis in self.axes):
                wrapped[axis] = (cell[axis] + cells[axis]) % cells[axis]
        return wrapped


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


# Counting sort, in phases; integers determine the order, so that it is the same for any number of threads


class CountingSort:
    """Writes `order` of particles by cell, and by key within a cell but the last.

    start:     field; the particles of cell c are order[start[c]:start[c + 1]]
    count_of:  device function (rebuild), number of particles

    A sort has device functions `cell_of(i, cells)`, 0 to `cells`, for the cell of a particle, `cell_count()`
    and `key(i)`, which is different for all particles. Cell `cells` collects the deleted particles.

    Counts are added atomically, which is exact for integers. The scan makes `start` the end of each cell;
    each particle that is placed there decreases it by 1, so that the begin remains.

    Reads:   as the device functions
    Writes:  start, order, coordination_number (the cell of each particle until it is placed), block_sum
    """

    cell_of: Any
    cell_count: Any
    key: Any

    def __init__(self, state: State, count_of: Any, start: Any, order: Any) -> None:
        self.state = state
        self.particles = state.particles
        self.sorting = state.cell_sort
        self.grids = state.built(CellGrids)
        self.cells = state.particles.coordination_number
        self.count_of = count_of
        self.start = start
        self.order = order

    def phases(self) -> list[Phase]:
        """The phases of the sort."""
        particles_per_task, cells_per_task = granularity(self.state)
        most_cells = self.start.shape[0]
        most_particles = self.order.shape[0]
        most_blocks = self.sorting.block_sum.shape[0]
        return [
            Phase(self.clear, most_cells, self.counts_of_cells, cells_per_task),
            Phase(self.count_particles, most_particles, self.count_of, particles_per_task),
            Phase(self.sum_block, most_blocks, self.counts_of_cells, SCAN_BLOCK, self.sum_blocks),
            Phase(self.scan_block, most_blocks, self.counts_of_cells, SCAN_BLOCK),
            Phase(self.place, most_particles, self.count_of, particles_per_task),
            Phase(self.order_cells, most_cells, self.cells_to_order, cells_per_task),
        ]

    @ti.func
    def cells_to_order(self, rebuild: ti.template()):
        """Number of cells without that of the deleted particles: the host orders these, which can be many."""
        return self.cell_count()

    @ti.func
    def counts_of_cells(self, rebuild: ti.template()):
        """Number of entries of `start` that the sort uses."""
        return self.cell_count() + 2

    @ti.func
    def clear(self, task: ti.template(), rebuild: ti.template()):
        """Set the counts of some cells to 0."""
        for c in range(task.begin, task.end):
            self.start[c] = 0

    @ti.func
    def count_particles(self, task: ti.template(), rebuild: ti.template()):
        """Count some particles in their cells."""
        cell = 0
        i = task.begin
        while (i < task.end) & is_count(cell):
            cell = self.cell_of(i, self.cell_count())
            self.cells[i] = cell
            ti.atomic_add(self.start[cell], 1)
            i += 1

    # Sums of the counts up to and including each cell

    @ti.func
    def sum_block(self, task: ti.template(), rebuild: ti.template()):
        """Sum of the counts of a block of cells."""
        total = 0
        c = task.begin
        while (c < task.end) & is_count(total):
            total += self.start[c]
            c += 1
        self.sorting.block_sum[task.index] = total

    @ti.func
    def sum_blocks(self, rebuild: ti.template()):
        """Sums of the counts before each block, on one thread."""
        total = 0
        blocks = task_count(self.counts_of_cells(rebuild), SCAN_BLOCK)
        block = 0
        while (block < blocks) & is_count(total):
            here = self.sorting.block_sum[block]
            self.sorting.block_sum[block] = total
            total += here
            block += 1

    @ti.func
    def scan_block(self, task: ti.template(), rebuild: ti.template()):
        """Replace the counts of a block of cells by their sums."""
        total = self.sorting.block_sum[task.index]
        c = task.begin
        while (c < task.end) & is_count(total):
            total += self.start[c]
            self.start[c] = total
            c += 1

    # The order

    @ti.func
    def place(self, task: ti.template(), rebuild: ti.template()):
        """Place some particles in their cells.

        Cells are filled from their ends, so that the last particles are placed first: a cell that is nearly
        in order takes the least time to sort.
        """
        last = self.count_of(rebuild) - 1
        cell = 0
        k = task.begin
        while (k < task.end) & is_count(cell):
            i = last - k
            cell = self.cells[i]
            self.order[ti.atomic_sub(self.start[cell], 1) - 1] = i
            k += 1

    @ti.func
    def order_cells(self, task: ti.template(), rebuild: ti.template()):
        """Order the particles of some cells by key: their order depends on the threads before."""
        for c in range(task.begin, task.end):
            self._order_by_key(self.start[c], self.start[c + 1])

    @ti.func
    def _order_by_key(self, begin, end):
        """Insertion sort of order[begin:end] by key; a cell holds few particles."""
        for k in range(begin + 1, end):
            moving = self.order[k]
            rank = k
            # The index is clamped in case both sides of `and` are evaluated.
            while rank > begin and self.key(self.order[ti.max(rank - 1, 0)]) > self.key(moving):
                self.order[rank] = self.order[rank - 1]
                rank -= 1
            self.order[rank] = moving


class SortByCell(CountingSort):
    """Order of the particles by cell, by id within a cell; deleted particles come last, in any order.

    Reads:   position, id; as `Remaining`
    Writes:  cell_start, order; as `CountingSort`
    """

    def __init__(self, state: State) -> None:
        super().__init__(state, all_particles, state.cell_sort.cell_start, state.cell_sort.order)
        self.remaining = state.built(Remaining)

    @ti.func
    def cell_of(self, i, cell_count):
        """See `CountingSort`."""
        cell = cell_count
        if self.remaining.remains(i):
            cell = cell_number(self.grids.cell_of_point(0, self.particles.position[i]), self.sorting.cells[0])
        return cell

    @ti.func
    def cell_count(self):
        """See `CountingSort`."""
        return self.sorting.cell_count[0]

    @ti.func
    def key(self, i):
        """See `CountingSort`."""
        return self.particles.id[i]


class SortByClass(CountingSort):
    """Order of the sorted particles, and of ghosts, by size class and cell of its grid.

    Within a cell the particles keep their order. Entries between the owned particles and the ghosts are
    unused.

    Reads:   position, radius, owned_count, ghost_first
    Writes:  class_start, class_order; as `CountingSort`
    """

    def __init__(self, state: State) -> None:
        super().__init__(state, self.present_count, state.cell_sort.class_start, state.cell_sort.class_order)
        self.has_ghosts = state.plan.has_ghosts
        self.class_count = state.parameter("class_count")

    @ti.func
    def cell_of(self, i, cell_count):
        """See `CountingSort`."""
        cell = self._class_cell(i)
        if ti.static(self.has_ghosts):
            if i >= self.sorting.owned_count[0] and i < self.sorting.ghost_first[0]:
                cell = cell_count
        return cell

    @ti.func
    def _class_cell(self, i):
        group = 0
        for smaller in range(self.class_count() - 1):
            group += ti.cast(self.particles.radius[i] > self.sorting.radius[smaller], ti.i32)
        cell = cell_number(
            self.grids.cell_of_point(group, self.particles.position[i]), self.sorting.cells[group]
        )
        return self.sorting.first_cell[group] + cell

    @ti.func
    def cell_count(self):
        """See `CountingSort`."""
        return self.sorting.cell_count[self.class_count()]

    @ti.func
    def key(self, i):
        """See `CountingSort`."""
        return i

    @ti.func
    def present_count(self, rebuild: ti.template()):
        """Number of particles and ghosts."""
        present = rebuild.count
        if ti.static(not self.has_ghosts):
            present = self.sorting.cell_start[self.sorting.cell_count[0]]
        return present
