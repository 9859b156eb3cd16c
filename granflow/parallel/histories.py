"""Contact histories by particle id, which migrate with the particles."""

from dataclasses import dataclass

import numpy as np

from granflow.engine.force.contact_output import candidate_pairs
from granflow.engine.host_copy import FieldTable
from granflow.engine.neighbor.contact_history_entry import IN_CONTACT
from granflow.engine.neighbor.history_transfer import vector_components
from granflow.engine.state import State

PARTNER_BITS = 32
"""Binary digits of the partner in the key of a pair."""


@dataclass(frozen=True)
class Histories:
    """Contact histories of m contacts, as the particle that owns them sees them.

    owner:    (m,) id of the particle
    partner:  (m,) id of the other particle, or a negative number of a wall or triangle
    values:   by slot of the contact models (m, components)
    """

    owner: np.ndarray
    partner: np.ndarray
    values: dict[str, np.ndarray]

    def selected(self, rows: np.ndarray) -> "Histories":
        """The histories with these indices, or of a mask."""
        return Histories(self.owner[rows], self.partner[rows], {slot: each[rows] for slot, each in self.values.items()})


def joined_histories(parts: list[Histories]) -> Histories:
    """The histories of several parts."""
    return Histories(
        np.concatenate([part.owner for part in parts]),
        np.concatenate([part.partner for part in parts]),
        {slot: np.concatenate([part.values[slot] for part in parts]) for slot in parts[0].values},
    )


class HistoryTable:
    """Reads the histories of the owned particles from the neighbor lists, and writes them to new lists."""

    def __init__(self, state: State) -> None:
        self._state = state

    @property
    def _states(self) -> FieldTable:
        return self._state.built(_state_table)

    @property
    def _values(self) -> FieldTable:
        return self._state.built(_value_table)

    def read(self, ids: np.ndarray) -> Histories:
        """Histories of all contacts of the owned particles; both sides of a contact between two of them.

        ids:  (k,) of the owned particles and the ghosts by index, at the time of the lists

        A pair within a chunk is in one list only; for the other side vectors change their sign.
        """
        state = self._state
        owner, list_index, partner = candidate_pairs(state)
        touching = self._states.take(list_index)["in_contact"] == IN_CONTACT
        owner, list_index, partner = owner[touching], list_index[touching], partner[touching]
        values = self._values.take(list_index)
        codes = np.where(partner < 0, partner, ids[np.maximum(partner, 0)])
        own = Histories(ids[owner].astype(np.int64), codes.astype(np.int64), values)
        size = state.plan.chunk_size
        single = (partner >= 0) & (owner // size == partner // size)
        listed = own.selected(single)
        signs = {slot: np.where(vector_components(state, slot), -1.0, 1.0) for slot in values}
        mirrored = {slot: (signs[slot] * each).astype(each.dtype) for slot, each in listed.values.items()}
        return joined_histories([own, Histories(listed.partner, listed.owner, mirrored)])

    def write(self, histories: Histories, ids: np.ndarray) -> None:
        """Write histories to the list entries of the same pairs, which have been cleared.

        ids:  (k,) of the owned particles and the ghosts by index
        """
        owner, list_index, partner = candidate_pairs(self._state)
        codes = np.where(partner < 0, partner, ids[np.maximum(partner, 0)])
        keys, saved = _keys(ids[owner], codes), _keys(histories.owner, histories.partner)
        order = np.argsort(saved, kind="stable")
        if not len(order):
            return
        place = np.minimum(np.searchsorted(saved[order], keys), len(order) - 1)
        source = order[place]
        found = saved[source] == keys
        self._states.put(list_index[found], {"in_contact": np.full(int(found.sum()), IN_CONTACT)})
        self._values.put(list_index[found], histories.selected(source[found]).values)


def _keys(owner: np.ndarray, partner: np.ndarray) -> np.ndarray:
    """One integer (m,) for each pair."""
    low = partner.astype(np.int64) & (2**PARTNER_BITS - 1)
    keys: np.ndarray = (owner.astype(np.int64) << PARTNER_BITS) | low
    return keys


def _state_table(state: State) -> FieldTable:
    """Table of the contact state of all list entries."""
    return FieldTable({"in_contact": state.neighbors.in_contact})


def _value_table(state: State) -> FieldTable:
    """Table of the histories of all list entries."""
    return FieldTable(dict(state.neighbors.history))
