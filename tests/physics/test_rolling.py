"""A particle on a plane: transition from slip to rolling, rolling friction and twisting friction."""

import numpy as np
import pytest
from scene_builders import (
    DASHPOTS,
    build_scene,
    column,
    few_spheres,
    particle_group,
    plane,
    run_and_sample,
    times,
)

from granflow.contact import theory

GRAVITY, RADIUS = 9.81, 5e-4
MATERIAL = {"young_modulus": 1e7, "poisson_ratio": 0.3, "density": 1e4}
MASS = 4.0 / 3.0 * np.pi * RADIUS**3 * MATERIAL["density"]
MODULUS = MATERIAL["young_modulus"] / (2.0 * (1.0 - MATERIAL["poisson_ratio"] ** 2))
OVERLAP = float((MASS * GRAVITY / theory.hertz_stiffness(MODULUS, RADIUS)) ** (2.0 / 3.0))
"""Overlap [m] at which a Hertz contact with a floor of the same material carries the weight."""
INERTIA, CONTACT_RADIUS = 0.4 * MASS * RADIUS**2, np.sqrt(RADIUS * OVERLAP)
SPIN, FRICTION = 60.0, 0.4
CONTACT = {"normal": "hertz", "tangential": "mindlin", "rolling": "epsd", "twisting": "marshall"}
"""Particles without spin about the normal have no twisting friction: all but one of the scenes share their kernels."""


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
        materials=dict.fromkeys([*names, "floor"], MATERIAL), rolling="epsd", contact=CONTACT,
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


def spinning(twisting, duration, spin=SPIN, **pair):
    """Snapshots of a sphere at rest on a plate that spins about the vertical."""
    sphere = particle_group([0.0, 0.0, RADIUS - OVERLAP], 2 * RADIUS, angular_velocity=[0.0, 0.0, spin])
    scene = few_spheres(
        {"ball": sphere}, {"floor": plane([0, 0, 0], [0, 0, 1])}, {"restitution": 1.0, "friction": FRICTION, **pair},
        materials={"glass": MATERIAL}, gravity=[0.0, 0.0, -GRAVITY], run={"duration": duration, "velocity_max": 0.1},
        rolling="epsd", contact=CONTACT | {"twisting": twisting},
        pairs={"fixed-fixed": {"restitution": 0.5, "friction": 0.5, "rolling_friction": 0.1, **pair}},
    )  # fmt: skip
    return run_and_sample(scene, duration / 60)


def test_spinning_sphere_stops_after_the_theoretical_time(taichi_f64):
    """The constant torque T = (2/3) mu a F (Marshall 2009) decelerates it by T/I: time I w / T, angle I w^2 /
    (2 T), dissipated energy I w^2 / 2. The spring of 4 G a^3 turns the sphere back and forth: k theta^2 / 2 =
    T^2 / (2 k) = I w^2 / 2."""
    limit = 2.0 / 3.0 * FRICTION * CONTACT_RADIUS * MASS * GRAVITY
    stopping_time = INERTIA * SPIN / limit
    snapshots = spinning("marshall", 1.1 * stopping_time)
    t = times(snapshots)
    rate = column(snapshots, "angular_velocity")[:, 0, 2]
    decelerating = t < 0.95 * stopping_time
    expected = SPIN * (1.0 - t[decelerating] / stopping_time)
    np.testing.assert_allclose(rate[decelerating], expected, rtol=0.0, atol=2e-3 * SPIN)
    assert np.trapezoid(rate, t) == pytest.approx(0.5 * SPIN * stopping_time, rel=5e-3)
    shear_modulus = MATERIAL["young_modulus"] / (2.0 * 1.3) / (2.0 * 1.7)
    largest = limit / np.sqrt(4.0 * shear_modulus * CONTACT_RADIUS**3 * INERTIA)
    assert np.abs(rate[t > 1.02 * stopping_time]).max() < 1.01 * largest < 0.1 * SPIN
    last = snapshots[-1].totals
    assert last["rolling_dissipation"] == pytest.approx(0.5 * INERTIA * SPIN**2, rel=5e-3)
    assert abs(last["energy_error"]) < 1e-4


