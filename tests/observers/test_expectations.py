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


@pytest.mark.parametrize(("quantity", "bound", "sentence", "met"), [
    ("mass_flow.outlet", {"between": (0.1, 0.2)}, "0.153 kg/s, as expected between 0.1 and 0.2 kg/s.", True),
    ("mass_flow.outlet", {"above": 0.2}, "0.153 kg/s, but should be above 0.2 kg/s.", False),
    ("angle_of_repose.heap", {"above": 0.3}, "0.4 rad (22.92 deg), as expected above 0.3 rad.", True),
    ("kinetic_energy", {"below": 1e-8}, "1e-09 J, as expected below 1e-08 J.", True),
    ("particle_count", {"equals": 8000}, "8000, as expected equal to 8000.", True),
    ("particle_count", {"equals": 8001}, "8000, but should be equal to 8001.", False),
    ("particle_count", {"equals": 8001, "tolerance": 0.001}, "8000, as expected equal to 8001 within 0.1 %.", True),
    ("kinetic_energy", {"equals": 1.001e-9, "tolerance": 0.01},
     "1e-09 J, as expected equal to 1.001e-09 J within 1 %.", True),
    ("energy_error", {"below": 1.0}, "nan, but should be below 1.", False),
])  # fmt: skip
def test_sentence_states_value_bound_and_result(quantity, bound, sentence, met):
    assert evaluate([expected(quantity, **bound)], NUMBERS) == [(f"{quantity} is {sentence}", met)]


def test_unknown_quantity_suggests_the_nearest_name_or_lists_all():
    similar, other = evaluate([expected("mass_flow.outlt", above=0), expected("xyzzy", above=0)], NUMBERS)
    assert similar == ("mass_flow.outlt is not a number of this run. Did you mean mass_flow.outlet?", False)
    assert not other[1] and all(name in other[0] for name in NUMBERS)
