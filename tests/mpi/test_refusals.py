"""Scenes and launches that do not work with --mpi: one sentence each."""

import sys

import pytest
from scene_builders import build_scene, particle_group

from granflow.cli.main import main
from granflow.errors import GranflowError
from granflow.parallel.rank_engine import RankEngine
from granflow.parallel.refusals import refuse_on_ranks


def particle_scene():
    """A scene with one particle."""
    return build_scene({"beads": particle_group([[0.0, 0.0, 0.0]])})


WET = {
    "pair": {"surface_tension": 0.07, "contact_angle": 0.0},
    "contact": {
        "normal": "hertz", "tangential": "mindlin", "rolling": "none",
        "cohesion": {"law": "capillary_transfer", "max_bridge_volume": 1e-9},
    },
}  # fmt: skip
REFUSED = {
    "contact.cohesion: capillary_transfer does not work on MPI ranks": lambda: build_scene(
        {"wet": particle_group([[0, 0, 0]], liquid_content=0.01)}, **WET
    ),
}


@pytest.mark.parametrize("message", REFUSED)
def test_scene_is_refused_by_check(tmp_path, capsys, message):
    path = REFUSED[message]().save(tmp_path / "scene.yaml")
    assert main(["check", str(path), "--mpi"]) == 2
    assert message in capsys.readouterr().err
    assert main(["check", str(path)]) == 0


def test_gpu_and_python_are_refused():
    with pytest.raises(GranflowError, match="--arch vulkan does not work with --mpi"):
        refuse_on_ranks("vulkan")
    with pytest.raises(GranflowError, match="Forces from Python do not work on MPI ranks"):
        refuse_on_ranks("cpu", [object()])
    with pytest.raises(GranflowError, match="Changes from Python do not work on MPI ranks"):
        RankEngine.begin_change(object())


def test_mpi_without_mpi4py_is_refused(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "mpi4py", None)
    path = particle_scene().save(tmp_path / "scene.yaml")
    assert main(["run", str(path), "--mpi", "--out", str(tmp_path / "out")]) == 2
    assert "--mpi needs mpi4py and an MPI library" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("variable", ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS"])
def test_run_and_resume_in_several_processes_are_refused(variable, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv(variable, "3")
    path = particle_scene().save(tmp_path / "scene.yaml")
    for arguments in (["run", str(path)], ["resume", str(tmp_path)]):
        assert main(arguments) == 2
        assert "mpirun has started 3 processes" in capsys.readouterr().err
