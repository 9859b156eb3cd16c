"""Chunks by the number of workers. The worker tuner selects the fastest number of workers from rates and
contention of launches (modeled here)."""

import numpy as np
import pytest
from scene_builders import build_scene, particle_group

from granflow.engine.threads import WorkerTuner
from granflow.plan.build import plan_for, with_workers

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


@pytest.mark.parametrize("launch", [0.002, 0.05])
@pytest.mark.parametrize("shared", [{1: 1.0, 2: 0.3}, {1: 1.0, 2: 0.7, 4: 0.3}])
def test_contention_reduces_the_workers_within_a_second_and_they_return_when_it_ends(launch, shared):
    """Cores, each shared with another process: workers wait for each other at most barriers."""
    tuner = WorkerTuner(max(shared))
    launches(tuner, IDLE, 30.0, launch=launch)
    launches(tuner, shared, 1.0, contended_above=1, launch=launch)
    assert tuner.size == 1
    time_by_size = launches(tuner, shared, 5.0, contended_above=1, launch=launch)
    assert tuner.size == 1
    assert mean_rate(time_by_size, shared) > 0.9 * shared[1]
    launches(tuner, IDLE, 2.0, launch=launch)
    assert tuner.size == max(shared)


def test_fewer_workers_are_used_if_more_are_slower_without_contention():
    tuner = WorkerTuner(4)
    launches(tuner, {1: 1.0, 2: 0.9, 4: 0.5}, 4.0)
    assert tuner.size == 1


@pytest.mark.parametrize(
    ("speed", "launch", "slower", "contended"),
    [
        ({1: 1.0, 2: 1.6}, LAUNCH, (1.0, 1.0), 3),  # every third launch is contended
        ({1: 1.0, 2: 1.9}, 1e-3, (1.9, 0.1), 0),  # rates of short launches scatter: 20 together have the mean
    ],
)
def test_rare_contention_and_scattered_rates_keep_two_workers(speed, launch, slower, contended):
    tuner = WorkerTuner(2)
    for number in range(4_000):
        size = tuner.next_size
        is_contended = bool(contended) and size == 2 and number % contended == 0
        tuner.record(launch * speed[size] * slower[number % 2], launch, contended=is_contended)
    assert tuner.size == 2


@pytest.mark.parametrize(("count", "workers", "given", "size"), [
    (64, 4, "auto", 1), (65, 1, "auto", 512), (5000, 1, "auto", 5000), (17000, 1, "auto", 16384),
    (5000, 2, "auto", 625), (5001, 2, "auto", 626), (40000, 2, "auto", 4000), (5000, 4, "auto", 512), (5000, 2, 77, 77),
])  # fmt: skip
def test_chunks_by_particles_and_workers(count, workers, given, size):
    """One worker has chunks of at most 16384 particles, each of several workers an equal number of chunks of 512
    to 4096 particles, at least four if the particles suffice."""
    scene = build_scene({"balls": particle_group(np.zeros((count, 3)))}, numerics={"chunk_size": given})
    assert with_workers(plan_for(scene), workers).chunk_size == size
    assert with_workers(plan_for(scene, on_gpu=True), workers).chunk_size == 1
