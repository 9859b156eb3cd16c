"""Shipped scenes satisfy their `expect:` blocks; large scenes are also tested in a reduced form."""

from pathlib import Path

import pytest

from granflow import Simulation, load_scene
from granflow.cli.run import scene_paths

SCENES = Path(__file__).parents[2] / "scenes"
VERIFICATION = sorted((SCENES / "verification").glob("*.yaml"))
LONG = ("haff_cooling", "haff_periodic")
TESTED_IN_PHYSICS = (
    *(f"chung_ooi_{number}" for number in ("1", "2", "3", "3_elastic", "4", "5", "6", "7", "8")),
    *(
        "kharaz_2001_hertz",
        "wall_limit",
        "rolling_friction",
        "incline",
        "stack_at_rest",
        "bouncing_ball",
        "mfix_bounce",
    ),
    *("restitution_linear", "restitution_hertz", "restitution_chrome_52100", "equivalent_spring"),
)
"""Cases that tests/physics checks with smaller tolerances; as scenes they are slow tests."""
DOSTA = tuple(
    f"dosta2024/{name}" for name in ("silo_large_orifice", "silo_small_orifice", "drum", "penetration")
)
LARGE = ("hopper", "vibrated_bed", "drum", "flat_silo", "column_collapse", "impact", "clumps", *DOSTA)

