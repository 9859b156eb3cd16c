"""Files that another program moves, deletes, replaces or damages: an error, a checkpoint, no foreign write."""

import os
import shutil
from pathlib import Path

import pytest
from resume.runs import balls, delete, files_of

import granflow as gf
from granflow.cli.main import main
from granflow.errors import OutputError

pytestmark = pytest.mark.usefixtures("taichi_f64")
HALF = 0.01


@pytest.fixture(scope="module")
def whole(tmp_path_factory, taichi_f64):
    """An undisturbed run of 20 ms."""
    out = tmp_path_factory.mktemp("lost") / "whole"
    with gf.Simulation(balls(), threads=2, out=out) as simulation:
        simulation.run()
    return out


def resume(directory, *options):
    """Exit code of `granflow resume`."""
    return main(["resume", str(directory), "--threads", "2", *options])


# ---------------------------------------------------------------- during a run


def lost_in_run(out, lose):
    """The message of a run in which `lose(out)` is called at half of its time."""
    done = []

    def act(snapshot):
        if snapshot.time > 0.99 * HALF and not done:
            done.append(lose(out))

    observers = [gf.on_interval(HALF / 10, act, ("walls",))]
    with (
        pytest.raises(OutputError) as stopped,
        gf.Simulation(balls(), threads=2, out=out, observers=observers) as simulation,
    ):
        simulation.run()
    assert done and f"Stopped at {HALF:.2g}"[:14] in str(stopped.value)
    return str(stopped.value)


def rename(out):
    out.rename(out.with_name("old"))


def rename_and_run_another(out):
    out.rename(out.with_name("old"))
    shutil.copytree(out.with_name("whole"), out)


def replace_by_another(out):
    delete(out)
    shutil.copytree(out.with_name("whole"), out)


def copy_series(out):
    shutil.copy(out / "timeseries.csv", out / "copy.csv")
    os.replace(out / "copy.csv", out / "timeseries.csv")


def edit_series(out):
    with open(out / "timeseries.csv", "a") as file:
        file.write("note\n")


LOSSES = {
    "renamed": (rename, "old", True),
    "renamed, another run in its place": (rename_and_run_another, "old", True),
    "series copied": (copy_series, "out", True),
    "series edited": (edit_series, "out", True),
    "lock deleted": (lambda out: (out / ".lock").unlink(), "out", True),
    "deleted": (delete, "out", False),
    "another run in its place": (replace_by_another, "out_rescued", False),
    "series deleted": (lambda out: (out / "timeseries.csv").unlink(), "out", False),
    "series emptied": (lambda out: os.truncate(out / "timeseries.csv", 0), "out", False),
}
"""Action, the directory that is resumed then, and whether all rows and frames still exist."""


@pytest.mark.parametrize("loss", LOSSES)
def test_run_continues_from_the_directory_of_the_message(tmp_path, whole, frequent_copies, loss):
    lose, name, is_whole = LOSSES[loss]
    shutil.copytree(whole, tmp_path / "whole")
    message = lost_in_run(tmp_path / "out", lose)
    found = tmp_path / name
    assert f"granflow resume {found} continues from" in message
    if "another" in loss:
        assert files_of(tmp_path / "out") == files_of(whole), "the files of the other run are as they were"
    assert resume(found, "--allow-changes") == 0
    last = sorted(path.name for path in whole.glob("particles_*.vtu"))[-1]
    assert (found / last).read_bytes() == (whole / last).read_bytes()
    assert not is_whole or files_of(found) == files_of(whole)


@pytest.mark.parametrize("begun", [True, False])
def test_directory_deleted_between_two_parts_is_not_created_again_without_need(tmp_path, begun):
    """In the first checkpoint interval the only copy of the state is that at 0 s, which is written again."""
    out = tmp_path / "out"
    simulation = gf.Simulation(balls(), threads=2, out=out)
    simulation.run(until=HALF) if begun else simulation.step(1)
    delete(out)
    message = "moved or deleted during the run" if begun else f"granflow resume {out} continues from 0 s"
    with pytest.raises(OutputError, match=message):
        simulation.step(1000)
    simulation.free()
    assert begun or resume(out, "--allow-changes") == 0


