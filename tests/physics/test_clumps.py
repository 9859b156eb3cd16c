"""Motion and impacts of clumps against closed forms, their energy, and clumps of one sphere."""

import numpy as np
import pytest
from clumps import ROD, about, clump_group
from scene_builders import build_scene, plane, run_and_sample
from scipy.special import ellipj

from granflow.geometry.clump import clump_body, matrices
from granflow.simulation import Simulation

ASYMMETRIC = [[0.0, 0.0, 0.0], [4e-3, 0.0, 0.0], [0.0, 2.5e-3, 0.0]]
DENSITY = 2500.0


def shape_of(centers, radius=0.002):
    return clump_body(tuple(map(tuple, centers)), (radius,) * len(centers))


def body_rates(particles):
    """Angular velocity [rad/s] of the first clump along its principal axes."""
    rotation = matrices(particles["orientation"][:1].astype(float))[0]
    return rotation.T @ particles["angular_velocity"][0]


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
    group = clump_group([[0.0, 0.0, 0.0]], ASYMMETRIC, angular_velocity=axes @ rates)
    scene = build_scene({"rotor": group}, run={"duration": duration, "time_step": step, "velocity_max": 1e-3})
    snapshots = run_and_sample(scene, duration / 12, threads=1)
    assert len(snapshots) == 13
    found = np.array([body_rates(each.particles)[order] for each in snapshots])
    expected = np.array([free_rotor(each.time, rates[order], shape.moments[order]) for each in snapshots])
    # the closed form fixes the sense of rotation only up to the handedness of the sorted axes
    handed = np.linalg.det(np.eye(3)[order])
    return np.abs(found - expected * [1.0, handed, 1.0]).max() / 100.0


def test_torque_free_rotor_converges_to_the_jacobi_functions_with_order_two(taichi_f64):
    coarse = rotor_error(1e-4)
    fine = rotor_error(5e-5)
    assert fine < 1e-5
    assert coarse / fine == pytest.approx(4.0, rel=0.02)


def test_angular_momentum_of_a_torque_free_rotor_is_exact(taichi_f64):
    group = clump_group([[0.0, 0.0, 0.0]], ASYMMETRIC, angular_velocity=[30.0, -50.0, 70.0])
    simulation = Simulation(
        build_scene({"rotor": group}, run={"duration": 1.0, "time_step": 5e-5}), threads=1
    )
    before = simulation.snapshot()
    simulation.step(5000)
    after = simulation.snapshot()
    simulation.free()
    momentum = "clump_angular_momentum"
    assert np.array_equal(before.particles[momentum], after.particles[momentum])
    assert not np.allclose(before.particles["orientation"], after.particles["orientation"])


FRICTIONLESS = {"friction": 0.0}


def rod_impact(angle, speed, restitution):
    """Velocity and angular velocity of a rod after its lower end hits a plate; the expected ones; turn in
    contact."""
    shape = shape_of(ROD)
    end = np.abs(np.array(ROD)[:, 0]).max()
    height = end * np.sin(np.deg2rad(angle)) + 0.002 + 1e-6
    group = clump_group(
        [[0.0, 0.0, height]], orientation=about([0, 1, 0], angle), velocity=[0.0, 0.0, -speed]
    )
    stiff = {"glass": {"young_modulus": 1e10, "poisson_ratio": 0.25, "density": DENSITY}}
    scene = build_scene(
        {"rod": group}, {"plate": plane([0, 0, 0], [0, 0, 1])}, FRICTIONLESS | {"restitution": restitution},
        materials=stiff, run={"duration": 4e-4, "velocity_max": 2 * speed},
    )  # fmt: skip
    snapshots = run_and_sample(scene, 4e-6, threads=1)
    last = snapshots[-1].particles
    in_contact = [each for each in snapshots if each.totals["contact_count"] > 0]
    assert len(in_contact) > 5 and not snapshots[-1].totals["contact_count"]
    turn = abs(last["angular_velocity"][0, 1]) * (in_contact[-1].time - in_contact[0].time)
    # The rod turns about y by `angle`: its positive end, at x = end cos(angle), is the lower one.
    arm = end * np.cos(np.deg2rad(angle))
    mass = DENSITY * shape.volume
    inertia = DENSITY * shape.moments[1]
    impulse = (1.0 + restitution) * speed / (1.0 / mass + arm**2 / inertia)
    expected = -speed + impulse / mass, -arm * impulse / inertia
    found = last["clump_velocity"][0, 2], last["angular_velocity"][0, 1]
    gained = np.array([speed, 0.0])  # the impulse alone, in both
    return found + gained, expected + gained, turn


@pytest.mark.parametrize("restitution", [1.0, 0.6])
@pytest.mark.parametrize("angle", [20.0, 50.0])
def test_rod_that_hits_a_plate_has_the_velocities_of_the_impulse(angle, restitution, taichi_f64):
    """The closed form is that of an instantaneous impulse; the rod turns during the contact.

    That changes the lever arm by tan(angle) times the turn, relative to the arm, and the impulse by about as
    much.
    """
    found, expected, turn = rod_impact(angle, 0.01, restitution)
    allowed = turn * np.tan(np.deg2rad(angle))
    assert 0.0 < allowed < 1e-3
    assert found == pytest.approx(expected, rel=allowed)


def test_energy_of_elastic_rods_is_conserved_over_many_steps(taichi_f64):
    """Rods that bounce on a plate, over 1e5 steps; without losses the error remains below 1e-6."""
    group = clump_group([[0.0, 0.0, 0.008]], orientation=about([0, 1, 0], 35), velocity=[0.0, 0.0, 0.0])
    scene = build_scene(
        {"rod": group}, {"plate": plane([0, 0, 0], [0, 0, 1])}, {"restitution": 1.0, "friction": 0.0}, normal="hertz",
        gravity=[0.0, 0.0, -9.81],
        materials={"glass": {"young_modulus": 1e7, "poisson_ratio": 0.25, "density": DENSITY}},
        run={"duration": 0.1, "time_step": 1e-6, "velocity_max": 1.0}, output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip
    snapshots = run_and_sample(scene, 2e-3, threads=1)
    assert snapshots[-1].step == pytest.approx(100_000, abs=1)
    heights = np.array([each.particles["clump_velocity"][0, 2] for each in snapshots])
    assert (np.diff(np.sign(heights)) > 0).sum() >= 2  # it has bounced
    assert max(each.totals["rotational_energy"] for each in snapshots) > 1e-6
    assert max(abs(each.totals["energy_error"]) for each in snapshots) < 1e-6
