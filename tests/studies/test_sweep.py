"""Sweeps without runs: messages, points, checks, and the driver with an executor that returns outcomes at
once."""

import csv
import json
import re
from concurrent.futures import Future
from threading import Event

import numpy as np
import pytest
from studies.sweep_files import SCENE, SWEEP, write_sweep

from granflow.cli.main import main
from granflow.errors import FileError, GranflowError
from granflow.io.checkpoint import write_checkpoint
from granflow.studies.checked_run import CheckedRun, RunSettings
from granflow.studies.run_pool import Driver, local_jobs
from granflow.studies.run_process import (
    ABORTED,
    CRASHED,
    DONE,
    MISSED,
    Outcome,
    RunRequest,
    final_outcome,
)
from granflow.studies.sweep import checked_points, read_sweep
from granflow.studies.sweep_design import (
    SobolSampling,
    SweepInput,
    design_points,
    unit_samples,
)
from granflow.studies.sweep_table import table_of, write_tables


def problems_of(folder, text):
    with pytest.raises(FileError) as caught:
        read_sweep(write_sweep(folder, text))
    return [problem.removeprefix(f"{folder}/") for problem in caught.value.problems]


def settings(folder):
    return RunSettings(folder / "runs", 1, "cpu", folder / ".stop")


def test_all_problems_are_reported_with_position_and_suggestion(tmp_path):
    text = "scene: spheres.yaml\nvray: {}\nrepeat: {seeds: 0}\nread: []\nsampling: {kind: sobl, count: 8}\n"
    assert problems_of(tmp_path, text) == [
        "sweep.yaml:2:1: vray is not a known key. Did you mean vary?",
        "sweep.yaml:3:17: repeat.seeds is 0, but a number of seeds must be in [1, 1000].",
        "sweep.yaml:4:7: read is [], but at least one item is required, such as [mass_flow.outlet].",
        "sweep.yaml:5:18: sampling.kind is sobl, but it must be one of grid, latin_hypercube, sobol. Did you "
        "mean sobol?",
    ]
    assert problems_of(tmp_path, "scene: spheres.yaml\nvary: {a: [1]}\n") == [
        "sweep.yaml:1:1: read is missing: numbers of the result to read, such as [mass_flow.outlet]."
    ]


@pytest.mark.parametrize(("text", "words"), [
    ("vary: {a: {from: 0.2, to: 0.1, count: 2}}", "vary.a.to is 0.1, but it must be larger than from, 0.2."),
    ("vary: {a: {from: 0.1, to: 0.2}}", "vary.a.count is missing"),
    ("vary: {a: 5}", "a list of values or a range is expected"),
    ("vary: {a: [1], b: {values: [2], keys: a}}", "vary.b sets a, which vary.a sets too"),
    ("vary: {a: {values: [1, 2], with: {b: [1]}}}", "it needs 2 values, one for each value of the parameter."),
    ("vary: {a: {from: 0, to: 1, count: 2, scale: log}}", "it must be above 0 on a logarithmic scale"),
    ("vary: {}", "vary is missing: at least one parameter"),
    ("vary: {a: {from: 30 deg, to: 10 deg, count: 2}}", "it must be larger than from, 30 deg."),
    ("vary: {a: {from: 10 deg, to: 30, count: 2}}", "30 has no unit; give all values in deg, or all in SI units."),
    ("vary: {a: {from: 10 mm, to: 1 s, count: 2}}", "mm and s are units of different dimensions."),
    ("vary: {a: [10 deg, 20]}", "vary.a is [10 deg, 20], but 20 has no unit"),
    ("vary: {a: {from: 0, to: 1, count: 1000000000}}", "vary gives 1000000000 runs, but a sweep has"),
    ("vary: {a: [1, 2]}\nrepeat: {seeds: 1000}\nsampling: {kind: sobol, count: 1024}",
     "count gives 3072000 runs"),
    ("vary: {a: {from: 0, to: 1}}\nsampling: {kind: latin_hypercube, count: 1000000000}",
     "sweep.yaml:3:35: sampling.count gives 1000000000 runs, but a sweep has at most 100000; give fewer values."),
])  # fmt: skip
def test_invalid_parameters_are_refused(tmp_path, text, words):
    problem = problems_of(tmp_path, f"scene: spheres.yaml\n{text}\nread: kinetic_energy\n")
    assert any(words in each and each.startswith("sweep.yaml:") for each in problem), problem


