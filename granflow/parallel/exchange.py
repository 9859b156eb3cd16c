"""What ranks exchange: ghosts in each step, and particles that migrate at some rebuilds.

Ghosts are copies of particles that other ranks own, within reach of the particles of this rank.
`GhostExchange` selects them at each neighbor-list rebuild, and updates them in each step. `migrated` sends
particles, with their contact histories, to the ranks that own their positions.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from granflow.engine.codes import NO_PARTICLE
from granflow.engine.fields import records_of
from granflow.engine.host import WITHOUT_HISTORY, Histories, HostParticles, joined_arrays, joined_particles
from granflow.engine.neighbor.sort import BLOCK_SIDE, KEPT_REACH
from granflow.engine.state import Arrays, State
from granflow.fields import PARTICLE_QUANTITIES
from granflow.parallel.communicator import Communicator

REBUILD, ABORT, PARTICLE, STOP, FLAGS = range(5)
"""Flags of a rank: rebuild requested, abort code, minus the id of the abort, stop requested; and their
number."""
MARGIN = 1.0 + 1e-5
"""Factor of distances above rounding, in all precisions: more ghosts than necessary are harmless."""


@dataclass(frozen=True)
class Box:
    """Bounding box of the centers of a rank's particles, and their largest radius plus reach [m]."""

    low: np.ndarray
    high: np.ndarray
    reach: float


def reaches(state: State, arrays: Arrays, reach_time: float) -> np.ndarray:
    """Radius plus an upper bound of the reach (n,) [m] of particles, see
    `engine.neighbor.sort.bounds_phases`."""
    plan = state.plan
    velocity = arrays["velocity"].astype(float)
    speed = np.sqrt(np.einsum("ij,ij->i", velocity, velocity))
    reach = np.minimum(0.5 * plan.skin + speed * reach_time, plan.reach_max)
    if reach_time == KEPT_REACH:
        reach = arrays["reach"].astype(float)
    found: np.ndarray = MARGIN * (arrays["radius"].astype(float) + reach)
    return found


def box_of(position: np.ndarray, reach: np.ndarray) -> Box:
    """Box of particles at positions (n, 3) [m]; without particles nothing is within its reach."""
    low = np.array([along.min(initial=np.inf) for along in position.T])
    high = np.array([along.max(initial=-np.inf) for along in position.T])
    return Box(low, high, float(reach.max(initial=0.0)))


