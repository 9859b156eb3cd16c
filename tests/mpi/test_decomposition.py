"""Recursive coordinate bisection, and the selection of ghosts, in one process."""

from types import SimpleNamespace

import numpy as np
import pytest

from granflow.geometry.periodic_box import ImageMotion, PeriodicBox
from granflow.parallel.exchange import bisected, box_of, within


class AllParticles:
    """A communicator of a rank that has all particles, with a number of ranks to which they are
    distributed."""

    def __init__(self, size):
        self.size = size

    def sums(self, values):
        return values

    largest_of = sums


def ones(position):
    """Equal weights."""
    return np.ones(len(position), np.int64)


@pytest.mark.parametrize("ranks", [1, 2, 3, 5, 8])
@pytest.mark.parametrize("largest", [1, 49])
def test_each_rank_has_an_equal_weight(ranks, largest):
    """To two particles."""
    rng = np.random.default_rng(6)
    position = rng.normal(size=(1000, 3)) * [3.0, 1.0, 0.2]
    weights = rng.integers(1, largest + 1, 1000)
    owner = bisected(AllParticles(ranks), position, weights).owners(position)
    owned = np.bincount(owner, weights, minlength=ranks)
    assert len(owned) == ranks
    assert np.ptp(owned) <= 2 * largest


def test_parts_are_cut_across_their_longest_side():
    position = np.random.default_rng(2).random((1000, 3)) * [1.0, 5.0, 2.0]
    owner = bisected(AllParticles(2), position, ones(position)).owners(position)
    assert position[owner == 0, 1].max() < position[owner == 1, 1].min()


@pytest.mark.parametrize("count", [0, 100])
def test_particles_outside_the_bed_and_later_ones_have_an_owner(count):
    position = np.random.default_rng(3).random((count, 3))
    found = bisected(AllParticles(3), position, ones(position))
    assert set(found.owners(np.array([[-9.0, 0.5, 0.5], [9.0, 9.0, 9.0], [0.1, 0.2, 0.3]]))) <= {0, 1, 2}


SHEAR = ImageMotion(flow=1, gradient=0, speed=1.0, start=0.0)


@pytest.mark.parametrize(
    ("axes", "motion"), [((), None), ((0,), None), ((0, 1, 2), None), ((0, 1, 2), SHEAR)]
)
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
