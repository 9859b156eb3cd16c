"""A barrier that a worker can leave: no launch blocks on a core that another process uses.

A worker that polls a barrier more than `control.patience` times leaves the launch; the others complete the step
without it, and the launch ends (if it leaves the first barrier, the others complete the launch). The operating system
then has a free core for the interrupted worker. A worker that has left returns with the next launch. Because workers
can leave, a launch also ends if the thread pool of Taichi has fewer threads than workers.
"""

import time
from collections.abc import Callable

from granflow.engine.control import CACHE_LINE, Control
from granflow.engine.state import CPU_STRIDE
from granflow.kernel_language import ti

ARRIVAL_BITS = 16
LEAVE, ARRIVALS = 1 << ARRIVAL_BITS, (1 << ARRIVAL_BITS) - 1
"""The counter of a barrier holds the arrivals in its low bits and the departures above them: one atomic operation
decides whether a worker leaves before or after the last arrival."""

CALIBRATION_POLLS = 50_000
"""Number of polls of one measurement of `seconds_per_poll`."""

SHORTEST_POLL = 1e-9
"""Lower bound of the time of one poll [s], an atomic operation: two launches can differ by more than the polls take."""


@ti.func
def _counter(number):
    """Index of the counter of a barrier in `arrived`; counters occupy separate cache lines."""
    return CACHE_LINE * (1 + number % 2)


@ti.func
def arrive(control: ti.template(), number):
    """Count the worker in; returns 1 for the last worker, which then calls `release`. The others call `wait`.

    The last worker subtracts the workers that left and clears the next counter. Barriers of a launch are numbered from
    1. Two counters alternate, so that a late departure never changes the next barrier.

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

    After `patience` polls the worker leaves unless all have arrived. The first barrier of a launch, whose threads may
    still be starting, has its own number of polls.

    Reads:   released, patience, worker_count
    Writes:  arrived
    """
    # Adding 0 is an atomic read: the compiler cannot move it out of the loop.
    polls, left, most = 0, 0, control.patience[ti.cast(number == 1, ti.i32)]
    while left == 0 and ti.atomic_add(control.released[CACHE_LINE], 0) < number:
        polls += 1
        if polls == most:
            before = ti.atomic_add(control.arrived[_counter(number)], LEAVE)
            left = ti.cast((before & ARRIVALS) < control.worker_count[0], ti.i32)
    return left


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
    launch, polling = (min(seconds_of(polls, 1) for _ in range(3)) for polls in (1, CALIBRATION_POLLS + 1))
    return max(polling - launch, SHORTEST_POLL * CALIBRATION_POLLS) / CALIBRATION_POLLS
