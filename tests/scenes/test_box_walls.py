"""A box as a wall: its faces are walls, with the motion of the box."""

import numpy as np
import pytest
from scene_builders import box, build_scene, particle_group

from granflow.load import scene_of
from granflow.scene.blocks.walls.box import FACES
from granflow.simulation import Simulation

SIZE, GRAVITY = 0.028, 9.81
SHAKEN = {"kind": "vibration", "direction": [0, 0, 1], "amplitude": 1e-3, "frequency": 60.0}


def box_wall(**more):
    return {"shape": "box", "min": [0, 0, 0], "max": [SIZE] * 3, "material": "glass"} | more


def test_a_box_is_six_planes_with_its_motion():
    planes = {name: wall | {"motion": SHAKEN} for name, wall in box(SIZE).items()}
    ball = {"ball": particle_group([0.5 * SIZE] * 3)}
    found, expected = (
        build_scene(ball, walls).walls for walls in ({"case": box_wall(motion=SHAKEN)}, planes)
    )
    assert list(found) == [f"case.{face}" for face in FACES]
    names = ["low_x", "high_x", "low_y", "high_y", "low_z", "high_z"]
    assert list(found.values()) == [expected[name] for name in names]


def test_a_finite_box_with_open_faces_has_pressures_and_carries_the_weight(taichi_f64):
    """One sphere at rest on the bottom: p = m g / A; another one leaves through an open side at 1 m/s."""
    balls = particle_group(
        [[0.014, 0.014, 0.005 - 1.87e-6], [0.014, 0.014, 0.02]], velocity=[[0.0] * 3, [1.0, 0.0, 1.0]]
    )
    scene = build_scene(
        {"balls": balls}, walls={"case": box_wall(finite=True, open=["right", "top"])},
        gravity=[0, 0, -GRAVITY], normal="hertz", pair={"restitution": 0.1},
        run={"duration": 0.03, "velocity_max": 1.5}, output={"interval": 1.0, "wall_forces": ["case.bottom"]},
    )  # fmt: skip
    assert list(scene.walls) == ["case.left", "case.front", "case.back", "case.bottom"]
    simulation = Simulation(scene)
    found = simulation.run().numbers
    position = simulation.particles.position[1, 0]
    simulation.free()
    assert position == pytest.approx(0.014 + 0.03, rel=1e-3)
    weight = 4 / 3 * np.pi * 0.005**3 * 2500 * GRAVITY
    assert found["wall_pressure.case.bottom"] == pytest.approx(weight / SIZE**2, rel=0.01)
    assert scene_of(scene.to_yaml(), "scene.yaml").walls == scene.walls
