"""Damping of all motion for settling: closed forms of drag and of Cundall damping, energy budget, stages."""

import math

import numpy as np
import pytest
from scene_builders import SOFT, column, few_spheres, particle_group, plane, run_and_sample, times

from granflow.contact import theory

DIAMETER, GRAVITY, NONE = 0.01, 9.81, 1e-14
MASS = SOFT["density"] * math.pi / 6.0 * DIAMETER**3
FLOOR = {"floor": plane([0.0] * 3, [0.0, 0.0, 1.0])}


def damped(group, duration, cundall=NONE, drag=NONE, gravity=GRAVITY, walls=None, time_step=1e-5, **parts):
    """Particles with both kinds of damping, of which one may be negligible."""
    parts = {"run": {"duration": duration, "velocity_max": 1.0, "time_step": time_step}} | parts
    pair = {"restitution": 1.0, "friction": 0.4}
    damping = {"cundall": cundall, "drag": drag} | parts.pop("damping", {})
    return few_spheres({"balls": group}, walls, pair, damping=damping, gravity=[0.0, 0.0, -gravity], **parts)


def test_drag_decays_velocities_exponentially(taichi_f64):
    """A step changes a free velocity by (1 - h) / (1 + h), h = g dt / 2: the rate is wrong by h^2 / 3."""
    rate = 200.0
    ball = particle_group([0.0] * 3, DIAMETER, velocity=[0.6, -0.3, 0.2], angular_velocity=[4.0, 0.0, -8.0])
    snapshots = run_and_sample(damped(ball, 0.01, drag=rate, gravity=0.0), 1e-3)
    decay = np.exp(-rate * times(snapshots))[:, None, None]
    for name in ("velocity", "angular_velocity"):
        expected = decay * column(snapshots, name)[0]
        np.testing.assert_allclose(column(snapshots, name), expected, rtol=2.0 * (0.5 * rate * 1e-5) ** 2)
    first, last = snapshots[0].totals, snapshots[-1].totals
    lost = sum(first[name] - last[name] for name in ("kinetic_energy", "rotational_energy"))
    assert last["damping_dissipation"] == pytest.approx(lost, rel=1e-5)


def test_cundall_damping_reduces_the_amplitude_of_an_oscillator_in_each_half_period(taichi_f64):
    """A particle on an elastic floor, displaced from rest by A, 0.2 % of its overlap, below the equilibrium.

    On the way to the equilibrium the force is (1 - a) k x, afterwards (1 + a) k x, because the damping force
    opposes the velocity. The energy at the equilibrium gives A' / A = sqrt((1 - a) / (1 + a)) for a half
    period, which takes T = pi / 2 sqrt(m / k) (1 / sqrt(1 - a) + 1 / sqrt(1 + a)).
    """
    ratio = 0.2
    hertz = theory.hertz_stiffness(
        SOFT["young_modulus"] / (2 * (1 - SOFT["poisson_ratio"] ** 2)), 0.5 * DIAMETER
    )
    sag = (MASS * GRAVITY / hertz) ** (2.0 / 3.0)
    stiffness = 1.5 * hertz * math.sqrt(sag)
    amplitude = 2e-3 * sag
    both = sum((1.0 + sign * ratio) ** -0.5 for sign in (-1.0, 1.0))
    half_period = 0.5 * math.pi * math.sqrt(MASS / stiffness) * both
    ball = particle_group([[0.0, 0.0, 0.5 * DIAMETER - sag - amplitude]], DIAMETER)
    scene = damped(ball, 4.0 * half_period, cundall=ratio, walls=FLOOR, time_step=half_period / 1000.0)
    snapshots = run_and_sample(scene, half_period)
    heights = column(snapshots, "position")[:5, 0, 2] - (0.5 * DIAMETER - sag)
    expected = -amplitude * (-math.sqrt((1.0 - ratio) / (1.0 + ratio))) ** np.arange(5)
    np.testing.assert_allclose(heights, expected, atol=2e-3 * amplitude)
    lost = 0.5 * stiffness * (expected[0] ** 2 - expected[4] ** 2)
    assert snapshots[-1].totals["damping_dissipation"] == pytest.approx(lost, rel=4e-3)


