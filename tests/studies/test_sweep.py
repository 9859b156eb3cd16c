"""Sweeps without runs: messages, points, and the driver with an executor that returns outcomes at once."""

import csv
import json
from concurrent.futures import Future
from threading import Event

import numpy as np
import pytest
from studies.sweep_files import SCENE, SWEEP, write_sweep

from granflow.errors import FileError
from granflow.io.checkpoint import write_checkpoint
from granflow.studies import run_process
from granflow.studies.checked_run import CheckedRun, RunSettings
from granflow.studies.run_pool import SYSTEMS, Driver, cluster_options, read_profile
from granflow.studies.sweep import checked_points, read_sweep
from granflow.studies.sweep_design import SobolSampling, SweepInput, design_points, unit_samples
from granflow.studies.sweep_table import table_of, write_tables


@pytest.mark.parametrize(("text", "problem"), [
    ("vray: {}", "sweep.yaml:2:1: vray is not a known key. Did you mean vary?"),
    ("vary: {a: 5}", "a list of values or a range is expected"),
    ("vary: {a: {from: 0.1, to: 0.2}}", "vary.a.count is missing"),
    ("vary: {a: {from: 30 deg, to: 10 deg, count: 2}}", "larger than from, 30 deg."),
    ("vary: {a: {from: 0, to: 1, count: 2, scale: log}}", "above 0 on a logarithmic scale"),
    ("vary: {a: [10 deg, 20]}", "vary.a is [10 deg, 20], but 20 has no unit"),
    ("vary: {a: [1], b: {values: [2], keys: a}}", "vary.b sets a, which vary.a sets too"),
    ("vary: {a: {values: [1, 2], with: {b: [1]}}}", "it needs 2 values"),
    ("vary: {a: [1, 2]}\nrepeat: {seeds: 1000}\nsampling: {kind: sobol, count: 1024}", "gives 3072000 runs"),
    ("vary: {pairs.steel-steel.friction: [10 mm]}", "sweep.yaml:2:8: pairs.steel-steel.friction is 10 mm"),
    ("vary: {seed: [1]}\nread: kinetik_energy", "sweep.yaml:3:1: kinetik_energy is not a number of a run"),
])  # fmt: skip
def test_invalid_sweeps_are_refused_with_their_position(tmp_path, text, problem):
    """Also a unit of another dimension, whose number 0.01 would be a valid friction."""
    text = f"scene: spheres.yaml\n{text}\n" + ("" if "read:" in text else "read: kinetic_energy\n")
    with pytest.raises(FileError) as caught:
        checked_points(read_sweep(write_sweep(tmp_path, text)), settings(tmp_path))
    assert any(problem in each for each in caught.value.problems), caught.value.problems


def settings(folder):
    return RunSettings(folder / "runs", 1, "cpu", folder / ".stop")


def names_of_runs(folder):
    """Names of the run directories of a sweep of two points."""
    text = SWEEP.replace("[0.5, 0.9, 1.2]", "[0.5]").replace("0.4]", "0.2]")
    (folder / "sweep.yaml").write_text(text)
    points = checked_points(read_sweep(folder / "sweep.yaml"), settings(folder))
    return [run.directory.name for _, runs in points for run in runs]


def source_run(folder, x, wall_clock):
    """Write the checkpoint of a run that `start_from` reads, with a particle at `x`."""
    particles = {"id": np.arange(1), "position": np.array([[x, 0.0, 0.0]])}
    engine = {"particles": particles, "accounting": {"group": np.zeros(1)}, "clock": {"time_step": 1e-6}}
    folder.mkdir(exist_ok=True)
    write_checkpoint(folder, "title: Source\n", 1.0, 7, {"engine": engine, "wall_clock": wall_clock})


def test_directory_of_a_run_changes_with_the_contents_of_its_inputs_and_the_version(tmp_path, monkeypatch):
    """Tables of motion, the run in start_from and the version; not with a repetition of that run."""
    motion = "[{kind: table, file: lid.csv, direction: [0, 0, 1]}]"
    lid = f"{{shape: plane, point: [0, 0, -1], normal: [0, 0, 1], material: steel, motion: {motion}}}"
    scene = SCENE.replace("domain:", f"walls: {{lid: {lid}}}\nstart_from: source\ndomain:")
    (tmp_path / "spheres.yaml").write_text(scene)
    (tmp_path / "lid.csv").write_text("time,displacement\n0,0\n1,0.01\n")
    source_run(tmp_path / "source", 0.0, 12.0)
    found = [names_of_runs(tmp_path)]
    source_run(tmp_path / "source", 0.0, 34.0)
    assert names_of_runs(tmp_path) == found[0]
    source_run(tmp_path / "source", 1e-9, 34.0)
    found.append(names_of_runs(tmp_path))
    (tmp_path / "lid.csv").write_text("time,displacement\n0,0\n1,0.02\n")
    found.append(names_of_runs(tmp_path))
    monkeypatch.setattr("granflow.load.engine_digest", lambda: "another engine")
    found.append(names_of_runs(tmp_path))
    assert len({name for names in found for name in names}) == 2 * len(found) == 8


