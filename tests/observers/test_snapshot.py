"""Snapshots are read-only and can be pickled."""

import pickle

import numpy as np
import pytest
from observers.snapshots import contacts_of, snapshot_of, turned


def test_every_array_is_read_only():
    snapshot = snapshot_of(contacts=contacts_of(4), walls={"gate": turned(0.5)})
    pose = snapshot.walls["gate"]
    arrays = [
        *snapshot.particles.values(), *snapshot.contacts.values(), pose.offset, pose.rotation, pose.pivot
    ]  # fmt: skip
    for values in arrays:
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 1


def test_every_mapping_is_read_only_and_the_source_stays_writable():
    for part in ("particles", "contacts", "walls", "totals"):
        with pytest.raises(TypeError):
            getattr(snapshot_of(contacts=contacts_of(4)), part)["radius"] = 1
    array = np.zeros(3)
    snapshot_of(particles={"radius": array})
    array[0] = 1.0


def test_pickled_snapshot_is_equal_and_read_only():
    snapshot = snapshot_of(time=0.5, step=7, contacts=contacts_of(4), walls={"gate": turned(0.5)})
    copy = pickle.loads(pickle.dumps(snapshot))
    assert (copy.time, copy.step, copy.stage, copy.totals) == (0.5, 7, "run", snapshot.totals)
    np.testing.assert_array_equal(copy.particles["position"], snapshot.particles["position"])
    np.testing.assert_array_equal(copy.walls["gate"].rotation, snapshot.walls["gate"].rotation)
    assert not copy.particles["position"].flags.writeable


def test_pose_rotates_about_the_pivot_and_then_translates():
    pose = turned(np.pi / 2, offset=(0, 0, 3), pivot=(1, 0, 0))
    np.testing.assert_allclose(pose.moved(np.array([[2.0, 0.0, 0.0]])), [[1.0, 1.0, 3.0]], atol=1e-15)
