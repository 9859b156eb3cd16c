"""Two-particle accuracy study: exact solutions against scipy, orders, recommendation."""

import csv
import sys
from dataclasses import fields

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from granflow.errors import GranflowError
from granflow.studies.accuracy.report import (
    TwoBodyStudy,
    fitted_order,
    recommendation,
    requirement_of,
    table_rows,
    write_two_bodies,
)
from granflow.studies.accuracy.two_particles import (
    EXACT,
    STUDIED_LAWS,
    VELOCITIES,
    StudyLine,
    StudyPoint,
    measured_line,
)

FEW_STEPS = (20, 40, 80, 160, 320)
K, MASS, SPEED = 4e5, 2e-4, 0.7
"""Hertz stiffness [N/m^1.5], effective mass [kg] and approach velocity [m/s] of the test collision."""


def solved(force, speed, mass):
    """Restitution, duration, time and value of the maximum overlap of M d'' = -F(d, d') until F = 0, by
    scipy.

    Scaled by the maximum overlap of a Hertz contact and the time to traverse it.
    """
    length = (1.25 * mass * speed**2 / K) ** 0.4
    time = length / speed

    def slope(_, state):
        return [state[1], -force(max(state[0], 0.0) * length, state[1] * speed) * time**2 / (mass * length)]

    def contact_ends(t, state):
        return force(state[0] * length, state[1] * speed) if t > 0.3 else 1.0

    def maximum_overlap_is_reached(_, state):
        return state[1]

    contact_ends.terminal = True
    events = (contact_ends, maximum_overlap_is_reached)
    course = solve_ivp(slope, (0.0, 9.0), (0.0, 1.0), events=events, rtol=1e-11, atol=1e-13)
    end, top = (times[0] * time for times in course.t_events)
    return -course.y_events[0][0][1], end, top, course.y_events[1][0][0] * length


def damping(e):
    """Damping ratio of an oscillator with restitution e at zero force, from its closed-form solution."""

    def restitution_of(zeta):
        root = np.sqrt(1.0 - zeta**2)
        end = np.pi - np.arctan2(2.0 * zeta * root, 1.0 - 2.0 * zeta**2)
        return np.exp(-zeta * end / root)

    return brentq(lambda zeta: restitution_of(zeta) - e, 1e-9, 0.999)


@pytest.mark.parametrize("e", [0.2, 0.5, 0.9])
def test_exact_solutions_match_scipy(e):
    """Hertz with damping, and a linear spring (Eq. 19) with a dashpot."""
    zeta = damping(e)
    spring = 0.8 * K * np.sqrt((1.25 * MASS * SPEED**2 / K) ** 0.4)
    viscosity = 2.0 * zeta * np.sqrt(spring * MASS)

    def hertz(d, rate):
        d = max(d, 0.0)
        return K * d**1.5 + np.sqrt(5.0) * zeta * np.sqrt(MASS * K) * d**0.25 * rate

    forces = {"hertz": hertz, "linear": lambda d, rate: spring * d + viscosity * rate}
    for law, force in forces.items():
        found = EXACT[law](e, K, MASS, SPEED)
        reached = (found.restitution, found.duration, found.peak_time, found.overlap_max)
        assert reached == pytest.approx(solved(force, SPEED, MASS), rel=1e-8), law


@pytest.fixture(scope="module")
def line(taichi_f64):
    """Zhou in double precision."""
    law = next(each for each in STUDIED_LAWS if each.name == "zhou")
    return measured_line(law, "f64", FEW_STEPS, repeats=1)[0]


def test_errors_decrease_with_second_order(line):
    """Leapfrog is of second order. Of Zhou's collision at e = 1/2, unloading, the shorter phase, takes 0.6293 of
    2.1010 (Eqs. 13-15, the model's table)."""
    for quantity, tolerance in (("duration", 0.35), ("overlap_max", 0.35), ("restitution", 0.3)):
        order = fitted_order(line.steps, line.error(quantity))
        assert order.order == pytest.approx(2.0, abs=tolerance), quantity
    point = next(point for point in line.points if point.restitution == 0.5 and point.steps == 40)
    assert point.share == pytest.approx(2.1010 / 0.6293 / 40, rel=1e-3)


def synthetic_line(law, precision, prefactor, seconds_per_step):
    """Errors prefactor / steps^2, twice that for a second kind of collision whose shorter phase is half as
    long."""
    points = []
    for steps in (10.0, 20.0, 40.0, 80.0):
        for kind, (e, phase) in enumerate(((0.5, 0.4), (0.2, 0.2))):
            numbers = dict.fromkeys((each.name for each in fields(StudyPoint)), 0.0)
            cost = seconds_per_step * steps
            numbers |= {"restitution_error": (1 + kind) * prefactor / steps**2, "share": 1.0 / (phase * steps),
                        "steps": steps, "restitution": e, "velocity": 1.0, "seconds_median": cost,
                        "seconds_min": 0.9 * cost, "seconds_max": 1.1 * cost}  # fmt: skip
            points.append(StudyPoint(**numbers | {"law": law, "precision": precision}))
    return StudyLine(law, precision, tuple(points))


def test_the_recommendation_is_the_cheapest_row_of_the_table():
    """2 * 7 / 40^2 = 0.9 % is the first error of the worse kind below 1 %; at 20 steps 7/400 = 1.75 %."""
    lines = [synthetic_line("zhou", "f64", 7.0, 2e-7), synthetic_line("zhou", "mixed", 7.0, 1e-7),
             synthetic_line("zhou", "f32", 30.0, 2e-7), synthetic_line("hertz", "f64", 0.1, 1e-9)]  # fmt: skip
    requirement = requirement_of(lines[1], 0.01)
    assert (requirement.steps, requirement.share) == (40.0, pytest.approx(1.0 / (0.4 * 40.0)))
    assert requirement.seconds == pytest.approx((4e-6, 3.6e-6, 4.4e-6))
    assert "precision mixed" in recommendation(lines, 0.01)
    chosen, other = table_rows(lines, 0.01)[1:3]
    assert chosen[4] == "40" and other[4:6] == ("80", "0.031")  # 2 * 30 / 80^2 = 0.94 %
    assert "No time step" in recommendation(lines, 1e-9)
    overlapping = recommendation([*lines, synthetic_line("zhou", "f32", 7.0, 1.2e-7)], 0.01)
    assert "not distinguished" in overlapping, "10 % about each"


def test_files_without_matplotlib(line, tmp_path, monkeypatch):
    study = TwoBodyStudy((line,), ("hertz with 5 steps a collision",), 0.01)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(GranflowError, match="pip install"):
        write_two_bodies(tmp_path, study)
    with (tmp_path / "accuracy.csv").open(encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) == 3 * len(VELOCITIES) * len(FEW_STEPS)  # three restitutions
    assert study.recommendation in (tmp_path / "accuracy.html").read_text(encoding="utf-8")
