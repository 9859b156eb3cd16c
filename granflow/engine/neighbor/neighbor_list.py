"""Neighbor list (Verlet list): sorts particles in cell order, then builds the list of each particle.

Integers or a fixed order of the sums determine all results: identical bits for any number of threads.
"""

from collections.abc import Callable
from typing import Any

import taichi as ti

from granflow.engine.frozen_masks import build_can_touch
from granflow.engine.mesh import build_mesh_geometry
from granflow.engine.neighbor.cell_grid import build_cell_number
from granflow.engine.neighbor.deletion import build_remains
from granflow.engine.periodic_box import build_image_index, build_minimum_image, build_shift_by_images
from granflow.engine.state import SCAN_BLOCK, State
from granflow.engine.walls import build_wall_geometry
from granflow.plan.capacities import BOUNDS

ROUNDING = 1e-5
"""Relative margin of the cell range of the search, because cell coordinates are rounded."""


def build_bounds(state: State) -> Callable[[int], None]:
    """Kernel (count): bounding boxes of BOUNDS parts of the particle list; part p contains p, p + BOUNDS, ...

    Reads:   position
    Writes:  low, high of the cell sort
    """
    position, low, high = state.particles.position, state.cell_sort.low, state.cell_sort.high

    @ti.kernel
    def bounds(count: ti.i32):
        for part in range(BOUNDS):
            start = position[ti.min(part, ti.max(count - 1, 0))]
            smallest, largest = start, start
            for row in range((count - part + BOUNDS - 1) // BOUNDS):
                here = position[part + row * BOUNDS]
                smallest, largest = ti.min(smallest, here), ti.max(largest, here)
            low[part], high[part] = smallest, largest

    return bounds


def build_cell_of_point(state: State) -> Any:
    """Device function (point, grid number) -> (x, y, z): cell that contains the point, or the nearest cell of the grid.

    Reads:  grid_low, cell_side, cells
    """
    sorting, real = state.cell_sort, state.backend.position_real

    @ti.func
    def cell_of_point(point, grid=0):
        p, cells = (point - sorting.grid_low[grid]) / sorting.cell_side[grid], sorting.cells[grid]
        last = ti.cast(cells, real) - 1.0
        x = ti.cast(ti.max(ti.min(p[0], last[0]), 0.0), ti.i32)
        y = ti.cast(ti.max(ti.min(p[1], last[1]), 0.0), ti.i32)
        z = ti.cast(ti.max(ti.min(p[2], last[2]), 0.0), ti.i32)
        return x, y, z

    return cell_of_point


def build_adjacent_cells(state: State) -> tuple[Any, Any]:
    """Device functions (cell, cells, axis) for the cells adjacent to one along an axis.

    first:   begin and end of the range of adjacent cells, which may extend beyond the grid along a periodic axis
    second:  the cell of a coordinate outside the grid

    Along a periodic axis the first and the last cell are adjacent; with fewer than three cells, all are.
    """
    periodic = state.plan.periodic_box.axes

    @ti.func
    def adjacent_cells(cell, cells, axis: ti.template()):
        first, end = cell - 1, cell + 2
        if ti.static(axis in periodic):
            if cells[axis] < 3:
                first, end = 0, cells[axis]
        else:
            first, end = ti.max(first, 0), ti.min(end, cells[axis])
        return first, end

    @ti.func
    def wrapped_cell(cell, cells, axis: ti.template()):
        found = cell
        if ti.static(axis in periodic):
            found = (cell + cells[axis]) % cells[axis]
        return found

    return adjacent_cells, wrapped_cell


def build_cells_within(state: State) -> Any:
    """Device function (point, reach, grid number): range of cells along each axis that a sphere intersects.

    reach:    radius of the sphere [m], enlarged by ROUNDING
    Returns:  first cells and end of the range along the axes, 3-vectors of integers

    Along a periodic axis the range may extend beyond the grid, but contains no cell twice. Images along a sheared
    gradient are searched separately.
    """
    sorting, real, periodic_box = state.cell_sort, state.backend.position_real, state.plan.periodic_box
    gradient = -1 if periodic_box.image_motion is None else periodic_box.image_motion.gradient
    periodic = [axis for axis in periodic_box.axes if axis != gradient]
    slack = 1.0 + ROUNDING

    @ti.func
    def cells_within(point, reach, grid):
        middle = (point - sorting.grid_low[grid]) / sorting.cell_side[grid]
        reach_in_cells, cells = slack * reach / sorting.cell_side[grid], sorting.cells[grid]
        lowest, highest = ti.floor(middle - reach_in_cells), ti.floor(middle + reach_in_cells)
        for axis in ti.static(range(3)):
            if ti.static(axis in periodic):
                if highest[axis] - lowest[axis] >= cells[axis] - 1:
                    lowest[axis], highest[axis] = 0.0, ti.cast(cells[axis], real) - 1.0
            elif ti.static(axis == gradient):
                lowest[axis] = ti.max(lowest[axis], 0.0)
                highest[axis] = ti.min(highest[axis], ti.cast(cells[axis], real) - 1.0)
            else:
                last = ti.cast(cells[axis], real) - 1.0
                lowest[axis] = ti.max(ti.min(lowest[axis], last), 0.0)
                highest[axis] = ti.max(ti.min(highest[axis], last), 0.0)
        return ti.cast(lowest, ti.i32), ti.cast(highest, ti.i32) + 1

    return cells_within


def build_sort(state: State) -> Callable[..., None]:
    """Kernel (count, cells): order of the particles by cell, by id within a cell; deleted particles come last.

    The order is unique, because ids are: it does not depend on the threads.

    Reads:   position, id
    Writes:  cell_start, order
    """
    particles, sorting = state.particles, state.cell_sort
    cell_number, remains, cell_of_point = build_cell_number(), build_remains(state), build_cell_of_point(state)

    @ti.func
    def cell_of(i, cells):
        cell = cells - 1
        if remains(i):
            x, y, z = cell_of_point(particles.position[i])
            cell = cell_number(x, y, z, sorting.cells[0])
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
    particles, sorting = state.particles, state.cell_sort
    cell_number, cell_of_point, class_of = build_cell_number(), build_cell_of_point(state), build_class_of(state)

    @ti.func
    def cell_of(i, cells):
        group = class_of(particles.radius[i])
        x, y, z = cell_of_point(particles.position[i], group)
        return sorting.first_cell[group] + cell_number(x, y, z, sorting.cells[group])

    @ti.func
    def key(i):
        return i

    return _build_counting_sort(state, cell_of, key, sorting.class_start, sorting.class_order)


def build_class_of(state: State) -> Any:
    """Device function (radius [m]): number of the size class, from 0 for the smallest."""
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
            rank = ti.atomic_add(sorting.cell_fill[cell], 1)
            order[start[cell] + rank] = i
        for c in range(cells):
            order_by_key(start[c], start[c + 1])

    @ti.func
    def order_by_key(begin, end):
        """Insertion sort of order[begin:end] by key."""
        for k in range(begin + 1, end):
            moving = order[k]
            rank = k
            while rank > begin and key(order[ti.max(rank - 1, 0)]) > key(moving):
                order[rank] = order[rank - 1]
                rank -= 1
            order[rank] = moving

    return sort


def build_reorder(state: State) -> Callable[[int], None]:
    """Kernel (count): move all particle fields to the new order, one field after the other.

    `position_at_rebuild` and `coordination` serve as buffers; both are written again before they are read.

    Reads:   order
    Writes:  all fields of `Particles.sorted_fields`
    """
    sorting, particles, fields = state.cell_sort, state.particles, state.particles.sorted_fields()
    vectors = [field for field in fields if isinstance(field, ti.MatrixField)]
    integers = [field for field in fields if field.dtype == ti.i32]
    scalars = [field for field in fields if not isinstance(field, ti.MatrixField) and field.dtype != ti.i32]
    vector, integer = particles.position_at_rebuild, particles.coordination

    @ti.kernel
    def reorder_vectors(count: ti.i32):
        for f in ti.static(range(len(vectors))):
            for k in range(count):
                vector[k] = ti.cast(vectors[f][sorting.order[k]], vector.dtype)
            for k in range(count):
                vectors[f][k] = ti.cast(vector[k], vectors[f].dtype)

    @ti.kernel
    def reorder_scalars(count: ti.i32):
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

    def reorder(count: int) -> None:
        reorder_vectors(count)
        reorder_scalars(count)

    return reorder


def build_save_history(state: State) -> Callable[[int], None]:
    """Kernel (count): copy history entries to `saved`, where `restore_history` finds them.

    `list_length_needed`: largest number of history entries of a chunk; entries beyond the capacity are not saved, and
    the host repeats the kernel with a larger capacity.

    Reads:   neighbor lists, in_contact, history
    Writes:  saved, partner_saved, list_begin_before, list_end_before, list_length_needed
    """
    neighbors, names, stride = state.neighbors, list(state.neighbors.history), state.stride
    chunk_size, history_capacity = state.plan.chunk_size, neighbors.history_capacity_per_chunk

    @ti.func
    def save_entry(list_index, saved_index):
        neighbors.partner_saved[saved_index] = neighbors.partner[list_index]
        for name in ti.static(names):
            neighbors.saved[name][saved_index] = neighbors.history[name][list_index]

    @ti.kernel
    def save_history(count: ti.i32):
        state.control.list_length_needed[0] = 0
        for task in range((count + chunk_size - 1) // chunk_size * stride):
            if task % stride == 0:
                chunk = task // stride
                saved_index = chunk * history_capacity
                for i in range(chunk * chunk_size, ti.min((chunk + 1) * chunk_size, count)):
                    neighbors.list_begin_before[i] = saved_index
                    for list_index in range(neighbors.list_begin[i], neighbors.list_end[i]):
                        if neighbors.in_contact[list_index] == 1:
                            if saved_index < (chunk + 1) * history_capacity:
                                save_entry(list_index, saved_index)
                            saved_index += 1
                    neighbors.list_end_before[i] = saved_index
                ti.atomic_max(state.control.list_length_needed[0], saved_index - chunk * history_capacity)

    return save_history


def build_restore_history(state: State) -> Any:
    """Device function (list index, i, j): copy the history of a pair from before the sort to its new list entry.

    If the pair was in the list of the partner, vectors change their sign. Without a saved history all values are zero.

    Reads:   order, saved, partner_saved
    Writes:  history, in_contact
    """
    neighbors, sorting, chunk_size = state.neighbors, state.cell_sort, state.plan.chunk_size
    names = list(neighbors.history)
    is_vector = {name: [each.size > 1 for each in state.plan.laws.history[name] for _ in range(each.size)]
                 for name in names}  # fmt: skip

    @ti.func
    def find_saved(row, partner):
        """Index in `saved` of a partner of the particle `row`; -1 if none. Both are indices before the sort."""
        found = -1
        for list_index in range(neighbors.list_begin_before[row], neighbors.list_end_before[row]):
            if neighbors.partner_saved[list_index] == partner:
                found = list_index
        return found

    @ti.func
    def restore_history(list_index, i, j):
        i_before = sorting.order[i]
        j_before = j
        if j >= 0:
            j_before = sorting.order[j]
        source = find_saved(i_before, j_before)
        sign = 1.0
        if source < 0 and j >= 0 and i_before // chunk_size == j_before // chunk_size:
            source = find_saved(j_before, i_before)
            sign = -1.0
        neighbors.in_contact[list_index] = ti.cast(source >= 0, ti.i32)
        for name in ti.static(names):
            neighbors.history[name][list_index] = 0.0 * neighbors.history[name][list_index]
            if source >= 0:
                for k, changes_sign in ti.static(enumerate(is_vector[name])):
                    value = neighbors.saved[name][source][k]
                    if ti.static(changes_sign):
                        value = sign * value
                    neighbors.history[name][list_index][k] = value

    return restore_history


def build_neighbor_list(state: State) -> Callable[..., None]:
    """Kernel (count, skin, pose): fill the neighbor lists with all particles and walls nearer than the skin [m].

    Reads:   position, radius, cell_start, walls
    Writes:  list_begin, list_end, partner, history, list_length_needed, position_at_rebuild, rebuild_due
    """
    plan, particles, sorting, neighbors = state.plan, state.particles, state.cell_sort, state.neighbors
    real, chunk_size, list_capacity = state.backend.position_real, plan.chunk_size, neighbors.list_capacity_per_chunk
    wall_count, has_history, stride = len(plan.walls), bool(neighbors.history), state.stride
    cell_number, cell_of_point, minimum_image = (
        build_cell_number(),
        build_cell_of_point(state),
        build_minimum_image(state),
    )
    adjacent_cells, wrapped_cell = build_adjacent_cells(state)
    classes, cells_within = len(plan.size_classes), build_cells_within(state)
    sheared, by_class = plan.features.lees_edwards, sorting.class_order is not None
    image_range, image_index = int(sheared), build_image_index(state) if sheared else None
    shift_by_images = build_shift_by_images(state)
    geometry, has_mesh = build_wall_geometry(state), plan.features.mesh_walls
    mesh = build_mesh_geometry(state) if has_mesh else None
    restore_history = build_restore_history(state) if has_history else None
    can_touch = build_can_touch(state)

    @ti.func
    def append(chunk, list_index, i, j):
        if list_index < (chunk + 1) * list_capacity:
            neighbors.partner[list_index] = j
            if ti.static(has_history):
                restore_history(list_index, i, j)
        return list_index + 1

    @ti.func
    def append_walls(chunk, list_index, i, skin, pose):
        """Append the walls, and the triangles of meshes, within the skin."""
        list_end, reach = list_index, particles.radius[i] + skin
        for w in range(wall_count):
            if state.walls.present[w] == 1 and can_touch(i, -1 - w):
                if ti.static(has_mesh):
                    list_end = append_triangles(chunk, list_end, i, w, skin, pose)
                if geometry.distance(w, pose, particles.position[i]) < reach:
                    list_end = append(chunk, list_end, i, -1 - w)
        return list_end

    @ti.func
    def append_triangles(chunk, list_index, i, w, skin, pose):
        """Append the triangles of a mesh that are within the skin and may own a contact."""
        list_end, reach = list_index, particles.radius[i] + skin
        local = geometry.to_wall_frame(w, pose, particles.position[i])
        begin, end = mesh.cell(w, local)
        for k in range(begin, end):
            t = state.mesh.cell_triangles[k]
            if mesh.may_own(t, local, skin) == 1 and mesh.from_nearest(t, local).norm() < reach:
                list_end = append(chunk, list_end, i, -1 - wall_count - t)
        return list_end

    @ti.func
    def append_if_near(chunk, list_index, i, j, skin, image, pose):
        """Along a sheared gradient, append only partners whose nearest image is the searched one."""
        list_end = list_index
        first, last = chunk * chunk_size, (chunk + 1) * chunk_size
        if j > i or (j < first) or (j >= last):
            branch = minimum_image(particles.position[i], particles.position[j], pose)
            reach, is_nearest_image = particles.radius[i] + particles.radius[j] + skin, True
            if ti.static(sheared):
                is_nearest_image = image_index(particles.position[i], particles.position[j]) == image
                reach += ti.cast(ti.abs(image), real) * skin
            if branch.dot(branch) < reach * reach and is_nearest_image and can_touch(i, j):
                list_end = append(chunk, list_end, i, j)
        return list_end

    @ti.func
    def append_particles(chunk, list_index, i, skin):
        """Append partners from the adjacent cells."""
        list_end, cells = list_index, sorting.cells[0]
        x, y, z = cell_of_point(particles.position[i])
        first_x, end_x = adjacent_cells(x, cells, 0)
        first_y, end_y = adjacent_cells(y, cells, 1)
        first_z, end_z = adjacent_cells(z, cells, 2)
        for next_z in range(first_z, end_z):
            for next_y in range(first_y, end_y):
                for next_x in range(first_x, end_x):
                    cell = cell_number(
                        wrapped_cell(next_x, cells, 0),
                        wrapped_cell(next_y, cells, 1),
                        wrapped_cell(next_z, cells, 2),
                        cells,
                    )
                    for j in range(sorting.cell_start[cell], sorting.cell_start[cell + 1]):
                        list_end = append_if_near(chunk, list_end, i, j, skin, 0, 0)
        return list_end

    @ti.func
    def append_particles_by_class(chunk, list_index, i, skin, pose):
        """Append partners class by class, from the cells within reach, separately for each image along a gradient."""
        list_end = list_index
        for group in range(classes):
            cells, reach = sorting.cells[group], particles.radius[i] + sorting.radius[group] + skin
            if ti.static(sheared):
                reach += skin
            for image in range(-image_range, image_range + 1):
                first, end = cells_within(shift_by_images(particles.position[i], image, pose), reach, group)
                for next_z in range(first[2], end[2]):
                    for next_y in range(first[1], end[1]):
                        for next_x in range(first[0], end[0]):
                            cell = cell_number(
                                wrapped_cell(next_x, cells, 0),
                                wrapped_cell(next_y, cells, 1),
                                wrapped_cell(next_z, cells, 2),
                                cells,
                            )
                            cell += sorting.first_cell[group]
                            for k in range(sorting.class_start[cell], sorting.class_start[cell + 1]):
                                list_end = append_if_near(chunk, list_end, i, sorting.class_order[k], skin, image, pose)
        return list_end

    @ti.func
    def fill_list(chunk, list_index, i, skin, pose):
        list_end = list_index
        if ti.static(wall_count > 0):
            list_end = append_walls(chunk, list_end, i, skin, pose)
        neighbors.list_walls_end[i] = list_end
        if ti.static(by_class):
            list_end = append_particles_by_class(chunk, list_end, i, skin, pose)
        else:
            list_end = append_particles(chunk, list_end, i, skin)
        return list_end

    @ti.kernel
    def fill_neighbor_list(count: ti.i32, skin: real, pose: ti.i32):
        state.control.rebuild_due[0] = 0
        state.control.rebuild_requested[0] = 0
        state.control.list_length_needed[0] = 0
        for task in range((count + chunk_size - 1) // chunk_size * stride):
            if task % stride == 0:
                chunk = task // stride
                list_index = chunk * list_capacity
                for i in range(chunk * chunk_size, ti.min((chunk + 1) * chunk_size, count)):
                    particles.position_at_rebuild[i] = particles.position[i]
                    neighbors.list_begin[i] = list_index
                    list_index = fill_list(chunk, list_index, i, skin, pose)
                    neighbors.list_end[i] = list_index
                ti.atomic_max(state.control.list_length_needed[0], list_index - chunk * list_capacity)

    return fill_neighbor_list
