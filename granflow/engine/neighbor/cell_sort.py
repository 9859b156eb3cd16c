"""Order of the particles by cell at a neighbor-list rebuild: a counting sort, in phases.

Integers determine all results: the order is the same for any number of threads.
"""

from typing import Any

from granflow.engine.neighbor.cells import cell_number, cell_of_point
from granflow.engine.neighbor.deletion import build_remains
from granflow.engine.neighbor.phases import Phase, all_particles, granularity, is_count, task_count
from granflow.engine.state import State
from granflow.kernel_language import ti
from granflow.plan.capacities import SCAN_BLOCK


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

    return _counting_sort(state, cell_of, cells_of_all, all_particles, key, sorting.cell_start, sorting.order)


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
    def present_count(rebuild: ti.template()):
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

    Cell `cells` collects the deleted particles. Counts are added atomically, which is exact for integers. The scan
    makes `start` the end of each cell; each particle that is placed there decreases it by 1, so that the begin remains.

    Writes:  start, order, coordination_number (the cell of each particle until it is placed), block_sum
    """
    particles_per_task, cells_per_task = granularity(state)
    most_cells, most_particles = start.shape[0], order.shape[0]

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

    # The ranks of the atomic additions depend on the threads; ordering each cell by key removes that. The cell of the
    # deleted particles can hold many of them: the host orders these.
    @ti.func
    def order_cells(task: ti.template(), rebuild: ti.template()):
        for c in range(task.begin, task.end):
            _order_by_key(order, key, start[c], start[c + 1])

    return clear, order_cells


def _build_particle_parts(
    state: State, count_of: Any, cell_of: Any, cells_of_all: Any, start: Any, order: Any
) -> tuple[Any, Any]:
    """Device functions (task, rebuild): count some particles in their cells; place them there.

    Cells are filled from their ends, so that the last particles are placed first: a cell that is nearly in order takes
    the least time to sort.
    """
    cells = state.particles.coordination_number

    @ti.func
    def count_particles(task: ti.template(), rebuild: ti.template()):
        cell, i = 0, task.begin
        while (i < task.end) & is_count(cell):
            cell = cell_of(i, cells_of_all())
            cells[i] = cell
            ti.atomic_add(start[cell], 1)
            i += 1

    @ti.func
    def place(task: ti.template(), rebuild: ti.template()):
        last = count_of(rebuild) - 1
        cell, k = 0, task.begin
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
    sorting, most_blocks = state.cell_sort, state.cell_sort.block_sum.shape[0]

    @ti.func
    def sum_block(task: ti.template(), rebuild: ti.template()):
        total, c = 0, task.begin
        while (c < task.end) & is_count(total):
            total += start[c]
            c += 1
        sorting.block_sum[task.index] = total

    @ti.func
    def sum_blocks(rebuild: ti.template()):
        total, blocks = 0, task_count(counts_of_cells(rebuild), SCAN_BLOCK)
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
