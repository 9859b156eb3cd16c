"""Progress display: a bar on a terminal, otherwise plain lines."""

import io

import pytest
from observers.snapshots import snapshot_of

from granflow.observers.progress import ProgressDisplay, StagePlan, StepRates

STAGES = [("fill", 1.0), ("settle", 2.0), ("discharge", 3.0)]


def test_stage_that_ends_early_reduces_the_planned_end():
    plan = StagePlan(STAGES)
    assert plan.end == 6.0
    plan.enter("fill", 0.5)
    plan.enter("settle", 1.0)
    plan.enter("discharge", 1.5)
    plan.enter("discharge", 2.5)
    assert plan.end == 4.5


def test_resumed_run_has_the_end_of_its_longer_stage():
    """The first stages have ended early, at 1.5 s; discharge now lasts 3.5 s."""
    display = ProgressDisplay(STAGES, io.StringIO())
    for time, stage in ((0.5, "fill"), (1.0, "settle"), (1.5, "discharge"), (2.0, "discharge")):
        display.observe(snapshot_of(time=time, step=0, stage=stage))
    output = io.StringIO()
    resumed = ProgressDisplay([*STAGES[:2], ("discharge", 3.5)], output)
    resumed.load_state_dict(display.state_dict())
    resumed.observe(snapshot_of(time=2.5, step=0, stage="discharge"))
    resumed.finish()
    assert "of 5 s" in output.getvalue()


def test_rates_are_averaged_between_samples():
    rates = StepRates()
    assert rates.particle_steps_per_second() == 0.0
    rates.add(10.0, 0, 100)
    assert rates.steps_per_second() == 0.0
    rates.add(12.0, 500, 100)
    assert rates.steps_per_second() == 250.0
    assert rates.particle_steps_per_second() == 25_000.0


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
    assert "fill" in text
    assert "steps/s" in text
    if not terminal:
        assert len(text.splitlines()) == 3, "first sample, new stage, end"
        assert "\x1b" not in text
