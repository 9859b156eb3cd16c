"""The time loop: single steps, and particles from arrays."""

from dataclasses import replace

import numpy as np
import pytest
from scene_builders import build_scene, particle_group, plane

from granflow import GranflowError, Simulation
from granflow.particles.insertion import initial_particles


def falling(**more):
    """Two particles above a floor."""
    groups = {"balls": particle_group([[0.0, 0.0, 0.02], [0.02, 0.0, 0.02]], velocity=[0.0, 0.0, -1.0])}
    return build_scene(
        groups, walls={"floor": plane([0.0] * 3, [0.0, 0.0, 1.0])}, run={"duration": 1e-3}, **more
    )


def test_steps_equal_a_run_to_the_same_time(taichi_f64):
    stepped = Simulation(falling())
    ran = Simulation(falling())
    for count in (1, 4):
        stepped.step(count)
    ran.run(until=5 * ran.time_step)
    first = stepped.snapshot()
    second = ran.snapshot()
    assert first.step == second.step == 5
    np.testing.assert_array_equal(first.particles["position"], second.particles["position"])
    stepped.free()
    ran.free()


def test_particles_from_arrays_replace_those_of_the_scene(taichi_f64):
    given = initial_particles(falling())
    given = replace(given, position=given.position + [0.0, 0.0, 0.5])
    simulation = Simulation(falling(), particles=given)
    np.testing.assert_array_equal(simulation.snapshot().particles["position"], given.position)
    simulation.free()
    with pytest.raises(GranflowError, match="radius lies in"):
        Simulation(falling(), particles=replace(given, radius=2.0 * given.radius))
