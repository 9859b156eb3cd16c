"""Progress: plain lines off a terminal, a bar on one, never in the way."""

import io

import pytest
from observe.snapshots import snapshot_of
from rich.console import Console

from granflow.observe import ProgressDisplay
from granflow.observe.progress import StagePlan, StepRates

STAGES = [("fill", 1.0), ("settle", 2.0), ("discharge", 3.0)]


def test_a_stage_that_ends_early_brings_the_end_nearer():
    plan = StagePlan(STAGES)
    assert plan.end == 6.0
    plan.enter("fill", 0.5)
    plan.enter("settle", 1.0)
    plan.enter("discharge", 1.5)
    plan.enter("discharge", 2.5)
    assert plan.end == 4.5


def test_rates():
    rates = StepRates()
    assert rates.particle_steps_per_second() == 0.0
    rates.add(10.0, 0, 100)
    assert rates.steps_per_second() == 0.0
    rates.add(12.0, 500, 100)
    assert rates.steps_per_second() == 250.0
    assert rates.particle_steps_per_second() == 25_000.0


@pytest.mark.parametrize("terminal", [False, True])
def test_display(terminal):
    output = io.StringIO()
    display = ProgressDisplay(STAGES, Console(file=output, force_terminal=terminal, width=120))
    for step in range(600):
        time = display.next_time()
        display.observe(snapshot_of(time=time, step=step, stage="fill" if time < 1 else "settle"))
    display.finish()
    text = output.getvalue()
    assert "fill" in text
    assert "steps/s" in text
    if not terminal:
        assert len(text.splitlines()) == 3, "the first look, the new stage, the end"
        assert "\x1b" not in text
