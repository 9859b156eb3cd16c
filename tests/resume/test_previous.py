"""The previous run in a directory is replaced when the new run starts, and is restored if the start fails."""

import errno
import itertools
import os
import subprocess
import sys
from pathlib import Path

import pytest
from resume.runs import balls

from granflow.cli.main import main
from granflow.errors import OutputError
from granflow.io import checkpoint as format_of
from granflow.io import frames
from granflow.io.checkpoint import write_checkpoint
from granflow.runs.run_directory import replaced_run, restore_previous_run
from granflow.simulation import Simulation

pytestmark = pytest.mark.usefixtures("taichi_f64")  # runs in this process

OTHER = {"notes.txt": b"other"}
OLD = {
    "particles_0000.vtu": b"old",
    "particles_0001.vtu": b"old",
    "run.log": b"old",
    "pictures/picture_0001.png": b"old",
}
NEW = {"particles_0000.vtu": b"new", "contacts_0000.vtu": b"new", "run.log": b"new"}


def write(directory, files):
    for name, content in files.items():
        (directory / name).parent.mkdir(parents=True, exist_ok=True)
        (directory / name).write_bytes(content)


def contents(directory):
    files = (path for path in directory.rglob("*") if path.is_file() and path.name != ".lock")
    return {path.relative_to(directory).as_posix(): path.read_bytes() for path in files}


def replace_until_killed(out, fatal_operation, event):
    """Replaces a run in this process, which exits before file operation number `fatal_operation`."""
    count = itertools.count(1)

    def exits_at_operation(function):
        def call(*arguments, **options):
            if next(count) == fatal_operation:
                os._exit(9)
            return function(*arguments, **options)

        return call

    for name in ("replace", "unlink", "rmdir"):
        setattr(os, name, exits_at_operation(getattr(os, name)))
    Path.unlink = exits_at_operation(Path.unlink)
    with replaced_run(out) as confirm_start:
        write(out, NEW)
        confirm_start() if event == "begun" else restore_previous_run(out)
    os._exit(0)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize("event", ["begun", "restored"])
def test_kill_at_any_file_operation_keeps_one_complete_run(tmp_path, event):
    """After each kill, the directory can be restored to one of the two complete runs; other files stay."""
    found = set()
    code = 9
    number = 0
    while code:
        number += 1
        out = tmp_path / f"{event}{number}"
        write(out, OLD | OTHER)
        child_pid = os.fork()
        if not child_pid:
            try:
                replace_until_killed(out, number, event)
            finally:
                os._exit(1)
        code = os.waitstatus_to_exitcode(os.waitpid(child_pid, 0)[1])
        assert code in (0, 9)
        restore_previous_run(out)
        remaining = contents(out)
        assert remaining in (OLD | OTHER, NEW | OTHER), number
        found.add(remaining["run.log"])
    assert number > 8
    assert found == ({b"old", b"new"} if event == "begun" else {b"old"})
    assert remaining == (NEW | OTHER if event == "begun" else OLD | OTHER)


def test_failure_of_the_first_frame_restores_the_previous_run(tmp_path, monkeypatch):
    write(tmp_path, OLD | OTHER)
    scene = balls(run={"duration": 1e-4, "velocity_max": 1.0})

    def raise_disk_full(path, mesh, _):
        assert contents(tmp_path / "previous_run") == OLD, "it is deleted only after the first frame"
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    failing = Simulation(scene, out=tmp_path, overwrite=True)
    with monkeypatch.context() as patched:
        patched.setattr(frames, "write_vtu", raise_disk_full)
        with pytest.raises(OutputError, match="No space left on device"):
            failing.run()
    failing.free()
    assert contents(tmp_path) == OLD | OTHER
    succeeding = Simulation(scene, out=tmp_path, overwrite=True)
    succeeding.run()
    succeeding.free()
    assert not (tmp_path / "previous_run").exists()
    assert b"old" not in contents(tmp_path).values() and (tmp_path / "notes.txt").exists()


def test_resume_restores_the_run_of_a_killed_replacement(tmp_path, capsys):
    old = {"checkpoint_000000000007.npz": b"nonsense", "scene_as_run.yaml": b"title: Old"}
    write(tmp_path, {"run.log": b"new"})
    write(tmp_path / "previous_run", old)
    assert main(["resume", str(tmp_path)]) == 2
    assert "holds the previous run again" in capsys.readouterr().err
    assert contents(tmp_path) == old


@pytest.fixture
def stopped(tmp_path):
    """Directory with the files of a stopped run that `resume` checks before it reads the scene."""
    write(tmp_path, {"scene_as_run.yaml": b"title: Not read\n"})
    write_checkpoint(tmp_path, "title: A scene\n", 0.5, 7, {"step": 7})
    return tmp_path


def test_newer_checkpoint_that_cannot_be_read_is_rejected(stopped, monkeypatch, capsys):
    """Neither an older checkpoint nor the initial state replaces one of another format, or an unreadable one."""
    with monkeypatch.context() as newer:
        newer.setattr(format_of, "FORMAT", 99)
        newer.setattr(format_of, "version_of", lambda package: "7.8.9")
        write_checkpoint(stopped, "title: A scene\n", 0.6, 8, {"step": 8})
    before = contents(stopped)
    assert main(["resume", str(stopped)]) == 2
    message = capsys.readouterr().err
    assert "checkpoint_000000000008.npz is in format 99, written by granflow 7.8.9; granflow " in message
    assert message.endswith(f"reads format {format_of.FORMAT}. Resume with the version that wrote it.\n")

    def unreadable(file):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(format_of, "_checksum", unreadable)
    assert main(["resume", str(stopped)]) == 2
    assert f"8.npz cannot be read: {os.strerror(errno.EIO)}. Make it" in capsys.readouterr().err
    assert contents(stopped) == before


def test_second_resume_is_rejected_before_reading_files(stopped, capsys):
    holder = "import sys; from pathlib import Path; from granflow.io.lock import locked\n"
    holder += "with locked(Path(sys.argv[1])): print('held', flush=True); sys.stdin.read()"
    command = [sys.executable, "-c", holder, str(stopped)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "held\n"
        assert main(["resume", str(stopped), "--from-start"]) == 2
        assert f"Another run is writing into {stopped}" in capsys.readouterr().err
        process.stdin.close()
