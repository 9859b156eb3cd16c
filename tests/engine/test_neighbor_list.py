"""Neighbor list: candidate pairs, contact history through rebuilds, particles that leave the domain."""

import numpy as np
import pytest
from scene_builders import (
    SOFT,
    assert_lists_hold,
    build_scene,
    neighbors_of,
    particle_group,
    plane,
    prepared_simulation,
    run_and_sample,
    run_to_end,
)
from scipy.spatial import cKDTree

from granflow.observers.observer import on_interval
from granflow.simulation import Simulation

DISTANT = np.array([[1000.0, 0.0, 0.0], [1000.008, 0.0, 0.0], [-300.0, 5.0, 2000.0], [-300.0, 5.009, 2000.0]])


def test_neighbor_list_holds_exactly_the_candidate_pairs_and_distant_particles_do_not_enlarge_cells(
    taichi_f64,
):
    """Compared with a search over all pairs. Particles a kilometer away lie outside the grid."""
    rng = np.random.default_rng(1)
    position = np.concatenate([rng.uniform(0.0, 0.12, (400, 3)), DISTANT])
    radius = 0.5 * np.append(rng.uniform(0.004, 0.016, 400), [0.01] * 4)
    wall = {"wall": plane([0.0, 0.0, 0.0], [1.0, 0.0, 0.0])}
    scene = build_scene(
        {"balls": particle_group(position, 2.0 * radius)}, wall, numerics={"chunk_size": 37, "skin": 0.002},
        domain={"min": [0.0] * 3, "max": [0.12] * 3, "on_exit": "expand"},
    )  # fmt: skip
    simulation = prepared_simulation(scene)
    near = cKDTree(position).query_pairs(0.018, output_type="ndarray")
    distance = np.linalg.norm(position[near[:, 0]] - position[near[:, 1]], axis=1)
    candidates = near[distance < radius[near].sum(axis=1) + 0.002]
    assert len(candidates) > 300 and {(400, 401), (402, 403)} <= set(map(tuple, candidates.tolist()))
    assert_lists_hold(simulation, candidates)
    at_wall = {i for i, j, _ in neighbors_of(simulation.engine) if j < 0}
    assert at_wall == set(np.flatnonzero(position[:, 0] < radius + 0.002))
    sides = simulation.engine.state.cell_sort.cell_side.to_numpy()
    assert sides.max() == pytest.approx(0.018, rel=0.01)
    simulation.free()


def test_size_classes_find_all_candidate_pairs(taichi_f64):
    """Sizes 1 : 20 in four classes; pairs are owned, and listed twice across chunks, as with one class. Minimum images
    along all axes; the grid of the largest class has two cells along z and three along the others."""
    rng = np.random.default_rng(9)
    size, skin = np.array([0.1, 0.1, 0.065]), 0.0003
    diameter = 0.0015 * 20.0 ** np.concatenate([rng.random(800) ** 3, [0.0, 1.0]])
    positions = size * rng.random((len(diameter), 3))
    domain = {"min": [0.0] * 3, "max": size.tolist(), "periodic": ["x", "y", "z"], "on_exit": "error"}
    groups = {"balls": particle_group(positions, diameter)}
    scene = build_scene(groups, numerics={"chunk_size": 64, "skin": skin}, domain=domain)
    simulation = prepared_simulation(scene)
    assert simulation.plan.features.size_classes == "4"
    distance = positions[:, None] - positions
    distance -= np.round(distance / size) * size
    near = np.linalg.norm(distance, axis=2) < 0.5 * (diameter[:, None] + diameter) + skin
    pairs = [(i, j) for i, j in np.argwhere(near).tolist() if i < j]
    assert len(pairs) > 200
    assert_lists_hold(simulation, pairs)
    simulation.free()


