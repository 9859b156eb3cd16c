"""Poses of moving walls: velocities are derivatives of poses; walls are at rest before the start and after
the end."""

from math import pi

import numpy as np
import pytest
from geometry.motions import rotation, surface_velocity, translation, vibration

from granflow.scene.blocks.motions import poses_at, speed_bound
from granflow.scene.blocks.walls.half_space import half_space
from granflow.scene.blocks.walls.rectangle import rectangle
from granflow.scene.blocks.walls.revolved import cylinder, disc
from granflow.scene.reference import json_schema

AXIS = (2 / 3, -1 / 3, 2 / 3)
MOTIONS = [
    vibration((0.6, 0.0, 0.8), 0.01, 2 * pi * 25, phase=0.7, start=0.2, end=0.9),
    translation((0.1, 0.2, -0.3), start=0.1, end=0.5),
    rotation((0.3, 0.1, 0.2), AXIS, 5.0, start=0.3, end=0.8),
]


RAMPS = [
    translation((0.1, 0.2, -0.3), start=0.1, end=0.9, initial_velocity=(0.0, -0.4, 0.2), ramp_duration=0.25),
    rotation(
        (0.3, 0.1, 0.2), AXIS, 5.0, start=0.3, end=0.8, initial_angular_velocity=-3.0, ramp_duration=0.2
    ),
]


def moved(points, motions, times):
    """Positions (k, n, 3) at times (k,) of points (n, 3) given in the initial pose."""
    poses = poses_at(motions, times)
    rotated = np.einsum("kij,nj->kni", poses.rotation, points - poses.pivot)
    return rotated + poses.pivot + poses.offset[:, None, :]


def test_vibration_follows_the_formulas_of_the_schema():
    """The displacement is relative to the position of the wall in the scene."""
    description = json_schema()["$defs"]["Vibration"]["description"]
    formulas = dict(
        line.strip().split(":", 1) for line in description.splitlines() if ": " in line and "*" in line
    )
    assert set(formulas) >= {"displacement", "velocity"}
    amplitude = 2e-3
    angular_frequency = 90.0
    start = 0.01
    times = start + np.linspace(0.0, 0.1, 51)
    for phase in (0.0, 0.7, pi / 2):
        known = {
            "amplitude": amplitude, "angular_frequency": angular_frequency, "phase": phase,
            "t": times - start
        }  # fmt: skip
        expected = {name: eval(formulas[name], {"sin": np.sin, "cos": np.cos, **known}) for name in formulas}
        found = poses_at(
            [vibration((0, 0, 1), amplitude, angular_frequency, phase=phase, start=start)], times
        )
        np.testing.assert_allclose(found.offset[:, 2], expected["displacement"], atol=1e-17)
        np.testing.assert_allclose(found.velocity[:, 2], expected["velocity"], atol=1e-15)
        assert found.offset[0, 2] == 0.0


SWITCHES = np.array([0.1, 0.2, 0.3, 0.35, 0.5, 0.8, 0.9])


@pytest.mark.parametrize(("motions", "third", "rounding"), [(MOTIONS, 3.9e4, 8e-16), (RAMPS, 1e4, 1e-15)])
def test_velocity_is_the_derivative_of_the_pose(motions, third, rounding):
    """Third derivatives: A w^3 = 3.9e4 of the vibration; 3 w (dw/dt) r + w^3 r, below 1e4, of the ramps."""
    points = np.random.default_rng(3).uniform(-1, 1, (5, 3))
    step = 1e-6
    times = np.random.default_rng(4).uniform(-0.1, 1.1, 400)
    times = times[np.abs(times[:, None] - SWITCHES).min(axis=1) > 2 * step]
    poses = poses_at(motions, times)
    arms = moved(points, motions, times) - poses.pivot - poses.offset[:, None, :]
    velocity = poses.velocity[:, None, :] + np.cross(poses.angular_velocity[:, None, :], arms)
    difference = (moved(points, motions, times + step) - moved(points, motions, times - step)) / (2 * step)
    np.testing.assert_allclose(velocity, difference, atol=third * step**2 / 6 + rounding / step)


