"""A run resumed from any checkpoint ends with the same bits as an uninterrupted run."""

import shutil
from pathlib import Path

import pytest
from resume.runs import complex_scene, files_of, states_of
from scene_builders import DASHPOTS, LIQUID, SOFT, SPRINGS
from sheared_scenes import sheared_gas
from subprocess_runner import in_subprocess

from granflow.engine import threads as workers
from granflow.engine.sums import exact_totals
from granflow.io.checkpoint import read_checkpoint
from granflow.simulation import Simulation


def run_to_end(scene, out, threads=2):
    """Runs the scene to its end and returns the paths of its checkpoints, at least eleven, in order of
    time."""
    simulation = Simulation(scene, out=out, threads=threads)
    simulation.run()
    simulation.free()
    return sorted(out.glob("checkpoint_*.npz"))


def resume_copy(scene, whole, out, path, threads=2):
    """Resumes a finished run from one of its checkpoints, in a copy of its directory."""
    shutil.copytree(whole, out)
    simulation = Simulation(scene, out=out, threads=threads, resume=read_checkpoint(out / path.name))
    simulation.run()
    simulation.free()


def assert_identical(whole, resumed):
    """Asserts equal files and equal states at all checkpoints of the two directories."""
    assert files_of(resumed) == files_of(whole)
    assert states_of(resumed) == states_of(whole)


def test_restart_during_insertion_and_deletion_is_bit_identical(tmp_path, taichi_f64):
    scene = complex_scene()
    checkpoints = run_to_end(scene, tmp_path / "whole")
    assert len(checkpoints) >= 11
    early, late = (read_checkpoint(checkpoints[k]) for k in (1, 7))
    assert (
        early.saved["stage_progress"]["stage"] == "fill"
        and 0 < early.saved["insertion"]["rain"]["due_count"] < 60
    )
    assert late.saved["stage_progress"]["stage"] == "out"
    for name, checkpoint in (("early", early), ("late", late)):
        assert len(checkpoint.saved["engine"]["contacts"]["partner"]) > 20
        resume_copy(scene, tmp_path / "whole", tmp_path / name, checkpoint.path)
        assert_identical(tmp_path / "whole", tmp_path / name)
    simulation = Simulation(scene, out=tmp_path / "start", threads=2)
    simulation.run(until=0)
    simulation.free()
    simulation = Simulation(scene, out=tmp_path / "start", threads=2, resume=tmp_path / "start")
    simulation.run()
    simulation.free()
    (tmp_path / "start" / "checkpoint_000000000000.npz").unlink()
    assert_identical(tmp_path / "whole", tmp_path / "start")
    last = read_checkpoint(checkpoints[-1]).saved["engine"]
    assert last["accounting"]["deleted_count"] > early.saved["engine"]["accounting"]["deleted_count"]
    plastic, friction, rolling, _, wall_work = exact_totals(last["energy_budget"]["losses"], 1.0)
    assert plastic and friction and rolling and wall_work


def test_restart_with_adaptive_time_step_is_bit_identical(tmp_path, taichi_f64):
    scene = complex_scene(0.006, run={"velocity_max": 2.0, "time_step": "adaptive"})
    checkpoints = run_to_end(scene, tmp_path / "whole")
    time_steps = [read_checkpoint(path).saved["engine"]["clock"]["time_step"] for path in checkpoints]
    assert len(set(time_steps)) > 1
    resume_copy(scene, tmp_path / "whole", tmp_path / "again", checkpoints[4])
    assert_identical(tmp_path / "whole", tmp_path / "again")


def test_restart_with_lees_edwards_box_is_bit_identical(tmp_path, taichi_f64):
    output = {"interval": 0.0008, "checkpoint": {"interval": 0.0007, "keep": 100}}
    scene = sheared_gas(duration=0.004, sizes=(0.002, 0.0065), output=output)
    checkpoints = run_to_end(scene, tmp_path / "whole")
    resume_copy(scene, tmp_path / "whole", tmp_path / "again", checkpoints[2])
    assert_identical(tmp_path / "whole", tmp_path / "again")


