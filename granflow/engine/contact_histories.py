"""Contact histories by particle id: in checkpoints, and for particles that migrate between MPI ranks."""

from dataclasses import dataclass

import numpy as np

from granflow.engine.host_copy import FieldTable, consecutive
from granflow.engine.neighbor.contact_history_entry import IN_CONTACT
from granflow.engine.neighbor.history_transfer import vector_components
from granflow.engine.state import State


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
        count = self.count[rows]
        entries = consecutive((np.cumsum(self.count) - self.count)[rows], count)
        return Histories(count, self.partner[entries], {slot: each[entries] for slot, each in self.values.items()})

    @property
    def owner(self) -> np.ndarray:
        """Index (m,) of the particle of each contact."""
        return np.repeat(np.arange(len(self.count)), self.count)

    def by_partner(self) -> "Histories":
        """The histories with the contacts of each particle in the order of the partners."""
        entries = np.lexsort((self.partner, self.owner))
        values = {slot: each[entries] for slot, each in self.values.items()}
        return Histories(self.count, self.partner[entries], values)


def joined_histories(parts: list[Histories]) -> Histories:
    """The histories of several parts, one part after the other."""
    return Histories(
        np.concatenate([part.count for part in parts]),
        np.concatenate([part.partner for part in parts]),
        {slot: np.concatenate([part.values[slot] for part in parts]) for slot in parts[0].values},
    )


class HistoryTable:
    """Reads the histories of the owned particles from the neighbor lists, and writes them for the next lists.

    Without ranks all particles are owned.
    """

    def __init__(self, state: State) -> None:
        self._state = state

    def read(self, ids: np.ndarray, count: int) -> Histories:
        """Histories of all contacts of the owned particles; both sides of a contact between two of them.

        ids:    (k,) of the owned particles and the ghosts by index, at the time of the lists
        count:  number of particles, of which those behind the owned ones have no contacts yet

        A pair within a chunk is in one list only; for the other side vectors change their sign.
        """
        state = self._state
        if not state.neighbors.history:
            return Histories(np.zeros(count, np.int64), np.zeros(0, np.int32), {})
        owner, partner, values = self._touching()
        size = state.plan.chunk_size
        listed_once = np.flatnonzero((partner >= 0) & (owner // size == partner // size))
        row = np.concatenate([owner, partner[listed_once]])
        by_row = np.argsort(row, kind="stable")
        codes = np.concatenate([np.where(partner < 0, partner, ids[np.maximum(partner, 0)]), ids[owner[listed_once]]])
        for slot, each in values.items():
            mirrored = np.where(vector_components(state, slot), -1.0, 1.0).astype(each.dtype) * each[listed_once]
            values[slot] = np.concatenate([each, mirrored])[by_row]
        return Histories(np.bincount(row, minlength=count), codes[by_row].astype(np.int32), values)

    def _touching(self) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """Index of the owner and the partner (m,) of each list entry in contact, and the histories."""
        state = self._state
        ranges = state.built(_list_table).take(slice(0, state.count))
        begin, length = ranges["begin"].astype(np.int64), ranges["end"] - ranges["begin"]
        list_index, owner = consecutive(begin, length), np.repeat(np.arange(len(begin)), length)
        touching = state.built(_state_table).take(list_index)["in_contact"] == IN_CONTACT
        list_index, owner = list_index[touching], owner[touching]
        entries = state.built(_contact_table).take(list_index)
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
        state.built(_list_table).put(np.arange(len(ids)), ranges)
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

    def write(self, histories: Histories) -> None:
        """Write the histories of the owned particles where a rank looks for them when it fills neighbor lists."""
        state, end = self._state, np.cumsum(histories.count)
        if not histories.values:
            return
        state.built(_range_table).put(np.arange(len(end)), {"begin": end - histories.count, "end": end})
        entries = {"partner": histories.partner} | histories.values
        state.built(_saved_table).put(np.arange(len(histories.partner)), entries)


def _state_table(state: State) -> FieldTable:
    """Table of the contact state of all list entries."""
    return FieldTable({"in_contact": state.neighbors.in_contact})


def _contact_table(state: State) -> FieldTable:
    """Table of the partners and histories of all list entries."""
    return FieldTable({"partner": state.neighbors.partner, **state.neighbors.history})


def _list_table(state: State) -> FieldTable:
    """Table of the ranges of all neighbor lists."""
    return FieldTable({"begin": state.neighbors.list_begin, "end": state.neighbors.list_end})


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
