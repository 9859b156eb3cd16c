"""Figures of the paper in reduced form: simulated collisions against theory solved by scipy without granflow."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from granflow.studies.paper import figures
from granflow.studies.paper.figures import PAPER_CASES

RESTITUTIONS = np.array([0.1, 0.2, 0.5, 0.7, 0.9, 1.0])
SPEEDS = np.array([0.01, 0.3, 10.0])


def root_of_equation_8(e):
    """y = 1 - x of Zhou 2011, Eq. 8."""
    return brentq(lambda y: y - 0.8 * e**2 - 0.2 * e**3 * y**2.5, 0.0, 1.0 + 1e-9, xtol=1e-15)


def solved(e, k, mass, speed):
    """Duration and maximum overlap of M d'' = -F with F of Eq. 4, by scipy; integrated in units of Ts = dmax
    / v."""
    largest = (1.25 * mass * speed**2 / k) ** 0.4
    y = root_of_equation_8(e)
    slope = (1.0 - e**3 * y**1.5) / y

    def loading(_, state):
        return [state[1], -1.25 * max(state[0], 0.0) ** 1.5]

    def unloading(_, state):
        above = max(state[0] - 1.0 + y, 0.0)
        return [state[1], -1.25 * (slope * above + e**3 * above**1.5)]

    def at_rest(_, state):
        return state[1]

    def contact_ends(_, state):
        return state[0] - 1.0 + y

    at_rest.terminal = contact_ends.terminal = True
    exact = {"rtol": 1e-11, "atol": 1e-13}
    up = solve_ivp(loading, (0.0, 5.0), (0.0, 1.0), events=at_rest, **exact)
    down = solve_ivp(unloading, (0.0, 5.0), (1.0, 0.0), events=contact_ends, **exact)
    return (up.t[-1] + down.t[-1]) * largest / speed, largest


def hertz_numbers(case):
    """Hertz stiffness k and effective mass M of two equal spheres, from the material properties."""
    solid = case.solid
    radius = 0.5 * case.diameter
    modulus = solid.young_modulus / (2.0 * (1.0 - solid.poisson_ratio**2))
    mass = solid.density * 4.0 / 3.0 * np.pi * radius**3
    return 4.0 / 3.0 * modulus * np.sqrt(0.5 * radius), 0.5 * mass


def test_residual_overlap_and_duration_match_figures_1_and_2_and_the_table(taichi_f64):
    """The closed form of the residual overlap has an error of 1 %."""
    outcomes = figures.residual_run(RESTITUTIONS)
    exact = np.array([1.0 - root_of_equation_8(e) for e in RESTITUTIONS])
    assert outcomes.overlap_residual / outcomes.overlap_max == pytest.approx(exact, abs=2e-5)
    assert outcomes.restitution == pytest.approx(RESTITUTIONS, rel=1e-3)
    scales = [solved(e, 1.0, 1.0, 1.0)[0] / 1.25**0.4 for e in RESTITUTIONS]
    figure_data = figures.residual_figure(outcomes, RESTITUTIONS)
    assert figure_data.columns["duration_over_ts_theory"] == pytest.approx(scales, rel=1e-6)
    assert all(deviation.is_within_target for deviation in figure_data.deviations)
    assert 0.009 < figures.error_figure(np.linspace(0.0, 0.999, 300)).deviations[0].largest < 0.0108


def test_restitution_duration_and_spring_match_figures_3_to_5(taichi_f64):
    """e(v), T(v) and the spring of Eq. 19 on both steels, at 200 steps for the shortest collision."""
    columns = figures.velocity_columns(figures.velocity_run(SPEEDS), SPEEDS)
    constants = (3.0432, 0.540, 0.310e9, 8030.0), (0.1418, 0.3114, 2.03e9, 7830.0)
    for case, (sigma, psi, strength, density) in zip(PAPER_CASES, constants, strict=True):
        of_case = columns["material"] == case.name
        limit = np.sqrt(3.0 * strength / density)
        requested = np.exp(-sigma * (SPEEDS / (limit - SPEEDS)) ** psi)
        assert columns["restitution_simulated"][of_case] == pytest.approx(requested, rel=1e-3)
        k, mass = hertz_numbers(case)
        found = [solved(e, k, mass, v) for e, v in zip(requested, SPEEDS, strict=True)]
        durations, largest = np.array(found).T
        assert columns["duration_simulated"][of_case] == pytest.approx(durations, rel=5e-3)
        assert columns["duration_theory"][of_case] == pytest.approx(durations, rel=1e-7)
        springs = mass * SPEEDS**2 / largest**2  # the whole kinetic energy is stored at dmax
        assert columns["spring_simulated"][of_case] == pytest.approx(springs, rel=1e-3)
    drawn = figures.restitution_figure(columns), figures.duration_figure(columns)
    assert all(deviation.is_within_target for figure_data in drawn for deviation in figure_data.deviations)


@pytest.mark.slow
def test_page_contains_every_figure(taichi_f64, tmp_path):
    pytest.importorskip("matplotlib")
    from granflow.studies.paper import report

    html = report.write_paper(tmp_path).read_text(encoding="utf-8")
    names = sorted(path.stem for path in tmp_path.glob("*.png"))
    assert names == sorted(path.stem for path in tmp_path.glob("*.csv")) and len(names) == 9
    assert html.count("data:image/png;base64,") == len(names)
