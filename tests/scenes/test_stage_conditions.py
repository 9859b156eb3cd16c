"""Stages that end on a quantity, at the first row of the time series that satisfies a condition."""

import logging

import numpy as np
import pytest
from resume.runs import files_of, resume_copy, run_to_end, states_of
from scene_builders import SOFT, build_scene, particle_group, plane

from granflow.contact import theory
from granflow.errors import GranflowError
from granflow.observers.timeseries import Row
from granflow.runs.stages import StageConditions
from granflow.simulation import Simulation

RADIUS, GRAVITY = 0.005, 9.81
MASS = 4.0 / 3.0 * np.pi * RADIUS**3 * 2500.0
STIFFNESS = theory.hertz_stiffness(SOFT["young_modulus"] / (2 * (1 - SOFT["poisson_ratio"] ** 2)), RADIUS)
SPEED, SIDE, ROW = 1e-3, 0.02, 1e-4


def press(until, **parts):
    """A sphere without gravity on a floor; a lid that touches it approaches at SPEED until the stage ends."""
    lid = {
        "shape": "rectangle", "corner": [-SIDE / 2, -SIDE / 2, 2 * RADIUS], "sides": [[SIDE, 0, 0], [0, SIDE, 0]],
        "material": "glass", "motion": {"kind": "translation", "velocity": [0, 0, -SPEED], "stages": ["press"]},
    }  # fmt: skip
    stages = [{"name": "press", "until": until, "max_duration": 0.05}, {"name": "hold", "duration": 1e-3}]
    defaults = {
        "walls": {"floor": plane([0, 0, 0], [0, 0, 1]), "lid": lid}, "normal": "hertz", "pair": {"restitution": 1.0},
        "run": {"velocity_max": 0.1}, "stages": stages,
        "output": {"interval": 1.0, "timeseries_interval": ROW, "wall_forces": True},
    }  # fmt: skip
    return build_scene({"ball": particle_group([0, 0, RADIUS])}, **(defaults | parts))


def stage_ends(scene, **options):
    """Start and end [s] of the stages, and the result."""
    simulation = Simulation(scene, **options)
    result = simulation.run()
    times = dict(simulation._state.progress.stage_times)
    simulation.free()
    return times, result


def time_of_force(force):
    """Time [s] at which the slowly approaching lid reaches a force F = k (d/2)^1.5 on two equal contacts in
    series."""
    return 2.0 * (force / STIFFNESS) ** (2 / 3) / SPEED


def test_the_hold_of_a_condition_begins_again_after_a_row_without_it():
    """Met from 1 to 2 ms, not at 3 ms, met from 4 ms: a hold of 2 ms ends at 6 ms, not at 4 ms."""
    until = {"quantity": "wall_force_z.lid", "above": 1.0, "hold": 2e-3}
    scene = press(until)
    stage, conditions = scene.stages[0], StageConditions()
    conditions.begin(stage, 0.0)
    ended = []
    for k, force in enumerate([0.0, 2.0, 2.0, 0.5, 2.0, 2.0, 2.0]):
        row = Row(time=k * 1e-3, time_before=max(k - 1, 0) * 1e-3, numbers={"wall_force_z.lid": force})
        conditions.add_row(scene, stage, 0.0, row)
        ended.append(conditions.met is not None)
    assert ended == [False] * 6 + [True]


def test_a_stage_ends_at_a_force(taichi_f64):
    """At the first row whose mean force since the previous row is above the target: within two rows of the
    theory.

    The sphere oscillates between both contacts; the force then deviates by less than 2 % from that of slow
    compression.
    """
    target = 0.5
    (start, end), (next_start, _) = stage_ends(press({"quantity": "wall_force_z.lid", "above": target}))[
        0
    ].values()
    assert (start, next_start) == (0.0, end)
    assert time_of_force(0.98 * target) <= end <= time_of_force(1.02 * target) + 2 * ROW


def test_a_pressure_is_read_with_its_unit_and_any_condition_ends_the_stage(taichi_f64):
    force = 0.5
    never = {"quantity": "kinetic_energy", "above": "1 J"}
    pressure = {"quantity": "wall_pressure.lid", "above": f"{force / SIDE**2 / 1000} kPa"}
    times, result = stage_ends(press([never, pressure]))
    assert times["press"][1] == pytest.approx(time_of_force(force), abs=3 * ROW)
    assert result.wall_forces["lid"]["wall_pressure"] == pytest.approx(force / SIDE**2, rel=0.05)


def test_the_count_of_all_inserted_particles_ends_a_stage(taichi_f64):
    times, _ = stage_ends(press({"quantity": "inserted_count", "above": 0}))
    assert ROW <= times["press"][1] < 1.5 * ROW


