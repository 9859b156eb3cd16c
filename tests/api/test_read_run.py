"""Runs read back from their directories, complete or not, and the metrics and fields that `analyze` computes."""

import csv

import meshio
import numpy as np
import pytest
from scene_builders import box, build_scene, particle_group

import granflow as gf
from granflow.cli.main import main
from granflow.io.log import run_log

POSITIONS = 0.0098 * (np.argwhere(np.ones((4, 4, 4))) + 0.5)
METRICS = {
    "mix": {"kind": "lacey", "cell": 0.02, "at_least": 2, "groups": ["red"]}, "web": {"kind": "fabric"},
    "bed": {"kind": "coordination"}, "heap": {"kind": "repose", "surface": "plane"}
}  # fmt: skip
FIELDS = {"bed": {"cells": [2, 2, 2], "region": {"min": [0.0] * 3, "max": [0.04] * 3}, "stages": ["last"]}}


@pytest.fixture(scope="module")
def reference(taichi_f64, tmp_path_factory):
    """Directory of a run of two groups in a box with contacts, wall forces, a flow meter, metrics and fields; its
    result and snapshots."""
    path = tmp_path_factory.mktemp("run") / "out"
    random = np.random.default_rng(1)
    groups = {
        name: particle_group(POSITIONS[cut], 0.01, velocity=random.normal(0.0, 0.3, POSITIONS[cut].shape))
        for name, cut in {"red": slice(0, 32), "blue": slice(32, 64)}.items()
    }
    scene = build_scene(
        groups, walls=box(0.0392), pair={"friction": 0.4}, gravity=[0.0, 0.0, -9.81],
        numerics={"max_overlap": 0.3}, run={"velocity_max": 2.0},
        stages=[{"name": "first", "duration": 0.001}, {"name": "last", "duration": 0.002}],
        output={
            "interval": 0.001, "contacts": True, "wall_forces": ["low_z"], "fields": FIELDS, "metrics": METRICS,
            "flow_meters": {"middle": {"point": [0, 0, 0.02], "normal": [0, 0, 1]}},
        },
        expect=[{"quantity": "particle_count", "equals": 64, "tolerance": 0}],
    )  # fmt: skip
    snapshots = []
    wants = ("particles", "totals", "contacts")
    simulation = gf.Simulation(scene, out=path, observers=[gf.on_interval(0.001, snapshots.append, wants)])
    result = simulation.run()
    simulation.free()
    return path, result, snapshots


@pytest.fixture
def run(reference):
    return gf.read_run(str(reference[0]))


def test_numbers_equal_those_of_the_run(run, reference):
    _, result, snapshots = reference
    assert run.status == "complete" and run.time == result.run["simulated_time"]
    assert run.result.numbers == pytest.approx(result.numbers, nan_ok=True)
    assert run.result.expectations == result.expectations and run.result.expectations[0].met
    series = run.timeseries_arrays
    assert series["kinetic_energy"].tolist() == [each.totals["kinetic_energy"] for each in snapshots]
    assert series["stage"].tolist() == [each.stage for each in snapshots]
    assert series.units["kinetic_energy"] == "J" and series.units["time"] == "s"
    for each in (run, run.result, run.snapshot(0)):
        assert "64" in repr(each) + each._repr_html_() and len(repr(each)) < 400


def test_frames_equal_the_snapshots(run, reference):
    _, _, snapshots = reference
    assert run.frames.times.tolist() == [each.time for each in snapshots]
    for index, expected in enumerate(snapshots):
        found = run.snapshot(index)
        assert found.time == expected.time and found.stage == expected.stage
        for name in ("position", "velocity", "radius", "mass"):
            np.testing.assert_allclose(found.particles[name], expected.particles[name], rtol=2e-6, atol=1e-8)
        np.testing.assert_array_equal(found.contacts["id_i"], expected.contacts["id_i"])
        np.testing.assert_allclose(found.contacts["force"], expected.contacts["force"], rtol=2e-6, atol=1e-9)
    assert run.frames[-1].contacts is None and len(run.frames[1:]) == len(snapshots) - 1
    between = np.mean(run.frames.times[:2])
    assert run.frames.at(0.9 * between).time == run.frames.times[0]
    assert run.frames.at(1.1 * between).time == run.frames.times[1]
    assert len(run.contacts.at(0.0)["overlap"]) == len(snapshots[0].contacts["force"])
    with pytest.raises(IndexError):
        run.frames[99]


def test_observers_have_tables_and_the_time_series_is_a_data_frame(run):
    pandas = pytest.importorskip("pandas")
    meter, wall, whole = run.flow_meters["middle"], run.wall_forces["low_z"], run.timeseries_arrays
    np.testing.assert_array_equal(meter["flow_mass"], whole["flow_mass.middle"])
    np.testing.assert_array_equal(wall["wall_force_z"], whole["wall_force_z.low_z"])
    assert meter.units["mass_flow"] == "kg/s" and "time" in wall and "wall_force_z" not in meter
    np.testing.assert_array_equal(run.metrics["bed"]["rattler_share"], whole["rattler_share.bed"])
    bed = run.fields["bed"][-1]
    assert bed["position"].shape == (8, 3) and bed["density"].shape == (8,)
    table = run.timeseries
    assert isinstance(table, pandas.DataFrame) and table.attrs["units"]["kinetic_energy"] == "J"
    assert table["kinetic_energy"].tolist() == whole["kinetic_energy"].tolist()


def rows_of(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def test_analyzed_metrics_and_fields_equal_those_of_the_run(reference, tmp_path, capsys):
    """Equal within the seven digits of the frames."""
    out = reference[0]
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


def test_unfinished_and_aborted_runs_are_readable(tmp_path):
    series = "time [s],stage,kinetic_energy [J]\n0.0,fill,1\n0.5,fill,2\n0.75,fi"
    (tmp_path / "timeseries.csv").write_text(series)
    (tmp_path / "run.log").write_text("")
    run = gf.read_run(tmp_path)
    assert run.status == "unfinished" and run.result is None and run.time == 0.5
    assert run.timeseries_arrays["kinetic_energy"].tolist() == [1.0, 2.0]
    assert len(run.frames) == 0 and len(run.contacts) == 0 and run.fields == {}
    with pytest.raises(gf.SceneError, match="there is no such file"):
        _ = run.scene
    with pytest.raises(gf.RunError), run_log(tmp_path):
        raise gf.RunError("it burst")
    run = gf.read_run(tmp_path)
    assert run.status == "aborted" and run.record[-1].text == "ended by RunError: it burst"
    assert "0 sessions" in repr(run.record)


def test_damaged_and_missing_runs_are_reported(tmp_path):
    for path, message in (
        (tmp_path, "is not the directory of a run: it contains none of scene_as_run"),
        (tmp_path / "none", "there is no such directory; give the directory of a run"),
    ):
        with pytest.raises(gf.GranflowError, match=message):
            gf.read_run(path)
    (tmp_path / "result.json").write_text("{")
    with pytest.raises(gf.GranflowError, match=r"result\.json cannot be read"):
        _ = gf.read_run(tmp_path).result
    (tmp_path / "result.json").write_text('{"run": {"simulated_time": null}}')
    assert np.isnan(gf.read_run(tmp_path).result.run["simulated_time"])
