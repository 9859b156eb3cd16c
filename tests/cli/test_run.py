"""`granflow run` from end to end: ten particles fall on a floor; each run is a separate process."""

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
from adversarial.beads import BEADS
from subprocess_runner import restore_interrupts

SCENE = (
    BEADS
    + """\
expect:
  - {quantity: particle_count, equals: 10, tolerance: 0}
"""
)
ON_EXIT_LINE = 14
FRAMES_TIMEOUT = 60.0
"""Longest wait [s] for the first frames of a run that is then interrupted."""


def granflow(directory, *arguments, environment=None):
    command = [sys.executable, "-m", "granflow", *arguments]
    return subprocess.run(
        command, cwd=directory, env=environment, capture_output=True, text=True, timeout=200
    )


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
def plain_run(home):
    """The run of the unchanged scene into out/beads."""
    return granflow(home, "run", "beads.yaml")


def test_run_succeeds_and_prints_a_summary(home, plain_run):
    assert plain_run.returncode == 0, plain_run.stderr
    assert plain_run.stdout.startswith("beads.yaml: no problems found.\n")
    for fragment in ("Ten beads fall", "step count", "forces", "compile", "wall clock", "particle count"):
        assert fragment in plain_run.stdout
    assert "particle_count is 10, as expected equal to 10." in plain_run.stdout
    assert str(Path("out", "beads", "particles.pvd")) in plain_run.stdout
    assert max(map(len, plain_run.stdout.splitlines())) <= 100


def test_stderr_contains_only_progress(plain_run):
    assert all(
        line.startswith("run: ") and "particle-steps/s" in line for line in plain_run.stderr.splitlines()
    )
    assert not any(word in plain_run.stdout + plain_run.stderr for word in ("Taichi", "Warning", "warning"))


def test_run_writes_all_files(home, plain_run):
    out = home / "out" / "beads"
    assert len(frames(out)) == len(frames(out, "walls")) == 6
    assert {path.name for path in out.iterdir() if path.suffix not in (".vtu", ".npz")} == {
        *(
            "particles.pvd",
            "walls.pvd",
            "timeseries.csv",
            "result.json",
            "scene_as_run.yaml",
            "run.log",
            "run.jsonl",
            ".lock",
        )
    }
    assert len(list(out.glob("checkpoint_*.npz"))) == 1
    assert json.loads((out / "result.json").read_text())["totals"]["particle_count"] == 10
    assert 0.0015 < last_heights(out).min() < 0.003, "the particles rest on the floor or bounce slightly"


def test_log_contains_the_plan_and_the_stages(home, plain_run):
    log = (home / "out" / "beads" / "run.log").read_text()
    for fragment in (
        "taichi",
        "cpu with f64",
        "stability limit",
        "numerics.chunk_size",
        "stage run begins at 0 s",
        "done at",
    ):
        assert fragment in log


def test_scene_as_run_reproduces_the_result(home, plain_run):
    second_run = granflow(home, "run", "out/beads/scene_as_run.yaml", "--out", "again")
    assert second_run.returncode == 0, second_run.stderr
    first, second = (json.loads((home / name / "result.json").read_text()) for name in ("out/beads", "again"))
    assert first["totals"] == second["totals"]


def test_earlier_run_is_kept_without_overwrite_and_until_ends_the_run(home, plain_run):
    copy = shutil.copytree(home / "out" / "beads", home / "kept")
    (copy / "notes.txt").write_text("other")
    assert granflow(home, "run", "beads.yaml", "--out", "kept", "--until", "20 ms").returncode == 2
    assert len(frames(copy)) == 6
    overwritten = granflow(home, "run", "beads.yaml", "--out", "kept", "--until", "20 ms", "--overwrite")
    assert overwritten.returncode == 0, overwritten.stderr
    assert "Expectations are not evaluated: --until ended the run at 0.02" in overwritten.stdout
    assert "as expected" not in overwritten.stdout
    assert len(frames(copy)) == 3
    assert (copy / "notes.txt").exists()


def test_unsatisfied_expectation_and_warning_are_reported(home):
    unsatisfied = granflow(
        *(
            home,
            "run",
            "beads.yaml",
            "--out",
            "unmet",
            "--set",
            "run.duration=10 ms",
            "--set",
            "run.time_step=5e-5",
        ),
        *("--set", "expect.0.equals=11"),
    )
    assert unsatisfied.returncode == 1, unsatisfied.stderr
    assert "NOT AS EXPECTED: particle_count is 10, but should be equal to 11." in unsatisfied.stdout
    warning = "glass-glass: the restitution at 0.886 m/s is 0.8, but"
    assert unsatisfied.stderr.count(f"granflow: warning: {warning}") == 1


