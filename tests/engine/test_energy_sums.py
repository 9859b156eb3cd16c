"""Sums of the energy budget, compared with values computed by hand; no device is needed."""

from types import SimpleNamespace

import numpy as np
import pytest

from granflow.engine.state import OneProcess
from granflow.engine.totals import Accounting, energy_budget_totals, mechanical_energy
from granflow.plan.sum_units import LOSSES

ENERGIES = (7.0, 2.0, -4.0)
"""Kinetic, rotational and gravitational energy [J]."""

LOSS_VALUES = dict(zip(LOSSES, (0.5, 0.25, 0.125, 1.0, 3.0), strict=True))
ENERGY_UNIT = 2.0**-40
"""Unit of the sums [J] of the test."""
MEASURED = {"elastic_energy": 1.5, "plastic_dissipation": 0.75}


def test_mechanical_energy_of_two_particles():
    """m v^2 / 2, (2/5 m r^2) w^2 / 2 and -m g x; a fixed particle contributes none."""
    arrays = {
        "mass": np.array([2.0, 3.0, 100.0]), "radius": np.array([0.5, 1.0, 1.0]), "fixed": np.array([0, 0, 1]),
        "position": np.array([[0.0, 0.0, 4.0], [0.0, 0.0, -1.0], [0.0, 0.0, 9.0]]),
        "velocity": np.array([[3.0, 0.0, 4.0], [0.0, 2.0, 0.0], [1.0, 0.0, 0.0]]),
        "angular_velocity": np.array([[0.0, 0.0, 2.0], [10.0, 0.0, 0.0], [5.0, 0.0, 0.0]]),
    }  # fmt: skip
    kinetic, rotational, potential = mechanical_energy(arrays, np.array([0.0, 0.0, -10.0]))
    assert kinetic == pytest.approx(25.0 + 6.0)
    assert rotational == pytest.approx(0.5 * 0.4 * 2.0 * 0.25 * 4.0 + 0.5 * 0.4 * 3.0 * 100.0)
    assert potential == pytest.approx(80.0 - 30.0)


def totals(inserted, removed=0.5, **changes):
    losses = LOSS_VALUES | changes
    words = [[int(losses[name] * 2 / ENERGY_UNIT) for name in LOSSES] + [0] * len(LOSSES)]
    field = SimpleNamespace(to_numpy=lambda: np.array(words))
    state = SimpleNamespace(
        control=SimpleNamespace(losses=field, boundary_work=None, external_work=None, wall_work_ahead=None),
        wall_dynamics=None,
        ranks=OneProcess(),
    )
    state.backend = SimpleNamespace(precision="f64", on_cpu=True)
    state.plan = SimpleNamespace(sum_units=SimpleNamespace())
    state.plan.sum_units.energy = ENERGY_UNIT
    return energy_budget_totals(
        state, Accounting(inserted_energy=inserted, removed_energy=removed), ENERGIES, MEASURED
    )


BALANCED = 7.0 + 2.0 - 4.0 + 1.5 + (0.5 + 0.75 + 0.25 + 0.125 + 1.0) + 0.5 - 3.0
"""Inserted energy [J] that closes the budget: stored + dissipated + removed - work of walls."""


def test_each_entry_of_the_budget_has_its_sign():
    budget = totals(BALANCED)
    assert budget["energy_error"] == pytest.approx(0.0, abs=1e-12)
    assert budget["plastic_dissipation"] == 1.25
    for name, sign in zip(LOSSES, (1, 1, 1, 1, -1), strict=True):
        assert np.sign(totals(BALANCED, **{name: LOSS_VALUES[name] + 0.5})["energy_error"]) == sign, name
    assert totals(BALANCED + 0.5)["energy_error"] < 0.0
    assert totals(BALANCED, removed=1.0)["energy_error"] > 0.0
