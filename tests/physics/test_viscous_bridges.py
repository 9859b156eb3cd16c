"""Viscous force of liquid bridges: lubrication between two spheres and at a wall, energy budget, time step."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scene_builders import build_scene, particle_group

from granflow.contact.law import ContactState
from granflow.errors import SceneError
from granflow.plan.build import plan_for
from granflow.simulation import Simulation

RADIUS, DENSITY = 1e-3, 2500.0
MASS = DENSITY * 4.0 / 3.0 * math.pi * RADIUS**3
VISCOSITY, RATIO = 0.1, 0.05
"""Viscosity [Pa s], and smallest distance over the effective radius."""
SMALLEST = RATIO * 0.5 * RADIUS
STOPPING = 6.0 * math.pi * VISCOSITY * (0.5 * RADIUS) ** 2 / (0.5 * MASS)
"""6 pi eta R^2 / m [m/s] of two spheres: velocity that they lose while their distance changes by a factor
e."""
STEP, OVERLAP = 1e-8, 1e-12
"""Time step [s], and overlap [m] at which the bridges form."""
FILM = 0.02
"""Volume of the film over that of each particle."""


def wet_scene(groups, viscosity=VISCOSITY, **run):
    """A scene of elastic particles with bridges without surface tension."""
    viscous = {"viscosity": viscosity, "min_separation_ratio": RATIO}
    cohesion = {"law": "capillary_transfer", "max_bridge_volume": 1e-11, "viscous_force": viscous}
    pair = {"restitution": 1.0, "surface_tension": 0.0, "contact_angle": 0.2}
    groups = {name: group | {"liquid_content": FILM} for name, group in groups.items()}
    return build_scene(
        groups, None, pair,
        contact={"normal": "hertz", "tangential": "none", "rolling": "none", "cohesion": cohesion},
        materials={"glass": {"young_modulus": 1e7, "poisson_ratio": 0.3, "density": DENSITY}},
        run={"duration": 0.01, "velocity_max": 0.3, **run}, numerics={"chunk_size": 1},
        output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip


def touching(speed, **more):
    """Two spheres that separate along x at a relative speed [m/s], with a tiny overlap."""
    velocity = 0.5 * speed * np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    positions = [[0.0, 0.0, 0.0], [2.0 * RADIUS - OVERLAP, 0.0, 0.0]]
    return {"balls": particle_group(positions, 2.0 * RADIUS, velocity=velocity, **more)}


def state_of(simulation):
    """Snapshot, distance of the surfaces [m], and velocity of the second sphere relative to the first."""
    last = simulation.snapshot()
    order = np.argsort(last.particles["id"])
    values = {name: last.particles[name][order] for name in ("position", "velocity")}
    branch = values["position"][1] - values["position"][0]
    return last, np.linalg.norm(branch) - 2.0 * RADIUS, (values["velocity"][1] - values["velocity"][0])[0]


def test_spheres_separate_and_approach_as_in_the_closed_form(taichi_f64):
    """m x'' = -6 pi eta R^2 x' / max(x, h): below h, v decreases linearly with x; above, v = v_h - k ln(x / h),
    with k = 6 pi eta R^2 / m. Spheres that approach at v from x stop at x exp(-v / k), before they touch if
    the Stokes number v / k is below ln(x / h). The energy budget closes to 1e-9."""
    speed = 2.2 * STOPPING
    simulation = Simulation(wet_scene(touching(speed), time_step=STEP))
    simulation.step(100_000)
    last, distance, velocity = state_of(simulation)
    assert 2.0 * SMALLEST < distance < simulation.plan.laws.range
    at_smallest = speed - STOPPING * (1.0 + OVERLAP / SMALLEST)
    expected = at_smallest - STOPPING * math.log(distance / SMALLEST)
    assert velocity == pytest.approx(expected, rel=1e-8)
    lost = 0.25 * MASS * (speed**2 - velocity**2)
    assert last.totals["damping_dissipation"] == pytest.approx(lost, rel=1e-9)
    assert abs(last.totals["energy_error"]) < 1e-9

    approach = 0.8 * STOPPING * math.log(distance / SMALLEST)
    simulation.particles.velocity = [[0.5 * approach, 0.0, 0.0], [-0.5 * approach, 0.0, 0.0]]
    simulation.step(200_000)
    last, stopped, velocity = state_of(simulation)
    assert abs(velocity) < 1e-2 * approach
    expected = distance * math.exp((-approach - velocity) / STOPPING)
    assert stopped == pytest.approx(expected, rel=1e-8) and stopped > SMALLEST
    assert abs(last.totals["energy_error"]) < 1e-9


def test_force_and_torques_of_sliding_and_rolling_spheres(taichi_f64):
    """F_n = 6 pi eta R^2 v_n / h, F_t = 6 pi eta R v_t (8/15 ln(R / h) + 0.9588), at the middle of the gap, so
    that the sum of all torques and of the angular momentum of the forces is 0."""
    spin = np.array([[3.0, 10.0, -20.0], [-5.0, 7.0, 40.0]])
    groups = touching(2.2 * STOPPING, angular_velocity=spin)
    simulation = Simulation(wet_scene(groups, time_step=STEP))
    simulation.step(20_000)
    simulation.particles.velocity = [[-0.02, 0.01, 0.03], [0.03, -0.02, 0.01]]
    simulation.step(20_000)
    particles = simulation.snapshot().particles
    order = np.argsort(particles["id"])
    x, v, w, force, torque = (
        particles[name][order] for name in ("position", "velocity", "angular_velocity", "force", "torque")
    )
    branch = x[0] - x[1]
    distance = np.linalg.norm(branch)
    normal = branch / distance
    gap = distance - 2.0 * RADIUS
    assert gap > 1.2 * SMALLEST
    rate = v[0] - v[1]
    slip = rate - rate @ normal * normal - np.cross(0.5 * distance * w.sum(axis=0), normal)
    radius = 0.5 * RADIUS
    stokes = 6.0 * math.pi * VISCOSITY * radius
    tangential = -stokes * (8.0 / 15.0 * math.log(radius / gap) + 0.9588) * slip
    expected = -stokes * radius / gap * rate @ normal * normal + tangential
    np.testing.assert_allclose(force[0], expected, rtol=1e-6)
    np.testing.assert_array_equal(force[1], -force[0])
    moment = np.cross(-0.5 * distance * normal, tangential)
    np.testing.assert_allclose(torque, [moment, moment], rtol=1e-6)
    np.testing.assert_allclose(
        torque.sum(axis=0) + np.cross(branch, force[0]), 0.0, atol=1e-9 * np.abs(torque).max()
    )
    state = ContactState(
        SimpleNamespace(distance=1.0), radius, 1.0, STEP, -gap, -rate @ normal,
        SimpleNamespace(bonded=1.0, bridge_volume=1e-12), slip,
    )  # fmt: skip
    found, found_tangential = simulation.plan.laws.cohesion.reference_viscous_force(state)
    np.testing.assert_allclose(found * normal + found_tangential, expected, rtol=1e-12)
    assert abs(simulation.snapshot().totals["energy_error"]) < 1e-9


def test_viscous_force_limits_the_time_step():
    """dt < m / c for the largest resistance c = 6 pi eta R / ratio of one contact, with 1 % of margin and the
    shear of the contact, c_t / c = ratio (8/15 ln(1 / ratio) + 0.9588)."""
    viscosity = 1e4
    plan = plan_for(wet_scene(touching(0.1), viscosity=viscosity))
    shear = RATIO * (8.0 / 15.0 * math.log(1.0 / RATIO) + 0.9588)
    resistance = 6.0 * math.pi * viscosity * 0.5 * RADIUS / RATIO * (1.0 + 2.0 * shear)
    limit = 0.99 * 0.5 * MASS / resistance
    assert plan.step.value == pytest.approx(limit, rel=1e-3)
    with pytest.raises(SceneError, match="above the stability limit"):
        plan_for(wet_scene(touching(0.1), viscosity=viscosity, time_step=2.0 * limit))
