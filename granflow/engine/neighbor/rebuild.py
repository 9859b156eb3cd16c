"""Rebuild of the neighbor lists: wrap, sort and delete particles, then fill the lists."""

from collections.abc import Callable

from granflow.engine.neighbor.cell_grid import update_cell_grids
from granflow.engine.neighbor.cell_sort import build_bounds, build_class_lists, build_reorder, build_sort
from granflow.engine.neighbor.deletion import check_coordinates
from granflow.engine.neighbor.neighbor_list import TOO_LONG, build_neighbor_list
from granflow.engine.neighbor.saved_history import build_save_history
from granflow.engine.periodic_box import build_wrap
from granflow.engine.state import State
from granflow.engine.wall_dynamics import mark_rebuild
from granflow.plan.capacities import list_capacity_for


class RebuildKernels:
    """The kernels of a rebuild; None if the plan does not need one."""

    def __init__(self, state: State) -> None:
        self.wrap = build_wrap(state) if state.plan.features.periodic != "none" else None
        self.bounds, self.sort, self.reorder = build_bounds(state), build_sort(state), build_reorder(state)
        self.sort_classes = build_class_lists(state) if state.cell_sort.class_order is not None else None
        self.fill = build_neighbor_list(state)
        self.save = build_save_history(state) if state.neighbors.history else None


class NeighborListRebuild:
    """A rebuild of the neighbor lists.

    state:       device data
    on_deleted:  receives the index range (first, last), `last` exclusive, of the particles to delete, before they are
                 deleted
    grow:        increases the list entries per chunk, and the batch, to at least these numbers and compiles all kernels
                 again
    """

    def __init__(self, state: State, on_deleted: Callable[[int, int], None], grow: Callable[[int, int], None]) -> None:
        self._state, self._on_deleted, self._grow = state, on_deleted, grow

    def compile(self) -> None:
        """Compile the kernels, unless the state has them, by launching them on empty ranges."""
        self._kernels = kernels = self._state.built(RebuildKernels)
        kernels.bounds(0)
        if kernels.wrap is not None:
            kernels.wrap(0, 0, 0, 1.0)
        kernels.sort(0, 0)
        if kernels.sort_classes is not None:
            kernels.sort_classes(0, 0)
        kernels.reorder(0)
        kernels.fill(0, 0, 0.0, 0)
        if kernels.save is not None:
            kernels.save(0, 0)

    def run(self, pose: int) -> None:
        """Sort the particles, delete those outside the domain or in an outlet, and fill the neighbor lists.

        `pose`: index of the wall poses at the time of the positions.
        """
        state = self._state
        if state.count:
            deleted = self._sort_particles(pose)
            if deleted:
                self._on_deleted(state.count - deleted, state.count)
                state.count -= deleted
        mark_rebuild(state)  # displacements of walls count from here
        self._fill_lists(pose)

    def _sort_particles(self, pose: int) -> int:
        """Sort the particles in cell order, with their contact histories saved.

        Returns the number of particles to delete, which are behind the others.
        """
        state = self._state
        if self._kernels.wrap is not None:
            self._kernels.wrap(state.chunk_count, state.count, pose, state.clock.time_step)
        self._kernels.bounds(state.count)
        if state.plan.domain.on_exit == "expand":
            check_coordinates(state)
        grids = update_cell_grids(state)
        self._kernels.sort(state.count, grids[0].cell_count)
        self._save_history()
        self._kernels.reorder(state.count)
        # Deleted particles are in the last cell, behind all others.
        present = int(state.cell_sort.cell_start[grids[0].cell_count])
        if self._kernels.sort_classes is not None:
            self._kernels.sort_classes(present, sum(grid.cell_count for grid in grids))
        return state.count - present

    def _save_history(self) -> None:
        """Copy the contact histories to `saved`; increase the list capacity and repeat if they do not fit."""
        while self._kernels.save is not None:
            self._kernels.save(self._state.chunk_count, self._state.count)
            needed = int(self._state.control.list_length_needed[0])
            if needed <= self._state.capacities.saved_entries_per_chunk:
                return
            self._grow(list_capacity_for(needed), 0)

    def _fill_lists(self, pose: int) -> None:
        """Fill the neighbor lists; increase the list capacity and repeat if they do not fit."""
        while True:
            plan, count = self._state.plan, self._state.count
            self._kernels.fill(self._state.chunk_count, count, plan.skin + plan.laws.range, pose)
            needed = int(self._state.control.list_length_needed[0])
            if needed <= self._state.capacities.list_entries_per_chunk:
                return
            too_long, length = divmod(needed, TOO_LONG)
            self._grow(length, length * too_long)