FRICTION = "pairs.steel-steel.friction: {from: 0.1, to: 0.4, count: 4}"


@pytest.mark.parametrize(("old", "new", "words"), [
    ("steel.friction", "steel.frction",
     "sweep.yaml:4:3: pairs.steel-steel.frction is not a known key. Did you mean friction?"),
    ("rotational_energy]", "kinetik_energy]", "sweep.yaml:5:24: kinetik_energy is not a number of a run"),
    (FRICTION, "pairs.steel-steel.friction: [10 mm, 20 mm]", "sweep.yaml:4:3: pairs.steel-steel.friction is"),
])  # fmt: skip
def test_problems_with_the_scene_are_reported_at_the_line_of_the_sweep(tmp_path, old, new, words):
    """Also a unit of another dimension, whose number 0.01 would be a valid friction."""
    sweep = read_sweep(write_sweep(tmp_path, SWEEP.replace(old, new)))
    with pytest.raises(FileError, match=re.escape(f"{tmp_path}/{words}")):
        checked_points(sweep, settings(tmp_path))


def names_of_runs(folder):
    """Names of the run directories of a sweep of two points."""
    text = SWEEP.replace("[0.5, 0.9, 1.2]", "[0.5]").replace("count: 4", "count: 2")
    (folder / "sweep.yaml").write_text(text)
    points = checked_points(read_sweep(folder / "sweep.yaml"), settings(folder))
    return [run.directory.name for _, runs in points for run in runs]


def source_run(folder, x, wall_clock):
    """Write the checkpoint of a run that `start_from` reads, with a particle at `x`."""
    particles = {"id": np.arange(1), "position": np.array([[x, 0.0, 0.0]])}
    engine = {"particles": particles, "accounting": {"group": np.zeros(1)}, "clock": {"time_step": 1e-6}}
    folder.mkdir(exist_ok=True)
    write_checkpoint(folder, "title: Source\n", 1.0, 7, {"engine": engine, "wall_clock": wall_clock})


MESH = (
    "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 -1\nvertex {x} 0 -1\nvertex 0 1 -1\nendloop\n"
    "endfacet\nendsolid a\n"
)


def test_directory_of_a_run_changes_with_the_contents_of_its_inputs_and_the_version(tmp_path, monkeypatch):
    """Meshes, tables of motion, the run in start_from and the version; not with a repetition of that run."""
    walls = (
        "walls:\n  lid: {shape: mesh, file: lid.stl, material: steel, motion: MOTION}\nstart_from: source\n"
    ).replace("MOTION", "[{kind: table, file: lid.csv, direction: [0, 0, 1]}]")
    (tmp_path / "spheres.yaml").write_text(SCENE.replace("domain:", walls + "domain:"))
    (tmp_path / "lid.stl").write_text(MESH.format(x=1))
    (tmp_path / "lid.csv").write_text("time,displacement\n0,0\n1,0.01\n")
    source_run(tmp_path / "source", 0.0, 12.0)
    found = [names_of_runs(tmp_path)]
    source_run(tmp_path / "source", 0.0, 34.0)
    assert names_of_runs(tmp_path) == found[0]
    edited = {
        tmp_path / "lid.stl": MESH.format(x=2),
        tmp_path / "lid.csv": "time,displacement\n0,0\n1,0.02\n",
    }
    source_run(tmp_path / "source", 1e-9, 34.0)
    found.append(names_of_runs(tmp_path))
    for path, text in edited.items():
        path.write_text(text)
        found.append(names_of_runs(tmp_path))
    monkeypatch.setattr("granflow.load.version_of", lambda _: "99.0")
    found.append(names_of_runs(tmp_path))
    monkeypatch.setattr("granflow.load.engine_digest", lambda: "another engine")
    found.append(names_of_runs(tmp_path))
    assert len({name for names in found for name in names}) == 2 * len(found) == 12