def test_wall_is_at_rest_before_the_start_and_after_the_end():
    early = poses_at(MOTIONS, np.array([-5.0, 0.0, 0.1]))
    np.testing.assert_array_equal(early.offset, 0.0)
    np.testing.assert_array_equal(early.rotation, np.broadcast_to(np.eye(3), (3, 3, 3)))
    late = poses_at(MOTIONS, np.array([0.9, 1.0, 50.0]))
    for poses in (poses_at(MOTIONS, np.array([-5.0, 0.05])), late):
        np.testing.assert_array_equal(poses.velocity, 0.0)
        np.testing.assert_array_equal(poses.angular_velocity, 0.0)
    np.testing.assert_array_equal(late.offset, np.broadcast_to(late.offset[0], (3, 3)))


def test_rotation_follows_the_right_hand_rule():
    poses = poses_at([rotation((1, 0, 0), (0, 0, 1), pi / 2)], np.array([1.0]))
    np.testing.assert_allclose(poses.rotation[0] @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(
        moved(np.array([[2.0, 0, 0]]), [rotation((1, 0, 0), (0, 0, 1), pi / 2)], 1.0)[0, 0], [1, 1, 0]
    )


def test_speed_bound_is_the_maximum_speed():
    assert speed_bound([], 1.0) == 0.0
    assert speed_bound(RAMPS, 0.4) == pytest.approx(np.sqrt(0.2) + 5.0 * 0.4)
    assert speed_bound([RAMPS[1], translation((0.0, 0.0, 0.1))], 1.0) == pytest.approx(5.1)
    bound = speed_bound(MOTIONS, 0.4)
    assert bound == pytest.approx(0.01 * 50 * pi + np.sqrt(0.14) + 5.0 * 0.4)
    poses = poses_at([vibration((0, 0, 1), 0.01, 10.0)], np.linspace(0, 1, 1000))
    assert np.abs(poses.velocity).max() == pytest.approx(speed_bound([vibration((0, 0, 1), 0.01, 10.0)], 1.0))


def test_ramps_change_velocities_linearly():
    """Half-way through the ramp the velocity is the mean of both; the displacement is that of the mean
    velocity."""
    times = np.array([0.1, 0.225, 0.35, 0.5, 1.0])
    found = poses_at(RAMPS[:1], times)
    first, last = np.array(RAMPS[0].initial_velocity), np.array(RAMPS[0].velocity)
    np.testing.assert_allclose(
        found.velocity, [first, (first + last) / 2, last, last, 0.0 * last], atol=1e-15
    )
    in_ramp = 0.25 * (first + last) / 2
    np.testing.assert_allclose(
        found.offset[2:], [in_ramp, in_ramp + 0.15 * last, in_ramp + 0.55 * last], atol=1e-15
    )


def test_surface_velocity_turns_with_the_wall_and_does_not_move_it():
    surface = surface_velocity(
        (0.0, 3.0, 0.0), start=0.5, initial_velocity=(0.0, 1.0, 0.0), ramp_duration=1.0
    )
    turning = rotation((1, 0, 0), (0, 0, 1), pi / 2)
    found, alone = (
        poses_at(motions, np.array([0.4, 1.0, 2.0])) for motions in ([turning, surface], [turning])
    )
    np.testing.assert_allclose(found.surface_velocity, [[0, 0, 0], [-2, 0, 0], [0, -3, 0]], atol=1e-15)
    for name in ("offset", "rotation", "velocity", "angular_velocity", "pivot"):
        np.testing.assert_array_equal(getattr(found, name), getattr(alone, name))
    assert speed_bound([surface], 1.0) == 0.0


def test_reach_excludes_surfaces_that_rotation_leaves_unchanged():
    origin = np.zeros(3)
    along_z = np.array([0, 0, 1.0])
    along_x = np.array([1.0, 0, 0])
    drum = cylinder([0, 0, 0], [0, 0, 2], 0.5)
    assert drum.reach_about(origin, along_z) == 0.0
    assert drum.reach_about(np.array([1.0, 0, 0]), along_z) == pytest.approx(1.5)
    assert drum.reach_about(origin, along_x) >= np.hypot(2, 0.5)
    assert disc([0, 0, 2], [0, 0, -1], 0.5).reach_about(origin, along_z) == 0.0
    assert rectangle([1, 0, 0], [1, 0, 0], [0, 0, 1]).reach_about(origin, along_z) == 2.0
    assert half_space([0, 0, 0], [0, 0, 1]).reach_about(origin, along_z) == 0.0
    assert half_space([0, 0, 0], [0, 0, 1]).reach_about(origin, along_x) == np.inf
