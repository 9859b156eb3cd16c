"""Phase of a rebuild that fills the neighbor lists, chunk by chunk or particle by particle."""

from typing import Any

from granflow.engine.limits import FORCES, INTEGRATION, NOT_HALTED
from granflow.engine.neighbor.neighbor_list import NeighborListFill
from granflow.engine.neighbor.phases import Phase
from granflow.engine.state import State
from granflow.kernel_language import ti

TOO_LONG = 2**30
"""Added to the length of a chunk in which the list of a particle is too long for a batch."""

NO_LIMIT = 2**31 - 1
"""Length of a list without batches."""


def fill_phase(state: State) -> Phase:
    """Fill the neighbor lists, chunk by chunk, with all pairs that can come into contact before the next rebuild.

    Two particles are listed if their gap is less than their reaches, a particle and a wall if it is less than the reach
    plus half the skin, by which walls may move. The range of forces at a distance is added to both.

    `list_length_needed`: largest number of entries of a segment; entries beyond the capacity are not stored, and the
    host repeats this phase with a larger capacity. TOO_LONG is added if the batch is too short for one of the lists.

    If each particle is a chunk, it counts its entries, reserves them by an atomic addition and then stores them. Their
    places depend on the threads; nothing depends on their places.

    Reads:   position, radius, reach, fixed, cells and order of the cell sort, walls, mesh, saved history
    Writes:  list_begin, list_walls_end, list_end, partner, history, in_contact, list_length_needed, present,
             position_at_rebuild, rebuild_due, rebuild_requested, halted_at
    """
    present_count, chunk_size = _build_present_count(state), state.parameter("chunk_size")
    fill = _build_fill_one(state) if state.plan.chunk_size == 1 else _build_fill(state, present_count)

    @ti.func
    def chunk_count(rebuild: ti.template()):
        return (present_count(rebuild) + chunk_size() - 1) // chunk_size()

    return Phase(fill, state.plan.capacities.chunks, chunk_count, 1, _build_finish(state, present_count))


def _build_present_count(state: State) -> Any:
    """Device function (rebuild): number of particles with a neighbor list."""
    sorting, has_ghosts = state.cell_sort, state.plan.has_ghosts

    @ti.func
    def present_count(rebuild: ti.template()):
        present = 0
        if rebuild.count > 0:
            if ti.static(has_ghosts):
                present = sorting.owned_count[0]  # the lists of ghosts are on the ranks that own them
            else:
                present = sorting.cell_start[sorting.cell_count[0]]  # deleted particles are in the cell behind the last
        return present

    return present_count


def _build_fill(state: State, present_count: Any) -> Any:
    """Device function (task, rebuild): fill the neighbor lists of a chunk, see `fill_phase`."""
    particles, neighbors, control, sorting = state.particles, state.neighbors, state.control, state.cell_sort
    chunk_size, list_capacity = state.parameter("chunk_size"), state.parameter("list_capacity")
    lists, longest_allowed = NeighborListFill(state), NO_LIMIT
    if state.batch is not None:
        longest_allowed = state.batch.longest_list

    @ti.func
    def fill(task: ti.template(), rebuild: ti.template()):
        first, end = task.index * chunk_size(), (task.index + 1) * chunk_size()
        begin = task.index * list_capacity()
        limit, list_index, longest = begin + list_capacity(), begin, 0
        for i in range(first, ti.min(end, present_count(rebuild))):
            particles.position_at_rebuild[i] = particles.position[i]
            neighbors.list_begin[i] = list_index
            owner = ti.Struct(
                i=i, first=first, end=end, limit=limit, skin=rebuild.skin, reach=sorting.reach_largest[0],
                pose=rebuild.pose,
            )  # fmt: skip
            list_index = lists.fill(owner, list_index)
            lists.restore(owner, neighbors.list_begin[i], list_index)
            neighbors.list_end[i] = list_index
            longest = ti.max(longest, list_index - neighbors.list_begin[i])
        excess = ti.cast(longest > longest_allowed, ti.i32) * TOO_LONG
        ti.atomic_max(control.list_length_needed[0], list_index - begin + excess)

    return fill


def _build_fill_one(state: State) -> Any:
    """Device function (task, rebuild): fill the neighbor list of one particle, see `fill_phase`."""
    particles, neighbors, control, sorting = state.particles, state.neighbors, state.control, state.cell_sort
    lists, list_capacity = NeighborListFill(state), state.parameter("list_capacity")

    @ti.func
    def fill_one(task: ti.template(), rebuild: ti.template()):
        i = task.index
        particles.position_at_rebuild[i] = particles.position[i]
        begin, end, limit = 0, 0, 0
        for _ in range(2):  # a limit of 0 counts the entries
            owner = ti.Struct(
                i=i, first=i, end=i + 1, limit=limit, skin=rebuild.skin, reach=sorting.reach_largest[0],
                pose=rebuild.pose,
            )  # fmt: skip
            end = lists.fill(owner, begin)
            lists.restore(owner, begin, end)
            if limit == 0:
                begin, limit = ti.atomic_add(control.list_length_needed[0], end), list_capacity()
        neighbors.list_begin[i], neighbors.list_end[i] = begin, end

    return fill_one


def _build_finish(state: State, present_count: Any) -> Any:
    """Device function (rebuild): store the number of particles and reset the requests of a rebuild."""
    control, sorting, can_halt = state.control, state.cell_sort, state.control.halted_at is not None

    @ti.func
    def finish(rebuild: ti.template()):
        sorting.present[0] = present_count(rebuild)
        control.rebuild_due[0] = 0
        control.rebuild_requested[0] = 0
        if ti.static(can_halt):
            for phase in ti.static((INTEGRATION, FORCES)):
                control.halted_at[phase] = NOT_HALTED

    return finish
