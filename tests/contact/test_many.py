"""Contact models in many-particle simulations: batches of contacts, energy budget, friction of cohesive contacts."""

import numpy as np
import pytest
from scene_builders import (
    SOFT,
    box,
    build_scene,
    column,
    few_spheres,
    particle_group,
    plane,
    run_and_sample,
    times,
)

from granflow.plan.build import plan_for

LUDING = {"law": "luding", "plasticity_depth": 0.02, "tension": 0.3, "stiffness": {"reference_velocity": 1.0}}


def bouncing_box(chunk_size):
    """Particles in contact with their neighbors initially, which then bounce in a box under gravity."""
    rng = np.random.default_rng(5)
    positions = 0.00999 * (np.argwhere(np.ones((4, 4, 4))) + 0.55)
    group = particle_group(positions, 0.01, velocity=rng.normal(0.0, 0.5, positions.shape))
    return build_scene(
        {"balls": group}, box(0.05), {"friction": 0.4, "restitution": 0.7, "cohesion_energy_density": 1e4},
        gravity=[0.0, 0.0, -9.81], numerics={"chunk_size": chunk_size},
        contact={"normal": LUDING, "tangential": "mindlin", "rolling": "none", "cohesion": "sjkr"},
        run={"duration": 0.03, "time_step": 2e-6, "velocity_max": 4.0},
        output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip


def test_batches_equal_single_contacts_and_the_energy_budget_closes(taichi_f64):
    """Models without branches are evaluated in batches. The sum over forces has another order: rounding of 1e-16
    per step, which 100 steps of collisions amplify."""
    scenes = [bouncing_box(chunk_size) for chunk_size in (1, 64)]
    assert [plan_for(scene).chunk_size for scene in scenes] == [1, 64]
    single, batched = (
        run_and_sample(scene, 2e-4, until)[1:] for scene, until in zip(scenes, (2e-4, None), strict=True)
    )
    assert 60 < single[0].totals["contact_count"] == batched[0].totals["contact_count"]
    for name, size in (("position", 0.05), ("velocity", 0.5), ("angular_velocity", 50.0)):
        found, expected = batched[0].particles[name], single[0].particles[name]
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-11 * size)
    totals = batched[-1].totals
    for part in ("friction_dissipation", "plastic_dissipation"):
        assert totals[part] > 0.01 * totals["kinetic_energy"], part
    assert abs(totals["energy_error"]) < 1e-4


def test_cohesion_increases_the_friction_limit(taichi_f64):
    """A particle slides on a wall with cohesion as the only normal load: friction is mu times the repulsion.

    At k d^1.5 = 2 pi w R d repulsion and attraction balance; a limit of mu times the total force would be 0.
    """
    radius, friction, cohesion, speed = 0.005, 0.3, 1e6, 0.5
    modulus = SOFT["young_modulus"] / (2.0 * (1.0 - SOFT["poisson_ratio"] ** 2))
    attraction = 2.0 * np.pi * cohesion * radius
    overlap = (attraction / (4.0 / 3.0 * modulus * np.sqrt(radius))) ** 2
    sphere = particle_group([0.0, 0.0, radius - overlap], 2.0 * radius, velocity=[[speed, 0.0, 0.0]])
    pair = {"restitution": 1.0, "friction": friction, "cohesion_energy_density": cohesion}
    scene = few_spheres(
        {"sphere": sphere}, {"floor": plane([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])}, pair=pair, pairs={"fixed-fixed": pair},
        contact={"normal": "hertz", "tangential": "mindlin", "rolling": "none", "cohesion": "sjkr"},
        run={"duration": 3e-4, "time_step": 1e-6, "velocity_max": speed},
    )  # fmt: skip
    snapshots = run_and_sample(scene, 1e-5)
    velocity = column(snapshots, "velocity")[:, 0]
    time = times(snapshots)
    mass = 4.0 / 3.0 * np.pi * radius**3 * SOFT["density"]
    late = time > 1e-4
    deceleration = -np.polyfit(time[late], velocity[late, 0], 1)[0]
    assert deceleration == pytest.approx(friction * attraction * overlap / mass, rel=2e-3)
    assert np.abs(velocity[:, 2]).max() < 1e-3 * speed
