"""The end of a run before its last stage: Ctrl-C, StopRun, requests, and what is refused afterwards."""

import errno
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from api.scenes import beads
from resume.runs import delete
from scene_builders import particle_group

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


def interrupt_at(time):
    """An observer that sends Ctrl-C once at a simulated time [s]."""
    pending = [time]

    def interrupt(snapshot):
        if pending and snapshot.time >= pending[0]:
            pending.clear()
            os.kill(os.getpid(), signal.SIGINT)

    return gf.on_interval(2e-4, interrupt, ("walls",))


@pytest.fixture(scope="module")
def expected(taichi_f64):
    """Particles at the end of an undisturbed run."""
    with gf.Simulation(scene()) as simulation:
        simulation.run()
        return simulation.snapshot().particles


def assert_continues(out, expected, observers):
    """Asserts that a run continues to the same bits as an undisturbed one."""
    with gf.Simulation(scene(), resume=out, out=out, observers=observers) as simulation:
        simulation.run()
        found = simulation.snapshot().particles
    for name in ("position", "velocity", "angular_velocity"):
        np.testing.assert_array_equal(found[name], expected[name])


def test_ctrl_c_writes_a_checkpoint_from_which_the_run_continues_with_the_same_bits(
    tmp_path, default_interrupt, expected
):
    with (
        pytest.raises(KeyboardInterrupt),
        gf.Simulation(scene(), out=tmp_path, observers=[interrupt_at(0.002)]) as simulation,
    ):
        simulation.run()
    assert 0.002 <= checkpoint_at(tmp_path).time < 0.0022
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert_continues(tmp_path, expected, [interrupt_at(1.0)])


def test_exit_of_the_program_in_an_observer_writes_a_checkpoint(tmp_path, expected):
    """The run continues from it with the bits of an undisturbed one; the observer gets the snapshot again."""
    seen = []

    def leave(snapshot):
        seen.append(snapshot.time)
        if snapshot.time >= 0.002 and len(seen) < 12:
            sys.exit(5)

    simulation = gf.Simulation(scene(), out=tmp_path, observers=[gf.on_interval(2e-4, leave)])
    with pytest.raises(SystemExit) as ended:
        simulation.run()
    assert ended.value.code == 5
    simulation.free()
    assert checkpoint_at(tmp_path).time == seen[-1] == pytest.approx(0.002, abs=1e-5)
    seen += [0.0] * 12
    assert_continues(tmp_path, expected, [gf.on_interval(2e-4, leave)])


def test_after_ctrl_c_a_run_without_files_continues_and_one_with_files_names_the_reason(
    taichi_f64, tmp_path, default_interrupt
):
    with gf.Simulation(scene(), observers=[interrupt_at(0.001)]) as simulation:
        with pytest.raises(KeyboardInterrupt):
            simulation.run()
        simulation.run()
        assert simulation.time == pytest.approx(0.004, abs=simulation.time_step)
    with gf.Simulation(scene(), out=tmp_path / "run", observers=[interrupt_at(0.001)]) as simulation:
        with pytest.raises(KeyboardInterrupt):
            simulation.run()
        with pytest.raises(
            gf.GranflowError, match=r"KeyboardInterrupt has ended the run in .*checkpoint, at 0.001"
        ):
            simulation.save()


def test_is_stopped_says_whether_an_observer_ended_the_last_call(taichi_f64):
    stops = [0.001]

    def stop(snapshot):
        if stops and snapshot.time > stops[0]:
            stops.clear()
            raise gf.StopRun

    with gf.Simulation(scene(), observers=[gf.on_interval(1e-4, stop, ("walls",))]) as simulation:
        simulation.step(3)
        assert not simulation.is_stopped
        simulation.run()
        assert simulation.is_stopped
        simulation.run(until=0.002)
        assert simulation.time == pytest.approx(0.002, abs=simulation.time_step)
        assert not simulation.is_stopped


