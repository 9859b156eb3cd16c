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
from resume.runs import balls, files_of
from subprocess_runner import restore_interrupts

from granflow.cli.main import main

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")

FAULT_INJECTION = str(Path(__file__).with_name("fault_injection.py"))


def rain():
    """Rain of 40 beads onto a gate that vanishes; all leave the domain at the end."""
    region = {"box": {"min": [0.0, 0.0, 0.01], "max": [0.02, 0.02, 0.03]}}
    beads = {
        "material": "glass", "count": 40, "diameter": 0.004,
        "insert": {"kind": "rain", "rate": 2000.0, "region": region},
    }  # fmt: skip
    output = {
        "interval": 4e-3, "timeseries_interval": 1e-3, "energy_budget": True, "wall_forces": True, "contacts": True,
        "checkpoint": {"interval": 3e-3}, "flow_meters": {"low": {"point": [0, 0, 0], "normal": [0, 0, -1]}},
    }  # fmt: skip
    return balls(
        groups={"beads": beads}, output=output, gate_until=0.04, run={"velocity_max": 1.0, "time_step": 1e-5},
        stages=[{"name": "pour", "duration": 0.04}, {"name": "fall", "duration": 0.04}],
        domain={"min": [-0.03, -0.03, -0.01], "max": [0.05, 0.05, 1.0], "on_exit": "delete"},
    )  # fmt: skip


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A directory with the scene as beads.yaml."""
    directory = tmp_path_factory.mktemp("home")
    rain().save(directory / "beads.yaml")
    return directory


def granflow(home, *arguments, fault=("count", "-"), **options):
    """Runs the command line to its end; `fault`: arguments of `fault_injection.py`."""
    command = [sys.executable, FAULT_INJECTION, *fault, *arguments]
    return subprocess.run(command, cwd=home, capture_output=True, text=True, timeout=240, **options)


@pytest.fixture(scope="module")
def whole(home, taichi_f64):
    """Directory of the undisturbed run."""
    out = home / "whole"
    assert main(["run", str(home / "beads.yaml"), "--out", str(out), "--threads", "2"]) == 0
    return out


@pytest.fixture(scope="module")
def writes(home):
    """Number of writes of the undisturbed run."""
    process = granflow(home, "run", "beads.yaml", "--out", "counted")
    return int(re.search(r"writes: (\d+)", process.stderr)[1])


def assert_complete(out, whole):
    """Asserts that a directory contains the files of the undisturbed run and no temporary files."""
    assert files_of(out) == files_of(whole)
    listed = {name for pvd in out.glob("*.pvd") for name in re.findall(r'file="([^"]+)"', pvd.read_text())}
    assert listed == {path.name for path in out.glob("*.vtu")}
    assert not list(out.glob("*.part")) + list(out.glob(".*.part"))
    assert json.loads((out / "result.json").read_text())["totals"]["inserted_count"] == 40
    assert (out / "run.log").stat().st_size > 0


def signalled(home, out, frame, number, *arguments):
    """Exit code and last message of a process that receives a signal as soon as a frame of `out` exists."""
    path = out / f"particles_{frame:04d}.vtu"
    running = subprocess.Popen(
        [sys.executable, "-m", "granflow", *arguments], cwd=home, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, preexec_fn=restore_interrupts,
    )  # fmt: skip
    deadline = time.monotonic() + 120.0
    while not path.exists() and running.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    assert running.poll() is None, "the run was over before the signal"
    running.send_signal(number)
    message = running.communicate(timeout=60)[1]
    assert "Traceback" not in message
    return running.returncode, message


def test_run_ended_by_signals_resumes_bit_identically(home, whole):
    """SIGTERM and SIGKILL at 16 and 32 of 80 ms; after SIGTERM all files are complete, also the kernels in the cache.

    At last the system time jumps by hours, the output goes into a closed pipe, and HOME is not a directory.
    """
    out = home / "out"
    ended, message = signalled(home, out, 4, signal.SIGTERM, "run", "beads.yaml", "--out", "out")
    assert ended == 143
    assert re.search(r"stopped at .* s; granflow resume out continues. out contains the run up", message)
    frames = len([*out.glob("particles_*.vtu")])
    assert (out / "particles.pvd").read_text().count("particles_") == frames > 4
    assert not (out / "result.json").exists() and not list(out.glob(".*.part"))
    killed, _ = signalled(home, out, 8, signal.SIGKILL, "resume", "out")
    assert killed == -signal.SIGKILL
    reading, closed_pipe = os.pipe()
    os.close(reading)
    command = [sys.executable, FAULT_INJECTION, "clock", "-", "resume", "out"]
    variables = os.environ | {"HOME": "/dev/null"}
    assert subprocess.call(command, cwd=home, stdout=closed_pipe, stderr=closed_pipe, env=variables) == 0
    os.close(closed_pipe)
    assert_complete(out, whole)


def resumed(home, out):
    """Resumes a run, with --from-start if it was killed between its first frame and its first checkpoint."""
    process = granflow(home, "resume", out.name)
    if process.returncode == 2 and f"granflow resume {out.name} --from-start" in process.stderr:
        process = granflow(home, "resume", out.name, "--from-start")
    assert process.returncode == 0, process.stderr
    assert "Traceback" not in process.stderr


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("verb", ["run", "resume"])
def test_process_killed_at_a_write_is_resumed_bit_identically(home, whole, writes, verb):
    """At each of the first 12 writes of a run and of its continuation, which truncates files, and at about 12 more
    of the run."""
    numbers = range(1, 13)
    if verb == "run":
        numbers = [*numbers, *range(13, writes + 1, writes // 12)]
    granflow(home, "run", "beads.yaml", "--out", "killed", fault=("kill", str(2 * writes // 3)))
    for number in numbers:
        out = home / f"{verb}{number}"
        arguments = ["run", "beads.yaml", "--out", out.name]
        if verb == "resume":
            shutil.copytree(home / "killed", out)
            arguments = ["resume", out.name]
        killed = granflow(home, *arguments, fault=("kill", str(number)))
        assert killed.returncode == -signal.SIGKILL
        if (out / "scene_as_run.yaml").exists():
            resumed(home, out)
        else:
            assert granflow(home, "resume", out.name).returncode == 2
            assert granflow(home, "run", "beads.yaml", "--out", out.name).returncode == 0
        assert_complete(out, whole)
    shutil.rmtree(home / "killed")


@pytest.mark.slow
def test_run_that_exceeds_a_limit_of_file_sizes_resumes_bit_identically(home, whole):
    """The limit lies below the size of the last checkpoint, so that the run ends with an error of the disk."""
    limit = int(0.7 * max(path.stat().st_size for path in whole.glob("checkpoint_*.npz")))

    def limited():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    full = granflow(home, "run", "beads.yaml", "--out", "full", preexec_fn=limited)
    assert full.returncode == 4 and "File too large" in full.stderr and "Traceback" not in full.stderr
    resumed(home, home / "full")
    assert_complete(home / "full", whole)
