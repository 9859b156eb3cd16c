"""Records of contacts: their forces add up to what moves the particles."""

import numpy as np
import pytest
from scene_builders import box, build_scene, particle_group, run_and_sample

GRAVITY = np.array([0.0, 0.0, -9.81])
EPS = np.finfo(float).eps


def pressed(chunk_size=512, pair=None, **parts):
    """What is seen of a block of spheres pressed together between rough walls, which flies apart spinning."""
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
        run={"duration": 0.002, "velocity_max": 2.0}, numerics={"chunk_size": chunk_size, "max_overlap": 0.3},
        **parts,
    )  # fmt: skip
    return run_and_sample(scene, 0.001, contacts=True)[1:]


def sums_of_contacts(snapshot):
    """Force of all contacts on every particle (n, 3), and the sum of their sizes (n,)."""
    ids, contacts = snapshot.particles["id"], snapshot.contacts
    total, size = np.zeros((ids.size, 3)), np.zeros(ids.size)
    distance = contacts["wall"] < 0
    for name, sign, chosen in (("id_i", 1.0, slice(None)), ("id_j", -1.0, distance)):
        cell_of_point = np.searchsorted(ids, contacts[name][chosen])
        np.add.at(total, cell_of_point, sign * contacts["force"][chosen])
        np.add.at(size, cell_of_point, np.linalg.norm(contacts["force"][chosen], axis=1))
    return total, size


STICKY = {
    "contact": {"normal": "hertz", "tangential": "mindlin", "rolling": "none", "cohesion": "sjkr"},
    "pair": {"cohesion_energy_density": 3e5},
}


@pytest.fixture(scope="module", params=[{}, {"chunk_size": 5}, STICKY], ids=["one_chunk", "chunks", "sticky"])
def seen(taichi_f64, request):
    """With friction; pairs across chunks stand in two rows; the sticky ones are damped too."""
    return pressed(**request.param)


def test_forces_of_contacts_and_weight_are_the_force_on_every_particle(seen):
    for snapshot in seen:
        particles, contacts = snapshot.particles, snapshot.contacts
        assert contacts["tangential_force"].max() > 0.01 * contacts["normal_force"].max() > 0.0
        total, size = sums_of_contacts(snapshot)
        expected = particles["force"] - particles["mass"][:, None] * GRAVITY
        # A sum of ten forces, each of some ten roundings, weight included.
        allowed = 100.0 * EPS * (size + particles["mass"] * 9.81)
        assert np.all(np.linalg.norm(total - expected, axis=1) <= allowed)


def test_a_record_has_the_parts_of_its_force(seen):
    """Along the branch from the partner to i the normal force, across it the friction force."""
    contacts = seen[-1].contacts
    branch = contacts["position_i"] - contacts["position_j"]
    normal = branch / np.linalg.norm(branch, axis=1)[:, None]
    along = np.einsum("na,na->n", contacts["force"], normal)
    across = np.linalg.norm(contacts["force"] - along[:, None] * normal, axis=1)
    np.testing.assert_allclose(along, contacts["normal_force"], rtol=1e-9)
    np.testing.assert_allclose(across, contacts["tangential_force"], rtol=0, atol=1e-12 * along.max())
