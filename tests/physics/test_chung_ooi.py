"""The benchmark collisions of Chung & Ooi (2011), Granular Matter 13:643, doi 10.1007/s10035-011-0277-0.

Tables 1-2 of the paper give the materials. Values without another source follow from Hertz's closed forms
dmax = (5 M v^2 / 4 k)^(2/5), F = k dmax^1.5, T = 2.9433 dmax / v, which the paper prints in rounded form.
"""

import numpy as np
import pytest
from scene_builders import colliding, column, few_spheres, particle_group, plane, run_and_sample, times

GLASS = {"young_modulus": 48e9, "poisson_ratio": 0.20, "density": 2800.0}
ALLOY = {"young_modulus": 70e9, "poisson_ratio": 0.30, "density": 2699.0}
RIGID = {"young_modulus": 1e25, "poisson_ratio": 0.3, "density": 1e4}
FLOOR = {"floor": plane([0, 0, 0], [0, 0, 1], "rigid")}

HALF_DIGIT = 6e-4
"""Relative tolerance: the values of the benchmark have four to five digits."""


@pytest.mark.parametrize(
    ("diameter", "material", "velocity", "overlap_max", "force_max", "duration"),
    [
        pytest.param(0.02, GLASS, 10.0, 274.11e-6, 10.697e3, 40.34e-6, id="1 glass pair"),
        pytest.param(0.2, ALLOY, 0.2, 49.717e-6, 11.370e3, 731.6e-6, id="2 alloy on plane"),
    ],
)
def test_elastic_collisions_reach_the_overlap_force_and_duration(
    taichi_f64, diameter, material, velocity, overlap_max, force_max, duration
):
    """Tests 1 and 2: maximum overlap [m], maximum force [N] and duration [s]."""
    if material is GLASS:
        group = colliding(diameter, diameter, 2 * velocity)
    else:
        group = particle_group([[0.0, 0.0, 0.5 * diameter]], diameter, velocity=[0.0, 0.0, -velocity])
    scene = few_spheres(
        {"balls": group}, FLOOR if material is ALLOY else None, {"restitution": 1.0},
        materials={"glass": material, "rigid": RIGID}, run={"duration": 1e-3, "velocity_max": 2 * velocity},
        numerics={"time_step_fraction": 0.002},
    )  # fmt: skip
    snapshots = run_and_sample(scene, duration / 400.0, until=1.2 * duration)
    force = np.linalg.norm(column(snapshots, "force")[:, 0], axis=1)
    position = column(snapshots, "position")
    gap = position[:, 1, 0] - position[:, 0, 0] if material is GLASS else position[:, 0, 2] + 0.5 * diameter
    overlap = diameter - gap
    assert overlap.max() == pytest.approx(overlap_max, rel=HALF_DIGIT)
    assert force.max() == pytest.approx(force_max, rel=HALF_DIGIT)
    time = times(snapshots)
    last = np.flatnonzero(overlap > 0.0)[-1]
    separation = time[last] + overlap[last] / (overlap[last] - overlap[last + 1]) * (
        time[last + 1] - time[last]
    )
    assert separation == pytest.approx(duration, rel=HALF_DIGIT)
