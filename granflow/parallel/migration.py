"""Migration of particles, with their contact histories, to the ranks that own their positions."""

from dataclasses import dataclass

import numpy as np

from granflow.engine.contact_histories import WITHOUT_HISTORY, Histories
from granflow.engine.host_particles import HostParticles, joined_particles
from granflow.engine.neighbor.cells import BLOCK_SIDE
from granflow.engine.ranks import Arrays
from granflow.parallel.communicator import Communicator


@dataclass(frozen=True)
class Share:
    """The n particles of a rank after a migration, in the order that they have on the device from now on.

    arrays:     saved fields (n, ...)
    histories:  of the particles before the migration, and of the arrived ones
    rows:       (n,) which of `histories` each particle is, counted over both
    left, left_id:  (m,) which of `histories` the particles are that other ranks own now, and their ids, ascending
    """

    arrays: Arrays
    histories: tuple[Histories, Histories]
    rows: np.ndarray
    left: np.ndarray
    left_id: np.ndarray

    def ghost_rows(self, ids: np.ndarray) -> np.ndarray:
        """Which of `histories` the ghosts with these ids (k,) are; WITHOUT_HISTORY if this rank has not owned them."""
        if not len(self.left):
            return np.full(len(ids), WITHOUT_HISTORY)
        place = np.minimum(np.searchsorted(self.left_id, ids), len(self.left) - 1)
        return np.where(self.left_id[place] == ids, self.left[place], WITHOUT_HISTORY)


def migrated(
    communicator: Communicator, particles: HostParticles, present: np.ndarray, to_rank: np.ndarray, cell_size: float
) -> Share:
    """Send particles to their ranks, and receive those of this rank; all ranks call this together.

    particles:  of this rank so far
    present:    (k,) indices of those that are not deleted
    to_rank:    (k,) rank that owns each of these
    cell_size:  [m], of the order of the particles
    """
    ranks = range(communicator.size)
    leaving = [present[to_rank == rank] if rank != communicator.rank else present[:0] for rank in ranks]
    arrived = joined_particles(communicator.exchanged([particles.of(rows) for rows in leaving]))
    rows = np.concatenate([present[to_rank == communicator.rank], particles.count + np.arange(arrived.count)])
    before, ids = particles.arrays, particles.arrays["id"]
    rows = rows[cell_order(_rows_of_both(before["position"], arrived.arrays["position"], rows), cell_size)]
    arrays = {name: _rows_of_both(values, arrived.arrays[name], rows) for name, values in before.items()}
    left = np.concatenate(leaving)
    left = left[np.argsort(ids[left])]
    return Share(arrays, (particles.histories, arrived.histories), rows, left, ids[left])


def _rows_of_both(first: np.ndarray, second: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Rows (k, ...) of two arrays (n, ...) and (m, ...), counted over both; m is small."""
    if not len(first):
        return second[rows]
    found = first.take(rows, axis=0, mode="clip")
    in_second = np.flatnonzero(rows >= len(first))
    found[in_second] = second[rows[in_second] - len(first)]
    return found


def cell_order(position: np.ndarray, cell_size: float) -> np.ndarray:
    """Order (n,) of particles by blocks of cells, as `engine.neighbor.cells.cell_number`: chunks are compact.

    position:   (n, 3) [m]
    cell_size:  [m]
    """
    if not len(position):
        return np.zeros(0, np.int64)
    # Axis by axis: numpy reduces contiguous arrays (n, 3) over n twenty times more slowly.
    cells = [((along - along.min()) / cell_size).astype(np.int64) for along in position.T]
    number = np.zeros(len(position), np.int64)
    for block in (cell // BLOCK_SIDE for cell in reversed(cells)):
        number = number * (block.max() + 1) + block
    for cell in reversed(cells):
        number = number * BLOCK_SIDE + cell % BLOCK_SIDE
    return np.argsort(number, kind="stable")
