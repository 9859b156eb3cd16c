"""Calibration without runs: messages, targets, and the response of residuals with known parameters."""

import errno
import json
import os

import numpy as np
import pytest
from studies.sweep_files import SCENE

from granflow.cli.main import main
from granflow.errors import FileError, GranflowError, OutputError
from granflow.studies.calibration.calibrate import estimate_trials, read_calibration, run_calibration
from granflow.studies.calibration.schema import (
    Parameter,
    Target,
    deviation_in_units,
    from_unit,
    settings_of,
    to_unit,
)
from granflow.studies.calibration.search import JOURNAL, Search
from granflow.studies.calibration.trials import (
    TrialRunner,
    _missing_reason,
    deviation,
    given_text,
    partial_loss,
    read_target,
    residuals,
    simulated,
    standard_errors,
)
from granflow.studies.checked_run import RunSettings
from granflow.studies.run_process import error_name

CALIBRATION = """\
scenes: {pair: {scene: spheres.yaml}}
parameters:
  friction: {keys: pairs.steel-steel.friction, from: 0.05, to: 0.8}
  restitution: {keys: [pairs.steel-steel.restitution], from: 0.3, to: 0.9}
targets:
  energy: {scene: pair, quantity: kinetic_energy, value: 1 mJ, tolerance: 10 uJ}
search: {trials: 12}
"""


def written(folder, text=CALIBRATION):
    (folder / "spheres.yaml").write_text(SCENE)
    (folder / "calibration.yaml").write_text(text)
    return folder / "calibration.yaml"


def test_dry_run_checks_the_ends_of_the_parameters_and_writes_nothing(tmp_path, capsys):
    path = written(tmp_path)
    command = ["calibrate", str(path), "--out", str(tmp_path / "out"), "--dry-run"]
    assert main(command) == 0
    said = capsys.readouterr().out
    assert "pair" in said and "12 of 12 trials are to do." in " ".join(said.split())
    assert "set search.trials to 16 or more" in said, "2 (3 + 5) for two parameters"
    assert not (tmp_path / "out").exists()
    study = read_calibration(written(tmp_path, CALIBRATION.replace("to: 0.9", "to: 1.2")))
    with pytest.raises(FileError, match=r"calibration\.yaml:4:.* is 1\.2"):
        estimate_trials(study, tmp_path / "out")
    study = read_calibration(written(tmp_path, CALIBRATION.replace("to: 0.9", "to: 1.9")))
    with pytest.raises(
        FileError, match=r"calibration\.yaml:4:.* is 1\.9,"
    ):  # the middle, 1.1, is invalid too
        estimate_trials(study, tmp_path / "out")


def test_dry_run_names_the_value_at_which_particles_overlap(tmp_path):
    """Spheres of 60 mm at a distance of 20.2 mm overlap by more than the radius."""
    diameter = "  d: {keys: particles.spheres.diameter, from: 1 mm, to: 60 mm}\ntargets:"
    study = read_calibration(written(tmp_path, CALIBRATION.replace("targets:", diameter)))
    with pytest.raises(FileError, match=r"at the start.* This is with d at 60 mm\.") as caught:
        estimate_trials(study, tmp_path / "out")
    assert all("d at 1 mm" not in each for each in caught.value.problems)