def within(state: State, box: Box, position: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Indices of the particles that can come into the neighbor lists of a rank.

    position:  (n, 3) [m], inside the domain along periodic axes
    reach:     (n,) [m], see `reaches`
    """
    if box.low[0] > box.high[0]:
        return np.zeros(0, np.int64)
    plan = state.plan
    gaps = np.zeros((len(position), 3))
    motion = plan.periodic_box.image_motion
    sheared = np.full(len(position), np.inf)
    for axis in range(3):
        gaps[:, axis] = _gap(position[:, axis], box.low[axis], box.high[axis])
        if axis in plan.periodic_box.axes:
            image_gap = _image_gap(state, box, position, axis)
            if motion is not None and axis == motion.gradient:
                sheared = image_gap
            else:
                gaps[:, axis] = np.minimum(gaps[:, axis], image_gap)
    squares = gaps**2
    gap_squared = squares.sum(axis=1)
    if motion is not None:  # moving images may be anywhere along the flow
        neutral = 3 - motion.flow - motion.gradient
        gap_squared = np.minimum(gap_squared, squares[:, neutral] + sheared**2)
    return np.flatnonzero(gap_squared <= (MARGIN * (reach + box.reach + plan.laws.range)) ** 2)


def _image_gap(state: State, box: Box, position: np.ndarray, axis: int) -> np.ndarray:
    """Distance (n,) [m] of the nearest periodic images from the box along an axis."""
    width = state.plan.domain_high[axis] - state.plan.domain_low[axis]
    above = _gap(position[:, axis] + width, box.low[axis], box.high[axis])
    below = _gap(position[:, axis] - width, box.low[axis], box.high[axis])
    found: np.ndarray = np.minimum(above, below)
    return found


def _gap(coordinate: np.ndarray, low: float, high: float) -> np.ndarray:
    """Distance (n,) [m] of coordinates from a range."""
    return np.maximum(np.maximum(low - coordinate, coordinate - high), 0.0)


class GhostExchange:
    """Selects ghosts at neighbor-list rebuilds, and updates them in each step.

    first:  index of the first ghost; count: number of ghosts
    """

    def __init__(self, state: State, communicator: Communicator) -> None:
        self._state = state
        self._communicator = communicator
        self._flags = np.zeros(FLAGS, np.int32)
        self.first = 0
        self.count = 0
        self._prepare([], [])

    def selected(self, arrays: Arrays, reach_time: float) -> list[np.ndarray]:
        """Indices (k,) of the owned particles that each rank needs as ghosts.

        arrays:      position, velocity, radius and reach of the owned particles
        reach_time:  [s], see `engine.neighbor.sort.bounds_phases`
        """
        communicator = self._communicator
        position = arrays["position"].astype(float)
        reach = reaches(self._state, arrays, reach_time)
        boxes = communicator.from_each(box_of(position, reach))
        return [
            np.zeros(0, np.int64) if rank == communicator.rank else within(self._state, box, position, reach)
            for rank, box in enumerate(boxes)
        ]

    def exchanged(self, entries: list[np.ndarray], rows_of: Callable[[np.ndarray], Arrays]) -> Arrays:
        """Send particles to other ranks; returns the ghosts of this rank, all saved fields.

        entries:  for each rank, indices (k,) on the device from now on
        rows_of:  saved fields of the owned particles with some indices
        """
        received = self._communicator.exchanged([rows_of(rows) for rows in entries])
        self._prepare(entries, [len(part["id"]) for part in received])
        return joined_arrays(received)

    def _prepare(self, entries: list[np.ndarray], received: list[int]) -> None:
        """Allocate the buffers: `entries` (k,) to send to each rank, number of ghosts `received` from each
        rank."""
        records = _records(self._state)
        self.count = sum(received)
        self._entries = np.concatenate(entries or [np.zeros(0, np.int64)])
        self._out = np.zeros(len(self._entries), records.dtype)
        self._in = np.zeros(self.count, records.dtype)
        self._sends = _parts(self._out, [len(rows) for rows in entries])
        self._receives = _parts(self._in, received)

    def update(self) -> None:
        """Update the ghosts from their owners."""
        records = _records(self._state)
        np.take(records, self._entries, out=self._out, mode="clip")
        self._communicator.exchange_buffers(self._sends, self._receives)
        records[self.first : self.first + self.count] = self._in

    def agree(self, stop: int, rebuild: bool = False) -> tuple[bool, int]:
        """Whether any rank requests a rebuild, and the largest request of a stop; an abort of one is that of
        all.

        stop, rebuild:  what this rank requests
        """
        control = self._state.control
        flags = self._flags
        flags[STOP] = stop
        flags[REBUILD] = int(rebuild)
        flags[ABORT] = int(control.abort[0])
        flags[PARTICLE] = -NO_PARTICLE
        if flags[ABORT]:
            flags[PARTICLE] = -int(control.abort_particle[0])
        agreed = self._communicator.largest_of(flags)
        if agreed[ABORT]:
            control.abort[0] = int(agreed[ABORT])
            control.abort_particle[0] = -int(agreed[PARTICLE])
        return bool(agreed[REBUILD]), int(agreed[STOP])


def _records(state: State) -> np.ndarray:
    """Records (capacity,) of positions, velocities and angular velocities, with radii and masses between
    them."""
    return state.built(_motion_records)


def _motion_records(state: State) -> np.ndarray:
    names = [name for name, field in PARTICLE_QUANTITIES.items() if field.block == "motion"]
    return records_of([field for name in names if (field := getattr(state.particles, name)) is not None])


def _parts(buffer: np.ndarray, lengths: list[int]) -> list[tuple[int, np.ndarray]]:
    """Rank and part of the buffer of records (sum of the lengths,), as bytes, for each rank with a length
    above 0."""
    ends = buffer.itemsize * np.cumsum([0, *lengths])
    bytes_of = buffer.view(np.uint8)
    return [(rank, bytes_of[ends[rank] : ends[rank + 1]]) for rank, length in enumerate(lengths) if length]


# Migration


@dataclass(frozen=True)
class Share:
    """The n particles of a rank after a migration, in the order that they have on the device from now on.

    arrays:     saved fields (n, ...)
    histories:  of the particles before the migration, and of the arrived ones
    rows:       (n,) which of `histories` each particle is, counted over both
    left, left_id:  (m,) which of `histories` the particles are that other ranks own now, and their ids,
                    ascending
    """

    arrays: Arrays
    histories: tuple[Histories, Histories]
    rows: np.ndarray
    left: np.ndarray
    left_id: np.ndarray

    def ghost_rows(self, ids: np.ndarray) -> np.ndarray:
        """Which of `histories` the ghosts with these ids (k,) are; WITHOUT_HISTORY if this rank has not owned
        them."""
        if not len(self.left):
            return np.full(len(ids), WITHOUT_HISTORY)
        place = np.minimum(np.searchsorted(self.left_id, ids), len(self.left) - 1)
        return np.where(self.left_id[place] == ids, self.left[place], WITHOUT_HISTORY)


def migrated(
    communicator: Communicator,
    particles: HostParticles,
    present: np.ndarray,
    to_rank: np.ndarray,
    cell_size: float,
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
    before = particles.arrays
    ids = particles.arrays["id"]
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
    """Order (n,) of particles by blocks of cells, as `engine.neighbor.sort.cell_number`: chunks are compact.

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
