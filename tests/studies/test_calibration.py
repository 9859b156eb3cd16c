"""Calibration with a program that replaces the runs: messages, search, targets, and continuation."""

import errno
import json
import os

import numpy as np
import pytest
from studies.sweep_files import SCENE

from granflow.cli.main import main
from granflow.errors import FileError, GranflowError, OutputError
from granflow.studies.calibration import trials
from granflow.studies.calibration.calibrate import estimate_trials, read_calibration, run_calibration
from granflow.studies.calibration.response import fit_response, is_identified
from granflow.studies.calibration.schema import Target
from granflow.studies.calibration.search import JOURNAL, Search
from granflow.studies.checked_run import RunSettings

CALIBRATION = """\
scenes: {pair: {scene: spheres.yaml}}
parameters:
  friction: {keys: pairs.steel-steel.friction, from: 0.05, to: 0.8}
  restitution: {keys_in: {pair: [pairs.steel-steel.restitution]}, from: 0.3, to: 0.9}
targets:
  energy: {scene: pair, quantity: kinetic_energy, value: 1 mJ, tolerance: 10 uJ}
search: {trials: 12}
"""


def written(folder, *changes):
    """A calibration with changes (old text, new text)."""
    text = CALIBRATION
    for old, new in changes:
        text = text.replace(old, new)
    (folder / "spheres.yaml").write_text(SCENE)
    (folder / "calibration.yaml").write_text(text)
    return folder / "calibration.yaml"


def test_dry_run_writes_nothing(tmp_path, capsys):
    command = ["calibrate", str(written(tmp_path)), "--out", str(tmp_path / "out"), "--dry-run"]
    assert main(command) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "12 of 12 trials are to do." in said
    assert "set search.trials to 16 or more" in said, "2 (3 + 5) for two parameters"
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("old", "new", "words"), [
    ("tolerance", "tolerence", "calibration.yaml:6:64: targets.energy.tolerence is not a known key."),
    ("scene: pair,", "scene: piar,", "calibration.yaml:6:19: targets.energy.scene is piar"),
    ("value: 1 mJ, ", "", "calibration.yaml:6:3: targets.energy.value is missing"),
    ("1 mJ, tolerance: 10 uJ", "1 mm, tolerance: 1 mm", "but kinetic_energy is in J, and mm is no"),
    ("steel.restitution", "steel.friction", "which parameters.friction sets too"),
    ("search", "repeat: {seeds: 2}\nsearch", "repeat changes the seed, which scenes.pair.set sets too"),
    ("to: 0.9", "to: 1.2", "restitution is 1.2"),
    ("quantity: kinetic", "quantity: kinetik", "calibration.yaml:6:35: kinetik_energy is not a number"),
])  # fmt: skip
def test_problems_are_reported_with_position(tmp_path, old, new, words):
    """Those of the scene at both ends of the parameters, too."""
    seed = ("spheres.yaml}", "spheres.yaml, set: {seed: 4}}")
    with pytest.raises(FileError) as caught:
        estimate_trials(read_calibration(written(tmp_path, seed, (old, new))), tmp_path / "out")
    assert words in str(caught.value)


def runner(folder, *changes):
    pytest.importorskip("optuna")
    study = read_calibration(written(folder, *changes))
    common = RunSettings(folder / "runs", 1, "cpu", folder / "stop")
    search = Search(study.content, folder)
    return trials.TrialRunner(search, study.scenes, study.targets, study.positions, common, lambda: False)


def test_trials_with_other_targets_or_another_content_of_a_scene_or_a_curve_are_refused(tmp_path):
    curve = ("value: 1 mJ", "curve: energy.csv")
    (tmp_path / "energy.csv").write_text("time,value\n1,0.4\n2,0.5\n")
    for _ in range(2):
        runner(tmp_path, curve).check()
    with pytest.raises(GranflowError, match="with other scenes, parameters or targets"):
        runner(tmp_path, curve, ("10 uJ", "20 uJ"))
    found = runner(tmp_path, curve)
    (tmp_path / "spheres.yaml").write_text(SCENE.replace("8000", "9000"))
    with pytest.raises(GranflowError, match="another content of the scene pair"):
        found.check()
    (tmp_path / "energy.csv").write_text("time,value\n1,0.4\n2,0.6\n")
    with pytest.raises(GranflowError, match="another content of the curve of energy"):
        runner(tmp_path, curve).check()


def test_a_journal_with_a_damaged_line_is_read_without_it(tmp_path):
    """Earlier programs wrote the next operation behind half a line."""
    search = runner(tmp_path).search
    path = tmp_path / JOURNAL
    for loss in (4.0, 3.0):
        middle = path.read_bytes()
        trial = search.next_trial()
        trial.set_user_attr("residuals", {"energy": [loss]})
        search.study.tell(trial, loss)
    path.write_bytes(middle + b'{"op_code":6,"wor' + path.read_bytes()[len(middle) :])
    assert [trial.value for trial in runner(tmp_path).search.completed()] == [4.0, 3.0]


