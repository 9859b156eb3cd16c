"""The benchmark collisions of Chung & Ooi (2011), Granular Matter 13:643, doi 10.1007/s10035-011-0277-0.

Tables 1-2 of the paper give the materials. Values without another source follow from Hertz's closed forms
dmax = (5 M v^2 / 4 k)^(2/5), F = k dmax^1.5, T = 2.9433 dmax / v, which the paper prints in rounded form.
"""

import numpy as np
import pytest
from scene_builders import build_scene, column, particle_group, plane, run_and_sample, times

from granflow.contact import theory

GLASS = {"young_modulus": 48e9, "poisson_ratio": 0.20, "density": 2800.0}
ALLOY = {"young_modulus": 70e9, "poisson_ratio": 0.30, "density": 2699.0}
ALLOY_OBLIQUE = {"young_modulus": 70e9, "poisson_ratio": 0.33, "density": 2700.0}
OXIDE = {"young_modulus": 380e9, "poisson_ratio": 0.23, "density": 4000.0}
IRON = {"young_modulus": 100e9, "poisson_ratio": 0.25, "density": 7000.0}
STEEL = {"young_modulus": 208e9, "poisson_ratio": 0.30, "density": 7850.0}
RIGID = {"young_modulus": 1e25, "poisson_ratio": 0.3, "density": 1e4}

HALF_DIGIT = 6e-4
"""Relative tolerance: the values of the benchmark have four to five digits."""


def collision(diameter, material, velocity, max_overlap=0.1):
    """A particle that touches a rigid floor initially and moves toward it at `velocity` [m/s]."""
    return build_scene(
        {"ball": particle_group([[0.0, 0.0, 0.5 * diameter]], diameter, velocity=[0.0, 0.0, -velocity])},
        walls={"floor": plane([0, 0, 0], [0, 0, 1], "rigid")},
        materials={"glass": material, "rigid": RIGID}, pair={"restitution": 1.0},
        run={"duration": 1e-3, "velocity_max": velocity}, numerics={"time_step_fraction": 0.002},
    )  # fmt: skip


def head_on(diameter, material, velocity):
    """Two equal particles that touch initially and approach each other at +-`velocity` [m/s]."""
    directions = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    return build_scene(
        {"balls": particle_group(0.5 * diameter * directions, diameter, velocity=-velocity * directions)},
        materials={"glass": material},
        pair={"restitution": 1.0},
        run={"duration": 1e-3, "velocity_max": 2.0 * velocity},
        numerics={"time_step_fraction": 0.002},
    )


CASES = {
    "1 glass pair": (head_on(0.02, GLASS, 10.0), 274.11e-6, 10.697e3, 40.34e-6),
    "2 alloy on plane": (collision(0.2, ALLOY, 0.2), 49.717e-6, 11.370e3, 731.6e-6),
    "3 oxide on plane": (collision(0.005, OXIDE, 3.9), 8.089e-6, 615.35, 6.104e-6),
    "3 iron on plane": (collision(0.005, IRON, 3.9), 17.189e-6, 506.76, 12.97e-6),
}
"""Scene, maximum overlap [m], maximum force [N] and duration [s] of tests 1 to 3 of the benchmark."""


@pytest.mark.parametrize("name", CASES)
def test_elastic_collisions_reach_the_overlap_force_and_duration(taichi_f64, name):
    scene, overlap_max, force_max, duration = CASES[name]
    snapshots = run_and_sample(scene, duration / 1000.0, until=1.2 * duration)
    force = np.linalg.norm(column(snapshots, "force")[:, 0], axis=1)
    position = column(snapshots, "position")
    radius = snapshots[0].particles["radius"]
    if position.shape[1] == 2:
        overlap = radius.sum() - np.linalg.norm(position[:, 0] - position[:, 1], axis=1)
    else:
        overlap = radius[0] - position[:, 0, 2]
    assert overlap.max() == pytest.approx(overlap_max, rel=HALF_DIGIT)
    assert force.max() == pytest.approx(force_max, rel=HALF_DIGIT)
    time = times(snapshots)
    last = np.flatnonzero(overlap > 0.0)[-1]
    separation_time = time[last] + overlap[last] / (overlap[last] - overlap[last + 1]) * (
        time[last + 1] - time[last]
    )
    assert separation_time == pytest.approx(duration, rel=HALF_DIGIT)


@pytest.mark.parametrize("material", [OXIDE, IRON], ids=["oxide", "iron"])
@pytest.mark.parametrize("law", ["zhou", "hertz"])
def test_rebound_has_the_requested_restitution(taichi_f64, law, material):
    """Test 3: e_out = e_in. Five particles of five materials hit the floor at separate positions."""
    requested = (0.2, 0.4, 0.6, 0.8, 1.0)
    names = [f"ball_{number}" for number in range(len(requested))]
    scene = build_scene(
        {
            name: particle_group([[0.05 * n, 0.0, 0.0025]], 0.005, name, velocity=[0, 0, -3.9])
            for n, name in enumerate(names)
        },
        walls={"floor": plane([0, 0, 0], [0, 0, 1], "rigid")},
        materials=dict.fromkeys(names, material) | {"rigid": RIGID},
        pairs={
            f"{name}-rigid": {"restitution": e, "friction": 0}
            for name, e in zip(names, requested, strict=True)
        },
        normal=law,
        run={"duration": 2e-5, "velocity_max": 3.9},
        numerics={"time_step_fraction": 0.004},
    )
    rebound = run_and_sample(scene, 1.0, until=1.8e-5)[-1].particles["velocity"][:, 2] / 3.9
    np.testing.assert_allclose(rebound, requested, rtol=2e-3)


