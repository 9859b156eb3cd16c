"""Walls that only some groups of particles touch: a screen for coarse particles."""

import numpy as np
import pytest
from scene_builders import build_scene, column, particle_group, plane, run_and_sample

from granflow.simulation import Simulation

GRAVITY = 9.81
DIAMETER = 0.004
HEIGHT = 0.02
DURATION = 0.07


def screen_scene():
    """A coarse and a fine ball fall on a screen that holds the coarse one."""
    groups = {
        name: particle_group([[x, 0.0, HEIGHT]], DIAMETER) for name, x in (("coarse", 0.0), ("fine", 0.01))
    }
    return build_scene(
        groups, {"screen": plane([0, 0, 0], [0, 0, 1], groups=["coarse"])}, {"restitution": 1.0}, normal="hertz",
        gravity=[0, 0, -GRAVITY], run={"duration": 2 * DURATION, "time_step": 1e-5, "velocity_max": 1.5},
    )  # fmt: skip


def test_a_screen_holds_one_group_and_lets_the_other_pass(taichi_f64):
    """The fine ball falls freely, z = h - g t^2 / 2; the coarse one bounces elastically from z = r.

    A ball that returns has the height h - g (t - 2 t1 - tc)^2 / 2 where t1 = sqrt(2 (h - r) / g) is the time of
    fall and tc the duration of the impact, below 0.1 ms.
    """
    coarse, fine = np.moveaxis(column(run_and_sample(screen_scene(), DURATION), "position")[1:, :, 2], 1, 0)
    times = DURATION * np.array([1, 2])
    assert fine == pytest.approx(HEIGHT - 0.5 * GRAVITY * times**2, rel=1e-9)
    fall = np.sqrt(2.0 * (HEIGHT - DIAMETER / 2) / GRAVITY)
    assert fall < DURATION < times[1] < 3 * fall
    returned = HEIGHT - 0.5 * GRAVITY * (times - 2.0 * fall) ** 2
    assert coarse == pytest.approx(returned, abs=1e-4 * GRAVITY * 2 * fall)


def test_a_particle_that_changes_its_group_meets_the_screen(taichi_f64):
    simulation = Simulation(screen_scene(), out=None)
    simulation.run(until=0.5 * DURATION)
    simulation.particles.group[:] = "coarse"
    simulation.run()
    assert np.asarray(simulation.particles.position)[1, 2] > 0.0
