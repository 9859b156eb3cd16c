"""The worker tuner selects the fastest number of workers from rates and contention of launches (modeled
here)."""

import pytest

from granflow.engine.threads import WorkerTuner

LAUNCH = 0.05
"""Wall seconds of a launch."""


def launches(tuner, speed, seconds, contended_above=99, launch=LAUNCH):
    """Launches for `seconds`; `size` workers do `speed[size]` units per second. Returns the time [s] by
    size."""
    time_by_size = dict.fromkeys(speed, 0.0)
    for _ in range(round(seconds / launch)):
        size = tuner.next_size
        time_by_size[size] += launch
        tuner.record(launch * speed[size], launch, contended=size > contended_above)
    return time_by_size


def mean_rate(time_by_size, speed):
    return sum(speed[size] * seconds for size, seconds in time_by_size.items()) / sum(time_by_size.values())


IDLE = {1: 1.0, 2: 1.9, 4: 3.6}


def test_all_workers_are_used_if_they_are_faster():
    tuner = WorkerTuner(4)
    launches(tuner, IDLE, 10.0)
    time_by_size = launches(tuner, IDLE, 40.0)
    assert tuner.size == 4
    assert mean_rate(time_by_size, IDLE) > 0.98 * IDLE[4], "launches that test fewer workers are rare"


@pytest.mark.parametrize("launch", [0.002, 0.01, 0.05])
def test_contention_reduces_the_workers_within_a_second(launch):
    """Two cores, each shared with another process: two workers wait for each other at most barriers."""
    tuner = WorkerTuner(2)
    shared = {1: 1.0, 2: 0.3}
    launches(tuner, {1: 1.0, 2: 1.9}, 30.0, launch=launch)
    launches(tuner, shared, 1.0, contended_above=1, launch=launch)
    time_by_size = launches(tuner, shared, 5.0, contended_above=1, launch=launch)
    assert tuner.size == 1
    assert mean_rate(time_by_size, shared) > 0.9 * shared[1]


def test_contention_reduces_four_workers_to_one_within_a_second():
    tuner = WorkerTuner(4)
    shared = {1: 1.0, 2: 0.7, 4: 0.3}
    launches(tuner, IDLE, 30.0)
    launches(tuner, shared, 1.0, contended_above=1)
    assert tuner.size == 1


@pytest.mark.parametrize("max_size", [2, 4])
def test_workers_return_when_the_contention_ends(max_size):
    tuner = WorkerTuner(max_size)
    launches(tuner, {1: 1.0, 2: 0.4, 4: 0.2}, 5.0, contended_above=1)
    assert tuner.size == 1
    launches(tuner, IDLE, 2.0)
    assert tuner.size == max_size


def test_fewer_workers_are_used_if_more_are_slower_without_contention():
    tuner = WorkerTuner(4)
    launches(tuner, {1: 1.0, 2: 0.9, 4: 0.5}, 4.0)
    assert tuner.size == 1


def test_rare_contention_keeps_two_workers_if_they_are_faster():
    tuner = WorkerTuner(2)
    speed = {1: 1.0, 2: 1.6}
    for number in range(2_000):
        size = tuner.next_size
        tuner.record(LAUNCH * speed[size], LAUNCH, contended=size == 2 and number % 3 == 0)
    assert tuner.size == 2


def test_short_launches_are_evaluated_together():
    """The rate of one launch of 1 ms scatters by a factor of ten; twenty launches together have the mean
    rate."""
    tuner = WorkerTuner(2)
    for number in range(4_000):
        speed = {1: 1.0, 2: 1.9}[tuner.next_size]
        tuner.record(1e-3 * speed * (0.1 if number % 2 else 1.9), 1e-3, contended=False)
    assert tuner.size == 2
