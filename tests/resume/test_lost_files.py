"""Files that another program moves, deletes, replaces or damages: an error, a checkpoint, no foreign write."""

import os
import shutil

import pytest
from resume.runs import balls, delete, files_of

import granflow as gf
from granflow.cli.main import main
from granflow.errors import OutputError

HALF = 0.01


@pytest.fixture(scope="module")
def runs(tmp_path_factory, taichi_f64):
    """Folder of an undisturbed run of 20 ms, and of one that ended at half of it, with two checkpoints."""
    folder = tmp_path_factory.mktemp("runs")
    with gf.Simulation(balls(), threads=2, out=folder / "whole") as simulation:
        simulation.run()
    with gf.Simulation(balls(), threads=2, out=folder / "half") as simulation:
        simulation.run(until=0.8 * HALF)
        simulation.save()
        simulation.run(until=HALF)
    return folder


@pytest.fixture
def whole(runs):
    return runs / "whole"


@pytest.fixture
def half(runs, tmp_path):
    """A copy of the run that ended at half of its time."""
    return shutil.copytree(runs / "half", tmp_path / "out")


def resume(directory, *options):
    """Exit code of `granflow resume`."""
    return main(["resume", str(directory), "--threads", "2", *options])


# ---------------------------------------------------------------- during a run


def rename_and_run_another(out):
    out.rename(out.with_name("old"))
    shutil.copytree(out.with_name("whole"), out)


def replace_by_another(out):
    delete(out)
    shutil.copytree(out.with_name("whole"), out)


def edit_series(out):
    with open(out / "timeseries.csv", "a") as file:
        file.write("note\n")


LOSSES = {
    "renamed, another run in its place": (rename_and_run_another, "old", True),
    "series edited": (edit_series, "out", True),
    "lock deleted": (lambda out: (out / ".lock").unlink(), "out", True),
    "deleted": (delete, "out", False),
    "another run in its place": (replace_by_another, "out_rescued", False),
    "series deleted": (lambda out: (out / "timeseries.csv").unlink(), "out", False),
}
"""Action, the directory that is resumed then, and whether all rows and frames still exist."""


@pytest.mark.parametrize("loss", LOSSES)
def test_run_continues_from_the_directory_of_the_message(tmp_path, whole, frequent_copies, loss):
    """The files are lost at half of the time."""
    lose, name, is_whole = LOSSES[loss]
    shutil.copytree(whole, tmp_path / "whole")
    out = tmp_path / "out"
    pending = [lose]

    def act(snapshot):
        if snapshot.time > 0.99 * HALF and pending:
            pending.pop()(out)

    observers = [gf.on_interval(HALF / 10, act, ("walls",))]
    with (
        pytest.raises(OutputError, match="Stopped at 0.01") as stopped,
        gf.Simulation(balls(), threads=2, out=out, observers=observers) as simulation,
    ):
        simulation.run()
    found = tmp_path / name
    assert f"granflow resume {found} continues from" in str(stopped.value)
    if "another" in loss:
        assert files_of(out) == files_of(whole), "the files of the other run are as they were"
    assert resume(found, "--allow-changes") == 0
    last = sorted(path.name for path in whole.glob("particles_*.vtu"))[-1]
    assert (found / last).read_bytes() == (whole / last).read_bytes()
    assert not is_whole or files_of(found) == files_of(whole)


def test_directory_deleted_in_the_first_checkpoint_interval_is_created_again(tmp_path, runs):
    """The only copy of the state is that at 0 s."""
    out = tmp_path / "out"
    with gf.Simulation(balls(), threads=2, out=out) as simulation:
        simulation.step(1)
        delete(out)
        with pytest.raises(OutputError, match=f"granflow resume {out} continues from 0 s"):
            simulation.step(1000)
    assert resume(out, "--allow-changes") == 0


def test_frames_that_no_longer_exist_at_the_end_cause_one_warning(tmp_path, runs):
    with gf.Simulation(balls(), threads=2, out=tmp_path / "out") as simulation:
        simulation.run(until=HALF)
        for number in (0, 2):
            (tmp_path / "out" / f"particles_000{number}.vtu").unlink()
        simulation.run()
    (warning,) = [text for text in gf.read_run(tmp_path / "out").result.warnings if "no longer exist" in text]
    assert "2 of the 11 frames in particles.pvd (the first is particles_0000.vtu)" in warning


def test_working_directory_does_not_matter_after_the_start(tmp_path, whole, monkeypatch):
    (tmp_path / "other").mkdir()
    monkeypatch.chdir(tmp_path)
    with gf.Simulation(balls(), threads=2, out="out") as simulation:
        monkeypatch.chdir(tmp_path / "other")
        simulation.run(until=HALF)
        monkeypatch.chdir(tmp_path)
        simulation.run()
    assert files_of(tmp_path / "out") == files_of(whole)
    assert not list((tmp_path / "other").iterdir())


def test_second_simulation_in_the_same_directory_is_refused(tmp_path, whole):
    (tmp_path / "out").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "out")
    first = gf.Simulation(balls(), threads=2, out=tmp_path / "out")
    second = gf.Simulation(balls(), threads=2, out=tmp_path / "link")
    first.run(until=HALF)
    for start in (
        second.run,
        lambda: gf.Simulation(balls(), threads=2, out=os.path.relpath(tmp_path / "out")),
    ):
        with pytest.raises(gf.GranflowError, match="Another Simulation of this process is writing into"):
            start()
    first.run()
    first.free()
    with pytest.raises(gf.GranflowError, match="contains an earlier run"):
        second.run()
    second.free()
    assert files_of(tmp_path / "out") == files_of(whole)


# ---------------------------------------------------------------- between a run and its continuation


def test_damaged_run_continues_with_the_same_bits(half, whole, capsys):
    """The newest checkpoint is damaged, the scene deleted; there are temporary and later files."""
    newest = max(half.glob("checkpoint_*.npz"))
    data = bytearray(newest.read_bytes())
    data[len(data) // 2] ^= 1
    newest.write_bytes(data)
    (half / "scene_as_run.yaml").unlink()
    for name in (".a.vtu.99.part", "particles_0999.vtu"):
        (half / name).write_bytes(b"x")
    assert resume(half) == 0
    assert f"{newest} is damaged: it is truncated, or its bytes have changed." in capsys.readouterr().err
    assert files_of(half) == files_of(whole)
    assert not list(half.glob(".*.part"))


@pytest.mark.parametrize("size", [None, 100])
def test_missing_rows_of_the_time_series_need_a_flag(half, capsys, size):
    """The file is deleted, or too short."""
    series = half / "timeseries.csv"
    series.unlink() if size is None else os.truncate(series, size)
    before = files_of(half)
    assert resume(half) == 2
    assert "timeseries.csv lacks rows that were written before the checkpoint" in capsys.readouterr().err
    assert files_of(half) == before
    assert resume(half, "--allow-changes") == 0


def test_restart_without_a_usable_checkpoint_requires_from_start(half, whole, capsys):
    for path in half.glob("checkpoint_*.npz"):
        path.write_bytes(b"nonsense")
    before = files_of(half)
    assert resume(half) == 2
    message = capsys.readouterr().err
    assert message.count("is damaged") == 2 and f"granflow resume {half} --from-start.\n" in message
    assert files_of(half) == before
    assert resume(half, "--from-start") == 0
    assert files_of(half) == files_of(whole)
