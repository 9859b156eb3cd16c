"""Scenes and launches that do not work with --mpi: one sentence each."""

import sys

import pytest
from clumps import clump_group
from scene_builders import build_scene, particle_group, plane

from granflow.cli.main import main
from granflow.errors import GranflowError
from granflow.parallel import refusals
from granflow.parallel.rank_engine import RankEngine
from granflow.parallel.refusals import refuse_on_ranks


def scene_with(changes):
    """A scene with a particle above a floor."""
    parts = {"walls": {"floor": plane([0, 0, -0.5], [0, 0, 1])}} | changes
    return build_scene({"beads": particle_group([[0.0, 0.0, 0.0]])}, parts.pop("walls"), **parts)


def test_a_gpu_is_refused():
    with pytest.raises(GranflowError, match="--arch vulkan does not work with --mpi"):
        refuse_on_ranks("vulkan")


def test_another_kernel_language_is_refused_by_check(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(refusals, "KERNELS", "quadrants")
    path = scene_with({}).save(tmp_path / "scene.yaml")
    assert main(["check", str(path), "--mpi"]) == 2
    assert (
        "GRANFLOW_KERNELS=quadrants does not work with --mpi: unset GRANFLOW_KERNELS."
        in capsys.readouterr().err
    )
    assert main(["check", str(path)]) == 0


def test_clumps_are_refused_by_check(tmp_path, capsys):
    path = build_scene({"rods": clump_group([[0, 0, 0]])}).save(tmp_path / "scene.yaml")
    assert main(["check", str(path), "--mpi"]) == 2
    assert "Clumps do not work on MPI ranks" in capsys.readouterr().err
    assert main(["check", str(path)]) == 0


def test_liquid_transfer_is_refused_by_check(tmp_path, capsys):
    cohesion = {"law": "capillary_transfer", "max_bridge_volume": 1e-9}
    pair = {"surface_tension": 0.07, "contact_angle": 0.0}
    contact = {"normal": "hertz", "tangential": "mindlin", "rolling": "none", "cohesion": cohesion}
    wet = particle_group([[0, 0, 0]], liquid_content=0.01)
    path = build_scene({"wet": wet}, pair=pair, contact=contact).save(tmp_path / "scene.yaml")
    assert main(["check", str(path), "--mpi"]) == 2
    assert "contact.cohesion: capillary_transfer does not work on MPI ranks" in capsys.readouterr().err
    assert main(["check", str(path)]) == 0


def test_forces_from_python_are_refused():
    with pytest.raises(GranflowError, match="Forces from Python do not work on MPI ranks"):
        refuse_on_ranks("cpu", [object()])


def test_changes_from_python_are_refused():
    with pytest.raises(GranflowError, match="Changes from Python do not work on MPI ranks"):
        RankEngine.begin_change(object())


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
