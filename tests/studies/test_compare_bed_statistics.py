"""Statistics of the comparison on synthetic snapshots: contact durations, force distribution, heights."""

from types import SimpleNamespace

import numpy as np
import pytest

from granflow.snapshot import Snapshot
from granflow.studies.compare.bed import (
    FORCE_EDGES,
    BedHeights,
    ContactBursts,
    ContactFollower,
    FollowedContacts,
    ForceHistogram,
    bursts,
    median_of,
    survival,
)


def snapshot(time, pairs=(), forces=None, particles=None, branches=None):
    """Snapshot with contacts (id_i, id_j, wall), and branch vectors if pairs have several contacts."""
    rows = np.array(pairs, dtype=np.int64).reshape(-1, 3)
    force = np.ones(len(rows)) if forces is None else np.asarray(forces, dtype=float)
    start = np.ones((len(rows), 3))
    end = start + (np.zeros((len(rows), 3)) if branches is None else np.asarray(branches, dtype=float))
    contacts = {
        "id_i": rows[:, 0], "id_j": rows[:, 1], "wall": rows[:, 2], "normal_force": force,
        "position_i": start, "position_j": end,
    }  # fmt: skip
    return Snapshot(time, 0, "run", particles or {}, contacts, {}, {})


A, A_SWAPPED, WALL = (3, 7, -1), (7, 3, -1), (3, -1, 0)


def test_contacts_begin_and_end_midway_between_samples_and_are_followed_by_their_direction():
    """A particle in a mesh groove: on the left face from 0.5 to 4.5 s, on the right one from 1.5 to 2.5 s; and a
    pair from 0.5 to 2.5 s.

    The contact turns as the particle moves, and its row changes with the order of the triangles.
    """
    record = FollowedContacts()
    follower = ContactFollower(record)
    left, right, pair = (-1.0, 0.0, -1.0), (1.0, 0.0, -1.0), (0.0, 1.0, 0.0)
    follower.update(snapshot(0.0))
    follower.update(snapshot(1.0, [WALL, A], branches=[left, pair]))
    follower.update(snapshot(2.0, [WALL, A_SWAPPED, WALL], branches=[right, pair, (-1.1, 0.0, -0.9)]))
    follower.update(snapshot(3.0, [WALL], branches=[(-1.2, 0.0, -0.8)]))
    follower.update(snapshot(4.0, [WALL], branches=[left]))
    follower.update(snapshot(5.0))
    seen, ended = record.arrays()
    assert sorted(seen.tolist()) == [1.0, 2.0, 4.0] and ended.all()


def test_survival_matches_kaplan_and_meier():
    """Five contacts: an end at 1 (share 4/5), one censored at 2, an end at 3 (4/5 2/3), an end at 4 (half of
    it)."""
    times, share = survival(np.array([1.0, 2.0, 3.0, 4.0, 5.0]), np.array([True, False, True, True, False]))
    np.testing.assert_array_equal(times, [1.0, 3.0, 4.0])
    np.testing.assert_allclose(share, [4 / 5, 8 / 15, 4 / 15])
    assert median_of(times, share) == 4.0
    assert np.isnan(median_of(*survival(np.ones(3), np.zeros(3, dtype=bool))))


def test_bursts_sample_only_when_due():
    times = list(bursts(1.0, 2, 3, 0.01))
    np.testing.assert_allclose(times, [[0.25, 0.26, 0.27], [0.75, 0.76, 0.77]])
    monitor = ContactBursts(times, 0.01)
    assert monitor.next_time() == 0.25
    touching = {
        0.0: True,
        0.25: False,
        0.26: True,
        0.27: True,
        0.75: False,
        0.76: True,
        0.77: False,
        1.0: True,
    }
    for time, touches in touching.items():
        monitor.observe(snapshot(time, [A] if touches else []))
    monitor.finish()
    assert monitor.next_time() == np.inf
    seen, ended = monitor.followed.arrays()
    np.testing.assert_allclose(seen, [0.015, 0.01])
    assert sorted(ended) == [False, True]


def test_forces_of_an_exponential_distribution():
    """P = exp(-f/<f>): in a class from a to b the density is (exp(-a) - exp(-b)) / (b - a)."""
    force = np.random.default_rng(2).exponential(5.0, 200_000)
    pairs = np.stack([np.zeros(len(force)), np.ones(len(force)), -np.ones(len(force))], axis=1)
    forces = ForceHistogram()
    forces.update(snapshot(0.0, pairs, force))
    low, high = FORCE_EDGES[:-2], FORCE_EDGES[1:-1]
    expected = (np.exp(-low) - np.exp(-high)) / (high - low)
    sigma = np.sqrt(expected / (len(force) * (high - low)))
    assert np.all(np.abs(forces.density("run") - expected) < 5.0 * sigma)
    assert forces.share_above("run", 2.0) == pytest.approx(np.exp(-2.0), rel=0.02)


def test_heights_are_opposite_to_gravity():
    particles = {
        "position": np.array([[1.0, 9.0, 9.0], [3.0, 0.0, 0.0]]), "mass": np.array([3.0, 1.0]),
        "radius": np.array([0.5, 0.5]), "velocity": np.array([[3.0, 4.0, 0.0]] * 2),
    }  # fmt: skip
    heights = BedHeights.of(SimpleNamespace(usual_gravity=(-2.0, 0.0, 0.0)))
    heights.update(snapshot(0.5, particles=particles))
    assert heights.rows == [(0.5, 1.5, pytest.approx(1.5 + 0.95 * 2.0))]
    assert heights.typical_speed == 5.0
