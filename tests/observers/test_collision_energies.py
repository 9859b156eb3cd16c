"""Counts of `collision_energies.csv` in checkpoints: integers, and values that are refused."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from granflow.io.checkpoint import CheckpointError
from granflow.observers.timeseries import CollisionEnergies
from granflow.runs.resume import refuse_other_keys
from granflow.snapshot import Snapshot

EDGES = np.array([1e-6, 1e-4])


def observed(directory):
    """An observer after two snapshots."""
    observer = CollisionEnergies(directory, 1.0, EDGES)
    for time, count in ((0.0, 0), (1.0, 5)):
        counts = {kind: np.full(3, count) for kind in ("particle", "wall")}
        observer.observe(Snapshot(time, 0, "run", {}, None, {}, {}, {}, counts))
    return observer


def check(directory, state):
    """Check the state of an observer as at the start of a resumed run."""
    checkpoint = SimpleNamespace(path=Path("c.npz"), saved={"observers": {"collisions": state}})
    fresh = CollisionEnergies(directory, 1.0, EDGES).state_dict()
    refuse_other_keys(checkpoint, "observers/collisions", fresh)


def test_saved_counts_are_integers(tmp_path):
    state = observed(tmp_path).state_dict()
    assert [(each.dtype, each.tolist()) for each in state["counted"].values()] == [(np.int64, [5, 5, 5])] * 2
    check(tmp_path, state)
    resumed = CollisionEnergies(tmp_path, 1.0, EDGES)
    resumed.load_state_dict(state)
    assert resumed.state_dict()["counted"]["wall"].tolist() == [5, 5, 5]


def test_counts_of_other_classes_are_refused(tmp_path):
    state = observed(tmp_path).state_dict()
    state["counted"]["wall"] = np.full(2, 5)
    with pytest.raises(CheckpointError, match="collisions/counted/wall does not fit the scene"):
        check(tmp_path, state)