REDUCED = {
    # An intruder of 8 mm and 1600 particles, the same ratio as in the full scene with 20 mm. Its kinetic
    # energy is 0.968 g (2.8 m/s)^2 / 2 = 3.8 mJ; after 25 ms the bed has dissipated most of it.
    "dosta2024/penetration": (
        "scale=0.4",
        "particles.ball.diameter=8 mm",
        "particles.ball.velocity=[0, 0, -2.5]",
        "particles.ball.insert.region.box={min: [-11 mm, -11 mm, -75 mm], max: [11 mm, 11 mm, -35 mm]}",
        "particles.ball.insert.start=0.03 s",
        "run.velocity_max=3 m/s",
        "run.duration=0.06 s",
        "materials.m1.young_modulus=10 MPa",
        "materials.steel.young_modulus=10 MPa",
        "expect=[{quantity: inserted_count, equals: 1601, tolerance: 0, any_scale: true}, "
        "{quantity: kinetic_energy, below: 0.76 mJ, any_scale: true}, "
        "{quantity: energy_error, between: [-1e-2, 1e-2], any_scale: true}]",
    ),
    # 1562 particles and an orifice of 3.75 diameters: 0.58 1500 sqrt(9.81) (0.015 - 1.4 0.004)^2.5 = 0.0234
    # kg/s. The uncertainty of C is 10 %, that of k adds 11 %. The modulus is a fifth; the weight of the bed
    # causes an overlap of (1500 9.81 0.05 / 1e6)^(2/3) = 0.8 % of d.
    "dosta2024/silo_large_orifice": (
        "scale=0.5",
        "materials.m1.young_modulus=1 MPa",
        "materials.steel.young_modulus=2 MPa",
        "numerics.max_overlap=0.4",
        "stages.0.duration=0.15 s",
        "stages.1.duration=0.3 s",
        # Beverloo's 0.0234 kg/s within 21 % is 84 +- 18 particles in 0.3 s; the standard deviation of the
        # count is its square root, 9.
        "expect=[{quantity: flow_count.outlet, between: [57, 111], any_scale: true}, "
        "{quantity: energy_error, between: [-1e-2, 1e-2], any_scale: true}]",
    ),
    # 125 large and 469 small particles at the same Froude number: M g b = 1.85 mN m, w = 2.83 rad/s. The
    # slope develops in the first 0.18 s of 0.5 s, so the work is 2.14 mJ sin(a) for 27 to 34 deg, within 20 %
    # because the length of the drum is only four large diameters.
    "dosta2024/drum": (
        "scale=0.5",
        "materials.m1.young_modulus=1 MPa",
        "materials.m2.young_modulus=0.5 MPa",
        "materials.steel.young_modulus=1 MPa",
        "numerics.max_overlap=0.4",
        *(
            f"walls.{name}.motion={{kind: rotation, point: [0, 0, 0], axis: [0, 1, 0], "
            "angular_velocity: 2.83 rad/s, stages: [turn]}"
            for name in ("shell", "front", "back")
        ),
        "stages.0.duration=0.1 s",
        "stages.1.duration=0.5 s",
        "expect=[{quantity: particle_count, equals: 594, tolerance: 0, any_scale: true}, "
        "{quantity: wall_work, between: [0.79e-3, 1.43e-3], any_scale: true}, "
        "{quantity: energy_error, between: [-1e-2, 1e-2], any_scale: true}]",
    ),
    # Half the width and height, an eighth of the particles, the same a: M g h / 4 = 8.3 g 9.81 7.1 mm / 4 =
    # 0.145 mJ. The bounds include a radius up to 8 % larger, or up to 13 % smaller because the runout of few
    # particles is shorter (Man et al. 2021).
    "column_collapse": (
        "particles.beads.count=780",
        "particles.beads.insert.region.cylinder={from: [0, 0, 0], to: [0, 0, 14 mm], radius: 12 mm}",
        "particles.floor.count=1296",
        "particles.floor.insert.region.box={min: [-36 mm, -36 mm, -2 mm], max: [36 mm, 36 mm, 0]}",
        "walls.tube={shape: cylinder, from: [0, 0, -5 mm], to: [0, 0, 40 mm], radius: 12 mm, material: "
        "glass, stages: [fill]}",
        "stages.0.duration=0.1 s",
        "stages.1.duration=0.2 s",
        "expect=[{quantity: gravitational_energy, between: [0.125 mJ, 0.190 mJ]}, "
        "{quantity: energy_error, between: [-5e-3, 5e-3]}]",
    ),
    # The outlet is as wide as the bed is high, so the flow is not steady and Beverloo's law does not apply.
    # Nearly all particles flow out. A sphere without rolling friction that rolls around the funnel does not
    # descend: its path oscillates in height, as in a vertical cylinder (see tests/physics/test_rest.py). With
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


@pytest.mark.parametrize(
    "name", [path.stem for path in VERIFICATION if path.stem not in (*LONG, *TESTED_IN_PHYSICS)]
)
def test_verification_scenes_satisfy_their_expectations(name, tmp_path, taichi_f64):
    assert unsatisfied(SCENES / "verification" / f"{name}.yaml", tmp_path) == []


def test_two_spheres_satisfy_their_expectations(tmp_path, taichi_f64):
    assert unsatisfied(SCENES / "two_spheres.yaml", tmp_path) == []


REDUCED_BUT_SLOW = (
    "dosta2024/penetration",
    "dosta2024/silo_large_orifice",
    "dosta2024/drum",
    "column_collapse",
)


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow if name in REDUCED_BUT_SLOW else ()) for name in REDUCED],
)
def test_reduced_scenes_satisfy_their_expectations(name, tmp_path, taichi_f64):
    assert unsatisfied(SCENES / f"{name}.yaml", tmp_path, REDUCED[name]) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", [*LONG, *TESTED_IN_PHYSICS])
def test_long_verification_scenes_satisfy_their_expectations(name, tmp_path, taichi_f64):
    assert unsatisfied(SCENES / "verification" / f"{name}.yaml", tmp_path) == []


@pytest.mark.slow
@pytest.mark.timeout(1500)
@pytest.mark.parametrize("name", LARGE)
def test_large_scenes_satisfy_their_expectations(name, tmp_path, taichi_f64):
    assert unsatisfied(SCENES / f"{name}.yaml", tmp_path) == []


def test_every_scene_has_a_description_and_expectations():
    for path in scene_paths().values():
        scene = load_scene(path)
        assert scene.description, path
        assert scene.expect, path