def sweep_of(**parts):
    return SweepInput.model_validate({"scene": "a.yaml", "read": ["kinetic_energy"], **parts})


def test_grid_contains_all_combinations_in_si_units_and_the_scene_gets_the_given_ones():
    vary = {"a.b": ["9 mm", "1 cm"], "c": {"from": 1, "to": 100, "count": 3, "scale": "log"}}
    points = design_points(sweep_of(vary=vary, set={"d": "2 ms"}))
    assert [tuple(point.values.values()) for point in points] == [
        (length, number) for length in (0.009, 0.01) for number in (1.0, pytest.approx(10.0), 100.0)
    ]  # fmt: skip
    assert points[3].settings == {"d": "2 ms", "a.b": "1 cm", "c": 1.0}
    listed = design_points(sweep_of(vary={"wall.angle": ["0 deg", "10 deg", "20 deg", "30 deg"]}))
    ranged = design_points(sweep_of(vary={"wall.angle": {"from": 0, "to": "30 deg", "count": 4}}))
    assert [point.values for point in ranged] == [point.values for point in listed]
    assert ranged[3].settings["wall.angle"] == "0.5235987755982988 rad"


def test_formulas_give_keys_of_the_scene_in_si_units():
    """omega = sqrt(Fr g / R): 4.95 rad/s for 0.1 and 40 mm."""
    vary = {"froude": [0.1, -1.0], "radius": {"values": ["40 mm"], "keys": ["walls.shell.radius"]}}
    derive = {"omega": "sqrt(froude * 9.81 / radius)", "side": "-2 * max(radius, 0.01) ** 2 + pi / 4"}
    first, second = design_points(sweep_of(vary=vary, derive=derive))
    assert first.values == {"froude": 0.1, "radius": 0.04}
    assert first.settings.keys() == {"omega", "side", "walls.shell.radius"}
    assert first.settings["omega"] == pytest.approx(np.sqrt(0.1 * 9.81 / 0.04), rel=1e-14)
    assert first.settings["side"] == pytest.approx(np.pi / 4 - 2 * 0.04**2, rel=1e-14)
    assert first.settings["walls.shell.radius"] == "40 mm" and np.isnan(second.settings["omega"])


@pytest.mark.parametrize(
    ("formula", "message"),
    [
        ("2 *", "is not a formula"),
        ("__import__('os').getcwd()", "but a formula consists of numbers"),
        ("x.real", "but a formula consists of numbers"),
        ("y + 1", "y is not a parameter of vary; these are x, law"),
        ("law + 1", "a formula needs numbers, and vary.law has other values"),
    ],
)
def test_other_words_than_those_of_a_formula_are_refused(formula, message):
    (fault,) = sweep_of(vary={"x": [1.0], "law": ["hertz"]}, derive={"key": formula}).faults()
    assert message in str(fault)


def test_sobol_design_gives_the_indices_of_the_ishigami_function():
    """Ishigami & Homma (1990): f = sin x + a sin^2 y + b z^4 sin x on (-pi, pi)^3, with a = 7 and b = 0.1.

    V = a^2/8 + b pi^4/5 + b^2 pi^8/18 + 1/2; V1 = (1 + b pi^4/5)^2 / 2; V2 = a^2/8; V13 = b^2 pi^8 (1/18 -
    1/50).
    """
    sobol = pytest.importorskip("SALib.analyze.sobol")
    x, y, z = (np.pi * (2.0 * unit_samples(SobolSampling(kind="sobol", count=2048, seed=1), 3) - 1.0)).T
    problem = {"num_vars": 3, "names": ["x", "y", "z"]}
    a, b = 7.0, 0.1
    found = sobol.analyze(
        problem, np.sin(x) + a * np.sin(y) ** 2 + b * z**4 * np.sin(x), calc_second_order=False
    )
    first = (1 + b * np.pi**4 / 5) ** 2 / 2
    second = a**2 / 8
    both = b**2 * np.pi**8 * (1 / 18 - 1 / 50)
    variance = first + second + both
    assert found["S1"] == pytest.approx([first / variance, second / variance, 0.0], abs=0.03)
    assert found["ST"] == pytest.approx(
        [(first + both) / variance, second / variance, both / variance], abs=0.03
    )


