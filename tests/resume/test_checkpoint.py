"""Checkpoint files: complete or rejected, fallback to the previous one, readable by numpy without pickle."""

from pathlib import Path

import numpy as np
import pytest
from resume.runs import balls

import granflow as gf
from granflow.cli.main import main
from granflow.io import checkpoint as format_of
from granflow.io.checkpoint import (
    CheckpointError,
    engine_digest,
    newest_checkpoint,
    read_checkpoint,
    remove_old_checkpoints,
    write_checkpoint,
)
from granflow.runs.run_directory import CheckpointWriter
from granflow.scene.blocks.output import Checkpoints

STATE = {
    "step": 7, "look": float("inf"), "fraction": 0.1 + 0.2,
    "engine": {"position": np.random.default_rng(1).normal(size=(50, 3)), "nothing": np.zeros((0, 3), np.float32)},
    "ids": np.arange(5, dtype=np.int32),
}  # fmt: skip


def written(directory, step=7):
    return write_checkpoint(directory, "title: A scene\n", 0.5, step, STATE)


def test_written_checkpoint_is_read_exactly(tmp_path):
    found = read_checkpoint(written(tmp_path))
    assert (found.scene, found.time) == ("title: A scene\n", 0.5)
    assert [found.saved[name] for name in ("step", "look", "fraction")] == [7, float("inf"), 0.1 + 0.2]
    for name in ("position", "nothing"):
        assert found.saved["engine"][name].dtype == STATE["engine"][name].dtype
        np.testing.assert_array_equal(found.saved["engine"][name], STATE["engine"][name])
    np.testing.assert_array_equal(found.saved["ids"], STATE["ids"])
    assert not [path.name for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_each_flipped_bit_and_truncation_is_detected(tmp_path):
    """One flipped bit in arrays, header, archive directory or checksum is detected."""
    path = written(tmp_path)
    whole = path.read_bytes()
    flips = np.random.default_rng(2).integers(0, len(whole), 50)
    damaged = [whole[:k] + bytes([whole[k] ^ 0x10]) + whole[k + 1 :] for k in flips]
    for content in [*damaged, *(whole[:size] for size in (0, 1, 64, 1000, -1))]:
        path.write_bytes(content)
        with pytest.raises(CheckpointError, match="damaged"):
            read_checkpoint(path)


def test_previous_checkpoint_replaces_a_damaged_one(tmp_path):
    written(tmp_path, 5)
    newest = written(tmp_path, 12)
    newest.write_bytes(newest.read_bytes()[:-20])
    found, skipped = newest_checkpoint(tmp_path)
    assert found.path.name == "checkpoint_000000000005.npz"
    assert skipped == [f"{newest} is damaged: it is truncated, or its bytes have changed."]


def test_only_the_newest_checkpoints_are_kept(tmp_path):
    for step in (9, 10, 100, 1000):
        written(tmp_path, step)
    remove_old_checkpoints(tmp_path, 2)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "checkpoint_000000000100.npz",
        "checkpoint_000000001000.npz",
    ]


def test_checkpoints_are_due_by_wall_clock_and_simulated_time(tmp_path, monkeypatch):
    """Every 10 s of the monotonic clock, and every 0.5 s of simulated time."""
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    monkeypatch.setattr("time.time", lambda: pytest.fail("the system time must not be used"))
    writer = CheckpointWriter(
        tmp_path, Checkpoints(wall_clock=10.0, interval=0.5, keep=2), "title: A scene\n"
    )
    writer.start(0.0)
    assert not writer.due(0.4) and writer.next_time() == 0.5 and writer.due(0.5)
    writer.write(0.5, 1, lambda _: STATE)
    assert not writer.due(0.6)
    now[0] += 10.0
    assert writer.due(0.6)
    writer.write(0.6, 2, lambda _: STATE)
    assert not writer.due(0.9) and writer.next_time() == 1.0
    assert (writer.last_time, len(list(tmp_path.iterdir()))) == (0.6, 2)


def test_sources_of_the_engine_exist():
    """A file or folder that was renamed would silently leave the digest."""
    package = Path(format_of.__file__).parents[1]
    assert [name for name in format_of.ENGINE_SOURCES if not (package / name).exists()] == []


def test_checkpoint_of_another_engine_is_named(taichi_f64, tmp_path, monkeypatch, capsys):
    """The run continues only on request, with a warning."""
    scene = balls(run={"duration": 2e-4, "velocity_max": 1.0})
    monkeypatch.setattr(format_of, "engine_digest", lambda: "0123456789ab")
    with gf.Simulation(scene, threads=2, out=tmp_path) as simulation:
        simulation.run(until=1e-4)
    monkeypatch.undo()
    named = (
        f"with the engine 0123456789ab, and this is granflow {gf.__version__} with the engine "
        f"{engine_digest()}"
    )
    assert main(["resume", str(tmp_path)]) == 2
    assert named in (message := capsys.readouterr().err) and "--allow-changes" in message
    assert main(["resume", str(tmp_path), "--allow-changes", "--threads", "2"]) == 0
    assert named in capsys.readouterr().err
    assert any(named in warning for warning in gf.read_run(tmp_path).result.warnings)
