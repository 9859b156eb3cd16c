"""Neighbor lists (Verlet lists): the candidate pairs of each particle, found in the cells around it.

The last phase of a rebuild fills them (`fill_phase`): a list holds all pairs that can come into contact
before the next rebuild. The order of the cells and of their particles determines that of each list: identical
bits for any number of threads.
"""

from granflow.engine.box import DeviceBox
from granflow.engine.codes import NOT_HALTED, PHASE_FORCES, PHASE_INTEGRATION
from granflow.engine.history import SavedHistory
from granflow.engine.neighbor.phases import Phase, is_count
from granflow.engine.neighbor.sort import BLOCK_SIDE, CellGrids, cell_number
from granflow.engine.state import State
from granflow.engine.walls import WallGeometry
from granflow.kernel_language import ti

TOO_LONG = 2**30
"""Added to the length of a chunk in which the list of a particle is too long for a batch.

`Control.list_length_needed` is one number for two phases of a rebuild and for this flag:

    1.  `history.SavedHistory.save` raises it to the largest number of history entries of a segment. If the
        saved histories do not fit, the rebuild ends there; otherwise it is set to 0 again
        (`rebuild._chunk_phases`).
    2.  `fill_phase` raises it to the largest number of list entries of a segment, plus TOO_LONG.

The host tells the two by `running`, see `NeighborListRebuild._launch`. If each particle is a chunk, all
particles share one segment, and the number is a sum instead of a maximum.
"""
NO_LIMIT = 2**31 - 1
"""Length of a list without batches."""


def fill_phase(state: State) -> Phase:
    """Fill the neighbor lists, chunk by chunk, with all pairs that can come into contact before the next
    rebuild.

    Two particles are listed if their gap is less than their reaches, a particle and a wall if it is less than
    the reach plus half the skin, by which walls may move. The range of forces at a distance is added to both.

    Entries beyond the capacity of a segment are not stored, and the host repeats this phase with a larger
    capacity, see `list_length_needed` at TOO_LONG.

    If each particle is a chunk, it counts its entries, reserves them by an atomic addition and then stores
    them. Their places depend on the threads; nothing depends on their places.

    Reads:   position, radius, reach, fixed, clump, cells and order of the cell sort, walls, mesh, saved
             history
    Writes:  list_begin, list_walls_end, list_end, partner, history, in_contact, list_length_needed, present,
             position_at_rebuild, rebuild_due, rebuild_requested, halted_at
    """
    lists = NeighborListFill(state)
    fill = lists.fill_one if state.plan.chunk_size == 1 else lists.fill_chunk
    return Phase(fill, state.plan.capacities.chunks, lists.chunk_count, per_task=1, serial=lists.finish)


