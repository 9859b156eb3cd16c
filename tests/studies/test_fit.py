"""Fit of Eq. 12: recovery of known parameters, and invalid input files."""

import numpy as np
import pytest
from ruamel.yaml import YAML
from scene_builders import build_scene, particle_group
from scipy.stats import t as student

from granflow.cli.main import main
from granflow.contact.material import VelocityRestitution
from granflow.errors import FileError, GranflowError
from granflow.studies.fit import Measurements, fit, limit_from_materials, read_measurements

STEEL = VelocityRestitution(3.0432, 0.540, 340.3)
SOFT = VelocityRestitution(1.2, 0.8, 12.0)
"""Curve with visible curvature in the measured range, so that its limit velocity can be fitted."""


def synthetic_measurements(curve, fastest, count=20, noise=0.0, seed=0):
    velocity = np.geomspace(0.01, 1.0, count) * fastest
    e = curve(velocity) + np.random.default_rng(seed).normal(0.0, noise, count) if noise else curve(velocity)
    return Measurements(velocity, e, np.ones(count), False)


@pytest.mark.parametrize("limit", [SOFT.limit_velocity, None])
def test_fit_to_exact_data_recovers_the_curve(limit):
    found = fit(synthetic_measurements(SOFT, 8.0), limit)
    for name in ("sigma", "psi", "limit_velocity"):
        assert getattr(found.curve, name) == pytest.approx(getattr(SOFT, name), rel=1e-7)
    assert (found.correlation, found.r_squared) == pytest.approx((1.0, 1.0), abs=1e-12)


@pytest.mark.parametrize(("truth", "fastest", "fitted_limit"), [(STEEL, 30.0, False), (SOFT, 9.0, True)])
def test_coverage_of_one_standard_error_matches_student_t(truth, fastest, fitted_limit):
    """About two thirds of the fits: Student's t with (rows - parameters) degrees of freedom."""
    sample_count = 100
    rows = 20
    names = ("sigma", "psi", "limit_velocity")[: 2 + fitted_limit]
    inside = np.zeros(len(names))
    for seed in range(sample_count):
        data = synthetic_measurements(truth, fastest, rows, 0.004, seed)
        found = fit(data, None if fitted_limit else truth.limit_velocity)
        deviations = [abs(getattr(found.curve, name) - getattr(truth, name)) for name in names]
        inside += np.array(deviations) < [getattr(found.errors, name) for name in names]
    expected = 1.0 - 2.0 * student.cdf(-1.0, rows - len(names))
    scatter = np.sqrt(expected * (1.0 - expected) / sample_count)
    np.testing.assert_allclose(inside / sample_count, expected, atol=3.5 * scatter)


def test_limit_velocity_is_that_of_the_materials_or_determined_by_the_data():
    """Eq. 11: the smaller yield strength, of 316, determines the limit. Slow collisions do not."""
    limit = np.sqrt(3.0 * 0.310e9 / 8030.0)
    assert limit_from_materials("chrome_52100", "stainless_316") == pytest.approx(limit, rel=1e-12)
    slow = synthetic_measurements(STEEL, 0.5, noise=0.01, seed=1)
    for data, given in ((slow, None), (slow, 0.4), (synthetic_measurements(SOFT, 8.0, count=2), 12.0)):
        with pytest.raises(GranflowError):
            fit(data, given)


def written(tmp_path, text):
    path = tmp_path / "data.csv"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("text", [
    "\ufeffv,e\r\n1,0.8\r\n2,0.7\r\n",
    "# Smith 1999\n\nV ; E ; remark\n1;0.8;first\n# a comment\n2;0.7;\n",
    'velocity (m/s), restitution coefficient\n"1 m/s", 80 %\n2000 mm/s, 0.7\n',
    "velocity [mm/s],e [%]\n1000,80\n2 m/s,70\n",
])  # fmt: skip
def test_equivalent_table_formats_give_equal_data(tmp_path, text):
    data = read_measurements(written(tmp_path, text))
    np.testing.assert_allclose(data.velocity, [1.0, 2.0], rtol=1e-15)
    np.testing.assert_allclose(data.restitution, [0.8, 0.7], rtol=1e-15)
    np.testing.assert_array_equal(data.uncertainty, [1.0, 1.0])


def test_deviations_and_weights_are_converted_to_uncertainties(tmp_path):
    deviations = read_measurements(written(tmp_path, "v,e,std\n1,0.8,0.1\n2,0.7,0.2\n"))
    weights = read_measurements(written(tmp_path, "v,e,weight\n1,0.8,4\n2,0.7,1\n"))
    assert (deviations.uncertainty.tolist(), deviations.absolute) == ([0.1, 0.2], True)
    assert (weights.uncertainty.tolist(), weights.absolute) == ([0.5, 1.0], False)


@pytest.mark.parametrize(("text", "problems"), [
    ("v;e\n1;0,5\nx;1.2\n-3;nan\n;0.4\n",
     [":2: restitution is 0,5", ":3: velocity is x", ":3: restitution is 1.2", ":4: velocity is -3",
      ":4: restitution is nan", ":5: velocity is empty"]),
    ("v,e\n1,0,8\n", [":2: the row has 3 values, but the header has 2 columns"]),
    ("1,0.8\n2,0.7\n", [":1: the header is 1, 0.8"]), ("v [mm],e\n1,0.8\n", [":1: the column of velocity is in mm"])
])  # fmt: skip
def test_each_invalid_row_or_header_is_reported_with_its_line(tmp_path, text, problems):
    path = written(tmp_path, text)
    with pytest.raises(FileError) as error:
        read_measurements(path)
    found = [each.removeprefix(str(path)) for each in error.value.problems]
    assert [each[: len(start)] for each, start in zip(found, problems, strict=True)] == problems


def test_printed_snippet_is_valid_in_a_scene(tmp_path, capsys):
    data = synthetic_measurements(STEEL, 30.0)
    rows = [f"{v!r},{e!r}\n" for v, e in zip(data.velocity.tolist(), data.restitution.tolist(), strict=True)]
    path = written(tmp_path, "".join(["velocity,restitution\n", *rows]))
    assert main(["fit", str(path), "--limit-velocity", "340.3 m/s", "--out", str(tmp_path)]) == 0
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    snippet = next(line for line in lines if line.startswith("restitution: {"))
    scene = build_scene({"balls": particle_group([[0.0, 0.0, 0.0]])}, pair=YAML(typ="safe").load(snippet))
    pasted = scene.pairs["glass-glass"].restitution
    found = (pasted.sigma, pasted.psi, pasted.limit_velocity)
    assert found == pytest.approx((3.0432, 0.540, 340.3), rel=1e-5)
    assert len((tmp_path / "fit.csv").read_text(encoding="utf-8").splitlines()) == 21
