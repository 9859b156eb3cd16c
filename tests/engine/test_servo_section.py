"""Servo walls: pressures on the present section between other walls, and warnings off the target."""

import json
import shutil

import numpy as np
import pytest
from engine.test_wall_dynamics import balls_below, lid
from scene_builders import SOFT, build_scene, particle_group, plane

from granflow.errors import GranflowError, SceneError
from granflow.io.checkpoint import read_checkpoint
from granflow.load import Scene
from granflow.plan.build import plan_for
from granflow.plan.wall_changes import with_motions, without_wall
from granflow.runs.stages import off_target
from granflow.simulation import Simulation

DIAMETER, GAP = 0.01, 0.002
PRESSURES = np.array([2e3, 3e3, 4e3])
FACES = {"x": ("y", "z"), "y": ("z", "x"), "z": ("x", "y")}


def servo_box():
    """A sphere between six planes: three at rest touch it, three servos start at a distance of 2 mm."""
    walls = {}
    for k, axis in enumerate("xyz"):
        unit = np.eye(3)[k]
        names = [f"{side}_{other}" for other in FACES[axis] for side in ("low", "high")]
        servo = {
            "kind": "servo", "direction": (-unit).tolist(), "pressure": PRESSURES[k], "velocity_max": 0.5,
            "between": names,
        }  # fmt: skip
        walls[f"low_{axis}"] = plane([0, 0, 0], unit.tolist())
        walls[f"high_{axis}"] = plane(((DIAMETER + GAP) * unit).tolist(), (-unit).tolist(), motion=servo)
    return build_scene(
        {"ball": particle_group([[DIAMETER / 2] * 3], DIAMETER)}, walls, normal="hertz", pair={"restitution": 0.5},
        run={"duration": 0.06, "velocity_max": 0.5}, output={"interval": 1.0},
    )  # fmt: skip


STIFFNESS = 4 / 3 * SOFT["young_modulus"] / (2 * (1 - SOFT["poisson_ratio"] ** 2)) * np.sqrt(DIAMETER / 2)
"""Of a contact with a wall: F = 4/3 E* sqrt(R) overlap^1.5, E* = E / (2 (1 - nu^2)) (Hertz)."""


def test_force_is_the_pressure_on_the_present_section(taichi_f64):
    """F_x = P_x L_y L_z with the present distances L = D - 2 overlap. The section of the start is larger by 44 %."""
    overlap = np.zeros(3)
    for _ in range(50):
        length = DIAMETER - 2.0 * overlap
        overlap = (PRESSURES * length.prod() / length / STIFFNESS) ** (2 / 3)
    with Simulation(servo_box()) as simulation:
        forces = [each.force for each in simulation.plan.controlled_motions]
        assert forces == pytest.approx(PRESSURES * (DIAMETER + GAP) ** 2)
        simulation.run(until=0.001)
        warned = list(off_target(simulation.engine, "run", []))
        result = simulation.run()
        last = simulation.snapshot()
    moved = np.array([last.totals[f"wall_displacement.high_{axis}"] for axis in "xyz"])
    np.testing.assert_allclose(moved, GAP + 2.0 * overlap, rtol=1e-9)
    np.testing.assert_allclose(last.particles["position"][0], DIAMETER / 2 - overlap, rtol=1e-9)
    assert not [each for each in result.warnings if "off its target" in each]
    for axis, sentence, pressure in zip("xyz", warned, PRESSURES, strict=True):
        assert f"walls.high_{axis}.motion" in sentence and "0 N (0 Pa) instead of" in sentence
        assert f"({pressure:.3g} Pa)" in sentence


def changed(change):
    """The scene after a change of its dictionary."""
    given = servo_box().to_dict()
    change(given, given["walls"])
    return Scene.from_dict(given)


@pytest.mark.parametrize(
    ("between", "message"),
    [
        (["low_x", "high_y", "low_z", "high_z"], "has low_x and high_y as a pair, which are not opposite"),
        (["low_x", "high_x", "low_z", "high_z"], "has walls that are not perpendicular to each other and"),
        (["low_y", "high_y"], "has two walls, but no periodic axis across them; give four walls"),
    ],
)
def test_walls_that_enclose_no_section_are_refused(between, message):
    def change(given, walls):
        walls["high_x"]["motion"][0]["between"] = between

    with pytest.raises(SceneError, match=rf"walls\.high_x\.motion\.between {message}"):
        plan_for(changed(change))


def test_direction_away_from_the_particles_is_reported():
    def change(given, walls):
        walls["high_x"]["motion"][0]["direction"] = [1.0, 0.0, 0.0]

    warnings = [each.warning for each in plan_for(changed(change)).forecasts if each.warning]
    (sentence,) = [each for each in warnings if "away from the particles" in each]
    assert sentence.startswith("walls.high_x.motion") and sentence.endswith("[-1, 0, 0].")


