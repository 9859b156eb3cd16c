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
