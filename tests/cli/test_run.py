"""`granflow run` from end to end: ten particles fall on a floor."""

import json
import os
import re
import shutil
import subprocess
import sys

import meshio
import pytest

from granflow.cli.main import main

pytestmark = pytest.mark.usefixtures("taichi_f64")
SCENE = """\
title: "Ten beads fall\\e[31m\\u202E"
gravity: [0, 0, -9.81]
materials: {glass: {young_modulus: 10 MPa, poisson_ratio: 0.23, density: 2500}}
pairs: {glass-glass: {restitution: 0.8, friction: 0.4}}
contact: {normal: zhou, tangential: mindlin, rolling: none}
walls:
  floor: {shape: plane, point: [0, 0, 0], normal: [0, 0, 1], material: glass}
particles:
  beads:
    material: glass
    count: 10
    diameter: 4 mm
    insert: {kind: lattice, region: {box: {min: [0, 0, 0], max: [2 cm, 2 cm, 1 cm]}}}
domain: {min: [-1 cm, -1 cm, -1 cm], max: [3 cm, 3 cm, 3 cm], on_exit: error}
run: {duration: 50 ms}
output: {interval: 10 ms}
expect:
  - {quantity: particle_count, equals: 10, tolerance: 0}
"""
ON_EXIT_LINE = 14
OUT = "out/b\neads 球"


def frames(directory, kind="particles"):
    return sorted(path.name for path in directory.glob(f"{kind}_*.vtu"))


def last_heights(directory):
    return meshio.read(directory / frames(directory)[-1]).points[:, 2]


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    directory = tmp_path_factory.mktemp("run")
    (directory / "beads.yaml").write_text(SCENE)
    return directory


@pytest.fixture(scope="module")
def plain(home):
    """A process that runs the scene in the C locale."""
    command = [sys.executable, "-m", "granflow", "run", "beads.yaml", "--out", OUT]
    environment = {name: value for name, value in os.environ.items() if name not in ("LANG", "PYTHONUTF8")}
    return subprocess.run(
        command, cwd=home, env=environment | {"LC_ALL": "C"}, capture_output=True, text=True, timeout=200
    )


@pytest.fixture
def run(home, monkeypatch, capsys):
    """Runs a verb in this process, in the directory of the scene; returns exit code, stdout and stderr."""
    monkeypatch.chdir(home)

    def call(*arguments, verb="run"):
        threads = ["--threads", "2"] if verb == "run" else []
        code = main([verb, "beads.yaml", *threads, *arguments])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


def changes(*overrides):
    """Arguments --set for each override."""
    return [argument for override in overrides for argument in ("--set", override)]


def test_a_process_prints_a_summary_and_only_progress_on_stderr(plain):
    """The title has control characters, which the terminal does not receive."""
    assert plain.returncode == 0, plain.stderr
    assert plain.stdout.startswith("beads.yaml: no problems found.\n")
    for fragment in ("Ten beads fall", "step count", "wall clock", "particle count"):
        assert fragment in plain.stdout
    assert "particle_count is 10, as expected equal to 10." in plain.stdout
    assert "particles.pvd" in plain.stdout and "\x1b" not in plain.stdout + plain.stderr
    assert max(map(len, plain.stdout.splitlines())) <= 100
    for line in plain.stderr.splitlines():
        assert line.startswith("run: ") and "particle-steps/s" in line
    assert re.search(r"warning count\W+0\b", plain.stdout) and plain.stdout.count("warning") == 1
    assert not any(word in plain.stdout + plain.stderr for word in ("Taichi", "Warning"))


def test_run_writes_all_files(home, plain):
    out = home / OUT
    assert len(frames(out)) == len(frames(out, "walls")) == 6
    names = {path.name for path in out.iterdir() if path.suffix not in (".vtu", ".npz")}
    files = "particles.pvd walls.pvd timeseries.csv result.json scene_as_run.yaml run.log run.jsonl .lock"
    assert names == set(files.split())
    assert len(list(out.glob("checkpoint_*.npz"))) == 1
    assert json.loads((out / "result.json").read_text())["totals"]["particle_count"] == 10
    assert 0.0015 < last_heights(out).min() < 0.003, "the particles rest on the floor or bounce slightly"
    log = (out / "run.log").read_text()
    for fragment in ("taichi", "cpu with f64", "stability limit", "stage run begins at 0 s", "done at"):
        assert fragment in log


