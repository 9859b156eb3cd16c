"""Runs that go wrong stop at once, say where and when, and leave the last state to look at."""

import re

import numpy as np
import pytest
from trials import balls, plane, trial

from granflow.errors import RunError
from granflow.simulation import Simulation

BAD = 2
"""Every scene here has spheres that are alright, and this one that is not (or the smaller of two)."""


def bystanders(*more):
    return {
        "good": balls([[0.3, 0.0, 0.0], [0.3, 0.1, 0.0]]),
        **{f"bad_{number}": group for number, group in enumerate(more)},
    }


SCENES = {
    "overlaps by more than": lambda: trial(
        bystanders(balls([[0.0, 0.0, 0.0]], velocity=[40.0, 0, 0]), balls([[0.012, 0.0, 0.0]])),
        run={"duration": 0.01, "velocity_max": 40.0},
    ),
    "moved farther than": lambda: trial(
        bystanders(balls([[0.0, 0.0, 0.0]], velocity=[500.0, 0, 0])),
        run={"duration": 0.01, "velocity_max": 1.0, "time_step": 5e-6}, numerics={"skin": 1e-3},
    ),
    "is not a number": lambda: trial(bystanders(balls([[0.0, 0.0, 0.0]])), run={"duration": 0.01}),
}  # fmt: skip


@pytest.mark.parametrize("reason", SCENES)
def test_guard_stops_the_run_names_particle_and_time_and_leaves_a_frame(taichi_f64, tmp_path, reason):
    simulation = Simulation(SCENES[reason](), out=tmp_path)
    if reason == "is not a number":
        simulation.engine.state.particles.velocity[BAD] = [float("nan")] * 3
    with pytest.raises(RunError) as stopped:
        simulation.run()
    message = str(stopped.value)
    assert reason in message
    assert f"particle {BAD} " in message
    time = float(re.search(r"at ([\d.e+-]+) s", message).group(1))
    assert time == pytest.approx(simulation.time, rel=1e-5)
    assert time < 0.001
    assert str(tmp_path) in message
    frames = sorted(tmp_path.rglob("*.vtu"))
    assert any("particles" in frame.name for frame in frames[-2:]), frames
    simulation.free()


def test_good_runs_trip_no_guard(taichi_f64):
    simulation = Simulation(trial(bystanders(balls([[0.0, 0.0, 0.0]], velocity=[1.0, 0, 0])), run={"duration": 0.01}))
    simulation.run()
    assert simulation.engine.trip is None
    assert np.isfinite(simulation.snapshot().particles["position"]).all()
    simulation.free()


def groups(*given):
    return {f"group_{number}": group for number, group in enumerate(given)}


def told(scene):
    """What a run says that trips a guard."""
    simulation = Simulation(scene)
    with pytest.raises(RunError) as stopped:
        simulation.run()
    simulation.free()
    return str(stopped.value)


def number_after(words, message):
    return float(message.partition(words)[2].split()[0].rstrip(".,:"))


BULLET = balls([[0.0, 0.0, 0.0]], velocity=[40.0, 0, 0])
TARGET = balls([[0.012, 0.0, 0.0]], material="steel")
MASS = 2500.0 * np.pi / 6 * 0.01**3
HERTZ = 4 / 3 * (1e8 / (2 * (1 - 0.25**2))) * np.sqrt(0.0025)
"""Stiffness [N/m^1.5] of two equal spheres of 10 mm of the trial's materials."""


def test_an_overlap_names_both_with_materials_and_speeds_and_what_they_do(taichi_f64):
    said = told(trial(groups(BULLET, TARGET), run={"duration": 0.01, "velocity_max": 40.0}))
    assert re.search(r"particle 0 \(glass, 39\.\d m/s\) .* with particle 1 \(steel, 0\.\d+ m/s\)", said)
    assert 0.1 < number_after("smaller radius: by", said) < 0.2
    assert 39.0 < number_after("approach at", said) < 40.0
    assert "raise young_modulus of glass and steel, or raise numerics.overlap_limit" in said


def test_an_overlap_in_the_first_step_is_an_impact_and_not_how_they_begin(taichi_f64):
    near = balls([[0.0105, 0.0, 0.0]], material="steel")
    given = {"run": {"duration": 0.01, "velocity_max": 40.0}, "numerics": {"overlap_limit": 1e-3, "skin": 5e-3}}
    said = told(trial(groups(balls([[0.0004995, 0.0, 0.0]], velocity=[40.0, 0, 0]), near), **given))
    assert "They approach at" in said and "They begin so" not in said
    overlapping = told(trial(groups(balls([[0.00052, 0.0, 0.0]], velocity=[40.0, 0, 0]), near), **given))
    assert "They begin so" in overlapping


