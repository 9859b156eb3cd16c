"""Expectations become sentences, met or not."""

from types import SimpleNamespace

import pytest

from granflow.observe import evaluate

NUMBERS = {"mass_flow.outlet": 0.153, "particle_count": 8000, "energy_error": float("nan"), "kinetic_energy": 1e-9}


def requested(quantity, **bound):
    nothing = dict.fromkeys(("between", "below", "above", "equals", "tolerance"))
    return SimpleNamespace(quantity=quantity, **{**nothing, **bound})


@pytest.mark.parametrize(
    ("expectation", "sentence", "met"),
    [
        (
            requested("mass_flow.outlet", between=(0.1, 0.2)),
            "mass_flow.outlet is 0.153 kg/s, as expected between 0.1 and 0.2 kg/s.",
            True,
        ),
        (
            requested("mass_flow.outlet", above=0.2),
            "mass_flow.outlet is 0.153 kg/s, but should be above 0.2 kg/s.",
            False,
        ),
        (requested("kinetic_energy", below=1e-8), "kinetic_energy is 1e-09 J, as expected below 1e-08 J.", True),
        (requested("particle_count", equals=8000), "particle_count is 8000, as expected equal to 8000.", True),
        (requested("particle_count", equals=8001), "particle_count is 8000, but should be equal to 8001.", False),
        (
            requested("particle_count", equals=8001, tolerance=0.001),
            "particle_count is 8000, as expected equal to 8001 within 0.100%.",
            True,
        ),
        (requested("energy_error", below=1.0), "energy_error is nan, but should be below 1.", False),
    ],
)
def test_sentence(expectation, sentence, met):
    assert evaluate([expectation], NUMBERS) == [(sentence, met)]


def test_unknown_quantity_names_the_nearest():
    ((sentence, met),) = evaluate([requested("mass_flow.outlt", above=0)], NUMBERS)
    assert not met
    assert sentence == "mass_flow.outlt is not a number of this run. Did you mean mass_flow.outlet?"


def test_unknown_quantity_with_nothing_near_lists_all():
    ((sentence, met),) = evaluate([requested("xyzzy", above=0)], NUMBERS)
    assert not met
    assert all(name in sentence for name in NUMBERS)
