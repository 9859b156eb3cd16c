"""Haff's law: a gas of smooth inelastic spheres cools as (1 + t / t0)^-2."""

import numpy as np
import pytest
from trials import balls, box, times, trial, watched

DIAMETER, COUNT, SIDE, RESTITUTION = 0.01, 512, 0.2, 0.9


@pytest.mark.slow
def test_a_gas_of_inelastic_spheres_cools_by_haffs_law(taichi_f64):
    """wE = 4 n s^2 chi sqrt(pi T / m), chi = (1 - phi/2) / (1 - phi)^3, T = T0 (1 + (1 - e^2) wE0 t / 6)^-2.

    The elastic walls leave centres the box less a diameter. 512 spheres meet about 3000 times: the rate is known to
    some 2 %, the walls' boundary layer adds a few more.
    """
    rng = np.random.default_rng(9)
    places = (SIDE / 8.0) * (np.argwhere(np.ones((8, 8, 8))) + 0.5)
    velocity = rng.normal(0.0, 1.0, places.shape)
    velocity -= velocity.mean(axis=0)
    scene = trial(
        {"gas": balls(places, DIAMETER, velocity=velocity)}, walls=box(SIDE, "smooth"),
        pairs={"glass-glass": {"restitution": RESTITUTION, "friction": 0},
               "glass-smooth": {"restitution": 1.0, "friction": 0}},
        run={"duration": 0.5, "velocity_max": 6.0}, numerics={"time_step_safety": 0.05},
    )  # fmt: skip
    seen = watched(scene, 0.02)
    mass = seen[0].particles["mass"][0]
    energy = np.array([snapshot.totals["kinetic_energy"] for snapshot in seen])
    temperature = 2.0 / 3.0 * energy / COUNT
    free = (SIDE - DIAMETER) ** 3
    share = COUNT * np.pi / 6.0 * DIAMETER**3 / free
    chi = (1.0 - 0.5 * share) / (1.0 - share) ** 3
    t = times(seen)
    start = 1  # velocities are Gaussian from the start, positions are disordered after one interval
    rate = 4.0 * COUNT / free * DIAMETER**2 * chi * np.sqrt(np.pi * temperature[start] / mass)
    slope = np.polyfit(t[start:], np.sqrt(temperature[start] / temperature[start:]), 1)[0]
    assert temperature[-1] < 0.4 * temperature[0]
    assert slope == pytest.approx((1.0 - RESTITUTION**2) * rate / 6.0, rel=0.06)
    curve = 1.0 / (1.0 + slope * (t[start:] - t[start])) ** 2
    np.testing.assert_allclose(temperature[start:] / temperature[start], curve, rtol=0.05)
