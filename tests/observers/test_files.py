"""Files are written completely or not at all; frames are written in order by a thread, whose errors reach the run."""

import errno
import threading

import numpy as np
import pytest

from granflow.io import files as background_writer
from granflow.io.files import BackgroundWriter, replacing, write_text
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


def test_temporary_file_is_hidden_and_in_the_directory_of_the_target(tmp_path):
    path = tmp_path / "frame.vtu"
    write_text(path, "old")
    with replacing(path) as temporary:
        temporary.write_text("new")
        assert temporary.parent == tmp_path and temporary.name.startswith(".")
        assert path.read_text() == "old"
    assert path.read_text() == "new"


POINT = VtuMesh.of_points(np.zeros((1, 3)), {})


def test_full_queue_delays_the_submitting_thread(monkeypatch):
    monkeypatch.setattr(background_writer, "LONGEST_QUEUE", 2)
    writer = BackgroundWriter()
    gate = threading.Event()
    submitted = []

    def submit_five():
        for number in range(5):
            writer.submit(gate.wait)
            submitted.append(number)

    with writer.running():
        submitting = threading.Thread(target=submit_five)
        submitting.start()
        submitting.join(timeout=0.2)
        assert submitting.is_alive() and len(submitted) == 2
        gate.set()
        submitting.join()
    assert len(submitted) == 5


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
        with pytest.raises(OSError, match="No space left"):
            writer.wait()
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
    gate = threading.Event()

    def write_slowly(path, mesh, _):
        gate.wait(0.05)
        path.touch()
        written.append(path.name)

    monkeypatch.setattr("granflow.io.frames.write_vtu", write_slowly)
    writer = BackgroundWriter()
    series = FrameSeries(tmp_path, "particles", writer)
    with writer.running():
        for time in range(5):
            series.write(POINT, time)
        series.sync()
        assert written == [name for _, name in series.frames] == [f"particles_{k:04d}.vtu" for k in range(5)]