def test_a_program_cannot_remove_or_move_walls_around_a_section():
    plan = plan_for(servo_box())
    message = r"walls\['low_x'\] cannot be .*: it bounds the section of walls\.high_y"
    with pytest.raises(GranflowError, match=message):
        without_wall(plan, "low_x", 0.0)
    with pytest.raises(GranflowError, match=message):
        with_motions(plan, "low_x", [], 0.0, [])


def test_two_walls_enclose_a_section_with_a_periodic_axis():
    """F = P L W with the width W of the box along the periodic axis; a plane needs no area of its own."""

    def change(given, walls):
        given["domain"] |= {"min": [-1.0, -1.0, 0.0], "max": [1.0, 1.0, 0.04], "periodic": ["z"]}
        del walls["low_z"], walls["high_z"]
        walls["high_x"]["motion"][0]["between"] = ["low_y", "high_y"]
        walls["high_y"]["motion"][0]["between"] = ["high_x", "low_x"]

    forces = [each.force for each in plan_for(changed(change)).controlled_motions]
    assert forces == pytest.approx(PRESSURES[:2] * (DIAMETER + GAP) * 0.04)


def test_default_gain_is_that_of_a_wall_of_the_size_of_the_section():
    """27 spheres: more than the closest layer on the section, fewer than on the domain."""
    side = DIAMETER + GAP

    def between(given, walls):
        places = 0.004 * (np.argwhere(np.ones((3, 3, 3))) + 0.5)
        given["particles"] = {"ball": particle_group(places, 0.0035)}
        del walls["high_x"]["motion"], walls["high_y"]["motion"]

    def rectangle(given, walls):
        between(given, walls)
        plate = walls["high_z"]
        del plate["normal"], plate["point"], plate["motion"][0]["between"]
        plate |= {"shape": "rectangle", "corner": [0, 0, side], "sides": [[side, 0, 0], [0, side, 0]]}

    found = [plan_for(changed(build)).controlled_motions[0].numbers for build in (between, rectangle)]
    assert found[0] == pytest.approx(found[1])


TARGET = 0.5
"""Force [N] of the lid below."""


def lid_scene(gap, press, velocity_max=0.5, **servo):
    """Four particles on a floor, and a lid `gap` [m] above them that presses with 0.5 N in the stage press."""
    motion = {"kind": "servo", "direction": [0, 0, -1], "force": TARGET, "velocity_max": velocity_max}
    return balls_below(
        lid(DIAMETER + gap, motion | {"stages": ["press"]} | servo), gravity=[0.0] * 3, pair={"restitution": 0.1},
        positions=[[0.006 * x, 0.006 * y, DIAMETER / 2] for x in (-1, 1) for y in (-1, 1)],
        stages=[{"name": "press", "duration": press}, {"name": "release", "duration": 1e-4}], run={"velocity_max": 1.0},
        output={"interval": 1.0, "checkpoint": {"interval": 0.004}, "energy_budget": True, "wall_forces": True},
    )  # fmt: skip


def warned(scene, folder, **options):
    """The warnings on servos at the end of a stage, in result.json after the run."""
    with Simulation(scene, out=folder, **options) as simulation:
        simulation.run()
    warnings = json.loads((folder / "result.json").read_text())["warnings"]
    return [each for each in warnings if "at the end of stage" in each]


def test_servo_that_still_approaches_its_target_at_the_end_of_its_stage_is_reported(taichi_f64, tmp_path):
    """With a gain so small that the force is still increasing; also by a resumed run."""
    assert warned(lid_scene(0.0, 0.03, velocity_max=0.05), tmp_path / "reached") == []
    scene = lid_scene(0.0, 0.01, gain=2e-4)
    (sentence,) = warned(scene, tmp_path / "whole")
    assert 0.0 < float(sentence.split("target: ")[1].split(" N")[0]) < 0.95 * TARGET
    assert "less than velocity_max 0.5 m/s. Give it more time or a larger gain." in sentence
    shutil.copytree(tmp_path / "whole", tmp_path / "run")
    saved = read_checkpoint(sorted((tmp_path / "run").glob("checkpoint_*.npz"))[0])
    assert saved.time > 0.0 and len(saved.saved["stage_progress"]["controls"]["samples"]) == 20
    assert warned(scene, tmp_path / "run", resume=saved) == [sentence]


def test_fluctuations_about_the_target_are_tolerated_and_a_deviation_of_the_mean_is_not(taichi_f64):
    """The lid has not arrived: off its target; the samples decide whether its force fluctuates about it."""
    with Simulation(lid_scene(0.003, 0.005)) as simulation:
        simulation.run(until=0.004)
        about = [[TARGET * (1.0 + 0.5 * (-1) ** k)] for k in range(20)]
        below = [[0.6 * sample[0]] for sample in about]
        assert list(off_target(simulation.engine, "press", about)) == []
        (sentence,) = off_target(simulation.engine, "press", below)
    assert "is off its target: 0 N" in sentence
