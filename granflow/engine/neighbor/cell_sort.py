"""Order of the particles by cell at a neighbor-list rebuild: a counting sort, in phases.

Integers determine all results: the order is the same for any number of threads.
"""

from typing import Any

from granflow.engine.neighbor.cell_grid import build_lay_grids
from granflow.engine.neighbor.cells import cell_number, cell_of_point
from granflow.engine.neighbor.deletion import build_remains
from granflow.engine.neighbor.phases import Phase, granularity, is_count, part_range
from granflow.engine.state import State
from granflow.kernel_language import ti
from granflow.plan.capacities import BOUNDS, SCAN_BLOCK

KEPT_REACH = -1.0
"""Time of the reach for which the particles keep the reach that they have."""


def bounds_phase(state: State) -> Phase:
    """Reach of all particles, bounds of BOUNDS parts of the particle list, and the grids.

        reach = min(skin / 2 + |v| time, reach_max)

    A part holds consecutive particles; its bounds are those of the positions, and the largest reach. A fast particle
    looks further, so that it does not make the rebuilds of all others more frequent. With the time KEPT_REACH, the
    reach is that of an earlier rebuild.

    Reads:   position, velocity, reach
    Writes:  reach of the particles; low, high, reach of the cell sort; the grids
    """
    particles, sorting, real = state.particles, state.cell_sort, state.backend.position_real
    position, reach_max, lay_grids = particles.position, state.parameter("reach_max"), build_lay_grids(state)

    @ti.func
    def part_count(rebuild):
        return ti.min(rebuild.count, BOUNDS)

    @ti.func
    def bounds(part, rebuild):
        begin, end = part_range(part, part_count(rebuild), rebuild.count)
        smallest, largest, reach_largest, limit = position[begin], position[begin], 0.5 * rebuild.skin, reach_max()
        i = begin
        while i < end and is_count(reach_largest):
            smallest, largest = ti.min(smallest, position[i]), ti.max(largest, position[i])
            speed = ti.cast(particles.velocity[i].norm(), real)
            reach = ti.min(0.5 * rebuild.skin + speed * rebuild.reach_time, limit)
            if rebuild.reach_time < 0.0:
                reach = particles.reach[i]
            particles.reach[i] = reach
            reach_largest = ti.max(reach_largest, reach)
            i += 1
        sorting.low[part], sorting.high[part], sorting.reach[part] = smallest, largest, reach_largest

    @ti.func
    def lay(rebuild):
        lay_grids(rebuild.count)

    return Phase(part_count, bounds, BOUNDS, lay)


def sort_phases(state: State) -> list[Phase]:
    """Order of the particles by cell, by id within a cell; deleted particles come last, in any order.

    Reads:   position, id
    Writes:  cell_start, order
    """
    particles, sorting = state.particles, state.cell_sort
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

    @ti.func
    def count_of(rebuild):
        return rebuild.count

    return _counting_sort(state, cell_of, cells_of_all, count_of, key, sorting.cell_start, sorting.order)


