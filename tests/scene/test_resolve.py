"""Resolved scenes: counts derived from mass or duration, particles from files, and scaled scenes."""

from math import pi

import numpy as np
import pytest
from plan.scenes import TEXT

from granflow.errors import SceneError
from granflow.load import load_scene, scene_of
from granflow.particles.group import groups_of
from granflow.particles.insertion import initial_particles
from granflow.particles.resolve import scaled
from granflow.plan.build import plan_for
from granflow.scene.blocks.sizes import GivenSizes
from granflow.scene.blocks.walls.mesh import MeshWall

PARTICLE = pi / 6.0 * 0.004**3 * 2500.0
"""Mass [kg] of a particle of the scene."""
BEADS = TEXT[TEXT.index("    count: 10\n") : TEXT.index("domain:")]


def scene_with(tmp_path, beads, *overrides, start=""):
    """The scene of ten particles with other lines for its group, and with start.csv in its folder."""
    (tmp_path / "start.csv").write_text(start)
    path = tmp_path / "beads.yaml"
    path.write_text(TEXT.replace(BEADS, beads))
    return load_scene(path, overrides)


REGION = "region: {box: {min: [0, 0, 0], max: [2 cm, 2 cm, 1 cm]}}"
PACK = f"    insert: {{kind: pack, {REGION}}}\n"
UNIFORM = "{distribution: uniform, min: 2 mm, max: 4 mm}"
CLASSES = (
    "{distribution: classes, by: mass, classes: [{diameter: 2 mm, fraction: 1}, {diameter: 4 mm, fraction: "
    "1}]}"
)


@pytest.mark.parametrize(
    ("amount", "insertion", "count"),
    [
        (f"mass: {7.4 * PARTICLE!r}", "kind: pack", 7),
        ("", f"kind: rain, mass_flow: {100 * PARTICLE!r}, start: 1 s, end: 1.5 s", 50),
        ("", "kind: rain, rate: 10, start: 1 s, end: 2.05 s", 11),  # at 1, 1.1, ... 2.0
        (f"mass: {4 * PARTICLE!r}", "kind: rain, rate: 10, end: 100 s", 4),
        ("count: 30", "kind: rain, rate: 10, end: 1.55 s", 16),
    ],
)
def test_count_is_derived_from_mass_or_duration(tmp_path, amount, insertion, count):
    scene = scene_with(tmp_path, f"    {amount}\n    diameter: 4 mm\n    insert: {{{insertion}, {REGION}}}\n")
    assert scene.particles["beads"].count == plan_for(scene).particle_capacity == count
    assert scene_of(scene.to_yaml(), "as run").particles == scene.particles, "resolving is idempotent"


def test_radius_is_half_the_diameter(tmp_path):
    beads = scene_with(tmp_path, f"    count: 9\n    radius: 2 mm\n{PACK}").particles["beads"]
    assert beads.sizes == GivenSizes(0.004)
    rows = "    insert: {kind: positions, positions: [[0, 0, 0.01], [0, 0, 0.02]]}\n"
    listed = scene_with(tmp_path, f"    radius: [1 mm, 2 mm]\n{rows}").particles["beads"]
    assert listed.sizes == GivenSizes((0.002, 0.004))


@pytest.mark.parametrize("sizes", [UNIFORM, CLASSES])
def test_mass_is_exact_within_one_particle(tmp_path, sizes):
    """Half of the mass in 2 mm and half in 4 mm, numbers 8 : 1, so the mean of d^3 is 8/9 8 + 1/9 64 mm^3."""
    requested = 300.4 * PARTICLE
    scene = scene_with(tmp_path, f"    mass: {requested!r}\n    diameter: {sizes}\n{PACK}")
    # The generator has the sizes without positions; the packing would be too dense.
    beads = groups_of(scene)["beads"]
    inserted = PARTICLE / 64e-9 * beads.spec.sizes.draw(beads.spec.count, beads.random()) ** 3
    assert abs(inserted.sum() - requested) <= PARTICLE / 2
    if sizes is CLASSES:
        assert beads.spec.count == round(300.4 * 64 / (8 / 9 * 8 + 64 / 9))
        assert inserted[inserted < PARTICLE / 2].sum() == pytest.approx(requested / 2, abs=PARTICLE)


FILE = "    insert: {kind: file, file: start.csv}\n"
ROWS = "x,y,z,r,vx,vy,vz\n0.005,0,0,0.002,3,0,4\n0.0085,0,0,0.002,0,0,0\n0.01,0.02,0,0.001,0,0,0\n"


def test_file_defines_count_diameters_and_velocities(tmp_path):
    """Two particles of radius 2 mm overlap by 0.5 mm; the largest speed is 5 m/s."""
    scene = scene_with(tmp_path, FILE, "run.velocity_max=null", start=ROWS)
    group = scene.particles["beads"]
    found = group.insert.found
    assert (group.count, found.diameter_min, found.diameter_max) == (3, 0.002, 0.004)
    assert found.overlap_max == pytest.approx(0.25) and found.overlap_rows == "lines 2 and 3"
    assert plan_for(scene).impact_velocity.value == pytest.approx(10.0)
    assert plan_for(scene).radius_min == 0.001
    particles = initial_particles(scene)
    np.testing.assert_allclose(particles.velocity[0], [3, 0, 4])
    assert particles.radius.tolist() == [0.002, 0.002, 0.001]
    (tmp_path / "start.csv").unlink()
    again = scene_of(scene.to_yaml(), str(tmp_path / "checkpoint.npz"))
    assert again.particles == scene.particles, "the resolved scene does not need the file"


