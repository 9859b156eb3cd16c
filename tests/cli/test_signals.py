"""SIGINT and SIGTERM end every phase of a run within one second: packing, compilation, time stepping."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from subprocess_runner import restore_interrupts

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
idle = pytest.mark.slow  # needs idle cores

ROOT = Path(__file__).resolve().parents[2]
LIMIT = 1.0
"""Seconds from the signal to the end of the process."""

SCENE = """\
title: Block of beads
gravity: [0, 0, -9.81]
materials: {glass: {young_modulus: 10 MPa, poisson_ratio: 0.23, density: 2500}}
pairs: {glass-glass: {restitution: 0.8, friction: 0.4, rolling_friction: 0.1}}
contact: {normal: zhou, tangential: mindlin, rolling: epsd}
walls: {floor: {shape: plane, point: [0, 0, 0], normal: [0, 0, 1], material: glass}}
particles:
  beads:
    {material: glass, count: COUNT, diameter: 4 mm,
    insert: {kind: lattice, region: {box: {min: [0, 0, 0], max: [0.4, 0.4, 0.4]}}}}
domain: {min: [-1, -1, -0.1], max: [1.5, 1.5, 1], on_exit: delete}
output: {interval: 10 ms}
run: {velocity_max: 5 m/s, duration: 1000 s}
"""


def started(home, count=2000, *arguments):
    (home / "block.yaml").write_text(SCENE.replace("COUNT", str(count)))
    command = [sys.executable, "-m", "granflow", "run", "block.yaml", "--out", "out", *arguments]
    environment = os.environ | {"GRANFLOW_CACHE": str(home / "cache")}
    return subprocess.Popen(
        command, cwd=home, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        preexec_fn=restore_interrupts
    )  # fmt: skip


def wait_until(is_ready, running):
    deadline = time.monotonic() + 120.0
    while not is_ready() and running.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    assert running.poll() is None, running.stderr.read()


def assert_ends(running, number):
    """Asserts that a process ends within LIMIT after a signal, with its exit code of a shell; its messages."""
    began = time.monotonic()
    running.send_signal(number)
    _, message = running.communicate(timeout=60)
    assert time.monotonic() - began < LIMIT
    assert running.returncode in (128 + number, -number)
    assert "Traceback" not in message
    return message


@idle
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("delay", [0.3, 0.8, 2.0])
def test_signal_during_compilation_ends_the_run(tmp_path, number, delay):
    """With an empty cache, compilation takes several seconds after the output directory appears."""
    running = started(tmp_path)
    wait_until((tmp_path / "out").exists, running)
    time.sleep(delay)
    assert_ends(running, number)


@idle
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_during_packing_ends_the_run(tmp_path, number):
    running = started(tmp_path, 900_000)
    time.sleep(2.0)
    assert_ends(running, number)


@idle
def test_signal_between_launches_writes_a_checkpoint(tmp_path):
    running = started(tmp_path)
    wait_until((tmp_path / "out" / "particles_0001.vtu").exists, running)
    assert "granflow resume out" in assert_ends(running, signal.SIGTERM)
    assert len(list((tmp_path / "out").glob("checkpoint_*.npz"))) == 1


LIBRARY = """\
import signal
try:
    signal.raise_signal(signal.NUMBER)
except BaseException as error:
    raise ImportError("the library cannot be loaded") from error
"""
"""A module that reports any exception of its import as an error of its own, as compiled ones do."""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_signal_during_an_import_ends_the_process(tmp_path, name):
    (tmp_path / "library.py").write_text(LIBRARY.replace("NUMBER", name))
    program = "from granflow.cli.process import stop_signals\nwith stop_signals():\n    import library"
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(tmp_path)])},
        preexec_fn=restore_interrupts,
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (-signal.Signals[name], "")
