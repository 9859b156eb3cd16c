"""A box as a wall: its faces are walls, with the motion of the box."""

import numpy as np
import pytest
from scene_builders import box, build_scene, moving_lattice, particle_group, run_to_end

from granflow.load import scene_of
from granflow.scene.blocks.walls.box import FACES
from granflow.simulation import Simulation

SIZE, GRAVITY = 0.028, 9.81
SHAKEN = {"kind": "vibration", "direction": [0, 0, 1], "amplitude": 1e-3, "frequency": 60.0}


def bed(walls, **parts):
    """27 moving particles."""
    defaults = {
        "pair": {"friction": 0.4}, "gravity": [0.0, 0.0, -GRAVITY],
        "run": {"duration": 0.01, "velocity_max": 3.0},
        "output": {"interval": 1.0, "energy_budget": True, "wall_forces": True},
    }  # fmt: skip
    return build_scene({"bed": moving_lattice((3, 3, 3), 0.006, 0.5)}, walls=walls, **(defaults | parts))


def box_wall(**more):
    return {"shape": "box", "min": [0, 0, 0], "max": [SIZE] * 3, "material": "glass"} | more


def test_a_box_gives_the_motion_of_six_planes(taichi_f64):
    """The same walls, in another order: the sums of forces are exact, so that the bits are equal."""
    planes = {name: wall | {"motion": SHAKEN} for name, wall in box(SIZE).items()}
    expected, _ = run_to_end(bed(planes))
    found, _ = run_to_end(bed({"case": box_wall(motion=SHAKEN)}))
    np.testing.assert_array_equal(found.particles["position"], expected.particles["position"])
    assert list(found.walls) == [f"case.{face}" for face in FACES]
    names = ["low_x", "high_x", "low_y", "high_y", "low_z", "high_z"]
    for face, name in zip(FACES, names, strict=True):
        np.testing.assert_array_equal(found.impulses[f"case.{face}"], expected.impulses[name], err_msg=face)
        np.testing.assert_array_equal(found.walls[f"case.{face}"].offset, expected.walls[name].offset)


def test_open_faces_have_no_wall_and_particles_leave_through_them(taichi_f64):
    scene = build_scene(
        {"ball": particle_group([0.014, 0.014, 0.014], velocity=[1.0, 0.0, 0.0])},
        walls={"case": box_wall(open=["right", "top"])}, run={"duration": 0.04, "velocity_max": 2.0},
    )  # fmt: skip
    assert list(scene.walls) == ["case.left", "case.front", "case.back", "case.bottom"]
    last, _ = run_to_end(scene)
    assert last.particles["position"][0, 0] == pytest.approx(0.014 + 0.04, rel=1e-3)


def test_a_finite_box_has_pressures_and_carries_the_weight(taichi_f64):
    """One sphere at rest on the bottom: p = m g / A; the sides are at the given positions."""
    scene = build_scene(
        {"ball": particle_group([0.014, 0.014, 0.005 - 1.87e-6])}, walls={"case": box_wall(finite=True, open=["top"])},
        gravity=[0, 0, -GRAVITY], normal="hertz", pair={"restitution": 0.1},
        run={"duration": 0.02, "velocity_max": 0.5}, output={"interval": 1.0, "wall_forces": ["case.bottom"]},
    )  # fmt: skip
    simulation = Simulation(scene)
    found = simulation.run().numbers
    simulation.free()
    weight = 4 / 3 * np.pi * 0.005**3 * 2500 * GRAVITY
    assert found["wall_pressure.case.bottom"] == pytest.approx(weight / SIZE**2, rel=0.01)
    assert scene.walls["case.right"].corner == (SIZE, 0.0, 0.0)
    assert scene.walls["case.right"].sides == ((0.0, SIZE, 0.0), (0.0, 0.0, SIZE))


def test_the_resolved_scene_with_faces_has_the_same_walls_when_read():
    scene = bed({"case": box_wall(motion=SHAKEN, open=["top"])})
    assert scene_of(scene.to_yaml(), "scene.yaml").walls == scene.walls
