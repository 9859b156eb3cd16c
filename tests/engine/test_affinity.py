"""The threads of the pool are identified by their CPU time and pinned while the workers use all cores."""

import hashlib
import itertools
import os
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from granflow.engine.threads import WorkerAffinity, identify_threads, thread_seconds

pytestmark = pytest.mark.skipif(not thread_seconds(), reason="needs the CPU time of threads, as on Linux")
CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1
DATA = bytes(5_000_000)  # hashing takes some milliseconds and releases the lock of the interpreter


@pytest.fixture
def pool():
    """Ids of CORES threads, and a function that gives each of them work."""
    barrier = threading.Barrier(CORES)

    def task(_):
        barrier.wait()
        hashlib.sha256(DATA).digest()
        return threading.get_native_id()

    with ThreadPoolExecutor(CORES) as executor:
        yield sorted(executor.map(task, range(CORES))), lambda: list(executor.map(task, range(CORES)))


def test_threads_are_identified_by_their_cpu_time(pool):
    threads, launch = pool
    assert identify_threads(CORES, launch) == threads
    assert identify_threads(CORES + 1, launch) == []


def test_threads_are_identified_if_one_thread_runs_all_tasks_of_a_launch():
    with ThreadPoolExecutor(1) as first, ThreadPoolExecutor(1) as second:
        turns = itertools.cycle([first] * 7 + [second])

        def launch():
            return (
                next(turns)
                .submit(lambda: [threading.get_native_id(), hashlib.sha256(DATA).digest()])
                .result()[0]
            )

        threads = sorted({launch() for _ in range(8)})
        assert identify_threads(2, launch) == threads


@pytest.mark.skipif(CORES == 1, reason="needs two cores")
def test_threads_are_pinned_to_different_cores_while_all_cores_are_used(pool):
    threads, launch = pool
    allowed = os.sched_getaffinity(0)
    affinity = WorkerAffinity(CORES, launch)
    affinity.set_workers(CORES)
    cores = [os.sched_getaffinity(thread) for thread in threads]
    assert [len(each) for each in cores] == [1] * CORES
    assert set.union(*cores) == allowed
    affinity.set_workers(1)
    assert all(os.sched_getaffinity(thread) == allowed for thread in threads)


def test_threads_are_not_pinned_if_the_pool_has_fewer_threads_than_cores(pool):
    threads, launch = pool
    allowed = os.sched_getaffinity(0)
    WorkerAffinity(CORES - 1, launch).set_workers(CORES - 1)
    assert all(os.sched_getaffinity(thread) == allowed for thread in threads)
