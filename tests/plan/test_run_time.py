"""Runs without a step, without an end or with a clock that stands still are refused before they start."""

import pytest
from scene_builders import build_scene, particle_group

from granflow.errors import SceneError
from granflow.plan import plan_for
from granflow.plan.run_time import YEAR, least_run_time, refuse_run_time

STEP = 1e-6


def scene(count=1, **parts):
    positions = [[0.02 * k, 0.0, 0.0] for k in range(count)]
    run = {"duration": 1.0, "time_step": STEP} | parts.pop("run", {})
    return build_scene({"balls": particle_group(positions)}, run=run, **parts)


def refusal(scene, allow_long=False):
    """The message, or none."""
    try:
        refuse_run_time(plan_for(scene), allow_long)
    except SceneError as error:
        return str(error)
    return ""


def test_a_duration_below_one_step_is_refused():
    assert not refusal(scene(run={"duration": STEP}))
    message = refusal(scene(run={"duration": 0.99 * STEP}))
    assert "run.duration is 9.9e-07 s, shorter than one time step of 1e-06 s (given in the scene)" in message


def test_a_stage_below_one_step_is_refused():
    stages = [
        {"name": "fill", "duration": 1.0},
        {"name": "rest", "kinetic_energy_below": 1e-9, "max_duration": 0.5 * STEP},
    ]
    message = refusal(scene(run={"duration": None}, stages=stages))
    assert "stages.1.max_duration is 5e-07 s, shorter than one time step" in message


def test_a_density_so_large_that_no_step_fits_is_refused():
    """Contacts would allow 1e4 s; 0.2 of the radius of 5 mm at 1 m/s takes 1 ms."""
    heavy = {"glass": {"young_modulus": 1e8, "poisson_ratio": 0.25, "density": 1e30}}
    run = {"time_step": "auto", "duration": 5e-4}
    assert "shorter than one time step of 0.001 s (0.2 of the smallest radius" in refusal(
        scene(run=run, materials=heavy)
    )


def test_steps_that_do_not_advance_the_clock_are_refused_always():
    """A clock at T has a spacing of T 2^-53 to T 2^-52."""
    for allow_long in (False, True):
        assert "that time in f64 resolves" in refusal(scene(run={"time_step": 0.99 * 2.0**-52}), allow_long)
        assert "that time in f64 resolves" in refusal(scene(run={"time_step": 1e-30}), allow_long)
    assert not refusal(scene(run={"time_step": 1.01 * 2.0**-52}), allow_long=True)


@pytest.mark.parametrize(("count", "rate"), [(1, 1e6), (1000, 1e6), (5000, 1e9 / 5000)])
def test_a_run_of_more_than_a_year_is_refused_and_a_flag_lifts_it(count, rate):
    """At 1e6 steps per second or 1e9 particle-steps per second, whichever is slower."""
    seconds = STEP * rate * YEAR
    output = {"interval": 1e29}
    assert not refusal(scene(count, run={"duration": 0.999 * seconds}, output=output))
    message = refusal(scene(count, run={"duration": 1.001 * seconds}, output=output))
    assert f"for {count} particles: 1 years of wall-clock time at least" in message and "--allow-long" in message
    assert not refusal(scene(count, run={"duration": 1.001 * seconds}, output=output), allow_long=True)


def test_a_duration_of_1e30_seconds_is_refused():
    assert refusal(scene(run={"duration": 1e30}))


@pytest.mark.parametrize("output", [
    {"interval": 1e-12}, {"interval": 1e3, "timeseries_interval": 1e-12},
    {"interval": 1e3, "checkpoint": {"interval": 1e-12}},
])  # fmt: skip
def test_frames_rows_and_checkpoints_count_at_most_one_in_a_step(output):
    """1e6 steps with a write in each, at most 1e4 of them per second: 101 s."""
    least = least_run_time(plan_for(scene(output=output)))
    assert least == pytest.approx(1e6 / 1e6 + 1e6 / 1e4 * (2 if output["interval"] < 1 else 1), rel=1e-3)


@pytest.mark.parametrize("changes", [
    {"gravity": [0.0, 0.0, 1e30]},
    {"materials": {"glass": {"young_modulus": 1e8, "poisson_ratio": 0.25, "density": 1e-30}}},
    {"materials": {"glass": {"young_modulus": 1e30, "poisson_ratio": 0.25, "density": 2500.0}}},
])  # fmt: skip
def test_extremes_that_make_the_step_tiny_are_refused(changes):
    assert "steps" in refusal(scene(run={"time_step": "auto"}, **changes))


def test_chunks_larger_than_a_million_are_refused():
    scene(numerics={"chunk_size": 1_000_000})
    with pytest.raises(ValueError, match=r"a chunk size must be in \[1, 1e\+06\]"):
        scene(numerics={"chunk_size": 1_000_001})


def test_an_unloading_angle_beyond_its_own_stability_is_refused():
    scene(numerics={"unloading_angle": 0.9})
    with pytest.raises(ValueError, match=r"an angle must be above 0 and at most 0.9"):
        scene(numerics={"unloading_angle": 0.91})


def test_a_skin_of_more_than_twenty_radii_is_refused():
    plan_for(scene(numerics={"skin": 0.0999}))
    with pytest.raises(SceneError, match="numerics.skin is 0.101 m, more than 20 times the smallest radius 0.005 m"):
        plan_for(scene(numerics={"skin": 0.101}))
