"""Distances of the contact point from the centers, torque over tangential force, against Hertz's solution."""

import numpy as np
import pytest
from scene_builders import build_scene, particle_group, plane

from granflow import Simulation

RADIUS, OVERLAP = 1e-3, 2e-5


def hertz_arm(radius, partner_radius, overlap):
    """Mean distance of the contact surface from a center, weighted with the pressure, for equal moduli [m].

    Both surfaces are displaced by u = (d - r^2/(2 R)) / 2 where the pressure is p ~ sqrt(1 - r^2/a^2), a^2 =
    R d, so that the contact surface is at the distance R_1 - r^2/(2 R_1) - u.
    """
    curvature = 1.0 / radius + 1.0 / partner_radius
    square = np.linspace(0.0, overlap / curvature, 100_001)
    pressure = np.sqrt(1.0 - square / square[-1])
    distance = radius - 0.5 * square / radius - 0.5 * (overlap - 0.5 * square * curvature)
    return np.trapezoid(pressure * distance, square) / np.trapezoid(pressure, square)


def measured_arms(partner_radius):
    """Torque over tangential force of a sphere and its partner, none for a wall (infinite radius); overlap
    [m]."""
    is_wall = np.isinf(partner_radius)
    groups = {"sphere": particle_group([0, 0, RADIUS - OVERLAP], 2 * RADIUS, velocity=[0.1, 0, 0])}
    if not is_wall:
        groups["partner"] = particle_group([0, 0, -partner_radius], 2 * partner_radius)
    scene = build_scene(
        groups, walls={"floor": plane([0, 0, 0], [0, 0, 1])} if is_wall else {},
        pair={"restitution": 0.9, "friction": 0.3}, run={"duration": 1e-3, "velocity_max": 1.0},
    )  # fmt: skip
    simulation = Simulation(scene)
    simulation.step(3)
    particles = simulation.snapshot().particles
    simulation.free()
    distance = particles["position"][0] - ([0, 0, 0] if is_wall else particles["position"][1])
    normal = np.array([0.0, 0.0, 1.0]) if is_wall else distance / np.linalg.norm(distance)
    overlap = RADIUS + (0.0 if is_wall else partner_radius) - distance @ normal
    tangential = particles["force"][0] - particles["force"][0] @ normal * normal
    torques = np.linalg.norm(particles["torque"], axis=1)
    return torques / np.linalg.norm(tangential), overlap


@pytest.mark.parametrize("ratio", [1.0, 5.0, 20.0, np.inf])
def test_the_contact_point_halves_the_overlap(taichi_f64, ratio):
    """As for Hertz's contact of equal moduli, within a tenth of the overlap; exactly for equal radii."""
    others = np.array([ratio * RADIUS, RADIUS])
    arms, overlap = measured_arms(others[0])
    radii = np.array([RADIUS, others[0]])[: len(arms)]
    np.testing.assert_allclose((radii - arms) / overlap, 0.5, rtol=1e-6)
    exact = [hertz_arm(radius, other, overlap) for radius, other in zip(radii, others, strict=False)]
    np.testing.assert_allclose(arms, exact, rtol=0.0, atol=(0.1 * (1.0 - 1.0 / ratio) + 1e-5) * overlap)