def oblique(diameter, material, restitution, friction, normal_velocity, tangential_velocity, spin):
    """Particles that hit a rigid floor with tangential velocities along x and angular velocities about y."""
    count = len(tangential_velocity)
    positions = np.stack(
        [np.arange(count) * 2.0 * diameter, np.zeros(count), np.full(count, 0.5 * diameter)], axis=1
    )
    velocity = np.stack([tangential_velocity, np.zeros(count), np.full(count, -normal_velocity)], axis=1)
    angular_velocity = np.stack([np.zeros(count), spin, np.zeros(count)], axis=1)
    return build_scene(
        {
            "balls": particle_group(
                positions - [count * diameter, 0, 0],
                diameter,
                velocity=velocity,
                angular_velocity=angular_velocity,
            )
        },
        walls={"floor": plane([0, 0, 0], [0, 0, 1], "rigid")},
        materials={"glass": material, "rigid": RIGID},
        pair={"restitution": restitution, "friction": friction},
        domain={"min": [-5.0] * 3, "max": [5.0] * 3, "on_exit": "error"},
        run={"duration": 1.0, "velocity_max": normal_velocity},
        numerics={"time_step_fraction": 0.005},
    )


def test_sliding_impact_of_a_small_ball_follows_the_closed_form(taichi_f64):
    """Test 5: if the contact slides throughout, Vs'/(mu Vn') = Vs/(mu Vn) - 7 and r w'/(mu Vn) = -5 (e = 1).

    These values hold for a lever arm r. Here the lever arm is r minus half of the overlap, whose mean over
    the impulse of a Hertz contact is int F d dt / int F dt = dmax int_0^1 sqrt(1 - u^2.5) du = dmax eta1 /
    1.8: 0.5 % of r at this speed.
    """
    friction = 0.3
    speed = 5.0
    radius = 1e-5
    ratio = np.array([8.0, 10.0, 14.0, 20.0])
    scene = oblique(2.0 * radius, STEEL, 1.0, friction, speed, ratio * friction * speed, np.zeros(4))
    last = run_and_sample(scene, 1.0, until=4.5e-8)[-1].particles
    k = theory.hertz_stiffness(STEEL["young_modulus"] / (1.0 - STEEL["poisson_ratio"] ** 2), radius)
    overlap_max = theory.overlap_max(k, last["mass"][0], speed)
    arm = 1.0 - 0.5 * theory.LOADING_DURATION / 1.8 * overlap_max / radius
    slip = last["velocity"][:, 0] - radius * last["angular_velocity"][:, 1]
    np.testing.assert_allclose(last["velocity"][:, 2], speed, rtol=1e-4)
    np.testing.assert_allclose(
        radius * last["angular_velocity"][:, 1] / (friction * speed), 5.0 * arm, rtol=1e-3
    )
    np.testing.assert_allclose(slip / (friction * speed), ratio - 2.0 - 5.0 * arm, rtol=0.0, atol=1e-3 * 7.0)


def test_sliding_impact_with_initial_rotation_follows_the_closed_form(taichi_f64):
    """Test 6: without tangential velocity and with an initial rotation, the slip becomes Vs - 3.5 mu (1 + e)
    Vn."""
    friction = 0.4
    restitution = 0.5
    normal_velocity = 0.2
    radius = 0.1
    loss = 3.5 * friction * (1.0 + restitution) * normal_velocity
    before = loss * np.array([1.2, 1.6, 2.4])
    scene = oblique(
        2.0 * radius, ALLOY_OBLIQUE, restitution, friction, normal_velocity, np.zeros(3), before / radius
    )
    last = run_and_sample(scene, 1.0, until=1.2e-3)[-1].particles
    assert np.allclose(last["velocity"][:, 2], restitution * normal_velocity, rtol=1e-3)
    slip = radius * last["angular_velocity"][:, 1] - last["velocity"][:, 0]
    np.testing.assert_allclose(slip, before - loss, atol=1e-3 * loss)


def test_collision_of_equal_balls_with_opposite_rotations_has_no_friction(taichi_f64):
    """Test 7: the surfaces do not slip, so no tangential velocity results and the angular velocity keeps its
    bits."""
    directions = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    spin = np.array([[0.0, 0.0, 5.0], [0.0, 0.0, -5.0]])
    scene = build_scene(
        {"balls": particle_group(0.1 * directions, 0.2, velocity=-0.2 * directions, angular_velocity=spin)},
        materials={"glass": ALLOY_OBLIQUE},
        pair={"restitution": 0.5, "friction": 0.4},
        run={"duration": 1.0, "velocity_max": 0.4},
    )
    last = run_and_sample(scene, 1.0, until=1.5e-3)[-1].particles
    np.testing.assert_allclose(last["velocity"][:, 0], 0.1 * directions[:, 0], rtol=0.005)
    assert not last["velocity"][:, 1:].any()
    np.testing.assert_array_equal(last["angular_velocity"], spin)
