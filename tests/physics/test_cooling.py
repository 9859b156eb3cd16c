"""Haff's law: a gas of smooth inelastic spheres cools as (1 + t / t0)^-2."""

import numpy as np
import pytest
from scene_builders import box, build_scene, particle_group, run_and_sample, times

DIAMETER, SIDE, RESTITUTION = 0.01, 0.25, 0.9
COUNT = 10**3
STATISTICS, BIAS = 0.04, 0.04
"""Relative tolerances. About 6000 collisions have a standard error of 1.3 %, times three. The contact
duration, 0.3 ms of the 30 ms between two collisions, and the higher density of colder regions slow the
cooling by some percent."""


@pytest.mark.slow
def test_gas_of_inelastic_spheres_cools_by_haffs_law(taichi_f64):
    """wE = 4 n s^2 chi sqrt(pi T / m), chi = (1 - phi/2) / (1 - phi)^3, T = T0 (1 + (1 - e^2) wE0 t / 6)^-2.

    The centers move in a cube of side a, the side of the box minus one diameter. The fraction 1 - 3 s / (2 a)
    of the positions one diameter away from a center lies in this cube (1 - surface * distance / (4 volume),
    Cauchy's formula).
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
    snapshots = run_and_sample(scene, 0.02)[3:]  # the initial lattice has no influence after 60 ms
    mass = snapshots[0].particles["mass"][0]
    t = times(snapshots)
    temperature = np.array([2.0 / 3.0 * snapshot.totals["kinetic_energy"] / COUNT for snapshot in snapshots])
    side = SIDE - DIAMETER
    solid_fraction = COUNT * np.pi / 6.0 * (DIAMETER / side) ** 3
    chi = (1.0 - 0.5 * solid_fraction) / (1.0 - solid_fraction) ** 3
    collision_rate = 4.0 * COUNT / side**3 * DIAMETER**2 * chi * np.sqrt(np.pi * temperature[0] / mass)
    cooling_rate = (1.0 - RESTITUTION**2) / 6.0 * collision_rate * (1.0 - 1.5 * DIAMETER / side)
    slope, offset = np.polyfit(t - t[0], np.sqrt(temperature[0] / temperature), 1)
    assert temperature[-1] < 0.35 * temperature[0]
    assert slope == pytest.approx(cooling_rate, rel=STATISTICS + BIAS)
    curve = (offset + slope * (t - t[0])) ** -2.0
    np.testing.assert_allclose(temperature / temperature[0], curve, rtol=STATISTICS)
