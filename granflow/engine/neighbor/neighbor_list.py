"""Neighbor list (Verlet list): candidate pairs of each particle, found in the cells around it.

The order of the cells and of their particles determines that of each list: identical bits for any number of threads.
"""

from typing import Any

from granflow.engine.frozen_masks import build_can_touch
from granflow.engine.mesh import from_nearest, may_own, triangle_range
from granflow.engine.neighbor.cells import (
    BLOCK_SIDE,
    adjacent_cells,
    cell_number,
    cell_of_point,
    cells_within,
    wrapped_cell,
)
from granflow.engine.neighbor.history_transfer import build_restore_history
from granflow.engine.neighbor.phases import is_count
from granflow.engine.periodic_box import build_image_index, build_minimum_image, build_shift_by_images
from granflow.engine.state import State
from granflow.engine.walls import WallGeometry
from granflow.kernel_language import ti


class NeighborListFill:
    """Device functions that append the entries of one neighbor list.

    `owner`, a struct: index `i` of the particle, `first` and `end` of its chunk, `limit` of the list indices of the
    chunk, the `skin` [m], the largest `reach` [m] of all particles and the `pose` of the walls.
    Each function takes the list index of the next entry and returns the one after its last entry.
    """

    def __init__(self, state: State) -> None:
        plan, periodic_box = state.plan, state.plan.periodic_box
        self.state, self.plan, self.mesh = state, plan, state.mesh
        self.particles, self.neighbors, self.sorting = state.particles, state.neighbors, state.cell_sort
        self.sheared, self.by_class = plan.features.lees_edwards, state.cell_sort.class_order is not None
        self.image_range, self.class_count = int(plan.features.lees_edwards), state.parameter("class_count")
        self.gradient = -1 if periodic_box.image_motion is None else periodic_box.image_motion.gradient
        self.periodic = periodic_box.axes
        self.periodic_unsheared = tuple(axis for axis in periodic_box.axes if axis != self.gradient)
        self.geometry, self.can_touch = WallGeometry(state), build_can_touch(state)
        self.wall_count = state.parameter("wall_count")
        self.domain_low, self.domain_high, self.force_range = (
            state.parameter(name) for name in ("domain_low", "domain_high", "force_range")
        )
        self.restore_history: Any = build_restore_history(state) if state.neighbors.history else None
        self.minimum_image, self.shift_by_images = build_minimum_image(state), build_shift_by_images(state)
        self.image_index = build_image_index(state)

    @ti.func
    def fill(self, owner: ti.template(), list_index):
        """Append walls, then particles: contact forces evaluate the two kinds in separate loops."""
        list_end = list_index
        if ti.static(self.plan.has_walls):
            list_end = self._append_walls(owner, list_end)
        self.neighbors.list_walls_end[owner.i] = list_end
        return self._append_particles(owner, list_end)

    @ti.func
    def _append(self, owner: ti.template(), list_index, j):
        if list_index < owner.limit:
            self.neighbors.partner[list_index] = j
        return list_index + 1

    @ti.func
    def restore(self, owner: ti.template(), begin, end):
        """Restore the contact histories of a list of these entries."""
        if ti.static(len(self.neighbors.history) > 0):
            for list_index in range(begin, ti.min(end, owner.limit)):
                self.restore_history(list_index, owner.i, self.neighbors.partner[list_index])

    @ti.func
    def _slack(self, owner: ti.template()):
        """Gap [m] between particle and wall below which they are listed."""
        return self.particles.reach[owner.i] + 0.5 * owner.skin + self.force_range()

    @ti.func
    def _append_walls(self, owner: ti.template(), list_index):
        """Append the walls, and the triangles of meshes, within reach."""
        position, list_end = self.particles.position[owner.i], list_index
        reach = self.particles.radius[owner.i] + self._slack(owner)
        for w in range(self.wall_count()):
            if self.state.walls.present[w] == 1 and self.can_touch(owner.i, -1 - w):
                if ti.static(self.plan.features.mesh_walls):
                    list_end = self._append_triangles(owner, list_end, w)
                if self.geometry.distance(w, owner.pose, position) < reach:
                    list_end = self._append(owner, list_end, -1 - w)
        return list_end

    @ti.func
    def _append_triangles(self, owner: ti.template(), list_index, w):
        """Append the triangles of a mesh that are within reach and may own a contact.

        In a periodic box, also of a contact after the particle has crossed a boundary.
        """
        list_end, slack = list_index, self._slack(owner)
        position = self.geometry.wrap_position(self.particles.position[owner.i])
        for number in range(self.geometry.image_count):
            image, is_near = self.geometry.near_image(position, number, slack)
            if is_near:
                local = self.geometry.image_in_wall_frame(w, owner.pose, image)
                begin, end = triangle_range(self.mesh, w, local)
                for k in range(begin, end):
                    t = self.mesh.cell_triangles[k]
                    if self._first_image_at(owner, w, t, position, number) == number:
                        list_end = self._append(owner, list_end, -1 - self.wall_count() - t)
        return list_end

    @ti.func
    def _first_image_at(self, owner: ti.template(), w, t, position, last):
        """Number of the first image up to `last` that may have a contact with triangle t, or `last` + 1."""
        slack, number, found = self._slack(owner), 0, last + 1
        reach = self.particles.radius[owner.i] + slack
        while number <= last and found > last:
            image, is_near = self.geometry.near_image(position, number, slack)
            if is_near:
                local = self.geometry.image_in_wall_frame(w, owner.pose, image)
                if may_own(self.mesh, t, local, slack) == 1 and from_nearest(self.mesh, t, local).norm() < reach:
                    found = number
            number += 1
        return found

    @ti.func
    def _append_particles(self, owner: ti.template(), list_index):
        """Append partners from the cells within reach, class by class; separately for each image along a gradient."""
        list_end, position = list_index, self.particles.position[owner.i]
        if ti.static(self.by_class):
            for grid in range(self.class_count()):
                reach = self.particles.radius[owner.i] + self.sorting.radius[grid] + self.force_range()
                reach += self.particles.reach[owner.i] + owner.reach
                if ti.static(self.sheared):
                    reach += owner.skin
                for image in range(-self.image_range, self.image_range + 1):
                    point = self.shift_by_images(position, image, owner.pose)
                    first, end = cells_within(self.sorting, self.periodic_unsheared, self.gradient, grid, point, reach)
                    list_end = self._append_cells(owner, list_end, grid, first, end, image)
        else:
            first, end = adjacent_cells(self.periodic, cell_of_point(self.sorting, 0, position), self.sorting.cells[0])
            list_end = self._append_cells(owner, list_end, 0, first, end, 0)
        return list_end

    @ti.func
    def _append_cells(self, owner: ti.template(), list_index, grid, first, end, image):
        """Append partners from a range of cells of a grid."""
        list_end, cells, z = list_index, self.sorting.cells[grid], first[2]
        while (z < end[2]) & is_count(list_end):
            y = first[1]
            while (y < end[1]) & is_count(list_end):
                x = first[0]
                while x < end[0]:
                    cell = wrapped_cell(self.periodic, ti.Vector([x, y, z]), cells)
                    # Cells along x are consecutive within a block: their particles are one range.
                    count = ti.min(end[0] - x, cells[0] - cell[0], BLOCK_SIDE - cell[0] % BLOCK_SIDE)
                    list_end = self._append_range(owner, list_end, grid, cell_number(cell, cells), count, image)
                    x += count
                y += 1
            z += 1
        return list_end

    @ti.func
    def _append_range(self, owner: ti.template(), list_index, grid, cell, count, image):
        """Append partners from `count` consecutive cells of a grid."""
        list_end, k = list_index, 0
        if ti.static(self.by_class):
            begin = self.sorting.first_cell[grid] + cell
            k = self.sorting.class_start[begin]
            while (k < self.sorting.class_start[begin + count]) & is_count(list_end):
                list_end = self._append_if_near(owner, list_end, self.sorting.class_order[k], image)
                k += 1
        else:
            k = self.sorting.cell_start[cell]
            while (k < self.sorting.cell_start[cell + count]) & is_count(list_end):
                list_end = self._append_if_near(owner, list_end, k, image)
                k += 1
        return list_end

    @ti.func
    def _can_cross(self, position, skin):
        """True if a particle can cross a sheared face before the next rebuild; it is an image for others then."""
        axis = ti.static(self.gradient)
        return position[axis] < self.domain_low()[axis] + skin or position[axis] > self.domain_high()[axis] - skin

    @ti.func
    def _append_if_near(self, owner: ti.template(), list_index, j, image):
        """Append a partner in another chunk, or behind `i` in this one, if it is within reach.

        Along a sheared gradient, append only partners whose nearest image is the given one.
        """
        list_end, i, is_nearest_image = list_index, owner.i, True
        # A half list within a chunk, a full list across chunks: no two workers write to the same particle.
        if (j > i) | (j < owner.first) | (j >= owner.end):
            position, partner_position = self.particles.position[i], self.particles.position[j]
            branch = self.minimum_image(position, partner_position, owner.pose)
            reach = self.particles.radius[i] + self.particles.radius[j] + self.force_range()
            reach += self.particles.reach[i] + self.particles.reach[j]
            if ti.static(self.sheared):
                is_nearest_image = self.image_index(position, partner_position) == image
                # Up to the next rebuild the image moves by at most the skin, in addition to the particles.
                if image != 0 or self._can_cross(position, owner.skin) or self._can_cross(partner_position, owner.skin):
                    reach += owner.skin
            if branch.dot(branch) < reach * reach and is_nearest_image and self.can_touch(i, j):
                list_end = self._append(owner, list_end, j)
        return list_end
