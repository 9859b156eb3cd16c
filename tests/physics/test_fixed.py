"""Fixed particles: zero velocity, contacts like those with a wall of their shape, and time step."""

from math import pi, sqrt

import numpy as np
import pytest
from scene_builders import SOFT, column, few_spheres, particle_group, run_and_sample

from granflow.plan.build import plan_for

RADIUS, FIXED_RADIUS, SPEED = 0.005, 0.008, 0.7
MASS = 4.0 / 3.0 * pi * RADIUS**3 * SOFT["density"]
HERTZ = 4.0 / 3.0 * SOFT["young_modulus"] / (2.0 * (1.0 - SOFT["poisson_ratio"] ** 2))
"""4/3 E* [Pa]: the Hertz stiffness without the square root of the effective radius."""
MOBILE = particle_group([[RADIUS + FIXED_RADIUS + 1e-4, 0, 0]], 2 * RADIUS, velocity=[[-SPEED, 0, 0]])
ROUGH = particle_group([[0, 0, 0], [-0.003, 0, 0]], 2 * FIXED_RADIUS) | {"fixed": True}
RUN = {"duration": 2e-3, "time_step": 1e-6, "velocity_max": 1.0}


def test_fixed_particle_acts_as_an_infinite_mass(taichi_f64):
    """A particle hits a fixed one of another size, which overlaps a second fixed particle behind it.

    Elastic impact: m v^2 / 2 = 2/5 k d^2.5 with the mass m of the mobile particle and 1/R = 1/R1 + 1/R2.
    """
    k = HERTZ * sqrt(RADIUS * FIXED_RADIUS / (RADIUS + FIXED_RADIUS))
    overlap_max = (5.0 * MASS * SPEED**2 / (4.0 * k)) ** 0.4
    snapshots = run_and_sample(
        few_spheres({"mobile": MOBILE, "rough": ROUGH}, pair={"restitution": 1.0}, run=RUN), 1e-6
    )
    position, velocity = (column(snapshots, name) for name in ("position", "velocity"))
    assert (RADIUS + FIXED_RADIUS - position[:, 0, 0]).max() == pytest.approx(overlap_max, rel=1e-4)
    assert velocity[-1, 0, 0] == pytest.approx(SPEED, rel=1e-6)
    assert np.all(position[:, 1:] == position[0, 1:]) and not velocity[:, 1:].any()
    assert snapshots[0].totals["contact_count"] == 0.0, "overlapping fixed particles form no contact"
    assert snapshots[0].totals["kinetic_energy"] == pytest.approx(0.5 * MASS * SPEED**2)
    assert max(abs(each.totals["energy_error"]) for each in snapshots) < 1e-4


def test_pair_cases_of_fixed_particles_use_the_mobile_mass():
    """The time step uses the mass of the mobile particle and both radii; fixed particles form no pair case."""
    plan = plan_for(few_spheres({"rough": ROUGH, "mobile": MOBILE}))
    cases = {frozenset(pair.name.split("-")): pair for pair in plan.pair_cases}
    assert frozenset({"rough"}) not in cases and frozenset({"mobile"}) in cases
    found = cases[frozenset({"mobile", "rough"})]
    assert found.mass_eff == pytest.approx(MASS)
    assert found.radius_eff == pytest.approx(RADIUS * FIXED_RADIUS / (RADIUS + FIXED_RADIUS))
