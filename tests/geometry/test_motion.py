"""Poses of moving walls: velocities are derivatives of poses; chains, ramps, stages, tables and largest speeds."""

from math import pi

import numpy as np
import pytest
from geometry.motions import oscillation, rotation, surface_velocity, table, translation, vibration

import granflow as gf
from granflow.geometry.motion import MotionTable
from granflow.plan.walls import geometry_speed
from granflow.scene.blocks.motions import poses_at
from granflow.scene.blocks.walls.half_space import half_space
from granflow.scene.blocks.walls.rectangle import rectangle
from granflow.scene.blocks.walls.revolved import cylinder
from granflow.scene.blocks.walls.sphere import sphere

AXIS = (2 / 3, -1 / 3, 2 / 3)
RAMPS = [
    translation(
        (0.1, 0.2, -0.3),
        start=0.1,
        end=0.9,
        initial_velocity=(0.0, -0.4, 0.2),
        ramp_duration=0.25,
        end_ramp_duration=0.1,
    ),
    rotation(
        (0.3, 0.1, 0.2),
        AXIS,
        5.0,
        start=0.3,
        end=0.8,
        initial_angular_velocity=-3.0,
        ramp_duration=0.2,
        end_ramp_duration=0.1,
    ),
]
CHAIN = [
    translation((0.4, -0.2, 0.1), start=0.1),
    rotation((0.3, 0.1, 0.2), AXIS, 3.0, start=0.2),
    oscillation((0.1, -0.3, 0.2), (0.0, 0.6, 0.8), 0.4, 6.0, phase=0.3, start=0.3, end=0.9),
    vibration((0.6, 0.0, 0.8), 0.02, 8.0, phase=0.7, start=0.2, end=0.8),
    table((0.0, 0.35, 0.8), start=0.1, angles=(0.0, 0.5, 0.2), point=(0.0, 0.2, 0.1), axis=(1.0, 0.0, 0.0)),
    translation((0.0, 0.1, 0.3), start=0.35, end=0.8),
]
"""Each motion is carried by those before it."""

SWITCHES = np.array([0.1, 0.2, 0.3, 0.35, 0.5, 0.8, 0.9])
"""Times [s] at which rates change."""


def moved(points, motions, times):
    """Positions (k, n, 3) and velocities at times (k,) of points (n, 3) given in the initial pose."""
    poses = poses_at(motions, times)
    arms = np.einsum("kij,nj->kni", poses.rotation, points - poses.pivot)
    velocity = poses.velocity[:, None, :] + np.cross(poses.angular_velocity[:, None, :], arms)
    return arms + poses.pivot + poses.offset[:, None, :], velocity


@pytest.mark.parametrize(("motions", "rounding"), [(RAMPS, 1e-15), (CHAIN, 2e-15)])
def test_velocity_is_the_derivative_of_the_pose(motions, rounding):
    """Third derivatives: 3 w (dw/dt) r + w^3 r, below 1e4, of the ramps; of the chain w^3 r < 10^3 * 5, with the
    sum of all rates below 3 + 0.4 * 6 + 3 = 8.4. Before all motions and after the ramps it is at rest."""
    points = np.random.default_rng(3).uniform(-1, 1, (5, 3))
    step = 1e-6
    times = np.random.default_rng(4).uniform(-0.1, 1.1, 400)
    times = times[np.abs(times[:, None] - SWITCHES).min(axis=1) > 2 * step]
    _, velocity = moved(points, motions, times)
    before, after = (moved(points, motions, times + change)[0] for change in (-step, step))
    difference = (after - before) / (2 * step)
    np.testing.assert_allclose(velocity, difference, atol=1e4 * step**2 / 6 + rounding / step)
    early, still = moved(points, motions, np.array([-5.0, 0.05]))
    np.testing.assert_allclose(early, [points, points], atol=1e-15)
    assert not still.any()
    if motions is RAMPS:
        assert not moved(points, motions, np.array([0.9, 50.0]))[1].any()


def rotated(points, about, axis, angle):
    """Points (n, 3) after a rotation (Rodrigues), written for one angle."""
    arm = points - np.asarray(about)
    along = np.outer(arm @ axis, axis)
    return about + along + np.cos(angle) * (arm - along) + np.sin(angle) * np.cross(axis, arm)


def test_motions_of_a_list_are_a_chain():
    """The last motion moves the wall, each one before it moves the result; displacements begin with 0."""
    points = np.random.default_rng(5).uniform(-1, 1, (4, 3))
    swing = CHAIN[4].angle_and_rate(np.array([0.7]))[0][0]
    expected = points + 0.35 * np.array([0.0, 0.1, 0.3])
    expected = rotated(expected, [0.0, 0.2, 0.1], [1.0, 0.0, 0.0], swing)
    expected = expected + 0.02 * (np.sin(8.0 * 0.5 + 0.7) - np.sin(0.7)) * np.array([0.6, 0.0, 0.8])
    angle = 0.4 * (np.sin(6.0 * 0.4 + 0.3) - np.sin(0.3))
    expected = rotated(expected, [0.1, -0.3, 0.2], [0.0, 0.6, 0.8], angle)
    expected = rotated(expected, [0.3, 0.1, 0.2], AXIS, 3.0 * 0.5) + 0.6 * np.array([0.4, -0.2, 0.1])
    np.testing.assert_allclose(moved(points, CHAIN, np.array([0.7]))[0][0], expected, atol=1e-14)


