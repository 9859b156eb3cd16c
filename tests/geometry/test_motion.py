"""Poses of moving walls: velocities are derivatives of poses; walls are at rest before the start and after
the end."""

from math import pi

import numpy as np
import pytest
from geometry.motions import oscillation, rotation, surface_velocity, table, translation, vibration

import granflow as gf
from granflow.plan.walls import geometry_speed
from granflow.scene.blocks.motions import poses_at
from granflow.scene.blocks.walls.half_space import half_space
from granflow.scene.blocks.walls.rectangle import rectangle
from granflow.scene.blocks.walls.revolved import cylinder, disc
from granflow.scene.blocks.walls.sphere import sphere
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
STOPPING = [each.model_copy(update={"end_ramp_duration": 0.1}) for each in RAMPS]


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
CHAIN = [
    translation((0.4, -0.2, 0.1), start=0.1),
    rotation((0.3, 0.1, 0.2), AXIS, 3.0, start=0.2),
    oscillation((0.1, -0.3, 0.2), (0.0, 0.6, 0.8), 0.4, 6.0, phase=0.3, start=0.3, end=0.9),
    vibration((0.6, 0.0, 0.8), 0.02, 8.0, start=0.2, end=0.8),
    table((0.0, 0.35, 0.8), start=0.1, angles=(0.0, 0.5, 0.2), point=(0.0, 0.2, 0.1), axis=(1.0, 0.0, 0.0)),
    translation((0.0, 0.1, 0.3), start=0.35, end=0.8),
]
"""Each motion is carried by those before it."""


@pytest.mark.parametrize(
    ("motions", "third", "rounding"),
    [(MOTIONS, 3.9e4, 8e-16), (RAMPS, 1e4, 1e-15), (STOPPING, 1e4, 1e-15), (CHAIN, 1e4, 2e-15)],
)
def test_velocity_is_the_derivative_of_the_pose(motions, third, rounding):
    """Third derivatives: A w^3 = 3.9e4 of the vibration; 3 w (dw/dt) r + w^3 r, below 1e4, of the ramps; of the
    chain w^3 r < 10^3 * 5, with the sum of all rates below 3 + 0.4 * 6 + 3 = 8.4."""
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


def rotated(points, about, axis, angle):
    """Points (n, 3) after a rotation (Rodrigues), written for one angle."""
    arm = points - np.asarray(about)
    along = np.outer(arm @ axis, axis)
    return about + along + np.cos(angle) * (arm - along) + np.sin(angle) * np.cross(axis, arm)


def test_motions_of_a_list_are_a_chain():
    """The last motion moves the wall, each one before it moves the result."""
    points = np.random.default_rng(5).uniform(-1, 1, (4, 3))
    time = 0.7
    expected = points + 0.35 * np.array([0.0, 0.1, 0.3])
    swing = CHAIN[4].angle_and_rate(np.array([time]))[0][0]
    expected = rotated(expected, [0.0, 0.2, 0.1], [1.0, 0.0, 0.0], swing)
    expected = expected + 0.02 * np.sin(8.0 * 0.5) * np.array([0.6, 0.0, 0.8])
    angle = 0.4 * (np.sin(6.0 * 0.4 + 0.3) - np.sin(0.3))
    expected = rotated(expected, [0.1, -0.3, 0.2], [0.0, 0.6, 0.8], angle)
    expected = rotated(expected, [0.3, 0.1, 0.2], AXIS, 3.0 * 0.5)
    expected = expected + 0.6 * np.array([0.4, -0.2, 0.1])
    np.testing.assert_allclose(moved(points, CHAIN, np.array([time]))[0], expected, atol=1e-14)


