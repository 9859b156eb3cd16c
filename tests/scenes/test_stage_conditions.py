"""Stages that end on a quantity, at the first row of the time series that satisfies a condition, or at rest."""

import numpy as np
import pytest
from resume.runs import files_of, resume_copy, run_to_end, states_of
from scene_builders import SOFT, build_scene, particle_group, plane

from granflow.contact import theory
from granflow.errors import GranflowError
from granflow.io.checkpoint import read_checkpoint
from granflow.observers.timeseries import Row
from granflow.runs.stages import REST_CHECKS, StageConditions
from granflow.simulation import Simulation

RADIUS, GRAVITY = 0.005, 9.81
MASS = 4.0 / 3.0 * np.pi * RADIUS**3 * 2500.0
STIFFNESS = theory.hertz_stiffness(SOFT["young_modulus"] / (2 * (1 - SOFT["poisson_ratio"] ** 2)), RADIUS)
SPEED, SIDE, ROW = 1e-3, 0.02, 1e-4
ROWS = {"interval": 1.0, "timeseries_interval": ROW, "wall_forces": True}


def press(until, output=ROWS, **stage):
    """A sphere without gravity on a floor; a lid that touches it approaches at SPEED until the stage ends."""
    lid = {
        "shape": "rectangle", "corner": [-SIDE / 2, -SIDE / 2, 2 * RADIUS], "sides": [[SIDE, 0, 0], [0, SIDE, 0]],
        "material": "glass", "motion": {"kind": "translation", "velocity": [0, 0, -SPEED], "stages": ["press"]},
    }  # fmt: skip
    stages = [
        {"name": "press", "until": until, "max_duration": 0.05} | stage,
        {"name": "hold", "duration": 1e-3},
    ]
    return build_scene(
        {"ball": particle_group([0, 0, RADIUS])}, {"floor": plane([0, 0, 0], [0, 0, 1]), "lid": lid},
        {"restitution": 1.0}, normal="hertz", run={"velocity_max": 0.1}, stages=stages, output=output,
    )  # fmt: skip


def first_stage(scene):
    """End [s] of the first stage, the height [m] of the first particle at the end of the run, and the result."""
    simulation = Simulation(scene)
    result = simulation.run()
    _, end = next(iter(simulation._state.progress.stage_times.values()))
    height = simulation.particles.position[0, 2]
    simulation.free()
    return end, height, result


def test_the_hold_of_a_condition_begins_again_after_a_row_without_it():
    """Met from 1 to 2 ms, not at 3 ms, met from 4 ms: a hold of 2 ms ends at 6 ms, not at 4 ms. Rows are late by up to
    one time step, so that the last two are 1.9 ms apart."""
    time_step = 1e-4
    scene = press({"quantity": "wall_force_z.lid", "above": 1.0, "hold": 2e-3})
    stage, conditions = scene.stages[0], StageConditions()
    conditions.begin(stage, 0.0)
    ended = []
    for k, force in enumerate([0.0, 2.0, 2.0, 0.5, 2.0, 2.0, 2.0]):
        late = 0.9 * time_step if k == 4 else 0.0
        row = Row(time=k * 1e-3 + late, time_before=max(k - 1, 0) * 1e-3, numbers={"wall_force_z.lid": force})
        conditions.add_row(scene, stage, 0.0, row, time_step)
        ended.append(conditions.met is not None)
    assert ended == [False] * 6 + [True]


def test_a_pressure_is_read_with_its_unit_and_any_condition_ends_the_stage(taichi_f64):
    """A slowly approaching lid reaches a force F = k (d/2)^1.5 on two equal contacts in series. The sphere oscillates
    between both contacts; the force then deviates by less than 2 % from that of slow compression."""
    force = 0.5
    never = {"quantity": "kinetic_energy", "above": "1 J"}
    pressure = {"quantity": "wall_pressure.lid", "above": f"{force / SIDE**2 / 1000} kPa"}
    end, _, result = first_stage(press([never, pressure]))
    low, high = (2.0 * (share * force / STIFFNESS) ** (2 / 3) / SPEED for share in (0.98, 1.02))
    assert low <= end <= high + 2 * ROW
    assert result.wall_forces["lid"]["wall_pressure"] == pytest.approx(force / SIDE**2, rel=0.05)


