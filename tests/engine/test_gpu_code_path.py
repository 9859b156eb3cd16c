"""The code path of a GPU, executed on the CPU: the bits of the CPU's code path, and the number of
dispatches."""

import hashlib
import json
import os
import tempfile
from collections import Counter

import numpy as np
import pytest
from gpu.code_path import use_gpu_code_path
from gpu.scenes import SCENES
from subprocess_runner import in_subprocess

from granflow.engine import fields as dispatch
from granflow.engine import stepper as gpu_stepper
from granflow.engine.stepper import STEPS_BETWEEN_READS
from granflow.kernel_language import KERNELS
from granflow.plan import plan as plan_module
from granflow.plan.plan import Plan
from granflow.simulation import Simulation

MOST_DISPATCHES_OF_A_REBUILD = 20
"""A phase is one dispatch, and one more if it has a serial part; with one grid and friction there are 19."""


def results(name, as_on_gpu, free_memory=None, largest_dispatch=dispatch.LARGEST_DISPATCH):
    """Digest of all arrays at the end of a run, its totals (of a snapshot without arrays) and counts.

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
    simulation = Simulation(SCENES[name](os.getcwd()), threads=2)
    simulation.run()
    assert (len(simulation.engine.state._block._trees) > 3) == as_on_gpu
    last = simulation.snapshot(contacts=True)
    timing = simulation.engine.timing
    arrays = [
        *last.particles.values(),
        *last.contacts.values(),
        *last.impulses.values(),
        *last.collisions.values(),
    ]
    arrays += [wall.offset for wall in last.walls.values()]
    digest = hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()
    counts = [timing.step_count, timing.rebuild_count, int(last.totals["contact_count"])]
    assert (timing.growth_count > 0) == (free_memory is not None)
    totals = simulation.engine.snapshot("end", frozenset({"totals"})).totals
    assert dict(totals) == dict(last.totals)
    return digest, json.dumps(dict(totals), sort_keys=True), counts


@pytest.mark.slow
@pytest.mark.parametrize("over_host", [False, True])
def test_neighbor_lists_grow_without_changing_a_bit(over_host):
    """On the device, with dispatches of 7 threads, and over the host.

    With at most 7 threads per dispatch, each thread has several of the 64 particles. All fields have 1.4 MB:
    with 1 MiB in addition, old and new fields do not fit together, and pass through the host.
    """
    cpu, on_device = (
        in_subprocess(results, "periodic", *each, seconds=600) for each in ((False,), (True, 2**40, 7))
    )
    assert on_device == cpu
    if over_host:
        assert in_subprocess(results, "periodic", True, 2**20, seconds=600) == cpu


def dispatches(name):
    """Dispatches of 4 batches of steps, of a rebuild, and kernel launches that read flags, as counted by
    Taichi."""
    os.environ["TI_KERNEL_PROFILER"] = "1"
    use_gpu_code_path()
    os.chdir(tempfile.mkdtemp())
    simulation = Simulation(SCENES[name](os.getcwd()), threads=1)
    simulation.step(1)
    engine = simulation.engine
    found = Counter()
    while not found and engine.step_count < 400:  # four batches without a rebuild and without a sampled step
        rebuilds = engine.timing.rebuild_count
        engine.stepper._since_sample = 0
        counted_tasks()
        engine.advance(4 * STEPS_BETWEEN_READS)
        found = Counter() if engine.timing.rebuild_count > rebuilds else counted_tasks()
    counted_tasks()
    engine.stepper.rebuild_neighbor_lists(engine.step_count, 0)
    return found, counted_tasks()


def counted_tasks():
    """Dispatches since the last call by name of the kernel."""
    import taichi
    from taichi.profiler.kernel_profiler import get_default_kernel_profiler

    taichi.sync()
    profiler = get_default_kernel_profiler()
    profiler._update_records()
    tasks = Counter(record.name.split("_c")[0] for record in profiler._traced_records)
    taichi.profiler.clear_kernel_profiler_info()
    return tasks


@pytest.mark.slow
@pytest.mark.skipif(KERNELS != "taichi", reason="counted by the profiler of Taichi")
@pytest.mark.parametrize("name", ["servo and free wall"])
def test_a_step_is_two_dispatches_and_a_batch_one_read(name):
    steps, rebuild = in_subprocess(dispatches, name)
    assert steps == {"step_on_gpu": 2 * 4 * STEPS_BETWEEN_READS, "flags": 4}
    assert rebuild["flags"] == 1
    assert rebuild["rebuild_on_gpu"] <= MOST_DISPATCHES_OF_A_REBUILD
