"""The file of a checkpoint: whole or refused, the one before in its place; numpy reads it without pickle."""

import json
import os
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from scene_builders import build_scene, particle_group

from granflow.errors import GranflowError
from granflow.observe import (
    CheckpointError,
    CheckpointWriter,
    locked,
    newest_checkpoint,
    read_checkpoint,
    remove_old_checkpoints,
    write_checkpoint,
)
from granflow.observe import checkpoint as format_of
from granflow.observe.files import replacing
from granflow.scene.schema import Checkpoints

KEPT = {
    "step": 7, "look": float("inf"), "fraction": 0.1 + 0.2,
    "engine": {"position": np.random.default_rng(1).normal(size=(50, 3)), "nothing": np.zeros((0, 3), np.float32)},
    "ids": np.arange(5, dtype=np.int32),
}  # fmt: skip


def written(directory, step=7):
    return write_checkpoint(directory, "title: A scene\n", 0.5, step, KEPT)


def test_everything_comes_back_as_it_was(tmp_path):
    found = read_checkpoint(written(tmp_path))
    assert (found.scene, found.time) == ("title: A scene\n", 0.5)
    assert [found.saved[name] for name in ("step", "look", "fraction")] == [7, float("inf"), 0.1 + 0.2]
    for name in ("position", "nothing"):
        assert found.saved["engine"][name].dtype == KEPT["engine"][name].dtype
        np.testing.assert_array_equal(found.saved["engine"][name], KEPT["engine"][name])
    np.testing.assert_array_equal(found.saved["ids"], KEPT["ids"])
    assert not [path.name for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_numpy_alone_reads_it_without_pickle(tmp_path):
    with np.load(written(tmp_path), allow_pickle=False) as arrays:
        np.testing.assert_array_equal(arrays["engine/position"], KEPT["engine"]["position"])


def test_every_bit_counts(tmp_path):
    """A bit flipped anywhere, in the arrays, in the header, in the directory of the archive or in the checksum."""
    path = written(tmp_path)
    whole = path.read_bytes()
    for insertion in np.random.default_rng(2).integers(0, len(whole), 200):
        path.write_bytes(whole[:insertion] + bytes([whole[insertion] ^ 0x10]) + whole[insertion + 1 :])
        with pytest.raises(CheckpointError, match="damaged"):
            read_checkpoint(path)


@pytest.mark.parametrize("left", [0, 1, 63, 64, 65, 1000, -1])
def test_cut_short(tmp_path, left):
    path = written(tmp_path)
    path.write_bytes(path.read_bytes()[:left])
    with pytest.raises(CheckpointError, match="damaged"):
        read_checkpoint(path)


def test_the_one_before_is_used_and_said(tmp_path):
    written(tmp_path, 5)
    newest = written(tmp_path, 12)
    newest.write_bytes(newest.read_bytes()[:-20])
    found, skipped = newest_checkpoint(tmp_path)
    assert found.path.name == "checkpoint_000000000005.npz"
    assert skipped == [f"{newest} is damaged: it is truncated, or its bytes have changed."]


def test_another_format_is_refused_by_number(tmp_path, monkeypatch):
    monkeypatch.setattr(format_of, "FORMAT", 99)
    path = written(tmp_path)
    monkeypatch.undo()
    with pytest.raises(CheckpointError, match="is in format 99, written by granflow .* reads format 3"):
        read_checkpoint(path)


def test_objects_are_not_written(tmp_path):
    with pytest.raises(ValueError, match="pickle"):
        write_checkpoint(tmp_path, "", 0.0, 1, {"objects": np.array([{}, None])})
    assert not list(tmp_path.iterdir())


def test_the_last_few_are_kept(tmp_path):
    for step in (9, 10, 100, 1000):
        written(tmp_path, step)
    remove_old_checkpoints(tmp_path, 2)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "checkpoint_000000000100.npz",
        "checkpoint_000000001000.npz",
    ]


def test_a_file_is_on_the_disk_before_it_gets_its_name(tmp_path, monkeypatch):
    done, real = [], os.replace
    monkeypatch.setattr("os.fsync", lambda _: done.append("fsync"))
    monkeypatch.setattr("os.replace", lambda *names: (done.append("replace"), real(*names)))
    with replacing(tmp_path / "a", durable=True) as temporary:
        temporary.write_text("a")
    assert done == ["fsync", "replace", "fsync"], "the file, its name, the directory"


def test_a_directory_is_held_by_one_run_and_a_dead_one_lets_go(tmp_path):
    holder = "import sys, time; from pathlib import Path; from granflow.observe.lock import locked\n"
    holder += "with locked(Path(sys.argv[1])): print('held', flush=True); time.sleep(600)"
    process = subprocess.Popen([sys.executable, "-c", holder, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout.readline() == "held\n"
        with pytest.raises(GranflowError, match="Another run is writing into"), locked(tmp_path):
            pass
    finally:
        process.kill()
        process.communicate()
    with locked(tmp_path):
        pass


def test_when_one_is_due(tmp_path, monkeypatch):
    """Every 10 s of a clock that nobody sets, and every 0.5 s of simulated time."""
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    monkeypatch.setattr("time.time", lambda: pytest.fail("the computer's time is asked"))
    scene = build_scene({"ball": particle_group([0.0, 0.0, 0.0])})
    writer = CheckpointWriter(tmp_path, Checkpoints(wall_clock=10.0, interval=0.5, keep=2))
    writer.start(0.0)
    assert not writer.due(0.4) and writer.next_time() == 0.5 and writer.due(0.5)
    writer.write(scene, 0.5, 1, KEPT)
    assert not writer.due(0.6)
    now[0] += 10.0
    assert writer.due(0.6)
    writer.write(scene, 0.6, 2, KEPT)
    assert not writer.due(0.9) and writer.next_time() == 1.0
    assert (writer.last_time, len(list(tmp_path.iterdir()))) == (0.6, 2)


def test_the_header_is_plain_json(tmp_path):
    with zipfile.ZipFile(written(tmp_path)) as archive:
        header = json.loads(archive.read("header.json"))
    assert header["format"] == 3 and header["scene"] == "title: A scene\n"
