"""Due times of observers, and the progress display."""

import io

import numpy as np
import pytest
from observers.snapshots import snapshot_of

from granflow.errors import GranflowError
from granflow.observers.observer import Schedule
from granflow.observers.progress import ProgressDisplay


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