def test_angular_velocity_of_a_file_above_the_limit_per_step_is_rejected(tmp_path):
    """The limit is 0.2 rad per step."""
    rows = "x,y,z,r,wx,wy,wz\n0.005,0,0,0.002,0,%g,0\n"
    plan_for(scene_with(tmp_path, FILE, "run.time_step=1e-6", start=rows % 1.99e5))
    with pytest.raises(SceneError, match=r"starts with 2.01e.05 rad/s, which is 0.201 rad per step"):
        plan_for(scene_with(tmp_path, FILE, "run.time_step=1e-6", start=rows % 2.01e5))


STEEL = "x,y,z,d,material\n0,0,0,4e-3,steel\n0.01,0,0,4e-3,glass\n0.02,0,0,4e-3,1\n"


def test_rows_are_assigned_to_the_group_of_their_material(tmp_path):
    both = FILE + "  shot: {material: steel, insert: {kind: file, file: start.csv}}\n"
    scene = scene_with(tmp_path, both, "pairs.steel-steel={restitution: 0.7, friction: 0}", start=STEEL)
    assert {name: group.count for name, group in scene.particles.items()} == {"beads": 1, "shot": 2}
    assert initial_particles(scene).position[:, 0].tolist() == [0.01, 0.0, 0.02]


OUTSIDE = "x,y,z,d\n0,0,0,4e-3\n9,0,0,4e-3\n0,9,0,4e-3\n"


@pytest.mark.parametrize(("beads", "rows", "problem"), [
    (FILE, STEEL, "start.csv:2: this particle is of steel, but no group has this material; add one."),
    (FILE, STEEL.replace("glass", "1"), "beads.yaml:17:15: no row of start.csv is of glass; its materials are 1, steel."),
    (FILE, OUTSIDE, "start.csv:3: this particle and 1 more lie outside the domain."),
    (f"    count: 4\n{FILE}", ROWS, "beads.yaml:18:12: particles.beads.count is 4, but start.csv has 3 rows for it."),
    (f"    velocity: [0, 0, 1]\n{FILE}", ROWS, "beads.yaml:18:15: particles.beads.velocity is in start.csv too;"),
    (FILE.replace("start", "none"), ROWS, "beads.yaml:18:32: particles.beads.insert.file is none.csv, but there is no"),
    (f"    mass: 1e20 kg\n    diameter: {UNIFORM}\n{PACK}", "", "beads.yaml:18:11: particles.beads.mass results in "),
    (f"    count: 9\n    radius: 2 mm\n    diameter: 4 mm\n{PACK}", "",
     "beads.yaml:19:13: particles.beads.radius is 2 mm, but diameter is given too"),
    (f"    count: 9\n    radius: -2 mm\n{PACK}", "", "beads.yaml:19:13: particles.beads.radius is -2 mm, but a radius"),
    (f"    count: 9\n    radius: [1 mm, 2 mm]\n{PACK}", "",
     "beads.yaml:19:5: particles.beads.radius is a list, which requires insert: {kind: positions}"),
])  # fmt: skip
def test_files_sizes_and_amounts_that_contradict_are_rejected(tmp_path, beads, rows, problem):
    with pytest.raises(SceneError) as caught:
        scene_with(tmp_path, beads, start=rows)
    (found,) = caught.value.problems
    assert found.replace(f"{tmp_path}/", "").startswith(problem)


def test_scale_changes_equipment_and_amounts_only(tmp_path):
    rain = f"    mass: {100 * PARTICLE!r}\n    diameter: 4 mm\n    velocity: [0, 0, -1]\n"
    rain += f"    insert: {{kind: rain, rate: 50, {REGION}}}\n"
    extra = [
        "walls.plate={shape: disc, center: [0, 0, 5 mm], normal: [0, 0, 1], radius: 4 mm, material: glass, "
        "motion: {kind: vibration, direction: [0, 0, 1], amplitude: 1 mm, frequency: 25}}",
        "output.flow_meters={out: {point: [0, 0, 1 mm], normal: [0, 0, 1], radius: 3 mm}}",
        "expect=[{quantity: particle_count, equals: 100, tolerance: 0}, "
        "{quantity: kinetic_energy, below: 1, any_scale: true}]",
    ]
    one = scene_with(tmp_path, rain, *extra)
    two = scene_with(tmp_path, rain, *extra, "scale=2")
    beads, wall, meter = two.particles["beads"], two.walls["plate"], two.output.flow_meters["out"]
    assert beads.count == 800 and beads.insert.rate == 400.0
    assert beads.insert.region.box.max == (0.04, 0.04, 0.02)
    assert (two.domain.min[0], two.domain.max[2]) == (-0.02, 0.06)
    assert (wall.center[2], wall.radius, wall.normal) == (0.01, 0.008, (0.0, 0.0, 1.0))
    assert wall.motion == one.walls["plate"].motion, "the amplitude does not scale"
    assert (meter.point[2], meter.radius) == (0.002, 0.006)
    assert beads.diameter == 0.004 and beads.velocity == one.particles["beads"].velocity
    assert (two.run, two.materials, two.numerics) == (one.run, one.materials, one.numerics)
    assert [each.quantity for each in two.expect] == ["kinetic_energy"] and len(one.expect) == 2
    assert two.remarks[0].startswith(
        "scale 2: lengths of the equipment are multiplied by 2, counts and masses"
    )
    assert scene_of(two.to_yaml(), "as run") == two, "resolving is idempotent"
    mesh = MeshWall(shape="mesh", material="glass", file="a.stl", scale=0.001, translate=(1.0, 0.0, -2.0))
    assert (scaled(mesh, 3.0).scale, scaled(mesh, 3.0).translate) == (0.003, (3.0, 0.0, -6.0))
    with pytest.raises(SceneError, match="scale is 2, but particles.beads has given positions"):
        scene_with(tmp_path, FILE, "scale=2", start=ROWS)
