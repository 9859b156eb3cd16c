"""Statistics of the comparison on synthetic snapshots: force distribution and heights."""

from types import SimpleNamespace

import numpy as np
import pytest

from granflow.snapshot import Snapshot
from granflow.studies.compare.bed import (
    FORCE_EDGES,
    BedHeights,
    ForceHistogram,
)


def snapshot(particles, contacts):
    return Snapshot(0.5, 0, "run", particles, contacts, {}, {})


def test_forces_of_an_exponential_distribution():
    """P = exp(-f/<f>): in a class from a to b the density is (exp(-a) - exp(-b)) / (b - a)."""
    force = np.random.default_rng(2).exponential(5.0, 200_000)
    forces = ForceHistogram()
    forces.update(snapshot({}, {"id_j": np.ones(len(force)), "normal_force": force}))
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
    heights.update(snapshot(particles, {}))
    assert heights.rows == [(0.5, 1.5, pytest.approx(1.5 + 0.95 * 2.0))]
    assert heights.typical_speed == 5.0