def test_trials_of_a_killed_process_are_repeated(tmp_path):
    """The process of a running trial is gone: its directory is not locked. Its parameters are the next
    ones."""
    search = runner(tmp_path).search
    lost = search.next_trial()
    lost.set_user_attr("worker", "gone-1")
    search.release_lost()
    again = search.next_trial()
    assert again.params == lost.params and again.number == lost.number + 1


def test_search_ends_after_its_number_of_trials_at_the_optimum(tmp_path):
    """The residuals are linear in ln(friction), so the last trials, at the optimum of the fit, are exact."""
    search = runner(tmp_path, ("to: 0.8}", "to: 0.8, scale: log}")).search
    count = 0
    while (trial := search.next_trial()) is not None:
        x, y = np.log(trial.params["friction"] / 0.3), trial.params["restitution"] - 0.6
        trial.set_user_attr("residuals", {"energy": [10.0 * x, 10.0 * y]})
        search.study.tell(trial, 100.0 * (x * x + y * y))
        count += 1
    best = min(search.completed(), key=lambda trial: trial.value)
    assert count == 12
    assert (best.params["friction"], best.params["restitution"]) == pytest.approx((0.3, 0.6), abs=1e-6)


def test_two_workers_find_planted_values_and_continue(tmp_path, stand_in, monkeypatch):
    """Runs are replaced by e + mu and e mu with e = 0.62 and mu = 0.27; the solution e = 0.27 is out of
    bounds. Seeds 1 and 2 give mu + 0.1 and mu + 0.2: a mean of 0.42, with a standard error of 0.05."""
    pytest.importorskip("optuna")
    more = """\
  product: {scene: pair, quantity: elastic_energy, value: 0.1674, tolerance: 0.002}
  height: {scene: pair, quantity: gravitational_energy, value: 0.42, tolerance: 0.025}
repeat: {seeds: 2}
search:"""
    path = written(
        tmp_path, ("from: 0.3", "from: 0.45"), ("1 mJ, tolerance: 10 uJ", "0.89, tolerance: 0.01"),
        ("search:", more), ("trials: 12", "trials: 16"),
    )  # fmt: skip
    out = tmp_path / "out"
    study = read_calibration(path)
    lines = []
    result = run_calibration(study, out, jobs=2, report=lines.append)
    assert result.is_met and len(lines) == 16
    friction, restitution = (each.value for each in result.parameters)
    assert (friction, restitution) == pytest.approx((0.27, 0.62), rel=0.05)
    assert not any(each.not_identified for each in result.parameters) and not result.conflicts
    assert "Warning of the best trial, pair: A wall has moved away." in result.remarks
    height = result.targets[-1]
    assert (height.simulated, height.error) == pytest.approx((friction + 0.15, 0.05 / 0.025), abs=1e-12)
    assert "raise repeat.seeds" in height.noise
    assert (out / "calibration.html").stat().st_size > 10_000
    assert f"friction: {friction!r}" in (out / "best.yaml").read_text()
    assert len((out / "starts.txt").read_text().splitlines()) == 2 * 16
    monkeypatch.setattr("granflow.studies.calibration.calibrate.write_calibration_page", lambda *_: None)
    again = run_calibration(study, out, jobs=2, report=lines.append)
    assert len(lines) == 16 and again.parameters == result.parameters