def test_a_condition_must_hold_and_wait_for_the_shortest_duration(taichi_f64):
    """The force is below 1 N from the start: the stage ends after min_duration plus hold."""
    until = {"quantity": "wall_force_z.lid", "below": 1.0, "hold": 5 * ROW}
    end, _, _ = first_stage(press(until, min_duration=2e-3))
    assert end == pytest.approx(2e-3 + 5 * ROW, abs=0.1 * ROW)


def test_a_condition_that_is_not_satisfied_is_reported(taichi_f64):
    end, _, result = first_stage(press({"quantity": "wall_force_z.lid", "above": 9.0}, max_duration=2e-3))
    assert end == pytest.approx(2e-3, abs=1e-5)
    assert (
        sum("longest duration of 0.002 s is over, but wall_force_z.lid" in each for each in result.warnings)
        == 1
    )
    with pytest.raises(GranflowError, match="there is no column queued_count"):
        first_stage(press({"quantity": "queued_count", "above": 1}))


@pytest.mark.slow
def test_restart_within_a_held_condition_is_bit_identical(tmp_path, taichi_f64):
    output = ROWS | {"interval": 5e-4, "checkpoint": {"interval": 3e-4, "keep": 100}}
    scene = press({"quantity": "wall_force_z.lid", "above": 0.2, "hold": 9 * ROW}, output)
    held = []
    for path in run_to_end(scene, tmp_path / "whole"):
        conditions = read_checkpoint(path).saved["stage_progress"]["conditions"]
        if conditions["met"] is None and bool(conditions["since"]) and conditions["since"][0] < np.inf:
            held.append(path)
    assert held, "a checkpoint lies within the time during which the condition holds"
    resume_copy(scene, tmp_path / "whole", tmp_path / "parts", held[0])
    assert files_of(tmp_path / "parts") == files_of(tmp_path / "whole")
    assert states_of(tmp_path / "parts") == states_of(tmp_path / "whole")


HEIGHT, LONGEST = 0.01, 0.4
FALL_TIME = np.sqrt(2.0 * HEIGHT / GRAVITY)
LIFT = MASS * GRAVITY * RADIUS
"""Energy [J] that lifts a sphere by its radius."""


@pytest.mark.parametrize(
    ("gap", "energy", "gravity", "stage", "low", "high"),
    [
        # The energy is below the limit during the whole fall: only the missing support continues the stage.
        (HEIGHT, 4.0 * LIFT, GRAVITY, {}, FALL_TIME, LONGEST),
        # Also the tops of bounces, where the velocity is zero, are in free fall.
        (HEIGHT, 1e-3 * LIFT, GRAVITY, {}, FALL_TIME, LONGEST),
        (0.0, 1e-2 * LIFT, GRAVITY, {}, 0.0, FALL_TIME),
        # Checks are LONGEST / REST_CHECKS apart.
        (0.0, 1e-2 * LIFT, GRAVITY, {"min_duration": 0.1}, 0.1, 0.1 + 1.1 * LONGEST / REST_CHECKS),
        (HEIGHT, 4.0 * LIFT, GRAVITY, {"max_duration": 0.5 * FALL_TIME}, 0.0, FALL_TIME),
        # Without gravity the energy decides.
        (HEIGHT, 1e-9 * LIFT, 0.0, {}, 0.0, 1.05 * LONGEST / REST_CHECKS),
    ],
)
def test_a_stage_ends_at_rest(taichi_f64, gap, energy, gravity, stage, low, high):
    """A sphere that starts at rest with a gap [m] above a floor; the stage ends below an energy [J], of particles whose
    weight is supported."""
    stage = {"name": "settle", "kinetic_energy_below": energy, "max_duration": LONGEST} | stage
    scene = build_scene(
        {"ball": particle_group([0, 0, RADIUS + gap])}, {"floor": plane([0, 0, 0], [0, 0, 1])}, {"restitution": 0.3},
        normal="hertz", gravity=[0, 0, -gravity], stages=[stage], run={"velocity_max": 1.0},
        output={"interval": 0.01, "energy_budget": True},
    )  # fmt: skip
    end, height, result = first_stage(scene)
    assert low < end < high
    assert not result.warnings or "the net force on the particles is 1 of their weight" in result.warnings[0]
    assert bool(result.warnings) == (stage["max_duration"] < LONGEST)
    if energy == 1e-3 * LIFT:
        assert height == pytest.approx(RADIUS, rel=0.01)