def sweep_of(**parts):
    return SweepInput.model_validate({"scene": "a.yaml", "read": ["kinetic_energy"], **parts})


def test_grid_contains_all_combinations_in_si_units_and_the_scene_gets_the_given_ones():
    vary = {"a.b": ["9 mm", "1 cm"], "c": {"from": 1, "to": 100, "count": 3, "scale": "log"}}
    points = design_points(sweep_of(vary=vary, set={"d": "2 ms"}))
    assert [tuple(point.values.values()) for point in points] == [
        (length, number) for length in (0.009, 0.01) for number in (1.0, pytest.approx(10.0), 100.0)
    ]  # fmt: skip
    assert points[3].settings == {"d": "2 ms", "a.b": "1 cm", "c": 1.0}
    ranged = design_points(sweep_of(vary={"wall.angle": {"from": 0, "to": "30 deg", "count": 4}}))
    assert [point.values["wall.angle"] for point in ranged] == pytest.approx(np.radians([0, 10, 20, 30]))
    assert ranged[3].settings["wall.angle"] == "0.5235987755982988 rad"


def test_formulas_give_keys_of_the_scene_in_si_units():
    """omega = sqrt(Fr g / R): 4.95 rad/s for 0.1 and 40 mm."""
    vary = {"froude": [0.1, -1.0], "radius": {"values": ["40 mm"], "keys": ["walls.shell.radius"]}}
    derive = {"omega": "sqrt(froude * 9.81 / radius)", "side": "-2 * max(radius, 0.01) ** 2 + pi / 4"}
    first, second = design_points(sweep_of(vary=vary, derive=derive))
    assert first.values == {"froude": 0.1, "radius": 0.04}
    assert first.settings == {
        "omega": pytest.approx(np.sqrt(0.1 * 9.81 / 0.04), rel=1e-14), "walls.shell.radius": "40 mm",
        "side": pytest.approx(np.pi / 4 - 2 * 0.04**2, rel=1e-14),
    }  # fmt: skip
    assert np.isnan(second.settings["omega"])
    for formula in ("2 *", "__import__('os').getcwd()", "y + 1"):
        assert len(list(sweep_of(vary={"x": [1.0]}, derive={"key": formula}).faults())) == 1


def test_sobol_design_gives_the_indices_of_the_ishigami_function():
    """Ishigami & Homma (1990): f = sin x + a sin^2 y + b z^4 sin x on (-pi, pi)^3, with a = 7 and b = 0.1.

    V = a^2/8 + b pi^4/5 + b^2 pi^8/18 + 1/2; V1 = (1 + b pi^4/5)^2 / 2; V2 = a^2/8; V13 = b^2 pi^8 (1/18 -
    1/50).
    """
    sobol = pytest.importorskip("SALib.analyze.sobol")
    x, y, z = (np.pi * (2.0 * unit_samples(SobolSampling(kind="sobol", count=2048, seed=1), 3) - 1.0)).T
    problem = {"num_vars": 3, "names": ["x", "y", "z"]}
    a, b = 7.0, 0.1
    values = np.sin(x) + a * np.sin(y) ** 2 + b * z**4 * np.sin(x)
    found = sobol.analyze(problem, values, calc_second_order=False)
    first = (1 + b * np.pi**4 / 5) ** 2 / 2
    second = a**2 / 8
    both = b**2 * np.pi**8 * (1 / 18 - 1 / 50)
    variance = first + second + both
    assert found["S1"] == pytest.approx(np.array([first, second, 0.0]) / variance, abs=0.03)
    assert found["ST"] == pytest.approx(np.array([first + both, second, both]) / variance, abs=0.03)


