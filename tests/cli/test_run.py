"""`granflow run` from end to end: ten beads fall on a floor, each time in a process of its own."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import meshio
import pytest

SCENE = """\
title: Ten beads fall
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
LEAVING_LINE = 14
UNTIL_FRAMES = 60.0
"""Seconds to wait at most for the first frames of a run that is to be interrupted."""


def granflow(directory, *arguments):
    command = [sys.executable, "-m", "granflow", *arguments]
    return subprocess.run(command, cwd=directory, capture_output=True, text=True, timeout=200)


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
def done(home):
    """The plain run, into out/beads."""
    return granflow(home, "run", "beads.yaml")


def test_a_run_ends_well_and_says_how(home, done):
    assert done.returncode == 0, done.stderr
    for words in ("Ten beads fall", "step count", "forces", "compile", "wall clock", "particle count"):
        assert words in done.stdout
    assert "particle_count is 10, as expected equal to 10." in done.stdout
    assert str(Path("out", "beads", "particles.pvd")) in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 100


def test_nothing_but_progress_goes_to_stderr(done):
    assert all(line.startswith("run: ") and "particle-steps/s" in line for line in done.stderr.splitlines())
    assert not any(word in done.stdout + done.stderr for word in ("Taichi", "Warning", "warning"))


def test_all_files_are_there(home, done):
    out = home / "out" / "beads"
    assert len(frames(out)) == len(frames(out, "walls")) == 6
    assert {path.name for path in out.iterdir() if path.suffix not in (".vtu", ".npz")} == {
        *("particles.pvd", "walls.pvd", "timeseries.csv", "result.json", "scene_as_run.yaml", "run.log", ".lock")
    }
    assert len(list(out.glob("checkpoint_*.npz"))) == 1
    assert json.loads((out / "result.json").read_text())["totals"]["particle_count"] == 10
    assert 0.0015 < last_heights(out).min() < 0.003, "the beads lie on the floor or bounce a little"


def test_the_log_tells_the_plan_and_the_stages(home, done):
    log = (home / "out" / "beads" / "run.log").read_text()
    for words in (
        "taichi",
        "cpu with f64",
        "stable below",
        "numerics.chunk_size",
        "stage run begins at 0 s",
        "done at",
    ):
        assert words in log


def test_the_scene_as_run_runs_the_same(home, done):
    again = granflow(home, "run", "out/beads/scene_as_run.yaml", "--out", "again")
    assert again.returncode == 0, again.stderr
    first, second = (json.loads((home / name / "result.json").read_text()) for name in ("out/beads", "again"))
    assert first["totals"] == second["totals"]


def test_an_earlier_run_is_kept_unless_forced_and_until_ends_early(home, done):
    kept = shutil.copytree(home / "out" / "beads", home / "kept")
    (kept / "notes.txt").write_text("mine")
    assert granflow(home, "run", "beads.yaml", "--out", "kept", "--until", "20 ms").returncode == 2
    assert len(frames(kept)) == 6
    forced = granflow(home, "run", "beads.yaml", "--out", "kept", "--until", "20 ms", "--overwrite")
    assert forced.returncode == 0, forced.stderr
    assert "Expectations are not evaluated: --until ended the run at 0.02" in forced.stdout
    assert "as expected" not in forced.stdout
    assert len(frames(kept)) == 3
    assert (kept / "notes.txt").exists()


def test_an_expectation_that_is_not_met_and_a_warning(home):
    unmet = granflow(
        *(home, "run", "beads.yaml", "--out", "unmet", "--set", "run.duration=10 ms", "--set", "run.time_step=5e-5"),
        *("--set", "expect.0.equals=11"),
    )
    assert unmet.returncode == 1, unmet.stderr
    assert "NOT AS EXPECTED: particle_count is 10, but should be equal to 11." in unmet.stdout
    assert unmet.stderr.count("granflow: warning: glass-glass: the restitution at 0.886 m/s is 0.8, but") == 1


