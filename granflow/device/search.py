"""Neighbour search: particles sorted in cell order, then one row of near partners for each.

Everything is decided by integers or by one order of the sums: the same bits on any number of threads.
"""

from collections.abc import Callable
from typing import Any

import taichi as ti

from granflow.device.apart import build_apart, build_seen_from, build_turn
from granflow.device.fixed import build_can_meet
from granflow.device.grid import build_cell_number
from granflow.device.leaving import build_stays
from granflow.device.mesh import build_mesh_geometry
from granflow.device.state import SCAN_BLOCK, State
from granflow.device.walls import build_wall_geometry
from granflow.plan.slots import BOUNDS

ROUNDING = 1e-5
"""Share by which the search reaches further than it has to: cells are found by numbers that are rounded."""


def build_bounds(state: State) -> Callable[[int], None]:
    """Box around every BOUNDS-th part of the particles, into sorting.low and sorting.high."""
    position, low, high = state.particles.position, state.sorting.low, state.sorting.high

    @ti.kernel
    def bounds(count: ti.i32):
        for part in range(BOUNDS):
            start = position[ti.min(part, ti.max(count - 1, 0))]
            smallest, largest = start, start
            for turn in range((count - part + BOUNDS - 1) // BOUNDS):
                here = position[part + turn * BOUNDS]
                smallest, largest = ti.min(smallest, here), ti.max(largest, here)
            low[part], high[part] = smallest, largest

    return bounds


def build_place(state: State) -> Any:
    """Device function (point, number of the grid): cell it stands in, or the one at the edge that is nearest."""
    sorting, real = state.sorting, state.backend.position_real

    @ti.func
    def place(point, grid=0):
        p, cells = (point - sorting.grid_low[grid]) / sorting.cell_side[grid], sorting.cells[grid]
        last = ti.cast(cells, real) - 1.0
        x = ti.cast(ti.max(ti.min(p[0], last[0]), 0.0), ti.i32)
        y = ti.cast(ti.max(ti.min(p[1], last[1]), 0.0), ti.i32)
        z = ti.cast(ti.max(ti.min(p[2], last[2]), 0.0), ti.i32)
        return x, y, z

    return place


def build_around(state: State) -> tuple[Any, Any]:
    """Device functions (cell, cells, axis) for the cells next to one along an axis.

    The first gives where they begin and end, the second the cell that a number off the grid stands for. Along a
    periodic axis the first and the last cell are neighbours; where there are less than three, all are near.
    """
    periodic = state.plan.border.axes

    @ti.func
    def around(cell, cells, axis: ti.template()):
        first, end = cell - 1, cell + 2
        if ti.static(axis in periodic):
            if cells[axis] < 3:
                first, end = 0, cells[axis]
        else:
            first, end = ti.max(first, 0), ti.min(end, cells[axis])
        return first, end

    @ti.func
    def meant(cell, cells, axis: ti.template()):
        found = cell
        if ti.static(axis in periodic):
            found = (cell + cells[axis]) % cells[axis]
        return found

    return around, meant


def build_within(state: State) -> Any:
    """Device function (point, reach, number of the grid): first cell along each axis that a sphere meets, and the end.

    Along a periodic axis they may lie off the grid, but none stands for another; images along a sheared gradient are
    looked at by themselves.
    """
    sorting, real, border = state.sorting, state.backend.position_real, state.plan.border
    across = -1 if border.shear is None else border.shear.across
    periodic = [axis for axis in border.axes if axis != across]
    slack = 1.0 + ROUNDING

    @ti.func
    def within(point, reach, grid):
        middle = (point - sorting.grid_low[grid]) / sorting.cell_side[grid]
        far, cells = slack * reach / sorting.cell_side[grid], sorting.cells[grid]
        lowest, highest = ti.floor(middle - far), ti.floor(middle + far)
        for axis in ti.static(range(3)):
            if ti.static(axis in periodic):
                if highest[axis] - lowest[axis] >= cells[axis] - 1:
                    lowest[axis], highest[axis] = 0.0, ti.cast(cells[axis], real) - 1.0
            elif ti.static(axis == across):
                lowest[axis] = ti.max(lowest[axis], 0.0)
                highest[axis] = ti.min(highest[axis], ti.cast(cells[axis], real) - 1.0)
            else:
                last = ti.cast(cells[axis], real) - 1.0
                lowest[axis] = ti.max(ti.min(lowest[axis], last), 0.0)
                highest[axis] = ti.max(ti.min(highest[axis], last), 0.0)
        return ti.cast(lowest, ti.i32), ti.cast(highest, ti.i32) + 1

    return within


def build_sort(state: State) -> Callable[..., None]:
    """Kernel (count, cells): order of the particles by cell, by id within a cell; those that leave come last.

    Reads:   position, id
    Writes:  cell_start, order
    """
    particles, sorting = state.particles, state.sorting
    number, stays, place = build_cell_number(), build_stays(state), build_place(state)

    @ti.func
    def cell_of(i, cells):
        cell = cells - 1
        if stays(i):
            x, y, z = place(particles.position[i])
            cell = number(x, y, z, sorting.cells[0])
        return cell

    @ti.func
    def key(i):
        return particles.id[i]

    return _build_counting_sort(state, cell_of, key, sorting.cell_start, sorting.order)


def build_class_lists(state: State) -> Callable[..., None]:
    """Kernel (count, cells): the sorted particles once more, by class of size and cell of its grid.

    Reads:   position, radius
    Writes:  listed_start, listed
    """
    particles, sorting = state.particles, state.sorting
    number, place, class_of = build_cell_number(), build_place(state), build_class_of(state)

    @ti.func
    def cell_of(i, cells):
        group = class_of(particles.radius[i])
        x, y, z = place(particles.position[i], group)
        return sorting.first_cell[group] + number(x, y, z, sorting.cells[group])

    @ti.func
    def key(i):
        return i

    return _build_counting_sort(state, cell_of, key, sorting.listed_start, sorting.listed)


def build_class_of(state: State) -> Any:
    """Device function (radius): number of the class of sizes."""
    real, uppers = state.backend.real, state.plan.size_classes[:-1]

    @ti.func
    def class_of(radius):
        found = 0
        for upper in ti.static(uppers):
            found += ti.cast(radius > real(upper), ti.i32)
        return found

    return class_of


def _build_counting_sort(state: State, cell_of: Any, key: Any, start: Any, order: Any) -> Callable[..., None]:
    """Kernel (count, cells): `order` of particles by `cell_of(i, cells + 1)`, by `key(i)` within a cell.

    Those of a cell stand from its `start` to the next one's; there is a cell behind the last for who has none.
    """
    sorting = state.sorting

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
        for _ in range(1):
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
            slot = ti.atomic_add(sorting.cell_fill[cell], 1)
            order[start[cell] + slot] = i
        for c in range(cells):
            order_by_key(start[c], start[c + 1])

    @ti.func
    def order_by_key(begin, end):
        for k in range(begin + 1, end):
            moving = order[k]
            slot = k
            while slot > begin and key(order[ti.max(slot - 1, 0)]) > key(moving):
                order[slot] = order[slot - 1]
                slot -= 1
            order[slot] = moving

    return sort


def build_gather(state: State) -> Callable[[int], None]:
    """Bring every particle to its new place, one array after the other.

    They go through `position_at_search` and `coordination`, which nobody reads before they are written anew.
    """
    sorting, particles, fields = state.sorting, state.particles, state.particles.sorted_fields()
    vectors = [field for field in fields if isinstance(field, ti.MatrixField)]
    integers = [field for field in fields if field.dtype == ti.i32]
    scalars = [field for field in fields if not isinstance(field, ti.MatrixField) and field.dtype != ti.i32]
    vector, integer = particles.position_at_search, particles.coordination

    @ti.kernel
    def gather_vectors(count: ti.i32):
        for f in ti.static(range(len(vectors))):
            for k in range(count):
                vector[k] = ti.cast(vectors[f][sorting.order[k]], vector.dtype)
            for k in range(count):
                vectors[f][k] = ti.cast(vector[k], vectors[f].dtype)

    @ti.kernel
    def gather_scalars(count: ti.i32):
        for k in range(count):
            for f in ti.static(range(len(scalars))):
                vector[k][f] = ti.cast(scalars[f][sorting.order[k]], vector.dtype)
        for k in range(count):
            for f in ti.static(range(len(scalars))):
                scalars[f][k] = ti.cast(vector[k][f], scalars[f].dtype)
        for f in ti.static(range(len(integers))):
            for k in range(count):
                integer[k] = integers[f][sorting.order[k]]
            for k in range(count):
                integers[f][k] = integer[k]

    def gather(count: int) -> None:
        gather_vectors(count)
        gather_scalars(count)

    return gather


def build_set_aside(state: State) -> Callable[[int], None]:
    """Copy slots with history to `before`, where the new rows look them up; `slots_needed`: the most in a chunk."""
    contacts, names, stride = state.contacts, list(state.contacts.history), state.stride
    chunk_size, kept = state.plan.chunk_size, contacts.kept_per_chunk

    @ti.func
    def keep(slot, place):
        contacts.partner_before[place] = contacts.partner[slot]
        for name in ti.static(names):
            contacts.before[name][place] = contacts.history[name][slot]

    @ti.kernel
    def set_aside(count: ti.i32):
        state.control.slots_needed[0] = 0
        for task in range((count + chunk_size - 1) // chunk_size * stride):
            if task % stride == 0:
                chunk = task // stride
                place = chunk * kept
                for i in range(chunk * chunk_size, ti.min((chunk + 1) * chunk_size, count)):
                    contacts.row_begin_before[i] = place
                    for slot in range(contacts.row_begin[i], contacts.row_end[i]):
                        if contacts.touching[slot] == 1:
                            if place < (chunk + 1) * kept:
                                keep(slot, place)
                            place += 1
                    contacts.row_end_before[i] = place
                ti.atomic_max(state.control.slots_needed[0], place - chunk * kept)

    return set_aside


def build_recall(state: State) -> Any:
    """Device function: history of the pair (i, j) from before the sort, into its new slot.

    A pair that stood in the partner's row comes with its vectors turned round.
    """
    contacts, sorting, chunk_size = state.contacts, state.sorting, state.plan.chunk_size
    names = list(contacts.history)
    odd = [name != "normal" for name in names]

    @ti.func
    def find(row, partner):
        found = -1
        for slot in range(contacts.row_begin_before[row], contacts.row_end_before[row]):
            if contacts.partner_before[slot] == partner:
                found = slot
        return found

    @ti.func
    def recall(slot, i, j):
        i_before = sorting.order[i]
        j_before = j
        if j >= 0:
            j_before = sorting.order[j]
        source = find(i_before, j_before)
        sign = 1.0
        if source < 0 and j >= 0 and i_before // chunk_size == j_before // chunk_size:
            source = find(j_before, i_before)
            sign = -1.0
        contacts.touching[slot] = ti.cast(source >= 0, ti.i32)
        for n in ti.static(range(len(names))):
            contacts.history[names[n]][slot] = 0.0 * contacts.history[names[n]][slot]
            if source >= 0:
                if ti.static(odd[n]):
                    contacts.history[names[n]][slot] = sign * contacts.before[names[n]][source]
                else:
                    contacts.history[names[n]][slot] = contacts.before[names[n]][source]

    return recall


def build_rows(state: State) -> Callable[..., None]:
    """Fill every row with the partners and walls nearer than the skin.

    Reads:   position, radius, cell_start, walls
    Writes:  row_begin, row_end, partner, history, slots_needed, position_at_search, search_due
    """
    plan, particles, sorting, contacts = state.plan, state.particles, state.sorting, state.contacts
    real, chunk_size, slots = state.backend.position_real, plan.chunk_size, contacts.slots_per_chunk
    wall_count, remembers, stride = len(plan.walls), bool(contacts.history), state.stride
    number, place, apart = build_cell_number(), build_place(state), build_apart(state)
    around, meant = build_around(state)
    classes, within = len(plan.size_classes), build_within(state)
    sheared, by_class = plan.features.shear, sorting.listed is not None
    images, turn = int(sheared), build_turn(state) if sheared else None
    seen_from = build_seen_from(state)
    geometry, has_mesh = build_wall_geometry(state), plan.features.mesh_walls
    mesh = build_mesh_geometry(state) if has_mesh else None
    recall = build_recall(state) if remembers else None
    can_meet = build_can_meet(state)

    @ti.func
    def append(chunk, slot, i, j):
        if slot < (chunk + 1) * slots:
            contacts.partner[slot] = j
            if ti.static(remembers):
                recall(slot, i, j)
        return slot + 1

    @ti.func
    def near_walls(chunk, slot, i, skin, pose):
        filled, reach = slot, particles.radius[i] + skin
        for w in range(wall_count):
            if state.walls.present[w] == 1 and can_meet(i, -1 - w):
                if ti.static(has_mesh):
                    filled = near_triangles(chunk, filled, i, w, skin, pose)
                if geometry.distance(w, pose, particles.position[i]) < reach:
                    filled = append(chunk, filled, i, -1 - w)
        return filled

    @ti.func
    def near_triangles(chunk, slot, i, w, skin, pose):
        filled, reach = slot, particles.radius[i] + skin
        local = geometry.to_rest(w, pose, particles.position[i])
        begin, end = mesh.cell(w, local)
        for k in range(begin, end):
            t = state.mesh.listed[k]
            if mesh.may_answer(t, local, skin) == 1 and mesh.away(t, local).norm() < reach:
                filled = append(chunk, filled, i, -1 - wall_count - t)
        return filled

    @ti.func
    def append_if_near(chunk, slot, i, j, skin, turned, pose):
        """Along a sheared gradient only those whose nearest image is in the row of cells that is looked at."""
        filled = slot
        first, last = chunk * chunk_size, (chunk + 1) * chunk_size
        if j > i or (j < first) or (j >= last):
            between = apart(particles.position[i], particles.position[j], pose)
            reach, meant_so = particles.radius[i] + particles.radius[j] + skin, True
            if ti.static(sheared):
                meant_so = turn(particles.position[i], particles.position[j]) == turned
                reach += ti.cast(ti.abs(turned), real) * skin
            if between.dot(between) < reach * reach and meant_so and can_meet(i, j):
                filled = append(chunk, filled, i, j)
        return filled

    @ti.func
    def near_grains(chunk, slot, i, skin):
        """All in the cells around."""
        filled, cells = slot, sorting.cells[0]
        x, y, z = place(particles.position[i])
        first_x, end_x = around(x, cells, 0)
        first_y, end_y = around(y, cells, 1)
        first_z, end_z = around(z, cells, 2)
        for next_z in range(first_z, end_z):
            for next_y in range(first_y, end_y):
                for next_x in range(first_x, end_x):
                    cell = number(meant(next_x, cells, 0), meant(next_y, cells, 1), meant(next_z, cells, 2), cells)
                    for j in range(sorting.cell_start[cell], sorting.cell_start[cell + 1]):
                        filled = append_if_near(chunk, filled, i, j, skin, 0, 0)
        return filled

    @ti.func
    def near_grains_by_class(chunk, slot, i, skin, pose):
        """Class by class, those in the cells that one of the class can reach from, row of images by row of images."""
        filled = slot
        for group in range(classes):
            cells, reach = sorting.cells[group], particles.radius[i] + sorting.radius[group] + skin
            if ti.static(sheared):
                reach += skin
            for turned in range(-images, images + 1):
                first, end = within(seen_from(particles.position[i], turned, pose), reach, group)
                for next_z in range(first[2], end[2]):
                    for next_y in range(first[1], end[1]):
                        for next_x in range(first[0], end[0]):
                            cell = number(
                                meant(next_x, cells, 0), meant(next_y, cells, 1), meant(next_z, cells, 2), cells
                            )
                            cell += sorting.first_cell[group]
                            for k in range(sorting.listed_start[cell], sorting.listed_start[cell + 1]):
                                filled = append_if_near(chunk, filled, i, sorting.listed[k], skin, turned, pose)
        return filled

    @ti.func
    def fill_row(chunk, slot, i, skin, pose):
        filled = slot
        if ti.static(wall_count > 0):
            filled = near_walls(chunk, filled, i, skin, pose)
        contacts.row_middle[i] = filled
        if ti.static(by_class):
            filled = near_grains_by_class(chunk, filled, i, skin, pose)
        else:
            filled = near_grains(chunk, filled, i, skin)
        return filled

    @ti.kernel
    def rows(count: ti.i32, skin: real, pose: ti.i32):
        state.control.search_due[0] = 0
        state.control.search_wanted[0] = 0
        state.control.slots_needed[0] = 0
        for task in range((count + chunk_size - 1) // chunk_size * stride):
            if task % stride == 0:
                chunk = task // stride
                slot = chunk * slots
                for i in range(chunk * chunk_size, ti.min((chunk + 1) * chunk_size, count)):
                    particles.position_at_search[i] = particles.position[i]
                    contacts.row_begin[i] = slot
                    slot = fill_row(chunk, slot, i, skin, pose)
                    contacts.row_end[i] = slot
                ti.atomic_max(state.control.slots_needed[0], slot - chunk * slots)

    return rows
