"""Output of contacts: sums of their forces, statistics, and numbers of collisions by impact energy."""

import csv

import numpy as np
import pytest
from scene_builders import (
    SOFT,
    box,
    build_scene,
    moving_lattice,
    particle_group,
    plane,
    run_and_sample,
    run_to_end,
)

from granflow.errors import SceneError
from granflow.plan.build import plan_for
from granflow.simulation import Simulation

GRAVITY = np.array([0.0, 0.0, -9.81])
EPS = np.finfo(float).eps


LIQUID = {"surface_tension": 0.07, "contact_angle": 0.3, "liquid_volume": 2e-9}
VISCOUS = {"law": "capillary", "viscous_force": {"viscosity": 0.1, "min_separation_ratio": 0.01}}


@pytest.mark.parametrize(
    ("cohesion", "pair"),
    [
        ("sjkr", {"cohesion_energy_density": 3e5}),
        ("van_der_waals", {"hamaker_constant": 1e-8, "separation": 5e-5}),
        ("capillary", LIQUID),
        (VISCOUS, LIQUID),
    ],
)
def test_contact_forces_and_weight_add_up_to_the_particle_force(taichi_f64, cohesion, pair):
    """Of pairs with a force at a distance, too. The normal force acts along the branch vector from the partner to i, the tangential force normal to it.

    A sum of ten forces has about ten rounding errors each, weight included. In the force on a particle, each
    component of a contact force, and the weight, is rounded to the nearest multiple of the unit.
    """
    rng = np.random.default_rng(6)
    positions = 0.0098 * (np.argwhere(np.ones((4, 4, 4))) + 0.5)
    motion = {"velocity": rng.normal(0.0, 0.3, (64, 3)), "angular_velocity": rng.normal(0.0, 100.0, (64, 3))}
    scene = build_scene(
        {"balls": particle_group(positions, 0.01, **motion)}, walls=box(0.0405), gravity=GRAVITY.tolist(),
        contact={"normal": "hertz", "tangential": "mindlin", "rolling": "none", "cohesion": cohesion},
        pair={"friction": 0.4} | pair,
        run={"duration": 0.002, "velocity_max": 2.0}, numerics={"chunk_size": 5, "max_overlap": 0.3},
    )  # fmt: skip
    snapshot = run_and_sample(scene, 0.001, contacts=True)[-1]
    particles, contacts = snapshot.particles, snapshot.contacts
    force = contacts["force"]
    assert contacts["tangential_force"].max() > 0.01 * contacts["normal_force"].max() > 0.0
    total, magnitude, count = np.zeros((64, 3)), np.zeros(64), np.ones(64)
    for name, sign, selected in (("id_i", 1.0, slice(None)), ("id_j", -1.0, contacts["wall"] < 0)):
        index = contacts[name][selected]
        np.add.at(total, index, sign * force[selected])
        np.add.at(magnitude, index, np.linalg.norm(force[selected], axis=1))
        np.add.at(count, index, 1.0)
    expected = particles["force"] - particles["mass"][:, None] * GRAVITY
    unit = plan_for(scene).sum_units.force
    allowed = 100.0 * EPS * (magnitude + particles["mass"] * 9.81) + np.sqrt(3.0) / 2.0 * unit * count
    assert np.all(np.linalg.norm(total - expected, axis=1) <= allowed)
    branch = contacts["position_i"] - contacts["position_j"]
    normal = branch / np.linalg.norm(branch, axis=1)[:, None]
    along = np.einsum("na,na->n", force, normal)
    np.testing.assert_allclose(along, contacts["normal_force"], rtol=1e-9)
    separated = contacts["overlap"] < 0.0
    assert separated.any() == (cohesion != "sjkr") and (~separated).sum() == snapshot.totals["contact_count"]
    if cohesion == VISCOUS:  # its tangential part is no friction
        return
    across = np.linalg.norm(force - along[:, None] * normal, axis=1)
    np.testing.assert_allclose(across, contacts["tangential_force"], rtol=0, atol=1e-12 * along.max())


