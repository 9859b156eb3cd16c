"""Motion and impacts of clumps against closed forms, and their energy."""

import numpy as np
import pytest
from clumps import ROD, about, clump_group
from scene_builders import build_scene, plane, run_and_sample
from scipy.special import ellipj

from granflow.geometry.clump import clump_body, matrices

ASYMMETRIC = [[0.0, 0.0, 0.0], [4e-3, 0.0, 0.0], [0.0, 2.5e-3, 0.0]]
DENSITY = 2500.0


def run_clump(group, interval, restitution=0.6, modulus=1e10, gravity=0.0, **run):
    """Snapshots of one clump above a frictionless plate."""
    material = {"young_modulus": modulus, "poisson_ratio": 0.25, "density": DENSITY}
    pairs = {"glass-plate": {"restitution": restitution, "friction": 0.0}}
    scene = build_scene(
        {"clump": group}, {"plate": plane([0, 0, 0], [0, 0, 1], "plate")}, pairs=pairs,
        materials={"glass": material, "plate": material}, gravity=[0.0, 0.0, -gravity], run=run,
        output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip
    return run_and_sample(scene, interval, threads=2)


def shape_of(centers, radius=0.002):
    return clump_body(tuple(map(tuple, centers)), (radius,) * len(centers))


def free_rotor(time, rates, moments):
    """Angular velocity of a torque-free rotor along its principal axes with moments I1 < I2 < I3.

    Landau & Lifshitz, Mechanics, 37: with M^2 > 2 E I2, and w2 = 0 at t = 0.
    """
    (a, b, c), energy, momentum = moments, moments @ rates**2, (moments * rates) @ (moments * rates)
    modulus = (b - a) * (energy * c - momentum) / ((c - b) * (momentum - energy * a))
    phase = time * np.sqrt((c - b) * (momentum - energy * a) / (a * b * c))
    sn, cn, dn, _ = ellipj(phase, modulus)
    first = np.sqrt((energy * c - momentum) / (a * (c - a)))
    second = np.sqrt((energy * c - momentum) / (b * (c - b)))
    return np.array([first * cn, second * sn, np.sqrt((momentum - energy * a) / (c * (c - a))) * dn])


def rotor_error(step, duration=0.06):
    """Largest difference of the angular velocity from the closed form, over its magnitude."""
    shape = shape_of(ASYMMETRIC)
    order = np.argsort(shape.moments)
    rates = np.zeros(3)
    rates[order[0]], rates[order[2]] = 60.0, 80.0
    axes = matrices(shape.principal_axes[None])[0]
    group = clump_group([[0.0, 0.0, 0.5]], ASYMMETRIC, angular_velocity=axes @ rates)
    snapshots = run_clump(
        group, duration / 12, modulus=1e6, duration=duration, time_step=step, velocity_max=1e-3
    )
    assert len(snapshots) == 13
    momentum = [each.particles["clump_angular_momentum"] for each in snapshots]
    assert all(np.array_equal(each, momentum[0]) for each in momentum), "it is exact"
    orientation = [matrices(each.particles["orientation"][:1].astype(float))[0] for each in snapshots]
    spin = [each.particles["angular_velocity"][0] for each in snapshots]
    found = np.array([axes.T @ w for axes, w in zip(orientation, spin, strict=True)])[:, order]
    expected = np.array([free_rotor(each.time, rates[order], shape.moments[order]) for each in snapshots])
    # the closed form fixes the sense of rotation only up to the handedness of the sorted axes
    handed = np.linalg.det(np.eye(3)[order])
    return np.abs(found - expected * [1.0, handed, 1.0]).max() / 100.0


def test_torque_free_rotor_converges_to_the_jacobi_functions_with_order_two(taichi_f64):
    """Its angular momentum is exact."""
    coarse = rotor_error(1e-4)
    fine = rotor_error(5e-5)
    assert fine < 1e-5
    assert coarse / fine == pytest.approx(4.0, rel=0.02)


def test_rod_that_hits_a_plate_has_the_velocities_of_the_impulse(taichi_f64):
    """The closed form is that of an instantaneous impulse; the rod turns during the contact.

    That changes the lever arm by tan(angle) times the turn, relative to the arm, and the impulse by about as
    much.
    """
    angle, restitution = 50.0, 0.6
    speed = 0.01
    shape = shape_of(ROD)
    end = np.abs(np.array(ROD)[:, 0]).max()
    height = end * np.sin(np.deg2rad(angle)) + 0.002 + 1e-6
    group = clump_group(
        [[0.0, 0.0, height]], orientation=about([0, 1, 0], angle), velocity=[0.0, 0.0, -speed]
    )
    snapshots = run_clump(group, 4e-6, restitution, duration=4e-4, velocity_max=2 * speed)
    last = snapshots[-1].particles
    in_contact = [each for each in snapshots if each.totals["contact_count"] > 0]
    assert len(in_contact) > 5 and not snapshots[-1].totals["contact_count"]
    turn = abs(last["angular_velocity"][0, 1]) * (in_contact[-1].time - in_contact[0].time)
    # The rod turns about y by `angle`: its positive end, at x = end cos(angle), is the lower one.
    arm = end * np.cos(np.deg2rad(angle))
    mass, inertia = DENSITY * shape.volume, DENSITY * shape.moments[1]
    impulse = (1.0 + restitution) * speed / (1.0 / mass + arm**2 / inertia)
    found = last["clump_velocity"][0, 2] + speed, last["angular_velocity"][0, 1]
    allowed = turn * np.tan(np.deg2rad(angle))
    assert 0.0 < allowed < 1e-3
    assert found == pytest.approx((impulse / mass, -arm * impulse / inertia), rel=allowed)


def damped_rods(cundall, drag, gravity):
    """Snapshots of a free rod that flies and tumbles, and of a rod that falls on a plate and comes to rest."""
    free = clump_group(
        [[0.0, 0.0, 0.5]], ASYMMETRIC, velocity=[0.3, -0.2, 0.1], angular_velocity=[4.0, 30.0, -8.0]
    )
    falling = clump_group([[0.2, 0.0, 0.004]], orientation=about([0, 1, 0], 20))
    scene = build_scene(
        {"free": free, "falling": falling}, {"plate": plane([0, 0, 0], [0, 0, 1], "plate")},
        pairs={"glass-plate": {"restitution": 0.6, "friction": 0.3}},
        materials=dict.fromkeys(("glass", "plate"), {"young_modulus": 1e7, "poisson_ratio": 0.25, "density": DENSITY}),
        gravity=[0.0, 0.0, -gravity], run={"duration": 0.1, "velocity_max": 1.0, "time_step": 1e-5},
        output={"interval": 1.0, "energy_budget": True}, damping={"cundall": cundall, "drag": drag},
    )  # fmt: skip
    return run_and_sample(scene, 0.01, threads=2)


NONE = 1e-14
"""Damping without effect."""


def test_drag_decays_velocity_and_angular_momentum_of_clumps(taichi_f64):
    """A step changes both by (1 - h) / (1 + h), h = g dt / 2: the rate is wrong by h^2 / 3."""
    rate = 20.0
    snapshots = damped_rods(NONE, rate, 0.0)
    for each in snapshots:
        for name in ("clump_velocity", "clump_angular_momentum"):
            expected = np.exp(-rate * each.time) * snapshots[0].particles[name][0]
            assert each.particles[name][0] == pytest.approx(expected, rel=(0.5 * rate * 1e-5) ** 2), name
    assert max(abs(each.totals["energy_error"]) for each in snapshots) < 1e-6
    assert snapshots[-1].totals["damping_dissipation"] > 0.9 * snapshots[0].totals["kinetic_energy"]


def test_cundall_damping_reduces_the_fall_of_clumps_and_brings_them_to_rest(taichi_f64):
    """Free fall has the acceleration (1 - a) g downwards and (1 + a) g upwards; a rod on a plate comes to rest.

    Without damping of its rotation, the rod would rock on both ends for much longer.
    """
    ratio = 0.6
    snapshots = damped_rods(ratio, NONE, 9.81)
    up = 0.1 / (9.81 * (1.0 + ratio))
    expected = 9.81 * (1.0 - ratio) * (snapshots[-1].time - up)
    assert -snapshots[-1].particles["clump_velocity"][0, 2] == pytest.approx(expected, rel=1e-3)
    assert np.array_equal(
        snapshots[-1].particles["clump_angular_momentum"][0],
        snapshots[0].particles["clump_angular_momentum"][0],
    ), "without torque there is no damping"
    spins = [np.abs(each.particles["angular_velocity"][-1]).max() for each in snapshots]
    assert max(spins) > 5.0 and spins[-1] < 0.02 * max(spins)
    assert max(abs(each.totals["energy_error"]) for each in snapshots) < 1e-3
    assert snapshots[-1].totals["damping_dissipation"] > 0.0


def test_energy_of_elastic_rods_is_conserved_over_many_steps(taichi_f64):
    """A rod that bounces on a plate, over 1e5 steps; without losses the error remains below 1e-6."""
    group = clump_group([[0.0, 0.0, 0.008]], orientation=about([0, 1, 0], 35), velocity=[0.0, 0.0, 0.0])
    snapshots = run_clump(group, 2e-3, 1.0, 1e7, 9.81, duration=0.1, time_step=1e-6, velocity_max=1.0)
    assert snapshots[-1].step == pytest.approx(100_000, abs=1)
    velocity = np.array([each.particles["clump_velocity"][0, 2] for each in snapshots])
    assert (np.diff(np.sign(velocity)) > 0).sum() >= 2  # it has bounced
    assert max(each.totals["rotational_energy"] for each in snapshots) > 1e-6
    assert max(abs(each.totals["energy_error"]) for each in snapshots) < 1e-6
