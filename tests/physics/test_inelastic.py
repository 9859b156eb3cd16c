"""Contacts of the restitution 0: impacts without rebound, and static loads.

The flights of a completely inelastic ball on a vibrating plate are a case of tools/validation.
"""

import numpy as np
import pytest
from scene_builders import box, colliding, column, few_spheres, particle_group, plane, run_and_sample, times

GRAVITY, RADIUS = 9.81, 0.0025
SOLID = {"young_modulus": 1e8, "poisson_ratio": 0.25, "density": 2500.0}
FLOOR = {"floor": plane([0, 0, 0], [0, 0, 1])}


def last_of(group, walls=None, duration=0.005, gravity=0.0, interval=1.0, **parts):
    """Snapshots of particles of the restitution 0."""
    given = {
        "pair": {"restitution": 0.0}, "materials": {"glass": SOLID}, "run": {"duration": duration, "velocity_max": 0.5},
    } | parts  # fmt: skip
    return run_and_sample(few_spheres({"balls": group}, walls, gravity=[0, 0, -gravity], **given), interval)


@pytest.mark.parametrize("fraction", [0.05, 0.5])
def test_two_particles_have_a_common_velocity_after_an_inelastic_impact(taichi_f64, fraction):
    """v = (m1 v1 + m2 v2) / (m1 + m2), whatever the time step; the energy budget closes."""
    diameter = 0.008
    group = colliding(0.5 * (0.005 + diameter) + 1e-4, [0.005, diameter], 0.4)
    first, last = last_of(group, numerics={"time_step_fraction": fraction})
    mass = last.particles["mass"][:2]
    velocities = first.particles["velocity"][:2]
    common = mass @ velocities / mass.sum()
    np.testing.assert_allclose(last.particles["velocity"][:2], [common, common], rtol=0.0, atol=1e-12)
    loss = 0.5 * mass @ np.sum(velocities**2, axis=1) - 0.5 * mass.sum() * common @ common
    assert last.totals["plastic_dissipation"] == pytest.approx(loss, rel=1e-9)


def test_particles_that_hit_one_from_both_sides_stop_together(taichi_f64):
    """The contacts load each other: both stop at the same time, and none rebounds by the load of the
    other."""
    group = particle_group([[-0.0101, 0, 0], [0, 0, 0], [0.0101, 0, 0]],
                           velocity=[[0.3, 0, 0], [0, 0, 0], [-0.3, 0, 0]])  # fmt: skip
    last = last_of(group, numerics={"time_step_fraction": 0.1})[-1]
    np.testing.assert_allclose(last.particles["velocity"], 0.0, rtol=0.0, atol=1e-12)
    energy = 0.5 * last.particles["mass"][[0, 2]].sum() * 0.3**2
    assert last.totals["plastic_dissipation"] == pytest.approx(energy, rel=1e-9)


def test_ball_that_hits_a_ceiling_falls_from_rest(taichi_f64):
    """No rebound and no tension: gravity separates the contact at once."""
    ceiling = {"ceiling": plane([0, 0, 0.01], [0, 0, -1])}
    ball = particle_group([[0.0, 0.0, 0.01 - RADIUS - 1e-4]], 2.0 * RADIUS, velocity=[0.0, 0.0, 0.4])
    snapshots = last_of(ball, ceiling, 0.05, GRAVITY, 0.001)
    time = times(snapshots)
    velocity = column(snapshots, "velocity")[:, 0, 2]
    falling = time > 0.0015
    release = time[falling] + velocity[falling] / GRAVITY
    np.testing.assert_allclose(release, release[0], rtol=0.0, atol=1e-12)
    assert 0.00025 < release[0] < 0.0005  # after 0.25 ms of flight and the impact


def test_work_on_a_sphere_compressed_by_two_walls_is_that_of_hertz(taichi_f64):
    """Two contacts of the overlap d take the work 2 (2/5) k d^2.5 in slow compression, and store none of
    it."""
    motion = {"kind": "translation", "velocity": [0.0, 0.0, -0.005]}
    lid = plane([0, 0, 0.004], [0, 0, -1], motion=motion)
    last = last_of(particle_group([[0.0, 0.0, 0.002]], 0.004), FLOOR | {"lid": lid},
                   materials={"glass": SOLID | {"young_modulus": 1e7}},
                   run={"duration": 0.04, "time_step": 13e-6})[-1]  # fmt: skip
    overlap = 0.5 * 0.005 * last.time
    work = 0.8 * 4.0 / 3.0 * 1e7 / (2.0 * (1.0 - 0.25**2)) * np.sqrt(0.002) * overlap**2.5
    assert last.totals["plastic_dissipation"] == pytest.approx(work, rel=1e-3)
    assert last.totals["elastic_energy"] == 0.0
    assert abs(last.totals["energy_error"]) < 1e-3


def test_energy_budget_of_an_inelastic_bed_closes(taichi_f64):
    """45 spheres with friction fall into a box and come to rest; the support of their contacts does not
    change this."""
    rng = np.random.default_rng(3)
    positions = 0.0045 * (np.argwhere(np.ones((3, 3, 5))) + 0.6) + rng.uniform(-1e-4, 1e-4, (45, 3))
    walls = box(0.0145) | {"high_z": plane([0, 0, 0.2], [0, 0, -1])}
    bed = particle_group(positions, 0.004)
    last = last_of(bed, walls, 0.12, GRAVITY, pair={"restitution": 0.0, "friction": 0.4},
                   materials={"glass": SOLID | {"young_modulus": 5e6}})[-1]  # fmt: skip
    assert abs(last.totals["energy_error"]) < 5e-4
    assert last.totals["kinetic_energy"] < 0.02 * last.totals["plastic_dissipation"]