def test_more_runs_than_cores_are_refused():
    with pytest.raises(
        GranflowError, match=r"3 runs of 2 threads need 6 cores, but 4 cores are there: give at most"
    ):
        local_jobs(3, 2, 4)
    assert local_jobs(None, 2, 5) == 2


class Instant:
    """An executor that answers each request from a list of outcomes by directory name; records the
    requests."""

    def __init__(self, answers):
        self.answers = {name: list(each) for name, each in answers.items()}
        self.requests = []

    def submit(self, _, request):
        future = Future()
        self.requests.append(request)
        name = request.directory.rpartition("/")[2]
        answer = self.answers[name].pop(0) if name in self.answers else Outcome(DONE, "", 1.0)
        future.set_exception(answer) if isinstance(answer, Exception) else future.set_result(answer)
        return future


def run(folder, name):
    directory = folder / name
    directory.mkdir(exist_ok=True)
    return CheckedRun(RunRequest("scene.yaml", (), str(directory), 1, "cpu", str(folder / ".stop")), 1, 0.0)


def drive(executor, runs, slots=1):
    driver = Driver(executor, lambda: slots, Event(), lambda *_: None, {})
    outcomes = driver.run(runs)
    return {each.directory.name: outcomes[each.request.directory] for each in runs}


def names(executor):
    return [request.directory.rpartition("/")[2] for request in executor.requests]


def test_lost_runs_are_retried_twice_and_aborted_runs_never(tmp_path):
    lost = Outcome(CRASHED, "The process was ended by SIGKILL.", 1.0, is_lost=True)
    executor = Instant({
        "a": [lost, lost, Outcome(DONE)], "b": [lost] * 5, "c": [Outcome(ABORTED, "overlap")],
        "d": [RuntimeError("connection closed"), Outcome(MISSED)], "e": [Outcome(CRASHED, "a defect")],
    })  # fmt: skip
    found = drive(executor, [run(tmp_path, name) for name in "abcde"])
    assert {name: each.status for name, each in found.items()} == {
        "a": DONE, "b": CRASHED, "c": ABORTED, "d": MISSED, "e": CRASHED
    }  # fmt: skip
    assert found["b"].reason == "The process was ended by SIGKILL. Attempts: 3."
    assert [names(executor).count(name) for name in "abcde"] == [3, 3, 1, 2, 1]


def ended(folder, name, **result):
    """A run with a result."""
    made = run(folder, name)
    content = {"expect": [], "run": {"wall_clock": 1.0}} | result
    (made.directory / "result.json").write_text(json.dumps(content))
    return made


def table_of_one_point(runs, *quantities):
    """The table of one point, a = 3 mm, with these runs."""
    (point,) = design_points(sweep_of(vary={"a": ["3 mm"]}))
    outcomes = {each.request.directory: final_outcome(each.directory) for each in runs}
    return table_of(("a",), quantities, [(point, runs)], outcomes)


def test_table_states_why_a_quantity_is_nan(tmp_path):
    warning = "output.metrics.left: the angle of repose is NaN: the surface has 3 points."
    done = ended(tmp_path, "a", metrics={"left": {"angle_of_repose": None}},
                 warnings=[warning, "output.metrics.right: another one."])  # fmt: skip
    table = table_of_one_point([done], "angle_of_repose.left", "angle_of_repose.right")
    assert table.columns()["status"] == ["done"]
    assert table.columns()["reason"] == [
        f"runs/a: angle_of_repose.left is NaN. {warning} runs/a: angle_of_repose.right is missing."
    ]