def test_dry_run_with_too_few_trials_says_that_no_parameter_is_identified(tmp_path, capsys):
    """A linear fit of two parameters needs 1.5 * 3 + 1 = 5.5, so 6 trials."""
    for count, words in ((1, "1 trial is too few"), (5, "5 trials are too few"), (6, "6 trials are few")):
        path = written(tmp_path, CALIBRATION.replace("trials: 12", f"trials: {count}"))
        assert main(["calibrate", str(path), "--out", str(tmp_path / "out"), "--dry-run"]) == 0
        assert words in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(("old", "new", "words"), [
    ("tolerance", "tolerence",
     "calibration.yaml:6:64: targets.energy.tolerence is not a known key. Did you mean"),
    ("scene: pair,", "scene: piar,",
     "calibration.yaml:6:19: targets.energy.scene is piar, but there is no such"),
    ("value: 1 mJ, ", "", "calibration.yaml:6:3: targets.energy.value is missing"),
    ("from: 0.3", "from: 0.95", "restitution.to is 0.9, but it must be larger than from, 0.95."),
    ("spheres.yaml", "sphere.yaml",
     "calibration.yaml:1:24: scenes.pair.scene is sphere.yaml, but there is no file"),
    ("value: 1 mJ", "curve: a.csv", "calibration.yaml:6:58: curve is a.csv, but "),
    ("value: 1 mJ", "value: 1 mm",
     "targets.energy.tolerance is 10 uJ, but mm and uJ are units of different"),
    ("1 mJ, tolerance: 10 uJ", "1 g, tolerance: 1 mg",
     "value is 1 g, but g is ambiguous; give the value in SI"),
    ("1 mJ, tolerance: 10 uJ", "1 mm, tolerance: 1 mm",
     "value is 1 mm, but kinetic_energy is in J, and mm is no"),
    ("tolerance: 10 uJ", "tolerance: 0.1", "tolerance is 0.1, but 0.1 has no unit; give all values in mJ"),
    ("from: 0.3, to: 0.9", "from: 30 deg, to: 10 deg",
     "to is 10 deg, but it must be larger than from, 30 deg."),
    ("from: 0.3, to: 0.9", "from: 0.3 rad, to: 0.9",
     "0.9 has no unit; give all values in rad, or all in SI units."),
    ("[pairs.steel-steel.restitution]", "pairs.steel-steel.friction", "which parameters.friction sets too")
])  # fmt: skip
def test_problems_are_reported_with_position(tmp_path, old, new, words):
    with pytest.raises(FileError) as caught:
        read_calibration(written(tmp_path, CALIBRATION.replace(old, new)))
    assert words in str(caught.value)


def runner(folder, text=CALIBRATION):
    pytest.importorskip("optuna")
    study = read_calibration(written(folder, text))
    common = RunSettings(folder / "runs", 1, "cpu", folder / "stop")
    search = Search(study.content, folder)
    return TrialRunner(search, study.scenes, study.targets, study.positions, common, lambda: False)


@pytest.mark.parametrize(("old", "new", "words"), [
    ("keys: pairs.steel-steel.friction", "keys: pairs.steel-steel.frction",
     r"calibration.yaml:3:3: .*frction is not a known key. Did you mean friction\?"),
    ("quantity: kinetic_energy", "quantity: kinetik_energy",
     r"calibration.yaml:6:35: kinetik_energy is not a number .* kinetic_energy\?"),
])  # fmt: skip
def test_problems_with_the_scene_are_reported_at_their_parameter_or_target(tmp_path, old, new, words):
    with pytest.raises(FileError, match=words):
        runner(tmp_path, CALIBRATION.replace(old, new)).check()


def test_journal_of_another_calibration_is_refused(tmp_path):
    runner(tmp_path)
    with pytest.raises(
        GranflowError, match="trials of a calibration with other scenes, parameters or targets"
    ):
        runner(tmp_path, CALIBRATION.replace("1 mJ", "2 mJ"))


CURVE = CALIBRATION.replace("value: 1 mJ", "curve: energy.csv")


@pytest.mark.parametrize(("name", "old", "new", "words"), [
    ("spheres.yaml", "8000", "9000", r"another content of the scene pair \(spheres.yaml\): it, a file"),
    ("energy.csv", "2,0.5", "2,0.6", r"another content of the curve of energy \(energy.csv\)")
])  # fmt: skip
def test_trials_with_another_content_of_a_scene_or_a_curve_are_refused(tmp_path, name, old, new, words):
    (tmp_path / "energy.csv").write_text("time,value\n1,0.4\n2,0.5\n")
    runner(tmp_path, CURVE).check()
    runner(tmp_path, CURVE).check()
    path = tmp_path / name
    changed = path.read_text().replace(old, new)
    found = runner(tmp_path, CURVE) if name == "spheres.yaml" else None
    path.write_text(changed)
    with pytest.raises(GranflowError, match=words):
        (found or runner(tmp_path, CURVE)).check()