def test_an_impact_faster_than_planned_says_what_to_plan_for(taichi_f64):
    scene = trial(groups(BULLET, TARGET), run={"duration": 0.01, "velocity_max": 1.0}, numerics={"skin": 5e-3})
    said = told(scene)
    assert "but 1 m/s is planned for" in said
    assert 40.0 <= number_after("set run.velocity_max to", said) < 60.0


def test_a_step_above_the_stable_one_of_the_pair_is_found_out(taichi_f64):
    """Stable: 2 sqrt(M/K), where the leapfrog of two bodies ends, on the tangent at the largest overlap d at 40 m/s:

    K = 1.5 k sqrt(d), d = (5 M v^2 / (4 k))^0.4. It goes with v^-0.2, and half a step of this size changes v by 12 %.
    """
    step, target = 1.2e-4, balls([[0.0142, 0.0, 0.0]], material="steel")
    numerics, run = {"skin": 5e-3}, {"duration": 0.01, "velocity_max": 1.0, "time_step": step}
    said = told(trial(groups(BULLET, target), numerics=numerics, run=run))
    mass_eff = MASS / 2
    largest = (5 * mass_eff * 40.0**2 / (4 * HERTZ)) ** 0.4
    stable = 2 * np.sqrt(mass_eff / (1.5 * HERTZ * np.sqrt(largest)))
    assert number_after("time step", said) == step
    assert number_after("above the stable", said) == pytest.approx(stable, rel=0.2 * 0.12)
    assert "lower run.time_step" in said


def test_spheres_that_begin_in_each_other_are_said_to(taichi_f64):
    said = told(trial(groups(balls([[0.0, 0, 0], [0.006, 0, 0]])), run={"duration": 0.01}))
    assert "particle 0 (glass, at rest) at 0 s" in said
    assert number_after("smaller radius: by", said) == pytest.approx(0.004 / 0.005, rel=1e-3)
    assert "They begin so: move them apart" in said


@pytest.mark.parametrize("moves", [False, True])
def test_a_wall_is_named_with_its_velocity(taichi_f64, moves):
    motion = {"motion": {"kind": "translation", "velocity": [0, 0, 50.0]}} if moves else {}
    ball = balls([[0.0, 0.0, 0.007]], velocity=[0.0, 0.0, 0.0 if moves else -50.0])
    said = told(
        trial(
            groups(ball), walls={"piston": plane([0, 0, 0], [0, 0, 1], "steel") | motion},
            run={"duration": 0.01, "velocity_max": 1.0}, numerics={"skin": 5e-3},
        )
    )  # fmt: skip
    assert f"with wall piston (steel, {'50 m/s' if moves else 'at rest'})" in said
    assert 0.1 < number_after("smaller radius: by", said) < 0.2
    assert 48.0 < number_after("approach at", said) < 50.1


def test_a_sphere_shot_out_of_an_overlap_names_whom_it_left(taichi_f64):
    """The first step from rest under F = k d^1.5 goes F dt^2 / (2 m)."""
    step, overlap = 5e-5, 0.004
    said = told(
        trial(
            groups(balls([[0.0, 0, 0], [0.006, 0, 0]])), numerics={"overlap_limit": 1.0, "skin": 5e-4},
            run={"duration": 0.01, "velocity_max": 20.0, "time_step": step},
        )
    )  # fmt: skip
    assert "particle 0 (glass, " in said
    assert "and particle 1 (glass, " in said
    assert number_after("overlapped by", said) == pytest.approx(overlap / 0.005, rel=1e-3)
    assert number_after("in one step:", said) == pytest.approx(HERTZ * overlap**1.5 * step**2 / (2 * MASS), rel=1e-2)


def test_a_sphere_that_leaves_says_where_it_is(taichi_f64):
    domain = {"min": [-0.01] * 3, "max": [0.01] * 3, "leaving": "error"}
    fast = balls([[0.0, 0, 0]], velocity=[3.0, 0, 0])
    said = told(trial(groups(balls([[0, 0.008, 0]], 0.001), fast), domain=domain, run={"duration": 0.1}))
    assert re.search(r"particle 1 at 0\.003\d+ s is outside the domain", said)
    assert re.search(r"it is at \[0\.01\d+, 0, 0\] m \(glass, 3 m/s\)", said)
