"""Number of workers of each launch, their cores, and the time that they wait for each other."""

from dataclasses import dataclass
from weakref import WeakKeyDictionary

from granflow.engine.backend import Backend
from granflow.engine.state import State
from granflow.engine.threads.affinity import WorkerAffinity
from granflow.engine.threads.barrier import CALIBRATION_POLLS, build_poll, seconds_per_poll
from granflow.engine.threads.worker_tuner import WorkerTuner

CONTENTION_LIMIT, PATIENCE_CHUNKS = 3e-4, 4.0
"""A worker leaves the launch after waiting this time [s] plus the time for this number of chunks: longer than the
differences in cost between chunks, and shorter than the time for which an operating system preempts a thread."""

START_PATIENCE = 3e-3
"""Additional waiting time at the first barrier of a launch [s], for the start of the threads."""

SINGLE_WORKER_PARTICLES = 512
"""Particle count up to which one worker processes all chunks: barriers would cost more time than more workers save."""


@dataclass(frozen=True)
class ThreadPool:
    """Measured properties of Taichi's pool: cores of its threads, and time of one poll of a barrier [s]."""

    affinity: WorkerAffinity
    seconds_per_poll: float


_pools: "WeakKeyDictionary[Backend, ThreadPool]" = WeakKeyDictionary()
"""The pool of each start of Taichi, once a launch has used several workers."""


def _measure_pool(state: State) -> ThreadPool:
    """Measure the pool with a kernel on the control fields of this state."""
    seconds_of, workers = build_poll(state.control), state.backend.worker_count
    affinity = WorkerAffinity(workers, lambda: seconds_of(CALIBRATION_POLLS, workers))
    return ThreadPool(affinity, seconds_per_poll(seconds_of))


class Workers:
    """Chooses the workers of each launch on a CPU and how long they wait at a barrier, from the previous launches."""

    def __init__(self, state: State) -> None:
        self._state = state
        self._tuner = WorkerTuner(state.backend.worker_count)
        self._chunk_seconds = self._patience = 0.0

    @property
    def count(self) -> int:
        """Number of workers of the next launch."""
        return 1 if self._state.count <= SINGLE_WORKER_PARTICLES else self._tuner.next_size

    def prepare(self) -> None:
        """Measure the pool of this process before the first launch with several workers, and set the initial patience.

        A single worker never waits, so that most small scenes do not compile and run the kernel of the measurement.
        """
        if self.count == 1 or self._patience:
            return
        backend = self._state.backend
        if backend not in _pools:
            _pools[backend] = _measure_pool(self._state)
        self._set_patience(_pools[backend], CONTENTION_LIMIT)

    def place(self, count: int) -> None:
        """Pin the threads for a launch with `count` workers, or let the scheduler place them."""
        pool = _pools.get(self._state.backend)
        if pool is not None:
            pool.affinity.set_workers(count)

    def record(self, steps: int, seconds: float) -> None:
        """Choose workers and patience of the next launch from the wall-clock time [s] of a launch of `steps` steps."""
        state, workers = self._state, self._tuner.next_size
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
        patience = CONTENTION_LIMIT + PATIENCE_CHUNKS * self._chunk_seconds
        # Small changes are ignored, so that the patience does not follow every fluctuation.
        if not 0.8 * self._patience < patience < 1.25 * self._patience:
            self._set_patience(pool, patience)

    def _set_patience(self, pool: ThreadPool, seconds: float) -> None:
        """Set the time [s] after which a worker leaves a barrier."""
        self._patience, patience = seconds, self._state.control.patience
        patience[0] = int(seconds / pool.seconds_per_poll)
        patience[1] = int((seconds + START_PATIENCE) / pool.seconds_per_poll)