def finished_trial(search, loss):
    trial = search.next_trial()
    trial.set_user_attr("residuals", {"energy": [loss]})
    search.study.tell(trial, loss)
    return trial


def full_disk(*_):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_journal_with_a_damaged_line_is_read_without_it(tmp_path):
    """Earlier programs wrote the next operation behind half a line."""
    search = runner(tmp_path).search
    finished_trial(search, 4.0)
    path = tmp_path / JOURNAL
    middle = path.read_bytes()
    finished_trial(search, 3.0)
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


def test_search_ends_after_its_number_of_trials(tmp_path):
    search = runner(tmp_path).search
    count = 0
    while (trial := search.next_trial()) is not None:
        x, y = trial.params["friction"] - 0.3, trial.params["restitution"] - 0.6
        trial.set_user_attr("residuals", {"energy": [10.0 * x, 10.0 * y]})
        search.study.tell(trial, 100.0 * (x * x + y * y))
        count += 1
    best = min(search.completed(), key=lambda trial: trial.value)
    assert count == 12
    # The residuals are linear, so the last trials, at the optimum of the fit, are exact.
    assert (best.params["friction"], best.params["restitution"]) == pytest.approx((0.3, 0.6), abs=1e-6)


def test_parameter_sets_its_keys_in_each_scene(tmp_path):
    text = CALIBRATION.replace(
        "keys: pairs.steel-steel.friction", "keys_in: {pair: [pairs.steel-steel.friction]}"
    )
    content = read_calibration(written(tmp_path, text)).content
    assert settings_of(content, "pair", {"friction": 0.1, "restitution": 0.5}) == {
        "pairs.steel-steel.friction": 0.1, "pairs.steel-steel.restitution": 0.5
    }  # fmt: skip


def test_scaled_parameters_include_both_bounds():
    """On a logarithmic scale, the middle of 0.01 and 1 is 0.1, and a share of 0.1 there is 0.1 ln(100)
    0.1."""
    parameter = Parameter.model_validate({"from": 0.01, "to": 1.0, "scale": "log"})
    assert [from_unit(parameter, share) for share in (0.0, 0.5, 1.0)] == pytest.approx([0.01, 0.1, 1.0])
    assert to_unit(parameter, 0.1) == pytest.approx(0.5)
    assert deviation_in_units(parameter, 0.1, 0.1) == pytest.approx(0.1 * np.log(100.0) * 0.1)


def test_two_workers_find_planted_values_and_continue(tmp_path, stand_in):
    """Runs are replaced by e + mu and e mu with e = 0.62 and mu = 0.27; the solution e = 0.27 is out of
    bounds."""
    pytest.importorskip("optuna")
    text = CALIBRATION.replace("from: 0.3", "from: 0.45").replace(
        "value: 1 mJ, tolerance: 10 uJ", "value: 0.89, tolerance: 0.01"
    )
    text = text.replace(
        "search:",
        "  product: {scene: pair, quantity: elastic_energy, value: 0.1674, tolerance: 0.002}\nsearch:",
    )
    study = read_calibration(written(tmp_path, text.replace("trials: 12", "trials: 30")))
    lines = []
    result = run_calibration(study, tmp_path / "out", jobs=2, report=lines.append)
    assert result.is_met and len(lines) == 30
    assert [each.value for each in result.parameters] == pytest.approx([0.27, 0.62], rel=0.05)
    assert not any(each.not_identified for each in result.parameters) and not result.conflicts
    assert result.remarks == ("Warning of the best trial, pair: A wall has moved away.",)
    assert (tmp_path / "out" / "trials.csv").read_text().count("pair: A wall has moved away.") >= 15
    assert ">warnings</th>" in (tmp_path / "out" / "calibration.html").read_text()
    best = (tmp_path / "out" / "best.yaml").read_text()
    assert f"friction: {result.parameters[0].value!r}" in best
    # The same command repeats nothing.
    again = run_calibration(study, tmp_path / "out", jobs=2, report=lines.append)
    assert len(lines) == 30 and again.parameters == result.parameters


