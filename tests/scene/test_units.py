"""Units in text: SI values from the SI brochure (9th edition) and NIST SP 811, appendix B; rejected text."""

import math

import pytest

import granflow as gf
from granflow.units import DIMENSIONS, UnitError, column_factor, factor_of, in_si, in_unit, to_si

DEGREE = 0.017453292519943295  # pi / 180
PER_MINUTE, PER_HOUR = 0.016666666666666666, 0.0002777777777777778  # 1 / 60, 1 / 3600

VALUES = {
    "number": {"%": 0.01},
    "length": {"m": 1.0, "km": 1000.0, "cm": 0.01, "mm": 0.001, "um": 0.000001,
               "nm": 0.000000001},
    "time": {"s": 1.0, "ms": 0.001, "us": 0.000001, "ns": 0.000000001, "min": 60.0,
             "h": 3600.0},
    "velocity": {"m/s": 1.0, "cm/s": 0.01, "mm/s": 0.001, "km/h": 0.2777777777777778, "m/min": PER_MINUTE},
    "acceleration": {"m/s2": 1.0, "mm/s2": 0.001, "g": 9.80665},
    "angle": {"rad": 1.0, "deg": DEGREE, "°": DEGREE, "turn": 6.283185307179586},
    "frequency": {"Hz": 1.0, "kHz": 1000.0, "1/s": 1.0, "1/min": PER_MINUTE},
    "angular_velocity": {"rad/s": 1.0, "deg/s": DEGREE, "°/s": DEGREE, "rpm": 0.10471975511965977,
                         "1/s": 1.0},
    "pressure": {"Pa": 1.0, "kPa": 1000.0, "MPa": 1000000.0, "GPa": 1000000000.0, "N/m2": 1.0,
                 "N/mm2": 1000000.0, "bar": 100000.0},
    "density": {"kg/m3": 1.0, "g/cm3": 1000.0, "t/m3": 1000.0},
    "viscosity": {"Pa s": 1.0, "mPa s": 0.001, "Pa*s": 1.0, "mPa*s": 0.001, "kg/m/s": 1.0, "P": 0.1, "cP": 0.001},
    "energy": {"J": 1.0, "kJ": 1000.0, "mJ": 0.001, "uJ": 0.000001, "nJ": 0.000000001,
               "pJ": 0.000000000001, "aJ": 0.000000000000000001, "zJ": 0.000000000000000000001},
    "energy_density": {"J/m3": 1.0, "mJ/m3": 0.001, "kJ/m3": 1000.0,
                       "MJ/m3": 1000000.0},
    "surface_energy": {"J/m2": 1.0, "mJ/m2": 0.001, "uJ/m2": 0.000001,
                       "N/m": 1.0, "mN/m": 0.001},
    "volume": {"m3": 1.0, "l": 0.001, "ml": 0.000001, "cm3": 0.000001,
               "ul": 0.000000001, "mm3": 0.000000001, "nl": 0.000000000001, "pl": 0.000000000000001,
               "L": 0.001, "mL": 0.000001, "uL": 0.000000001, "nL": 0.000000000001,
               "pL": 0.000000000000001},
    "stiffness": {"N/m": 1.0, "kN/m": 1000.0, "N/mm": 1000.0, "N/cm": 100.0},
    "torsion_stiffness": {"Nm/rad": 1.0, "mNm/rad": 0.001, "uNm/rad": 0.000001, "N*m/rad": 1.0},
    "torsion_damping": {"Nms": 1.0, "mNms": 0.001, "uNms": 0.000001, "N*m*s": 1.0},
    "granular_temperature": {"m2/s2": 1.0, "J/kg": 1.0, "cm2/s2": 0.0001,
                             "mm2/s2": 0.000001},
    "rate": {"1/s": 1.0, "/s": 1.0, "1/min": PER_MINUTE, "1/h": PER_HOUR},
    "mass": {"kg": 1.0, "g": 0.001, "mg": 0.000001, "t": 1000.0},
    "mass_flow": {"kg/s": 1.0, "g/s": 0.001, "kg/min": PER_MINUTE, "kg/h": PER_HOUR,
                  "t/h": 0.2777777777777778},
    "damping": {"kg/s": 1.0, "g/s": 0.001, "Ns/m": 1.0}, "force": {"N": 1.0, "kN": 1000.0, "mN": 0.001},
    "temperature": {"K": 1.0, "mK": 0.001, "degC": 274.15, "°C": 274.15},
    "heat_capacity": {"J/kg/K": 1.0, "J/(kg*K)": 1.0, "kJ/kg/K": 1000.0, "kJ/(kg*K)": 1000.0, "J/g/K": 1000.0,
                      "J/(g*K)": 1000.0},
    "thermal_conductivity": {"W/m/K": 1.0, "W/(m*K)": 1.0, "mW/m/K": 0.001, "mW/(m*K)": 0.001},
    "power": {"W": 1.0, "kW": 1000.0, "mW": 0.001, "uW": 1e-6},
    "velocity_per_force": {"m/(s N)": 1.0, "m/(s*N)": 1.0, "m/s/N": 1.0, "mm/s/N": 0.001},
    "rate_per_pressure": {"1/(Pa s)": 1.0, "1/(Pa*s)": 1.0, "1/Pa/s": 1.0, "1/kPa/s": 0.001},
    "heat_flux": {"W/m2": 1.0, "kW/m2": 1000.0}
}  # fmt: skip


