"""Fit of Beverloo's law to mass flows computed from the law, with and without scatter."""

import numpy as np
import pytest

from granflow.cli.main import main
from granflow.errors import GranflowError
from granflow.studies.beverloo import Discharge, fit_beverloo, read_discharges

PARTICLE, DENSITY, C, K = 0.004, 1500.0, 0.58, 1.4
ORIFICE = np.array([0.03, 0.035, 0.04, 0.05, 0.06, 0.075])


def flows(exponent=2.5):
    return C * DENSITY * np.sqrt(9.81) * PARTICLE**2.5 * (ORIFICE / PARTICLE - K) ** exponent


def test_fit_without_scatter_is_exact():
    found = fit_beverloo(Discharge(ORIFICE, flows()), PARTICLE, DENSITY)
    assert (found.c, found.k) == pytest.approx((C, K), rel=1e-6)
    assert found.exponent == 2.5
    # W = C rho sqrt(g) (D - k d)^2.5 of the paper gives the same value.
    assert flows()[0] == pytest.approx(C * DENSITY * np.sqrt(9.81) * (0.03 - K * PARTICLE) ** 2.5)


def test_free_exponent_is_fitted():
    found = fit_beverloo(Discharge(ORIFICE, flows(2.2)), PARTICLE, DENSITY, exponent=None)
    assert (found.c, found.k, found.exponent) == pytest.approx((C, K, 2.2), rel=1e-4)


def test_standard_errors_match_repeated_experiments():
    """The spread of C and k over 300 data sets with 1 % scatter is their mean standard error, within a
    fifth."""
    random = np.random.default_rng(0)
    found = [
        fit_beverloo(Discharge(ORIFICE, flows() * np.exp(random.normal(0.0, 0.01, 6))), PARTICLE, DENSITY)
        for _ in range(300)
    ]
    for name in ("c", "k"):
        values, errors = (
            np.array([getattr(each, f"{name}{end}") for each in found]) for end in ("", "_error")
        )
        # The mean of the root of an estimated variance with 4 degrees of freedom is 0.94 of the root.
        assert values.std() == pytest.approx(np.sqrt((errors**2).mean()), rel=0.2)
        assert values.mean() == pytest.approx(
            {"c": C, "k": K}[name], abs=3.0 * values.std() / np.sqrt(300) + 0.01
        )


def test_a_table_with_units_is_read_and_shown(tmp_path, capsys):
    path = tmp_path / "flows.csv"
    rows = [
        f"{1e3 * orifice!r} mm,{flow!r}"
        for orifice, flow in zip(ORIFICE.tolist(), flows().tolist(), strict=True)
    ]
    path.write_text("\n".join(["orifice,mass_flow", *rows]) + "\n", encoding="utf-8")
    np.testing.assert_allclose(read_discharges([path]).orifice, ORIFICE)
    assert main(["beverloo", str(path), "--diameter", "4mm", "--bulk-density", "1500"]) == 0
    shown = capsys.readouterr().out
    assert "0.58 ±" in shown and "1.4 ±" in shown and "2.5 given" in shown and "2.5 ±" in shown


def test_units_of_columns_are_those_of_cells_without_one(tmp_path):
    """75 mm and 0.06 m; 3.6 t/h and 360 kg/h are 1 and 0.1 kg/s."""
    path = tmp_path / "flows.csv"
    path.write_text("orifice (mm),mass_flow [t/h]\n75,3.6\n0.06 m,360 kg/h\n", encoding="utf-8")
    found = read_discharges([path])
    assert found.orifice == pytest.approx([0.075, 0.06]) and found.mass_flow == pytest.approx([1.0, 0.1])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("orifice\n1\n", "has no column mass_flow"),
        ("orifice,mass_flow\n5 kg,1\n", ":2: "),
        ("orifice,mass_flow\n1,1\n1,2\n", "1 different orifices are too few"),
        ("orifice,mass_flow\n1,1\n2,0\n", "not above 0"),
    ],
)
def test_invalid_tables_are_rejected_with_one_sentence(tmp_path, text, message):
    path = tmp_path / "flows.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(GranflowError, match=message):
        fit_beverloo(read_discharges([path]), PARTICLE, DENSITY)