def traveling_pair(skin):
    """Two particles, the first in front, that rub against each other in flight, clamped between two of large mass.

    A particle at rest fixes the grid, so that cell boundaries pass between the two in flight.
    """
    flight = [3.0, 0.0, 0.0]
    spins = [[20.0, 0, 50.0], [-10.0, 30.0, 50.0]]
    clamp = particle_group([[-0.0098, 0, 0], [0.0196, 0, 0]], material="heavy", velocity=flight)
    groups = {
        "pair": particle_group([[0.0098, 0, 0], [0, 0, 0]], velocity=flight, angular_velocity=spins),
        "clamp": clamp,
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
        entries = neighbors_of(simulation.engine)
        owners.extend(int(owner) for owner, partner, _ in entries if {owner, partner} == {0, 1})

    with Simulation(scene, observers=[on_interval(1e-4, sample)]) as simulation:
        simulation.run()
        return owners, simulation.snapshot(), simulation.engine.timing.rebuild_count


def test_contact_history_does_not_depend_on_owner_and_rebuilds(taichi_f64):
    """A run with many rebuilds and a change of owner is bit-identical to a run with few rebuilds."""
    owners, many, rebuild_count = owners_during(traveling_pair(1e-3))
    _, few, smaller_count = owners_during(traveling_pair(0.02))
    assert set(owners) == {0, 1}, "each particle owns the pair at some time"
    assert rebuild_count > 10 * smaller_count
    assert many.totals["friction_dissipation"] > 0.0
    for name in ("position", "velocity", "angular_velocity", "force", "torque"):
        np.testing.assert_array_equal(many.particles[name], few.particles[name])


DIRECTIONS = np.concatenate([np.eye(3), -np.eye(3)])
OUTGOING = particle_group(0.05 * DIRECTIONS + [0, 0, 0.03], 0.002, velocity=2.0 * DIRECTIONS)


def test_particles_outside_the_domain_are_deleted_and_counted_and_the_others_keep_their_ids(taichi_f64):
    """Six particles leave the domain, and every second one of a row; the others stay."""
    row = np.stack([np.linspace(-0.09, 0.09, 40), np.full(40, -0.02), np.arange(40) * 1e-4], axis=1)
    velocity = np.outer(np.arange(40) % 2 == 0, [0.0, 5.0, 0.0])
    groups = {
        "outgoing": OUTGOING,
        "row": particle_group(row, np.linspace(0.002, 0.004, 40), velocity=velocity),
    }
    domain = {"min": [-0.1] * 3, "max": [0.1] * 3, "on_exit": "delete"}
    scene = build_scene(groups, domain=domain, run={"duration": 0.05, "velocity_max": 5.0})
    first, last = run_and_sample(scene, 0.05)
    assert last.particles["id"].tolist() == list(range(7, 46, 2))
    for name in ("position", "radius", "velocity"):
        np.testing.assert_array_equal(last.particles[name], first.particles[name][7::2])
    counts = {"deleted_count": 26.0, "inserted_count": 46.0, "particle_count": 20.0}
    assert {name: last.totals[name] for name in counts} == counts
    left = np.r_[:6, 6:46:2]
    assert last.totals["deleted_mass"] == pytest.approx(first.particles["mass"][left].sum(), rel=1e-14)


def test_expanding_domain_keeps_all_particles(taichi_f64):
    """Particles outside move by x = x0 + v t, and two of them collide as in a domain that is large enough."""
    pair = particle_group([[0.05, 0, 0], [-0.05, 0, 0.002]], velocity=[[2.0, 0, 0], [4.0, 0, 0]])
    large, small = (
        run_to_end(
            build_scene(
                {"pair": pair, "outgoing": OUTGOING},
                domain={"min": [-size] * 3, "max": [size] * 3, "on_exit": "expand"},
                run={"duration": 0.06, "velocity_max": 4.0, "time_step": 2e-6},
            )
        )[0]
        for size in (1.0, 0.1)
    )
    assert small.totals["deleted_count"] == 0.0
    expected = 0.05 * DIRECTIONS + [0, 0, 0.03] + 2.0 * small.time * DIRECTIONS
    np.testing.assert_allclose(small.particles["position"][2:], expected, rtol=1e-12, atol=1e-15)
    assert np.all(large.particles["position"][:2, 0] > 0.1)
    assert np.ptp(large.particles["velocity"][:2, 2]) > 0.1
    np.testing.assert_array_equal(small.particles["velocity"], large.particles["velocity"])
