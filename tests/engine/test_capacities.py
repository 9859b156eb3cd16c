"""Capacities of neighbor lists and saved history may start at 1: they grow without changing a bit."""

import numpy as np
import pytest
from scene_builders import box, build_scene, particle_group, prepared_simulation, run_to_end

from granflow.engine import state_cache
from granflow.engine.neighbor.sort import BLOCK_SIDE, CellGrids
from granflow.kernel_language import ti
from granflow.observers.observer import on_interval
from granflow.plan import capacities
from granflow.plan import plan as plan_module
from granflow.plan.build import plan_for
from granflow.plan.plan import Plan
from granflow.simulation import Simulation

ARRAYS = ("position", "velocity", "angular_velocity", "force", "torque", "coordination_number")


def compressed_bed(chunk_size):
    """Closely packed particles and rain, compressed by a rising floor: the number of contacts grows."""
    rng = np.random.default_rng(5)
    walls = box(0.04)
    walls["low_z"] |= {"motion": {"kind": "translation", "velocity": [0.0, 0.0, 1.0]}}
    bed = particle_group(0.0096 * (np.argwhere(np.ones((4, 4, 2))) + 0.6), rng.uniform(0.0095, 0.0098, 32))
    region = {"box": {"min": [0.0, 0.0, 0.026], "max": [0.04, 0.04, 0.04]}}
    rain = {
        "material": "glass", "count": 12, "diameter": 0.006, "velocity": [0.0, 0.0, -1.0],
        "insert": {"kind": "rain", "region": region, "rate": 4000.0},
    }  # fmt: skip
    return build_scene(
        {"bed": bed, "rain": rain}, walls=walls, rolling="epsd",
        pair={"friction": 0.4, "rolling_friction": 0.1, "restitution": 0.3}, gravity=[0.0, 0.0, -9.81],
        numerics={"chunk_size": chunk_size, "max_overlap": 0.5}, output={"interval": 1.0, "energy_budget": True},
        run={"duration": 0.006, "velocity_max": 3.0},
    )  # fmt: skip


def run_and_sample(scene):
    """Snapshots with contacts every millisecond and at the end, and the simulation."""
    snapshots = []
    simulation = Simulation(
        scene, observers=[on_interval(1e-3, snapshots.append, ("particles", "totals", "contacts"))]
    )
    simulation.run()
    snapshots.append(simulation.snapshot(contacts=True))
    simulation.free()
    return snapshots, simulation


@pytest.fixture
def separate_states(monkeypatch):
    """No simulation takes arrays that an earlier one has left."""
    monkeypatch.setattr(state_cache, "_kept", [])


@pytest.mark.parametrize(
    ("chunk_size", "smallest"),
    [(1, 8), *(pytest.param(size, 1, marks=pytest.mark.slow) for size in (1, 16))],
)
def test_capacities_that_start_small_grow_and_are_bit_identical(
    taichi_f64, monkeypatch, separate_states, chunk_size, smallest
):
    """The reference takes the arrays of the run that has grown them, and compiles nothing."""
    scene = compressed_bed(chunk_size)
    monkeypatch.setattr(Plan, "list_capacity_per_segment", property(lambda plan: smallest))
    monkeypatch.setattr(plan_module, "MIN_LIST_ENTRIES", 1)
    monkeypatch.setattr(capacities, "SPARE", 1)
    grown, growing_run = run_and_sample(scene)
    assert growing_run.plan.capacities.list_entries_per_segment <= smallest + 1
    assert growing_run.engine.timing.growth_count > 0
    reference, reference_run = run_and_sample(scene)
    assert reference_run.engine.timing.growth_count == 0
    assert max(snapshot.totals["contact_count"] for snapshot in reference) > 40
    assert len(grown) == len(reference)
    for one, other in zip(grown, reference, strict=True):
        assert one.totals == other.totals
        for name in ARRAYS:
            np.testing.assert_array_equal(one.particles[name], other.particles[name])
        for name, values in one.contacts.items():
            np.testing.assert_array_equal(values, other.contacts[name])


