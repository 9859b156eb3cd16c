"""Shipped scenes satisfy their `expect:` blocks; large scenes are also tested in a reduced form."""

from pathlib import Path

import pytest

from granflow import Simulation, load_scene
from granflow.cli.run import scene_paths

SCENES = Path(__file__).parents[2] / "scenes"
QUICK = ("through_flow", "unequal_spheres", "mfix_slip_to_roll")
"""Verification scenes that tests/physics does not check with smaller tolerances; the others are slow tests."""
OTHERS = sorted({path.stem for path in (SCENES / "verification").glob("*.yaml")} - set(QUICK))
LARGE = (
    *(
        "hopper",
        "vibrated_bed",
        "drum",
        "flat_silo",
        "column_collapse",
        "impact",
        "clumps",
        "mixer",
        "angle_of_repose",
    ),
    *(f"dosta2024/{name}" for name in ("silo_large_orifice", "silo_small_orifice", "drum", "penetration")),
)

REDUCED = {
    # The outlet is as wide as the bed is high, so the flow is not steady and Beverloo's law does not apply.
    # Nearly all particles flow out. A sphere without rolling friction that rolls around the funnel does not
    # descend: its path oscillates in height, as in a vertical cylinder. With
    # other seeds, one or two of 300 particles are still in the funnel after 0.3 s, also without rest damping
    # (6 of 12 seeds).
    "hopper": (
        "particles.beads.count=300",
        "materials.glass.young_modulus=10 MPa",
        "materials.acrylic.young_modulus=10 MPa",
        "numerics.max_overlap=0.2",
        "numerics.time_step_fraction=0.1",
        "stages.0.duration=0.2 s",
        "stages.1.max_duration=0.1 s",
        "stages.2.duration=0.3 s",
        "expect=[{quantity: flow_count.outlet, between: [297, 300]}, {quantity: energy_error, between: "
        "[-2e-3, 2e-3]}]",
    ),
    # A tenth of the width: M = 25.13 g. Two landings occur in 0.28 s: 32.0 mJ.
    "vibrated_bed": (
        "particles.beads.count=300",
        "particles.beads.insert.region.box={min: [-20 mm, -10 mm, 0], max: [20 mm, 10 mm, 100 mm]}",
        "walls.floor.corner=[-20 mm, -10 mm, 0]",
        "walls.floor.sides=[[40 mm, 0, 0], [0, 20 mm, 0]]",
        "walls.left.corner=[-20 mm, -10 mm, 0]",
        "walls.right.corner=[20 mm, -10 mm, 0]",
        "walls.front.corner=[-20 mm, -10 mm, 0]",
        "walls.front.sides=[[40 mm, 0, 0], [0, 0, 150 mm]]",
        "walls.back.corner=[-20 mm, 10 mm, 0]",
        "walls.back.sides=[[40 mm, 0, 0], [0, 0, 150 mm]]",
        "run.duration=0.28 s",
        "expect=[{quantity: wall_work, between: [0.028, 0.035]}, {quantity: energy_error, between: [-1e-3, "
        "1e-3]}]",
    ),
    # Half the diameter and length at the same Froude number: M = 29.3 g, b = 12.7 mm, w = 4.443 rad/s. The
    # distance of the end walls is only four diameters, which raises the slope to up to 50 degrees.
    "drum": (
        "particles.beads.count=350",
        "particles.beads.insert={kind: pack, "
        "region: {box: {min: [-22.5 mm, -7.5 mm, -19 mm], max: [22.5 mm, 7.5 mm, 19 mm]}}}",
        "walls.shell={shape: cylinder, from: [0, -7.5 mm, 0], to: [0, 7.5 mm, 0], radius: 30 mm, material: "
        "steel, motion: {kind: rotation, point: [0, 0, 0], axis: [0, 1, 0], angular_velocity: -42.43 rpm}}",
        "walls.front={shape: disc, center: [0, -7.5 mm, 0], normal: [0, 1, 0], radius: 30 mm, material: "
        "steel, motion: {kind: rotation, point: [0, 0, 0], axis: [0, 1, 0], angular_velocity: -42.43 rpm}}",
        "walls.back={shape: disc, center: [0, 7.5 mm, 0], normal: [0, 1, 0], radius: 30 mm, material: steel, "
        "motion: {kind: rotation, point: [0, 0, 0], axis: [0, 1, 0], angular_velocity: -42.43 rpm}}",
        "run.duration=0.7 s",
        "expect=[{quantity: gravitational_energy, between: [-3.5e-3, -2.3e-3]}, "
        "{quantity: wall_work, between: [3e-3, 8e-3]}, {quantity: energy_error, between: [-1e-3, 1e-3]}]",
    ),
}


def unsatisfied(path, out, overrides=()):
    """Run a scene; return the expectations that are not satisfied."""
    simulation = Simulation(load_scene(path, ["output.interval=1000 s", *overrides]), threads=2, out=out)
    result = simulation.run()
    simulation.free()
    assert result.expectations
    return [sentence for sentence, met in result.expectations if not met]


@pytest.mark.parametrize("name", QUICK)
def test_verification_scenes_satisfy_their_expectations(name, tmp_path, taichi_f64):
    assert unsatisfied(SCENES / "verification" / f"{name}.yaml", tmp_path) == []


@pytest.mark.parametrize(
    "name", [pytest.param(each, marks=pytest.mark.slow) if each == "drum" else each for each in REDUCED]
)
def test_reduced_scenes_satisfy_their_expectations(name, tmp_path, taichi_f64):
    assert unsatisfied(SCENES / f"{name}.yaml", tmp_path, REDUCED[name]) == []


@pytest.mark.slow
@pytest.mark.timeout(1500)
@pytest.mark.parametrize("name", ["two_spheres", *(f"verification/{name}" for name in OTHERS), *LARGE])
def test_large_and_other_scenes_satisfy_their_expectations(name, tmp_path, taichi_f64):
    assert unsatisfied(SCENES / f"{name}.yaml", tmp_path) == []


def test_every_scene_has_a_description_and_expectations():
    for path in scene_paths().values():
        scene = load_scene(path)
        assert scene.description, path
        assert scene.expect, path
