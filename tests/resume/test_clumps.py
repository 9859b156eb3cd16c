"""Runs with clumps continue from a checkpoint with the same bits."""

import pytest
from engine.test_clumps import falling_clumps
from resume.test_bit_identity import assert_identical, resume_copy, run_to_end

from granflow.io.checkpoint import read_checkpoint


@pytest.fixture(scope="module")
def scene():
    """Clumps, single spheres and rain of clumps; an outlet deletes some."""
    outlets = {"out": {"box": {"min": [-1.0, -1.0, -1.0], "max": [0.012, 0.012, 0.004]}}}
    return falling_clumps(outlets=outlets)


@pytest.fixture(scope="module")
def checkpoints(scene, tmp_path_factory, taichi_f64):
    """Checkpoints of a whole run."""
    return run_to_end(scene, tmp_path_factory.mktemp("run") / "whole")


@pytest.mark.parametrize("number", [4, 10])
def test_resumed_run_is_bit_identical(scene, checkpoints, tmp_path, number):
    whole = checkpoints[0].parent
    saved = read_checkpoint(checkpoints[number]).saved["engine"]
    assert len(saved["contacts"]["partner"]) > 3
    resume_copy(scene, whole, tmp_path / "again", checkpoints[number])
    assert_identical(whole, tmp_path / "again")
    last = read_checkpoint(checkpoints[-1]).saved["engine"]
    assert last["accounting"]["deleted_count"] > 0 and last["accounting"]["inserted_count"] == 157
