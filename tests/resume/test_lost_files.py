"""Files of a running run that another program moves, deletes or replaces: an error, a checkpoint, no foreign
write."""

import os
import shutil
from pathlib import Path

import pytest
from resume.runs import files_of
from scene_builders import build_scene, particle_group, plane

import granflow as gf
from granflow.cli.main import main
from granflow.errors import OutputError
from granflow.runs import run_state

HALF = 0.01


def scene():
    balls = particle_group([[0, 0, 0.006], [0.03, 0, 0.015]], velocity=[[0.1, 0, 0], [0.1, 0, 0]])
    return build_scene(
        {"balls": balls}, {"floor": plane([0, 0, 0], [0, 0, 1])}, pair={"friction": 0.3},
        gravity=[0.0, 0.0, -9.81], run={"duration": 2 * HALF, "velocity_max": 1.0},
        output={"interval": HALF / 5, "timeseries_interval": HALF / 20},
    )  # fmt: skip


@pytest.fixture(scope="module")
def whole(
    tmp_path_factory,
):
    """An undisturbed run."""
    out = tmp_path_factory.mktemp("lost") / "whole"
    with gf.Simulation(scene(), threads=2, out=out) as simulation:
        simulation.run()
    return out


@pytest.fixture
def frequent_copies(monkeypatch):
    """The state is kept after each batch of steps."""
    monkeypatch.setattr(run_state, "KEPT_SECONDS", 0.0)
    monkeypatch.setattr(run_state, "KEPT_SHARE", float("inf"))


def lost_in_run(out, lose):
    """The message of a run in which `lose(out)` is called at half of its time."""
    done = []

    def act(snapshot):
        if snapshot.time > 0.99 * HALF and not done:
            done.append(lose(out))

    with (
        pytest.raises(OutputError) as stopped,
        gf.Simulation(
            scene(), threads=2, out=out, observers=[gf.on_interval(HALF / 100, act, ("walls",))]
        ) as simulation,
    ):
        simulation.run()
    assert done and f"Stopped at {HALF:.2g}"[:14] in str(stopped.value)
    return str(stopped.value)


def remove(out):
    shutil.rmtree(out)


def rename(out):
    out.rename(out.with_name("old"))


def rename_and_run_another(out):
    out.rename(out.with_name("old"))
    shutil.copytree(out.with_name("whole"), out)


def replace_by_another(out):
    shutil.rmtree(out)
    shutil.copytree(out.with_name("whole"), out)


def copy_series(out):
    shutil.copy(out / "timeseries.csv", out / "copy.csv")
    os.replace(out / "copy.csv", out / "timeseries.csv")


def delete_series(out):
    (out / "timeseries.csv").unlink()


def edit_series(out):
    with open(out / "timeseries.csv", "a") as file:
        file.write("note\n")


def empty_series(out):
    os.truncate(out / "timeseries.csv", 0)


def delete_lock(out):
    (out / ".lock").unlink()


MOVED = {
    rename: "old",
    rename_and_run_another: "old",
    copy_series: "out",
    delete_lock: "out",
    edit_series: "out",
}
"""Losses after which no row and no frame is missing, and the directory that is resumed then."""


@pytest.mark.parametrize("lose", MOVED)
def test_run_continues_where_its_files_are_now(taichi_f64, tmp_path, whole, frequent_copies, lose):
    shutil.copytree(whole, tmp_path / "whole")
    message = lost_in_run(tmp_path / "out", lose)
    found = tmp_path / MOVED[lose]
    assert f"granflow resume {found} continues from" in message
    if lose is rename_and_run_another:
        assert files_of(tmp_path / "out") == files_of(whole), "the files of the other run are as they were"
    assert main(["resume", str(found), "--threads", "2", "--allow-changes"]) == 0
    assert files_of(found) == files_of(whole)


