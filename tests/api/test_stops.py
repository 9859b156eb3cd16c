"""The end of a run before its last stage: Ctrl-C, exits of the program, and what is refused afterwards."""

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from api.scenes import beads

import granflow as gf
from granflow.io.checkpoint import checkpoint_at
from granflow.runs.run_directory import CheckpointWriter


@pytest.fixture
def default_interrupt():
    """SIGINT as in a terminal; in a background process it is ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def scene():
    """Two particles that bounce on a floor."""
    return beads(velocity=[[0.1, 0.0, -0.5], [0.0, 0.1, -0.5]])


def interrupt():
    os.kill(os.getpid(), signal.SIGINT)


def leave():
    sys.exit(5)


def once(function, time):
    """An observer that calls a function once at a simulated time [s]."""
    pending = [time]

    def observe(snapshot):
        if pending and snapshot.time >= pending[0]:
            pending.clear()
            function()

    return gf.on_interval(2e-4, observe, ("walls",))


@pytest.mark.parametrize(("end", "exception"), [(interrupt, KeyboardInterrupt), (leave, SystemExit)])
def test_an_ended_run_has_a_checkpoint_and_continues_with_the_same_bits(
    tmp_path, taichi_f64, default_interrupt, end, exception
):
    with gf.Simulation(scene(), out=tmp_path, observers=[once(end, 0.002)]) as simulation:
        with pytest.raises(exception):
            simulation.run()
        with pytest.raises(
            gf.GranflowError, match=rf"{exception.__name__} has ended the run in .*, at 0.002"
        ):
            simulation.save()
    assert 0.002 <= checkpoint_at(tmp_path).time < 0.0022
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    found = []
    for parts in ({"resume": tmp_path, "out": tmp_path, "observers": [once(end, 1.0)]}, {}):
        with gf.Simulation(scene(), **parts) as simulation:
            simulation.run()
            found.append(simulation.snapshot().particles)
    for name in ("position", "velocity", "angular_velocity"):
        np.testing.assert_array_equal(found[0][name], found[1][name])


def test_missing_checkpoints_and_other_settings_are_refused(tmp_path, taichi_f64):
    with pytest.raises(gf.GranflowError, match="none: there is no such file or directory; give a checkpoint"):
        checkpoint_at(tmp_path / "none")
    with pytest.raises(gf.GranflowError, match="contains no usable checkpoint: a run writes them at its end"):
        checkpoint_at(tmp_path)
    with gf.Simulation(scene(), threads=2) as simulation:
        with pytest.raises(gf.GranflowError, match="f64 and 2 threads: end it by simulation.free.. before"):
            gf.start("cpu", "f64", 3)
        assert simulation.particles.position.shape == (2, 3)


def test_a_run_is_unfinished_until_its_end_and_replaced_only_on_request(taichi_f64, tmp_path):
    with gf.Simulation(scene(), out=tmp_path) as simulation:
        simulation.run(until=0.001)
    assert gf.read_run(tmp_path).status == "unfinished"
    with gf.Simulation(scene(), out=tmp_path, resume=tmp_path) as simulation:
        simulation.run()
    assert gf.read_run(tmp_path).status == "complete"
    before = (tmp_path / "timeseries.csv").read_bytes()
    with pytest.raises(gf.GranflowError, match="contains an earlier run: give another directory, replace"):
        gf.Simulation(scene(), out=tmp_path)
    assert (tmp_path / "timeseries.csv").read_bytes() == before
    with gf.Simulation(scene(), out=tmp_path, overwrite=True) as simulation:
        simulation.run(until=0.001)
    assert gf.read_run(tmp_path).time < 0.0011


@pytest.mark.parametrize("loss", ["replaced", "disk full"])
def test_a_failed_observer_is_named_although_no_checkpoint_can_be_written(
    taichi_f64, tmp_path, monkeypatch, loss
):
    out, moved = tmp_path / "out", tmp_path / "moved"

    def full(*arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def fail():
        if loss == "replaced":
            out.rename(moved)
            out.mkdir()
        else:
            monkeypatch.setattr(CheckpointWriter, "write", full)
        raise ValueError("user bug")

    simulation = gf.Simulation(scene(), out=out, observers=[once(fail, 0.001)])
    reason = "another directory has replaced" if loss == "replaced" else "No space left on device"
    message = (
        rf"observe failed at 0\.001\S* s: ValueError: user bug. No checkpoint .* can be written: .*{reason}"
    )
    with pytest.raises(gf.FunctionError, match=message) as failed:
        simulation.run()
    simulation.free()
    if loss == "replaced":
        assert f"granflow resume {moved} continues from 0 s" in str(failed.value)
        assert checkpoint_at(moved).time == 0.0 and not list(out.iterdir())


UNCLOSED = """
import sys
sys.path.insert(0, {tests!r})
from api.test_stops import scene
import granflow as gf

def main(out):
    simulation = gf.Simulation(scene(), threads=2, out=out)
    simulation.run(until=0.002)

main({out!r} + "/first")
main({out!r} + "/second")
raise ValueError("unrelated")
"""


def test_end_of_a_program_without_close_finishes_the_files(tmp_path):
    """Also those of simulations that the program no longer refers to, and after an exception."""
    program = UNCLOSED.format(tests=str(Path(__file__).parents[1]), out=str(tmp_path))
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert done.returncode == 1 and done.stderr.count("Traceback") == 1 and "unrelated" in done.stderr
    for name in ("first", "second"):
        assert checkpoint_at(tmp_path / name).time == pytest.approx(0.002, abs=1e-5)
        run = gf.read_run(tmp_path / name)
        assert run.status == "unfinished" and run.frames.times[-1] == pytest.approx(0.002, abs=1e-5)
