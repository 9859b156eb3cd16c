"""Files are written completely or not at all; frames are written in order by a thread, whose errors reach the run."""

import errno
import pickle
import threading

import numpy as np
import pytest
from observers.snapshots import contacts_of, snapshot_of, turned

from granflow.io.files import BackgroundWriter, replacing
from granflow.io.frames import FrameSeries
from granflow.io.vtu import VtuMesh


def test_failed_write_keeps_the_old_file_and_no_temporary_file(tmp_path):
    path = tmp_path / "frame.vtu"
    path.write_text("old")
    with pytest.raises(OSError, match="disk full"), replacing(path) as temporary:
        temporary.write_text("half")
        raise OSError("disk full")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_error_is_raised_once_and_later_tasks_are_tried_again():
    """The failed task stays first, so that the order of files is kept."""
    writer = BackgroundWriter()
    seen = []
    disk = {"full": True}

    def write(name):
        if disk["full"]:
            raise OSError(errno.ENOSPC, "No space left on device")
        seen.append(name)

    with writer.running():
        writer.submit(lambda: write("first"))
        for _ in range(2):
            with pytest.raises(OSError, match="No space left"):
                writer.wait()
        disk["full"] = False
        writer.submit(lambda: write("second"))
        writer.wait()
    assert seen == ["first", "second"]
    disk["full"] = True
    with pytest.raises(OSError, match="No space left"), writer.running():  # of the last task, at the end
        writer.submit(lambda: write("third"))


def test_sync_waits_for_all_frames(tmp_path, monkeypatch):
    """A checkpoint contains the list of frames after `sync`: all of them are on the disk then."""
    written = []

    def write_slowly(path, mesh, _):
        threading.Event().wait(0.05)
        path.touch()
        written.append(path.name)

    monkeypatch.setattr("granflow.io.frames.write_vtu", write_slowly)
    writer = BackgroundWriter()
    series = FrameSeries(tmp_path, "particles", writer)
    with writer.running():
        for time in range(5):
            series.write(VtuMesh.of_points(np.zeros((1, 3)), {}), time)
        series.sync()
        assert written == [name for _, name in series.frames] == [f"particles_{k:04d}.vtu" for k in range(5)]


def test_snapshots_are_read_only_also_when_they_are_unpickled():
    given = snapshot_of(time=0.5, step=7, contacts=contacts_of(4), walls={"gate": turned(0.5)})
    for snapshot in (given, pickle.loads(pickle.dumps(given))):
        arrays = [*snapshot.particles.values(), *snapshot.contacts.values()]
        pose = snapshot.walls["gate"]
        arrays += [pose.offset, pose.rotation, pose.pivot, pose.surface_velocity]
        assert not any(values.flags.writeable for values in arrays)
        for part in (snapshot.particles, snapshot.contacts, snapshot.walls, snapshot.totals):
            with pytest.raises(TypeError):
                part["radius"] = 1
        assert (snapshot.time, snapshot.step, snapshot.stage, snapshot.totals) == (
            0.5,
            7,
            "run",
            given.totals,
        )
        np.testing.assert_array_equal(snapshot.walls["gate"].rotation, given.walls["gate"].rotation)
    pose = turned(np.pi / 2, offset=(0, 0, 3), pivot=(1, 0, 0))
    np.testing.assert_allclose(pose.moved(np.array([[2.0, 0.0, 0.0]])), [[1.0, 1.0, 3.0]], atol=1e-15)
