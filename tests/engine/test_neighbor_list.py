"""Neighbor list: candidate pairs, contact history through rebuilds, deletion of particles."""

import numpy as np
import pytest
from scene_builders import (
    SOFT,
    assert_lists_hold,
    box,
    build_scene,
    neighbors_of,
    particle_group,
    prepared_simulation,
    run_and_sample,
    run_to_end,
)
from scipy.spatial import cKDTree

from granflow.engine.host import HistoryTable, append_particles, copy_to_host
from granflow.observers.observer import on_interval
from granflow.simulation import Simulation


def random_particles(count, seed=1):
    """Particles of many sizes at random positions in a box of 12 cm; some overlap."""
    rng = np.random.default_rng(seed)
    return {"balls": particle_group(rng.uniform(0.0, 0.12, (count, 3)), rng.uniform(0.004, 0.016, count))}


@pytest.mark.parametrize("chunk_size", [1, 37])
def test_neighbor_list_holds_exactly_the_candidate_pairs(taichi_f64, chunk_size):
    """Compared with a search over all pairs."""
    scene = build_scene(
        random_particles(400), walls=box(0.12), numerics={"chunk_size": chunk_size, "skin": 0.002}
    )
    simulation = prepared_simulation(scene)
    particles = simulation.snapshot().particles
    position, radius = particles["position"], particles["radius"]
    near = cKDTree(position).query_pairs(0.018, output_type="ndarray")
    distance = np.linalg.norm(position[near[:, 0]] - position[near[:, 1]], axis=1)
    candidates = near[distance < radius[near].sum(axis=1) + 0.002]
    assert len(candidates) > 300
    assert_lists_hold(simulation, candidates)
    at_walls = {(i, -1 - j) for i, j, _ in neighbors_of(simulation.engine) if j < 0}
    gaps = np.stack([g for axis in range(3) for g in (position[:, axis], 0.12 - position[:, axis])], axis=1)
    assert at_walls == {(i, w) for i, w in np.argwhere(gaps < radius[:, None] + 0.002).tolist()}
    simulation.free()


def traveling_pair(skin):
    """Two particles, the first in front, that rub against each other in flight, clamped between two of large
    mass.

    A particle at rest fixes the grid, so that cell boundaries pass between the two in flight.
    """
    flight = [3.0, 0.0, 0.0]
    groups = {
        "pair": particle_group(
            [[0.0098, 0, 0], [0, 0, 0]],
            velocity=flight,
            angular_velocity=[[20.0, 0, 50.0], [-10.0, 30.0, 50.0]],
        ),
        "clamp": particle_group([[-0.0098, 0, 0], [0.0196, 0, 0]], material="heavy", velocity=flight),
        "post": particle_group([[-0.1, -0.1, -0.1]]),
    }
    return build_scene(
        groups,
        rolling="epsd",
        materials={"heavy": SOFT | {"density": 1e8}},
        pair={"friction": 0.5, "rolling_friction": 0.2, "restitution": 0.3},
        numerics={"skin": skin},
        run={"duration": 0.012, "velocity_max": 8.0, "time_step": 2e-6},
        output={"interval": 1.0, "energy_budget": True},
    )


def owners_during(scene):
    """Owner of the list entry of the pair every 0.1 ms, the last snapshot, and the number of rebuilds."""
    owners = []

    def sample(snapshot):
        owners.extend(
            int(owner) for owner, partner, _ in neighbors_of(simulation.engine) if {owner, partner} == {0, 1}
        )

    simulation = Simulation(scene, observers=[on_interval(1e-4, sample)])
    simulation.run()
    last = simulation.snapshot()
    count = simulation.engine.timing.rebuild_count
    simulation.free()
    return owners, last, count


def test_contact_history_does_not_depend_on_owner_and_rebuilds(taichi_f64):
    """A run with many rebuilds and a change of owner is bit-identical to a run with few rebuilds."""
    many_rebuilds = owners_during(traveling_pair(1e-3))
    few_rebuilds = owners_during(traveling_pair(0.02))
    assert set(many_rebuilds[0]) == {0, 1}, "each particle owns the pair at some time"
    assert many_rebuilds[2] > 10 * few_rebuilds[2]
    assert many_rebuilds[1].totals["friction_dissipation"] > 0.0
    for name in ("position", "velocity", "angular_velocity", "force", "torque"):
        np.testing.assert_array_equal(many_rebuilds[1].particles[name], few_rebuilds[1].particles[name])


DIRECTIONS = np.concatenate([np.eye(3), -np.eye(3)])


def open_scene(on_exit):
    """Six particles leave the domain, among a row in which every second one does; the others stay."""
    count = 40
    positions = np.stack(
        [np.linspace(-0.09, 0.09, count), np.full(count, -0.02), np.arange(count) * 1e-4], axis=1
    )
    velocity = np.outer(np.arange(count) % 2 == 0, [0.0, 5.0, 0.0])
    groups = {
        "outgoing": particle_group(0.05 * DIRECTIONS + [0, 0, 0.03], 0.002, velocity=2.0 * DIRECTIONS),
        "row": particle_group(positions, np.linspace(0.002, 0.004, count), velocity=velocity),
    }
    domain = {"min": [-0.1] * 3, "max": [0.1] * 3, "on_exit": on_exit}
    return build_scene(groups, domain=domain, run={"duration": 0.05, "velocity_max": 5.0})


