"""Collisions over three decades under both linear springs: closed forms, and what is said of the claim."""

import numpy as np
import pytest
from study.test_compare import MASS_EFF, SPEED, duration, head_on, overlap_max, spring

from granflow.device import backend as backends
from granflow.study.compare.claim import judge_collisions
from granflow.study.compare.collisions import subject_of, sweep_columns, sweeps_of
from granflow.study.compare.variants import variants_of

REFERENCE = 0.1 * SPEED
FLOOR = 0.01 * SPEED
"""Per contact no spring is softer than that of a hundredth of the fastest approach."""


@pytest.fixture(scope="module")
def columns(taichi_f64):
    scene = head_on()
    subject = subject_of(scene, REFERENCE)
    backend = backends.start("cpu", "f64", 2)
    return sweep_columns(
        subject, sweeps_of(scene, subject, variants_of(scene, ["linear"], REFERENCE), backend, ["fine"])
    )


def of_law(columns, law, name):
    return columns[name][columns["law"] == law]


def test_exact_columns_are_those_of_hertz(columns):
    velocity = columns["velocity"]
    np.testing.assert_allclose(columns["duration_exact"], duration(velocity), rtol=1e-9)
    np.testing.assert_allclose(columns["overlap_max_exact"], overlap_max(velocity), rtol=1e-9)


@pytest.mark.parametrize("law", ["linear_onset", "linear_reference"])
def test_springs_collide_as_harmonic_oscillators(columns, law):
    """Half a period pi sqrt(M/alpha) and a largest overlap v sqrt(M/alpha), 100 steps and more in each."""
    velocity = of_law(columns, law, "velocity")
    alpha = spring(np.maximum(velocity, FLOOR)) if law == "linear_onset" else np.full(len(velocity), spring(REFERENCE))
    np.testing.assert_allclose(of_law(columns, law, "duration"), np.pi * np.sqrt(MASS_EFF / alpha), rtol=1e-3)
    np.testing.assert_allclose(of_law(columns, law, "overlap_max"), velocity * np.sqrt(MASS_EFF / alpha), rtol=1e-3)
    np.testing.assert_allclose(of_law(columns, law, "restitution"), 1.0, atol=1e-3)


def test_claim_is_judged_from_the_numbers(columns):
    """One spring is off by 10^0.2 at ten times its velocity; per contact nothing changes."""
    wrong, mended, unstable = judge_collisions(columns)
    assert wrong.holds and f"+{100.0 * (10.0**0.2 - 1.0):.1f} %" in wrong.why
    assert mended.holds and f"+{100.0 * (np.pi / 2.9432751838 - 1.0):.1f} %" in mended.why
    assert unstable.holds is None
