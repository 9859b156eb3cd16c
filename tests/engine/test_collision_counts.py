"""Numbers of collisions by impact energy: energies of single impacts, each contact once, and the CSV file."""

import csv

import numpy as np
import pytest
from geometry.meshes import write
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

MASS = 4.0 / 3.0 * np.pi * 0.005**3 * 2500.0
CLASSES = {"min": 1e-9, "max": 1e-2, "classes": 14}
EDGES = 1e-9 * 10.0 ** (0.5 * np.arange(15))
FLOOR = {"floor": plane([0, 0, 0], [0, 0, 1])}


def counting(groups, walls=None, interval=1.0, duration=1.0, classes=CLASSES, **parts):
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
        "output": {"interval": interval, "collision_energies": classes},
    }
    return build_scene(groups | far, walls, **(defaults | parts))


def counts_of(*energies):
    """Numbers of collisions with these energies [J] by class."""
    return np.bincount(np.searchsorted(EDGES, energies, side="right"), minlength=16).tolist()


def test_single_impacts_have_the_energies_of_their_effective_masses(taichi_f64):
    """m v^2 / 2 at a wall, (m / 2) v^2 / 2 and (2/3) m v^2 / 2 for masses 1:1 and 1:2; slow ones are below 1
    nJ.

    The rebound of the first sphere from the wall does not reach another one.
    """
    speed = 0.7
    light = particle_group(
        [[0.0, 0.0, 0.0051], [0.1, 0.0, 0.5], [0.1, 0.0, 0.5101], [0.3, 0.0, 0.5], [0.5, 0.0, 0.0051]], 0.01,
        velocity=[[0.3, 0.0, -speed], [0.0, 0.0, speed], [0.0, 0.0, 0.0], [0.0, 0.0, speed], [0.0, 0.0, -1e-3]],
    )  # fmt: skip
    dense = particle_group([[0.3, 0.0, 0.5101]], 0.01, "heavy")
    scene = counting({"light": light, "dense": dense}, FLOOR, duration=0.11, pair={"restitution": 0.5})
    last, _ = run_to_end(scene)
    energy = 0.5 * MASS * speed**2
    assert last.collisions["wall"].tolist() == counts_of(energy, 0.5 * MASS * 1e-6)
    assert last.collisions["particle"].tolist() == counts_of(energy / 2.0, energy * 2.0 / 3.0)


def test_fixed_partner_counts_like_a_wall_with_the_mass_of_the_mobile_particle(taichi_f64):
    target = particle_group([[0.0, 0.0, 0.0]], 0.01) | {"fixed": True}
    ball = particle_group([[0.0, 0.0, 0.0101]], 0.01, velocity=[[0.0, 0.0, -0.7]])
    last, _ = run_to_end(counting({"target": target, "ball": ball}, duration=0.002))
    assert last.collisions["particle"].tolist() == counts_of(0.5 * MASS * 0.49)
    assert not last.collisions["wall"].any()


def test_bouncing_sphere_counts_each_impact_and_a_resting_one_none(taichi_f64):
    """Impacts with e = 0.7 from 0.1 m/s lose 51 % of the energy each; a sphere at rest stays in contact."""
    ball = particle_group([[0.0, 0.0, 0.00501]], 0.01, velocity=[[0.0, 0.0, -0.1]])
    scene = counting(
        {"ball": ball}, FLOOR, gravity=[0.0, 0.0, -9.81], pair={"restitution": 0.7}, duration=0.2
    )
    snapshots = run_and_sample(scene, 0.02)
    totals = [each.collisions["wall"].sum() for each in snapshots]
    impacts = snapshots[-1].collisions["wall"]
    energies = 0.5 * MASS * 0.01 * 0.49 ** np.arange(40)
    for edge in (1e-7, 1e-6):
        above = int((energies > edge).sum())
        index = int(np.searchsorted(EDGES, edge))
        assert abs(impacts[index + 1 :].sum() - above) <= 1
    assert totals[-1] == totals[-2] == totals[-3] > 5, "the sphere rests"


