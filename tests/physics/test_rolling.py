"""A particle on a plane: transition from slip to rolling, rolling friction, sticking and sliding on a
slope."""

import numpy as np
import pytest
from scene_builders import column, few_spheres, particle_group, plane, run_and_sample, times

from granflow.contact import theory

GRAVITY, RADIUS = 9.81, 5e-4
MATERIAL = {"young_modulus": 1e7, "poisson_ratio": 0.3, "density": 1e4}
MASS = 4.0 / 3.0 * np.pi * RADIUS**3 * MATERIAL["density"]
ANGLE = np.arctan(0.4)
DOWN, INTO = GRAVITY * np.sin(ANGLE), GRAVITY * np.cos(ANGLE)
"""Components of gravity [m/s2] along a slope of 0.4 and into it."""


def resting_overlap(acceleration):
    """Overlap [m] at which a Hertz contact with a floor of the same material balances the weight of the
    particle."""
    modulus = MATERIAL["young_modulus"] / (2.0 * (1.0 - MATERIAL["poisson_ratio"] ** 2))
    return float((MASS * acceleration / theory.hertz_stiffness(modulus, RADIUS)) ** (2.0 / 3.0))


def on_a_floor(pairs, velocity, rotation, duration, interval, gravity=(0.0, -GRAVITY)):
    """Times, position and velocity along x, R w about y (times, particles), and the velocities.

    One particle per pair of friction and rolling friction, in a row along y, each of a separate material;
    `gravity` along x and z.
    """
    names = [f"ball_{number}" for number in range(len(pairs))]
    height = RADIUS - resting_overlap(-gravity[1])
    groups = {
        name: particle_group([0.0, 0.005 * n, height], 2.0 * RADIUS, name, velocity=[velocity, 0, 0],
                             angular_velocity=[0, rotation / RADIUS, 0])
        for n, name in enumerate(names)
    }  # fmt: skip
    scene = few_spheres(
        groups, {"floor": plane([0, 0, 0], [0, 0, 1], "floor")},
        materials=dict.fromkeys([*names, "floor"], MATERIAL), rolling="epsd",
        pairs={f"{name}-floor": {"restitution": 0.5, "friction": friction, "rolling_friction": rolling}
               for name, (friction, rolling) in zip(names, pairs, strict=True)},
        gravity=[gravity[0], 0.0, gravity[1]], run={"duration": duration, "velocity_max": 0.2},
    )  # fmt: skip
    snapshots = run_and_sample(scene, interval)
    path, u = (column(snapshots, name)[:, :-1, 0] for name in ("position", "velocity"))
    return times(snapshots), path, u, RADIUS * column(snapshots, "angular_velocity")[:, :-1, 1]


def test_sliding_ball_starts_to_roll_after_two_sevenths(taichi_f64):
    """Slip ends at mu g t / u0 = 2/7; then u / u0 = w R / u0 = 5/7 (MFiX verification manual)."""
    frictions = np.array([0.2, 0.4, 0.6, 0.8, 1.0])
    speed = 0.1
    stop = 2.0 / 7.0 * speed / (frictions * GRAVITY)
    pairs = [(mu, 0.0) for mu in frictions]
    t, _, u, rotation = on_a_floor(pairs, speed, 0.0, 1.3 * stop[0], stop[-1] / 60)
    # angular momentum about the line of contact
    np.testing.assert_allclose(u + 0.4 * rotation, speed, rtol=1e-3)
    for n, mu in enumerate(frictions):
        sliding, rolling = t < 0.98 * stop[n], t > 1.05 * stop[n]
        expected = speed - mu * GRAVITY * t[sliding]
        np.testing.assert_allclose(u[sliding, n], expected, rtol=0.0, atol=2e-3 * speed)
        assert np.mean(u[rolling, n]) == pytest.approx(5.0 / 7.0 * speed, rel=1e-3)
        assert np.mean(rotation[rolling, n]) == pytest.approx(5.0 / 7.0 * speed, rel=1e-3)
        near = t < 1.02 * stop[n]
        slip_end = np.interp(0.0, (rotation - u)[near, n], t[near])
        assert mu * GRAVITY * slip_end / speed == pytest.approx(2.0 / 7.0, rel=0.01)


def test_rolling_friction_stops_a_ball_after_the_theoretical_distance(taichi_f64):
    """The torque mu_r R N decelerates it by 5/7 mu_r g: distance 7 v^2 / (10 mu_r g); mu_r = 0 keeps the
    velocity."""
    rolling_frictions = np.array([0.05, 0.1, 0.2, 0.0])
    speed = 0.05
    deceleration = 5.0 / 7.0 * rolling_frictions[0] * GRAVITY
    stopping_time = speed / deceleration
    pairs = [(0.6, each) for each in rolling_frictions]
    t, path, u, _ = on_a_floor(pairs, speed, speed, 1.2 * stopping_time, stopping_time / 20)
    np.testing.assert_allclose(path[-1, :3], 0.7 * speed**2 / (rolling_frictions[:3] * GRAVITY), rtol=0.01)
    np.testing.assert_allclose(u[:, 3], speed, rtol=1e-3)
    assert np.all(np.abs(u[-1, :3]) < 0.02 * speed)
    early = t < 0.2 * stopping_time
    np.testing.assert_allclose(u[early, 0], speed - deceleration * t[early], atol=0.01 * speed)


def test_a_ball_on_a_slope_sticks_slides_or_rolls(taichi_f64):
    """Without rolling, it sticks below the friction angle and slides above it. Rolling without slip requires
    friction above 2/7 tan(angle); the acceleration is 5/7 g sin(angle)."""
    duration = 0.05
    pairs = [(0.2, 4.0), (0.3, 4.0), (0.5, 4.0), (3.0, 4.0), (0.5, 0.0)]
    t, path, u, rotation = on_a_floor(pairs, 0.0, 0.0, duration, duration / 50, (DOWN, -INTO))
    # the velocity gained during the initial deflection of the springs is constant from then on
    late = t > 0.2 * duration
    for n in (0, 1):
        gained = u[late, n] - (DOWN - pairs[n][0] * INTO) * t[late]
        np.testing.assert_allclose(gained, gained.mean(), rtol=0.0, atol=2e-3 * DOWN * duration)
        assert 0.0 < gained.mean() < 2e-3
    # the tangential spring deflects until it carries the load, and the rolling spring adds the same
    # displacement at the center; from rest the first oscillation doubles the sum, and creep adds at most the
    # same amount again while the normal contact vibrates
    nu = MATERIAL["poisson_ratio"]
    shear = MATERIAL["young_modulus"] / (2.0 * (1.0 + nu)) / (2.0 * (2.0 - nu))
    deflection = MASS * DOWN / (8.0 * shear * np.sqrt(RADIUS * resting_overlap(INTO)))
    first = path[t < 0.2 * duration, 3]
    assert 2.0 * deflection < first.max() < 1.01 * 4.0 * deflection
    assert np.abs(path[:, 2:4]).max() < 8.0 * deflection < 1e-3 * path[-1, 1]
    expected = 5.0 / 14.0 * DOWN * t**2
    np.testing.assert_allclose(path[:, 4], expected, rtol=0.0, atol=5e-3 * expected[-1])
    assert rotation[-1, 4] == pytest.approx(5.0 / 7.0 * DOWN * t[-1], rel=5e-3)
