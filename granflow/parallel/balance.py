"""Balance of the computing time of the ranks: when a migration decomposes space again, and with which weights.

The rule depends on measured times. Which rank owns a particle has no influence on the bits of a run.
"""

from math import inf

import numpy as np

from granflow.parallel.communicator import Communicator
from granflow.parallel.decomposition import Decomposition, bisected

IMBALANCE = 1.1
"""Largest over mean cost of a rank above which a migration decomposes space again."""

PARTICLE_WEIGHT, CONTACT_WEIGHT = 2, 1
"""Cost of a particle with six walls, and of a contact in the list of one particle: 40 and 24 ns, measured."""

LARGEST_FACTOR = 2.0
"""Limit of the measured cost of a unit of weight on a rank over the mean, and of its inverse."""

SHORTEST_STEP = 5e-4
"""Mean computing time [s] of a step below which costs are those of the weights: it is mostly that of the launches."""

WEIGHT_STEPS = 256
"""Integer steps of a weight: sums of integers are equal on all ranks."""


class LoadBalance:
    """Decomposes space into parts of equal cost.

    The cost of a particle is its weight, which grows with its contacts, times the time per weight that its rank has
    measured: that of the fastest step since the last migration, which other programs of the machine have not disturbed.
    """

    def __init__(self, communicator: Communicator) -> None:
        self._communicator = communicator
        self._decomposition: Decomposition | None = None
        self._seconds = inf

    def record(self, seconds: float) -> None:
        """Account for a step that took this computing time [s] on this rank, without messages."""
        self._seconds = min(self._seconds, seconds)

    def owners(self, position: np.ndarray, contacts: np.ndarray) -> np.ndarray:
        """Rank (n,) that owns each particle of this rank from now on; all ranks call this together.

        position:  (n, 3) [m]
        contacts:  (n,) number of contacts in the list of each particle
        """
        weights = PARTICLE_WEIGHT + CONTACT_WEIGHT * contacts
        gathered = self._communicator.from_each((int(weights.sum()), self._seconds))
        sums, seconds = map(np.array, zip(*gathered, strict=True))
        self._seconds = inf
        factors = relative_costs(sums, seconds)
        costs = factors * sums
        if self._decomposition is None or costs.max() > IMBALANCE * costs.mean():
            scaled = np.rint(WEIGHT_STEPS * factors[self._communicator.rank] * weights).astype(np.int64)
            self._decomposition = bisected(self._communicator, position, scaled)
        return self._decomposition.owners(position)


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
