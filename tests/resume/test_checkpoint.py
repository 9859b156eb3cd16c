"""Checkpoint files: complete or rejected, and written when they are due."""

from pathlib import Path

import numpy as np
import pytest
from resume.runs import balls

import granflow as gf
from granflow.cli.main import main
from granflow.io import checkpoint as format_of
from granflow.io.checkpoint import CheckpointError, engine_digest, read_checkpoint, write_checkpoint
from granflow.runs.run_directory import CheckpointWriter
from granflow.scene.blocks.output import Checkpoints

STATE = {
    "step": 7, "look": float("inf"), "fraction": 0.1 + 0.2,
    "engine": {"position": np.random.default_rng(1).normal(size=(50, 3)), "nothing": np.zeros((0, 3), np.float32)},
}  # fmt: skip


def test_checkpoint_is_read_exactly_and_each_flipped_bit_or_truncation_is_detected(tmp_path):
    """One flipped bit in arrays, header, archive directory or checksum."""
    path = write_checkpoint(tmp_path, "title: A scene\n", 0.5, 7, STATE)
    found = read_checkpoint(path)
    assert (found.scene, found.time) == ("title: A scene\n", 0.5)
    assert [found.saved[name] for name in ("step", "look", "fraction")] == [7, float("inf"), 0.1 + 0.2]
    for name, values in STATE["engine"].items():
        assert found.saved["engine"][name].dtype == values.dtype
        np.testing.assert_array_equal(found.saved["engine"][name], values)
    assert list(tmp_path.iterdir()) == [path]
    whole = path.read_bytes()
    flips = np.random.default_rng(2).integers(0, len(whole), 50)
    damaged = [whole[:k] + bytes([whole[k] ^ 0x10]) + whole[k + 1 :] for k in flips]
    for content in [*damaged, *(whole[:size] for size in (0, 64, 1000, -1))]:
        path.write_bytes(content)
        with pytest.raises(CheckpointError, match="damaged"):
            read_checkpoint(path)


def test_checkpoints_are_due_by_wall_clock_and_simulated_time_and_the_newest_are_kept(tmp_path, monkeypatch):
    """Every 10 s of the monotonic clock, and every 0.5 s of simulated time; steps 9, 10 and 1000."""
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    monkeypatch.setattr("time.time", lambda: pytest.fail("the system time must not be used"))
    writer = CheckpointWriter(
        tmp_path, Checkpoints(wall_clock=10.0, interval=0.5, keep=2), "title: A scene\n"
    )
    writer.start(0.0)
    assert not writer.due(0.4) and writer.next_time() == 0.5 and writer.due(0.5)
    writer.write(0.5, 9, lambda _: STATE)
    assert not writer.due(0.6)
    now[0] += 10.0
    assert writer.due(0.6)
    writer.write(0.6, 10, lambda _: STATE)
    assert not writer.due(0.9) and writer.next_time() == 1.0
    writer.write(1.0, 1000, lambda _: STATE)
    assert writer.last_time == 1.0
    assert sorted(path.name[-8:] for path in tmp_path.iterdir()) == ["0010.npz", "1000.npz"]


def test_checkpoint_of_another_engine_is_named(taichi_f64, tmp_path, monkeypatch, capsys):
    """The run continues only on request, with a warning. A source that was renamed would leave the digest."""
    package = Path(format_of.__file__).parents[1]
    assert all((package / name).exists() for name in format_of.ENGINE_SOURCES)
    scene = balls(run={"duration": 2e-4, "velocity_max": 1.0})
    with monkeypatch.context() as other, gf.Simulation(scene, threads=2, out=tmp_path) as simulation:
        other.setattr(format_of, "engine_digest", lambda: "0123456789ab")
        simulation.run(until=1e-4)
        simulation.save()
    named = f"with the engine 0123456789ab, and this is granflow {gf.__version__} with the engine {engine_digest()}"
    assert main(["resume", str(tmp_path)]) == 2
    assert named in (message := capsys.readouterr().err) and "--allow-changes" in message
    assert main(["resume", str(tmp_path), "--allow-changes", "--threads", "2"]) == 0
    assert named in capsys.readouterr().err
    assert any(named in warning for warning in gf.read_run(tmp_path).result.warnings)
