"""Neighbor search: the right pairs, rows that grow, history that travels with its pair, particles that leave."""

import numpy as np
import pytest
from scene_builders import (
    SOFT,
    box,
    build_scene,
    neighbors_of,
    particle_group,
    plane,
    prepared_simulation,
    run_and_sample,
    run_to_end,
)
from scipy.spatial import cKDTree

from granflow.errors import RunError
from granflow.observe import every
from granflow.plan import plan as plan_module
from granflow.simulation import Simulation


def crowd(count, seed=1):
    """Spheres of many sizes anywhere in a box of 12 cm, overlapping or not."""
    rng = np.random.default_rng(seed)
    return {"balls": particle_group(rng.uniform(0.0, 0.12, (count, 3)), rng.uniform(0.004, 0.016, count))}


@pytest.mark.parametrize("chunk_size", [1, 37, 512])
def test_rows_hold_exactly_the_near_pairs(taichi_f64, chunk_size):
    """Against a search over all pairs: once where both are in one chunk, from both sides where not."""
    scene = build_scene(crowd(400), walls=box(0.12), numerics={"chunk_size": chunk_size, "skin": 0.002})
    simulation = prepared_simulation(scene)
    there = simulation.engine.host_copy.copy_to_host(("id", "position", "radius"))
    order = np.argsort(there["id"])
    position, radius = there["position"][order], there["radius"][order]
    near = {
        tuple(pair)
        for pair in cKDTree(position).query_pairs(0.018, output_type="ndarray").tolist()
        if np.linalg.norm(position[pair[0]] - position[pair[1]]) < radius[pair].sum() + 0.002
    }
    rows = neighbors_of(simulation.engine)
    within = [tuple(sorted(row[:2])) for row in rows if row[1] >= 0 and row[2]]
    across = [row[:2] for row in rows if row[1] >= 0 and not row[2]]
    assert len(near) > 300
    assert len(within) == len(set(within))
    assert len(across) == len(set(across))
    assert {(j, i) for i, j in across} == set(across)
    assert set(within) | {tuple(sorted(pair)) for pair in across} == near
    assert not set(within) & set(across)

    at_walls = {(i, -1 - j) for i, j, _ in rows if j < 0}
    gaps = np.stack([g for axis in range(3) for g in (position[:, axis], 0.12 - position[:, axis])], axis=1)
    assert at_walls == {(i, w) for i, w in np.argwhere(gaps < radius[:, None] + 0.002).tolist()}
    simulation.free()


def falling_heap(**numerics):
    rng = np.random.default_rng(2)
    positions = 0.0103 * (np.argwhere(np.ones((5, 5, 5))) + 0.5)
    group = particle_group(
        positions, rng.uniform(0.0098, 0.0102, len(positions)), velocity=rng.normal(0.0, 0.3, positions.shape)
    )
    return build_scene(
        {"balls": group}, walls=box(0.0515), pair={"friction": 0.4}, gravity=[0.0, 0.0, -9.81],
        numerics=numerics, run={"duration": 0.005, "velocity_max": 3.0},
    )  # fmt: skip


def test_rows_that_start_too_small_grow_and_change_nothing(taichi_f64, monkeypatch):
    plenty, roomy = run_to_end(falling_heap())
    monkeypatch.setattr(plan_module, "neighbors_per_particle", lambda count, skin: 0.0)
    grown, cramped = run_to_end(falling_heap())
    assert roomy.engine.timing.growth_count == 0
    assert cramped.engine.timing.growth_count > 0
    for name in ("position", "velocity", "angular_velocity", "force", "torque"):
        np.testing.assert_array_equal(grown.particles[name], plenty.particles[name])


