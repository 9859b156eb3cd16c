"""`granflow analyze` computes the same metrics and fields from the frames of a run as the run itself."""

import csv

import meshio
import numpy as np
import pytest
from scene_builders import box, build_scene, particle_group, run_to_end

from granflow.cli.main import main

METRICS = {
    "mix": {"kind": "lacey", "cell": 0.02, "at_least": 2, "groups": ["red"]}, "web": {"kind": "fabric"},
    "bed": {"kind": "coordination"}, "heap": {"kind": "repose", "surface": "plane"}
}  # fmt: skip
FIELDS = {"bed": {"cells": [2, 2, 2], "region": {"min": [0.0] * 3, "max": [0.04] * 3}, "stages": ["last"]}}


@pytest.fixture
def out(taichi_f64, tmp_path_factory):
    """Directory of a run of two groups with random velocities in a box: contact frames, metrics and
    fields."""
    path = tmp_path_factory.mktemp("run")
    random = np.random.default_rng(1)
    positions = 0.0098 * (np.argwhere(np.ones((4, 4, 4))) + 0.5)
    groups = {
        name: particle_group(positions[cut], 0.01, velocity=random.normal(0.0, 0.3, positions[cut].shape))
        for name, cut in {"red": slice(0, 32), "blue": slice(32, 64)}.items()
    }
    scene = build_scene(
        groups, walls=box(0.0392), pair={"friction": 0.4}, gravity=[0.0, 0.0, -9.81],
        numerics={"max_overlap": 0.3}, run={"velocity_max": 2.0},
        stages=[{"name": "first", "duration": 0.001}, {"name": "last", "duration": 0.002}],
        output={"interval": 0.001, "contacts": True, "metrics": METRICS, "fields": FIELDS},
    )  # fmt: skip
    run_to_end(scene, out=path)
    return path


def rows_of(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def test_analyzed_metrics_and_fields_equal_those_of_the_run(out, tmp_path, capsys):
    """Equal within the seven digits of the frames."""
    assert main(["analyze", str(out), "--out", str(tmp_path)]) == 0
    measured, series = (rows_of(path) for path in (tmp_path / "metrics.csv", out / "timeseries.csv"))
    assert len(measured) == len(series) >= 4
    assert len(measured[0]) == 2 + 1 + 4 + 4 + 2
    for one, other in zip(measured, series, strict=True):
        assert one.pop("stage") == other["stage"]
        for name, value in one.items():
            expected = pytest.approx(float(other[name]), rel=1e-4, abs=1e-6, nan_ok=True)
            assert float(value) == expected, name
    names = sorted(path.name for path in out.glob("fields_*.vtu"))
    assert names == sorted(path.name for path in tmp_path.glob("fields_*.vtu"))
    for name in ("fields_bed_mean.vtu", names[0]):
        one, other = (meshio.read(folder / name).cell_data for folder in (tmp_path, out))
        for field, (values,) in other.items():
            tolerance = 1e-5 * np.nanmax(np.abs(values))
            np.testing.assert_allclose(one[field][0], values, rtol=1e-4, atol=tolerance)
    assert main(["analyze", str(out), "--set", "output.metrics={}", "--set", "output.fields={}"]) == 2
    assert "Nothing to analyze" in capsys.readouterr().err
