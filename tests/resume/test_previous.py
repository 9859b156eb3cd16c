"""The previous run in a directory is replaced when the new run has begun, and is still there if it never does."""

import errno
import itertools
import os
import subprocess
import sys
import types
from pathlib import Path

import pytest
from scene_builders import build_scene, particle_group

from granflow.cli import main
from granflow.errors import GranflowError, OutputError
from granflow.observe import checkpoint as format_of
from granflow.observe import frames, replaced_run, restore_previous_run, write_checkpoint
from granflow.simulation import Simulation

OLD = {"particles_0000.vtu": "old", "particles_0001.vtu": "old", "run.log": "old", "pictures/picture_0001.png": "old"}
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
    write(tmp_path, OLD | {"notes.txt": "mine"})
    return tmp_path


MINE = {"notes.txt": b"mine"}


@pytest.mark.parametrize("error", [OSError("disk full"), KeyboardInterrupt(), GranflowError("no such device")])
def test_a_start_that_fails_leaves_the_previous_run(out, error):
    with pytest.raises(type(error)), replaced_run(out):
        write(out, NEW)
        raise error
    assert contents(out) == as_bytes(OLD) | MINE


@pytest.mark.parametrize("error", [None, OSError("disk full")])
def test_a_run_that_has_begun_replaces_it(out, error):
    try:
        with replaced_run(out) as prepared_simulation:
            write(out, NEW)
            assert contents(out / "previous_run") == as_bytes(OLD), "until then it is there"
            prepared_simulation()
            assert contents(out) == as_bytes(NEW) | MINE
            if error:
                raise error
    except OSError:
        pass
    assert contents(out) == as_bytes(NEW) | MINE


def test_a_run_that_ends_without_a_frame_replaces_it_too(out):
    with replaced_run(out):
        write(out, NEW)
    assert contents(out) == as_bytes(NEW) | MINE


def replace_until_killed(out, last, then):
    """Replace a run in this process, which ends at once before file operation number `last`."""
    count = itertools.count(1)

    def killed_at_last(function):
        def call(*arguments, **options):
            if next(count) == last:
                os._exit(9)
            return function(*arguments, **options)

        return call

    for name in ("replace", "unlink", "rmdir"):
        setattr(os, name, killed_at_last(getattr(os, name)))
    Path.unlink = killed_at_last(Path.unlink)
    with replaced_run(out) as prepared_simulation:
        write(out, NEW)
        prepared_simulation() if then == "begun" else restore_previous_run(out)
    os._exit(0)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize("then", ["begun", "restored"])
def test_killed_at_every_file_operation(tmp_path, then):
    """Whatever is left, the next start finds one of the two runs, complete, and the files that are not of a run."""
    found, code, number = set(), 9, 0
    while code:
        number += 1
        out = tmp_path / f"{then}{number}"
        write(out, OLD | {"notes.txt": "mine"})
        subprocess_runner = os.fork()
        if not subprocess_runner:
            try:
                replace_until_killed(out, number, then)
            finally:
                os._exit(1)
        code = os.waitstatus_to_exitcode(os.waitpid(subprocess_runner, 0)[1])
        assert code in (0, 9)
        restore_previous_run(out)
        left = contents(out)
        assert left in (as_bytes(OLD) | MINE, as_bytes(NEW) | MINE), number
        found.add(left["run.log"])
    assert number > 8
    assert found == ({b"old", b"new"} if then == "begun" else {b"old"})


# ---------------------------------------------------------------- a simulation


def test_a_simulation_that_cannot_write_its_first_frame_leaves_the_previous_run(out, monkeypatch):
    scene = build_scene({"ball": particle_group([0.0, 0.0, 0.0])}, run={"duration": 1e-4}, output={"interval": 5e-5})

    def full(path, mesh):
        assert contents(out / "previous_run") == as_bytes(OLD), "it is not deleted before the first frame"
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    failing = Simulation(scene, out=out)
    with monkeypatch.context() as patched:
        patched.setattr(frames, "write_vtu", full)
        with pytest.raises(OutputError, match="No space left on device"):
            failing.run()
    failing.free()
    assert contents(out) == as_bytes(OLD) | MINE
    succeeding = Simulation(scene, out=out)
    succeeding.run()
    succeeding.free()
    assert not (out / "previous_run").exists()
    assert b"old" not in contents(out).values() and (out / "notes.txt").exists()


