"""Workers of a CPU launch: the barrier between their phases, their number, and the cores of their threads.

The first section is device code that the kernels of steps and rebuilds call; all others are of the host.

Workers wait for each other after each phase of a step. The barrier is one that a worker can leave, so that no
launch blocks on a core that another process uses: a worker that polls it more than `control.patience` times
leaves the launch; the others complete the step without it, and the launch ends (if it leaves the first
barrier, the others complete the launch). The operating system then has a free core for the interrupted
worker, which returns with the next launch. Because workers can leave, a launch also ends if the thread pool
of Taichi has fewer threads than workers.

On the host, `Workers` chooses the number of workers of each launch, their patience and their cores from the
previous launches. Results depend on none of them.
"""

import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from weakref import WeakKeyDictionary

from granflow.engine.backend import Backend
from granflow.engine.state import CACHE_LINE, CPU_STRIDE, Control, State
from granflow.kernel_language import ti

# In kernels: the barrier between the phases of a step, and of a rebuild

ARRIVAL_BITS = 16
LEAVE = 1 << ARRIVAL_BITS
ARRIVALS = LEAVE - 1
"""The counter of a barrier holds the arrivals in its low bits and the departures above them: one atomic
operation decides whether a worker leaves before or after the last arrival."""


@ti.func
def arrive(control: ti.template(), number):
    """Count the worker in; returns 1 for the last worker, which then calls `release`. The others call `wait`.

    The last worker subtracts the workers that left and clears the next counter. Barriers of a launch are
    numbered from 1. Two counters alternate, so that a late departure never changes the next barrier.

    Reads:   arrived, worker_count
    Writes:  arrived, worker_count
    """
    before = ti.atomic_add(control.arrived[_counter(number)], 1)
    last = ti.cast((before & ARRIVALS) == control.worker_count[0] - 1, ti.i32)
    if last == 1:
        control.worker_count[0] = control.worker_count[0] - (before >> ARRIVAL_BITS)
        control.arrived[_counter(number + 1)] = 0
    return last


@ti.func
def release(control: ti.template(), number):
    """Set the number of the last complete barrier.

    Writes:  released
    """
    # Atomic, so that the compiler moves no store of the phase behind it.
    ti.atomic_max(control.released[CACHE_LINE], number)


@ti.func
def wait(control: ti.template(), number):
    """Poll until the barrier is complete; returns 1 if the worker must leave the launch.

    After `patience` polls the worker leaves unless all have arrived. The first barrier of a launch, whose
    threads may still be starting, has its own number of polls.

    Reads:   released, patience, worker_count
    Writes:  arrived
    """
    # Adding 0 is an atomic read: the compiler cannot move it out of the loop.
    polls = 0
    left = 0
    most = control.patience[ti.cast(number == 1, ti.i32)]
    while left == 0 and ti.atomic_add(control.released[CACHE_LINE], 0) < number:
        polls += 1
        if polls == most:
            before = ti.atomic_add(control.arrived[_counter(number)], LEAVE)
            left = ti.cast((before & ARRIVALS) < control.worker_count[0], ti.i32)
    return left


@ti.func
def _counter(number):
    """Index of the counter of a barrier in `arrived`; counters occupy separate cache lines."""
    return CACHE_LINE * (1 + number % 2)


# On the host: the workers of each launch

BARRIER_CONTENTION_LIMIT = 3e-4
PATIENCE_CHUNKS = 4.0
"""A worker leaves the launch after waiting for BARRIER_CONTENTION_LIMIT [s] plus the time of PATIENCE_CHUNKS
chunks: longer than the differences in cost between chunks, and shorter than the time for which an operating
system preempts a thread."""
START_PATIENCE = 3e-3
"""Additional waiting time at the first barrier of a launch [s], for the start of the threads."""
SINGLE_WORKER_PARTICLES = 512
"""Particle count up to which one worker processes all chunks: barriers would cost more time than more workers
save."""


@dataclass(frozen=True)
class ThreadPool:
    """Measured properties of Taichi's pool: cores of its threads, and time of one poll of a barrier [s]."""

    affinity: "WorkerAffinity"
    seconds_per_poll: float


_pools: "WeakKeyDictionary[Backend, ThreadPool]" = WeakKeyDictionary()
"""The pool of each start of Taichi, once a launch has used several workers."""


