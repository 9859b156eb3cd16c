"""Poses of moving walls stay on the device between rows of the time series."""

import numpy as np
from scene_builders import SOFT, build_scene, particle_group, plane

from granflow.engine import walls as wall_poses
from granflow.plan.capacities import POSE_COUNT
from granflow.simulation import Simulation

MOTION = {"kind": "vibration", "direction": [0, 0, 1], "amplitude": 1e-4, "frequency": 200.0}


def simulation_on_a_shaken_floor():
    """A ball in contact with a vibrating floor."""
    scene = build_scene(
        {"ball": particle_group([0.0, 0.0, 0.00499])},
        walls={"floor": plane([0, 0, 0], [0, 0, 1]) | {"motion": MOTION}},
        materials={"glass": SOFT}, run={"duration": 1.0, "time_step": 1e-6, "velocity_max": 1.0},
        output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip
    return Simulation(scene)


def test_snapshots_between_steps_upload_no_poses(taichi_f64, monkeypatch):
    """300 steps with a snapshot after each 10 need the uploads of the start, and one per POSE_COUNT steps."""
    simulation = simulation_on_a_shaken_floor()
    uploads = []
    upload = wall_poses.upload_poses
    monkeypatch.setattr(
        wall_poses, "upload_poses", lambda state, step: (uploads.append(step), upload(state, step))
    )
    for _ in range(30):
        simulation.step(10)
        simulation.snapshot(contacts=True)
    rebuilds = simulation.engine.timing.rebuild_count
    assert len(uploads) <= 2 + rebuilds + 300 // POSE_COUNT
    simulation.free()


def test_snapshot_at_any_pose_of_the_batch_is_bit_identical(taichi_f64):
    """A snapshot with the poses on the device equals one after a new upload, whose first pose is the present
    one."""
    simulation = simulation_on_a_shaken_floor()
    for steps in (1, 99, 155, 1):
        simulation.step(steps)
        found = simulation.snapshot(contacts=True)
        simulation.engine.stepper.poses.discard()
        again = simulation.snapshot(contacts=True)
        assert len(found.contacts["overlap"]) == 1
        assert found.totals == again.totals
        for name, values in found.contacts.items():
            np.testing.assert_array_equal(values, again.contacts[name], err_msg=name)
    simulation.free()
