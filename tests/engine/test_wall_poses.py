"""Poses of moving walls stay on the device between rows of the time series."""

import numpy as np
from scene_builders import build_scene, particle_group, plane

from granflow.simulation import Simulation

MOTION = {"kind": "vibration", "direction": [0, 0, 1], "amplitude": 1e-4, "frequency": 200.0}


def test_snapshot_at_any_pose_of_the_batch_is_bit_identical(taichi_f64):
    """A snapshot with the poses on the device equals one after a new upload, whose first pose is the present
    one."""
    scene = build_scene(
        {"ball": particle_group([0.0, 0.0, 0.00499])}, {"floor": plane([0, 0, 0], [0, 0, 1], motion=MOTION)},
        run={"duration": 1.0, "time_step": 1e-6, "velocity_max": 1.0}, output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip
    simulation = Simulation(scene)
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