def test_pot_of_a_planetary_mill():
    """The center of the pot circles the axis of the mill; the pot turns by the difference to space."""
    arm, orbit, spin = 0.1, 30.0, -75.0
    mill = [rotation((0, 0, 0), (0, 0, 1), orbit), rotation((arm, 0, 0), (0, 0, 1), spin)]
    times = np.linspace(0.0, 0.3, 7)
    point = np.array([[arm + 0.03, 0.0, 0.02]])
    turned = (orbit + spin) * times
    expected = np.stack(
        [
            arm * np.cos(orbit * times) + 0.03 * np.cos(turned),
            arm * np.sin(orbit * times) + 0.03 * np.sin(turned),
            np.full(7, 0.02),
        ],
        axis=1,
    )
    np.testing.assert_allclose(moved(point, mill, times)[:, 0], expected, atol=1e-15)
    np.testing.assert_allclose(poses_at(mill, times).angular_velocity, [[0.0, 0.0, orbit + spin]] * 7)


def test_speeds_of_chains_are_bounded():
    """No point of a surface is faster than the bound, which of a planetary pot is at most twice its speed."""
    domain = gf.Domain(min=[-2.0] * 3, max=[2.0] * 3, on_exit="delete")
    pot = cylinder((0.1, 0.0, 0.0), (0.1, 0.0, 0.05), 0.03)
    mill = [rotation((0, 0, 0), (0, 0, 1), 30.0), rotation((0.1, 0, 0), (0, 0, 1), -75.0)]
    plate = rectangle((0.2, 0.1, 0.0), (0.3, 0.0, 0.0), (0.0, 0.2, 0.1))
    for surface, motions, slack in ((pot, mill, 2.0), (plate, CHAIN, np.inf), (plate, CHAIN[::-1], np.inf)):
        points, _ = surface.triangles(np.zeros(3), 1.0)
        times = np.linspace(0.0, 1.0, 500)
        poses = poses_at(motions, times)
        arms = moved(points, motions, times) - poses.pivot - poses.offset[:, None, :]
        velocity = poses.velocity[:, None, :] + np.cross(poses.angular_velocity[:, None, :], arms)
        fastest = np.linalg.norm(velocity, axis=2).max()
        bound = geometry_speed(surface, motions, domain, 1.0)
        assert fastest <= bound <= slack * fastest
    with_plane = geometry_speed(half_space((0, 0, 0), (0, 0, 1)), CHAIN, domain, 1.0)
    assert 0.0 < with_plane < 1e3


def test_speed_of_a_plate_is_that_of_its_farthest_point_in_the_domain():
    """w R: R is the distance of the farthest corner of the plate from the axis z through P, or that of the
    domain from the axis if this is smaller."""
    domain = gf.Domain(min=[0.0, 0.0, 0.0], max=[1.0, 0.5, 0.2], on_exit="delete")
    inside = rectangle((0.9, 0.1, 0.0), (0.1, 0.0, 0.0), (0.0, 0.0, 0.1))
    beyond = rectangle((0.9, 0.1, 0.0), (7.0, 0.0, 0.0), (0.0, 0.0, 0.1))
    axis = (-3.0, 0.1, 5.0)
    turning = rotation(axis, (0, 0, 1), 2.0)
    corner_of_domain = np.hypot(4.0, 0.4)
    ramp = rotation(axis, (0, 0, 1), 2.0, initial_angular_velocity=-3.0, ramp_duration=0.2)
    carrying = translation((0.3, 0.0, 0.0), end=0.5)
    expanding = domain.model_copy(update={"on_exit": "expand"})
    for surface, motions, box, expected in (
        (inside, [turning], domain, 2.0 * 4.0),
        (beyond, [turning], domain, 2.0 * corner_of_domain),
        (beyond, [turning], expanding, 2.0 * 10.9),
        (half_space((0, 0, 0), (1, 0, 0)), [turning], domain, 2.0 * corner_of_domain),
        (inside, [ramp], domain, 3.0 * 4.0),
        (inside, [ramp, carrying], domain, 3.0 * corner_of_domain + 0.3),
        (inside, [ramp, carrying], expanding, 3.0 * (np.hypot(4.0, 5.0) + 0.15) + 0.3),
        (beyond, [carrying, turning], domain, 0.3 + 2.0 * (corner_of_domain + 0.15)),
        (inside, [vibration((0, 0, 1), 0.01, 10.0)], domain, 0.1),
        (inside, [], domain, 0.0),
    ):
        assert geometry_speed(surface, motions, box, 1.0) == pytest.approx(expected)


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