def test_frames_that_no_longer_exist_at_the_end_cause_one_warning(tmp_path, whole):
    """Two frames of the particles and one of the walls are deleted in the middle of the run."""
    out = tmp_path / "out"
    with gf.Simulation(balls(), threads=2, out=out) as simulation:
        simulation.run(until=HALF)
        for name in ("particles_0000.vtu", "particles_0002.vtu", "walls_0001.vtu"):
            (out / name).unlink()
        simulation.run()
    count = len(list(whole.glob("particles_*.vtu")))
    (warning,) = [text for text in gf.read_run(out).result.warnings if "no longer exist" in text]
    assert f"2 of the {count} frames in particles.pvd (the first is particles_0000.vtu)" in warning
    assert f"1 of the {count} frames in walls.pvd (the first is walls_0001.vtu)" in warning
    assert not [text for text in gf.read_run(whole).result.warnings if "no longer exist" in text]


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


@pytest.mark.parametrize("overwrite", [False, True])
def test_second_simulation_in_the_same_directory_is_refused(tmp_path, whole, overwrite):
    (tmp_path / "out").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "out")
    first = gf.Simulation(balls(), threads=2, out=tmp_path / "out")
    second = gf.Simulation(balls(), threads=2, out=tmp_path / "link", overwrite=overwrite)
    first.run(until=HALF)
    with pytest.raises(gf.GranflowError, match="Another Simulation of this process is writing into"):
        second.run()
    with pytest.raises(gf.GranflowError, match="Another Simulation of this process is writing into"):
        gf.Simulation(balls(), threads=2, out=Path(os.path.relpath(tmp_path / "out")), overwrite=overwrite)
    first.run()
    first.free()
    assert files_of(tmp_path / "out") == files_of(whole)
    if not overwrite:
        with pytest.raises(gf.GranflowError, match="contains an earlier run"):
            second.run()
        assert files_of(tmp_path / "out") == files_of(whole)
    second.free()


# ---------------------------------------------------------------- between a run and its continuation


@pytest.fixture(scope="module")
def half(tmp_path_factory, taichi_f64):
    """A run that ended at half of its time, with two checkpoints."""
    out = tmp_path_factory.mktemp("half") / "out"
    with gf.Simulation(balls(), threads=2, out=out) as simulation:
        simulation.run(until=0.8 * HALF)
        simulation.save()
        simulation.run(until=HALF)
    return out


def newest(out):
    return max(out.glob("checkpoint_*.npz"))


def flip_a_bit(out):
    data = bytearray(newest(out).read_bytes())
    data[len(data) // 2] ^= 1
    newest(out).write_bytes(data)


def add_files(out):
    (out / ".a.vtu.99.part").write_bytes(b"x")
    (out / "particles_0999.vtu").write_bytes(b"x")


DAMAGES = {
    "flipped bit": (flip_a_bit, "is damaged: it is truncated, or its bytes have changed."),
    "no scene": (lambda out: (out / "scene_as_run.yaml").unlink(), ""),
    "temporary and later files": (add_files, ""),
}
"""Changes of the files of a stopped run despite which it continues, and a part of the warning."""


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_run_continues_with_the_same_bits(tmp_path, whole, half, capsys, damage):
    act, warning = DAMAGES[damage]
    out = tmp_path / "out"
    shutil.copytree(half, out)
    act(out)
    assert resume(out) == 0
    assert warning in (error := capsys.readouterr().err) and (warning or "damaged" not in error)
    assert files_of(out) == files_of(whole)
    assert not list(out.glob(".*.part"))


@pytest.mark.parametrize("size", [None, 0, 100])
def test_missing_rows_of_the_time_series_need_a_flag(tmp_path, half, capsys, size):
    """The file is deleted, empty or too short."""
    out = tmp_path / "out"
    shutil.copytree(half, out)
    series = out / "timeseries.csv"
    series.unlink() if size is None else os.truncate(series, size)
    before = files_of(out)
    assert resume(out) == 2
    assert "timeseries.csv lacks rows that were written before the checkpoint" in capsys.readouterr().err
    assert files_of(out) == before
    assert resume(out, "--allow-changes") == 0


def test_scene_that_cannot_be_read_is_named_and_nothing_is_changed(tmp_path, half, capsys):
    out = tmp_path / "out"
    shutil.copytree(half, out)
    (out / "scene_as_run.yaml").write_text("[")
    before = files_of(out)
    assert resume(out) == 2
    assert "scene_as_run.yaml:1:2: the bracket that opens here is not closed" in capsys.readouterr().err
    assert files_of(out) == before
