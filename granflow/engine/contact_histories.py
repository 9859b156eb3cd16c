"""Contact histories by particle id: in checkpoints, and for particles that migrate between MPI ranks."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from granflow.engine.host_copy import FieldTable, consecutive, list_table
from granflow.engine.neighbor.contact_history_entry import IN_CONTACT
from granflow.engine.neighbor.history_transfer import vector_components
from granflow.engine.state import State

WITHOUT_HISTORY = -1
"""Row of a particle without contact history, see `HistoryTable.write`."""

NOT_TAKEN = -1
"""Place of a particle that is not selected."""


@dataclass(frozen=True)
class Histories:
    """Contact histories of n particles with m contacts, one particle after the other, as each particle sees them.

    count:    (n,) number of contacts of each particle
    partner:  (m,) int32, id of the other particle, or a negative number of a wall or triangle
    values:   by slot of the contact models (m, components)
    """

    count: np.ndarray
    partner: np.ndarray
    values: dict[str, np.ndarray]

    def of(self, rows: np.ndarray) -> "Histories":
        """The histories of the particles with these indices (k,), in this order."""
        entries, values = self._contacts_of(rows), self.values
        return Histories(self.count[rows], self.partner[entries], {slot: values[slot][entries] for slot in values})

    def _contacts_of(self, rows: np.ndarray) -> np.ndarray:
        """Index of each contact of particles (k,), one particle after the other."""
        return consecutive((np.cumsum(self.count) - self.count)[rows], self.count[rows])

    @property
    def owner(self) -> np.ndarray:
        """Index (m,) of the particle of each contact."""
        return np.repeat(np.arange(len(self.count)), self.count)

    def by_partner(self) -> "Histories":
        """The histories with the contacts of each particle in the order of the partners."""
        entries = np.lexsort((self.partner, self.owner))
        values = {slot: each[entries] for slot, each in self.values.items()}
        return Histories(self.count, self.partner[entries], values)


@dataclass(frozen=True)
class ListedHistories(Histories):
    """Histories as the neighbor lists contain them: a pair within a chunk is in the list of one of both particles only.

    ids:      (n,) int32, of the particles
    once:     (k,) contacts that are in the list of one of both particles only
    other:    (k,) index of the partner of each of these
    vectors:  by slot (components,), whether a component is that of a vector, which has the other sign for the partner
    """

    ids: np.ndarray
    once: np.ndarray
    other: np.ndarray
    vectors: dict[str, list[bool]]

    def of(self, rows: np.ndarray) -> Histories:
        """The histories of the particles with these indices (k,), in this order, with both sides of each pair."""
        place = np.full(len(self.count), NOT_TAKEN)
        place[rows] = np.arange(len(rows))
        direct, mirrored = self._contacts_of(rows), np.flatnonzero(place[self.other] != NOT_TAKEN)
        once, owner = self.once[mirrored], self.owner
        row = np.concatenate([place[owner[direct]], place[self.other[mirrored]]])
        by_row = np.argsort(row, kind="stable")
        partner = np.concatenate([self.partner[direct], self.ids[owner[once]]])[by_row]
        values = {}
        for slot, each in self.values.items():
            opposite = np.where(self.vectors[slot], -1.0, 1.0).astype(each.dtype) * each[once]
            values[slot] = np.concatenate([each[direct], opposite])[by_row]
        return Histories(np.bincount(row, minlength=len(rows)), partner, values)


def joined_histories(parts: list[Histories]) -> Histories:
    """The histories of several parts, one part after the other; those of one part are not copied."""
    filled = [part for part in parts if len(part.count)] or parts[:1]
    if len(filled) == 1:
        return filled[0]
    return Histories(
        np.concatenate([part.count for part in filled]),
        np.concatenate([part.partner for part in filled]),
        {slot: np.concatenate([part.values[slot] for part in filled]) for slot in filled[0].values},
    )


class HistoryTable:
    """Reads the histories of the owned particles from the neighbor lists, and writes them for the next lists.

    Without ranks all particles are owned.
    """

    def __init__(self, state: State) -> None:
        self._state = state

    def read(self, ids: np.ndarray, count: int) -> Histories:
        """Histories of all contacts of the owned particles; arguments as for `listed`."""
        return self.listed(ids, count).of(np.arange(count))

    def listed(self, ids: np.ndarray, count: int) -> ListedHistories:
        """Histories of all contacts in the neighbor lists of the owned particles.

        ids:    (k,) of the owned particles and the ghosts by index, at the time of the lists
        count:  number of particles, of which those behind the owned ones have no contacts yet
        """
        state, none = self._state, np.zeros(0, np.int64)
        if not state.neighbors.history:
            return ListedHistories(np.zeros(count, np.int64), np.zeros(0, np.int32), {}, ids, none, none, {})
        owner, index, values = self._touching()
        size = state.plan.chunk_size
        once = np.flatnonzero((index >= 0) & (owner // size == index // size))
        partner = np.where(index < 0, index, ids[np.maximum(index, 0)]).astype(np.int32)
        vectors = {slot: vector_components(state, slot) for slot in values}
        return ListedHistories(np.bincount(owner, minlength=count), partner, values, ids, once, index[once], vectors)

    def _touching(self) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """Index of the owner and the partner (m,) of each list entry in contact, and the histories."""
        state = self._state
        ranges = state.built(list_table).take(slice(0, state.count))
        begin, length = ranges["begin"].astype(np.int64), ranges["end"] - ranges["begin"]
        list_index = consecutive(begin, length)
        touches = np.flatnonzero(state.built(_state_table).take(list_index)["in_contact"] == IN_CONTACT)
        owner = np.repeat(np.arange(len(begin)), length)[touches]
        entries = state.built(_contact_table).take(list_index[touches])
        return owner, entries.pop("partner").astype(np.int64), entries

    def write_lists(self, histories: Histories, ids: np.ndarray) -> None:
        """Write neighbor lists that contain the contacts only, from which a rebuild takes the histories.

        ids:  (n,) of all particles by index, in ascending order

        The capacity must suffice, see `longest_segment`.
        """
        state, owner, segment = self._state, histories.owner, self._segments(len(ids))
        before = np.cumsum(histories.count) - histories.count
        in_segment = before - before[segment * state.plan.chunk_size]
        begin = segment * state.capacities.list_entries_per_segment + in_segment
        ranges = {"begin": begin, "end": begin + histories.count}
        state.built(list_table).put(np.arange(len(ids)), ranges)
        if not state.neighbors.history:
            return
        entry = begin[owner] + np.arange(len(owner)) - before[owner]
        partner = np.where(histories.partner < 0, histories.partner, np.searchsorted(ids, histories.partner))
        in_contact = np.full(len(entry), IN_CONTACT, np.int32)
        entries = {"partner": partner.astype(np.int32), "in_contact": in_contact} | histories.values
        state.built(_entry_table).put(entry, entries)

    def longest_segment(self, histories: Histories) -> int:
        """Largest number of contacts of the particles of a segment of the neighbor lists."""
        segments = self._segments(len(histories.count))
        return int(np.bincount(segments, weights=histories.count, minlength=1).max())

    def _segments(self, count: int) -> np.ndarray:
        """Segment (count,) of each particle; see `NeighborList`."""
        size = self._state.plan.chunk_size
        return np.arange(count) // size if size > 1 else np.zeros(count, np.int64)

    def write(self, parts: Sequence[Histories], rows: np.ndarray) -> None:
        """Write histories where a rank looks for them when it fills neighbor lists.

        parts:  histories, counted one part after the other
        rows:   (k,) for each particle by index, which of the histories it has; WITHOUT_HISTORY if none
        """
        state, first = self._state, 0
        if not state.neighbors.history:
            return
        count = np.concatenate([*(part.count for part in parts), [0]])  # the last one is that of WITHOUT_HISTORY
        end = np.cumsum(count)
        state.built(_range_table).put(slice(0, len(rows)), {"begin": (end - count)[rows], "end": end[rows]})
        for part in parts:
            last = first + len(part.partner)
            state.built(_saved_table).put(slice(first, last), {"partner": part.partner} | part.values)
            first = last

    def clear(self, rows: slice) -> None:
        """Let particles have no histories where a rank looks for them."""
        if self._state.neighbors.history:
            self._state.built(_range_table).put(rows, {"begin": 0, "end": 0})


def _state_table(state: State) -> FieldTable:
    """Table of the contact state of all list entries."""
    return FieldTable({"in_contact": state.neighbors.in_contact})


def _contact_table(state: State) -> FieldTable:
    """Table of the partners and histories of all list entries."""
    return FieldTable({"partner": state.neighbors.partner, **state.neighbors.history})


def _entry_table(state: State) -> FieldTable:
    """Table of all list entries."""
    neighbors = state.neighbors
    return FieldTable({"partner": neighbors.partner, "in_contact": neighbors.in_contact, **neighbors.history})


def _range_table(state: State) -> FieldTable:
    """Table of the ranges of the saved histories of each particle."""
    return FieldTable({"begin": state.neighbors.list_begin_before, "end": state.neighbors.list_end_before})


def _saved_table(state: State) -> FieldTable:
    """Table of the saved histories and their partners."""
    return FieldTable({"partner": state.neighbors.partner_saved} | state.neighbors.saved)
