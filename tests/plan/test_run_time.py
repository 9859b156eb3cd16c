"""Runs shorter than a step, too long, or with a step that does not advance the time are rejected before the
start."""

import pytest
from scene_builders import build_scene, particle_group

from granflow.errors import SceneError
from granflow.plan.build import plan_for
from granflow.plan.cost import YEAR, least_run_time, refuse_run_time

STEP = 1e-6


def scene(count=1, **parts):
    positions = [[0.02 * k, 0.0, 0.0] for k in range(count)]
    run = {"duration": 1.0, "time_step": STEP} | parts.pop("run", {})
    return build_scene({"balls": particle_group(positions)}, run=run, **parts)


def rejection(scene, allow_long=False):
    """Message of the rejection, or an empty string."""
    try:
        refuse_run_time(plan_for(scene), allow_long)
    except SceneError as error:
        return str(error)
    return ""


def test_duration_of_a_run_or_stage_below_one_step_is_rejected():
    assert not rejection(scene(run={"duration": STEP}))
    message = rejection(scene(run={"duration": 0.99 * STEP}))
    assert "run.duration is 9.9e-07 s, shorter than one time step of 1e-06 s (given in the scene)" in message
    rest = {"name": "rest", "kinetic_energy_below": 1e-9, "max_duration": 0.5 * STEP}
    message = rejection(scene(run={"duration": None}, stages=[{"name": "fill", "duration": 1.0}, rest]))
    assert "stages.1.max_duration is 5e-07 s, shorter than one time step" in message


def test_steps_that_do_not_advance_the_time_are_always_rejected():
    """The floating-point spacing at a time T is T 2^-53 to T 2^-52."""
    for allow_long in (False, True):
        assert "that time in f64 resolves" in rejection(scene(run={"time_step": 0.99 * 2.0**-52}), allow_long)
        assert "that time in f64 resolves" in rejection(scene(run={"time_step": 1e-30}), allow_long)
    assert not rejection(scene(run={"time_step": 1.01 * 2.0**-52}), allow_long=True)


@pytest.mark.parametrize(("count", "rate"), [(1, 1e6), (1000, 1e6), (5000, 1e9 / 5000)])
def test_run_of_more_than_a_year_is_rejected_without_allow_long(count, rate):
    """At 1e6 steps per second or 1e9 particle-steps per second, whichever is slower."""
    seconds = STEP * rate * YEAR
    output = {"interval": 1e29}
    assert not rejection(scene(count, run={"duration": 0.999 * seconds}, output=output))
    message = rejection(scene(count, run={"duration": 1.001 * seconds}, output=output))
    assert f"With a particle count of {count} and" in message and "--allow-long" in message
    assert "the run would take at least 1 year. " in message
    assert not rejection(scene(count, run={"duration": 1.001 * seconds}, output=output), allow_long=True)


@pytest.mark.parametrize("output", [
    {"interval": 1e-12}, {"interval": 1e3, "timeseries_interval": 1e-12},
    {"interval": 1e3, "checkpoint": {"interval": 1e-12}},
])  # fmt: skip
def test_run_time_counts_at_most_one_write_per_step_and_output(output):
    """1e6 steps at 1e6 per second, with one write per step at 1e4 per second, take 101 s."""
    run_time = least_run_time(plan_for(scene(output=output)))
    assert run_time == pytest.approx(1e6 / 1e6 + 1e6 / 1e4 * (2 if output["interval"] < 1 else 1), rel=1e-3)


def test_skin_above_twenty_radii_is_rejected():
    plan_for(scene(numerics={"skin": 0.0999}))
    with pytest.raises(
        SceneError, match="numerics.skin is 0.101 m, more than 20 times the smallest radius 0.005 m"
    ):
        plan_for(scene(numerics={"skin": 0.101}))