def test_a_ramp_at_the_end_stops_the_motion_linearly():
    """From 0.7 to 0.9 s the velocity v decreases to 0, over the way v T / 2; the wall remains there."""
    velocity = np.array([0.1, 0.2, -0.3])
    stopping = translation(velocity, start=0.1, end=0.9, end_ramp_duration=0.2)
    found = poses_at([stopping], np.array([0.7, 0.8, 0.9 - 1e-12, 0.9, 5.0]))
    shares = np.array([1.0, 0.5, 0.0, 0.0, 0.0])
    ways = np.array([0.6, 0.6 + 0.075, 0.7, 0.7, 0.7])
    np.testing.assert_allclose(found.velocity, np.outer(shares, velocity), atol=1e-11)
    np.testing.assert_allclose(found.offset, np.outer(ways, velocity), atol=1e-11)
    turning = rotation((0, 0, 0), (0, 0, 1), 5.0, start=0.1, end=0.9, end_ramp_duration=0.2)
    angle, rate = turning.angle_and_rate(np.array([0.8, 0.9]))
    np.testing.assert_allclose([angle, rate], [[5.0 * 0.675, 5.0 * 0.7], [2.5, 0.0]], atol=1e-12)


def test_a_stage_that_ends_during_the_ramp_at_the_start_ends_with_a_ramp_from_the_velocity_then():
    """The stage ends at 0.5 s, half-way through the ramp to v: v / 2 remains, and decreases during 0.2 s."""
    given = gf.Translation(
        velocity=[0.4, 0, 0], ramp_duration=1.0, end_ramp_duration=0.2, stages=["push"]
    ).numeric((0.0, 0.0, 0.0))
    during, after = (given.at({"push": (0.0, end)}) for end in (np.inf, 0.5))
    np.testing.assert_allclose(poses_at([during], np.array([0.5, 1.0])).velocity[:, 0], [0.2, 0.4])
    found = poses_at([after], np.array([0.5, 0.6, 0.7, 1.0]))
    np.testing.assert_allclose(found.velocity[:, 0], [0.2, 0.1, 0.0, 0.0], atol=1e-15)
    way = 0.5 * 0.5 * 0.2
    np.testing.assert_allclose(found.offset[:, 0], [way, way + 0.015, way + 0.02, way + 0.02], atol=1e-15)


def test_a_motion_pauses_in_the_stages_between_its_stages():
    """It continues from the pose and the phase that it had, also if its stages are written in another
    order."""
    second = {"first": (0.0, 0.3), "rest": (0.3, 0.7), "second": (0.7, np.inf)}
    begun = {"first": (0.0, 0.3), "rest": (0.3, np.inf)}
    shaken = gf.Vibration(
        direction=[0, 0, 1], amplitude=0.01, frequency=0.9, stages=["second", "first"]
    ).numeric((0.0, 0.0, 0.0))
    alone = shaken.at({"first": (0.0, np.inf)})
    times = np.array([0.3, 0.5, 0.9])
    expected = poses_at([alone], times).offset
    np.testing.assert_array_equal(poses_at([shaken.at(begun)], np.array([0.5, 0.6])).offset, expected[[0, 0]])
    np.testing.assert_allclose(poses_at([shaken.at(second)], 0.4 + times).offset, expected, atol=1e-16)
    np.testing.assert_array_equal(
        shaken.at({"first": (0.0, 0.3), "second": (0.3, np.inf)}).model_dump(), alone.model_dump()
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
    assert surface.top_speed(1.0) == 0.0


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
    assert drum.farthest_from(origin, along_z) == 0.5
    ball = sphere([0, 0, 1], 0.5)
    assert ball.reach_about(origin, along_z) == 0.0 and ball.farthest_from(origin, along_x) == 1.5
