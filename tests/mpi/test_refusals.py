"""Scenes and launches that do not work with --mpi: one sentence each."""

import sys

import pytest
from plan.scenes import TEXT
from scene_builders import LIQUID, build_scene, particle_group

from granflow.cli.main import main
from granflow.errors import GranflowError
from granflow.parallel.rank_engine import RankEngine
from granflow.parallel.refusals import refuse_on_ranks


def test_features_without_ranks_are_refused(tmp_path, capsys):
    path = build_scene({"wet": particle_group([[0, 0, 0]], liquid_content=0.01)}, **LIQUID).save(
        tmp_path / "wet.yaml"
    )
    assert main(["check", str(path)]) == 0
    assert main(["check", str(path), "--mpi"]) == 2
    assert "contact.cohesion: capillary_transfer does not work on MPI ranks" in capsys.readouterr().err
    with pytest.raises(GranflowError, match="--arch vulkan does not work with --mpi"):
        refuse_on_ranks("vulkan")
    with pytest.raises(GranflowError, match="Forces from Python do not work on MPI ranks"):
        refuse_on_ranks("cpu", [object()])
    with pytest.raises(GranflowError, match="Changes from Python do not work on MPI ranks"):
        RankEngine.begin_change(object())


def test_launches_without_mpi4py_or_without_the_option_are_refused(tmp_path, capsys, monkeypatch):
    path = tmp_path / "beads.yaml"
    path.write_text(TEXT)
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "mpi4py", None)
        assert main(["run", str(path), "--mpi", "--out", str(tmp_path / "out")]) == 2
    assert "--mpi needs mpi4py and an MPI library" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    for variable in ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS"):
        for arguments in (["run", str(path)], ["resume", str(tmp_path)]):
            with monkeypatch.context() as launched:
                launched.setenv(variable, "3")
                assert main(arguments) == 2
            assert "mpirun has started 3 processes" in capsys.readouterr().err
