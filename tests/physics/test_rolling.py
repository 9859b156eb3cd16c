"""A particle on a plane: transition from slip to rolling, and rolling friction."""

import numpy as np
import pytest
from scene_builders import column, few_spheres, particle_group, plane, run_and_sample, times

from granflow.contact import theory

GRAVITY, RADIUS = 9.81, 5e-4
MATERIAL = {"young_modulus": 1e7, "poisson_ratio": 0.3, "density": 1e4}
MASS = 4.0 / 3.0 * np.pi * RADIUS**3 * MATERIAL["density"]
MODULUS = MATERIAL["young_modulus"] / (2.0 * (1.0 - MATERIAL["poisson_ratio"] ** 2))
OVERLAP = float((MASS * GRAVITY / theory.hertz_stiffness(MODULUS, RADIUS)) ** (2.0 / 3.0))
"""Overlap [m] at which a Hertz contact with a floor of the same material carries the weight."""


def on_a_floor(pairs, velocity, rotation, duration, interval):
    """Times, position and velocity along x and R w about y (times, particles).

    One particle per pair of friction and rolling friction, in a row along y, each of a separate material.
    """
    names = [f"ball_{number}" for number in range(len(pairs))]
    groups = {
        name: particle_group([0.0, 0.005 * n, RADIUS - OVERLAP], 2.0 * RADIUS, name, velocity=[velocity, 0, 0],
                             angular_velocity=[0, rotation / RADIUS, 0])
        for n, name in enumerate(names)
    }  # fmt: skip
    scene = few_spheres(
        groups, {"floor": plane([0, 0, 0], [0, 0, 1], "floor")},
        materials=dict.fromkeys([*names, "floor"], MATERIAL), rolling="epsd",
        pairs={f"{name}-floor": {"restitution": 0.5, "friction": friction, "rolling_friction": rolling}
               for name, (friction, rolling) in zip(names, pairs, strict=True)},
        gravity=[0.0, 0.0, -GRAVITY], run={"duration": duration, "velocity_max": 0.2},
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