def test_table_has_mean_and_standard_error_over_seeds(tmp_path):
    """Values 1, 2 and 6: mean 3, sample variance 7, standard error sqrt(7/3)."""
    values = {"a": 1.0, "b": 2.0, "c": 6.0}
    runs = [
        ended(tmp_path, name, flow_meters={"out": {"mass_flow": value}}) for name, value in values.items()
    ]
    write_tables(tmp_path, table_of_one_point(runs, "mass_flow.out"))
    with open(tmp_path / "sweep.csv", newline="") as file:
        (row,) = csv.DictReader(file)
    assert (row["a"], row["status"], row["seconds"], row["runs"]) == ("0.003", "done", "3.0", "a b c")
    assert float(row["mass_flow.out [kg/s]"]) == pytest.approx(3.0, rel=1e-15)
    assert float(row["standard_error.mass_flow.out [kg/s]"]) == pytest.approx(np.sqrt(7.0 / 3.0), rel=1e-15)
    assert len((tmp_path / "runs.csv").read_text().splitlines()) == 4


@pytest.mark.parametrize(("values", "errors", "expected"), [
    ([0.4], [0.1], 0.1), ([0.4, 0.4], [0.3, 0.4], 0.25), ([0.2, 0.6], [0.0, 0.1], 0.2), ([0.4], [], None)
])  # fmt: skip
def test_table_has_the_standard_errors_of_the_runs(tmp_path, values, errors, expected):
    """One run: its own error. Several: sqrt(sum e^2) / n, or the scatter between seeds if it is larger."""
    runs = []
    for k, value in enumerate(values):
        metric = {"angle_of_repose": value} | ({"angle_of_repose_error": errors[k]} if errors else {})
        runs.append(ended(tmp_path, "ab"[k], metrics={"left": metric}))
    found = table_of_one_point(runs, "angle_of_repose.left").columns()
    assert found.get("standard_error.angle_of_repose.left [rad]") == (
        None if expected is None else [pytest.approx(expected)]
    )


@pytest.mark.parametrize(("arguments", "words"), [
    (["sweep", "none.yaml"], "none.yaml: there is no such file"),
    (["sweep", "sweep.yaml", "--jobs", "0"], "give a whole number of at least 1"),
    (["sweep", "sweep.yaml", "--jobs", "5000"], "5 000 runs of 1 thread need 5 000 cores"),
    (["sweep", "sweep.yaml", "--threads", "4000"], "1 run of 4 000 threads needs 4 000 cores"),
    (["sweep", "sweep.yaml", "--scheduler-file", "none.json"], "none.json: there is no such file"),
    (["sweep", "sweep.yaml", "--part", "3/2"], "3/2 is not a part; give the number of the part and the number of"),
    (["sweep", "sweep.yaml", "--slurm", "sweep.yaml"], "cores is missing")
])  # fmt: skip
def test_invalid_requests_have_a_message_and_exit_code_2(tmp_path, monkeypatch, capsys, arguments, words):
    write_sweep(tmp_path)
    monkeypatch.chdir(tmp_path)
    try:
        code = main(arguments)
    except SystemExit as stop:
        code = stop.code
    assert code == 2 and words in capsys.readouterr().err


def test_batch_system_that_is_not_installed_is_refused(tmp_path, monkeypatch):
    pytest.importorskip("dask_jobqueue")
    from granflow.studies.run_pool import BatchProfile, batch_cluster

    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(
        GranflowError, match="--slurm requires the command sbatch, which this machine does not have"
    ):
        batch_cluster("slurm", tmp_path / "profile.yaml", BatchProfile(jobs=1, cores=1, memory="1 GB"), 1)


@pytest.mark.parametrize("system", ["slurm", "pbs", "lsf", "sge"])
def test_batch_profile_gives_a_job_script(system, tmp_path):
    dask_jobqueue = pytest.importorskip("dask_jobqueue")
    from granflow.studies.run_pool import SYSTEMS, cluster_options, read_profile

    path = tmp_path / "profile.yaml"
    path.write_text(
        "{jobs: 4, cores: 8, memory: 16 GB, walltime: '02:00', queue: long, prologue: module load python}\n"
    )
    kind = getattr(dask_jobqueue, SYSTEMS[system]).job_cls
    script = kind(
        scheduler="tcp://10.0.0.1:8786", name="job", **cluster_options(system, read_profile(path), 2)
    ).job_script()
    assert "long" in script and "module load python" in script
    assert script.rindex("--nthreads 4") > script.index("--nthreads 8")