@pytest.mark.parametrize("dimension", sorted(DIMENSIONS))
def test_every_unit_has_its_si_value(dimension):
    notations = str.maketrans({"^": "", "²": "2", "³": "3", "µ": "u", "\u03bc": "u"})
    plain = {unit: unit.translate(notations) for unit in DIMENSIONS[dimension].units}
    assert set(plain.values()) == set(VALUES[dimension])
    for unit, name in plain.items():
        value = VALUES[dimension][name]
        assert to_si(f"1 {unit}", dimension) == value
        zero = 273.15 if unit in ("degC", "°C") else 0.0
        expected = zero - 2500.0 * (value - zero)
        assert math.isclose(to_si(f"-2.5e3 {unit}", dimension), expected, rel_tol=1e-15)
    assert math.isfinite(to_si(DIMENSIONS[dimension].example, dimension))


@pytest.mark.parametrize(("text", "dimension", "value"), [
    ("25.4mm", "length", 0.0254), ("  1e-5  ", "length", 1e-5), ("0.31 GPa", "pressure", 0.31e9),
    ("3.6 t/h", "any", 1.0), ("0 °C", "any", 273.15), ("1e-400 m", "length", 0.0), ("1e400 m", "length", math.inf),
    ("-1e308 km", "length", -math.inf), ("1" * 5000, "length", math.inf), ("0." + "3" * 5000 + " m", "length", 1 / 3),
], ids=lambda value: str(value)[:20])  # fmt: skip
def test_text_is_converted_to_si_with_a_single_rounding(text, dimension, value):
    assert to_si(text, dimension) == value


@pytest.mark.parametrize(
    "text", ["four mm", "4 furlong", "4 Pa", "4 m m", "1e", "4,5 mm", "", "mm", "4 MM", "0x10 m"]
)
def test_invalid_lengths_are_rejected(text):
    with pytest.raises(UnitError):
        to_si(text, "length")


def test_degrees_celsius_are_units_of_values_but_not_of_factors():
    assert in_unit(293.15, "degC") == pytest.approx(20.0, rel=1e-14)
    assert in_si(293.15, "degC") == "293.15 K"
    with pytest.raises(UnitError, match="give K"):
        factor_of("degC", "temperature")
    with pytest.raises(UnitError, match="give K, mK"):
        column_factor("degC", "K")


def test_the_unit_of_a_bound_is_one_of_its_quantity():
    """g is gram for a mass and the acceleration of gravity without a known quantity."""
    assert gf.StageCondition.model_validate({"quantity": "deleted_mass", "above": "50 g"}).above == 0.05
    between = gf.Expectation.model_validate({"quantity": "flow_mass.outlet", "between": ["5 g", "0.05 kg"]})
    assert between.between == (0.005, 0.05)
    with pytest.raises(ValueError, match="g is ambiguous"):
        gf.StageCondition.model_validate({"quantity": "own.number", "above": "50 g"})
