"""Two-particle accuracy study: orders of the errors, recommendation."""

import csv
import sys
from dataclasses import fields

import pytest

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
    STUDIED_LAWS,
    VELOCITIES,
    StudyLine,
    StudyPoint,
    measured_line,
)

FEW_STEPS = (20, 40, 80, 160, 320)


@pytest.fixture(scope="module")
def lines(taichi_f64):
    """Zhou, and Hertz with damping, in double precision."""
    return {law.name: measured_line(law, "f64", FEW_STEPS, repeats=1)[0] for law in STUDIED_LAWS[:2]}


@pytest.mark.parametrize("law", ["zhou", "hertz"])
def test_errors_decrease_with_second_order(lines, law):
    """Leapfrog is of second order about the exact solution of each law. Of Zhou's collision at e = 1/2, unloading,
    the shorter phase, takes 0.6293 of 2.1010 (Eqs. 13-15, the model's table)."""
    for quantity, tolerance in (("duration", 0.35), ("overlap_max", 0.35), ("restitution", 0.3)):
        order = fitted_order(lines[law].steps, lines[law].error(quantity))
        assert order.order == pytest.approx(2.0, abs=tolerance), quantity
    point = next(point for point in lines["zhou"].points if point.restitution == 0.5 and point.steps == 40)
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


def test_files_without_matplotlib(lines, tmp_path, monkeypatch):
    study = TwoBodyStudy((lines["zhou"],), ("hertz with 5 steps a collision",), 0.01)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(GranflowError, match="pip install"):
        write_two_bodies(tmp_path, study)
    with (tmp_path / "accuracy.csv").open(encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) == 3 * len(VELOCITIES) * len(FEW_STEPS)  # three restitutions
    assert study.recommendation in (tmp_path / "accuracy.html").read_text(encoding="utf-8")
