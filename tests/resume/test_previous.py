"""The previous run in a directory is replaced when the new run starts, and is restored if the start fails."""

import errno
import itertools
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from resume.runs import balls

from granflow.cli.main import main
from granflow.errors import GranflowError, OutputError
from granflow.io import checkpoint as format_of
from granflow.io import frames
from granflow.io.checkpoint import write_checkpoint
from granflow.runs.run_directory import replaced_run, restore_previous_run
from granflow.simulation import Simulation

pytestmark = pytest.mark.usefixtures("taichi_f64")  # runs in this process

OLD = {
    "particles_0000.vtu": "old",
    "particles_0001.vtu": "old",
    "run.log": "old",
    "pictures/picture_0001.png": "old",
}
NEW = {"particles_0000.vtu": "new", "contacts_0000.vtu": "new", "run.log": "new"}


def write(directory, files):
    for name, text in files.items():
        (directory / name).parent.mkdir(parents=True, exist_ok=True)
        (directory / name).write_text(text)


def contents(directory):
    files = (path for path in directory.rglob("*") if path.is_file() and path.name != ".lock")
    return {path.relative_to(directory).as_posix(): path.read_bytes() for path in files}


def as_bytes(files):
    return {name: text.encode() for name, text in files.items()}


@pytest.fixture
def out(tmp_path):
    write(tmp_path, OLD | {"notes.txt": "other"})
    return tmp_path


OTHER_FILES = {"notes.txt": b"other"}


@pytest.mark.parametrize("error", [OSError("disk full"), KeyboardInterrupt(), GranflowError("no device")])
def test_failed_start_restores_the_previous_run(out, error):
    with pytest.raises(type(error)), replaced_run(out):
        write(out, NEW)
        raise error
    assert contents(out) == as_bytes(OLD) | OTHER_FILES


@pytest.mark.parametrize("fails", [False, True])
def test_started_run_replaces_the_previous_run(out, fails):
    """The previous run is kept until the new one has started, which then remains also if it fails."""
    with suppress(OSError), replaced_run(out) as confirm_start:
        write(out, NEW)
        assert contents(out / "previous_run") == as_bytes(OLD)
        confirm_start()
        assert contents(out) == as_bytes(NEW) | OTHER_FILES
        if fails:
            raise OSError("disk full")
    assert contents(out) == as_bytes(NEW) | OTHER_FILES


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
    """After each kill, the directory can be restored to one of the two complete runs; other files are
    unchanged."""
    found = set()
    code = 9
    number = 0
    while code:
        number += 1
        out = tmp_path / f"{event}{number}"
        write(out, OLD | {"notes.txt": "other"})
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
        assert remaining in (as_bytes(OLD) | OTHER_FILES, as_bytes(NEW) | OTHER_FILES), number
        found.add(remaining["run.log"])
    assert number > 8
    assert found == ({b"old", b"new"} if event == "begun" else {b"old"})


# ---------------------------------------------------------------- a simulation


def test_failure_of_the_first_frame_restores_the_previous_run(out, monkeypatch):
    scene = balls(run={"duration": 1e-4, "velocity_max": 1.0})

    def raise_disk_full(path, mesh, _):
        assert contents(out / "previous_run") == as_bytes(OLD), (
            "the previous run is deleted only after the first frame"
        )
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    failing = Simulation(scene, out=out, overwrite=True)
    with monkeypatch.context() as patched:
        patched.setattr(frames, "write_vtu", raise_disk_full)
        with pytest.raises(OutputError, match="No space left on device"):
            failing.run()
    failing.free()
    assert contents(out) == as_bytes(OLD) | OTHER_FILES
    succeeding = Simulation(scene, out=out, overwrite=True)
    succeeding.run()
    succeeding.free()
    assert not (out / "previous_run").exists()
    assert b"old" not in contents(out).values() and (out / "notes.txt").exists()


# ---------------------------------------------------------------- resume


def resume_error(out, capsys, *arguments):
    """Error message of `granflow resume`; asserts that all files are unchanged."""
    before = contents(out)
    assert main(["resume", str(out), *arguments]) == 2
    assert contents(out) == before
    return capsys.readouterr().err


@pytest.fixture
def stopped(out):
    """Directory with the files of a stopped run that `resume` checks before it reads the scene."""
    write(out, {"scene_as_run.yaml": "title: Not read\n"})
    write_checkpoint(out, "title: A scene\n", 0.5, 7, {"step": 7})
    return out


def test_newer_checkpoint_that_cannot_be_read_is_rejected(stopped, monkeypatch, capsys):
    """Neither an older checkpoint nor the initial state replaces one of another format, or an unreadable one."""
    monkeypatch.setattr(format_of, "FORMAT", 99)
    monkeypatch.setattr(format_of, "version_of", lambda package: "7.8.9")
    write_checkpoint(stopped, "title: A scene\n", 0.6, 8, {"step": 8})
    monkeypatch.undo()
    message = resume_error(stopped, capsys)
    assert "checkpoint_000000000008.npz is in format 99, written by granflow 7.8.9; granflow " in message
    assert message.endswith(f"reads format {format_of.FORMAT}. Resume with the version that wrote it.\n")
    assert message.count("\n") == 1

    def unreadable(file):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(format_of, "_checksum", unreadable)
    reason = f"cannot be read: {os.strerror(errno.EIO)}. Make it readable, then try again.\n"
    assert f"checkpoint_000000000008.npz {reason}" in resume_error(stopped, capsys)


def test_restart_over_results_requires_from_start(stopped, capsys):
    for path in stopped.glob("checkpoint_*.npz"):
        path.write_bytes(b"nonsense")
    message = resume_error(stopped, capsys)
    assert "is damaged" in message and "contains no usable checkpoint, but 3 result files" in message
    assert f"granflow resume {stopped} --from-start.\n" in message


def test_resume_restores_the_run_of_a_killed_replacement(out, capsys):
    write(
        out / "previous_run", {"checkpoint_000000000007.npz": "nonsense", "scene_as_run.yaml": "title: Old"}
    )
    assert main(["resume", str(out)]) == 2
    assert "holds the previous run again" in capsys.readouterr().err
    assert (out / "scene_as_run.yaml").read_text() == "title: Old" and not Path(out / "run.log").exists()


def test_second_resume_is_rejected_before_reading_files(stopped, capsys):
    holder = "import sys; from pathlib import Path; from granflow.io.lock import locked\n"
    holder += "with locked(Path(sys.argv[1])): print('held', flush=True); sys.stdin.read()"
    command = [sys.executable, "-c", holder, str(stopped)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "held\n"
        for verb in (["resume", str(stopped)], ["resume", str(stopped), "--from-start"]):
            assert main(verb) == 2
            assert f"Another run is writing into {stopped}" in capsys.readouterr().err
        process.stdin.close()
