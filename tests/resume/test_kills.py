"""One run of the command line that signals end, resumes with the bits of an undisturbed run."""

import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from resume.runs import files_of
from subprocess_runner import restore_interrupts

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")

FAULT_INJECTION = str(Path(__file__).with_name("fault_injection.py"))
LIMIT = 120.0
"""Longest duration [s] of a process."""

SCENE = """\
title: Beads rain on a shaken floor
gravity: [0, 0, -9.81]
materials: {glass: {young_modulus: 10 MPa, poisson_ratio: 0.23, density: 2500}}
pairs: {glass-glass: {restitution: 0.8, friction: 0.4}}
contact: {normal: zhou, tangential: mindlin, rolling: none}
walls:
  floor:
    {shape: plane, point: [0, 0, 0], normal: [0, 0, 1], material: glass, stages: [pour],
    motion: {kind: vibration, direction: [0, 0, 1], amplitude: 1 mm, frequency: 50 Hz}}
particles:
  beads:
    material: glass
    count: 40
    diameter: 4 mm
    insert: {kind: rain, rate: 2000 1/s, region: {box: {min: [0, 0, 1 cm], max: [2 cm, 2 cm, 3 cm]}}}
domain: {min: [-3 cm, -3 cm, -1 cm], max: [5 cm, 5 cm, 4 cm], on_exit: delete}
stages: [{name: pour, duration: 40 ms}, {name: fall, duration: 40 ms}]
output:
  interval: 4 ms
  timeseries_interval: 1 ms
  contacts: true
  energy_budget: true
  flow_meters: {low: {point: [0, 0, 0], normal: [0, 0, -1]}}
  checkpoint: {interval: 3 ms}
numerics: {max_overlap: 0.4}
run: {velocity_max: 1 m/s}
"""


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A directory with SCENE as beads.yaml."""
    directory = tmp_path_factory.mktemp("home")
    (directory / "beads.yaml").write_text(SCENE)
    return directory


def granflow(home, *arguments, fault=("count", "-"), **options):
    """Runs the command line to its end; `fault`: arguments of `fault_injection.py`."""
    command = [sys.executable, FAULT_INJECTION, *fault, *arguments]
    return subprocess.run(command, cwd=home, capture_output=True, text=True, timeout=2 * LIMIT, **options)


@pytest.fixture(scope="module")
def whole(home):
    """Directory of the undisturbed run, and its number of writes."""
    process = granflow(home, "run", "beads.yaml", "--out", "whole")
    assert process.returncode == 0, process.stderr
    return home / "whole", int(re.search(r"writes: (\d+)", process.stderr)[1])


def assert_complete(out, whole):
    """Asserts that a directory contains the files of the undisturbed run and no temporary files."""
    assert files_of(out) == files_of(whole)
    listed = {name for pvd in out.glob("*.pvd") for name in re.findall(r'file="([^"]+)"', pvd.read_text())}
    assert listed == {path.name for path in out.glob("*.vtu")}
    assert not [path.name for path in out.iterdir() if path.name.endswith(".part")]
    assert json.loads((out / "result.json").read_text())["totals"]["inserted_count"] == 40
    assert (out / "run.log").stat().st_size > 0


def signalled(home, out, frame, number, *arguments):
    """Exit code and last message of a process that receives a signal as soon as a frame of `out` exists."""
    path = out / f"particles_{frame:04d}.vtu"
    running = subprocess.Popen(
        [sys.executable, "-m", "granflow", *arguments], cwd=home, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, preexec_fn=restore_interrupts,
    )  # fmt: skip
    deadline = time.monotonic() + LIMIT
    while not path.exists() and running.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    assert running.poll() is None, "the run was over before the signal"
    running.send_signal(number)
    message = running.communicate(timeout=60)[1]
    assert "Traceback" not in message
    return running.returncode, message


@pytest.mark.parametrize(
    "stops",
    [
        pytest.param([(8, signal.SIGINT, 130)], id="int"),
        pytest.param(
            [(8, signal.SIGINT, 130), (13, signal.SIGTERM, 143)], id="int_term", marks=pytest.mark.slow
        ),
    ],
)
def test_run_ended_by_signals_resumes_bit_identically(home, whole, stops):
    """SIGKILL, SIGINT and SIGTERM at 16, 32 and 52 of 80 ms; after SIGINT and SIGTERM all files are complete.

    At last the system time jumps by hours, the output goes into a closed pipe, and HOME is not a directory.
    """
    name = f"out{len(stops)}"
    out = home / name
    killed, _ = signalled(home, out, 4, signal.SIGKILL, "run", "beads.yaml", "--out", name)
    assert killed == -signal.SIGKILL
    for frame, number, code in stops:
        found, message = signalled(home, out, frame, number, "resume", name)
        assert found == code
        continues = rf"stopped at .* s; granflow resume {name} continues. {name} contains the run up"
        assert re.search(continues, message)
        assert not [path.name for path in out.iterdir() if path.name.endswith(".part")]
        frames = len([*out.glob("particles_*.vtu")])
        assert (out / "particles.pvd").read_text().count("particles_") == frames > frame
        assert not (out / "result.json").exists()
    reading, closed_pipe = os.pipe()
    os.close(reading)
    command = [sys.executable, FAULT_INJECTION, "clock", "-", "resume", name]
    variables = os.environ | {"HOME": "/dev/null"}
    assert subprocess.call(command, cwd=home, stdout=closed_pipe, stderr=closed_pipe, env=variables) == 0
    os.close(closed_pipe)
    assert_complete(out, whole[0])


def resumed(home, out):
    """Resumes a run, with --from-start if it was killed between its first frame and its first checkpoint."""
    process = granflow(home, "resume", out.name)
    if process.returncode == 2 and f"granflow resume {out.name} --from-start" in process.stderr:
        process = granflow(home, "resume", out.name, "--from-start")
    assert process.returncode == 0, process.stderr
    assert "Traceback" not in process.stderr


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_run_killed_at_a_write_resumes_bit_identically(home, whole):
    """About 40 writes of a run, including each of the first 20; one killed and resumed run for each."""
    reference, writes = whole
    write_numbers = [*range(1, 21), *range(21, writes + 1, max((writes - 20) // 20, 1))]
    for number in write_numbers:
        out = home / f"write{number}"
        killed = granflow(home, "run", "beads.yaml", "--out", out.name, fault=("kill", str(number)))
        assert killed.returncode == -signal.SIGKILL
        if (out / "scene_as_run.yaml").exists():
            resumed(home, out)
        else:
            assert granflow(home, "resume", out.name).returncode == 2
            assert granflow(home, "run", "beads.yaml", "--out", out.name).returncode == 0
        assert_complete(out, reference)
        shutil.rmtree(out)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_run_killed_during_resume_resumes_bit_identically(home, whole):
    """Resume truncates files; a resume killed during truncation can be repeated."""
    reference, writes = whole
    out = home / "twice"
    for number in range(1, 13):
        shutil.rmtree(out, ignore_errors=True)
        granflow(home, "run", "beads.yaml", "--out", out.name, fault=("kill", str(2 * writes // 3)))
        killed = granflow(home, "resume", out.name, fault=("kill", str(number)))
        assert killed.returncode == -signal.SIGKILL
        resumed(home, out)
        assert_complete(out, reference)


@pytest.mark.slow
def test_run_that_exceeds_a_limit_of_file_sizes_resumes_bit_identically(home, whole):
    """The limit lies below the size of the last checkpoint, so that the run ends with an error of the disk."""
    limit = int(0.7 * max(path.stat().st_size for path in whole[0].glob("checkpoint_*.npz")))

    def limited():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    full = granflow(home, "run", "beads.yaml", "--out", "full", preexec_fn=limited)
    assert full.returncode == 4 and "File too large" in full.stderr and "Traceback" not in full.stderr
    resumed(home, home / "full")
    assert_complete(home / "full", whole[0])
