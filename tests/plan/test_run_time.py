"""Runs that are too short or too long, or whose step or precision does not resolve times or positions."""

import pytest
from scene_builders import build_scene, particle_group

from granflow.errors import SceneError
from granflow.plan.build import plan_for
from granflow.plan.cost import YEAR, least_run_time, refuse_run_time

STEP = 1e-6
RESOLUTION = 2.0**-52
"""Spacing of floating-point numbers at the end of a run of 1 s."""
REST = {"name": "rest", "kinetic_energy_below": 1e-9, "max_duration": 0.5 * STEP}


def scene(count=1, **parts):
    positions = [[0.02 * k, 0.0, 0.0] for k in range(count)]
    run = {"duration": 1.0, "time_step": STEP} | parts.pop("run", {})
    return build_scene({"balls": particle_group(positions)}, run=run, **parts)


@pytest.mark.parametrize(("parts", "allow_long", "message"), [
    ({"run": {"duration": STEP}}, False, None),
    ({"run": {"duration": 0.99 * STEP}}, False, "run.duration is 9.9e-07 s, shorter than one time step of 1e-06"),
    ({"run": {"duration": None}, "stages": [{"name": "fill", "duration": 1.0}, REST]}, False,
     "stages.1.max_duration is 5e-07 s, shorter than one time step"),
    ({"run": {"time_step": 1.01 * RESOLUTION}}, True, None),
    ({"run": {"time_step": 0.99 * RESOLUTION}}, True, "that time in f64 resolves"),
])  # fmt: skip
def test_run_or_stage_without_a_step_that_advances_is_rejected(parts, allow_long, message):
    plan = plan_for(scene(**parts))
    if message is None:
        return refuse_run_time(plan, allow_long)
    with pytest.raises(SceneError, match=message):
        refuse_run_time(plan, allow_long)


@pytest.mark.parametrize(("count", "rate"), [(1, 1e6), (5000, 1e9 / 5000)])
def test_run_of_more_than_a_year_is_rejected_without_allow_long(count, rate):
    """At 1e6 steps per second or 1e9 particle-steps per second, whichever is slower."""
    shorter, longer = (
        plan_for(scene(count, run={"duration": share * STEP * rate * YEAR}, output={"interval": 1e29}))
        for share in (0.999, 1.001)
    )
    refuse_run_time(shorter, False)
    refuse_run_time(longer, True)
    with pytest.raises(SceneError, match="the run would take at least 1 year. .*--allow-long"):
        refuse_run_time(longer, False)


@pytest.mark.parametrize(("output", "writes"), [
    ({"interval": 1e-12}, 2), ({"interval": 1e3, "checkpoint": {"interval": 1e-12}}, 1),
])  # fmt: skip
def test_run_time_counts_at_most_one_write_per_step_and_output(output, writes):
    """1e6 steps at 1e6 per second, and one write per step at 1e4 per second: frames and time series, or
    checkpoints."""
    assert least_run_time(plan_for(scene(output=output))) == pytest.approx(1.0 + 100.0 * writes, rel=1e-3)


def test_skin_above_twenty_radii_is_rejected():
    plan_for(scene(numerics={"skin": 0.0999}))
    with pytest.raises(SceneError, match="skin is 0.101 m, more than 20 times the smallest radius 0.005 m"):
        plan_for(scene(numerics={"skin": 0.101}))


def planned(edge, precision, on_exit="error", **run):
    domain = {"min": [0.0] * 3, "max": [0.1, 0.1, edge], "on_exit": on_exit}
    run = {"duration": 0.1, "precision": precision} | run
    return plan_for(build_scene({"ball": particle_group([[0.05] * 3])}, domain=domain, run=run))


@pytest.mark.parametrize(("precision", "edge", "on_exit", "advice"), [
    ("f32", 2.0**13, "error", "Use --precision mixed"), ("f32", 2.0**13, "expand", "Use --precision mixed"),
    ("mixed", 2.0**42, "error", "Move the scene closer"),
])  # fmt: skip
def test_spacing_above_a_tenth_of_the_smallest_radius_is_rejected(precision, edge, on_exit, advice):
    """The radius is 5 mm. The spacing is 2^(12 - 23) = 2^(41 - 52) = 0.49 mm up to the edge [m], and 0.98 mm
    beyond."""
    planned(edge, precision, on_exit)
    with pytest.raises(SceneError, match=f"resolves positions only to 0.000977 m .*{advice}"):
        planned(1.001 * edge, precision, on_exit)


def test_motion_that_f32_does_not_resolve_in_one_step_is_reported():
    """The spacing is 2^-23 m from 1 m up to 2 m, not included: in 1 us, particles below 2^-24 m / 1 us = 0.06 m/s
    stand still."""
    steps = {"velocity_max": 5.0, "time_step": 1e-6}
    (warning,) = (each for each in planned(1.99, "f32", **steps).warnings if "do not move" in each)
    assert "slower than 0.06 m/s do not move there" in warning
    fast = planned(1.99, "f32", **steps | {"velocity_max": 7.0})
    assert not any("do not move" in each for each in fast.warnings)
    assert not any("do not move" in each for each in planned(1.99, "mixed", **steps).warnings)
