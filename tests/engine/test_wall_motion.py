"""Moving walls: their velocity in the middle of the step, and poses that stay on the device."""

import numpy as np
import pytest
from scene_builders import SOFT, box, build_scene, particle_group, plane, run_to_end
from scipy.spatial.transform import Rotation

from granflow.simulation import Simulation

RADIUS, OVERLAP = 0.005, 1e-4
AMPLITUDE, OMEGA, STEP, COUNT = 1e-5, 5e4, 1e-6, 31


def test_friction_uses_the_wall_velocity_in_the_middle_of_the_step(taichi_f64):
    """A particle too heavy to move sticks to a plane that vibrates below it. Its tangential force is Kt times
    the sum

        sum of dt A w cos(w (k - 1/2) dt), k = 1..n  =  A sin(w n dt) (w dt / 2) / sin(w dt / 2)

    with Kt = 8 G sqrt(R d) (Mindlin). w t ends near pi/2, where the velocity has dropped from A w to 0: a
    velocity evaluated half a step early or late changes the sum by A w dt / 2, 2.5 % of it.
    """
    heavy = {"glass": SOFT | {"density": 1e6}}
    motion = {
        "kind": "vibration", "direction": [1, 0, 0], "amplitude": AMPLITUDE, "angular_frequency": OMEGA
    }  # fmt: skip
    scene = build_scene(
        {"ball": particle_group([0.0, 0.0, RADIUS - OVERLAP], 2 * RADIUS)},
        walls={"plate": plane([0, 0, 0], [0, 0, 1]) | {"motion": motion}},
        pair={"restitution": 1.0, "friction": 10.0}, normal="hertz", materials=heavy,
        run={"duration": 1.0, "time_step": STEP, "velocity_max": 1.0},
    )  # fmt: skip
    last, _ = run_to_end(scene, until=COUNT * STEP)
    modulus = SOFT["young_modulus"] / (2 * (1 + SOFT["poisson_ratio"])) / (2 * (2 - SOFT["poisson_ratio"]))
    stiffness = 8 * modulus * np.sqrt(RADIUS * OVERLAP)
    half = 0.5 * OMEGA * STEP
    displacement = AMPLITUDE * np.sin(OMEGA * COUNT * STEP) * half / np.sin(half)
    assert last.particles["force"][0, 0] == pytest.approx(stiffness * displacement, rel=1e-3)


def test_walls_carried_by_two_rotations_close_the_energy_budget(taichi_f64):
    """Spheres in a box on an arm that turns about its own axis, too: they stay inside, and gain what the walls
    work."""
    side, center = 0.03, np.full(3, 0.015)
    motion = [
        {"kind": "rotation", "point": [-0.05, 0.015, 0.0], "axis": [0, 0, 1], "angular_velocity": 40.0},
        {"kind": "rotation", "point": center.tolist(), "axis": [0, 0.6, 0.8], "angular_velocity": -70.0},
    ]
    positions = 0.011 * np.argwhere(np.ones((2, 2, 2))) + 0.0095
    scene = build_scene(
        {"balls": particle_group(positions, 0.01)},
        walls={name: wall | {"motion": motion} for name, wall in box(side).items()},
        pair={"restitution": 0.8, "friction": 0.3}, normal="hertz", numerics={"max_overlap": 0.3},
        run={"duration": 0.02, "time_step": 2e-6, "velocity_max": 6.0},
        output={"interval": 0.02, "energy_budget": True},
    )  # fmt: skip
    last, _ = run_to_end(scene)
    arm = [-0.05, 0.015, 0.0]
    found = last.particles["position"]
    for point, axis, angle in (
        (arm, [0, 0, 1], 40.0 * last.time),
        (center, [0, 0.6, 0.8], -70.0 * last.time),
    ):
        back = np.array([Rotation.from_rotvec(-angle * np.array(axis)).apply(each - point) for each in found])
        found = back + point
    nearest = RADIUS * (1.0 - last.totals["overlap_largest"]) - 1e-12
    assert found.min() >= nearest and found.max() <= side - nearest and nearest > 0.9 * RADIUS
    assert last.totals["wall_work"] > 0.5 * last.totals["kinetic_energy"] > 0.0
    assert abs(last.totals["energy_error"]) < 1e-3


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
