"""Observers are built from the output block of a scene."""

from types import SimpleNamespace

import numpy as np

from granflow.observers.build import observers_for, stage_durations
from granflow.observers.timeseries import TimeSeries
from granflow.observers.vtu import ContactFrames, ParticleFrames, WallFrames

TRIANGLES = {"floor": (np.zeros((3, 3)), np.array([[0, 1, 2]]))}


def scene_of(**output):
    meter = SimpleNamespace(point=(0, 0, 0), normal=(0, 0, -1), radius=None, sides=None, group_by=None)
    block = {
        "interval": 0.01, "timeseries_interval": None, "particles": True, "contacts": False, "walls": True,
        "energy_budget": False, "flow_meters": {"outlet": meter}, "fields": {}, "metrics": {}, **output,
    }  # fmt: skip
    domain = SimpleNamespace(min=(-1, -1, -3), max=(1, 1, 1), periodic_box=lambda: None, on_exit="error")
    return SimpleNamespace(
        output=SimpleNamespace(**block), domain=domain, walls={}, measured_walls=(), flow_meter_parts=lambda name: ()
    )


def kinds(scene, triangles, path):
    return [type(observer) for observer in observers_for(scene, path, triangles)]


def test_output_block_selects_the_observers(tmp_path):
    assert kinds(scene_of(), TRIANGLES, tmp_path) == [TimeSeries, ParticleFrames, WallFrames]
    assert kinds(scene_of(contacts=True, particles=False), {}, tmp_path) == [TimeSeries, ContactFrames]
    assert not list(tmp_path.iterdir()), "nothing is written before the first snapshot"


def test_time_series_has_a_separate_interval(tmp_path):
    series, frames, _ = observers_for(scene_of(timeseries_interval=0.001), tmp_path, TRIANGLES)
    for observer in (series, frames):
        observer._schedule.mark_done(0.0)
    assert (series.next_time(), frames.next_time()) == (0.001, 0.01)


def test_stage_durations_are_upper_bounds():
    stages = [
        SimpleNamespace(name="fill", duration=1.0, max_duration=None),
        SimpleNamespace(name="settle", duration=None, max_duration=2.0),
    ]
    assert stage_durations(SimpleNamespace(stages=stages)) == [("fill", 1.0), ("settle", 2.0)]
    assert stage_durations(SimpleNamespace(stages=[], run=SimpleNamespace(duration=4.0))) == [("run", 4.0)]