def test_trials_with_several_seeds_have_the_loss_of_their_means(tmp_path, stand_in, capsys):
    """Seeds 1, 2, 3 give friction + 0.1, 0.2, 0.3: a mean of 0.5 needs a friction of 0.3, and its standard
    error is 0.1 / sqrt(3) = 0.058, or 2.9 tolerances."""
    pytest.importorskip("optuna")
    text = CALIBRATION.replace(
        "kinetic_energy, value: 1 mJ, tolerance: 10 uJ", "gravitational_energy, value: 0.5, tolerance: 0.02"
    )
    text = text.replace("search: {trials: 12}", "search: {trials: 25}\nrepeat: {seeds: 3}")
    study = read_calibration(written(tmp_path, text))
    result = run_calibration(study, tmp_path / "out", jobs=2)
    assert result.parameters[0].value == pytest.approx(0.3, abs=0.02)
    (target,) = result.targets
    assert target.simulated == pytest.approx(0.2 + result.parameters[0].value, abs=1e-12)
    assert target.error == pytest.approx(0.1 / np.sqrt(3.0) / 0.02)
    assert target.shown[1].endswith(" \N{PLUS-MINUS SIGN} 0.058") and "raise repeat.seeds" in target.noise
    assert len((tmp_path / "out" / "starts.txt").read_text().split("run ")) - 1 == 3 * 25
    assert (tmp_path / "out" / "calibration.png").stat().st_size > 10_000
    page = (tmp_path / "out" / "calibration.html").read_text()
    assert "simulated, mean of 3 seeds" in page and "\N{PLUS-MINUS SIGN} 0.058" in page
    single = estimate_trials(
        read_calibration(written(tmp_path, text.replace("seeds: 3", "seeds: 1"))), tmp_path / "o"
    )
    three = estimate_trials(study, tmp_path / "o")
    assert three.scenes["pair"] == pytest.approx([3.0 * each for each in single.scenes["pair"]])


def test_a_seed_cannot_be_both_set_and_repeated(tmp_path):
    text = CALIBRATION.replace("scene: spheres.yaml", "scene: spheres.yaml, set: {seed: 4}")
    with pytest.raises(FileError, match="repeat changes the seed, which scenes.pair.set sets too"):
        read_calibration(written(tmp_path, text + "repeat: {seeds: 2}\n"))


def test_calibration_continues_after_a_full_disk_and_reports_conflicting_targets(
    tmp_path, stand_in, monkeypatch
):
    """The sum cannot be 0.6 and 0.9 at the same time."""
    pytest.importorskip("optuna")
    text = CALIBRATION.replace("value: 1 mJ, tolerance: 10 uJ", "value: 0.6, tolerance: 0.1")
    text = text.replace(
        "search:", "  other: {scene: pair, quantity: kinetic_energy, value: 0.9, tolerance: 0.1}\nsearch:"
    )
    study = read_calibration(written(tmp_path, text.replace("trials: 12", "trials: 40")))
    with monkeypatch.context() as patch:
        patch.setattr("granflow.studies.calibration.search.os.fsync", full_disk)
        message = r"out cannot be written or read: No space left on device. The trials that"
        with pytest.raises(OutputError, match=message):
            run_calibration(study, tmp_path / "out", jobs=1)
    result = run_calibration(study, tmp_path / "out", jobs=1)
    assert not result.is_met
    (sentence,) = result.conflicts
    assert sentence.startswith("energy and other conflict: of ") and sentence.endswith("but none meets both.")


