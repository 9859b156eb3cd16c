"""Balance of the computing time of the ranks, with threads in place of ranks."""

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import numpy as np
import pytest

from granflow.parallel.exchange import (
    CONTACT_WEIGHT,
    PARTICLE_WEIGHT,
    LoadBalance,
    MeasuredCost,
    migration_pays,
    relative_costs,
)

COUNT = 4000
SLOW_STEP = 0.01
"""Computing time [s] of a step that is long enough to be compared."""


class ThreadRanks:
    """Communicators of ranks that are threads of this process."""

    def __init__(self, size):
        self.size = size
        self.barrier = Barrier(size)
        self.values = [None] * size

    def on_each(self, rank, value):
        """The values of all ranks."""
        self.values[rank] = value
        self.barrier.wait(timeout=60)
        found = list(self.values)
        self.barrier.wait(timeout=60)
        return found

    def run(self, function):
        """Results of function(communicator) on all ranks."""
        with ThreadPoolExecutor(self.size) as pool:
            return list(pool.map(lambda rank: function(ThreadRank(self, rank)), range(self.size)))


class ThreadRank:
    """The communicator of one of these ranks."""

    def __init__(self, ranks, rank):
        self.ranks = ranks
        self.rank = rank
        self.size = ranks.size

    def from_each(self, value):
        return self.ranks.on_each(self.rank, value)

    def sums(self, values):
        return np.sum(self.from_each(values), axis=0)

    def largest_of(self, values):
        return np.max(self.from_each(values), axis=0)


def owner_of(position, contacts, *measured):
    """Rank of each particle after a rebuild, and after each further one, before which the ranks measure times
    [s]."""

    def rebuilds(communicator):
        balance = LoadBalance(communicator)
        own = np.array_split(np.arange(COUNT), communicator.size)[communicator.rank]
        found = []
        for seconds in (None, *measured):
            if seconds is not None:
                own_seconds = seconds[communicator.rank]
                balance.record(0.5 * own_seconds)
                balance.record(1.5 * own_seconds)
            moved = balance.owners(position[own], contacts[own])
            owners, rows = (
                np.concatenate(part) for part in zip(*communicator.from_each((moved, own)), strict=True)
            )
            found.append(owners[np.argsort(rows)])
            own = np.flatnonzero(found[-1] == communicator.rank)
        return found

    return ThreadRanks(2).run(rebuilds)[0]


@pytest.fixture
def position():
    """Positions in a long box."""
    return np.random.default_rng(1).random((COUNT, 3)) * [4.0, 1.0, 1.0]


def test_ranks_have_equal_weights_and_unequal_counts(position):
    """Particles with contacts weigh more; without measured times nothing moves between two rebuilds."""
    contacts = np.where(position[:, 0] < 2.0, 6, 0)
    owner = owner_of(position, contacts)[0]
    weights = np.bincount(owner, PARTICLE_WEIGHT + CONTACT_WEIGHT * contacts)
    assert weights.max() < 1.002 * weights.mean()
    counts = np.bincount(owner)
    assert counts.max() > 1.4 * counts.min()


def test_measured_times_move_the_cut(position):
    contacts = np.full(COUNT, 4)
    first, second = owner_of(position, contacts, (2.0 * SLOW_STEP, SLOW_STEP))
    assert abs(np.bincount(first)[0] - COUNT // 2) <= 1
    # Rank 0 needs twice the time per particle: n0 * 4/3 = n1 * 2/3 + (particles of rank 0 that move) * 4/3.
    assert abs(np.bincount(second)[0] - 3 * COUNT // 8) <= 2


@pytest.mark.parametrize("seconds", [(1.05 * SLOW_STEP, SLOW_STEP), (2e-4, 1e-4)])
def test_small_imbalance_and_times_of_launches_do_not_move_the_cut(position, seconds):
    first, second = owner_of(position, np.full(COUNT, 4), seconds)
    assert (first == second).all()


def test_costs_are_limited_and_need_the_times_of_all_ranks():
    weights = np.array([100, 100])
    assert relative_costs(weights, np.array([0.01, np.inf])).tolist() == [1.0, 1.0]
    assert relative_costs(np.array([200, 0]), np.array([0.01, 0.01])).tolist() == [1.0, 1.0]
    np.testing.assert_allclose(relative_costs(weights, np.array([0.03, 0.01])), [1.5, 0.5])
    assert relative_costs(np.array([100, 1000]), np.array([0.1, 0.01]))[0] == 2.0


@pytest.mark.parametrize(("steps", "due"), [(39, False), (41, True)])
def test_migration_is_due_when_waiting_has_cost_twice_its_time(steps, due):
    """Steps of 12 and 8 ms: 2 ms over the mean in each, 80 ms in 40 steps, twice the 40 ms of the slower
    migration."""
    costs = [MeasuredCost(0.012, steps, 0.03), MeasuredCost(0.008, steps, 0.04)]
    assert migration_pays(costs) is due
    assert not migration_pays([MeasuredCost(0.012, 10 * steps, 0.03), MeasuredCost(0.012, 10 * steps, 0.04)])
    assert not migration_pays([MeasuredCost(np.inf, 0, 0.01), MeasuredCost(np.inf, 0, 0.01)])
    assert not migration_pays([MeasuredCost(2e-4, 10**6, 0.01), MeasuredCost(1e-4, 10**6, 0.01)])
