"""Haff's law: a gas of smooth inelastic spheres cools as (1 + t / t0)^-2."""

import numpy as np
import pytest
from scene_builders import box, build_scene, particle_group, run_and_sample, times

DIAMETER, SIDE, RESTITUTION = 0.01, 0.25, 0.9
COUNT = 10**3
STATISTICS, BIAS = 0.04, 0.04
"""About 6000 collisions, each worth its share give or take as much: 1.3 %, three times. Contacts that last 0.3 ms of
the 30 ms between two, and a gas that is denser where it is colder, slow the cooling by some percent more."""


@pytest.mark.slow
def test_a_gas_of_inelastic_spheres_cools_by_haffs_law(taichi_f64):
    """wE = 4 n s^2 chi sqrt(pi T / m), chi = (1 - phi/2) / (1 - phi)^3, T = T0 (1 + (1 - e^2) wE0 t / 6)^-2.

    Centers have the box less a diameter, side a; of the places one diameter away from a center in it, a share
    1 - 3 s / (2 a) lies in it too (one less surface times distance over four volumes, Cauchy's formula).
    """
    rng = np.random.default_rng(1)
    positions = (SIDE / 10.0) * (np.argwhere(np.ones((10, 10, 10))) + 0.5)
    velocity = rng.normal(0.0, 1.0, positions.shape)
    velocity -= velocity.mean(axis=0)
    scene = build_scene(
        {"gas": particle_group(positions, DIAMETER, velocity=velocity)}, walls=box(SIDE, "smooth"),
        pairs={"glass-glass": {"restitution": RESTITUTION, "friction": 0},
               "glass-smooth": {"restitution": 1.0, "friction": 0}},
        run={"duration": 0.6, "velocity_max": 6.0}, numerics={"time_step_fraction": 0.05, "max_overlap": 0.5},
    )  # fmt: skip
    seen = run_and_sample(scene, 0.02)[3:]  # by then the lattice of the start is forgotten
    mass, t = seen[0].particles["mass"][0], times(seen)
    temperature = np.array([2.0 / 3.0 * snapshot.totals["kinetic_energy"] / COUNT for snapshot in seen])
    side = SIDE - DIAMETER
    share = COUNT * np.pi / 6.0 * (DIAMETER / side) ** 3
    chi = (1.0 - 0.5 * share) / (1.0 - share) ** 3
    pair = 4.0 * COUNT / side**3 * DIAMETER**2 * chi * np.sqrt(np.pi * temperature[0] / mass)
    rate = (1.0 - RESTITUTION**2) / 6.0 * pair * (1.0 - 1.5 * DIAMETER / side)
    slope, offset = np.polyfit(t - t[0], np.sqrt(temperature[0] / temperature), 1)
    assert temperature[-1] < 0.35 * temperature[0]
    assert slope == pytest.approx(rate, rel=STATISTICS + BIAS)
    curve = (offset + slope * (t - t[0])) ** -2.0
    np.testing.assert_allclose(temperature / temperature[0], curve, rtol=STATISTICS)
