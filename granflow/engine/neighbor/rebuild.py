"""Rebuild of the neighbor lists: wrap, sort and delete particles, then fill the lists."""

from collections.abc import Callable

from granflow.engine.neighbor.cell_grid import update_cell_grids
from granflow.engine.neighbor.cell_sort import build_bounds, build_class_lists, build_reorder, build_sort
from granflow.engine.neighbor.deletion import check_coordinates
from granflow.engine.neighbor.neighbor_list import build_neighbor_list
from granflow.engine.neighbor.saved_history import build_save_history
from granflow.engine.periodic_box import build_wrap_all
from granflow.engine.state import State
from granflow.engine.wall_dynamics import mark_rebuild
from granflow.plan.capacities import BOUNDS, REACH_STEPS, list_capacity_for


class NeighborListRebuild:
    """The kernels of a rebuild, in order.

    state:       device data
    on_deleted:  receives the index range (first, last), `last` exclusive, of the particles to delete, before they are
                 deleted
    grow:        increases the list capacity per chunk to at least a number of entries and compiles all kernels again
    """

    def __init__(self, state: State, on_deleted: Callable[[int, int], None], grow: Callable[[int], None]) -> None:
        self._state, self._on_deleted, self._grow = state, on_deleted, grow
        self._reach = 0.5 * state.plan.skin

    @property
    def _reach_time(self) -> float:
        """Time [s] for which the reach of a particle allows for its velocity."""
        return REACH_STEPS * self._state.clock.time_step

    def compile(self) -> None:
        """Compile the kernels by launching them on empty ranges."""
        state = self._state
        self._wrap = build_wrap_all(state) if state.plan.features.periodic != "none" else None
        self._bounds, self._sort, self._reorder = build_bounds(state), build_sort(state), build_reorder(state)
        self._sort_classes = build_class_lists(state) if state.cell_sort.class_order is not None else None
        self._fill = build_neighbor_list(state)
        self._save = build_save_history(state) if state.neighbors.history else None
        self._bounds(0, 0.0, 0.0)
        if self._wrap is not None:
            self._wrap(0, 0, 1.0)
        self._sort(0, 0)
        if self._sort_classes is not None:
            self._sort_classes(0, 0)
        self._reorder(0)
        self._fill(0, 0.0, 0.0, 0)
        if self._save is not None:
            self._save(0)

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
        if self._wrap is not None:
            self._wrap(state.count, pose, state.clock.time_step)
        self._bounds(state.count, state.plan.skin, self._reach_time)
        self._reach = float(state.cell_sort.reach.to_numpy()[: min(state.count, BOUNDS)].max())
        if state.plan.domain.on_exit == "expand":
            check_coordinates(state)
        grids = update_cell_grids(state, self._reach)
        self._sort(state.count, grids[0].cell_count)
        self._save_history()
        self._reorder(state.count)
        # Deleted particles are in the last cell, behind all others.
        present = int(state.cell_sort.cell_start[grids[0].cell_count])
        if self._sort_classes is not None:
            self._sort_classes(present, sum(grid.cell_count for grid in grids))
        return state.count - present

    def _save_history(self) -> None:
        """Copy the contact histories to `saved`; increase the list capacity and repeat if they do not fit."""
        while self._save is not None:
            self._save(self._state.count)
            needed = int(self._state.control.list_length_needed[0])
            if needed <= self._state.neighbors.history_capacity_per_chunk:
                return
            self._grow(list_capacity_for(needed))

    def _fill_lists(self, pose: int) -> None:
        """Fill the neighbor lists; increase the list capacity and repeat if they do not fit."""
        while True:
            self._fill(self._state.count, self._state.plan.skin, self._reach, pose)
            needed = int(self._state.control.list_length_needed[0])
            if needed <= self._state.neighbors.list_capacity_per_chunk:
                return
            self._grow(needed)
