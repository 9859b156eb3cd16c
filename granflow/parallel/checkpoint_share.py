"""Reading of a checkpoint that MPI ranks have written: each rank reads a part of the files."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from granflow.engine.host_copy import saved_particle_table
from granflow.engine.host_particles import HostParticles, joined_particles
from granflow.engine.saved_particles import RankFiles, host_particles
from granflow.engine.state import State
from granflow.errors import GranflowError
from granflow.parallel.communicator import Communicator


def share_of_checkpoint(
    state: State,
    communicator: Communicator,
    particles: HostParticles | None,
    files: RankFiles | None,
    accounting: Mapping[str, Any],
) -> tuple[HostParticles, str | None]:
    """The particles that this rank reads, and a sentence on a problem of any rank, or None; all ranks call this.

    particles:   of the checkpoint itself, on the root
    files:       with the other particles
    accounting:  state of `Accounting`
    """
    parts, problem = [no_particles(state) if particles is None else particles], None
    try:
        if files is not None:  # the root, which has particles already, is the last one to read a file
            for number in range((communicator.rank - 1) % communicator.size, files.count, communicator.size):
                parts.append(host_particles(state, files.read(number, state.plan, accounting)))
    except GranflowError as error:
        problem = str(error)
    problem = _first(communicator, problem)
    found = joined_particles(parts)
    if files is not None and problem is None:
        problem = _first(communicator, _contradiction(communicator, found))
    return found, problem


def no_particles(state: State) -> HostParticles:
    """Empty arrays and histories of the state."""
    none = saved_particle_table(state).take(np.zeros(0, np.int32))
    contacts = {"count": np.zeros(0, np.int64), "partner": np.zeros(0, np.int32)}
    return host_particles(state, {"particles": none, "contacts": contacts})


def _first(communicator: Communicator, problem: str | None) -> str | None:
    """The sentence of the lowest rank that has one."""
    return next(filter(None, communicator.from_each(problem)), None)


def _contradiction(communicator: Communicator, particles: HostParticles) -> str | None:
    """A sentence if a particle is in two files, or a contact between two particles at one of them only.

    Each rank compares the ids, and the contacts by their lower id, with its number modulo the number of ranks.
    """
    ids, histories, size = particles.arrays["id"], particles.histories, communicator.size
    pairs = np.stack([ids[histories.owner], histories.partner], axis=1)[histories.partner >= 0]
    lower = pairs.min(axis=1, initial=2**31 - 1)
    sent = [(ids[ids % size == rank], pairs[lower % size == rank]) for rank in range(size)]
    compared, contacts = (np.concatenate(each) for each in zip(*communicator.exchanged(sent), strict=True))
    if len(np.unique(compared)) < len(compared):
        return "The checkpoint has a particle in the files of two ranks. Remove it to use the checkpoint before it."
    first, second = (each[np.lexsort(each.T)] for each in (contacts, contacts[:, ::-1]))
    if not np.array_equal(first, second):
        return (
            "The checkpoint has a contact between two particles at one of them only. Remove it to use the checkpoint "
            "before it."
        )
    return None
