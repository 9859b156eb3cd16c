"""Sorts particles in cell order at a neighbor-list rebuild: a counting sort, then the permutation of all fields.

Integers determine all results: identical bits for any number of threads.
"""

from collections.abc import Callable
from typing import Any

import taichi as ti

from granflow.engine.neighbor.cells import cell_number, cell_of_point
from granflow.engine.neighbor.deletion import build_remains
from granflow.engine.state import State
from granflow.plan.capacities import BOUNDS, SCAN_BLOCK


def build_bounds(state: State) -> Callable[..., None]:
    """Kernel (count, skin [m], time [s]): reach of all particles, and bounds of BOUNDS parts of the particle list.

        reach = min(skin / 2 + |v| time, reach_max)

    Part p contains the particles p, p + BOUNDS, ...; its bounds are those of the positions, and the largest reach. A
    fast particle looks further, so that it does not make the rebuilds of all others more frequent.

    Reads:   position, velocity
    Writes:  reach of the particles; low, high, reach of the cell sort
    """
    particles, sorting, real = state.particles, state.cell_sort, state.backend.position_real
    position, low, high, reach_max = particles.position, sorting.low, sorting.high, state.plan.reach_max

    @ti.kernel
    def bounds(count: ti.i32, skin: real, time: real):
        for part in range(BOUNDS):
            start = position[ti.min(part, ti.max(count - 1, 0))]
            smallest, largest, reach_largest = start, start, 0.5 * skin
            for row in range((count - part + BOUNDS - 1) // BOUNDS):
                i = part + row * BOUNDS
                here = position[i]
                smallest, largest = ti.min(smallest, here), ti.max(largest, here)
                reach = ti.min(0.5 * skin + ti.cast(particles.velocity[i].norm(), real) * time, real(reach_max))
                particles.reach[i] = reach
                reach_largest = ti.max(reach_largest, reach)
            low[part], high[part], sorting.reach[part] = smallest, largest, reach_largest

    return bounds


def build_sort(state: State) -> Callable[..., None]:
    """Kernel (count, cells): order of the particles by cell, by id within a cell; deleted particles come last.

    The order is unique, because ids are: it does not depend on the threads.

    Reads:   position, id
    Writes:  cell_start, order
    """
    particles, sorting = state.particles, state.cell_sort
    remains = build_remains(state)

    @ti.func
    def cell_of(i, cells):
        cell = cells - 1
        if remains(i):
            cell = cell_number(cell_of_point(sorting, 0, particles.position[i]), sorting.cells[0])
        return cell

    @ti.func
    def key(i):
        return particles.id[i]

    return _build_counting_sort(state, cell_of, key, sorting.cell_start, sorting.order)


def build_class_lists(state: State) -> Callable[..., None]:
    """Kernel (count, cells): order of the sorted particles by size class and cell of its grid.

    Within a cell the particles keep their order.

    Reads:   position, radius
    Writes:  class_start, class_order
    """
    particles, sorting, real = state.particles, state.cell_sort, state.backend.real
    uppers = state.plan.size_classes[:-1]

    @ti.func
    def cell_of(i, cells):
        group = 0
        for upper in ti.static(uppers):
            group += ti.cast(particles.radius[i] > real(upper), ti.i32)
        cell = cell_number(cell_of_point(sorting, group, particles.position[i]), sorting.cells[group])
        return sorting.first_cell[group] + cell

    @ti.func
    def key(i):
        return i

    return _build_counting_sort(state, cell_of, key, sorting.class_start, sorting.class_order)


def _build_counting_sort(state: State, cell_of: Any, key: Any, start: Any, order: Any) -> Callable[..., None]:
    """Kernel (count, cells): `order` of particles by `cell_of(i, cells + 1)`, by `key(i)` within a cell.

    cell_of:  device function, 0 to `cells`
    key:      device function, different for all particles
    start:    field, written; the particles of cell c are order[start[c]:start[c + 1]]
    order:    field, written

    Cell `cells` collects the particles outside the grid. Counts are added atomically, which is exact for integers.

    Writes:  start, order, cell, cell_fill, block_sum
    """
    sorting = state.cell_sort

    @ti.kernel
    def sort(count: ti.i32, cell_count: ti.i32):
        cells = cell_count + 1
        blocks = (cells + 1 + SCAN_BLOCK - 1) // SCAN_BLOCK
        for c in range(cells + 1):
            start[c] = 0
            sorting.cell_fill[c] = 0
        for i in range(count):
            cell = cell_of(i, cells)
            sorting.cell[i] = cell
            ti.atomic_add(start[cell], 1)
        for b in range(blocks):
            total = 0
            for c in range(b * SCAN_BLOCK, ti.min((b + 1) * SCAN_BLOCK, cells + 1)):
                total += start[c]
            sorting.block_sum[b] = total
        for _ in range(1):  # a serial loop, one task of the kernel
            total = 0
            for b in range(blocks):
                here = sorting.block_sum[b]
                sorting.block_sum[b] = total
                total += here
        for b in range(blocks):
            total = sorting.block_sum[b]
            for c in range(b * SCAN_BLOCK, ti.min((b + 1) * SCAN_BLOCK, cells + 1)):
                here = start[c]
                start[c] = total
                total += here
        for i in range(count):
            cell = sorting.cell[i]
            rank = ti.atomic_add(sorting.cell_fill[cell], 1)
            order[start[cell] + rank] = i
        # The ranks of the atomic additions depend on the threads; ordering each cell by key removes that.
        for c in range(cells):
            _order_by_key(order, key, start[c], start[c + 1])

    return sort


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


def build_reorder(state: State) -> Callable[[int], None]:
    """Kernel (count): move all particle fields to the new order, one field after the other.

    `position_at_rebuild` and `coordination_number` serve as buffers; both are written again before they are read.

    Reads:   order
    Writes:  all fields of `Particles.sorted_fields`
    """
    sorting, particles, fields = state.cell_sort, state.particles, state.particles.sorted_fields()
    vectors = [field for field in fields if isinstance(field, ti.MatrixField)]
    integers = [field for field in fields if field.dtype == ti.i32]
    scalars = [field for field in fields if not isinstance(field, ti.MatrixField) and field.dtype != ti.i32]
    vector, integer = particles.position_at_rebuild, particles.coordination_number

    @ti.kernel
    def reorder_vectors(count: ti.i32):
        for f in ti.static(range(len(vectors))):
            for k in range(count):
                vector[k] = ti.cast(vectors[f][sorting.order[k]], vector.dtype)
            for k in range(count):
                vectors[f][k] = ti.cast(vector[k], vectors[f].dtype)

    @ti.kernel
    def reorder_scalars(count: ti.i32):
        for first in ti.static(range(0, len(scalars), 3)):
            for k in range(count):
                for f in ti.static(range(first, min(first + 3, len(scalars)))):
                    vector[k][f - first] = ti.cast(scalars[f][sorting.order[k]], vector.dtype)
            for k in range(count):
                for f in ti.static(range(first, min(first + 3, len(scalars)))):
                    scalars[f][k] = ti.cast(vector[k][f - first], scalars[f].dtype)
        for f in ti.static(range(len(integers))):
            for k in range(count):
                integer[k] = integers[f][sorting.order[k]]
            for k in range(count):
                integers[f][k] = integer[k]

    def reorder(count: int) -> None:
        reorder_vectors(count)
        reorder_scalars(count)

    return reorder