class NeighborListFill:
    """Device functions of the phase that fills the lists, see `fill_phase`.

    `owner` of a list, a struct: index `i` of the particle, `first` and `end` of its chunk, `limit` of the
    list indices of the chunk, the `skin` [m], the `reach_largest` [m] of all particles and the `pose` of the
    walls. Functions that append entries take the list index of the next entry and return the one after their
    last entry.
    """

    def __init__(self, state: State) -> None:
        plan = state.plan
        self.plan = plan
        self.walls = state.walls
        self.mesh = state.mesh
        self.particles = state.particles
        self.neighbors = state.neighbors
        self.control = state.control
        self.sorting = state.cell_sort
        self.grids = state.built(CellGrids)
        self.geometry = state.built(WallGeometry)
        self.saved_history = state.built(SavedHistory)
        self.box = state.built(DeviceBox)
        self.chunk_size = state.parameter("chunk_size")
        self.list_capacity = state.parameter("list_capacity")
        self.class_count = state.parameter("class_count")
        self.wall_count = state.parameter("wall_count")
        self.domain_low = state.parameter("domain_low")
        self.domain_high = state.parameter("domain_high")
        self.force_range = state.parameter("force_range")
        self.longest_allowed = NO_LIMIT if state.batch is None else state.batch.longest_list
        self.can_halt = state.control.halted_at is not None
        self.by_class = state.cell_sort.class_order is not None
        self.sheared = plan.features.lees_edwards
        self.image_range = int(plan.features.lees_edwards)

    # The phase, chunk by chunk or particle by particle

    @ti.func
    def present_count(self, rebuild: ti.template()):
        """Number of particles with a neighbor list."""
        present = 0
        if rebuild.count > 0:
            if ti.static(self.plan.has_ghosts):
                present = self.sorting.owned_count[0]  # the lists of ghosts are on the ranks that own them
            else:
                # Deleted particles are in the cell behind the last.
                present = self.sorting.cell_start[self.sorting.cell_count[0]]
        return present

    @ti.func
    def chunk_count(self, rebuild: ti.template()):
        """Number of chunks with neighbor lists."""
        return (self.present_count(rebuild) + self.chunk_size() - 1) // self.chunk_size()

    @ti.func
    def fill_chunk(self, task: ti.template(), rebuild: ti.template()):
        """Fill the neighbor lists of a chunk."""
        first = task.index * self.chunk_size()
        end = (task.index + 1) * self.chunk_size()
        begin = task.index * self.list_capacity()
        limit = begin + self.list_capacity()
        list_index = begin
        longest = 0
        for i in range(first, ti.min(end, self.present_count(rebuild))):
            self.particles.position_at_rebuild[i] = self.particles.position[i]
            self.neighbors.list_begin[i] = list_index
            owner = ti.Struct(
                i=i,
                first=first,
                end=end,
                limit=limit,
                skin=rebuild.skin,
                reach_largest=self.sorting.reach_largest[0],
                pose=rebuild.pose,
            )
            list_index = self._append_partners(owner, list_index)
            self._restore(owner, self.neighbors.list_begin[i], list_index)
            self.neighbors.list_end[i] = list_index
            longest = ti.max(longest, list_index - self.neighbors.list_begin[i])
        excess = ti.cast(longest > self.longest_allowed, ti.i32) * TOO_LONG
        ti.atomic_max(self.control.list_length_needed[0], list_index - begin + excess)

    @ti.func
    def fill_one(self, task: ti.template(), rebuild: ti.template()):
        """Fill the neighbor list of one particle."""
        i = task.index
        self.particles.position_at_rebuild[i] = self.particles.position[i]
        begin = 0
        end = 0
        limit = 0
        for _ in range(2):  # a limit of 0 counts the entries
            owner = ti.Struct(
                i=i,
                first=i,
                end=i + 1,
                limit=limit,
                skin=rebuild.skin,
                reach_largest=self.sorting.reach_largest[0],
                pose=rebuild.pose,
            )
            end = self._append_partners(owner, begin)
            self._restore(owner, begin, end)
            if limit == 0:
                begin = ti.atomic_add(self.control.list_length_needed[0], end)
                limit = self.list_capacity()
        self.neighbors.list_begin[i] = begin
        self.neighbors.list_end[i] = end

    @ti.func
    def finish(self, rebuild: ti.template()):
        """Store the number of particles and reset the requests of a rebuild."""
        self.sorting.present[0] = self.present_count(rebuild)
        self.control.rebuild_due[0] = 0
        self.control.rebuild_requested[0] = 0
        if ti.static(self.can_halt):
            for phase in ti.static((PHASE_INTEGRATION, PHASE_FORCES)):
                self.control.halted_at[phase] = NOT_HALTED

    # One list

    @ti.func
    def _append_partners(self, owner: ti.template(), list_index):
        """Append walls, then particles: contact forces evaluate the two kinds in separate loops."""
        list_end = list_index
        if ti.static(self.plan.features.walls):
            list_end = self._append_walls(owner, list_end)
        self.neighbors.list_walls_end[owner.i] = list_end
        return self._append_particles(owner, list_end)

    @ti.func
    def _append(self, owner: ti.template(), list_index, j):
        if list_index < owner.limit:
            self.neighbors.partner[list_index] = j
        return list_index + 1

    @ti.func
    def _restore(self, owner: ti.template(), begin, end):
        """Restore the contact histories of a list of these entries."""
        if ti.static(len(self.neighbors.history) > 0):
            for list_index in range(begin, ti.min(end, owner.limit)):
                self.saved_history.restore(list_index, owner.i, self.neighbors.partner[list_index])

    @ti.func
    def _slack(self, owner: ti.template()):
        """Gap [m] between particle and wall below which they are listed."""
        return self.particles.reach[owner.i] + 0.5 * owner.skin + self.force_range()

    @ti.func
    def _append_walls(self, owner: ti.template(), list_index):
        """Append the walls, and the triangles of meshes, within the search radius."""
        position = self.particles.position[owner.i]
        list_end = list_index
        search_radius = self.particles.radius[owner.i] + self._slack(owner)
        for w in range(self.wall_count()):
            if self.walls.present[w] == 1 and self._can_touch(owner.i, -1 - w):
                if ti.static(self.plan.features.mesh_walls):
                    list_end = self._append_triangles(owner, list_end, w)
                if self.geometry.wall_distance(w, owner.pose, position) < search_radius:
                    list_end = self._append(owner, list_end, -1 - w)
        return list_end

    @ti.func
    def _append_triangles(self, owner: ti.template(), list_index, w):
        """Append the triangles of a mesh that are within the search radius and may own a contact.

        In a periodic box, also of a contact after the particle has crossed a boundary.
        """
        list_end = list_index
        slack = self._slack(owner)
        position = self.box.wrap_position(self.particles.position[owner.i])
        for number in range(self.geometry.image_count):
            image, is_near = self.box.near_image(position, number, slack)
            if is_near:
                local = self.geometry.image_in_wall_frame(w, owner.pose, image)
                begin, end = self.mesh.triangle_range(w, local)
                for k in range(begin, end):
                    t = self.mesh.cell_triangles[k]
                    if self._first_image_at(owner, w, t, position, number) == number:
                        list_end = self._append(owner, list_end, -1 - self.wall_count() - t)
        return list_end

    @ti.func
    def _first_image_at(self, owner: ti.template(), w, t, position, last):
        """Number of the first image up to `last` that may have a contact with triangle t, or `last` + 1."""
        slack = self._slack(owner)
        number = 0
        found = last + 1
        search_radius = self.particles.radius[owner.i] + slack
        while number <= last and found > last:
            image, is_near = self.box.near_image(position, number, slack)
            if is_near:
                local = self.geometry.image_in_wall_frame(w, owner.pose, image)
                if (
                    self.mesh.may_own(t, local, slack) == 1
                    and self.mesh.from_nearest(t, local).norm() < search_radius
                ):
                    found = number
            number += 1
        return found

    @ti.func
    def _append_particles(self, owner: ti.template(), list_index):
        """Append partners from the cells within the search radius, class by class; separately for each image
        along a gradient."""
        list_end = list_index
        position = self.particles.position[owner.i]
        if ti.static(self.by_class):
            for grid in range(self.class_count()):
                search_radius = self.particles.radius[owner.i] + self.sorting.radius[grid]
                search_radius += self.force_range()
                search_radius += self.particles.reach[owner.i] + owner.reach_largest
                if ti.static(self.sheared):
                    search_radius += owner.skin
                for image in range(-self.image_range, self.image_range + 1):
                    point = self.box.shift_by_images(position, image, owner.pose)
                    first, end = self.grids.cells_within(grid, point, search_radius)
                    list_end = self._append_cells(owner, list_end, grid, first, end, image)
        else:
            first, end = self.grids.adjacent_cells(0, position)
            list_end = self._append_cells(owner, list_end, 0, first, end, 0)
        return list_end

    @ti.func
    def _append_cells(self, owner: ti.template(), list_index, grid, first, end, image):
        """Append partners from a range of cells of a grid."""
        list_end = list_index
        cells = self.sorting.cells[grid]
        z = first[2]
        while (z < end[2]) & is_count(list_end):
            y = first[1]
            while (y < end[1]) & is_count(list_end):
                x = first[0]
                while x < end[0]:
                    cell = self.grids.wrapped_cell(ti.Vector([x, y, z]), cells)
                    # Cells along x are consecutive within a block: their particles are one range.
                    count = ti.min(end[0] - x, cells[0] - cell[0], BLOCK_SIDE - cell[0] % BLOCK_SIDE)
                    list_end = self._append_range(
                        owner, list_end, grid, cell_number(cell, cells), count, image
                    )
                    x += count
                y += 1
            z += 1
        return list_end

    @ti.func
    def _append_range(self, owner: ti.template(), list_index, grid, cell, count, image):
        """Append partners from `count` consecutive cells of a grid."""
        list_end = list_index
        k = 0
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
        """True if a particle can cross a sheared face before the next rebuild; it is an image for others
        then."""
        axis = ti.static(self.grids.gradient)
        return (
            position[axis] < self.domain_low()[axis] + skin
            or position[axis] > self.domain_high()[axis] - skin
        )

    @ti.func
    def _append_if_near(self, owner: ti.template(), list_index, j, image):
        """Append a partner in another chunk, or behind `i` in this one, if it is within the search radius.

        Along a sheared gradient, append only partners whose nearest image is the given one.
        """
        list_end = list_index
        i = owner.i
        is_nearest_image = True
        # A half list within a chunk, a full list across chunks: no two workers write to the same particle.
        if (j > i) | (j < owner.first) | (j >= owner.end):
            position = self.particles.position[i]
            partner_position = self.particles.position[j]
            branch = self.box.minimum_image(position, partner_position, owner.pose)
            search_radius = self.particles.radius[i] + self.particles.radius[j] + self.force_range()
            search_radius += self.particles.reach[i] + self.particles.reach[j]
            if ti.static(self.sheared):
                is_nearest_image = self.box.image_index(position, partner_position) == image
                # Up to the next rebuild the image moves by at most the skin, in addition to the particles.
                if (
                    image != 0
                    or self._can_cross(position, owner.skin)
                    or self._can_cross(partner_position, owner.skin)
                ):
                    search_radius += owner.skin
            is_near = branch.dot(branch) < search_radius * search_radius
            if is_near and is_nearest_image and self._can_touch(i, j):
                list_end = self._append(owner, list_end, j)
        return list_end

    @ti.func
    def _can_touch(self, i, j):
        """False for two fixed particles, a fixed particle and a wall (j < 0), two spheres of a clump, and a
        particle and a wall through which its group passes."""
        can = True
        if ti.static(self.plan.features.wall_groups):
            if j < 0:
                can = self.walls.holds[-1 - j, self.particles.group[i]] == 1
        if ti.static(self.plan.features.fixed_particles):
            if self.particles.fixed[i] == 1:
                can = j >= 0
                if j >= 0:
                    can = self.particles.fixed[j] == 0
        if ti.static(self.plan.features.clumps):
            if j >= 0:
                can = can and (
                    self.particles.clump[i] < 0 or self.particles.clump[i] != self.particles.clump[j]
                )
        return can