def test_a_guard_stops_the_run_after_writing_the_state(home):
    stopped = granflow(home, "run", "beads.yaml", "--out", "guard", "--set", "numerics.max_overlap=1e-4")
    assert stopped.returncode == 3, stopped.stderr
    sentence = stopped.stderr.splitlines()[-1]
    assert (
        sentence.startswith("granflow: Stopped: particle ")
        and "overlaps by more than numerics.max_overlap 0.0001" in sentence
    )
    assert "Traceback" not in stopped.stderr
    out = home / "guard"
    assert not (out / "result.json").exists()
    moment = float(sentence.split(" at ")[1].split()[0])
    frame_times = re.findall(r'timestep="([^"]+)"', (out / "particles.pvd").read_text())
    assert float(frame_times[-1]) == pytest.approx(moment, rel=5e-4), "the sentence rounds to four digits"
    assert last_heights(out).min() < 0.002, "the frame shows the overlap"
    assert "ended by RunError: Stopped: particle" in (out / "run.log").read_text()


def test_a_particle_that_leaves_is_an_error_with_the_line_that_says_so(home):
    left = granflow(home, "run", "beads.yaml", "--out", "left", "--set", "walls={}", "--set", "run.duration=1 s")
    assert left.returncode == 3, left.stderr
    assert "is outside the domain" in left.stderr and f"(beads.yaml:{LEAVING_LINE})" in left.stderr
    assert frames(home / "left")


@pytest.mark.parametrize("verb", ["run", "check", "explain"])
def test_a_step_that_is_not_stable_is_refused(home, verb):
    refused = granflow(home, verb, "beads.yaml", "--set", "run.time_step=1 ms", *["--out", "no"] * (verb == "run"))
    assert refused.returncode == 2
    problem, count = refused.stderr.splitlines()
    assert problem.startswith("--set run.time_step=1 ms: run.time_step is 0.001 s, above the stable 5e-05 s (")
    assert problem.endswith(" s or leave it out.") and count == "1 problem found."
    assert not (home / "no").exists()


def test_a_run_needs_neither_a_reader_nor_a_home_and_its_paths_may_hold_newlines(home, done):
    """stdout and stderr go to a pipe that is closed at once, as by `2>&1 | true`; HOME is no directory."""
    (home / "be\nads.yaml").write_text(SCENE)
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "granflow", "run", "be\nads.yaml", "--out", "o\nut"]
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("XDG_", "GRANFLOW_"))}
    try:
        code = subprocess.call(
            command, cwd=home, stdout=writing, stderr=writing, env=environment | {"HOME": "/dev/null"}, timeout=200
        )
    finally:
        os.close(writing)
    assert code == 0
    first, second = (json.loads((home / name / "result.json").read_text()) for name in ("out/beads", "o\nut"))
    assert first["totals"] == second["totals"]
    assert frames(home / "o\nut") == frames(home / "out" / "beads")


def test_check_finds_that_there_is_too_little_room(home):
    refused = granflow(home, "check", "beads.yaml", "--set", "particles.beads.count=1000")
    assert refused.returncode == 2
    assert "particles.beads.count is 1000, but only" in refused.stderr


def hear_interrupts():
    """A shell lets what it starts in the background ignore SIGINT; the run shall not inherit that from the tests."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize(("sent", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_run_that_is_told_to_stop_leaves_whole_files(home, sent, code):
    out = home / sent.name
    command = [sys.executable, "-m", "granflow", "run", "beads.yaml", "--out", out.name, "--set", "run.duration=1000 s"]
    running = subprocess.Popen(command, cwd=home, stderr=subprocess.PIPE, text=True, preexec_fn=hear_interrupts)
    give_up = time.monotonic() + UNTIL_FRAMES
    while len(frames(out)) < 3 and running.poll() is None and time.monotonic() < give_up:
        time.sleep(0.05)
    running.send_signal(sent)
    _, message = running.communicate(timeout=60)
    assert running.returncode == code
    assert (
        message.splitlines()[-1].endswith(f"{out.name} contains the run up to this time.")
        and "Traceback" not in message
    )
    assert not [path.name for path in out.iterdir() if path.name.endswith(".part")]
    named = (out / "particles.pvd").read_text().count("particles_")
    assert named in (len(frames(out)), len(frames(out)) - 1)
    assert len(last_heights(out)) == 10
    assert len((out / "timeseries.csv").read_text().splitlines()) >= 3
