"""Distances of the contact point from the centers, torque over tangential force, against Hertz's solution."""

import numpy as np
import pytest
from scene_builders import few_spheres, particle_group, plane

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


@pytest.mark.parametrize("ratio", [1.0, 2.5, np.inf])
def test_the_contact_point_halves_the_overlap(taichi_f64, ratio):
    """As for Hertz's contact of equal moduli, within a tenth of the overlap; exactly for equal radii.

    Torque over tangential force of a sphere and its partner; an infinite radius is a wall, without torque.
    """
    partner = ratio * RADIUS
    groups = {"sphere": particle_group([0, 0, RADIUS - OVERLAP], 2 * RADIUS, velocity=[0.1, 0, 0])}
    walls = {"floor": plane([0, 0, 0], [0, 0, 1])}
    if np.isfinite(ratio):
        groups["partner"] = particle_group([0, 0, -partner], 2 * partner)
        walls = None
    simulation = Simulation(few_spheres(groups, walls, {"restitution": 0.9, "friction": 0.3},
                                        run={"duration": 1e-3, "velocity_max": 1.0}))  # fmt: skip
    simulation.step(3)
    particles = simulation.snapshot().particles
    simulation.free()
    radii = np.array([RADIUS, partner])[: len(groups)]
    distance = particles["position"][0] - (particles["position"][1] if walls is None else 0.0)
    normal = np.array([0.0, 0.0, 1.0]) if walls else distance / np.linalg.norm(distance)
    overlap = radii.sum() - distance @ normal
    tangential = particles["force"][0] - particles["force"][0] @ normal * normal
    arms = np.linalg.norm(particles["torque"][: len(radii)], axis=1) / np.linalg.norm(tangential)
    np.testing.assert_allclose((radii - arms) / overlap, 0.5, rtol=1e-6)
    exact = [
        hertz_arm(radius, other, overlap) for radius, other in zip(radii, (partner, RADIUS), strict=False)
    ]
    np.testing.assert_allclose(arms, exact, rtol=0.0, atol=(0.1 * (1.0 - 1.0 / ratio) + 1e-5) * overlap)
