"""Which rank owns a particle: decomposition of space, and its balance of computing time.

Space is divided among the ranks by recursive coordinate bisection (Berger and Bokhari 1987). `LoadBalance`
measures the steps of each rank, gives the particles their weights, and decides when space is divided again.
Its rule depends on measured times: which rank owns a particle has no influence on the bits of a run.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

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
