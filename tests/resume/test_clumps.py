"""Runs with clumps continue from a checkpoint with the same bits; crafted clumps are rejected."""

import numpy as np
import pytest
from engine.test_clumps import falling_clumps
from resume.test_bit_identity import assert_identical, resume_copy, run_to_end

from granflow.io.checkpoint import CheckpointError, read_checkpoint, write_checkpoint
from granflow.plan.build import plan_for
from granflow.runs.resume import accepted_change


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


def put(name, value):
    """A change of one particle array: function (copy of the array) -> None."""

    def change(particles):
        particles[name] = particles[name].copy()
        value(particles[name])

    return change


CRAFTED = {
    "a clump of ids beyond all particles": put("clump", lambda a: a.__setitem__(0, 10**6)),
    "a sphere of another clump": put("clump", lambda a: a.__setitem__(0, a[0] + 4)),
    "a clump without group": put("clump", lambda a: a.__setitem__(0, -1)),
    "a clump with more spheres": put("clump_size", lambda a: a.__setitem__(slice(None), 10**6)),
    "a light clump": put("clump_mass", lambda a: a.__imul__(0.5)),
    "another inertia": put("clump_inertia", lambda a: a.__imul__(1.5)),
    "another shape": put("clump_offset", lambda a: a.__imul__(1.5)),
    "no rotation": put("orientation", lambda a: a.__imul__(0.0)),
    "an angular momentum that is not finite": put("clump_angular_momentum", lambda a: a.fill(np.nan)),
}


@pytest.mark.parametrize("name", CRAFTED)
def test_crafted_clumps_are_rejected(scene, checkpoints, tmp_path, name):
    original = read_checkpoint(checkpoints[3])
    CRAFTED[name](original.saved["engine"]["particles"])
    path = write_checkpoint(tmp_path, original.scene, original.time, 20, original.saved)
    with pytest.raises(CheckpointError, match=r"engine/particles/(clump|orientation)"):
        accepted_change(read_checkpoint(path), plan_for(scene), allow_changes=False)