def test_torsion_spring_oscillates_with_its_damped_period(taichi_f64):
    """Below the limit: w(t) = w0 exp(-g t) (cos(f t) - g/f sin(f t)), g = c / (2 I), f^2 = k / I - g^2."""
    stiffness = 4e-9
    decay = 0.1 * np.sqrt(stiffness / INERTIA)
    twisting = {"law": "torsion_spring", "stiffness": stiffness, "damping": 2.0 * INERTIA * decay}
    duration = 6.0 * np.pi * np.sqrt(INERTIA / stiffness)
    snapshots = spinning(twisting, duration, spin=0.1, twisting_friction=1.0)
    t = times(snapshots)
    rate = column(snapshots, "angular_velocity")[:, 0, 2]
    frequency = np.sqrt(stiffness / INERTIA - decay**2)
    expected = np.exp(-decay * t) * (np.cos(frequency * t) - decay / frequency * np.sin(frequency * t))
    np.testing.assert_allclose(rate / 0.1, expected, rtol=0.0, atol=5e-3)
    assert abs(snapshots[-1].totals["energy_error"]) < 1e-4


def test_dashpots_beyond_the_limit_leave_no_energy_in_their_springs(taichi_f64):
    """Fast slip and spin deflect the springs, whose energy ends with the contact: it has been dissipated.

    What the sphere loses by both is their dissipation, without a rest in the energy budget.
    """
    sphere = particle_group([[0, 0, 0.0051]], velocity=[2.0, 0, -0.5], angular_velocity=[0, 0, 400.0])
    scene = build_scene(
        {"ball": sphere}, {"floor": plane([0, 0, 0], [0, 0, 1])}, {"restitution": 0.3, "friction": 0.1},
        run={"duration": 2e-3, "velocity_max": 0.5, "time_step": 1e-6}, output={"interval": 1.0, "energy_budget": True},
        contact=DASHPOTS["contact"] | {"tangential": {"law": "mindlin", "damping": 1.0}, "rolling": "none"},
    )  # fmt: skip
    before, last = run_and_sample(scene, 2e-3)
    assert last.totals["contact_count"] == 0 and last.particles["velocity"][0, 2] > 0.0
    lost = sum(before.totals[name] - last.totals[name] for name in ("kinetic_energy", "rotational_energy"))
    dissipated = {name: last.totals[f"{name}_dissipation"] for name in ("friction", "rolling", "damping")}
    assert min(dissipated.values()) > 1e-7
    assert sum(dissipated.values()) == pytest.approx(lost, rel=1e-4)


def test_a_ball_at_rest_on_a_turntable_stays_at_its_place(taichi_f64):
    """Held by friction and rolling friction, whose springs turn with table and ball, after it has come to rest.

    If they kept their direction in space, the ball would creep by more than 2 pi F / K in each revolution, with
    the force F = m w^2 r and Mindlin's stiffness K = 8 G sqrt(R d).
    """
    rate, distance = 50.0, 5e-3
    ball = particle_group(
        [distance, 0, RADIUS - OVERLAP],
        2 * RADIUS,
        velocity=[0, rate * distance, 0],
        angular_velocity=[0, 0, rate],
    )
    table = {"kind": "rotation", "point": [0, 0, 0], "axis": [0, 0, 1], "angular_velocity": rate}
    scene = build_scene(
        {"ball": ball}, {"table": plane([0, 0, 0], [0, 0, 1], motion=table)}, materials={"glass": MATERIAL},
        pair={"restitution": 0.3, "friction": 2.0, "rolling_friction": 2.0, "rolling_damping": 0.5},
        contact={"normal": "hertz", "tangential": {"law": "mindlin", "damping": 1.0}, "rolling": "sds"},
        gravity=[0, 0, -GRAVITY], run={"duration": 0.2, "velocity_max": 0.3},
    )  # fmt: skip
    snapshots = run_and_sample(scene, 0.1)[1:]
    place = column(snapshots, "position")[:, 0]
    angle = np.unwrap(np.arctan2(place[:, 1], place[:, 0]) - rate * times(snapshots), period=2 * np.pi)
    shear = MATERIAL["young_modulus"] / (2 * 1.3) / (2 * 1.7)
    creep = rate * 0.1 * MASS * rate**2 * distance / (8 * shear * np.sqrt(RADIUS * OVERLAP))
    assert abs(distance * np.diff(angle)[0]) < 0.01 * creep
    np.testing.assert_allclose(
        column(snapshots, "angular_velocity")[:, 0], [[0, 0, rate]] * 2, atol=1e-4 * rate
    )
