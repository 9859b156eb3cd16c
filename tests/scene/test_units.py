"""Units in text: SI value with a single rounding, and rejected text."""

import math

import pytest

import granflow as gf
from granflow.units import DIMENSIONS, UnitError, column_factor, factor_of, in_si, in_unit, to_si

GOOD = [
    ("4 mm", "length", 0.004), ("25.4mm", "length", 0.0254), ("  1e-5  ", "length", 1e-5),
    ("7 µm", "length", 7e-6), ("1 GPa", "pressure", 1e9), ("0.31 GPa", "pressure", 0.31e9),
    ("25 Hz", "frequency", 25.0),
    ("30 rpm", "angular_velocity", math.pi), ("180 deg", "angle", math.pi), ("36 km/h", "velocity", 10.0),
    ("2.5 g/cm3", "density", 2500.0), ("3.6 t/h", "mass_flow", 1.0), ("3.6 t/h", "any", 1.0),
    ("10 %", "number", 0.1), ("1 nJ", "energy", 1e-9), ("1e-400 m", "length", 0.0),
    ("1e400 m", "length", math.inf),
    ("-1e308 km", "length", -math.inf), ("1" * 5000, "length", math.inf),
    ("0." + "3" * 5000 + " m", "length", 1 / 3),
    ("20 degC", "temperature", 293.15), ("0 °C", "any", 273.15), ("-10 degC", "temperature", 263.15),
]  # fmt: skip


@pytest.mark.parametrize(("text", "dimension", "value"), GOOD, ids=lambda value: str(value)[:20])
def test_text_is_converted_to_si(text, dimension, value):
    assert to_si(text, dimension) == value


@pytest.mark.parametrize(
    "text", ["four mm", "4 furlong", "4 Pa", "4 m m", "1e", "4,5 mm", "", "mm", "4 MM", "0x10 m"]
)
def test_invalid_lengths_are_rejected(text):
    with pytest.raises(UnitError):
        to_si(text, "length")


def test_ambiguous_unit_is_rejected_without_a_dimension():
    with pytest.raises(UnitError, match="g is ambiguous"):
        to_si("2 g", "any")


def test_degrees_celsius_are_units_of_values_but_not_of_factors():
    assert in_unit(293.15, "degC") == pytest.approx(20.0, rel=1e-14)
    assert in_si(293.15, "degC") == "293.15 K"
    with pytest.raises(UnitError, match="give K"):
        factor_of("degC", "temperature")
    with pytest.raises(UnitError, match="give K, mK"):
        column_factor("degC", "K")


def test_example_of_every_dimension_is_valid():
    for name, dimension in DIMENSIONS.items():
        assert math.isfinite(to_si(dimension.example, name))


def test_the_unit_of_a_bound_is_one_of_its_quantity():
    """g is gram for a mass and the acceleration of gravity without a known quantity."""
    for key in ("above", "below"):
        condition = gf.StageCondition.model_validate({"quantity": "deleted_mass", key: "50 g"})
        assert getattr(condition, key) == 0.05
    between = gf.Expectation.model_validate({"quantity": "flow_mass.outlet", "between": ["5 g", "0.05 kg"]})
    assert between.between == (0.005, 0.05)
    with pytest.raises(ValueError, match="g is ambiguous"):
        gf.StageCondition.model_validate({"quantity": "own.number", "above": "50 g"})
