"""A barrier that a worker can leave: no launch blocks on a core that another process uses.

A worker that polls the barrier more than `control.patience` times leaves the launch; the others continue without it.
The operating system then has a free core for the interrupted worker. A worker that has left returns with the next
launch. Because workers can leave, a launch also ends if the thread pool of Taichi has fewer threads than workers.
"""

import time
from typing import Any

import taichi as ti

from granflow.device.state import CACHE_LINE, CPU_STRIDE, Control

ARRIVAL_BITS = 16
LEAVE, ARRIVALS = 1 << ARRIVAL_BITS, (1 << ARRIVAL_BITS) - 1
"""The counter of a barrier holds the arrivals in its low bits and the departures above them: one atomic operation
decides whether a worker leaves before or after the last arrival."""

CALIBRATION_POLLS = 2_000
"""Number of polls of one measurement of `seconds_per_poll`."""


def build_barrier(control: Control) -> tuple[Any, Any, Any]:
    """Device functions (barrier number): arrive, which returns 1 for the last worker; release; wait.

    The last worker calls `release`; the others call `wait`, which returns 1 if the worker must leave the launch.
    Barriers are numbered from 1. Two counters alternate, so that a late departure never changes the next barrier.

    arrive:   counts the worker in; the last worker subtracts the workers that left and clears the next counter
    release:  sets the number of the last complete barrier
    wait:     polls until the barrier is complete; after `patience` polls the worker leaves unless all have arrived

    Reads:   patience
    Writes:  arrived, released, worker_count
    """

    @ti.func
    def counter(number):
        """Index of the counter of a barrier in `arrived`; counters occupy separate cache lines."""
        return CACHE_LINE * (1 + number % 2)

    @ti.func
    def arrive(number):
        before = ti.atomic_add(control.arrived[counter(number)], 1)
        last = ti.cast((before & ARRIVALS) == control.worker_count[0] - 1, ti.i32)
        if last == 1:
            control.worker_count[0] = control.worker_count[0] - (before >> ARRIVAL_BITS)
            control.arrived[counter(number + 1)] = 0
        return last

    @ti.func
    def release(number):
        ti.atomic_max(control.released[CACHE_LINE], number)

    @ti.func
    def wait(number):
        polls, left = 0, 0
        while left == 0 and ti.atomic_add(control.released[CACHE_LINE], 0) < number:
            polls += 1
            if polls == control.patience[0]:
                before = ti.atomic_add(control.arrived[counter(number)], LEAVE)
                left = ti.cast((before & ARRIVALS) < control.worker_count[0], ti.i32)
        return left

    return arrive, release, wait


def seconds_per_poll(control: Control) -> float:
    """Wall-clock time [s] of one poll of the barrier by a waiting worker: the shortest of three measurements.

    Writes:  released
    """

    @ti.kernel
    def poll(polls: ti.i32):
        for task in range(CPU_STRIDE):
            if task == 0:
                poll_count = 0
                while poll_count < polls and ti.atomic_add(control.released[CACHE_LINE], 0) < polls:
                    poll_count += 1

    control.released[CACHE_LINE] = 0
    poll(0)
    seconds = []
    for _ in range(3):
        began = time.perf_counter()
        poll(CALIBRATION_POLLS)
        seconds.append(time.perf_counter() - began)
    return min(seconds) / CALIBRATION_POLLS
