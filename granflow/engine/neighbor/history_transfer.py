"""Contact history during the sort: saved before the particles are permuted, restored for each new list entry."""

from typing import Any

from granflow.engine.neighbor.phases import is_count
from granflow.engine.state import State
from granflow.kernel_language import ti


def vector_components(state: State, slot: str) -> list[bool]:
    """For each component of a history, whether it is one of a vector: it changes its sign with the order of a pair."""
    return [each.size > 1 for each in state.plan.laws.history[slot] for _ in range(each.size)]


def build_save_history(state: State) -> Any:
    """Device function (chunk, first, last): copy history entries of a chunk to `saved` for `restore_history`.

    `list_length_needed`: largest number of history entries of a segment; entries beyond the capacity are not saved, and
    the host repeats the rebuild with a larger capacity. If each particle is a chunk, it reserves its entries by an
    atomic addition: their places depend on the threads, and nothing depends on their places.

    On MPI ranks the partner is saved by its id: ghosts have other indices afterwards.

    Reads:   neighbor lists, in_contact, history, id
    Writes:  saved, partner_saved, list_begin_before, list_end_before, list_length_needed
    """
    neighbors, names, has_ghosts = state.neighbors, list(state.neighbors.history), state.plan.has_ghosts
    saved_capacity, one_segment = state.parameter("saved_capacity"), state.plan.chunk_size == 1

    @ti.func
    def entries_in_contact(i):
        count, list_index = 0, neighbors.list_begin[i]
        while (list_index < neighbors.list_end[i]) & is_count(count):
            count += ti.cast(neighbors.in_contact[list_index] == 1, ti.i32)
            list_index += 1
        return count

    @ti.func
    def save_entry(list_index, saved_index):
        partner = neighbors.partner[list_index]
        if ti.static(has_ghosts):
            if partner >= 0:
                partner = state.particles.id[partner]
        neighbors.partner_saved[saved_index] = partner
        for name in ti.static(names):
            neighbors.saved[name][saved_index] = neighbors.history[name][list_index]

    @ti.func
    def save_history(chunk, first, last):
        begin, limit = chunk * saved_capacity(), saved_capacity()
        if ti.static(one_segment):
            begin = ti.atomic_add(state.control.list_length_needed[0], entries_in_contact(first))
        else:
            limit += begin
        saved_index = begin
        i = first
        while (i < last) & is_count(saved_index):
            neighbors.list_begin_before[i] = saved_index
            list_index = neighbors.list_begin[i]
            while (list_index < neighbors.list_end[i]) & is_count(saved_index):
                if neighbors.in_contact[list_index] == 1:
                    if saved_index < limit:
                        save_entry(list_index, saved_index)
                    saved_index += 1
                list_index += 1
            neighbors.list_end_before[i] = saved_index
            i += 1
        if ti.static(not one_segment):
            ti.atomic_max(state.control.list_length_needed[0], saved_index - begin)

    return save_history


def build_restore_history(state: State) -> Any:
    """Device function (list index, i, j): copy the history of a pair from before the sort to its new list entry.

    If the pair was in the list of the partner, vectors change their sign. Without a saved history all values are zero.
    On MPI ranks the histories are saved with the ids of the partners, and the range of each particle at its new index;
    the range of a ghost that this rank has owned is that of before.

    Reads:   order, id, saved, partner_saved
    Writes:  history, in_contact
    """
    neighbors, source_of, names = state.neighbors, _build_source(state), list(state.neighbors.history)
    components = [
        (name, k, changes_sign) for name in names for k, changes_sign in enumerate(vector_components(state, name))
    ]

    @ti.func
    def restore_history(list_index, i, j):
        source, sign = source_of(i, j)
        neighbors.in_contact[list_index] = ti.cast(source >= 0, ti.i32)
        if source >= 0:
            for name, k, changes_sign in ti.static(components):
                value = neighbors.saved[name][source][k]
                if ti.static(changes_sign):
                    value = sign * value
                neighbors.history[name][list_index][k] = value
        else:
            for name, k, _ in ti.static(components):
                neighbors.history[name][list_index][k] = 0.0

    return restore_history


def _build_source(state: State) -> Any:
    """Device function (i, j): index of the saved history of a pair, -1 if none, and the sign of its vectors.

    Reads:   order, id, partner_saved
    """
    neighbors, sorting, chunk_size = state.neighbors, state.cell_sort, state.parameter("chunk_size")

    @ti.func
    def find_saved(row, partner):
        """Index in `saved` of a partner of the particle `row`; -1 if none."""
        found, list_index = -1, neighbors.list_begin_before[row]
        while (found < 0) & (list_index < neighbors.list_end_before[row]):
            if neighbors.partner_saved[list_index] == partner:
                found = list_index
            list_index += 1
        return found

    @ti.func
    def find_either(row, partner, row_other, partner_other, has_other):
        """Search of the list of one particle, then of the other one; one call of `find_saved`, compiled once."""
        source, sign, row_now, partner_now, attempt = -1, 1.0, row, partner, 0
        while (source < 0) & (attempt <= has_other):
            if attempt == 1:
                sign, row_now, partner_now = -1.0, row_other, partner_other
            source = find_saved(row_now, partner_now)
            attempt += 1
        return source, sign

    @ti.func
    def source_before_sort(i, j):
        i_before, j_before, same_chunk = sorting.order[i], j, 0
        if j >= 0:
            j_before = sorting.order[j]
            same_chunk = ti.cast(i_before // chunk_size() == j_before // chunk_size(), ti.i32)
        return find_either(i_before, j_before, j_before, i_before, same_chunk)

    @ti.func
    def source_by_id(i, j):
        """As `source_before_sort`, on MPI ranks."""
        partner, is_particle = j, ti.cast(j >= 0, ti.i32)
        if j >= 0:
            partner = state.particles.id[j]
        return find_either(i, partner, j, state.particles.id[i], is_particle)

    return source_by_id if state.plan.has_ghosts else source_before_sort