@pytest.mark.slow
def test_batch_grows_for_a_particle_with_many_neighbors(taichi_f64, monkeypatch, separate_states):
    """450 small particles press on a large one; a batch at first holds 392 candidate pairs of one
    particle."""
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(450)
    height = 1.0 - (2.0 * np.arange(450) + 1.0) / 450
    level = np.sqrt(1.0 - height**2)
    directions = np.stack([level * np.cos(turn), level * np.sin(turn), height], axis=1)
    groups = {
        "large": particle_group([[0.0, 0.0, 0.0]], 0.04),
        "small": particle_group(0.021 * directions, 0.002, velocity=-0.1 * directions),
    }
    scene = build_scene(groups, pair={"friction": 0.4}, numerics={"chunk_size": 16}, run={"duration": 1e-4})
    reference, _ = run_to_end(scene)
    monkeypatch.setattr(state_cache, "_kept", [])
    monkeypatch.setattr(plan_module, "MIN_BATCH", 1)
    grown, growing_run = run_to_end(scene)
    assert growing_run.engine.timing.growth_count == 1
    assert reference.particles["coordination_number"].max() == 450
    for name in ARRAYS:
        np.testing.assert_array_equal(grown.particles[name], reference.particles[name])


@pytest.mark.slow
def test_history_capacity_grows_if_saved_history_does_not_fit(taichi_f64, monkeypatch, separate_states):
    """The list capacity suffices, but at first only one history entry per chunk can be saved."""
    scene = compressed_bed(16)
    reference, reference_run = run_and_sample(scene)
    monkeypatch.setattr(state_cache, "_kept", [])
    planned = reference_run.plan.capacities
    monkeypatch.setattr(capacities, "HISTORY_SHARE", (planned.segments + 0.5) / planned.list_entries)
    monkeypatch.setattr(capacities, "SPARE", 0)
    assert plan_for(scene).capacities.saved_entries_per_segment == 1
    grown, growing_run = run_and_sample(scene)
    assert growing_run.engine.timing.growth_count > 0
    for name in ARRAYS:
        np.testing.assert_array_equal(grown[-1].particles[name], reference[-1].particles[name])


@pytest.mark.parametrize(("needed", "expected"), [(0, 100), (100, 100), (101, 125), (126, 156), (1000, 1151)])
def test_capacities_are_rounded_up_in_steps_of_a_quarter(needed, expected):
    assert capacities.rounded_capacity(needed, 100) == expected


def test_cell_grid_respects_the_cell_limit_for_any_extent(taichi_f64):
    grid = falling_particle_grid()
    for extent in (1.0, 1e6, 1e30):
        for side in (1e-3, 1e-30):
            *sides, cells_x, cells_y, cells_z = grid(extent, side, 8192)
            cells = np.array([cells_x, cells_y, cells_z])
            assert 1 <= np.prod(np.ceil(cells / BLOCK_SIDE)) * BLOCK_SIDE**3 <= 8192
            assert np.min(np.multiply(sides, cells)) >= extent


def falling_particle_grid():
    """Function (extent [m], side [m], cell limit): sides and cells of the grid over a cube in an expanding
    domain."""
    domain = {"min": [-1.0] * 3, "max": [1.0] * 3, "on_exit": "expand"}
    state = prepared_simulation(
        build_scene({"ball": particle_group([[0.0] * 3])}, domain=domain)
    ).engine.state
    grids = CellGrids(state)

    @ti.kernel
    def lay(extent: ti.f64, side: ti.f64, limit: ti.i32) -> ti.types.vector(6, ti.f64):
        _low, sides, cells = grids.over(
            ti.Vector.zero(ti.f64, 3), extent * ti.Vector.one(ti.f64, 3), side, limit
        )
        return ti.Vector([sides[0], sides[1], sides[2], cells[0], cells[1], cells[2]], dt=ti.f64)

    return lambda extent, side, limit: lay(extent, side, limit).to_list()
