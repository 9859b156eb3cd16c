"""Particles of a checkpoint on the host, in the order of their ids."""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from granflow.engine.contact_histories import Histories
from granflow.engine.host_copy import saved_particle_table
from granflow.engine.host_particles import HostParticles
from granflow.engine.saved_sums import refuse_other_names
from granflow.engine.state import State
from granflow.plan.plan import Plan


class RankFiles(Protocol):
    """Files with the particles of MPI ranks, which all ranks read together; each rank has a copy."""

    @property
    def count(self) -> int:
        """Number of files."""

    def read(self, number: int, plan: Plan, accounting: Mapping[str, Any]) -> Mapping[str, Any]:
        """Checked particles and contacts of a file, as in `engine.checkpoint.saved_state`.

        number:      of the file
        accounting:  state of `Accounting`
        Raises:      GranflowError for an invalid file
        """


def host_particles(state: State, saved: Mapping[str, Any]) -> HostParticles:
    """The particles of a checkpoint, in the order of their ids.

    saved:   with "particles" and "contacts" as in `engine.checkpoint.saved_state`
    Raises:  GranflowError if the scene needs other arrays
    """
    history, contacts = state.plan.history, dict(saved["contacts"])
    refuse_other_names(saved["particles"], saved_particle_table(state).fields)
    count, partner = contacts.pop("count"), contacts.pop("partner")
    refuse_other_names(contacts, history if len(partner) or contacts else {})
    contacts = contacts or {slot: np.zeros((0, components)) for slot, components in history.items()}
    particles = HostParticles(saved["particles"], Histories(count, partner, contacts))
    is_sorted = np.all(np.diff(saved["particles"]["id"]) > 0)
    return particles if is_sorted else particles.by_id()