def test_a_material_of_several_groups_does_not_choose_one(taichi_f64):
    groups = {name: particle_group([[x, 0.0, 0.01]]) for name, x in (("left", 0.0), ("right", 0.02))}
    with gf.Simulation(beads(groups=groups)) as simulation:
        with pytest.raises(gf.GranflowError, match="group is missing: left, right are of glass"):
            simulation.particles.add(position=[0.0, 0.0, 0.03], material="glass")
        simulation.particles.add(position=[0.0, 0.0, 0.03], material="glass", group="right")
        assert list(simulation.particles.group) == ["left", "right", "right"]


def test_missing_checkpoints_have_their_own_messages(tmp_path):
    with pytest.raises(
        gf.GranflowError, match="none: there is no such file or directory; give a checkpoint or the"
    ):
        checkpoint_at(tmp_path / "none")
    with pytest.raises(gf.GranflowError, match="contains no usable checkpoint: a run writes them at its end"):
        checkpoint_at(tmp_path)


def test_other_settings_are_refused_while_a_simulation_is_in_use(taichi_f64):
    with gf.Simulation(scene(), threads=2) as simulation:
        with pytest.raises(
            gf.GranflowError, match="f64 and 2 threads: end it by simulation.free.. before one"
        ):
            gf.start("cpu", "f64", 3)
        assert simulation.particles.position.shape == (2, 3)


def test_unknown_precision_and_architecture_are_refused_with_the_known_ones():
    with pytest.raises(gf.GranflowError, match="^precision is 'f16'; give one of f64, f32, mixed\\.$"):
        gf.Simulation(scene(), precision="f16")
    with pytest.raises(gf.GranflowError, match="^arch is 'tpu'; give one of cpu, cuda, vulkan, gpu\\.$"):
        gf.start("tpu")


def test_a_run_is_unfinished_until_its_end_and_replaced_only_on_request(taichi_f64, tmp_path):
    with gf.Simulation(scene(), out=tmp_path) as simulation:
        simulation.run(until=0.001)
    assert gf.read_run(tmp_path).status == "unfinished"
    with gf.Simulation(scene(), out=tmp_path, resume=tmp_path) as simulation:
        simulation.run()
    assert gf.read_run(tmp_path).status == "complete"
    before = (tmp_path / "timeseries.csv").read_bytes()
    with pytest.raises(
        gf.GranflowError, match="contains an earlier run: give another directory, replace the run with"
    ):
        gf.Simulation(scene(), out=tmp_path)
    assert (tmp_path / "timeseries.csv").read_bytes() == before
    with gf.Simulation(scene(), out=tmp_path, overwrite=True) as simulation:
        simulation.run(until=0.001)
    assert gf.read_run(tmp_path).time < 0.0011


@pytest.mark.parametrize("loss", ["renamed", "deleted", "disk full"])
def test_a_failed_observer_is_named_although_no_checkpoint_can_be_written(
    taichi_f64, tmp_path, monkeypatch, loss
):
    out = tmp_path / "out"

    def full(*arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def fail(snapshot):
        if snapshot.time < 0.001:
            return
        if loss == "renamed":
            out.rename(tmp_path / "out_x")
        elif loss == "deleted":
            delete(out)
        else:
            monkeypatch.setattr(CheckpointWriter, "write", full)
        raise ValueError("user bug")

    simulation = gf.Simulation(scene(), out=out, observers=[gf.on_interval(2e-4, fail)])
    with pytest.raises(gf.FunctionError, match=r"fail failed at 0\.001\S* s: ValueError: user bug") as failed:
        simulation.run()
    simulation.free()
    assert isinstance(failed.value.__cause__, ValueError)
    reason = "No space left on device" if loss == "disk full" else "moved or deleted during the run"
    assert re.search(f"user bug. No checkpoint of this state can be written: .*{reason}", str(failed.value))
    if loss != "disk full":
        kept = tmp_path / ("out_x" if loss == "renamed" else "out")
        assert f"granflow resume {kept} continues from 0 s" in str(failed.value)
        assert checkpoint_at(kept).time == 0.0


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
        assert run.status == "unfinished"
        assert run.frames.times[-1] == pytest.approx(0.002, abs=1e-5)
