"""Pins the threads of Taichi's pool to cores while the workers of a launch use all cores of this process (Linux only).

A launch wakes one thread per worker. The scheduler can put two of them on one core for several milliseconds although
another core is free, and the others wait at the barrier. Pinned threads start on different cores. If fewer workers than
cores are in use, because other processes use the cores, the scheduler places the threads.
"""

import os
import threading
import time
from collections.abc import Callable

PER_THREAD_CPU_CLOCK = 6
"""Low bits of the number of a Linux clock that measures the CPU time of one thread; the others are ~id."""

MIN_SHARE = 0.5
"""A thread of the pool has at least this share of the largest CPU time of a thread in an identifying launch."""

ATTEMPTS = 60
"""Launches that identify the threads. While two threads share a core, one of them often runs all tasks of a launch,
which one differs between launches: on a loaded machine 5 launches showed both threads in one process of five."""


class WorkerAffinity:
    """Cores of the pool's threads.

    thread_count:  threads of the pool
    launch:        runs a task of about 1 ms on each thread of the pool
    """

    def __init__(self, thread_count: int, launch: Callable[[], object]) -> None:
        self._cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
        covers_all = 1 < thread_count == len(self._cores)
        self._threads = identify_threads(thread_count, launch) if covers_all else []
        self._pinned = False

    def set_workers(self, workers: int) -> None:
        """Pin the threads for a launch with `workers` workers, or let the scheduler place them."""
        pinned = workers == len(self._threads)
        if pinned == self._pinned:
            return
        self._pinned = pinned
        for thread, core in zip(self._threads, self._cores, strict=False):
            try:
                os.sched_setaffinity(thread, {core} if pinned else self._cores)
            except OSError:  # the cores of the process have changed since its start
                self._threads = []
                return


def identify_threads(count: int, launch: Callable[[], object]) -> list[int]:
    """Ids of the `count` threads that run tasks of launches, without the calling one; empty if not found."""
    found: set[int] = set()
    for _ in range(ATTEMPTS):
        before = thread_seconds()
        launch()
        used = {thread: seconds - before.get(thread, 0.0) for thread, seconds in thread_seconds().items()}
        used.pop(threading.get_native_id(), None)
        limit = MIN_SHARE * max(used.values(), default=0.0)
        found |= {thread for thread, seconds in used.items() if seconds > limit}
        if len(found) >= count:
            break
    return sorted(found) if len(found) == count else []


def thread_seconds() -> dict[int, float]:
    """CPU time [s] of each thread of this process; empty if the operating system does not show it."""
    found = {}
    try:
        for thread in map(int, os.listdir("/proc/self/task")):
            found[thread] = time.clock_gettime(~thread << 3 | PER_THREAD_CPU_CLOCK)
    except (OSError, AttributeError, ValueError):
        return {}
    return found
