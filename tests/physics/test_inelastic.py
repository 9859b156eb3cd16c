"""Contacts of Zhou's model without rebound, at rest and with static loads.

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


STORED = tuple(f"{name}_energy" for name in ("kinetic", "rotational", "gravitational", "elastic"))
DISSIPATED = tuple(f"{name}_dissipation" for name in ("plastic", "friction", "rolling", "damping"))


def stack(restitution, duration):
    """Snapshots of three particles that fall by 1 mm, one on another."""
    centers = [[0.0, 0.0, 2 * RADIUS * (0.5 + number) + 0.001 * (1 + number)] for number in range(3)]
    scene = few_spheres(
        {"balls": particle_group(centers, 2 * RADIUS)}, FLOOR,
        {"restitution": restitution, "friction": 0.5}, materials={"glass": SOLID | {"young_modulus": 1e7}}, gravity=[0.0, 0.0, -9.81],
        numerics={"time_step_fraction": 0.1}, run={"duration": duration, "velocity_max": 1.0},
    )  # fmt: skip
    return run_and_sample(scene, 0.1)


def test_stack_comes_to_rest_to_rounding(taichi_f64):
    """The error of the loss by rest damping is of first order in the time step. With the restitution 1 nothing
    damps, and plastic work remains at the rounding of the energies."""
    first, *_, before, last = stack(0.3, 0.6)
    assert last.totals["kinetic_energy"] < 1e-24
    np.testing.assert_allclose(last.particles["position"], before.particles["position"], rtol=0.0, atol=1e-15)
    change = [sum(each.totals[name] for name in (*STORED, *DISSIPATED)) for each in (first, last)]
    assert abs(change[1] - change[0]) < 2e-3 * sum(last.totals[name] for name in DISSIPATED)
    elastic = stack(1.0, 0.3)[-1].totals
    assert elastic["damping_dissipation"] == 0.0
    assert sum(elastic[name] for name in DISSIPATED) < 1e-12 * elastic["gravitational_energy"]


RESTITUTIONS = (0.0, 0.05, 0.3, 1.0)


def test_column_rests_with_the_overlaps_of_hertz_at_every_restitution(taichi_f64):
    """A contact that is loaded slowly is on the loading curve, and carries its load there.

    Columns of spheres that just touch are let down by a drag: d = (n m g / k)^(2/3) below n spheres,
    k = (4/3) E sqrt(R), E = E_material / (2 (1 - nu^2)), R = radius at the floor and half of it between spheres.
    """
    count, radius = 6, 0.002
    soft = {"young_modulus": 2e6, "poisson_ratio": 0.25, "density": 2500.0}
    names = [f"solid_{number}" for number in range(len(RESTITUTIONS))]
    groups = {
        name: particle_group([[0.01 * number, 0.0, radius * (2 * row + 1)] for row in range(count)], 2 * radius, name)
        for number, name in enumerate(names)
    }  # fmt: skip
    pairs = {
        pair: {"restitution": restitution, "friction": 0.0}
        for name, restitution in zip(names, RESTITUTIONS, strict=True)
        for pair in (f"{name}-{name}", f"{name}-floor")
    }
    scene = few_spheres(
        groups, {"floor": plane([0, 0, 0], [0, 0, 1], "floor")}, materials=dict.fromkeys([*names, "floor"], soft),
        pairs=pairs, gravity=[0.0, 0.0, -GRAVITY], damping={"drag": 4000.0},
        run={"duration": 0.15, "velocity_max": 0.3},
    )  # fmt: skip
    last = run_and_sample(scene, 1.0)[-1]
    height = last.particles["position"][:-1, 2].reshape(len(names), count)
    radius_eff = np.where(np.arange(count) == 0, radius, radius / 2)
    stiffness = 4.0 / 3.0 * 2e6 / (2.0 * (1.0 - 0.25**2)) * np.sqrt(radius_eff)
    weight = 2500.0 * 4.0 / 3.0 * np.pi * radius**3 * GRAVITY
    hertz = (weight * (count - np.arange(count)) / stiffness) ** (2 / 3)
    overlap = np.concatenate([radius - height[:, :1], 2.0 * radius - np.diff(height, axis=1)], axis=1)
    np.testing.assert_allclose(overlap / hertz, np.ones((len(names), count)), rtol=2e-3)
    assert abs(last.totals["energy_error"]) < 1e-4