@pytest.mark.parametrize("lose", [remove, replace_by_another, delete_series, empty_series])
def test_state_is_saved_when_files_are_lost(taichi_f64, tmp_path, whole, frequent_copies, lose):
    shutil.copytree(whole, tmp_path / "whole")
    message = lost_in_run(tmp_path / "out", lose)
    target = tmp_path / ("out_rescued" if lose is replace_by_another else "out")
    assert f"granflow resume {target} continues from" in message
    if lose is replace_by_another:
        assert files_of(tmp_path / "out") == files_of(whole)
    assert main(["resume", str(target), "--threads", "2"]) == 2, "rows are missing"
    assert main(["resume", str(target), "--threads", "2", "--allow-changes"]) == 0
    last = sorted(path.name for path in whole.glob("particles_*.vtu"))[-1]
    assert (target / last).read_bytes() == (whole / last).read_bytes()


def test_directory_deleted_between_two_parts_is_not_created_again(taichi_f64, tmp_path):
    simulation = gf.Simulation(scene(), threads=2, out=tmp_path / "out")
    simulation.run(until=HALF)
    shutil.rmtree(tmp_path / "out")
    with pytest.raises(OutputError, match="moved or deleted during the run"):
        simulation.run(until=2 * HALF)
    simulation.free()


def test_loss_in_the_first_checkpoint_interval_leaves_the_state_at_the_start(taichi_f64, tmp_path):
    """The only copy of the state is that at 0 s, before the first step."""
    out = tmp_path / "out"
    simulation = gf.Simulation(scene(), threads=2, out=out)
    simulation.step(1)
    shutil.rmtree(out)
    with pytest.raises(OutputError, match=f"granflow resume {out} continues from 0 s"):
        simulation.step(1000)
    simulation.free()
    assert main(["resume", str(out), "--threads", "2", "--allow-changes"]) == 0


def test_frames_that_no_longer_exist_at_the_end_cause_one_warning(taichi_f64, tmp_path, whole):
    """Two frames of the particles and one of the walls are deleted in the middle of the run."""
    out = tmp_path / "out"
    lost = ["particles_0000.vtu", "particles_0002.vtu", "walls_0001.vtu"]

    def delete(snapshot):
        if snapshot.time > 0.99 * HALF:
            for name in lost:
                (out / name).unlink(missing_ok=True)

    observers = [gf.on_interval(HALF / 100, delete, ("walls",))]
    with gf.Simulation(scene(), threads=2, out=out, observers=observers) as simulation:
        simulation.run()
    count = len(list(whole.glob("particles_*.vtu")))
    (warning,) = [text for text in gf.read_run(out).result.warnings if "no longer exist" in text]
    assert f"2 of the {count} frames in particles.pvd (the first is particles_0000.vtu)" in warning
    assert f"1 of the {count} frames in walls.pvd (the first is walls_0001.vtu)" in warning
    assert not [text for text in gf.read_run(whole).result.warnings if "no longer exist" in text]


def test_working_directory_does_not_matter_after_the_start(taichi_f64, tmp_path, whole, monkeypatch):
    (tmp_path / "other").mkdir()
    monkeypatch.chdir(tmp_path)
    with gf.Simulation(scene(), threads=2, out="out") as simulation:
        monkeypatch.chdir(tmp_path / "other")
        simulation.run(until=HALF)
        monkeypatch.chdir(tmp_path)
        simulation.run()
    assert files_of(tmp_path / "out") == files_of(whole)
    assert not list((tmp_path / "other").iterdir())


@pytest.mark.parametrize("overwrite", [False, True])
def test_second_simulation_in_the_same_directory_is_refused(taichi_f64, tmp_path, whole, overwrite):
    (tmp_path / "out").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "out")
    first = gf.Simulation(scene(), threads=2, out=tmp_path / "out")
    second = gf.Simulation(scene(), threads=2, out=tmp_path / "link", overwrite=overwrite)
    first.run(until=HALF)
    with pytest.raises(gf.GranflowError, match="Another Simulation of this process is writing into"):
        second.run()
    with pytest.raises(gf.GranflowError, match="Another Simulation of this process is writing into"):
        gf.Simulation(scene(), threads=2, out=Path(os.path.relpath(tmp_path / "out")), overwrite=overwrite)
    first.run()
    first.free()
    assert files_of(tmp_path / "out") == files_of(whole)
    if not overwrite:
        with pytest.raises(gf.GranflowError, match="contains an earlier run"):
            second.run()
        assert files_of(tmp_path / "out") == files_of(whole)
    second.free()
