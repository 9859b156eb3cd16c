"""Expectations: the sentence and the result of each."""

from types import SimpleNamespace

import pytest

from granflow.runs.result import evaluate

NUMBERS = {
    "mass_flow.outlet": 0.153, "angle_of_repose.heap": 0.4, "particle_count": 8000,
    "energy_error": float("nan"), "kinetic_energy": 1e-9
}  # fmt: skip


def expected(quantity, **bound):
    no_bounds = dict.fromkeys(("between", "below", "above", "equals", "tolerance"))
    return SimpleNamespace(quantity=quantity, **{**no_bounds, **bound})


@pytest.mark.parametrize(("expectation", "sentence", "met"), [
    (expected("mass_flow.outlet", between=(0.1, 0.2)),
     "mass_flow.outlet is 0.153 kg/s, as expected between 0.1 and 0.2 kg/s.", True),
    (expected("mass_flow.outlet", above=0.2),
     "mass_flow.outlet is 0.153 kg/s, but should be above 0.2 kg/s.", False),
    (expected("angle_of_repose.heap", above=0.3),
     "angle_of_repose.heap is 0.4 rad (22.92 deg), as expected above 0.3 rad.", True),
    (expected("kinetic_energy", below=1e-8), "kinetic_energy is 1e-09 J, as expected below 1e-08 J.", True),
    (expected("particle_count", equals=8000), "particle_count is 8000, as expected equal to 8000.", True),
    (expected("particle_count", equals=8001), "particle_count is 8000, but should be equal to 8001.",
     False),
    (expected("particle_count", equals=8001, tolerance=0.001),
     "particle_count is 8000, as expected equal to 8001 within 0.1 %.", True),
    (expected("kinetic_energy", equals=1.001e-9, tolerance=0.01),
     "kinetic_energy is 1e-09 J, as expected equal to 1.001e-09 J within 1 %.", True),
    (expected("energy_error", below=1.0), "energy_error is nan, but should be below 1.", False)
])  # fmt: skip
def test_sentence_states_value_bound_and_result(expectation, sentence, met):
    assert evaluate([expectation], NUMBERS) == [(sentence, met)]


def test_unknown_quantity_suggests_the_nearest_name():
    ((sentence, met),) = evaluate([expected("mass_flow.outlt", above=0)], NUMBERS)
    assert not met
    assert sentence == "mass_flow.outlt is not a number of this run. Did you mean mass_flow.outlet?"


def test_unknown_quantity_without_a_similar_name_lists_all():
    ((sentence, met),) = evaluate([expected("xyzzy", above=0)], NUMBERS)
    assert not met
    assert all(name in sentence for name in NUMBERS)
