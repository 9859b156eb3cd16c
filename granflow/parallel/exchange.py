"""Which rank owns a particle, and what ranks exchange.

Space is divided among the ranks by recursive coordinate bisection (Berger and Bokhari 1987). `LoadBalance`
measures the steps of each rank, gives the particles their weights, and decides when space is divided again.
Its rule depends on measured times: which rank owns a particle has no influence on the bits of a run.

Ghosts are copies of particles that other ranks own, within reach of the particles of this rank.
`GhostExchange` selects them at each neighbor-list rebuild, and updates them in each step. `migrated` sends
particles, with their contact histories, to the ranks that own their positions.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from granflow.engine.codes import NO_PARTICLE
from granflow.engine.fields import records_of
from granflow.engine.host import WITHOUT_HISTORY, Histories, HostParticles, joined_arrays, joined_particles
from granflow.engine.neighbor.sort import BLOCK_SIDE, KEPT_REACH
from granflow.engine.state import Arrays, State
from granflow.fields import PARTICLE_QUANTITIES
from granflow.parallel.communicator import Communicator

# Decomposition of space

BISECTIONS = 40
"""Halvings of the range of a cut: its position is then exact to 1e-12 of the size of the bed."""
NO_CUT = -1
"""Axis of a node that belongs to one rank."""


@dataclass(frozen=True)
class Decomposition:
    """A binary tree of cuts.

    axis:    (nodes,) axis of the cut, or NO_CUT
    cut:     (nodes,) coordinate [m] of the cut
    child:   (nodes,) node below the cut; the node above it is the next one
    rank:    (nodes,) lowest rank of the node
    """

    axis: np.ndarray
    cut: np.ndarray
    child: np.ndarray
    rank: np.ndarray

    def owners(self, position: np.ndarray) -> np.ndarray:
        """Rank (n,) that owns particles at positions (n, 3) [m]."""
        node = np.zeros(len(position), np.int64)
        while True:
            is_cut = self.axis[node] != NO_CUT
            if not is_cut.any():
                return self.rank[node]
            rows = np.flatnonzero(is_cut)
            inner = node[is_cut]
            above = position[rows, self.axis[inner]] >= self.cut[inner]
            node[rows] = self.child[inner] + above


def bisected(communicator: Communicator, position: np.ndarray, weights: np.ndarray) -> Decomposition:
    """Decomposition into parts of equal weight; all ranks call this together.

    position:  (n, 3) [m] of the particles of this rank
    weights:   (n,) integers: their sums are exact, so that all ranks find the same cuts

    Each level of the tree cuts all its nodes at once, across their longest side, between the numbers of ranks
    of both parts. Only sums are communicated.
    """
    first = [0]
    ranks = [communicator.size]
    axis = [NO_CUT]
    cut = [0.0]
    child = [0]
    node = np.zeros(len(position), np.int64)
    level = [0]
    while level := [each for each in level if ranks[each] > 1]:
        row = np.full(len(ranks), -1)
        row[level] = np.arange(len(level))
        inside = row[node] >= 0
        part = row[node[inside]]
        points = position[inside]
        shares = np.array([(ranks[each] // 2) / ranks[each] for each in level])
        axes, cuts = _cuts(communicator, part, points, weights[inside], shares)
        below = []
        for number, each in enumerate(level):
            axis[each] = int(axes[number])
            cut[each] = float(cuts[number])
            child[each] = len(ranks)
            low = ranks[each] // 2
            below += [len(ranks), len(ranks) + 1]
            first += [first[each], first[each] + low]
            ranks += [low, ranks[each] - low]
            axis = [*axis, NO_CUT, NO_CUT]
            cut = [*cut, 0.0, 0.0]
            child = [*child, 0, 0]
        above = points[np.arange(len(points)), axes[part]] >= cuts[part]
        node[inside] = np.array(child)[node[inside]] + above
        level = below
    return Decomposition(np.array(axis), np.array(cut), np.array(child), np.array(first))


def _cuts(
    communicator: Communicator, part: np.ndarray, points: np.ndarray, weights: np.ndarray, shares: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Axis and coordinate [m] of the cut of each of k parts.

    part:    (n,) part of each particle
    points:  (n, 3) positions [m]
    weights: (n,) integers
    shares:  (k,) share of the weight below the cut
    """
    parts = len(shares)
    bounds = np.full((2, parts, 3), -np.inf)
    np.maximum.at(bounds[0], part, points)
    np.maximum.at(bounds[1], part, -points)
    largest = communicator.largest_of(bounds)
    largest[~np.isfinite(largest)] = 0.0  # without particles
    high = largest[0]
    low = -largest[1]
    axes = np.argmax(high - low, axis=1)
    rows = np.arange(parts)
    begin = low[rows, axes]
    end = high[rows, axes]
    along = points[np.arange(len(points)), axes[part]]

    def summed(selected: np.ndarray) -> np.ndarray:
        """Weight (k,) of the selected particles (n,) of each part."""
        own = np.bincount(part[selected], weights[selected], minlength=parts)
        return communicator.sums(own.astype(np.int64))

    wanted = shares * summed(np.ones(len(part), bool))
    for _ in range(BISECTIONS):
        middle = 0.5 * (begin + end)
        below = summed(along < middle[part])
        begin = np.where(below < wanted, middle, begin)
        end = np.where(below < wanted, end, middle)
    return axes, end