@pytest.mark.parametrize(
    "models",
    [pytest.param(DASHPOTS, id="dashpots"), pytest.param(SPRINGS, id="springs", marks=pytest.mark.slow)],
)
def test_restart_is_bit_identical_for_tangential_rolling_and_twisting_models(tmp_path, taichi_f64, models):
    scene = complex_scene(0.006, **models)
    checkpoints = run_to_end(scene, tmp_path / "whole")
    resume_copy(scene, tmp_path / "whole", tmp_path / "again", checkpoints[4])
    assert_identical(tmp_path / "whole", tmp_path / "again")
    losses = read_checkpoint(checkpoints[-1]).saved["engine"]["energy_budget"]["losses"]
    _, friction, rolling, damping, _ = exact_totals(losses, 1.0)
    assert friction and rolling and damping


def test_restart_is_bit_identical_with_liquid_films_and_bridges(tmp_path, taichi_f64):
    scene = complex_scene(0.009, of_groups={"liquid_content": 0.01}, **LIQUID)
    checkpoints = run_to_end(scene, tmp_path / "whole")
    for k in (4, 8):  # before and after two walls are removed
        engine = read_checkpoint(checkpoints[k]).saved["engine"]
        assert (engine["contacts"]["cohesion"][:, 0] > 0.0).sum() > 20
        resume_copy(scene, tmp_path / "whole", tmp_path / f"again_{k}", checkpoints[k])
        assert_identical(tmp_path / "whole", tmp_path / f"again_{k}")


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


def is_restart_identical(folder, threads, in_parallel, precision, law, friction):
    """Whether a resumed run equals the uninterrupted one; called in a separate process."""
    if in_parallel:  # a scene of this size uses one thread by default
        workers.SINGLE_WORKER_PARTICLES = 0
    pair = {"friction": friction, "restitution": None if law == "thornton" else 0.7}
    rolling = (
        {"rolling": "epsd", "pair": pair | {"rolling_friction": 0.1}} if friction else {"rolling": "none"}
    )
    materials = {name: SOFT | {"yield_strength": 3e6} for name in ("glass", "steel")}
    run = {"velocity_max": 2.0, "time_step": 2e-6, "precision": precision}
    parts = {"pair": pair, "materials": materials, "run": run} | rolling
    has_history = friction > 0.0 or law not in ("hertz", "kuwabara_kono")
    scene = complex_scene(0.009, normal=LAWS[law], counts_collisions=has_history, **parts)
    whole = Path(folder) / "whole"
    resumed = Path(folder) / "again"
    resume_copy(scene, whole, resumed, run_to_end(scene, whole, threads)[4], threads)
    return files_of(whole) == files_of(resumed) and states_of(whole) == states_of(resumed)


@pytest.mark.slow
@pytest.mark.timeout(1500)
@pytest.mark.parametrize(
    ("threads", "precision"), [(1, "f64"), (2, "f64"), (1, "mixed"), (2, "mixed"), (2, "f32")]
)
def test_restart_is_bit_identical_for_threads_and_precisions(tmp_path, threads, precision):
    assert in_subprocess(
        is_restart_identical, str(tmp_path), threads, threads > 1, precision, "zhou", 0.4, seconds=1200
    )


@pytest.mark.slow
@pytest.mark.timeout(1500)
@pytest.mark.parametrize("friction", [0.4, 0.0])
@pytest.mark.parametrize("law", LAWS)
def test_restart_is_bit_identical_for_contact_models(tmp_path, law, friction):
    assert in_subprocess(is_restart_identical, str(tmp_path), 2, True, "f64", law, friction, seconds=1200)


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_restart_is_bit_identical_from_every_checkpoint(tmp_path, taichi_f64):
    scene = complex_scene(rest=True)
    checkpoints = run_to_end(scene, tmp_path / "whole")
    for path in checkpoints:
        resume_copy(scene, tmp_path / "whole", tmp_path / path.stem, path)
        assert_identical(tmp_path / "whole", tmp_path / path.stem)
