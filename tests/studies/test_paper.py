"""Figures of the paper in reduced form: simulated collisions against the closed forms, and the page."""

import numpy as np
import pytest
from scipy.optimize import brentq

from granflow.studies.paper import figures, report

RESTITUTIONS = np.array([0.1, 0.2, 0.5, 0.7, 0.9, 1.0])
SPEEDS = np.array([0.01, 0.3, 10.0])


def test_simulations_match_figures_1_to_4(taichi_f64):
    """The residual overlap x solves Eq. 8, y = 0.8 e^2 + 0.2 e^3 y^2.5 with y = 1 - x; its closed form has an error
    of 1 %. Restitutions on both steels follow from Eq. 12 with the limit velocity sqrt(3 Y / rho) of Eq. 11."""
    exact = [
        1.0 - brentq(lambda y, e=e: y - 0.8 * e**2 - 0.2 * e**3 * y**2.5, 0.0, 1.0 + 1e-9)
        for e in RESTITUTIONS
    ]
    outcomes = figures.residual_run(RESTITUTIONS)
    assert outcomes.overlap_residual / outcomes.overlap_max == pytest.approx(exact, abs=2e-5)
    assert outcomes.restitution == pytest.approx(RESTITUTIONS, rel=1e-3)
    error = figures.error_figure(np.linspace(0.0, 0.999, 300))
    assert 0.009 < error.deviations[0].largest < 0.0108
    columns = figures.velocity_columns(figures.velocity_run(SPEEDS), SPEEDS)
    constants = (3.0432, 0.540, 0.310e9, 8030.0), (0.1418, 0.3114, 2.03e9, 7830.0)
    for case, (sigma, psi, strength, density) in zip(figures.PAPER_CASES, constants, strict=True):
        limit = np.sqrt(3.0 * strength / density)
        requested = np.exp(-sigma * (SPEEDS / (limit - SPEEDS)) ** psi)
        found = columns["restitution_simulated"][columns["material"] == case.name]
        assert found == pytest.approx(requested, rel=1e-3)
    drawn = [figures.residual_figure(outcomes, RESTITUTIONS), figures.restitution_figure(columns)]
    for data in (*drawn, figures.duration_figure(columns)):
        assert all(deviation.is_within_target for deviation in data.deviations), data


@pytest.mark.slow
def test_page_contains_every_figure(taichi_f64, tmp_path):
    """All deviations from theory are within their targets."""
    pytest.importorskip("matplotlib")
    html = report.write_paper(tmp_path).read_text(encoding="utf-8")
    names = sorted(path.stem for path in tmp_path.glob("*.png"))
    assert names == sorted(path.stem for path in tmp_path.glob("*.csv")) and len(names) == 9
    assert html.count("data:image/png;base64,") == len(names) and "not satisfied" not in html