def test_a_target_that_no_trial_reaches_is_named_first(tmp_path, stand_in):
    """The sum e + mu of the stand-in is at most 2 within any bounds of e and mu up to 1."""
    pytest.importorskip("optuna")
    text = CALIBRATION.replace("value: 1 mJ, tolerance: 10 uJ", "value: 2.5, tolerance: 0.1")
    result = run_calibration(read_calibration(written(tmp_path, text)), tmp_path / "out", jobs=1)
    values = [trial.user_attrs["simulated"]["energy"] for trial in result.trials]
    (sentence,) = result.out_of_reach
    assert result.remarks[0] == sentence
    assert sentence.startswith(
        f"energy is out of reach: in all 12 trials kinetic_energy is below the measured 2.5 J, from "
        f"{min(values):.5g} J to {max(values):.5g} J, at best by {(2.5 - max(values)) / 0.1:.2g} tolerances."
    )


def target(folder, **more):
    given = {"scene": "a", "quantity": "flow_mass.out", "tolerance": 0.5, "weight": 3.0, **more}
    return read_target(Target.model_validate(given), folder, "x:1:1")


def test_residual_of_a_value_is_the_weighted_deviation_in_tolerances(tmp_path):
    """(5 - 4) / 0.5 = 2 tolerances; the share of the loss is 3 * 2^2 = 12."""
    (tmp_path / "result.json").write_text(json.dumps({"flow_meters": {"out": {"flow_mass": 5.0}}}))
    measured = target(tmp_path, value=4.0)
    found = residuals(measured, simulated(measured, tmp_path))
    assert float(found @ found) == pytest.approx(12.0)
    assert deviation(measured, {"a": found.tolist()}, "a") == pytest.approx(2.0)


def test_curve_is_compared_from_the_beginning_of_its_stage(tmp_path):
    """The run has 10 t from the stage at 1 s on; the curve is 10 t + 1: two tolerances everywhere."""
    rows = [
        f"{time},{'fill' if time < 1 else 'out'},{10 * max(time - 1, 0)}" for time in np.linspace(0, 3, 13)
    ]
    (tmp_path / "timeseries.csv").write_text("\n".join(["time [s],stage,flow_mass.out [kg]", *rows]) + "\n")
    (tmp_path / "flow.csv").write_text("time,value\n0,1\n0.5,6\n1.1,12\n2,21\n")
    measured = target(tmp_path, curve="flow.csv", stage="out")
    found = residuals(measured, simulated(measured, tmp_path))
    assert float(found @ found) == pytest.approx(12.0)
    # After 2.25 s of the run, 1.25 s of the stage, three of four points are known: three quarters of the
    # loss.
    (tmp_path / "timeseries.csv").write_text(
        "\n".join(["time [s],stage,flow_mass.out [kg]", *rows[:10]]) + "\n"
    )
    assert partial_loss(measured, tmp_path) == pytest.approx(9.0)


@pytest.mark.parametrize(("head", "rows", "time", "value"), [
    ("time [ms],value [g]", "0,1\n500,6\n", [0.0, 0.5], [1e-3, 6e-3]),
    ("time(min),value", "0,1\n2,6\n", [0.0, 120.0], [1.0, 6.0]),
    ("value [t],time [s]", "1,0\n6,2\n", [0.0, 2.0], [1e3, 6e3])
])  # fmt: skip
def test_a_curve_is_converted_by_the_units_of_its_columns(tmp_path, head, rows, time, value):
    (tmp_path / "flow.csv").write_text(f"{head}\n{rows}")
    measured = target(tmp_path, curve="flow.csv")
    assert measured.time == pytest.approx(time) and measured.value == pytest.approx(value)


