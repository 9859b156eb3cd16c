"""Twisting friction: a sphere that spins about the vertical on a plate, and its energy."""

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

GRAVITY, RADIUS, SPIN, FRICTION = 9.81, 5e-3, 20.0, 0.4
MATERIAL = {"young_modulus": 1e7, "poisson_ratio": 0.3, "density": 2500.0}
MASS = 4.0 / 3.0 * np.pi * RADIUS**3 * MATERIAL["density"]
INERTIA = 0.4 * MASS * RADIUS**2
WEIGHT = MASS * GRAVITY
MODULUS = MATERIAL["young_modulus"] / (2.0 * (1.0 - MATERIAL["poisson_ratio"] ** 2))
OVERLAP = float((WEIGHT / theory.hertz_stiffness(MODULUS, RADIUS)) ** (2.0 / 3.0))
"""Overlap [m] at which a Hertz contact carries the weight."""
CONTACT_RADIUS = np.sqrt(RADIUS * OVERLAP)
SHEAR = MATERIAL["young_modulus"] / (2.0 * 1.3) / (2.0 * 1.7)


def spinning(twisting, duration, spin=SPIN, **pair):
    """Snapshots of a sphere at rest on a plate that spins about the vertical."""
    sphere = particle_group([0.0, 0.0, RADIUS - OVERLAP], 2 * RADIUS, angular_velocity=[0.0, 0.0, spin])
    scene = few_spheres(
        {"ball": sphere}, {"floor": plane([0, 0, 0], [0, 0, 1])}, {"restitution": 1.0, "friction": FRICTION, **pair},
        materials={"glass": MATERIAL}, gravity=[0.0, 0.0, -GRAVITY], run={"duration": duration, "velocity_max": 0.1},
        contact={"normal": "hertz", "tangential": "mindlin", "rolling": "none", "twisting": twisting},
        pairs={"fixed-fixed": {"restitution": 0.5, "friction": 0.5, **pair}},
    )  # fmt: skip
    return run_and_sample(scene, duration / 60)


def test_spinning_sphere_stops_after_the_theoretical_time(taichi_f64):
    """The constant torque T = (2/3) mu a F (Marshall 2009) decelerates it by T/I: time I w / T, angle I w^2 /
    (2 T), dissipated energy I w^2 / 2. The spring of 4 G a^3 turns the sphere back and forth: k theta^2 / 2 =
    T^2 / (2 k) = I w^2 / 2."""
    limit = 2.0 / 3.0 * FRICTION * CONTACT_RADIUS * WEIGHT
    stopping_time = INERTIA * SPIN / limit
    snapshots = spinning("marshall", 1.1 * stopping_time)
    t = times(snapshots)
    rate = column(snapshots, "angular_velocity")[:, 0, 2]
    decelerating = t < 0.95 * stopping_time
    expected = SPIN * (1.0 - t[decelerating] / stopping_time)
    np.testing.assert_allclose(rate[decelerating], expected, rtol=0.0, atol=2e-3 * SPIN)
    assert np.trapezoid(rate, t) == pytest.approx(0.5 * SPIN * stopping_time, rel=5e-3)
    largest = limit / np.sqrt(4.0 * SHEAR * CONTACT_RADIUS**3 * INERTIA)
    assert np.abs(rate[t > 1.02 * stopping_time]).max() < 1.01 * largest < 0.1 * SPIN
    last = snapshots[-1].totals
    assert last["rolling_dissipation"] == pytest.approx(0.5 * INERTIA * SPIN**2, rel=5e-3)
    assert abs(last["energy_error"]) < 1e-4


def test_torsion_spring_oscillates_with_its_damped_period(taichi_f64):
    """Below the limit: w(t) = w0 exp(-g t) (cos(f t) - g/f sin(f t)), g = c / (2 I), f^2 = k / I - g^2."""
    stiffness = 1e-4
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
