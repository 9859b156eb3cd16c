"""Stages that end at rest: low kinetic energy of particles whose weight is supported."""

import logging

import numpy as np
import pytest
from scene_builders import build_scene, particle_group, plane

from granflow.runs.stages import REST_CHECKS
from granflow.simulation import Simulation

RADIUS, GRAVITY, DENSITY = 0.005, 9.81, 2500.0
MASS = 4.0 / 3.0 * np.pi * RADIUS**3 * DENSITY
HEIGHT, LONGEST = 0.01, 0.4
FALL_TIME = np.sqrt(2.0 * HEIGHT / GRAVITY)


def settle(gap, energy, gravity=-GRAVITY, **stage):
    """A sphere that starts at rest with a gap [m] above a floor; the stage ends below an energy [J]."""
    stage = {"name": "settle", "kinetic_energy_below": energy, "max_duration": LONGEST} | stage
    return build_scene(
        {"ball": particle_group([0, 0, RADIUS + gap])}, gravity=[0, 0, gravity],
        walls={"floor": plane([0, 0, 0], [0, 0, 1])}, normal="hertz", pair={"restitution": 0.3},
        stages=[stage], run={"velocity_max": 1.0}, output={"interval": 0.01},
    )  # fmt: skip


def end_of(scene):
    """End [s] of the stage, height [m] of the sphere there, and the result."""
    simulation = Simulation(scene)
    result = simulation.run()
    end = simulation._state.progress.stage_times["settle"][1]
    height = simulation.particles.position[0, 2]
    simulation.free()
    return end, height, result


def test_free_fall_from_rest_is_not_rest(taichi_f64, caplog):
    """The energy is below the limit during the whole fall: only the missing support continues the stage."""
    with caplog.at_level(logging.INFO, logger="granflow"):
        end, height, _ = end_of(settle(HEIGHT, 2.0 * MASS * GRAVITY * HEIGHT))
    assert FALL_TIME < end < LONGEST
    assert any(
        "stage settle ends at" in each.message and "of their weight" in each.message
        for each in caplog.records
    )


def test_a_sphere_that_bounces_ends_the_stage_on_the_floor(taichi_f64):
    """Also the tops of bounces, where the velocity is zero, are in free fall."""
    end, height, result = end_of(settle(HEIGHT, 1e-3 * MASS * GRAVITY * RADIUS))
    assert FALL_TIME < end < LONGEST and height == pytest.approx(RADIUS, rel=0.01)
    assert not result.warnings and result.numbers["warning_count"] == 0.0


def test_a_supported_sphere_at_rest_ends_the_stage_after_its_shortest_duration(taichi_f64):
    """At the first check, or after min_duration; checks are LONGEST / REST_CHECKS apart."""
    interval = LONGEST / REST_CHECKS
    energy = 1e-2 * MASS * GRAVITY * RADIUS
    assert end_of(settle(0.0, energy))[0] < FALL_TIME
    shortest = 20.0 * interval
    assert end_of(settle(0.0, energy, min_duration=shortest))[0] == pytest.approx(
        shortest, abs=1.1 * interval
    )


def test_particles_that_do_not_come_to_rest_are_reported(taichi_f64):
    result = end_of(settle(HEIGHT, 1.0, max_duration=0.5 * FALL_TIME))[2]
    assert (
        len(result.warnings) == result.numbers["warning_count"] == 1
        and "the net force on the particles is 1 of their weight" in result.warnings[0]
    )


def test_without_gravity_the_energy_decides(taichi_f64):
    assert end_of(settle(HEIGHT, 1e-12, gravity=0.0))[0] == pytest.approx(LONGEST / REST_CHECKS, rel=0.05)