def class_phases(state: State) -> list[Phase]:
    """Order of the sorted particles, and of ghosts, by size class and cell of its grid.

    Within a cell the particles keep their order. Entries between the owned particles and the ghosts are unused.

    Reads:   position, radius, owned_count, ghost_first
    Writes:  class_start, class_order
    """
    particles, sorting, has_ghosts = state.particles, state.cell_sort, state.plan.has_ghosts
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
    def present_count(rebuild):
        present = rebuild.count
        if ti.static(not has_ghosts):
            present = sorting.cell_start[sorting.cell_count[0]]
        return present

    return _counting_sort(state, cell_of, cells_of_all, present_count, key, sorting.class_start, sorting.class_order)


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

    Cell `cells` collects the deleted particles. Counts are added atomically, which is exact for integers.

    Writes:  start, order, cell, cell_fill, block_sum
    """
    most_parts, cells_per_task = granularity(state)
    most_cells, most_particles = start.shape[0], order.shape[0]

    @ti.func
    def part_count(rebuild):
        return ti.min(count_of(rebuild), most_parts)

    @ti.func
    def task_count(rebuild):
        return (cells_of_all() + 2 + cells_per_task - 1) // cells_per_task

    clear, order_cells = _build_cell_tasks(state, cells_per_task, cells_of_all, key, start, order)
    count_particles, place = _build_particle_parts(state, part_count, count_of, cell_of, cells_of_all, start, order)
    return [
        Phase(task_count, clear, most_cells),
        Phase(part_count, count_particles, most_particles),
        *_scan_phases(state, cells_of_all, start),
        Phase(part_count, place, most_particles),
        Phase(task_count, order_cells, most_cells),
    ]


def _build_cell_tasks(
    state: State, cells_per_task: int, cells_of_all: Any, key: Any, start: Any, order: Any
) -> tuple[Any, Any]:
    """Device functions (task, rebuild): set the counts of some cells to 0; order their particles by key."""
    sorting = state.cell_sort

    @ti.func
    def clear(task, rebuild):
        for c in range(task * cells_per_task, ti.min((task + 1) * cells_per_task, cells_of_all() + 2)):
            start[c], sorting.cell_fill[c] = 0, 0

    # The ranks of the atomic additions depend on the threads; ordering each cell by key removes that. The cell of the
    # deleted particles can hold many of them: the host orders these.
    @ti.func
    def order_cells(task, rebuild):
        for c in range(task * cells_per_task, ti.min((task + 1) * cells_per_task, cells_of_all())):
            _order_by_key(order, key, start[c], start[c + 1])

    return clear, order_cells


def _build_particle_parts(
    state: State, part_count: Any, count_of: Any, cell_of: Any, cells_of_all: Any, start: Any, order: Any
) -> tuple[Any, Any]:
    """Device functions (part, rebuild): count some particles in their cells; place them there."""
    sorting = state.cell_sort

    @ti.func
    def count_particles(part, rebuild):
        begin, end = part_range(part, part_count(rebuild), count_of(rebuild))
        cell, i = 0, begin
        while i < end and is_count(cell):
            cell = cell_of(i, cells_of_all())
            sorting.cell[i] = cell
            ti.atomic_add(start[cell], 1)
            i += 1

    @ti.func
    def place(part, rebuild):
        begin, end = part_range(part, part_count(rebuild), count_of(rebuild))
        cell, i = 0, begin
        while i < end and is_count(cell):
            cell = sorting.cell[i]
            rank = ti.atomic_add(sorting.cell_fill[cell], 1)
            order[start[cell] + rank] = i
            i += 1

    return count_particles, place


def _scan_phases(state: State, cells_of_all: Any, start: Any) -> list[Phase]:
    """Phases that replace the counts of the cells in `start` by their sums over the cells before."""
    sorting, most_blocks = state.cell_sort, state.cell_sort.block_sum.shape[0]

    @ti.func
    def block_count(rebuild):
        return (cells_of_all() + 2 + SCAN_BLOCK - 1) // SCAN_BLOCK

    @ti.func
    def range_of(block):
        return block * SCAN_BLOCK, ti.min((block + 1) * SCAN_BLOCK, cells_of_all() + 2)

    @ti.func
    def sum_block(block, rebuild):
        begin, end = range_of(block)
        total, c = 0, begin
        while c < end and is_count(total):
            total += start[c]
            c += 1
        sorting.block_sum[block] = total

    @ti.func
    def sum_blocks(rebuild):
        total = 0
        block = 0
        while block < block_count(rebuild) and is_count(total):
            here = sorting.block_sum[block]
            sorting.block_sum[block] = total
            total += here
            block += 1

    @ti.func
    def scan_block(block, rebuild):
        begin, end = range_of(block)
        total = sorting.block_sum[block]
        c = begin
        while c < end and is_count(total):
            here = start[c]
            start[c] = total
            total += here
            c += 1

    return [Phase(block_count, sum_block, most_blocks, sum_blocks), Phase(block_count, scan_block, most_blocks)]


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