DOMAIN = gf.Domain(min=[0.0, 0.0, 0.0], max=[1.0, 0.5, 0.2], on_exit="delete")
EXPANDING = DOMAIN.model_copy(update={"on_exit": "expand"})


def test_speed_of_a_plate_is_that_of_its_farthest_point_in_the_domain():
    """w R: R is the distance of the farthest corner of the plate from the axis z through P, or that of the
    domain from the axis if this is smaller; rotation leaves a drum and a ball on the axis unchanged."""
    inside = rectangle((0.9, 0.1, 0.0), (0.1, 0.0, 0.0), (0.0, 0.0, 0.1))
    beyond = rectangle((0.9, 0.1, 0.0), (7.0, 0.0, 0.0), (0.0, 0.0, 0.1))
    axis = (-3.0, 0.1, 5.0)
    turning = rotation(axis, (0, 0, 1), 2.0)
    corner_of_domain = np.hypot(4.0, 0.4)
    ramp = rotation(axis, (0, 0, 1), 2.0, initial_angular_velocity=-3.0, ramp_duration=0.2)
    carrying = translation((0.3, 0.0, 0.0), end=0.5)
    for surface, motions, box, expected in (
        (inside, [turning], DOMAIN, 2.0 * 4.0),
        (beyond, [turning], DOMAIN, 2.0 * corner_of_domain),
        (beyond, [turning], EXPANDING, 2.0 * 10.9),
        (half_space((0, 0, 0), (1, 0, 0)), [turning], DOMAIN, 2.0 * corner_of_domain),
        (inside, [ramp, carrying], DOMAIN, 3.0 * corner_of_domain + 0.3),
        (inside, [ramp, carrying], EXPANDING, 3.0 * (np.hypot(4.0, 5.0) + 0.15) + 0.3),
        (beyond, [carrying, turning], DOMAIN, 0.3 + 2.0 * (corner_of_domain + 0.15)),
        (inside, [vibration((0, 0, 1), 0.01, 10.0)], DOMAIN, 0.1),
        (cylinder((-3.0, 0.1, 0.0), (-3.0, 0.1, 1.0), 0.5), [turning], EXPANDING, 0.0),
        (cylinder((-2.0, 0.1, 0.0), (-2.0, 0.1, 1.0), 0.5), [turning], EXPANDING, 2.0 * 1.5),
        (sphere((-3.0, 0.1, 1.0), 0.5), [turning], EXPANDING, 0.0),
    ):
        assert geometry_speed(surface, motions, box, 1.0) == pytest.approx(expected)


