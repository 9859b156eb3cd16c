"""Servo walls whose pressure refers to the present section between other walls."""

import numpy as np
import pytest
from scene_builders import SOFT, build_scene, particle_group, plane

from granflow.errors import GranflowError, SceneError
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
    """F_x = P_x L_y L_z with the present distances L = D - 2 overlap. The section of the start is larger by
    44 %."""
    overlap = np.zeros(3)
    for _ in range(50):
        length = DIAMETER - 2.0 * overlap
        overlap = (PRESSURES * length.prod() / length / STIFFNESS) ** (2 / 3)
    with Simulation(servo_box()) as simulation:
        assert [each.force for each in simulation.plan.controlled_motions] == pytest.approx(
            PRESSURES * (DIAMETER + GAP) ** 2
        )
        simulation.run(until=0.001)
        warned = list(off_target(simulation.engine, "run", []))
        result = simulation.run()
        last = simulation.snapshot()
    moved = np.array([last.totals[f"wall_displacement.high_{axis}"] for axis in "xyz"])
    np.testing.assert_allclose(moved, GAP + 2.0 * overlap, rtol=1e-9)
    np.testing.assert_allclose(last.particles["position"][0], DIAMETER / 2 - overlap, rtol=1e-9)
    assert not [each for each in result.warnings if "off its target" in each]
    assert len(warned) == 3 and all(
        f"walls.high_{axis}.motion" in sentence and "0 N (0 Pa) instead of" in sentence and f"({pressure:.3g} Pa)" in sentence
        for axis, sentence, pressure in zip("xyz", warned, PRESSURES, strict=True)
    )  # fmt: skip


@pytest.mark.parametrize(
    ("between", "message"),
    [
        (["low_x", "high_y", "low_z", "high_z"], "has low_x and high_y as a pair, which are not opposite"),
        (["low_x", "high_x", "low_z", "high_z"], "has walls that are not perpendicular to each other and"),
        (["low_y", "high_y"], "has two walls, but no periodic axis across them; give four walls"),
    ],
)
def test_walls_that_enclose_no_section_are_refused(between, message):
    scene = servo_box().to_dict()
    scene["walls"]["high_x"]["motion"][0]["between"] = between
    with pytest.raises(SceneError, match=rf"walls\.high_x\.motion\.between {message}"):
        plan_for(Scene.from_dict(scene))


def test_forecast_of_a_single_particle_has_the_whole_force_of_each_wall():
    found = [each.overlap for each in plan_for(servo_box()).forecasts if each.name == "overlap under a wall"]
    expected = (PRESSURES * (DIAMETER + GAP) ** 2 / STIFFNESS) ** (2 / 3) / (DIAMETER / 2)
    assert found == pytest.approx(expected, rel=1e-6)


def test_servo_on_a_section_that_does_not_reach_the_bed_is_reported():
    """Along gravity, the plane at 12 mm is above a sphere of 10 mm; it would have to move by 50 mm more."""
    given = servo_box().to_dict()
    given["gravity"] = [0.0, 0.0, -9.81]
    given["walls"]["high_z"]["point"] = [0.0, 0.0, 0.09]
    given["domain"] |= {"max": [0.1, 0.1, 0.1]}
    warnings = [each.warning for each in plan_for(Scene.from_dict(given)).forecasts if each.warning]
    (sentence,) = [each for each in warnings if "the bed is about" in each]
    assert sentence.startswith("walls.high_z.motion")


def test_direction_into_the_plane_is_reported():
    given = servo_box().to_dict()
    given["walls"]["high_x"]["motion"][0]["direction"] = [1.0, 0.0, 0.0]
    warnings = [each.warning for each in plan_for(Scene.from_dict(given)).forecasts if each.warning]
    (sentence,) = [each for each in warnings if "away from the particles" in each]
    assert sentence.startswith("walls.high_x.motion") and sentence.endswith("[-1, 0, 0].")
    given["contact"]["cohesion"] = "sjkr"
    for pair in given["pairs"].values():
        pair["cohesion_energy_density"] = 1e3
    warnings = [each.warning for each in plan_for(Scene.from_dict(given)).forecasts if each.warning]
    assert not [each for each in warnings if "away from the particles" in each]


def test_a_program_cannot_remove_or_move_walls_around_a_section():
    plan = plan_for(servo_box())
    for change in (
        lambda: without_wall(plan, "low_x", 0.0),
        lambda: with_motions(plan, "low_x", [], 0.0, []),
    ):
        with pytest.raises(
            GranflowError, match=r"walls\['low_x'\] cannot be .*: it bounds the section of walls\.high_y"
        ):
            change()


def test_two_walls_enclose_a_section_with_a_periodic_axis():
    """F = P L W with the width W of the box along the periodic axis; a plane needs no area of its own."""
    scene = servo_box().to_dict()
    scene["domain"] |= {"min": [-1.0, -1.0, 0.0], "max": [1.0, 1.0, 0.04], "periodic": ["z"]}
    for name in ("low_z", "high_z"):
        del scene["walls"][name]
    scene["walls"]["high_x"]["motion"][0]["between"] = ["low_y", "high_y"]
    scene["walls"]["high_y"]["motion"][0]["between"] = ["high_x", "low_x"]
    forces = [each.force for each in plan_for(Scene.from_dict(scene)).controlled_motions]
    assert forces == pytest.approx(PRESSURES[:2] * (DIAMETER + GAP) * 0.04)


def test_default_gain_is_that_of_a_wall_of_the_size_of_the_section():
    """27 spheres: more than the closest layer on the section, fewer than on the domain."""
    low = servo_box().to_dict()
    places = [[(i + 0.5) * 0.004, (j + 0.5) * 0.004, (k + 0.5) * 0.004]
              for i in range(3) for j in range(3) for k in range(3)]  # fmt: skip
    low["particles"] = {"ball": particle_group(places, 0.0035)}
    for axis in "xy":
        del low["walls"][f"high_{axis}"]["motion"]
    rectangle = Scene.from_dict(low).to_dict()
    side = DIAMETER + GAP
    plate = rectangle["walls"]["high_z"]
    del plate["normal"], plate["point"], plate["motion"][0]["between"]
    plate |= {"shape": "rectangle", "corner": [0, 0, side], "sides": [[side, 0, 0], [0, side, 0]]}
    between, own = (
        plan_for(Scene.from_dict(each)).controlled_motions[0].numbers for each in (low, rectangle)
    )
    assert between == pytest.approx(own)
