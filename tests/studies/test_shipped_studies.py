"""The shipped sweeps and calibrations: all points, and the bounds of all parameters, are valid."""

from pathlib import Path

import pytest

from granflow.studies.calibration.calibrate import estimate_trials, read_calibration
from granflow.studies.checked_run import CheckedRun, RunSettings
from granflow.studies.sweep import checked_points, read_sweep

SCENES = Path(__file__).parents[2] / "scenes"
SWEEPS, CALIBRATIONS = (sorted((SCENES / folder).glob("*.yaml")) for folder in ("sweeps", "calibration"))


@pytest.mark.parametrize("path", SWEEPS, ids=lambda path: path.stem)
def test_all_points_of_a_shipped_sweep_are_valid(path, tmp_path):
    points = checked_points(read_sweep(path), RunSettings(tmp_path, 1, "cpu", tmp_path / "stop"))
    assert all(isinstance(run, CheckedRun) for _, runs in points for run in runs)


@pytest.mark.parametrize("path", CALIBRATIONS, ids=lambda path: path.stem)
def test_bounds_of_a_shipped_calibration_are_valid(path, tmp_path):
    study = read_calibration(path)
    assert estimate_trials(study, tmp_path / "out").scenes.keys() == study.scenes.keys()
