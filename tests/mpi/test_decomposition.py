"""Decomposition of space among ranks, its balance by measured times, and the selection of ghosts."""

from types import SimpleNamespace

import numpy as np
import pytest

from granflow.geometry.periodic_box import ImageMotion, PeriodicBox
from granflow.parallel.exchange import (
    CONTACT_WEIGHT,
    PARTICLE_WEIGHT,
    LoadBalance,
    MeasuredCost,
    box_of,
    migration_pays,
    relative_costs,
    within,
)


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
    assert migration_pays([MeasuredCost(0.012, steps, 0.03), MeasuredCost(0.008, steps, 0.04)]) is due
    assert not migration_pays([MeasuredCost(0.012, 10 * steps, 0.03), MeasuredCost(0.012, 10 * steps, 0.04)])
    assert not migration_pays([MeasuredCost(np.inf, 0, 0.01), MeasuredCost(np.inf, 0, 0.01)])
    assert not migration_pays([MeasuredCost(2e-4, 10**6, 0.01), MeasuredCost(1e-4, 10**6, 0.01)])


class AllParticles:
    """A communicator of rank 0, which has all particles and has measured its time alone."""

    rank = 0

    def __init__(self, size):
        self.size = size

    def from_each(self, value):
        return [value, *[(0, np.inf)] * (self.size - 1)]

    def sums(self, values):
        return values

    largest_of = sums


@pytest.mark.parametrize("ranks", [2, 3, 8])
def test_ranks_have_equal_weights_and_later_particles_an_owner(ranks):
    """To three particles; those with contacts weigh more. The first cut is across the longest side."""
    rng = np.random.default_rng(6)
    position = rng.random((1000, 3)) * [1.0, 4.0, 2.0]
    contacts = np.where(position[:, 1] < 2.0, 6, 0)
    balance = LoadBalance(AllParticles(ranks))
    owner = balance.owners(position, contacts)
    weights = PARTICLE_WEIGHT + CONTACT_WEIGHT * contacts
    owned = np.bincount(owner, weights, minlength=ranks)
    assert len(owned) == ranks and np.ptp(owned) <= 3 * weights.max()
    assert position[owner < ranks // 2, 1].max() < position[owner >= ranks // 2, 1].min()
    assert np.bincount(owner)[-1] > 1.4 * np.bincount(owner)[0]
    later = np.array([[-9.0, 0.5, 0.5], [9.0, 9.0, 9.0], [0.1, 0.2, 0.3]])
    assert set(balance.owners(later, np.zeros(3, int))) <= set(range(ranks))
    empty = LoadBalance(AllParticles(ranks))
    assert len(empty.owners(np.zeros((0, 3)), np.zeros(0, int))) == 0
    assert set(empty.owners(later, np.zeros(3, int))) <= set(range(ranks))


SHEAR = ImageMotion(flow=1, gradient=0, speed=1.0, start=0.0)


@pytest.mark.parametrize(("axes", "motion"), [((), None), ((0, 1, 2), None), ((0, 1, 2), SHEAR)])
def test_ghosts_contain_all_pairs_within_reach(axes, motion):
    rng = np.random.default_rng(5)
    width = np.array([1.0, 0.8, 0.6])
    position = rng.random((600, 3)) * width
    reach = rng.uniform(0.02, 0.06, 600)
    box = PeriodicBox(axes, np.zeros(3), width, motion)
    plan = SimpleNamespace(
        periodic_box=box, domain_low=np.zeros(3), domain_high=width, laws=SimpleNamespace(range=0.01)
    )
    own, other = position[:, 0] < 0.3, position[:, 0] >= 0.3
    ghosts = within(
        SimpleNamespace(plan=plan), box_of(position[own], reach[own]), position[other], reach[other]
    )
    for time in (0.0, 0.13, 0.37):  # images of the shear are at other places
        images = box.at(time).nearest_images(
            np.repeat(position[other], own.sum(), axis=0), np.tile(position[own], (other.sum(), 1))
        )
        branch = images.reshape(other.sum(), own.sum(), 3) - position[own][None]
        needed = np.linalg.norm(branch, axis=2) < reach[other][:, None] + reach[own][None] + 0.01
        assert set(np.flatnonzero(needed.any(axis=1))) <= set(ghosts)
    assert len(ghosts) < 0.9 * other.sum()