def test_ramps_change_velocities_linearly():
    """At the start from v0 to v over the way (v0 + v) T / 2, at the end from v to 0 over v T / 2.

    A stage that ends half-way through the ramp to v leaves v / 2, which decreases.
    """
    first, last = np.array([0.0, -0.4, 0.2]), np.array([0.1, 0.2, -0.3])
    found = poses_at(RAMPS[:1], np.array([0.1, 0.225, 0.35, 0.8, 0.85, 0.9 - 1e-12, 5.0]))
    expected = [first, (first + last) / 2, last, last, last / 2, 0.0 * last, 0.0 * last]
    np.testing.assert_allclose(found.velocity, expected, atol=1e-11)
    in_ramp = 0.25 * (first + last) / 2
    ways = [in_ramp + after * last for after in (0.0, 0.45, 0.45 + 0.0375, 0.5, 0.5)]
    np.testing.assert_allclose(found.offset[2:], ways, atol=1e-11)
    given = gf.Translation(velocity=[0.4, 0, 0], ramp_duration=1.0, end_ramp_duration=0.2, stages=["push"])
    during, after = (given.numeric((0.0,) * 3).at({"push": (0.0, end)}) for end in (np.inf, 0.5))
    np.testing.assert_allclose(poses_at([during], np.array([0.5, 1.0])).velocity[:, 0], [0.2, 0.4])
    found = poses_at([after], np.array([0.5, 0.6, 0.7, 1.0]))
    np.testing.assert_allclose(found.velocity[:, 0], [0.2, 0.1, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(found.offset[:, 0], 0.05 + np.array([0.0, 0.015, 0.02, 0.02]), atol=1e-15)


def test_a_motion_pauses_in_the_stages_between_its_stages():
    """It continues from the pose and the phase that it had, also if its stages are written in another order."""
    shaken = gf.Vibration(direction=[0, 0, 1], amplitude=0.01, frequency=0.9, stages=["second", "first"])
    shaken = shaken.numeric((0.0, 0.0, 0.0))
    begun = {"first": (0.0, 0.3), "rest": (0.3, np.inf)}
    second = {"first": (0.0, 0.3), "rest": (0.3, 0.7), "second": (0.7, np.inf)}
    times = np.array([0.3, 0.5, 0.9])
    expected = poses_at([shaken.at({"first": (0.0, np.inf)})], times).offset
    np.testing.assert_array_equal(poses_at([shaken.at(begun)], np.array([0.5, 0.6])).offset, expected[[0, 0]])
    np.testing.assert_allclose(poses_at([shaken.at(second)], 0.4 + times).offset, expected, atol=1e-16)
    without_pause = shaken.at({"first": (0.0, 0.3), "second": (0.3, np.inf)})
    np.testing.assert_array_equal(poses_at([without_pause], times).offset, expected)


def test_surface_velocity_turns_with_the_wall_and_does_not_move_it():
    ramp = {"initial_velocity": (0.0, 1.0, 0.0), "ramp_duration": 1.0}
    surface = surface_velocity((0.0, 3.0, 0.0), start=0.5, **ramp)
    turning = rotation((1, 0, 0), (0, 0, 1), pi / 2)
    times = np.array([0.4, 1.0, 2.0])
    found, alone = (poses_at(motions, times) for motions in ([turning, surface], [turning]))
    np.testing.assert_allclose(found.surface_velocity, [[0, 0, 0], [-2, 0, 0], [0, -3, 0]], atol=1e-15)
    np.testing.assert_array_equal(found.velocity, alone.velocity)
    np.testing.assert_array_equal(found.offset, alone.offset)


TIMES, VALUES = (0.0, 0.2, 0.5, 0.6, 1.0), (0.3, 0.4, 0.4, 1.0, 0.1)
RATES = (0.0, 2.0, 2.0, -1.0, 0.0)
BY_VALUES, BY_RATES = MotionTable.of_values(TIMES, VALUES), MotionTable.of_rates(TIMES, RATES)
FASTEST_BETWEEN = MotionTable.of_values((0.0, 0.3, 0.7, 0.8, 1.0), (0.0, 0.03, 0.5, 0.53, 0.55))
"""The largest rate is between the second and the third row, at which the rates are not 0."""


def test_displacements_of_a_table_pass_through_its_rows_without_overshoot_and_velocities_are_linear():
    """The first row is the rest position; the displacement is constant between equal rows."""
    np.testing.assert_allclose(BY_VALUES.at(np.array(TIMES))[0], np.array(VALUES) - VALUES[0], atol=1e-15)
    times = np.linspace(0.0, 0.999, 1001)
    values, _ = BY_VALUES.at(times)
    row = np.minimum(np.searchsorted(TIMES, times, side="right") - 1, 3)
    ends = np.sort([np.array(VALUES)[row + k] - VALUES[0] for k in (0, 1)], axis=0)
    assert (values >= ends[0] - 1e-12).all() and (values <= ends[1] + 1e-12).all()
    np.testing.assert_allclose(BY_RATES.at(times)[1], np.interp(times, TIMES, RATES), atol=1e-13)
    assert BY_RATES.at(np.array([0.0, 0.5]))[0] == pytest.approx([0.0, 0.5 * 0.2 * 2.0 + 0.3 * 2.0])


@pytest.mark.parametrize("course", [BY_VALUES, BY_RATES, FASTEST_BETWEEN])
def test_rates_of_a_table_are_continuous_derivatives_within_their_bounds(course):
    step, times = 1e-6, np.linspace(0.001, 0.999, 4999)
    _, rate = course.at(times)
    slope = (course.at(times + step)[0] - course.at(times - step)[0]) / (2 * step)
    np.testing.assert_allclose(rate, slope, atol=1.1 * step * course.largest_change_of_rate)
    assert 0.999 * course.largest_rate < np.abs(rate).max() <= course.largest_rate * (1 + 1e-12)
    change = np.abs(np.diff(rate) / np.diff(times)).max()
    assert 0.98 * course.largest_change_of_rate < change <= course.largest_change_of_rate * (1 + 1e-9)
    assert course.shortest_step == pytest.approx(0.1)


def test_a_wall_is_at_rest_outside_of_its_table():
    along_x = {"displacements": (0.0, 3.0), "direction": (1.0, 0.0, 0.0)}
    found = poses_at([table((0.1, 0.2), **along_x, start=1.0, end=1.15)], np.array([0.0, 1.05, 1.12, 9.0]))
    np.testing.assert_allclose(found.offset[:, 0], [0.0, 0.0, 0.6, 1.5], atol=1e-12)
    np.testing.assert_allclose(found.velocity[:, 0], [0.0, 0.0, 30.0, 0.0], atol=1e-12)
    turning = table((0.0, 1.0, 2.0), angles=(0.0, pi / 2, pi), point=(1, 0, 0), axis=(0, 0, 1))
    assert turning.top_speed(2.0) == pytest.approx(pi)
