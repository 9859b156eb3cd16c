"""Observers are built from the output block of a plan; due times; the progress display."""

import io

import numpy as np
import pytest
from observers.snapshots import snapshot_of
from scene_builders import build_scene, particle_group, plane

from granflow.errors import GranflowError
from granflow.observers.build import observers_for
from granflow.observers.frames import ContactFrames, ParticleFrames, WallFrames
from granflow.observers.observer import Schedule
from granflow.observers.progress import ProgressDisplay
from granflow.observers.timeseries import TimeSeries
from granflow.plan.build import plan_for


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
    for interval in (0.0, float("nan")):
        with pytest.raises(GranflowError, match="interval"):
            Schedule(interval)


def test_output_block_selects_the_observers(tmp_path):
    def observers(path, walls=None, **output):
        meters = {"outlet": {"point": [0, 0, 0], "normal": [0, 0, -1]}}
        block = {"interval": 0.01, "flow_meters": meters, **output}
        return observers_for(
            plan_for(build_scene({"ball": particle_group([0, 0, 0])}, walls, output=block)), path
        )

    floor = {"floor": plane([0.0] * 3, [0.0, 0.0, 1.0])}
    found = [
        observers(tmp_path, floor, timeseries_interval=0.001),
        observers(tmp_path, contacts=True, particles=False),
        observers(None, floor),
        observers(None, floor, flow_meters={}),
    ]
    assert [[type(each) for each in row] for row in found] == [
        [TimeSeries, ParticleFrames, WallFrames],
        [TimeSeries, ContactFrames],
        [TimeSeries],  # without a directory only meters are observed
        [],
    ]
    assert not list(tmp_path.iterdir()), "nothing is written before the first snapshot"
    for observer in found[0]:
        observer._schedule.mark_done(0.0)
    assert [each.next_time() for each in found[0]] == [0.001, 0.01, 0.01]


@pytest.mark.parametrize("terminal", [False, True])
def test_display_shows_stage_and_rate(terminal):
    output = io.StringIO()
    output.isatty = lambda: terminal
    display = ProgressDisplay([("fill", 1.0), ("settle", 2.0), ("discharge", 3.0)], output)
    for step in range(600):
        time = display.next_time()
        display.observe(snapshot_of(time=time, step=step, stage="fill" if time < 1 else "settle"))
    display.finish()
    text = output.getvalue()
    assert "fill" in text and "steps/s" in text
    assert terminal or len(text.splitlines()) == 3, "first sample, new stage, end"
