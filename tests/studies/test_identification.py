"""What targets determine, from responses with known effects and known scatter."""

import numpy as np
import pytest

from granflow.studies.calibration.response import fit_response, is_identified


def deviations(u, residuals, error=0.0):
    """Standard deviations at the best trial, and the parameters at the optimum of the fit."""
    best = int(np.argmin((residuals**2).sum(axis=1)))
    response = fit_response(u, residuals, best, np.full_like(residuals, error), highest=1)
    return response.deviation(u[best]), response.optimum(u[best])


def test_uncertainty_of_exact_linear_residuals():
    """Residuals 20 (u - 0.3) and 5 (v - 0.6): standard deviations 1/sqrt(400 + 12) and 1/sqrt(25 + 12)."""
    u = np.random.default_rng(1).uniform(size=(40, 2))
    found, optimum = deviations(u, np.column_stack([20.0 * (u[:, 0] - 0.3), 5.0 * (u[:, 1] - 0.6)]))
    assert found == pytest.approx([1 / np.sqrt(412.0), 1 / np.sqrt(37.0)], rel=1e-6)
    assert optimum == pytest.approx([0.3, 0.6])


def test_standard_errors_of_the_runs_limit_what_is_identified():
    """A residual 7 (u - 0.5) that chance makes exact, with errors of 4 tolerances."""
    u = np.linspace(0.0, 1.0, 5)[:, None]
    (uncertain,), _ = deviations(u, 7.0 * (u - 0.5), 4.0)
    assert uncertain == pytest.approx(np.sqrt(1.0 / 12.0)) and not is_identified(uncertain)
    assert is_identified(deviations(u, 7.0 * (u - 0.5))[0][0])


def test_parameters_of_a_sum_are_identified_only_together():
    """One residual with scatter responds to u and v through their sum only, and not to w.

    The sum is known: its direction has a vanishing variance, each of u and v keeps half of the uniform one.
    """
    random = np.random.default_rng(2)
    u = random.uniform(size=(60, 3))
    found, _ = deviations(u, 30.0 * (u[:, :1] + u[:, 1:2] - 1.0) + random.normal(0.0, 0.5, (60, 1)))
    assert found == pytest.approx([np.sqrt(1 / 24), np.sqrt(1 / 24), np.sqrt(1 / 12)], rel=0.05)
    assert not any(map(is_identified, found))


def test_a_parameter_without_effect_is_rarely_identified():
    """A residual that responds to the first parameter only, with a scatter of 1 of 18 of its effect."""
    count = np.zeros(2)
    for seed in range(100):
        random = np.random.default_rng(seed)
        u = random.uniform(size=(40, 2))
        residuals = 18.0 * (u[:, :1] - 0.3) + random.normal(size=(40, 1))
        count += [is_identified(each) for each in deviations(u, residuals)[0]]
    assert count[0] >= 90 and count[1] <= 2