# Balance of the computing time

IMBALANCE = 1.03
"""Largest over mean cost of a rank above which a migration decomposes space again."""
LOSS = 2.0
"""A migration is due if imbalance has cost this multiple of the time of a migration since the last one."""
PARTICLE_WEIGHT = 2
CONTACT_WEIGHT = 1
"""Cost of a particle with six walls, and of a contact in the list of one particle: 40 and 24 ns, measured."""
LARGEST_FACTOR = 2.0
"""Limit of the measured cost of a unit of weight on a rank over the mean, and of its inverse."""
SHORTEST_STEP = 5e-4
"""Mean computing time [s] of a step below which costs are those of the weights: it is mostly that of the
launches."""
WEIGHT_STEPS = 256
"""Integer steps of a weight: sums of integers are equal on all ranks."""


@dataclass(frozen=True)
class MeasuredCost:
    """Times of one rank since the last migration.

    step:       mean computing time [s] of a step, without messages; infinite if it has taken none
    steps:      number of steps
    migration:  time [s] of that migration
    """

    step: float
    steps: int
    migration: float


class LoadBalance:
    """Decomposes space into parts of equal cost.

    The cost of a particle is its weight, which grows with its contacts, times the time per weight that its
    rank has measured: the mean of the steps since the last migration, so that a slower or shared core has
    fewer particles.

    `migration_seconds`: time [s] of the last migration.
    """

    def __init__(self, communicator: Communicator) -> None:
        self._communicator = communicator
        self._decomposition: Decomposition | None = None
        self._seconds = 0.0
        self._steps = 0
        self.migration_seconds = np.inf

    def record(self, seconds: float) -> None:
        """Account for a step that took this computing time [s] on this rank, without messages."""
        self._seconds += seconds
        self._steps += 1

    @property
    def cost(self) -> MeasuredCost:
        """What this rank has measured since the last migration."""
        step = self._seconds / self._steps if self._steps else np.inf
        return MeasuredCost(step, self._steps, self.migration_seconds)

    def owners(self, position: np.ndarray, contacts: np.ndarray) -> np.ndarray:
        """Rank (n,) that owns each particle of this rank from now on; all ranks call this together.

        position:  (n, 3) [m]
        contacts:  (n,) number of contacts in the list of each particle
        """
        weights = PARTICLE_WEIGHT + CONTACT_WEIGHT * contacts
        gathered = self._communicator.from_each((int(weights.sum()), self.cost.step))
        sums = np.array([weight for weight, _ in gathered])
        seconds = np.array([step for _, step in gathered])
        self._seconds = 0.0
        self._steps = 0
        factors = relative_costs(sums, seconds)
        costs = factors * sums
        if self._decomposition is None or costs.max() > IMBALANCE * costs.mean():
            scaled = np.rint(WEIGHT_STEPS * factors[self._communicator.rank] * weights).astype(np.int64)
            self._decomposition = bisected(self._communicator, position, scaled)
        return self._decomposition.owners(position)


def migration_pays(costs: Sequence[MeasuredCost]) -> bool:
    """Whether waiting for the slowest rank has cost more than a migration, which could have prevented it.

    costs:  of all ranks

    Migrations that do not help take at most half as much time as the waiting that makes them due.
    """
    step = np.array([each.step for each in costs])
    if not np.isfinite(step).all() or step.mean() < SHORTEST_STEP:
        return False
    loss = float(step.max() - step.mean()) * costs[0].steps
    return loss > LOSS * max(each.migration for each in costs)


def relative_costs(weights: np.ndarray, seconds: np.ndarray) -> np.ndarray:
    """Measured cost (ranks,) of a unit of weight on each rank, over the mean.

    weights:  (ranks,) sum of the weights of each rank
    seconds:  (ranks,) computing time [s] of a step of each rank; infinite if it has measured none

    1 if the times are too short or a rank has measured none.
    """
    if not np.isfinite(seconds).all() or not weights.all() or seconds.mean() < SHORTEST_STEP:
        return np.ones(len(weights))
    cost = seconds / weights
    found: np.ndarray = np.clip(cost * (weights.sum() / seconds.sum()), 1.0 / LARGEST_FACTOR, LARGEST_FACTOR)
    return found


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
    `engine.neighbor.sort.Bounds`."""
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
        reach_time:  [s], see `engine.neighbor.sort.Bounds`
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
    """Records (capacity,) of the properties that ghosts get in every step, see `FieldSpec.of_ghosts`."""
    return state.built(_ghost_records)


def _ghost_records(state: State) -> np.ndarray:
    names = [name for name, field in PARTICLE_QUANTITIES.items() if field.of_ghosts]
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