def test_a_simulation_that_would_delete_its_own_start_is_refused(tmp_path):
    scene = build_scene({"ball": particle_group([0.0, 0.0, 0.0])}, start_from=str(tmp_path))
    write(tmp_path, OLD)
    with pytest.raises(GranflowError, match="start_from is .*, which is in the output directory"):
        Simulation(scene, out=tmp_path)
    assert contents(tmp_path) == as_bytes(OLD)


# ---------------------------------------------------------------- resume


def refused_resume(out, capsys, *more):
    """The sentence with which `granflow resume` refuses; every file is as before."""
    before = contents(out)
    assert main(["resume", str(out), *more]) == 2
    assert contents(out) == before
    return capsys.readouterr().err


@pytest.fixture
def stopped(out):
    """A run that was stopped, as far as `resume` can see before it reads the scene."""
    write(out, {"scene_as_run.yaml": "title: A scene that no test reads\n"})
    write_checkpoint(out, "title: A scene\n", 0.5, 7, {"step": 7})
    return out


def test_a_newer_checkpoint_of_another_format_is_refused(stopped, monkeypatch, capsys):
    monkeypatch.setattr(format_of, "FORMAT", 99)
    monkeypatch.setattr(format_of, "version_of", lambda package: "7.8.9")
    write_checkpoint(stopped, "title: A scene\n", 0.6, 8, {"step": 8})
    monkeypatch.undo()
    message = refused_resume(stopped, capsys)
    assert "checkpoint_000000000008.npz is in format 99, written by granflow 7.8.9; granflow " in message
    assert message.endswith(f"reads format {format_of.FORMAT}. Resume with the version that wrote it.\n")
    assert message.count("\n") == 1


@pytest.mark.parametrize("code", [errno.EACCES, errno.EIO])
def test_a_checkpoint_that_the_system_cannot_read_is_refused(stopped, monkeypatch, capsys, code):
    """Neither an older checkpoint nor the start takes its place."""
    write_checkpoint(stopped, "title: A scene\n", 0.6, 8, {"step": 8})

    def unreadable(file):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(format_of, "_checksum", unreadable)
    message = refused_resume(stopped, capsys)
    reason = os.strerror(code)
    assert f"checkpoint_000000000008.npz cannot be read: {reason}. Make it readable, then try again.\n" in message


def test_beginning_from_the_start_over_results_takes_a_flag(stopped, capsys):
    for path in stopped.glob("checkpoint_*.npz"):
        path.write_bytes(b"nonsense")
    message = refused_resume(stopped, capsys)
    assert "is damaged" in message and "contains no usable checkpoint, but 3 result files" in message
    assert f"granflow resume {stopped} --from-start.\n" in message


def test_the_flag_begins_from_the_start(stopped, monkeypatch):
    made = []

    class NotMade(Exception):
        pass

    def simulation(scene, resume, **options):
        made.append(resume)
        raise NotMade

    monkeypatch.setitem(sys.modules, "granflow.simulation", types.SimpleNamespace(Simulation=simulation))
    monkeypatch.setattr("granflow.cli.resume.scene_to_resume", lambda options, checkpoint: checkpoint)
    for flags in ([], ["--from-start"]):
        with pytest.raises(NotMade):
            main(["resume", str(stopped), *flags])
    assert [checkpoint and checkpoint.saved for checkpoint in made] == [{"step": 7}, None]


def test_resume_puts_back_a_run_whose_replacement_was_killed(out, capsys):
    write(out / "previous_run", {"checkpoint_000000000007.npz": "nonsense", "scene_as_run.yaml": "title: Old"})
    assert main(["resume", str(out)]) == 2
    assert "holds the previous run again" in capsys.readouterr().err
    assert (out / "scene_as_run.yaml").read_text() == "title: Old" and not Path(out / "run.log").exists()


def test_a_second_resume_is_refused_before_anything_is_read(stopped, capsys):
    holder = "import sys; from pathlib import Path; from granflow.observe.lock import locked\n"
    holder += "with locked(Path(sys.argv[1])): print('held', flush=True); sys.stdin.read()"
    command = [sys.executable, "-c", holder, str(stopped)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "held\n"
        for verb in (["resume", str(stopped)], ["resume", str(stopped), "--from-start"]):
            assert main(verb) == 2
            assert f"Another run is writing into {stopped}" in capsys.readouterr().err
        process.stdin.close()
