"""Threads: the default count follows affinity, cgroup quota and Slurm; workers are tuned and pinned; chunks."""

import hashlib
import os
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scene_builders import build_scene, particle_group

from granflow.engine.threads import WorkerAffinity, WorkerTuner, identify_threads, thread_seconds
from granflow.errors import GranflowError
from granflow.io import machine
from granflow.io.machine import allowed_cores, quota_cores, worker_count
from granflow.plan.build import plan_for, with_workers

V2, V1 = "0::/user/job\n", "5:memory:/job\n4:cpu,cpuacct:/job\n"
PERIOD = {"cpu,cpuacct/job/cpu.cfs_period_us": "100000"}


@pytest.mark.parametrize(
    ("groups", "texts", "cores"),
    [
        (V2, {"user/job/cpu.max": "150000 100000"}, 2),  # 1.5 cores: two threads can use them, one cannot
        (V2, {"user/job/cpu.max": "50000 100000"}, 1),
        (V2, {"user/job/cpu.max": "max 100000", "user/cpu.max": "300000 100000"}, 3),
        (V2, {"user/job/cpu.max": "400000 100000", "cpu.max": "100000 100000"}, 1),
        (V2, {"cpu.max": "nonsense"}, None),
        (V1, PERIOD | {"cpu,cpuacct/job/cpu.cfs_quota_us": "300000"}, 3),
        (V1, PERIOD | {"cpu,cpuacct/job/cpu.cfs_quota_us": "-1"}, None),
    ],
)
def test_quota_of_a_cgroup_and_slurm_limit_the_cores(tmp_path, monkeypatch, groups, texts, cores):
    monkeypatch.setattr(machine, "ROOT", tmp_path)
    group_files = {f"sys/fs/cgroup/{name}": text for name, text in texts.items()}
    for name, text in {"proc/self/cgroup": groups, **group_files}.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert quota_cores({}) == cores
    assert quota_cores({"SLURM_CPUS_PER_TASK": "2"}) == min(cores or 2, 2)
    for value in ("0", "many", ""):
        assert quota_cores({"SLURM_CPUS_PER_TASK": value}) == cores


def test_threads_are_the_smaller_of_affinity_and_quota_and_more_are_reduced_with_a_warning(monkeypatch):
    for affinity, quota, count in ((8, 3, 3), (2, 5, 2)):
        assert worker_count(None, affinity, quota) == (count, "")
    count, warning = worker_count(8, affinity=2, quota=1)
    assert count == 2 and "this process can use 2 cores, so granflow uses 2" in warning
    assert worker_count(2, affinity=2, quota=1) == (2, "")
    for threads in (0, 2.5, "2"):
        with pytest.raises(GranflowError, match="give a whole number of at least 1, or None for all"):
            worker_count(threads)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {3}, raising=False)
    monkeypatch.setattr("os.cpu_count", lambda: 64)
    assert allowed_cores() == 1


CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1


@pytest.mark.skipif(not thread_seconds() or CORES == 1, reason="needs CPU times of threads and two cores")
def test_threads_are_pinned_to_different_cores_while_all_cores_are_used():
    barrier = threading.Barrier(CORES)
    data = bytes(5_000_000)  # hashing takes some milliseconds and releases the lock of the interpreter

    def task(_):
        barrier.wait()
        hashlib.sha256(data).digest()
        return threading.get_native_id()

    allowed = os.sched_getaffinity(0)
    with ThreadPoolExecutor(CORES) as executor:
        threads = sorted(executor.map(task, range(CORES)))

        def launch():
            return list(executor.map(task, range(CORES)))

        assert identify_threads(CORES, launch) == threads
        assert identify_threads(CORES + 1, launch) == []
        affinity = WorkerAffinity(CORES, launch)
        affinity.set_workers(CORES)
        cores = [os.sched_getaffinity(thread) for thread in threads]
        assert [len(each) for each in cores] == [1] * CORES and set.union(*cores) == allowed
        affinity.set_workers(1)
        WorkerAffinity(CORES - 1, launch).set_workers(CORES - 1)
        assert all(os.sched_getaffinity(thread) == allowed for thread in threads)


def launches(tuner, speed, seconds, contended_above=99, launch=0.05):
    """Mean rate of launches for `seconds`; `size` workers do `speed[size]` units per second."""
    done = 0.0
    for _ in range(round(seconds / launch)):
        size = tuner.next_size
        done += launch * speed[size]
        tuner.record(launch * speed[size], launch, contended=size > contended_above)
    return done / seconds


IDLE = {1: 1.0, 2: 1.9, 4: 3.6}


def test_all_workers_are_used_if_they_are_faster_and_fewer_if_not():
    tuner = WorkerTuner(4)
    launches(tuner, IDLE, 10.0)
    assert launches(tuner, IDLE, 40.0) > 0.98 * IDLE[4], "launches that test fewer workers are rare"
    assert tuner.size == 4
    tuner = WorkerTuner(4)
    launches(tuner, {1: 1.0, 2: 0.9, 4: 0.5}, 4.0)
    assert tuner.size == 1


@pytest.mark.parametrize("launch", [0.002, 0.05])
def test_contention_reduces_the_workers_within_a_second_and_they_return_when_it_ends(launch):
    """Cores, each shared with another process: workers wait for each other at most barriers."""
    shared = {1: 1.0, 2: 0.7, 4: 0.3}
    tuner = WorkerTuner(4)
    launches(tuner, IDLE, 30.0, launch=launch)
    launches(tuner, shared, 1.0, contended_above=1, launch=launch)
    assert tuner.size == 1
    assert launches(tuner, shared, 5.0, contended_above=1, launch=launch) > 0.9 * shared[1]
    assert tuner.size == 1
    launches(tuner, IDLE, 2.0, launch=launch)
    assert tuner.size == 4


@pytest.mark.parametrize(("count", "workers", "given", "size"), [
    (64, 4, "auto", 1), (65, 1, "auto", 512), (17000, 1, "auto", 16384),
    (5001, 2, "auto", 626), (40000, 2, "auto", 4000), (5000, 4, "auto", 512), (5000, 2, 77, 77),
])  # fmt: skip
def test_chunks_by_particles_and_workers(count, workers, given, size):
    """One worker has chunks of at most 16384 particles, each of several workers an equal number of chunks of 512
    to 4096 particles, at least four if the particles suffice."""
    scene = build_scene({"balls": particle_group(np.zeros((count, 3)))}, numerics={"chunk_size": given})
    assert with_workers(plan_for(scene), workers).chunk_size == size
    assert with_workers(plan_for(scene, on_gpu=True), workers).chunk_size == 1
