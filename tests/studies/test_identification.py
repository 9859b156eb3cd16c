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
    """Residuals 20 (u - 0.3) and 5 (v - 0.6): standard deviations 1/sqrt(400 + 12) and 1/sqrt(25 + 12).

    With standard errors of the runs of 40 tolerances, the residuals do not limit the uniform deviation 1/sqrt(12).
    """
    u = np.random.default_rng(1).uniform(size=(40, 2))
    residuals = np.column_stack([20.0 * (u[:, 0] - 0.3), 5.0 * (u[:, 1] - 0.6)])
    found, optimum = deviations(u, residuals)
    assert found == pytest.approx([1 / np.sqrt(412.0), 1 / np.sqrt(37.0)], rel=1e-6)
    assert optimum == pytest.approx([0.3, 0.6]) and is_identified(found[0])
    (uncertain,), _ = deviations(u[:5, :1], 7.0 * (u[:5, :1] - 0.5), 4.0)
    assert uncertain == pytest.approx(np.sqrt(1.0 / 12.0)) and not is_identified(uncertain)


def test_parameters_of_a_sum_are_identified_only_together():
    """One residual with scatter responds to u and v through their sum only, and not to w.

    The sum is known: its direction has a vanishing variance, each of u and v keeps half of the uniform one.
    """
    random = np.random.default_rng(2)
    u = random.uniform(size=(60, 3))
    found, _ = deviations(u, 30.0 * (u[:, :1] + u[:, 1:2] - 1.0) + random.normal(0.0, 0.5, (60, 1)))
    assert found == pytest.approx([np.sqrt(1 / 24), np.sqrt(1 / 24), np.sqrt(1 / 12)], rel=0.05)
    assert not any(map(is_identified, found))
