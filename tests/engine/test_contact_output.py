"""Contact output: the contact forces add up to the force on each particle."""

import numpy as np
import pytest
from scene_builders import box, build_scene, particle_group, run_and_sample

from granflow.plan.build import plan_for

GRAVITY = np.array([0.0, 0.0, -9.81])
EPS = np.finfo(float).eps


def separating_block(pair=None, **parts):
    """Scene and snapshots of spinning particles between rough walls; the block overlaps initially, then
    separates."""
    rng = np.random.default_rng(6)
    positions = 0.0098 * (np.argwhere(np.ones((4, 4, 4))) + 0.5)
    group = particle_group(
        positions,
        0.01,
        velocity=rng.normal(0.0, 0.3, positions.shape),
        angular_velocity=rng.normal(0.0, 100.0, positions.shape),
    )
    scene = build_scene(
        {"balls": group}, walls=box(0.0392), pair={"friction": 0.4} | (pair or {}), gravity=GRAVITY.tolist(),
        run={"duration": 0.002, "velocity_max": 2.0}, numerics={"chunk_size": 5, "max_overlap": 0.3},
        **parts,
    )  # fmt: skip
    return scene, run_and_sample(scene, 0.001, contacts=True)[1:]


def contact_force_sums(snapshot):
    """Sum of the contact forces on each particle (n, 3), sum of their magnitudes and number of contacts
    (n,)."""
    ids = snapshot.particles["id"]
    contacts = snapshot.contacts
    total = np.zeros((ids.size, 3))
    magnitude = np.zeros(ids.size)
    count = np.zeros(ids.size)
    with_particle = contacts["wall"] < 0
    for name, sign, selected in (("id_i", 1.0, slice(None)), ("id_j", -1.0, with_particle)):
        index = np.searchsorted(ids, contacts[name][selected])
        np.add.at(total, index, sign * contacts["force"][selected])
        np.add.at(magnitude, index, np.linalg.norm(contacts["force"][selected], axis=1))
        np.add.at(count, index, 1.0)
    return total, magnitude, count


COHESIVE = {
    "contact": {"normal": "hertz", "tangential": "mindlin", "rolling": "none", "cohesion": "sjkr"},
    "pair": {"cohesion_energy_density": 3e5},
}


@pytest.fixture(scope="module", params=[{}, COHESIVE], ids=["zhou", "cohesive"])
def block(taichi_f64, request):
    """Scene and snapshots with friction; pairs across chunks are listed twice; the cohesive case also has
    damping."""
    return separating_block(**request.param)


def test_contact_forces_and_weight_add_up_to_the_particle_force(block):
    scene, snapshots = block
    unit = plan_for(scene).sum_units.force
    for snapshot in snapshots:
        particles = snapshot.particles
        contacts = snapshot.contacts
        assert contacts["tangential_force"].max() > 0.01 * contacts["normal_force"].max() > 0.0
        total, magnitude, count = contact_force_sums(snapshot)
        expected = particles["force"] - particles["mass"][:, None] * GRAVITY
        # A sum of ten forces, each with about ten rounding errors, weight included. In the force on a
        # particle, each component of a contact force is rounded to the nearest multiple of the unit.
        allowed = 100.0 * EPS * (magnitude + particles["mass"] * 9.81) + np.sqrt(3.0) / 2.0 * unit * count
        assert np.all(np.linalg.norm(total - expected, axis=1) <= allowed)


def test_contact_force_has_the_given_normal_and_tangential_parts(block):
    """The normal force acts along the branch vector from the partner to i, the tangential force normal to
    it."""
    contacts = block[1][-1].contacts
    branch = contacts["position_i"] - contacts["position_j"]
    normal = branch / np.linalg.norm(branch, axis=1)[:, None]
    normal_part = np.einsum("na,na->n", contacts["force"], normal)
    tangential_part = np.linalg.norm(contacts["force"] - normal_part[:, None] * normal, axis=1)
    np.testing.assert_allclose(normal_part, contacts["normal_force"], rtol=1e-9)
    np.testing.assert_allclose(
        tangential_part, contacts["tangential_force"], rtol=0, atol=1e-12 * normal_part.max()
    )
