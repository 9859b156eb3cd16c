"""Damping of all motion for settling: closed forms of drag and of Cundall damping, energy budget, stages."""

import math

import numpy as np
import pytest
from scene_builders import box, build_scene, column, particle_group, plane, run_and_sample, times

DIAMETER = 0.01
MASS = 2500.0 * math.pi / 6.0 * DIAMETER**3
OUTPUT = {"interval": 1.0, "energy_budget": True}
DISSIPATED = tuple(f"{name}_dissipation" for name in ("plastic", "friction", "rolling", "damping"))


def free_particle(damping, duration, **parts):
    """One particle that rotates and may fall; a second one far away gives it friction and thereby
    rotation."""
    particles = particle_group(
        [[0.0] * 3, [0.0, 0.3, 0.0]], DIAMETER, velocity=[0.6, -0.3, 0.2], angular_velocity=[4.0, 0.0, -8.0]
    )
    run = {"duration": duration, "velocity_max": 1.0, "time_step": 1e-5}
    return build_scene(
        {"particles": particles}, damping=damping, pair={"friction": 0.5}, run=run, output=OUTPUT, **parts
    )


def test_drag_decays_velocities_exponentially(taichi_f64):
    """A step changes a free velocity by (1 - h) / (1 + h), h = g dt / 2: the rate is wrong by h^2 / 3."""
    rate = 200.0
    snapshots = run_and_sample(free_particle({"drag": rate}, 0.01), 1e-3)
    decay = np.exp(-rate * times(snapshots))[:, None, None]
    for name in ("velocity", "angular_velocity"):
        expected = decay * column(snapshots, name)[0]
        np.testing.assert_allclose(column(snapshots, name), expected, rtol=2.0 * (0.5 * rate * 1e-5) ** 2)
    first, last = snapshots[0].totals, snapshots[-1].totals
    lost = sum(first[name] - last[name] for name in ("kinetic_energy", "rotational_energy"))
    assert last["damping_dissipation"] == pytest.approx(lost, rel=1e-5)


def test_terminal_velocity_of_drag_is_exact(taichi_f64):
    """v = g / rate for any time step, after 40 decay times; the energies are of second order in h = rate dt /
    2."""
    scene = free_particle({"drag": 2000.0}, 0.02, gravity=[0.0, 0.0, -9.81])
    last = run_and_sample(scene, 0.02)[-1]
    np.testing.assert_allclose(
        last.particles["velocity"], [[0.0, 0.0, -9.81 / 2000.0]] * 2, rtol=1e-12, atol=1e-15
    )
    assert abs(last.totals["energy_error"]) < 2.0 * (0.5 * 2000.0 * 1e-5) ** 2


def test_cundall_damping_reduces_the_amplitude_of_an_oscillator_in_each_half_period(taichi_f64):
    """A particle on a linear spring, displaced from rest by A below the equilibrium.

    On the way to the equilibrium the force is (1 - a) k x, afterwards (1 + a) k x, because the damping force
    opposes the velocity. The energy at the equilibrium gives A' / A = sqrt((1 - a) / (1 + a)) for a half
    period, which takes T = pi / 2 sqrt(m / k) (1 / sqrt(1 - a) + 1 / sqrt(1 + a)).
    """
    ratio = 0.2
    stiffness = 1e3
    gravity = 9.81
    sag = MASS * gravity / stiffness
    amplitude = 0.5 * sag
    half_period = (
        0.5 * math.pi * math.sqrt(MASS / stiffness) * sum((1.0 + s * ratio) ** -0.5 for s in (-1.0, 1.0))
    )
    scene = build_scene(
        {"ball": particle_group([[0.0, 0.0, 0.5 * DIAMETER - sag - amplitude]], DIAMETER)},
        walls={"floor": plane([0.0] * 3, [0.0, 0.0, 1.0])},
        normal={"law": "linear", "stiffness": {"value": stiffness}},
        pair={"restitution": 1.0},
        damping={"cundall": ratio},
        gravity=[0.0, 0.0, -gravity],
        run={"duration": 4.0 * half_period, "velocity_max": 0.1, "time_step": half_period / 1000.0},
        output=OUTPUT,
    )
    snapshots = run_and_sample(scene, half_period)
    heights = column(snapshots, "position")[:5, 0, 2] - (0.5 * DIAMETER - sag)
    expected = -amplitude * (-math.sqrt((1.0 - ratio) / (1.0 + ratio))) ** np.arange(5)
    np.testing.assert_allclose(heights, expected, atol=2e-3 * amplitude)
    totals = snapshots[-1].totals
    lost = 0.5 * stiffness * (expected[0] ** 2 - expected[4] ** 2)
    assert totals["damping_dissipation"] == pytest.approx(lost, rel=4e-3)


def test_cundall_damping_slows_free_fall(taichi_f64):
    """A particle that falls from rest accelerates with (1 - a) g."""
    particle = particle_group([[0.0] * 3], DIAMETER)
    run = {"duration": 0.05, "velocity_max": 1.0, "time_step": 1e-5}
    scene = build_scene(
        {"ball": particle}, damping={"cundall": 0.3}, gravity=[0.0, 0.0, -9.81], run=run, output=OUTPUT
    )
    last = run_and_sample(scene, 0.05)[-1]
    assert last.particles["velocity"][0, 2] == pytest.approx(-0.7 * 9.81 * last.time, rel=1e-3)
    assert last.totals["damping_dissipation"] == pytest.approx(
        0.3 * MASS * 9.81 * 0.35 * 9.81 * last.time**2, rel=1e-3
    )


def settling_bed(damping, **parts):
    """64 particles that fall into a box for 20 ms and remain in it for 20 ms; several chunks."""
    rng = np.random.default_rng(2)
    positions = 0.0105 * (np.argwhere(np.ones((4, 4, 4))) + 0.6)
    bed = particle_group(positions, DIAMETER, velocity=rng.normal(0.0, 0.3, positions.shape))
    defaults = {
        "walls": box(0.045),
        "gravity": [0.0, 0.0, -9.81],
        "pair": {"friction": 0.4},
        "stages": [{"name": "settle", "duration": 0.02}, {"name": "rest", "duration": 0.02}],
        "run": {"velocity_max": 1.0},
        "numerics": {"chunk_size": 16},
        "output": OUTPUT,
    }
    return build_scene({"bed": bed}, damping=damping, **(defaults | parts))


def test_bed_settles_faster_and_the_energy_budget_closes(taichi_f64):
    """Damping in the first stage only: afterwards, no more energy is lost in it."""
    damping = {"cundall": 0.5, "drag": 50.0, "stages": ["settle"]}
    damped, plain = (run_and_sample(settling_bed(each), 0.02) for each in (damping, None))
    assert damped[1].totals["kinetic_energy"] < 0.2 * plain[1].totals["kinetic_energy"]
    assert abs(damped[-1].totals["energy_error"]) < 2e-3
    contacts_only = [s.totals["damping_dissipation"] for s in plain]
    lost = [s.totals["damping_dissipation"] for s in damped]
    assert lost[1] > 10.0 * contacts_only[-1]
    assert lost[2] - lost[1] < 1e-2 * lost[1]