def test_damping_of_a_stage_ends_with_it_and_the_energy_budget_closes(taichi_f64):
    """27 particles fall on a floor for 20 ms and remain on it for 20 ms; damping acts in the first stage."""
    rng = np.random.default_rng(2)
    positions = 0.0105 * (np.argwhere(np.ones((3, 3, 3))) + 0.6)
    bed = particle_group(positions, DIAMETER, velocity=rng.normal(0.0, 0.3, positions.shape))
    stages = [{"name": "settle", "duration": 0.02}, {"name": "rest", "duration": 0.02}]
    given = {
        "stages": stages,
        "run": {"velocity_max": 1.0},
        "damping": {"stages": ["settle"]},
        "walls": FLOOR,
    }
    strong, weak = (
        run_and_sample(damped(bed, None, **ratios, **given), 0.02)
        for ratios in ({"cundall": 0.5, "drag": 50.0}, {})
    )
    assert strong[1].totals["kinetic_energy"] < 0.2 * weak[1].totals["kinetic_energy"]
    assert abs(strong[-1].totals["energy_error"]) < 2e-3
    lost = [each.totals["damping_dissipation"] for each in strong]
    assert lost[1] > 10.0 * weak[-1].totals["damping_dissipation"]
    assert lost[2] - lost[1] < 1e-2 * lost[1]
    assert np.ptp(strong[-1].particles["velocity"][:-1], axis=0).max() > 1e-3, "particles still move"


COLUMN_RESTITUTIONS = (0.0, 0.05, 0.3, 1.0)


def test_column_rests_with_the_overlaps_of_hertz_at_every_restitution(taichi_f64):
    """A contact that is loaded slowly is on the loading curve, and carries its load there.

    Columns of spheres that just touch are let down by a drag: d = (n m g / k)^(2/3) below n spheres,
    k = (4/3) E sqrt(R), E = E_material / (2 (1 - nu^2)), R = radius at the floor and half of it between spheres.
    """
    count, radius = 12, 0.002
    soft = {"young_modulus": 2e6, "poisson_ratio": 0.25, "density": 2500.0}
    names = [f"solid_{number}" for number in range(len(COLUMN_RESTITUTIONS))]
    groups = {
        name: particle_group([[0.01 * number, 0.0, radius * (2 * row + 1)] for row in range(count)], 2 * radius, name)
        for number, name in enumerate(names)
    }  # fmt: skip
    pairs = {
        pair: {"restitution": restitution, "friction": 0.0}
        for name, restitution in zip(names, COLUMN_RESTITUTIONS, strict=True)
        for pair in (f"{name}-{name}", f"{name}-floor")
    }
    scene = few_spheres(
        groups, {"floor": plane([0, 0, 0], [0, 0, 1], "floor")}, materials=dict.fromkeys([*names, "floor"], soft),
        pairs=pairs, gravity=[0.0, 0.0, -GRAVITY], damping={"drag": 4000.0, "cundall": NONE},
        run={"duration": 0.5, "velocity_max": 0.3},
    )  # fmt: skip
    last = run_and_sample(scene, 1.0)[-1]
    height = last.particles["position"][:-1, 2].reshape(len(names), count)
    radius_eff = np.where(np.arange(count) == 0, radius, radius / 2)
    stiffness = 4.0 / 3.0 * 2e6 / (2.0 * (1.0 - 0.25**2)) * np.sqrt(radius_eff)
    weight = 2500.0 * 4.0 / 3.0 * np.pi * radius**3 * GRAVITY
    hertz = (weight * (count - np.arange(count)) / stiffness) ** (2 / 3)
    overlap = np.concatenate([radius - height[:, :1], 2.0 * radius - np.diff(height, axis=1)], axis=1)
    np.testing.assert_allclose(overlap / hertz, np.ones((len(names), count)), rtol=2e-3)
    assert abs(last.totals["energy_error"]) < 1e-4