@pytest.mark.parametrize(("head", "message"), [
    ("time [mm],value", "flow.csv:1: time is in s, and mm is no unit of it; give s, ms, us, ns, min, h."),
    ("time,value [mJ]", "flow.csv:1: flow_mass.out is in kg, and mJ is no unit of it; give kg, g, mg, t."),
    ("time,value,Value", "flow.csv:1: the header has both value and Value; keep one of the columns."),
    ("time [s],value,time [ms]", "flow.csv:1: the header has both time [s] and time [ms]; keep one")
])  # fmt: skip
def test_a_curve_with_columns_that_do_not_fit_is_refused(tmp_path, head, message):
    (tmp_path / "flow.csv").write_text(f"{head}\n0,1,0\n1,2,1\n")
    with pytest.raises(FileError) as error:
        target(tmp_path, curve="flow.csv")
    assert message in str(error.value)


ANGLE = {"angle_of_repose": np.radians(26.0), "angle_of_repose_error": 0.2}


def angle_run(folder, metrics=ANGLE, warnings=()):
    """The result of a run with a metric `left`."""
    result = {"metrics": {"left": metrics}, "warnings": warnings}
    (folder / "result.json").write_text(json.dumps(result))


def angle_target(folder):
    given = {"scene": "a", "quantity": "angle_of_repose.left", "tolerance": "3 deg", "value": "27 deg"}
    return read_target(Target.model_validate(given), folder, "x:1:1")


def test_standard_error_and_unit_of_a_target(tmp_path):
    """0.2 rad are 3.82 tolerances of 3 deg; the value is shown in degrees, as it is given."""
    angle_run(tmp_path)
    measured = angle_target(tmp_path)
    assert errors_of([tmp_path], measured) == pytest.approx([0.2 / np.radians(3.0)])
    assert given_text(measured, np.radians(27.0), "angle_of_repose.left") == "27 deg"
    plain = read_target(
        Target(scene="a", quantity="angle_of_repose.left", value=0.5, tolerance=0.1), tmp_path, ""
    )
    assert given_text(plain, 0.5, "angle_of_repose.left") == "0.5 rad"
    assert error_name("angle_of_repose_mean.left") == "angle_of_repose_error_mean.left"
    assert errors_of([tmp_path], target(tmp_path, value=4.0)) == [0.0]


def errors_of(directories, measured):
    """Standard errors of the residuals of a target from runs with different seeds."""
    values = np.array([simulated(measured, each) for each in directories])
    return standard_errors(measured, values, directories)


def test_standard_error_of_seeds_is_the_larger_one_of_scatter_and_errors_of_the_runs(tmp_path):
    """Angles 25, 27, 29 deg: s = 2 deg, s / sqrt(3) = 1.155 deg. Errors of 1 deg of each run: sqrt(3) / 3 deg;
    of 3 deg: 1.732 deg."""
    for error, expected in ((1.0, 2.0 / np.sqrt(3.0)), (3.0, 3.0 / np.sqrt(3.0))):
        folders = []
        for degrees in (25.0, 27.0, 29.0):
            folders.append(tmp_path / f"{error}_{degrees}")
            folders[-1].mkdir()
            angles = {"angle_of_repose": np.radians(degrees), "angle_of_repose_error": np.radians(error)}
            angle_run(folders[-1], angles)
        assert errors_of(folders, angle_target(tmp_path)) == pytest.approx([expected / 3.0])


def test_missing_value_of_a_trial_is_explained(tmp_path):
    """A value that is NaN, with the reason that the run gives; a quantity that the run does not have."""
    reason = (
        "output.metrics.left: the angle of repose is NaN: the surface has 3 points, but a fit needs at least "
        "4."
    )
    angle_run(tmp_path, dict.fromkeys(ANGLE), [reason, "output.metrics.right: another one"])
    sentence = _missing_reason("left", angle_target(tmp_path), tmp_path)
    assert sentence == f"{tmp_path}: target left: angle_of_repose.left is NaN. {reason}"
    angle_run(tmp_path, {})
    assert _missing_reason("left", angle_target(tmp_path), tmp_path).endswith(
        "angle_of_repose.left is missing."
    )