def traveling_pair(skin):
    """Two spheres, the first in front, that rub on each other in flight, clamped between two of huge mass.

    A third kind at rest pins the grid, so that the cells' walls pass between the two as they fly.
    """
    flight = [3.0, 0.0, 0.0]
    groups = {
        "pair": particle_group(
            [[0.0098, 0, 0], [0, 0, 0]], velocity=flight, angular_velocity=[[20.0, 0, 50.0], [-10.0, 30.0, 50.0]]
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
    """Which particle's row the pair stood in, seen every few steps, the last snapshot, and how many searches."""
    owners = []

    def sample(snapshot):
        owners.extend(int(owner) for owner, partner, _ in neighbors_of(simulation.engine) if {owner, partner} == {0, 1})

    simulation = Simulation(scene, observers=[every(1e-4, sample)])
    simulation.run()
    last, count = simulation.snapshot(), simulation.engine.timing.rebuild_count
    simulation.free()
    return owners, last, count


def test_history_goes_with_the_pair_whoever_owns_its_row(taichi_f64):
    """Many searches on the way and a change of owner leave the same bits as a run with hardly any search."""
    often, rarely = owners_during(traveling_pair(1e-3)), owners_during(traveling_pair(0.02))
    assert set(often[0]) == {0, 1}, "the pair must have stood in both rows"
    assert often[2] > 10 * rarely[2]
    assert often[1].totals["friction_dissipation"] > 0.0
    for name in ("position", "velocity", "angular_velocity", "force", "torque"):
        np.testing.assert_array_equal(often[1].particles[name], rarely[1].particles[name])


def open_scene(leaving):
    ways = np.concatenate([np.eye(3), -np.eye(3)])
    return build_scene(
        {
            "leavers": particle_group(0.05 * ways, velocity=2.0 * ways),
            "stayer": particle_group([[0.0, 0.0, 0.0]], 0.02),
        },
        domain={"min": [-0.1] * 3, "max": [0.1] * 3, "on_exit": leaving},
        run={"duration": 0.05, "velocity_max": 2.0},
        output={"interval": 0.01},
    )


def test_particles_that_leave_the_domain_are_deleted_and_counted(taichi_f64):
    first, *_, last = run_and_sample(open_scene("delete"), 0.01)
    assert last.particles["id"].tolist() == [6]
    assert last.totals["deleted_count"] == 6.0
    assert last.totals["inserted_count"] == 7.0
    assert last.totals["particle_count"] == 1.0
    assert last.totals["deleted_mass"] == pytest.approx(first.particles["mass"][:6].sum(), rel=1e-14)


def test_a_particle_that_leaves_stops_the_run_where_that_is_an_error(taichi_f64):
    with pytest.raises(
        RunError, match="particle [0-9]+ at 0.0[0-9]+ s is outside the domain, and domain.on_exit is error"
    ):
        run_and_sample(open_scene("error"), 0.01)


def test_a_domain_that_grows_loses_nobody(taichi_f64):
    """They fly on as they flew, x = x0 + v t, and two that meet far out do so as in a domain that is large enough."""
    *_, last = run_and_sample(open_scene("expand"), 0.01)
    ways = np.concatenate([np.eye(3), -np.eye(3)])
    assert last.totals["deleted_count"] == 0.0
    np.testing.assert_allclose(last.particles["position"][:6], (0.05 + 2.0 * last.time) * ways, rtol=1e-12)
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


def test_stragglers_do_not_make_cells_large(taichi_f64):
    """A few balls a kilometer away stand off the grid, and are near to each other as anywhere."""
    rng = np.random.default_rng(7)
    bulk = rng.uniform(0.0, 0.1, (600, 3))
    far = np.array([[1000.0, 0.0, 0.0], [1000.008, 0.0, 0.0], [-300.0, 5.0, 2000.0], [-300.0, 5.009, 2000.0]])
    scene = build_scene(
        {"balls": particle_group(np.concatenate([bulk, far]), 0.01)}, numerics={"skin": 0.001, "chunk_size": 64},
        domain={"min": [0.0] * 3, "max": [0.1] * 3, "on_exit": "expand"},
    )  # fmt: skip
    simulation = prepared_simulation(scene)
    assert simulation.engine.state.cell_sort.cell_side[0].to_numpy() == pytest.approx(np.full(3, 0.011), rel=1e-5)
    near = {tuple(pair) for pair in cKDTree(np.concatenate([bulk, far])).query_pairs(0.011).copy()}
    found = {tuple(sorted(row[:2])) for row in neighbors_of(simulation.engine)}
    assert {(600, 601), (602, 603)} <= found == near
    simulation.free()


def test_ids_stay_with_their_particles_when_others_leave(taichi_f64):
    """Each sphere of a row keeps its own size and height while every other one flies away."""
    count = 40
    positions = np.stack([np.linspace(-0.09, 0.09, count), np.zeros(count), np.arange(count) * 1e-4], axis=1)
    velocity = np.zeros((count, 3))
    velocity[::2, 1] = 5.0
    diameter = np.linspace(0.001, 0.004, count)
    scene = build_scene(
        {"row": particle_group(positions, diameter, velocity=velocity)}, walls={"far": plane([0, -0.1, 0], [0, 1, 0])},
        domain={"min": [-0.1] * 3, "max": [0.1] * 3, "on_exit": "delete"}, run={"duration": 0.03, "velocity_max": 5.0},
    )  # fmt: skip
    last, _ = run_to_end(scene)
    assert last.particles["id"].tolist() == list(range(1, count, 2))
    np.testing.assert_array_equal(last.particles["radius"], 0.5 * diameter[1::2])
    np.testing.assert_array_equal(last.particles["position"], positions[1::2])


@pytest.mark.parametrize("periodic", [[], ["x", "y", "z"]])
def test_wide_sizes_have_the_pairs_of_a_search_over_all(taichi_f64, periodic):
    """Sizes 1 : 20 in four classes; who owns a pair, and that it stands in both rows across chunks, is as ever."""
    rng, size, skin = np.random.default_rng(9), 0.1, 0.0003
    diameter = 0.0015 * 20.0 ** np.concatenate([rng.random(800) ** 3, [0.0, 1.0]])
    positions = rng.uniform(0.0, size, (len(diameter), 3))
    domain = {"min": [0.0] * 3, "max": [size] * 3, "periodic": periodic, "on_exit": "error"}
    scene = build_scene(
        {"balls": particle_group(positions, diameter)}, numerics={"chunk_size": 64, "skin": skin}, domain=domain
    )
    simulation = prepared_simulation(scene)
    assert simulation.plan.features.size_classes == "4"
    distance = positions[:, None] - positions
    distance -= np.round(distance / size) * size if periodic else 0.0
    near = np.linalg.norm(distance, axis=2) < 0.5 * (diameter[:, None] + diameter) + skin
    pairs = {(i, j) for i, j in np.argwhere(near).tolist() if i < j}
    rows = neighbors_of(simulation.engine)
    within = [tuple(sorted(row[:2])) for row in rows if row[2]]
    across = [row[:2] for row in rows if not row[2]]
    assert len(within) == len(set(within)) > 100
    assert len(across) == len(set(across)) > 100
    assert {(j, i) for i, j in across} == set(across)
    assert set(within) | {tuple(sorted(pair)) for pair in across} == pairs
    simulation.free()