MASS = 4.0 / 3.0 * np.pi * 0.005**3 * 2500.0
CLASSES = {"min": 1e-9, "max": 1e-2, "classes": 14}
EDGES = 1e-9 * 10.0 ** (0.5 * np.arange(15))
FLOOR = {"floor": plane([0, 0, 0], [0, 0, 1])}


def counting(groups, walls=None, interval=1.0, duration=1.0, **parts):
    """A scene without gravity that counts collisions.

    All have one compiled structure: two materials, fixed particles far away, walls that meet, friction
    between the materials.
    """
    far = {
        material: particle_group([[0.9, 0.9, z]], material=material) | {"fixed": True}
        for material, z in (("glass", 0.8), ("heavy", 0.9))
    }
    walls = {"side": plane([-0.9, 0, 0], [1, 0, 0])} | (walls or {"low": plane([0, 0, -0.9], [0, 0, 1])})
    defaults = {
        "run": {"duration": duration},
        "numerics": {"chunk_size": 16},
        "materials": {"heavy": SOFT | {"density": 5000.0}},
        "pairs": {"glass-heavy": {"restitution": 0.5, "friction": 0.3}},
        "output": {"interval": interval, "collision_energies": CLASSES},
    }
    return build_scene(groups | far, walls, **(defaults | parts))


def test_statistics_of_pairs_and_of_a_chain_between_walls(taichi_f64):
    """Overlaps are relative to the smaller radius, also if it is that of the second particle; walls are no
    part of the coordination number, which is that of mobile particles."""
    at = [[0.1, 0.0, 0.0148], [0.1, 0.0138, 0.0148], [0.2, 0.0, 0.0148], [0.2, 0.0138, 0.0148]]
    groups = {
        "pairs": particle_group(at, [0.008, 0.02, 0.02, 0.008]),
        "chain": particle_group([[0, 0, 0.00495], [0, 0, 0.0148], [0, 0, 0.02465]], 0.01),
    }
    walls = FLOOR | {"lid": plane([0, 0, 0.0296], [0, 0, -1])}
    last, _ = run_to_end(counting(groups, walls, run={"duration": 1e-6, "time_step": 1e-6}))
    found, totals, position = last.particles, last.totals, last.particles["position"]
    pairs = [(0.014 - np.linalg.norm(position[k] - position[k + 1])) / 0.004 for k in (0, 2)]
    chain = [(0.01 - np.linalg.norm(position[k] - position[k + 1])) / 0.005 for k in (4, 5)]
    at_walls = (0.005 - np.array([position[4, 2], 0.0296 - position[6, 2]])) / 0.005
    assert min(pairs) > 0.04 > max(chain)
    assert totals["overlap_largest"] == pytest.approx(max(pairs), rel=1e-12)
    assert totals["overlap_mean"] == pytest.approx(np.mean([*pairs, *chain, *at_walls]), rel=1e-12)
    assert (totals["contact_count"], totals["wall_contact_count"]) == (6.0, 2.0)
    assert totals["coordination_number"] == pytest.approx(8 / 7)
    assert found["coordination_number"].tolist() == [1, 1, 1, 1, 1, 2, 1, 0, 0]
    assert found["wall_contact_count"].tolist() == [0, 0, 0, 0, 1, 0, 1, 0, 0]


def test_single_impacts_have_the_energies_of_their_effective_masses(taichi_f64):
    """m v^2 / 2 at a wall and at a fixed particle, (m / 2) v^2 / 2 and (2/3) m v^2 / 2 for masses 1:1 and 1:2; a
    slow one is below 1 nJ."""
    energy = 0.5 * MASS * 0.49
    at = [[0.0, 0.0, 0.0051], [0.1, 0.0, 0.5], [0.1, 0.0, 0.5101], [0.3, 0.0, 0.5], [0.5, 0.0, 0.0051]]
    vertical = [-0.7, 0.7, 0.0, 0.7, -1e-3]
    groups = {
        "light": particle_group(at, 0.01, velocity=np.outer(vertical, [0.0, 0.0, 1.0])),
        "dense": particle_group([[0.3, 0.0, 0.5101]], 0.01, "heavy"),
        "target": particle_group([[0.7, 0.0, 0.3]], 0.01) | {"fixed": True},
        "ball": particle_group([[0.7, 0.0, 0.3101]], 0.01, velocity=[[0.0, 0.0, -0.7]]),
    }
    last, _ = run_to_end(counting(groups, FLOOR, duration=0.11, pair={"restitution": 0.5}))
    for partner, energies in {
        "wall": [energy, 0.5 * MASS * 1e-6],
        "particle": [energy, energy / 2.0, energy * 2.0 / 3.0],
    }.items():
        expected = np.bincount(np.searchsorted(EDGES, energies, side="right"), minlength=16)
        assert last.collisions[partner].tolist() == expected.tolist()