class Instant:
    """An executor that answers each request from a list of outcomes by directory name; records the
    requests."""

    def __init__(self, answers):
        self.answers = {name: list(each) for name, each in answers.items()}
        self.names = []

    def submit(self, _, request):
        future = Future()
        self.names.append(request.directory.rpartition("/")[2])
        answer = self.answers[self.names[-1]].pop(0)
        future.set_exception(answer) if isinstance(answer, Exception) else future.set_result(answer)
        return future


def run(folder, name):
    directory = folder / name
    directory.mkdir(parents=True)
    return CheckedRun(
        run_process.RunRequest("scene.yaml", (), str(directory), 1, "cpu", str(folder / ".stop")), 1, 0.0
    )


def test_lost_runs_are_retried_twice_and_aborted_runs_never(tmp_path):
    lost = run_process.Outcome(run_process.CRASHED, "The process was ended by SIGKILL.", 1.0, is_lost=True)
    executor = Instant({
        "a": [lost, lost, run_process.Outcome(run_process.DONE)], "b": [lost] * 5, "c": [run_process.Outcome(run_process.ABORTED, "overlap")],
        "d": [RuntimeError("connection closed"), run_process.Outcome(run_process.MISSED)], "e": [run_process.Outcome(run_process.CRASHED, "a defect")],
    })  # fmt: skip
    runs = [run(tmp_path, name) for name in "abcde"]
    found = Driver(executor, lambda: 1, Event(), lambda *_: None, {}).run(runs)
    statuses = [found[each.request.directory].status for each in runs]
    assert statuses == [
        run_process.DONE,
        run_process.CRASHED,
        run_process.ABORTED,
        run_process.MISSED,
        run_process.CRASHED,
    ]
    assert [executor.names.count(name) for name in "abcde"] == [3, 3, 1, 2, 1]


def ended(folder, name, **result):
    """A run with a result."""
    made = run(folder, name)
    content = {"expect": [], "run": {"wall_clock": 1.0}} | result
    (made.directory / "result.json").write_text(json.dumps(content))
    return made


def table_of_one_point(runs, *quantities):
    """The table of one point, a = 3 mm, with these runs."""
    (point,) = design_points(sweep_of(vary={"a": ["3 mm"]}))
    outcomes = {each.request.directory: run_process.final_outcome(each.directory) for each in runs}
    return table_of(("a",), quantities, [(point, runs)], outcomes)


@pytest.mark.parametrize(("values", "errors", "expected"), [
    ([1.0, 2.0, 6.0], [], np.sqrt(7.0 / 3.0)), ([0.4], [0.1], 0.1), ([0.4, 0.4], [0.3, 0.4], 0.25),
    ([0.2, 0.6], [0.0, 0.1], 0.2), ([0.4], [], None)
])  # fmt: skip
def test_table_has_means_and_standard_errors(tmp_path, values, errors, expected):
    """One run: its own error. Several: sqrt(sum e^2) / n, or the scatter between seeds, s / sqrt(n), if it is
    larger. The sample variance of 1, 2 and 6 is 7."""
    runs = []
    for k, value in enumerate(values):
        metric = {"angle_of_repose": value} | ({"angle_of_repose_error": errors[k]} if errors else {})
        runs.append(ended(tmp_path, "abc"[k], metrics={"left": metric}))
    write_tables(tmp_path, table_of_one_point(runs, "angle_of_repose.left"))
    with open(tmp_path / "sweep.csv", newline="") as file:
        (row,) = csv.DictReader(file)
    assert (row["a"], row["status"], float(row["seconds"])) == ("0.003", "done", len(runs))
    assert float(row["angle_of_repose.left [rad]"]) == pytest.approx(np.mean(values), rel=1e-15)
    error = row.get("standard_error.angle_of_repose.left [rad]")
    assert error is None if expected is None else float(error) == pytest.approx(expected)


@pytest.mark.parametrize("system", ["slurm", "pbs", "lsf", "sge"])
def test_batch_profile_gives_a_job_script(system, tmp_path):
    dask_jobqueue = pytest.importorskip("dask_jobqueue")
    path = tmp_path / "profile.yaml"
    path.write_text(
        "{jobs: 4, cores: 8, memory: 16 GB, walltime: '02:00', queue: long, prologue: module load a}\n"
    )
    job = getattr(dask_jobqueue, SYSTEMS[system]).job_cls
    options = cluster_options(system, read_profile(path), 2)
    script = job(scheduler="tcp://10.0.0.1:8786", name="job", **options).job_script()
    assert "long" in script and "module load a" in script and "--nthreads 4" in script
