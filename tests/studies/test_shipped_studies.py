"""The shipped sweeps and calibrations: all points and trials are valid."""

from pathlib import Path

import pytest

from granflow.studies.calibration.calibrate import read_calibration
from granflow.studies.calibration.schema import settings_of
from granflow.studies.checked_run import CheckedRun, RunSettings, checked_run
from granflow.studies.sweep import checked_points, read_sweep

SCENES = Path(__file__).parents[2] / "scenes"
SWEEPS, CALIBRATIONS = (sorted((SCENES / folder).glob("*.yaml")) for folder in ("sweeps", "calibration"))


@pytest.mark.parametrize("path", SWEEPS, ids=lambda path: path.stem)
def test_all_points_of_a_shipped_sweep_are_valid(path, tmp_path):
    sweep = read_sweep(path)
    assert sweep.content.description
    runs = [
        run
        for _, each in checked_points(sweep, RunSettings(tmp_path, 1, "cpu", tmp_path / "stop"))
        for run in each
    ]
    assert not [run for run in runs if not isinstance(run, CheckedRun)]


@pytest.mark.parametrize("path", CALIBRATIONS, ids=lambda path: path.stem)
def test_bounds_of_a_shipped_calibration_are_valid(path, tmp_path):
    study = read_calibration(path)
    assert study.content.description
    common = RunSettings(tmp_path, 1, "cpu", tmp_path / "stop")
    for end in ("start", "stop"):
        values = {name: getattr(each, end) for name, each in study.content.parameters.items()}
        for name, scene in study.scenes.items():
            targets = [each for each in study.targets.values() if each.target.scene == name]
            read = {each.target.quantity: each.position for each in targets}
            assert isinstance(
                checked_run(scene, settings_of(study.content, name, values), read, common), CheckedRun
            )