def test_each_contact_of_a_gas_counts_once(taichi_f64):
    """The pairs of snapshots after each step that were not in contact a step before, with rebuilds in between.

    Pairs within a chunk are evaluated once, pairs across two chunks twice.
    """
    gas, step = {"gas": moving_lattice((6, 6, 6), largest=0.006, speed=0.6)}, 4e-6
    run = {"duration": 800 * step, "time_step": step, "velocity_max": 4.0}
    scene = counting(gas, box(0.042), pair={"restitution": 0.9, "friction": 0.3}, run=run)
    before: set[tuple[int, int]] = set()
    new = {"particle": 0, "wall": 0}
    for snapshot in run_and_sample(scene, step, contacts=True):
        now = {*zip(snapshot.contacts["id_i"].tolist(), snapshot.contacts["id_j"].tolist(), strict=True)}
        for pair in now - before:
            new["wall" if min(pair) < 0 else "particle"] += 1
        before = now
        last = snapshot
    assert {kind: int(counts.sum()) for kind, counts in last.collisions.items()} == new
    assert new["particle"] > 100 and new["wall"] > 20


def test_file_has_the_counts_of_each_interval_and_a_resting_sphere_counts_none(tmp_path, taichi_f64):
    """Impacts with e = 0.7 from 0.1 m/s lose 51 % of the energy each."""
    ball = particle_group([[0.0, 0.0, 0.00501]], 0.01, velocity=[[0.0, 0.0, -0.1]])
    pair = {"restitution": 0.7}
    scene = counting({"ball": ball}, FLOOR, 0.05, duration=0.2, gravity=GRAVITY.tolist(), pair=pair)
    with Simulation(scene, out=tmp_path / "run") as simulation:
        simulation.run()
        last = simulation.snapshot().collisions["wall"]
    with (tmp_path / "run" / "collision_energies.csv").open() as file:
        rows = list(csv.DictReader(file))
    rows = [row for row in rows if row["contact"] == "wall"]
    counts, totals = (
        np.array([int(row[name]) for row in rows]).reshape(4, 16) for name in ("count", "count_total")
    )
    np.testing.assert_array_equal(counts.cumsum(axis=0), totals)
    np.testing.assert_array_equal(totals[-1], last)
    assert counts[0].sum() > 5 and not counts[-1].any(), "the sphere rests"
    energies = 0.5 * MASS * 0.01 * 0.49 ** np.arange(40)
    for k in (4, 6):
        assert abs(last[k + 1 :].sum() - (energies > EDGES[k]).sum()) <= 1
    for name, edges in (("energy_min [J]", [0.0, *EDGES]), ("energy_max [J]", [*EDGES, np.inf])):
        assert [float(row[name]) for row in rows[:16]] == pytest.approx(edges)
    ends = [float(row["time_end [s]"]) for row in rows[::16]]
    assert ends == pytest.approx([0.05, 0.1, 0.15, 0.2], abs=1e-5)
    assert [float(row["time_start [s]"]) for row in rows[::16]] == [0.0, *ends[:-1]]


def test_collisions_of_contacts_without_a_history_are_refused():
    ball = {"ball": particle_group([[0.0, 0.0, 0.1]])}
    with pytest.raises(SceneError, match=r"output.collision_energies needs a contact model with a history"):
        plan_for(counting(ball, normal="hertz", pairs={}))
