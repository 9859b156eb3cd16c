"""Counts of `collision_energies.csv` in checkpoints: integers, and values that are refused."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from granflow.io.checkpoint import CheckpointError
from granflow.observers.timeseries import CollisionEnergies
from granflow.runs.checkpoint_checks import check_observers
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
    fresh = {"collisions": CollisionEnergies(directory, 1.0, EDGES).state_dict()}
    check_observers(SimpleNamespace(path=Path("c.ckpt"), saved={"observers": {"collisions": state}}), fresh)


def test_saved_counts_are_integers(tmp_path):
    state = observed(tmp_path).state_dict()
    assert [(each.dtype, each.tolist()) for each in state["counted"].values()] == [(np.int64, [5, 5, 5])] * 2
    check(tmp_path, state)
    resumed = CollisionEnergies(tmp_path, 1.0, EDGES)
    resumed.load_state_dict(state)
    assert resumed.state_dict()["counted"]["wall"].tolist() == [5, 5, 5]


@pytest.mark.parametrize(
    ("counts", "sentence"),
    [
        (np.full(3, 5.0), "but must be an array (3,) of whole numbers"),
        (np.full(2, 5), "but must be an array (3,) of whole numbers"),
        (np.full(3, -1), "holds -1, but must lie in"),
    ],
)
def test_damaged_counts_are_refused(tmp_path, counts, sentence):
    state = observed(tmp_path).state_dict()
    state["counted"]["wall"] = counts
    with pytest.raises(CheckpointError) as caught:
        check(tmp_path, state)
    assert sentence in str(caught.value)