def test_scene_as_run_reproduces_the_result(home, plain, run):
    shutil.copy(home / OUT / "scene_as_run.yaml", home / "again.yaml")
    assert main(["run", "again.yaml", "--out", "again", "--threads", "2"]) == 0
    first, second = (json.loads((home / name / "result.json").read_text()) for name in (OUT, "again"))
    assert first["totals"] == second["totals"]


def test_earlier_run_is_kept_without_overwrite_and_until_ends_the_run(home, plain, run):
    copy = shutil.copytree(home / OUT, home / "kept")
    (copy / "notes.txt").write_text("other")
    assert run("--out", "kept", "--until", "20 ms")[0] == 2
    assert len(frames(copy)) == 6
    code, out, _ = run("--out", "kept", "--until", "20 ms", "--overwrite")
    assert code == 0
    assert "Expectations are not evaluated: --until ended the run at 0.02" in out
    assert "as expected" not in out
    assert len(frames(copy)) == 3
    assert (copy / "notes.txt").exists()


def test_unsatisfied_expectations_and_all_warnings_are_reported(home, run):
    """A coarse time step, an impact above the overlap limit, and particles that are due after the end.

    The highest drop is that of the rain, 2 cm: sqrt(2 g h) = 0.626 m/s. Restitutions are those at 0.886 m/s.
    """
    rain = "{kind: rain, rate: 10, start: 1 s, region: {box: {min: [0, 0, 1 cm], max: [2 cm, 2 cm, 2 cm]}}}"
    late = f"{{material: glass, count: 5, diameter: 4 mm, insert: {rain}}}"
    overrides = (
        "run.duration=2 ms", "run.time_step=5e-5", "numerics.max_overlap=0.05", f"particles.late={late}",
        "expect.0.equals=11",
    )  # fmt: skip
    code, out, err = run("--out", "warned", *changes(*overrides))
    assert code == 1
    assert "NOT AS EXPECTED: particle_count is 10, but should be equal to 11." in out
    printed = [line.partition("warning: ")[2] for line in err.splitlines() if "warning: " in line]
    for words in ("an impact at 0.626 m/s", "no particle is inserted", "the restitution at 0.886 m/s"):
        assert sum(words in line for line in printed) == 1, err
    log = (home / "warned" / "run.log").read_text(encoding="utf-8")
    stored = json.loads((home / "warned" / "result.json").read_text(encoding="utf-8"))["warnings"]
    assert set(stored) == set(printed) and len(printed) == len(set(printed))
    assert all(f"WARNING granflow: {line}" in log for line in printed)


def test_aborted_run_writes_its_last_state(home, run):
    code, _, err = run("--out", "aborted", *changes("numerics.max_overlap=1e-4"))
    assert code == 3
    message = err.splitlines()[-1]
    assert message.startswith("granflow: Stopped: particle ")
    assert "times the smaller radius, more than numerics.max_overlap 0.0001" in message
    out = home / "aborted"
    assert not (out / "result.json").exists()
    abort_time = float(message.split(" at ")[1].split()[0])
    frame_times = re.findall(r'timestep="([^"]+)"', (out / "particles.pvd").read_text())
    assert float(frame_times[-1]) == pytest.approx(abort_time, rel=5e-4), "the message rounds to four digits"
    assert last_heights(out).min() < 0.002, "the frame shows the overlap"
    assert "ended by RunError: Stopped: particle" in (out / "run.log").read_text()


def test_particle_outside_the_domain_aborts_with_the_line_of_on_exit(home, run):
    code, _, err = run("--out", "left", *changes("walls.floor.point=[0, 0, -5 cm]", "run.duration=1 s"))
    assert code == 3
    assert "is outside the domain" in err and f"(beads.yaml:{ON_EXIT_LINE})" in err
    assert frames(home / "left")


@pytest.mark.parametrize("verb", ["run", "check", "explain"])
def test_invalid_scene_is_rejected_before_the_run(home, run, verb):
    code, _, err = run(*changes("run.time_step=1 ms"), *["--out", "no"] * (verb == "run"), verb=verb)
    assert code == 2
    problem, count = err.splitlines()
    assert problem.startswith("--set run.time_step=1 ms: run.time_step is 0.001 s, above the stability limit")
    assert problem.endswith(" s or remove it.") and count == "1 problem found."
    assert not (home / "no").exists()
    if verb == "check":
        code, _, err = run(*changes("particles.beads.count=1000"), verb=verb)
        assert code == 2 and "particles.beads.count is 1000, but only" in err