def test_calibration_continues_after_a_full_disk_and_reports_conflicting_targets(
    tmp_path, stand_in, monkeypatch
):
    """The sum cannot be 0.6 and 0.9 at the same time."""
    pytest.importorskip("optuna")
    other = "  other: {scene: pair, quantity: kinetic_energy, value: 0.9, tolerance: 0.1}\nsearch:"
    path = written(
        tmp_path, ("1 mJ, tolerance: 10 uJ", "0.6, tolerance: 0.1"), ("search:", other),
        ("trials: 12", "trials: 20"),
    )  # fmt: skip
    study = read_calibration(path)

    def full_disk(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr("granflow.studies.calibration.search.os.fsync", full_disk)
        with pytest.raises(OutputError, match="No space left on device"):
            run_calibration(study, tmp_path / "out", jobs=1)
    monkeypatch.setattr("granflow.studies.calibration.calibrate.write_calibration_page", lambda *_: None)
    result = run_calibration(study, tmp_path / "out", jobs=1)
    assert not result.is_met
    (sentence,) = result.conflicts
    assert sentence.startswith("energy and other conflict: of ")


def target(folder, **more):
    given = {"scene": "a", "quantity": "flow_mass.out", "tolerance": 0.5, "weight": 3.0, **more}
    return trials.read_target(Target.model_validate(given), folder, "x:1:1")


def test_residual_of_a_value_is_the_weighted_deviation_in_tolerances(tmp_path):
    """(5 - 4) / 0.5 = 2 tolerances; the share of the loss is 3 * 2^2 = 12."""
    (tmp_path / "result.json").write_text(json.dumps({"flow_meters": {"out": {"flow_mass": 5.0}}}))
    measured = target(tmp_path, value=4.0)
    found = trials.residuals(measured, trials.simulated(measured, tmp_path))
    assert float(found @ found) == pytest.approx(12.0)
    assert trials.deviation(measured, {"a": found.tolist()}, "a") == pytest.approx(2.0)
    assert errors_of([tmp_path], measured) == [0.0]


def test_curve_is_compared_from_the_beginning_of_its_stage(tmp_path):
    """The run has 10 t from the stage at 1 s on; the curve is 10 t + 1: two tolerances everywhere. After 2.25 s
    of the run, 1.25 s of the stage, three of four points are known: three quarters of the loss."""
    rows = [
        f"{time},{'fill' if time < 1 else 'out'},{10 * max(time - 1, 0)}" for time in np.linspace(0, 3, 13)
    ]
    (tmp_path / "flow.csv").write_text("time,value\n0,1\n0.5,6\n1.1,12\n2,21\n")
    measured = target(tmp_path, curve="flow.csv", stage="out")
    for count, loss in ((13, lambda: trials.residuals(measured, trials.simulated(measured, tmp_path)) ** 2),
                        (10, lambda: trials.partial_loss(measured, tmp_path))):  # fmt: skip
        lines = ["time [s],stage,flow_mass.out [kg]", *rows[:count]]
        (tmp_path / "timeseries.csv").write_text("\n".join(lines) + "\n")
        assert np.sum(loss()) == pytest.approx(12.0 if count == 13 else 9.0)


def test_a_curve_is_converted_by_the_units_of_its_columns(tmp_path):
    (tmp_path / "flow.csv").write_text("value [g],time(min)\n1,0\n6,2\n")
    measured = target(tmp_path, curve="flow.csv")
    assert measured.time == pytest.approx([0.0, 120.0]) and measured.value == pytest.approx([1e-3, 6e-3])


def errors_of(directories, measured):
    """Standard errors of the residuals of a target from runs with different seeds."""
    values = np.array([trials.simulated(measured, each) for each in directories])
    return trials.standard_errors(measured, values, directories)


def test_standard_error_of_seeds_is_the_larger_one_of_scatter_and_errors_of_the_runs(tmp_path):
    """Angles 25, 27, 29 deg: s = 2 deg, s / sqrt(3) = 1.155 deg. Errors of 1 deg of each run: sqrt(3) / 3 deg;
    of 3 deg: 1.732 deg. The tolerance is 3 deg."""
    given = {"scene": "a", "quantity": "angle_of_repose.left", "tolerance": "3 deg", "value": "27 deg"}
    measured = trials.read_target(Target.model_validate(given), tmp_path, "x:1:1")
    for error, expected in ((1.0, 2.0 / np.sqrt(3.0)), (3.0, 3.0 / np.sqrt(3.0))):
        folders = []
        for degrees in (25.0, 27.0, 29.0):
            folders.append(tmp_path / f"{error}_{degrees}")
            folders[-1].mkdir()
            angles = {"angle_of_repose": np.radians(degrees), "angle_of_repose_error": np.radians(error)}
            (folders[-1] / "result.json").write_text(json.dumps({"metrics": {"left": angles}}))
        assert errors_of(folders, measured) == pytest.approx([expected / 3.0])
        assert errors_of(folders[:1], measured) == pytest.approx([error / 3.0])


def deviations(u, residuals, error=0.0):
    """Standard deviations at the best trial, and the parameters at the optimum of the fit."""
    best = int(np.argmin((residuals**2).sum(axis=1)))
    response = fit_response(u, residuals, best, np.full_like(residuals, error), highest=1)
    return response.deviation(u[best]), response.optimum(u[best])


def test_uncertainty_of_exact_linear_residuals():
    """Residuals 20 (u - 0.3) and 5 (v - 0.6): standard deviations 1/sqrt(400 + 12) and 1/sqrt(25 + 12).

    With standard errors of the runs of 40 tolerances, the residuals do not limit the uniform deviation 1/sqrt(12).
    """
    u = np.random.default_rng(1).uniform(size=(40, 2))
    residuals = np.column_stack([20.0 * (u[:, 0] - 0.3), 5.0 * (u[:, 1] - 0.6)])
    found, optimum = deviations(u, residuals)
    assert found == pytest.approx([1 / np.sqrt(412.0), 1 / np.sqrt(37.0)], rel=1e-6)
    assert optimum == pytest.approx([0.3, 0.6]) and is_identified(found[0])
    (uncertain,), _ = deviations(u[:5, :1], 7.0 * (u[:5, :1] - 0.5), 4.0)
    assert uncertain == pytest.approx(np.sqrt(1.0 / 12.0)) and not is_identified(uncertain)


def test_parameters_of_a_sum_are_identified_only_together():
    """One residual with scatter responds to u and v through their sum only, and not to w.

    The sum is known: its direction has a vanishing variance, each of u and v keeps half of the uniform one.
    """
    random = np.random.default_rng(2)
    u = random.uniform(size=(60, 3))
    found, _ = deviations(u, 30.0 * (u[:, :1] + u[:, 1:2] - 1.0) + random.normal(0.0, 0.5, (60, 1)))
    assert found == pytest.approx([np.sqrt(1 / 24), np.sqrt(1 / 24), np.sqrt(1 / 12)], rel=0.05)
    assert not any(map(is_identified, found))
