"""Scenes and launches that do not work with --mpi: one sentence each."""

import sys

import pytest
from scene_builders import build_scene, particle_group, plane

from granflow.cli.main import main
from granflow.errors import GranflowError
from granflow.runs.ranks import rank_problems, refuse_on_ranks

SERVO = {"kind": "servo", "direction": [0, 0, -1], "force": 1.0, "velocity_max": 0.01}
BOX = {"min": [-0.1] * 3, "max": [0.1] * 3}
SHEARED = {
    "min": [-1.0] * 3, "max": [1.0] * 3, "periodic": ["x", "y", "z"], "on_exit": "error",
    "lees_edwards": {"flow": "x", "gradient": "y", "rate": 1.0},
}  # fmt: skip
REFUSED = {
    "run.time_step": {"run": {"duration": 1.0, "time_step": "adaptive"}},
    "domain.lees_edwards": {"domain": SHEARED, "walls": {}},
    "outlets.hole": {"outlets": {"hole": {"box": {"min": [0.5] * 3, "max": [0.7] * 3}}}},
    "walls.floor.motion": {"walls": {"floor": plane([0, 0, -0.5], [0, 0, 1], motion=SERVO)}},
    "output.contacts": {"output": {"interval": 1.0, "contacts": True}},
    "output.walls": {"output": {"interval": 1.0, "wall_forces": True}},
    "output.metrics.chain": {"output": {"interval": 1.0, "metrics": {"chain": {"kind": "fabric"}}}},
    "output.fields.mean": {
        "output": {"interval": 1.0, "fields": {"mean": {"cells": [2, 2, 2], "quantities": ["pressure"]}}}
    },
}


def scene_with(changes):
    """A scene with a particle above a floor."""
    parts = {"walls": {"floor": plane([0, 0, -0.5], [0, 0, 1])}} | changes
    return build_scene({"beads": particle_group([[0.0, 0.0, 0.0]])}, parts.pop("walls"), **parts)


@pytest.mark.parametrize("key", REFUSED)
def test_each_key_is_refused_with_one_sentence(key):
    problems = [*rank_problems(scene_with(REFUSED[key]))]
    assert len(problems) == 1
    assert f": {key} " in problems[0]
    assert "does not work with --mpi: " in problems[0]


def test_a_scene_without_these_keys_is_accepted():
    refuse_on_ranks(scene_with({}))


def test_a_gpu_is_refused():
    with pytest.raises(GranflowError, match="--arch vulkan does not work with --mpi"):
        refuse_on_ranks(scene_with({}), "vulkan")


def test_check_names_the_keys(tmp_path, capsys):
    path = scene_with(REFUSED["run.time_step"] | REFUSED["output.contacts"]).save(tmp_path / "scene.yaml")
    assert main(["check", str(path)]) == 0
    assert main(["check", str(path), "--mpi"]) == 2
    errors = capsys.readouterr().err
    assert "run.time_step adaptive does not work with --mpi: set it to auto." in errors
    assert "output.contacts true does not work with --mpi: set it to false." in errors
    assert errors.strip().endswith("2 problems found.")


def test_mpi_without_mpi4py_is_refused(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "mpi4py", None)
    path = scene_with({}).save(tmp_path / "scene.yaml")
    assert main(["run", str(path), "--mpi", "--out", str(tmp_path / "out")]) == 2
    assert "--mpi needs mpi4py and an MPI library" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("variable", ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS"])
def test_run_and_resume_in_several_processes_are_refused(variable, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv(variable, "3")
    path = scene_with({}).save(tmp_path / "scene.yaml")
    for arguments in (["run", str(path)], ["resume", str(tmp_path)]):
        assert main(arguments) == 2
        assert "mpirun has started 3 processes" in capsys.readouterr().err
