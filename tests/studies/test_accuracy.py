"""Accuracy studies of two particles and of a scene: orders, errors, noise, recommendation, kept runs."""

import csv
import sys
from dataclasses import fields

import numpy as np
import pytest
from scene_builders import build_scene, plane

from granflow.errors import GranflowError
from granflow.particles.insertion import initial_particles
from granflow.studies.accuracy import scene as scene_runs
from granflow.studies.accuracy.report import (
    TwoBodyStudy,
    fitted_order,
    recommendation,
    requirement_of,
    table_rows,
    write_two_bodies,
)
from granflow.studies.accuracy.scene import (
    ENERGY_ERROR,
    SAMPLES,
    SIGMAS,
    KeptRuns,
    RunOutcome,
    SceneTask,
    _Runs,
    _study,
    measure_scene,
    run_task,
    scene_recommendation,
    write_scene,
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


@pytest.fixture
def drop(tmp_path):
    """Path of a scene in which a few beads fall onto a floor."""
    region = {"box": {"min": [-0.02, -0.02, 0.1], "max": [0.02, 0.02, 0.15]}}
    beads = {"material": "glass", "count": 12, "diameter": 0.01, "insert": {"kind": "pack", "region": region}}
    scene = build_scene(
        {"beads": beads}, walls={"floor": plane([0, 0, 0], [0, 0, 1])}, gravity=[0, 0, -9.81],
        domain={"min": [-0.2, -0.2, -0.01], "max": [0.2] * 3, "on_exit": "error"}, run={"duration": 0.25},
    )  # fmt: skip
    path = tmp_path / "drop.yaml"
    path.write_text(scene.to_yaml(), encoding="utf-8")
    return path


def test_center_of_mass_of_free_fall_matches_theory(taichi_f64, drop):
    """Before the impact the particles have no contacts; the mean height of the center of mass is g T^2 / 6
    lower.

    Over n + 1 samples at equal intervals the mean of t^2 is T^2 (2 n + 1) / (6 n).
    """
    until = 0.1  # a fall of 49 mm, from 100 mm
    task = SceneTask(drop, ("output.energy_budget=true", "run.time_step=2e-5"), until)
    fallen = run_task(task)
    start = initial_particles(task.scene()).position[:, 2].mean() + 0.01  # above the bottom of the domain
    fall = 0.5 * 9.81 * until**2 * (2 * SAMPLES + 1) / (6 * SAMPLES)
    assert fallen.values["center_height"] == pytest.approx(start - fall, abs=2e-6)
    assert fallen.values["coordination_number"] == 0.0
    assert abs(fallen.values[ENERGY_ERROR]) < 1e-9
    assert fallen.simulated == pytest.approx(until, abs=2e-5)
    assert fallen.seconds > 0.0


def outcome(energy_budget, height, seconds=2.0):
    return RunOutcome({ENERGY_ERROR: energy_budget, "center_height": height}, seconds, 100.0, 0.5)


def synthetic_study():
    """A fine reference, an error within the noise, a wrong restitution, a wrong bed height, and an abort."""
    heights = np.array([1.00, 1.02, 0.98])
    found = [_Runs("fixed", "f64", 0.9, 9e-5, np.inf, [RunOutcome(stopped="not stable")] * 3)]
    for share, error, values, seconds in (
        (0.4, 0.009, heights + 0.5, 0.2), (0.2, 0.03, heights, 0.5), (0.1, 0.008, [1.03, 1.00, 0.97], 1.0),
        (0.05, 0.001, heights, 2.0),
    ):  # fmt: skip
        outcomes = [outcome(2e-5, height, seconds) for height in values]
        found.append(_Runs("fixed", "f64", share, 1e-4 * share, error, outcomes))
    return _study(found, 0.05, "made up", (0.1, 1e-5), 12, 3, 0.01)


def test_errors_are_separated_from_noise():
    """Differences from the reference: .03, -.02, -.01 (variance 7e-4), and twice a constant, 0 or .5 (variance
    0)."""
    study = synthetic_study()
    assert study.noise["center_height"] == pytest.approx(SIGMAS * np.sqrt(7e-4 / 3.0 / 3.0))
    assert study.spread["center_height"] == pytest.approx(0.02)
    assert study.points[1].errors["center_height"] == pytest.approx(0.5)
    assert [study.within_target(point) for point in study.points] == [False] * 3 + [True] * 2
    assert study.cheapest == [study.points[3]]


def test_runs_of_a_study_that_was_stopped_are_kept(drop, tmp_path, monkeypatch):
    """The study is interrupted in its sixth run; the next one repeats neither the first five runs nor, of another
    scene or from a damaged file, uses any."""
    ran = []

    def run_task(task):
        ran.append(task)
        if len(ran) == 6:
            raise KeyboardInterrupt
        return outcome(1e-5, 1.0, 1.0 + 0.01 * len(ran))

    monkeypatch.setattr(scene_runs, "run_task", run_task)
    monkeypatch.setattr(scene_runs, "restitution_error", lambda _: 0.001)
    path = tmp_path / "out" / "accuracy_runs.json"

    def study():
        given = {"report": lambda _: None, "shares": (0.1,), "precisions": ("f64",)}
        return measure_scene(SceneTask(drop, (), None), 0.01, kept=KeptRuns(path), **given)

    with pytest.raises(KeyboardInterrupt):
        study()
    seconds = [each for point in study().points for each in point.seconds.tolist()]
    assert seconds == [1.01, 1.02, 1.03, 1.04, 1.05, 1.07, 1.08, 1.09, 1.1]
    study()
    assert len(ran) == 6 + 4
    drop.write_text(drop.read_text().replace("2500", "2600"))
    study()
    path.write_text(path.read_text()[:100])
    study()
    assert len(ran) == 10 + 9 + 9


def test_files_of_a_scene_without_matplotlib(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    study = synthetic_study()
    with pytest.raises(GranflowError, match="pip install"):
        write_scene(tmp_path, study)
    with (tmp_path / "accuracy.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["share"]) for row in rows] == [0.9, 0.4, 0.2, 0.1, 0.05]
    assert rows[0]["stopped"] == "not stable"
    sentence = scene_recommendation(study)
    assert "time_step_fraction 0.1" in sentence and "it costs 2 s (" in sentence  # 1.0 s for 0.5 s
    assert sentence in (tmp_path / "accuracy.html").read_text(encoding="utf-8")