class Workers:
    """Chooses the workers of each launch on a CPU and their patience, from the previous launches."""

    def __init__(self, state: State) -> None:
        self._state = state
        self._tuner = WorkerTuner(state.backend.worker_count)
        self._chunk_seconds = self._patience = 0.0

    @property
    def count(self) -> int:
        """Number of workers of the next launch."""
        return 1 if self._state.count <= SINGLE_WORKER_PARTICLES else self._tuner.next_size

    def prepare(self) -> None:
        """Measure the pool before the first launch with several workers, and set the initial patience.

        A single worker never waits, so that most small scenes do not compile and run the kernel of the
        measurement.
        """
        if self.count == 1 or self._patience:
            return
        backend = self._state.backend
        if backend not in _pools:
            _pools[backend] = _measure_pool(self._state)
        self._set_patience(_pools[backend], BARRIER_CONTENTION_LIMIT)

    def place(self, count: int) -> None:
        """Pin the threads for a launch with `count` workers, or let the scheduler place them."""
        pool = _pools.get(self._state.backend)
        if pool is not None:
            pool.affinity.set_workers(count)

    def record(self, steps: int, seconds: float) -> None:
        """Choose workers and patience of the next launch from the wall-clock time [s] of `steps` steps."""
        state = self._state
        workers = self._tuner.next_size
        pool = _pools.get(state.backend)
        if state.count <= SINGLE_WORKER_PARTICLES or pool is None:
            return
        contended = int(state.control.worker_count[0]) < workers
        self._tuner.record(steps * state.count, seconds, contended)
        if contended:
            return  # the time contains the waiting time of the workers that left
        chunk_seconds = workers * seconds / steps / state.chunk_count
        # A single slow launch, interrupted by another process, shall not raise the patience by much.
        self._chunk_seconds = min(chunk_seconds, 1.1 * (self._chunk_seconds or chunk_seconds))
        patience = BARRIER_CONTENTION_LIMIT + PATIENCE_CHUNKS * self._chunk_seconds
        # Small changes are ignored, so that the patience does not follow every fluctuation.
        if not 0.8 * self._patience < patience < 1.25 * self._patience:
            self._set_patience(pool, patience)

    def _set_patience(self, pool: ThreadPool, seconds: float) -> None:
        """Set the time [s] after which a worker leaves a barrier."""
        self._patience = seconds
        patience = self._state.control.patience
        patience[0] = int(seconds / pool.seconds_per_poll)
        patience[1] = int((seconds + START_PATIENCE) / pool.seconds_per_poll)


def _measure_pool(state: State) -> ThreadPool:
    """Measure the pool with a kernel on the control fields of this state."""
    seconds_of = build_poll(state.control)
    workers = state.backend.worker_count
    affinity = WorkerAffinity(workers, lambda: seconds_of(CALIBRATION_POLLS, workers))
    return ThreadPool(affinity, seconds_per_poll(seconds_of))


# On the host: the number of workers

WINDOW = 0.02
"""Launch time [s] over which a rate is measured; also the length of a trial."""
UP_INTERVAL = 0.7
"""Launch time [s] between two trials with more workers."""
FIRST_DOWN_INTERVAL = 0.25
LAST_DOWN_INTERVAL = 8.0
"""Launch time [s] until a trial with fewer workers; doubled after each trial that was not faster."""
CONTENDED_DOWN_INTERVAL = 0.25
"""Launch time [s] between two trials with fewer workers that contention makes due."""
MEMORY = 0.7
"""Weight of the previous rates in the mean with which a trial is compared: a single interruption has little
effect."""
MIN_SPEEDUP = 1.05
"""A trial is faster if its rate is at least this multiple of the previous rate."""
CONTENTION_LIMIT = 3
"""A launch with contention adds 2 to a score, one without subtracts 1. Above this limit half the workers are
tried."""