def test_each_contact_of_a_gas_counts_once(taichi_f64):
    """The pairs of snapshots after each step that were not in contact a step before, with rebuilds in
    between.

    Pairs within a chunk are evaluated once, pairs across two chunks twice.
    """
    gas = {"gas": moving_lattice((6, 6, 6), largest=0.006, speed=0.6)}
    step = 4e-6
    scene = counting(
        gas, box(0.042), pair={"restitution": 0.9, "friction": 0.3},
        run={"duration": 800 * step, "time_step": step, "velocity_max": 4.0}, numerics={"chunk_size": 16},
    )  # fmt: skip
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


@pytest.mark.slow
def test_sphere_that_slides_over_the_triangles_of_a_mesh_collides_once(taichi_f64, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # in which scenes without a file look for meshes
    x, y = np.meshgrid(np.linspace(-0.02, 0.2, 23), np.linspace(-0.02, 0.02, 5), indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), 0.0 * x.ravel()], axis=1)
    index = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (each.ravel() for each in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    write(tmp_path / "plate.obj", points, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))
    ball = particle_group([[0.0, 0.003, 0.00501]], 0.01, velocity=[[0.5, 0.0, 0.0]])
    walls = {"plate": {"shape": "mesh", "file": "plate.obj", "material": "glass"}}
    pair = {"restitution": 0.05, "friction": 0.1}
    scene = counting({"ball": ball}, walls, gravity=[0.0, 0.0, -9.81], pair=pair, duration=0.3)
    snapshots = run_and_sample(scene, 0.05)
    assert snapshots[-1].particles["position"][0, 0] > 0.1, "it has slid over ten triangles"
    assert snapshots[1].collisions["wall"].sum() == snapshots[-1].collisions["wall"].sum() <= 3


def test_file_has_the_counts_of_each_interval(tmp_path, taichi_f64):
    ball = particle_group([[0.0, 0.0, 0.02]], 0.01)
    scene = counting({"ball": ball}, FLOOR, interval=0.1, duration=0.3, gravity=[0.0, 0.0, -9.81])
    simulation = Simulation(scene, out=tmp_path / "run")
    simulation.run()
    last = simulation.snapshot()
    simulation.close()
    with (tmp_path / "run" / "collision_energies.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 * 2 * 16
    of_walls = [row for row in rows if row["contact"] == "wall"]
    counts = np.array([int(row["count"]) for row in of_walls]).reshape(3, 16)
    totals = np.array([int(row["count_total"]) for row in of_walls]).reshape(3, 16)
    np.testing.assert_array_equal(counts.cumsum(axis=0), totals)
    np.testing.assert_array_equal(totals[-1], last.collisions["wall"])
    assert counts.sum(axis=1).all(), "each interval has impacts"
    assert [float(row["energy_min [J]"]) for row in of_walls[:16]] == pytest.approx([0.0, *EDGES])
    assert [float(row["energy_max [J]"]) for row in of_walls[:16]] == pytest.approx([*EDGES, np.inf])
    ends = [float(row["time_end [s]"]) for row in of_walls[::16]]
    assert ends == pytest.approx([0.1, 0.2, 0.3], abs=1e-5)
    assert [float(row["time_start [s]"]) for row in of_walls[::16]] == [0.0, *ends[:-1]]


def test_contacts_without_a_history_are_refused():
    ball = {"ball": particle_group([[0.0, 0.0, 0.1]])}
    with pytest.raises(SceneError, match=r"output.collision_energies needs a contact model with a history"):
        plan_for(counting(ball, normal="hertz", pairs={}))
    assert plan_for(counting(ball, normal="hertz", pair={"friction": 0.1})).capacities.energy_classes == 16
    assert plan_for(build_scene(ball)).capacities.energy_classes == 0