def test_particles_outside_the_domain_are_deleted_and_counted_and_the_others_keep_their_ids(taichi_f64):
    first, last = run_and_sample(open_scene("delete"), 0.05)
    assert last.particles["id"].tolist() == list(range(7, 46, 2))
    for name in ("position", "radius", "velocity"):
        np.testing.assert_array_equal(last.particles[name], first.particles[name][7::2])
    counts = {"deleted_count": 26.0, "inserted_count": 46.0, "particle_count": 20.0}
    assert {name: last.totals[name] for name in counts} == counts
    left = np.r_[:6, 6:46:2]
    assert last.totals["deleted_mass"] == pytest.approx(first.particles["mass"][left].sum(), rel=1e-14)


def test_expanding_domain_keeps_all_particles(taichi_f64):
    """Particles outside move by x = x0 + v t, and two of them collide as in a domain that is large enough."""
    groups = {
        "outgoing": particle_group(0.05 * DIRECTIONS, velocity=2.0 * DIRECTIONS),
        "resting": particle_group([[0.0, 0.0, 0.0]], 0.02),
    }
    domain = {"min": [-0.1] * 3, "max": [0.1] * 3, "on_exit": "expand"}
    last, _ = run_to_end(build_scene(groups, domain=domain, run={"duration": 0.05, "velocity_max": 2.0}))
    assert last.totals["deleted_count"] == 0.0
    expected = (0.05 + 2.0 * last.time) * DIRECTIONS
    np.testing.assert_allclose(last.particles["position"][:6], expected, rtol=1e-12)
    pair = {"two": particle_group([[0.05, 0, 0], [-0.05, 0, 0.002]], velocity=[[2.0, 0, 0], [4.0, 0, 0]])}
    large, small = (
        run_to_end(
            build_scene(pair, domain={"min": [-size] * 3, "max": [size] * 3, "on_exit": "expand"},
                  run={"duration": 0.06, "velocity_max": 4.0, "time_step": 2e-6})
        )[0] for size in (1.0, 0.06)
    )  # fmt: skip
    assert np.all(large.particles["position"][:, 0] > 0.1)
    assert np.ptp(large.particles["velocity"][:, 2]) > 0.1
    np.testing.assert_array_equal(small.particles["velocity"], large.particles["velocity"])


def test_distant_particles_do_not_enlarge_the_cells(taichi_f64):
    """Particles a kilometer away lie outside the grid; their candidate pairs are found as for all others."""
    rng = np.random.default_rng(7)
    bulk = rng.uniform(0.0, 0.1, (600, 3))
    distant = np.array(
        [[1000.0, 0.0, 0.0], [1000.008, 0.0, 0.0], [-300.0, 5.0, 2000.0], [-300.0, 5.009, 2000.0]]
    )
    scene = build_scene(
        {"balls": particle_group(np.concatenate([bulk, distant]), 0.01)}, numerics={"skin": 0.001, "chunk_size": 64},
        domain={"min": [0.0] * 3, "max": [0.1] * 3, "on_exit": "expand"},
    )  # fmt: skip
    simulation = prepared_simulation(scene)
    assert simulation.engine.state.cell_sort.cell_side[0].to_numpy() == pytest.approx(
        np.full(3, 0.011), rel=1e-5
    )
    near = cKDTree(np.concatenate([bulk, distant])).query_pairs(0.011)
    assert {(600, 601), (602, 603)} <= near
    assert_lists_hold(simulation, near)
    simulation.free()


@pytest.mark.parametrize("periodic", [pytest.param([], marks=pytest.mark.slow), ["x", "y", "z"]])
def test_size_classes_find_all_candidate_pairs(taichi_f64, periodic):
    """Sizes 1 : 20 in four classes; pairs are owned, and listed twice across chunks, as with one class."""
    rng = np.random.default_rng(9)
    size = 0.1
    skin = 0.0003
    diameter = 0.0015 * 20.0 ** np.concatenate([rng.random(800) ** 3, [0.0, 1.0]])
    positions = rng.uniform(0.0, size, (len(diameter), 3))
    domain = {"min": [0.0] * 3, "max": [size] * 3, "periodic": periodic, "on_exit": "error"}
    scene = build_scene(
        {"balls": particle_group(positions, diameter)},
        numerics={"chunk_size": 64, "skin": skin},
        domain=domain,
    )
    simulation = prepared_simulation(scene)
    assert simulation.plan.features.size_classes == "4"
    distance = positions[:, None] - positions
    distance -= np.round(distance / size) * size if periodic else 0.0
    near = np.linalg.norm(distance, axis=2) < 0.5 * (diameter[:, None] + diameter) + skin
    pairs = [(i, j) for i, j in np.argwhere(near).tolist() if i < j]
    assert len(pairs) > 200
    assert_lists_hold(simulation, pairs)
    simulation.free()


def test_inserted_particle_has_no_contacts_of_a_deleted_one(taichi_f64):
    """A new particle that takes the array entry of a deleted one finds its neighbor list; it has no
    contacts."""
    positions = 0.0098 * np.argwhere(np.ones((2, 2, 2)))
    simulation = prepared_simulation(
        build_scene({"balls": particle_group(positions)}, numerics={"chunk_size": 1})
    )
    state = simulation.engine.state
    histories = HistoryTable(state)
    assert histories.read(np.arange(8), 8).count.tolist() == [3] * 8
    new = {
        name: values[-1:]
        for name, values in copy_to_host(state, ("id", "position", "radius", "mass")).items()
    }
    state.count = 7
    append_particles(state, new)
    assert histories.listed(np.arange(8), 8).count[-1] == 0
    simulation.free()
