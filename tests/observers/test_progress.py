"""Progress display: a bar on a terminal, otherwise plain lines."""

import io

import pytest
from observers.snapshots import snapshot_of

from granflow.observers.progress import ProgressDisplay

STAGES = [("fill", 1.0), ("settle", 2.0), ("discharge", 3.0)]


@pytest.mark.parametrize("terminal", [False, True])
def test_display_shows_stage_and_rate(terminal):
    output = io.StringIO()
    output.isatty = lambda: terminal
    display = ProgressDisplay(STAGES, output)
    for step in range(600):
        time = display.next_time()
        display.observe(snapshot_of(time=time, step=step, stage="fill" if time < 1 else "settle"))
    display.finish()
    text = output.getvalue()
    assert "fill" in text and "steps/s" in text
    assert terminal or len(text.splitlines()) == 3, "first sample, new stage, end"
