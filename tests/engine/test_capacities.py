"""Capacities of neighbor lists and saved history may start at 1: they grow without changing a bit."""

import hashlib
import os
import tempfile

import numpy as np
import pytest
from gpu.code_path import use_gpu_code_path
from gpu.scenes import SCENES
from scene_builders import box, build_scene, particle_group
from subprocess_runner import in_subprocess

from granflow.engine import fields as dispatch
from granflow.engine import state_cache
from granflow.engine import stepper as gpu_stepper
from granflow.observers.observer import on_interval
from granflow.plan import capacities
from granflow.plan import plan as plan_module
from granflow.plan.build import plan_for
from granflow.plan.plan import Plan
from granflow.simulation import Simulation


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


def short_lists(monkeypatch):
    monkeypatch.setattr(Plan, "list_capacity_per_segment", property(lambda plan: 8))
    monkeypatch.setattr(plan_module, "MIN_LIST_ENTRIES", 1)
    monkeypatch.setattr(capacities, "SPARE", 1)


def little_history(monkeypatch):
    """The capacity of lists suffices, but at first only one history entry per chunk can be saved."""
    planned = plan_for(compressed_bed(16)).capacities
    monkeypatch.setattr(capacities, "HISTORY_SHARE", (planned.segments + 0.5) / planned.list_entries)
    monkeypatch.setattr(capacities, "SPARE", 0)


def run_and_sample(scene):
    """Snapshots with contacts every millisecond and at the end, and how often the arrays have grown."""
    snapshots = []
    observer = on_interval(1e-3, snapshots.append, ("particles", "totals", "contacts"))
    with Simulation(scene, observers=[observer]) as simulation:
        simulation.run()
        return [*snapshots, simulation.snapshot(contacts=True)], simulation.engine.timing.growth_count


@pytest.mark.parametrize(
    ("chunk_size", "reduce"),
    [(1, short_lists), pytest.param(16, little_history, marks=pytest.mark.slow)],
)
def test_capacities_that_start_small_grow_and_are_bit_identical(taichi_f64, monkeypatch, chunk_size, reduce):
    """The reference takes the arrays of the run that has grown them, and compiles nothing. Kept arrays above the
    limit are freed."""
    monkeypatch.setattr(state_cache, "_kept", [])
    scene = compressed_bed(chunk_size)
    with monkeypatch.context() as patch:
        reduce(patch)
        grown, growth_count = run_and_sample(scene)
        assert growth_count > 0
    reference, growth_count = run_and_sample(scene)
    assert growth_count == 0
    assert max(snapshot.totals["contact_count"] for snapshot in reference) > 40
    for one, other in zip(grown, reference, strict=True):
        assert one.totals == other.totals
        for part in ("particles", "contacts"):
            for name, values in getattr(one, part).items():
                np.testing.assert_array_equal(values, getattr(other, part)[name], err_msg=name)
    monkeypatch.setattr(state_cache, "MOST_BYTES", 0)
    state_cache._free_excess()
    assert not state_cache._kept


def test_capacities_are_rounded_up_in_steps_of_a_quarter():
    rounded = [capacities.rounded_capacity(needed, 100) for needed in (0, 100, 101, 126, 1000)]
    assert rounded == [100, 100, 125, 156, 1151]


def end_of_gas(as_on_gpu, free_memory=None, largest_dispatch=dispatch.LARGEST_DISPATCH):
    """Digest of all arrays and totals of the periodic gas, and numbers of steps and rebuilds.

    free_memory:       bytes of the GPU, on which neighbor lists grow from one entry; None: they do not grow
    largest_dispatch:  largest number of threads of a loop
    """
    dispatch.LARGEST_DISPATCH = largest_dispatch
    if as_on_gpu:
        use_gpu_code_path()
    if free_memory is not None:
        Plan.list_capacity_per_segment = property(lambda plan: 1)
        plan_module.MIN_LIST_ENTRIES = 1
        gpu_stepper.free_device_memory = lambda arch: free_memory
    os.chdir(tempfile.mkdtemp())
    simulation = Simulation(SCENES["periodic"](os.getcwd()), threads=2)
    simulation.run()
    assert (len(simulation.engine.state._block._trees) > 3) == as_on_gpu
    last = simulation.snapshot(contacts=True)
    timing = simulation.engine.timing
    assert (timing.growth_count > 0) == (free_memory is not None)
    arrays = [*last.particles.values(), *last.contacts.values(), np.array(list(last.totals.values()))]
    digest = hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()
    return digest, timing.step_count, timing.rebuild_count


@pytest.mark.slow
def test_neighbor_lists_grow_on_a_gpu_without_changing_a_bit():
    """On the device, with dispatches of 7 threads, of which each has several of the 64 particles, and over the
    host: all fields have 1.4 MB, so that old and new ones do not fit into 1 MiB in addition."""
    expected = in_subprocess(end_of_gas, False)
    assert in_subprocess(end_of_gas, True, 2**40, 7, seconds=600) == expected
    assert in_subprocess(end_of_gas, True, 2**20, seconds=600) == expected