def test_every_warning_on_the_screen_is_in_log_result_and_report(home):
    """A coarse time step, an impact above the overlap limit, and particles that are due after the end.

    The highest drop is that of the rain, 2 cm: sqrt(2 g h) = 0.626 m/s. Restitutions are those at 0.886 m/s.
    """
    rain = "{kind: rain, rate: 10, start: 1 s, region: {box: {min: [0, 0, 1 cm], max: [2 cm, 2 cm, 2 cm]}}}"
    late = f"{{material: glass, count: 5, diameter: 4 mm, insert: {rain}}}"
    changes = (
        "run.duration=2 ms",
        "run.time_step=5e-5",
        "numerics.max_overlap=0.05",
        f"particles.late={late}",
        "expect=[]",
    )
    arguments = [argument for change in changes for argument in ("--set", change)]
    done = granflow(home, "run", "beads.yaml", "--out", "warned", *arguments)
    assert done.returncode == 0, done.stderr
    printed = [line.partition("warning: ")[2] for line in done.stderr.splitlines() if "warning: " in line]
    for words in ("an impact at 0.626 m/s", "no particle is inserted", "the restitution at 0.886 m/s"):
        assert sum(words in line for line in printed) == 1, done.stderr
    log = (home / "warned" / "run.log").read_text(encoding="utf-8")
    stored = json.loads((home / "warned" / "result.json").read_text(encoding="utf-8"))["warnings"]
    assert set(stored) == set(printed) and len(printed) == len(set(printed))
    assert all(f"WARNING granflow: {line}" in log for line in printed)


def test_aborted_run_writes_its_last_state(home):
    aborted = granflow(home, "run", "beads.yaml", "--out", "aborted", "--set", "numerics.max_overlap=1e-4")
    assert aborted.returncode == 3, aborted.stderr
    message = aborted.stderr.splitlines()[-1]
    assert (
        message.startswith("granflow: Stopped: particle ")
        and "times the smaller radius, more than numerics.max_overlap 0.0001" in message
    )
    assert "Traceback" not in aborted.stderr
    out = home / "aborted"
    assert not (out / "result.json").exists()
    abort_time = float(message.split(" at ")[1].split()[0])
    frame_times = re.findall(r'timestep="([^"]+)"', (out / "particles.pvd").read_text())
    assert float(frame_times[-1]) == pytest.approx(abort_time, rel=5e-4), "the message rounds to four digits"
    assert last_heights(out).min() < 0.002, "the frame shows the overlap"
    assert "ended by RunError: Stopped: particle" in (out / "run.log").read_text()


def test_particle_outside_the_domain_aborts_with_the_line_of_on_exit(home):
    outside = granflow(
        home, "run", "beads.yaml", "--out", "left", "--set", "walls={}", "--set", "run.duration=1 s"
    )
    assert outside.returncode == 3, outside.stderr
    assert "is outside the domain" in outside.stderr and f"(beads.yaml:{ON_EXIT_LINE})" in outside.stderr
    assert frames(home / "left")


@pytest.mark.parametrize("verb", ["run", "check", "explain"])
def test_unstable_time_step_is_rejected(home, verb):
    rejected = granflow(
        home, verb, "beads.yaml", "--set", "run.time_step=1 ms", *["--out", "no"] * (verb == "run")
    )
    assert rejected.returncode == 2
    problem, count = rejected.stderr.splitlines()
    assert problem.startswith(
        "--set run.time_step=1 ms: run.time_step is 0.001 s, above the stability limit 5e-05 s ("
    )
    assert problem.endswith(" s or remove it.") and count == "1 problem found."
    assert not (home / "no").exists()


def test_run_succeeds_with_closed_pipe_without_home_and_with_newlines_in_paths(home, plain_run):
    """stdout and stderr are a pipe that is closed at once, as by `2>&1 | true`; HOME is not a directory."""
    (home / "be\nads.yaml").write_text(SCENE)
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "granflow", "run", "be\nads.yaml", "--out", "o\nut"]
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith(("XDG_", "GRANFLOW_"))
    }
    try:
        code = subprocess.call(
            command,
            cwd=home,
            stdout=writing,
            stderr=writing,
            env=environment | {"HOME": "/dev/null"},
            timeout=200,
        )
    finally:
        os.close(writing)
    assert code == 0
    first, second = (json.loads((home / name / "result.json").read_text()) for name in ("out/beads", "o\nut"))
    assert first["totals"] == second["totals"]
    assert frames(home / "o\nut") == frames(home / "out" / "beads")


def test_run_succeeds_without_home(home):
    environment = {name: value for name, value in os.environ.items() if name != "HOME"}
    finished = granflow(home, "run", "beads.yaml", "--out", "no_home", environment=environment)
    assert finished.returncode == 0, finished.stderr
    assert (home / "no_home" / "result.json").exists()


def test_check_reports_too_small_a_region(home):
    rejected = granflow(home, "check", "beads.yaml", "--set", "particles.beads.count=1000")
    assert rejected.returncode == 2
    assert "particles.beads.count is 1000, but only" in rejected.stderr


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize(("signal_number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signal_stops_the_run_with_complete_files(home, signal_number, code):
    out = home / signal_number.name
    command = [
        sys.executable,
        "-m",
        "granflow",
        "run",
        "beads.yaml",
        "--out",
        out.name,
        "--set",
        "run.duration=1000 s",
    ]
    running = subprocess.Popen(
        command, cwd=home, stderr=subprocess.PIPE, text=True, preexec_fn=restore_interrupts
    )
    deadline = time.monotonic() + FRAMES_TIMEOUT
    while len(frames(out)) < 3 and running.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    running.send_signal(signal_number)
    _, message = running.communicate(timeout=60)
    assert running.returncode == code
    assert (
        message.splitlines()[-1].endswith(f"{out.name} contains the run up to this time.")
        and "Traceback" not in message
    )
    assert not [path.name for path in out.iterdir() if path.name.endswith(".part")]
    listed = (out / "particles.pvd").read_text().count("particles_")
    assert listed in (len(frames(out)), len(frames(out)) - 1)
    assert len(last_heights(out)) == 10
    assert len((out / "timeseries.csv").read_text().splitlines()) >= 3