class WorkerTuner:
    """Proposes the number of workers of each launch from the rate and the contention of previous launches.

    If other processes use the cores, fewer workers can be faster. Trials with twice or half the workers
    measure it; contention makes a trial with half the workers due at once.

    max_size:  largest number of workers, with which the first launch starts

    `size` is the number of workers outside trials.
    """

    def __init__(self, max_size: int) -> None:
        self.size = max_size
        self._max_size = max_size
        self._candidate = 0
        self._rate = 0.0
        self._contention = 0
        self._down_interval = FIRST_DOWN_INTERVAL
        self._since_up = self._since_down = 0.0
        self._since_contended_down = CONTENDED_DOWN_INTERVAL
        self._start_window()

    @property
    def next_size(self) -> int:
        """Number of workers for the next launch."""
        return self._candidate or self.size

    def record(self, work: float, seconds: float, contended: bool) -> None:
        """Record a launch.

        work:       amount of work in a constant unit, such as particle-steps
        seconds:    wall-clock time [s]
        contended:  True if a worker left the launch
        """
        self._work += work
        self._seconds += seconds
        self._since_up += seconds
        self._since_down += seconds
        self._since_contended_down += seconds
        if not self._candidate:
            self._contention = max(self._contention + (2 if contended else -1), 0)
        if self._seconds < WINDOW:
            return
        rate = self._work / self._seconds
        self._start_window()
        if self._candidate:
            self._evaluate(rate)
        else:
            self._rate = MEMORY * self._rate + (1.0 - MEMORY) * rate if self._rate else rate
            self._candidate = self._next_trial()

    def _start_window(self) -> None:
        self._work = self._seconds = 0.0

    def _evaluate(self, rate: float) -> None:
        """Adopt the number of workers of the trial if it is faster.

        `rate`: work per second during the trial. The interval between trials with fewer workers doubles after
        each of them that is not faster.
        """
        faster = rate > MIN_SPEEDUP * self._rate
        down = self._candidate < self.size
        if faster:
            self.size = self._candidate
            self._rate = rate
            self._down_interval = FIRST_DOWN_INTERVAL
        elif down:
            self._down_interval = min(2 * self._down_interval, LAST_DOWN_INTERVAL)
        self._candidate = 0
        self._contention = 0

    def _next_trial(self) -> int:
        """Number of workers of the next trial; 0 if no trial is due."""
        if self.size > 1 and self._down_is_due():
            self._since_down = self._since_contended_down = 0.0
            return self.size // 2
        if self.size < self._max_size and self._since_up >= UP_INTERVAL:
            self._since_up = 0.0
            return min(2 * self.size, self._max_size)
        return 0

    def _down_is_due(self) -> bool:
        """True if a trial with fewer workers is due, because of the interval or of contention."""
        contended = (
            self._contention > CONTENTION_LIMIT and self._since_contended_down >= CONTENDED_DOWN_INTERVAL
        )
        return contended or self._since_down >= self._down_interval


# On the host: the cores of the threads

PER_THREAD_CPU_CLOCK = 6
"""Low bits of the number of a Linux clock that measures the CPU time of one thread; the others are ~id."""
MIN_SHARE = 0.5
"""A thread of the pool has at least this share of the largest CPU time of a thread in an identifying
launch."""
ATTEMPTS = 60
"""Launches that identify the threads. While two threads share a core, one of them often runs all tasks of a
launch, which one differs between launches: on a loaded machine 5 launches showed both threads in one process
of five."""


class WorkerAffinity:
    """Pins the threads of Taichi's pool to cores while the workers of a launch use all cores of this process.

    A launch wakes one thread per worker. The scheduler can put two of them on one core for several
    milliseconds although another core is free, and the others wait at the barrier. Pinned threads start on
    different cores. If fewer workers than cores are in use, because other processes use the cores, the
    scheduler places the threads. Linux only.

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
        for name in os.listdir("/proc/self/task"):
            found[int(name)] = time.clock_gettime(~int(name) << 3 | PER_THREAD_CPU_CLOCK)
    except (OSError, AttributeError, ValueError):
        return {}
    return found


# On the host: the time of one poll of the barrier, which a kernel measures

CALIBRATION_POLLS = 50_000
"""Number of polls of one measurement of `seconds_per_poll`."""
SHORTEST_POLL = 1e-9
"""Lower bound of the time of one poll [s], an atomic operation: two launches can differ by more than the
polls take."""


def build_poll(control: Control) -> Callable[[int, int], float]:
    """Function (polls, workers) -> wall-clock time [s] of a launch in which each worker polls a barrier.

    Writes:  released
    """

    @ti.kernel
    def poll(polls: ti.i32, workers: ti.i32):
        for task in range(workers * CPU_STRIDE):
            if task % CPU_STRIDE == 0:
                poll_count = 0
                while poll_count < polls and ti.atomic_add(control.released[CACHE_LINE], 0) < polls:
                    poll_count += 1

    def seconds_of(polls: int, workers: int) -> float:
        control.released[CACHE_LINE] = 0
        began = time.perf_counter()
        poll(polls, workers)
        return time.perf_counter() - began

    seconds_of(0, 1)
    return seconds_of


def seconds_per_poll(seconds_of: Callable[[int, int], float]) -> float:
    """Wall-clock time [s] of one poll of the barrier by a waiting worker, without the time of the launch.

    seconds_of:  function of `build_poll`
    """
    launch = min(seconds_of(1, 1) for _ in range(3))
    launch_and_polls = min(seconds_of(CALIBRATION_POLLS + 1, 1) for _ in range(3))
    return max(launch_and_polls - launch, SHORTEST_POLL * CALIBRATION_POLLS) / CALIBRATION_POLLS
