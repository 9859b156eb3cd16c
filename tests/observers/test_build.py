"""Observers are built from the output block of a plan."""

from scene_builders import build_scene, particle_group, plane

from granflow.observers.build import observers_for
from granflow.observers.frames import ContactFrames, ParticleFrames, WallFrames
from granflow.observers.timeseries import TimeSeries
from granflow.plan.build import plan_for

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
