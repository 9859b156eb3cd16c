"""A spherical wall: oscillation of a ball in it."""

import numpy as np
import pytest
from scene_builders import build_scene, column, particle_group, run_and_sample

GRAVITY = 9.81
RADIUS = 0.05
BALL = 0.005
ANGLE = 0.05


def test_a_ball_oscillates_in_a_sphere_as_a_pendulum(taichi_f64):
    """Without friction its center is a pendulum of length L = R - r:

        T = 2 pi sqrt(L / g) (1 + a^2 / 16),    a = 0.05 rad

    After half a period it rests at the opposite side; after three quarters it passes the lowest point.
    """
    length = RADIUS - BALL
    start = [length * np.sin(ANGLE), 0.0, -length * np.cos(ANGLE)]
    shell = {"shape": "sphere", "center": [0, 0, 0], "radius": RADIUS, "material": "glass"}
    period = 2.0 * np.pi * np.sqrt(length / GRAVITY) * (1.0 + ANGLE**2 / 16.0)
    scene = build_scene(
        {"ball": particle_group([start], 2 * BALL)}, {"shell": shell}, gravity=[0, 0, -GRAVITY],
        pair={"restitution": 0.5}, normal="hertz", run={"duration": 0.75 * period, "time_step": 2e-5, "velocity_max": 0.1},
        output={"interval": 0.25 * period},
    )  # fmt: skip
    half, last = column(run_and_sample(scene, 0.25 * period), "position")[2:, 0]
    assert half[0] == pytest.approx(-start[0], rel=2e-3)
    assert last[0] == pytest.approx(0.0, abs=0.01 * start[0])
    assert last[2] == pytest.approx(-length, rel=1e-3)
