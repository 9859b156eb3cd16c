"""Every first guess of a capacity may be 1: rows, kept history and all that goes with them grow, bit for bit."""

import numpy as np
import pytest
from scene_builders import box, build_scene, particle_group

from granflow.device.cell_grid import CellGrid
from granflow.observe import every
from granflow.plan import Plan, capacities
from granflow.simulation import Simulation

ARRAYS = ("position", "velocity", "angular_velocity", "force", "torque", "coordination_number")


def crushed(chunk_size):
    """Spheres packed closely and rain onto them, over a floor that comes up: ever more contacts."""
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
    """All snapshots every millisecond, contacts too, the last one, and the simulation."""
    seen = []
    simulation = Simulation(scene, observers=[every(1e-3, seen.append, ("particles", "totals", "contacts"))])
    simulation.run()
    seen.append(simulation.snapshot(contacts=True))
    simulation.free()
    return seen, simulation


@pytest.mark.parametrize("chunk_size", [1, pytest.param(16, marks=pytest.mark.slow)])
def test_slots_and_kept_slots_that_start_at_one_end_in_the_same_bits(taichi_f64, monkeypatch, chunk_size):
    scene = crushed(chunk_size)
    monkeypatch.setattr(Plan, "list_capacity_per_chunk", property(lambda plan: 40 * plan.chunk_size))
    plenty, roomy = run_and_sample(scene)
    assert roomy.engine.timing.growth_count == 0
    assert max(snapshot.totals["contact_count"] for snapshot in plenty) > 40

    monkeypatch.setattr(Plan, "list_capacity_per_chunk", property(lambda plan: 1))
    monkeypatch.setattr(capacities, "SPARE", 1)
    assert capacities.history_capacity(1) == 1
    grown, cramped = run_and_sample(scene)
    assert cramped.engine.timing.growth_count > 0
    assert cramped.engine.state.neighbors.list_capacity_per_chunk < 40 * chunk_size
    assert len(grown) == len(plenty)
    for one, other in zip(grown, plenty, strict=True):
        assert one.totals == other.totals
        for name in ARRAYS:
            np.testing.assert_array_equal(one.particles[name], other.particles[name])
        for name, values in one.contacts.items():
            np.testing.assert_array_equal(values, other.contacts[name])


@pytest.mark.slow
def test_history_that_finds_no_room_when_it_is_set_aside_grows_too(taichi_f64, monkeypatch):
    """Rows long enough, but with room to keep the history of a single slot of each chunk."""
    scene = crushed(16)
    monkeypatch.setattr(Plan, "list_capacity_per_chunk", property(lambda plan: 40 * plan.chunk_size))
    plenty, _ = run_and_sample(scene)
    monkeypatch.setattr(capacities, "HISTORY_SHARE", 1 / 640)
    monkeypatch.setattr(capacities, "SPARE", 0)
    assert capacities.history_capacity(640) == 1
    monkeypatch.setattr("granflow.device.stepper.list_capacity_for", lambda saved: grow_share(monkeypatch, saved))
    grown, cramped = run_and_sample(scene)
    assert cramped.engine.timing.growth_count > 0
    for name in ARRAYS:
        np.testing.assert_array_equal(grown[-1].particles[name], plenty[-1].particles[name])


def grow_share(monkeypatch, saved):
    """Instead of longer rows, a share of them that holds sixteen times what must be kept."""
    monkeypatch.setattr(capacities, "HISTORY_SHARE", 16 * saved / 640)
    return 640


@pytest.mark.parametrize("extent", [1.0, 1e6, 1e30])
@pytest.mark.parametrize("side", [1e-3, 1e-30])
def test_the_search_grid_fits_into_its_cells_however_far_apart_the_particles_are(extent, side):
    limit = 8192
    grid = CellGrid.over(np.zeros(3), np.full(3, extent), side, limit)
    assert 1 <= grid.cell_count <= limit
    assert min(grid.blocks) >= 1
    assert min(np.multiply(grid.side, grid.cells)) >= extent
