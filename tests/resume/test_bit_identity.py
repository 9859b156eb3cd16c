"""A run that goes on from a checkpoint ends with the bits of one never stopped, wherever the checkpoint fell."""

import shutil
from pathlib import Path

import pytest
from resume.runs import complex_scene, files_of, states_of
from scene_builders import SOFT
from sheared_scenes import sheared_gas
from subprocess_runner import in_subprocess

from granflow.device import stepper
from granflow.observe import read_checkpoint
from granflow.simulation import Simulation


def undisturbed(scene, out, threads=2):
    """Run to the end with eleven checkpoints on the way, which are listed in order."""
    simulation = Simulation(scene, out=out, threads=threads)
    simulation.run()
    simulation.free()
    return sorted(out.glob("checkpoint_*.npz"))


def resumed(scene, whole, out, path, threads=2):
    """Go on from one checkpoint of a finished run, in a copy of all that the run left behind."""
    shutil.copytree(whole, out)
    simulation = Simulation(scene, out=out, threads=threads, resume=read_checkpoint(out / path.name))
    simulation.run()
    simulation.free()


def assert_same(whole, again):
    """The same files; and the same state at every checkpoint, from the one gone on from to the last."""
    assert files_of(again) == files_of(whole)
    assert states_of(again) == states_of(whole)


def test_in_the_rain_and_in_the_outflow(tmp_path, taichi_f64):
    scene = complex_scene()
    written = undisturbed(scene, tmp_path / "whole")
    assert len(written) >= 11
    early, late = (read_checkpoint(written[k]) for k in (1, 7))
    assert early.saved["stage_progress"]["stage"] == "fill" and 0 < early.saved["insertion"]["rain"]["due_count"] < 60
    assert late.saved["stage_progress"]["stage"] == "out"
    for name, checkpoint in (("early", early), ("late", late)):
        resumed(scene, tmp_path / "whole", tmp_path / name, checkpoint.path)
        assert_same(tmp_path / "whole", tmp_path / name)
    last = read_checkpoint(written[-1]).saved["engine"]
    assert last["accounting"]["deleted_count"] > early.saved["engine"]["accounting"]["deleted_count"]
    plastic, friction, rolling, _, wall_work = last["energy_budget"]["losses"].sum(axis=0)
    assert plastic and friction and rolling and wall_work
    assert len(last["neighbors"]["partner"]) > 50


def test_a_step_that_follows_the_scene(tmp_path, taichi_f64):
    scene = complex_scene(0.006, run={"velocity_max": 2.0, "time_step": "adaptive"})
    written = undisturbed(scene, tmp_path / "whole")
    clocks = [read_checkpoint(path).saved["engine"]["clock"]["time_step"] for path in written]
    assert len(set(clocks)) > 1
    resumed(scene, tmp_path / "whole", tmp_path / "again", written[4])
    assert_same(tmp_path / "whole", tmp_path / "again")


def test_in_the_middle_of_a_shear(tmp_path, taichi_f64):
    output = {"interval": 0.0008, "checkpoint": {"interval": 0.0007, "keep": 100}}
    scene = sheared_gas(duration=0.004, sizes=(0.002, 0.0065), output=output)
    written = undisturbed(scene, tmp_path / "whole")
    resumed(scene, tmp_path / "whole", tmp_path / "again", written[2])
    assert_same(tmp_path / "whole", tmp_path / "again")


SPRING = {"stiffness": {"reference_velocity": 1.0}}
LAWS = {
    "zhou": {"law": "zhou", "restitution_at": "max_overlap"},
    "hertz": {"law": "hertz"},
    "linear": {"law": "linear", **SPRING},
    "thornton": {"law": "thornton", "yield_ratio": 1.6},
    "walton_braun": {"law": "walton_braun", "unloading": {"reference_velocity": 1.0}, **SPRING},
    "luding": {"law": "luding", "plasticity_depth": 0.02, "tension": 0.3, **SPRING},
    "kuwabara_kono": {"law": "kuwabara_kono", "reference_velocity": 1.0},
}


def is_same(folder, threads, in_parallel, precision, law, friction):
    """Whether a run gone on with is the whole one: in a process of its own."""
    if in_parallel:  # a scene this small would be stepped on one thread
        stepper.SINGLE_WORKER_PARTICLES = 0
    pair = {"friction": friction, "restitution": None if law == "thornton" else 0.7}
    rolling = {"rolling": "epsd", "pair": pair | {"rolling_friction": 0.1}} if friction else {"rolling": "none"}
    materials = {name: SOFT | {"yield_strength": 3e6} for name in ("glass", "steel")}
    run = {"velocity_max": 2.0, "time_step": 2e-6, "precision": precision}
    scene = complex_scene(0.009, normal=LAWS[law], **({"pair": pair, "materials": materials, "run": run} | rolling))
    whole, again = Path(folder) / "whole", Path(folder) / "again"
    resumed(scene, whole, again, undisturbed(scene, whole, threads)[4], threads)
    return files_of(whole) == files_of(again) and states_of(whole) == states_of(again)


@pytest.mark.slow
@pytest.mark.timeout(1500)
@pytest.mark.parametrize(("threads", "precision"), [(1, "f64"), (2, "f64"), (1, "mixed"), (2, "mixed"), (2, "f32")])
def test_threads_and_precisions(tmp_path, threads, precision):
    assert in_subprocess(is_same, str(tmp_path), threads, threads > 1, precision, "zhou", 0.4, seconds=1200)


@pytest.mark.slow
@pytest.mark.timeout(1500)
@pytest.mark.parametrize("friction", [0.4, 0.0])
@pytest.mark.parametrize("law", LAWS)
def test_every_law(tmp_path, law, friction):
    assert in_subprocess(is_same, str(tmp_path), 2, True, "f64", law, friction, seconds=1200)


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_every_point_of_the_run(tmp_path, taichi_f64):
    scene = complex_scene(rest=True)
    written = undisturbed(scene, tmp_path / "whole")
    for path in written:
        resumed(scene, tmp_path / "whole", tmp_path / path.stem, path)
        assert_same(tmp_path / "whole", tmp_path / path.stem)
