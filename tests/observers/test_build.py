"""Observers are built from the output block of a plan; due times neither drift nor repeat."""

from fractions import Fraction

import numpy as np
import pytest
from observers.snapshots import snapshot_of
from scene_builders import build_scene, particle_group, plane

from granflow.errors import GranflowError
from granflow.observers.build import observers_for
from granflow.observers.frames import ContactFrames, ParticleFrames, WallFrames
from granflow.observers.observer import Schedule, on_interval
from granflow.observers.timeseries import TimeSeries
from granflow.plan.build import plan_for


@pytest.mark.parametrize("interval", [0.01, 1 / 3])
def test_many_intervals_stay_within_one_rounding_of_the_exact_time(interval):
    schedule = Schedule(interval, start=0.25)
    for k in range(200_000):
        due = schedule.next_time()
        if k % 9_991 == 0 or k == 199_999:
            exact = Fraction(0.25) + k * Fraction(interval)
            assert abs(Fraction(due) - exact) <= Fraction(np.spacing(due))
        schedule.mark_done(due)


def test_due_times():
    """Skipped times are due once, as is the same time; a time rounded down is the due time, an earlier one is
    not."""
    schedule = Schedule(0.1)
    schedule.mark_done(0.05)
    assert schedule.next_time() == pytest.approx(0.1)
    assert schedule.mark_done(0.1) and not schedule.mark_done(0.1)
    schedule.mark_done(np.nextafter(0.3, 0))
    assert schedule.next_time() == pytest.approx(0.4)
    assert schedule.mark_done(0.55)
    assert schedule.next_time() == pytest.approx(0.6)


@pytest.mark.parametrize("interval", [0.0, -1.0, float("inf"), float("nan")])
def test_interval_must_be_positive_and_finite(interval):
    with pytest.raises(GranflowError, match="interval"):
        Schedule(interval)


def test_observer_of_a_function_calls_it_once_per_time():
    observed_times = []
    observer = on_interval(
        0.5, lambda snapshot: observed_times.append(snapshot.time), wants=("totals", "contacts")
    )
    assert observer.wants == {"totals", "contacts"}
    for time in (0.0, 0.5, 0.5, 1.0):
        observer.observe(snapshot_of(time=time))
    observer.finish()
    assert observed_times == [0.0, 0.5, 1.0]
    assert observer.next_time() == 1.5


FLOOR = {"floor": plane([0.0] * 3, [0.0, 0.0, 1.0])}


def plan_of(walls=FLOOR, **output):
    """A plan with a flow meter, and other keys of the output block."""
    block = {
        "interval": 0.01, "flow_meters": {"outlet": {"point": [0, 0, 0], "normal": [0, 0, -1]}}, **output
    }  # fmt: skip
    return plan_for(build_scene({"ball": particle_group([0, 0, 0])}, walls=walls, output=block))


def kinds(plan, path):
    return [type(observer) for observer in observers_for(plan, path)]


def test_output_block_selects_the_observers(tmp_path):
    assert kinds(plan_of(), tmp_path) == [TimeSeries, ParticleFrames, WallFrames]
    assert kinds(plan_of({}, contacts=True, particles=False), tmp_path) == [TimeSeries, ContactFrames]
    assert not list(tmp_path.iterdir()), "nothing is written before the first snapshot"
    assert kinds(plan_of(), None) == [TimeSeries], "without a directory only meters are observed"
    assert kinds(plan_of(flow_meters={}), None) == []


def test_time_series_has_a_separate_interval(tmp_path):
    series, frames, _ = observers_for(plan_of(timeseries_interval=0.001), tmp_path)
    for observer in (series, frames):
        observer._schedule.mark_done(0.0)
    assert (series.next_time(), frames.next_time()) == (0.001, 0.01)
