"""Accuracy study of a scene: errors and their noise, recommendation, kept runs."""

import csv
import sys

import numpy as np
import pytest
from scene_builders import build_scene, plane

from granflow.errors import GranflowError
from granflow.particles.insertion import initial_particles
from granflow.studies.accuracy import scene as scene_runs
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


def test_files_without_matplotlib(tmp_path, monkeypatch):
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