def test_the_count_of_one_inserted_group_ends_a_stage(taichi_f64):
    """Particles of a rain of 2000 per second are due at 0, 0.5, 1, ... ms: the fourth at 1.5 ms."""
    region = {"box": {"min": [0.05, 0, 0], "max": [0.15, 0.1, 0.1]}}
    rain = {"kind": "rain", "rate": 2000.0, "region": region}
    groups = {
        "ball": particle_group([0, 0, RADIUS]),
        "feed": {"material": "glass", "count": 20, "diameter": 0.004, "insert": rain},
    }
    stages = [
        {"name": "fill", "until": {"quantity": "inserted_count.feed", "above": 3}, "max_duration": 0.05}
    ]
    scene = build_scene(
        groups, run={"velocity_max": 0.1}, stages=stages, output={"interval": 1.0, "timeseries_interval": ROW}
    )
    times, result = stage_ends(scene)
    assert times["fill"][1] == pytest.approx(1.5e-3, abs=1.5 * ROW)
    assert result.totals["inserted_count.feed"] == result.insertion["feed"]["inserted_count"] == 4.0


def test_a_condition_must_hold_and_wait_for_the_shortest_duration(taichi_f64):
    """The force is below 1 N from the start: the stage ends after min_duration plus hold."""
    until = {"quantity": "wall_force_z.lid", "below": 1.0, "hold": 5 * ROW}
    stages = [{"name": "press", "until": until, "max_duration": 0.05, "min_duration": 2e-3}]
    times, _ = stage_ends(press(until, stages=stages))
    assert times["press"][1] == pytest.approx(2e-3 + 5 * ROW, abs=0.1 * ROW)


def test_a_condition_that_is_not_satisfied_is_reported(taichi_f64, caplog):
    stages = [
        {"name": "press", "until": {"quantity": "wall_force_z.lid", "above": 9.0}, "max_duration": 2e-3}
    ]
    with caplog.at_level(logging.WARNING, logger="granflow"):
        times, result = stage_ends(press({}, stages=stages))
    assert times["press"][1] == pytest.approx(2e-3, abs=1e-5)
    (warning,) = [sentence for sentence in result.warnings if "press" in sentence]
    assert "its longest duration of 0.002 s is over, but wall_force_z.lid is" in warning
    assert warning.endswith("N, not above 9 N.")


def test_a_stage_ends_when_particles_have_left(taichi_f64):
    """Spheres fall through the bottom of the domain at sqrt(2 h / g): the stage ends with the third of
    four."""
    heights = np.array([0.02, 0.04, 0.06, 0.2])
    positions = [[0.03 * k, 0.0, height] for k, height in enumerate(heights)]
    stages = [
        {"name": "discharge", "until": {"quantity": "deleted_mass", "above": 2.5 * MASS}, "max_duration": 1.0}
    ]
    scene = build_scene(
        {"balls": particle_group(positions)}, gravity=[0, 0, -GRAVITY], stages=stages, run={"velocity_max": 1.0},
        domain={"min": [-0.1, -0.1, 0.0], "max": [0.2, 0.1, 0.3], "on_exit": "delete"},
        output={"interval": 1.0, "timeseries_interval": 1e-3},
    )  # fmt: skip
    end = stage_ends(scene)[0]["discharge"][1]
    fall = np.sqrt(2 * heights / GRAVITY)
    assert fall[2] <= end < fall[2] + 0.03  # particles are deleted at the next rebuild of the neighbor list
    assert end < fall[3]


def test_a_column_that_the_run_lacks_is_named(taichi_f64):
    with pytest.raises(
        GranflowError, match=r"stages.press.until: there is no column queued_count; the columns are"
    ):
        stage_ends(press({"quantity": "queued_count", "above": 1}))


@pytest.mark.slow
def test_restart_within_a_held_condition_is_bit_identical(tmp_path, taichi_f64):
    output = {
        "interval": 5e-4, "timeseries_interval": ROW, "wall_forces": True, "checkpoint": {"interval": 3e-4, "keep": 100}
    }  # fmt: skip
    until = {"quantity": "wall_force_z.lid", "above": 0.2, "hold": 9 * ROW}
    scene = press(until, output=output)
    checkpoints = run_to_end(scene, tmp_path / "whole")
    held = [path for path in checkpoints if _is_held(path)]
    assert held, "a checkpoint lies within the time during which the condition holds"
    resume_copy(scene, tmp_path / "whole", tmp_path / "parts", held[0])
    assert files_of(tmp_path / "parts") == files_of(tmp_path / "whole")
    assert states_of(tmp_path / "parts") == states_of(tmp_path / "whole")


def _is_held(path):
    from granflow.io.checkpoint import read_checkpoint

    conditions = read_checkpoint(path).saved["stage_progress"]["conditions"]
    return conditions["met"] is None and bool(conditions["since"]) and conditions["since"][0] < np.inf
