"""Groups of clumps: counts and masses, orientations, messages about invalid combinations, `explain`."""

from pathlib import Path

import numpy as np
import pytest
from clumps import ROD, about, clump_group
from scene_builders import SOFT, build_scene, particle_group, plane

from granflow.errors import SceneError
from granflow.geometry.clump import clump_body, matrices
from granflow.load import Scene
from granflow.particles.insertion import initial_particles
from granflow.plan.build import plan_for
from granflow.plan.explain import explain
from granflow.plan.overlaps import particle_warnings, refuse_initial_overlaps
from granflow.runs.initial_particles import initial_state

REGION = {"box": {"min": [0.0, 0.0, 0.0], "max": [0.1, 0.1, 0.1]}}


def problems(group=None, **parts):
    """The messages about a scene with one group of rods."""
    rods = clump_group([[0.0, 0.0, 0.0]]) | (group or {})
    rods = {key: value for key, value in rods.items() if value is not None}
    scene = build_scene(
        {"rods": clump_group([[0.0, 0.0, 0.0]])}, {"floor": plane([0, 0, -0.5], [0, 0, 1])}
    ).to_dict()
    with pytest.raises(SceneError) as caught:
        Scene.from_dict(scene | {"particles": {"rods": rods}} | parts)
    return list(caught.value.problems)


SPHERES = clump_group([0, 0, 0])["clump"]["spheres"]
CHAIN = [{"position": [0.001 * k, 0, 0], "radius": 0.002} for k in range(101)]
SHEARED = {
    "min": [-1.0] * 3, "max": [1.0] * 3, "on_exit": "error", "periodic": ["x", "y", "z"],
    "lees_edwards": {"flow": "x", "gradient": "z", "rate": 1.0},
}  # fmt: skip
DEFORMED = {key: SHEARED[key] for key in ("min", "max", "on_exit", "periodic")}
DEFORMED |= {"deformation": {"x": {"strain_rate": -1.0}}}
EXCLUDED = {
    "`fixed: {to: WALL}` of the group": (
        {"fixed": {"to": "floor"}}, {}, "particles.rods.fixed is {to: floor}, but clumps cannot move with a wall"
    ),
    "`insert.kind` of the group: `file`, `python`": (
        {"insert": {"kind": "python"}}, {}, "particles.rods.insert.kind is python, but clumps are not inserted"
    ),
    "`diameter`, `radius` of the group": (
        {"diameter": 0.004}, {}, "particles.rods.diameter is 0.004, but the spheres of the clump define the sizes"
    ),
    "`domain.lees_edwards`": (
        {}, {"walls": {}, "domain": SHEARED}, "domain.lees_edwards cannot be combined with the clumps"
    ),
    "`deformation` of the domain or a stage": (
        {}, {"walls": {}, "domain": DEFORMED}, "domain.deformation cannot be combined with clumps"
    ),
    "`kind: stress` of `output.metrics`": (
        {}, {"output": {"interval": 1.0, "metrics": {"all": {"kind": "stress"}}}},
        "output.metrics.all.kind is stress, but particles.rods are clumps, for which it is not implemented",
    ),
}  # fmt: skip
"""What clumps exclude, as in the table of the guide: changes of the group and of the scene, and the message."""
OF_PROGRAMS = {"`particles.add`, and other values of spheres of clumps, from Python"}
"""Further rows of the table; `tests/engine` has their messages."""
INVALID = [
    ({"clump": {"spheres": SPHERES, "orientation": [about([0, 0, 1], 10)] * 2}},
     "particles.rods.clump.orientation is a list of length 2, but insert.positions has length 1"),
    ({"clump": {"spheres": SPHERES, "orientation": "upright"}}, "particles.rods.clump.orientation is upright, but "
     "it must be random, {axis: [..], angle: ..}, or a list"),
    ({"clump": {"spheres": []}}, "at least one item is required, such as [{position: [0, 0, 0]"),
    ({"clump": {"spheres": CHAIN}}, "particles.rods.clump.spheres has 101 spheres, but the limit is 100"),
]  # fmt: skip


@pytest.mark.parametrize(("group", "parts", "sentence"), [
    *EXCLUDED.values(), *((group, {}, sentence) for group, sentence in INVALID)
])  # fmt: skip
def test_invalid_group_or_part_has_one_message(group, parts, sentence):
    (found,) = problems(group, **parts)
    assert sentence in found


def test_guide_lists_what_clumps_exclude():
    """Each row of its table is a refusal of this file or of a program."""
    guide = (Path(__file__).parents[2] / "docs/pages/guides/clumps.md").read_text()
    table = guide.partition("## What clumps exclude")[2].partition("## ")[0]
    rows = [line.split("|")[1].strip() for line in table.splitlines() if line.startswith("| ")]
    assert rows[0] == "excluded" and set(rows[1:]) == EXCLUDED.keys() | OF_PROGRAMS
    assert len(rows) == 1 + len(EXCLUDED) + len(OF_PROGRAMS)


def test_mass_of_a_group_gives_the_number_of_clumps():
    """The mass of a clump is density times the volume of the union of its spheres."""
    mass = SOFT["density"] * clump_body(tuple(map(tuple, ROD)), (0.002,) * len(ROD)).volume
    packed = clump_group([[0, 0, 0]]) | {
        "count": None, "mass": 37.2 * mass, "insert": {"kind": "pack", "region": REGION}
    }  # fmt: skip
    scene = build_scene({"rods": {key: value for key, value in packed.items() if value is not None}})
    assert scene.particles["rods"].count == 37
    plan = plan_for(scene)
    assert plan.particle_capacity == 37 * len(ROD)
    assert "rods 37 clumps of 4 spheres" in " ".join(explain(plan).split())


def test_random_orientations_are_uniform_and_follow_the_seed():
    """The mean of the axis of many rods is 0 and that of its products 1/3, within four standard
    deviations."""
    group = clump_group(0.02 * np.argwhere(np.ones((20, 20, 5))), orientation="random")
    found = [initial_particles(build_scene({"rods": group}, seed=seed)) for seed in (1, 1, 2)]
    assert np.array_equal(found[0].orientation, found[1].orientation)
    assert not np.array_equal(found[0].orientation, found[2].orientation)
    axis = matrices(found[0].orientation)[:, :, 0]
    assert np.abs(axis.mean(axis=0)).max() < 4.0 / np.sqrt(3.0 * len(axis))
    assert np.abs(axis.T @ axis / len(axis) - np.eye(3) / 3.0).max() < 4.0 * np.sqrt(4.0 / 45.0 / len(axis))


def test_packed_clumps_do_not_overlap():
    """The spheres around the clumps do not overlap, so that clumps are in any orientation."""
    group = clump_group([[0, 0, 0]]) | {"count": 60, "insert": {"kind": "pack", "region": REGION}}
    found = initial_particles(build_scene({"rods": group}))
    assert found.radius == pytest.approx(np.full(60, 5e-3))
    branch = np.linalg.norm(found.position[:, None] - found.position, axis=2)
    assert branch[~np.eye(60, dtype=bool)].min() > 1e-2


CROSSED = {"axis": [0.0, 0.0, 1.0], "angle": np.pi / 2}
PERIODIC = {"min": [-0.1] * 3, "max": [0.1] * 3, "periodic": ["x", "z"], "on_exit": "error"}
OVERLAPS = {
    "side": ([[0, 0, 0], [0, 3e-3, 0]], None, (
        "rods[0] at [0, 0, 0] m and particles rods[1] at [0, 0.003, 0] m overlap by 0.5 of"
    ), "1 pair overlaps by more). Move them 0.001 m"),
    "ends": ([[0, 0, 0], [9e-3, 0, 0], [18e-3, 0, 0]], None, "overlap by 0.5 of", "2 pairs overlap by more"),
    "orientation": ([[0, 0, 0], [0, 6e-3, 0]], [{"axis": [0.0, 0.0, 1.0], "angle": 0.0}, CROSSED],
                    "overlap by 0.419 of", "1 pair"),
    "periodic": ([[-0.096, 0, 0], [0.0955, 0, 0]], None, (
        "rods[0] at [-0.096, 0, 0] m and the periodic image of particles rods[1] at [-0.1045, 0, 0] m "
        "overlap by 0.75 of"
    ), "1 pair"),
}  # fmt: skip
"""Positions of rods with a radius of 2 mm, their orientations, and two parts of the sentence."""


@pytest.mark.parametrize("name", OVERLAPS)
def test_clumps_whose_spheres_overlap_at_the_start_are_refused(name):
    """The ends of a rod are 5 mm from its center; 3.162 mm separate the spheres nearest to the end of a
    crossed rod."""
    positions, orientation, *parts = OVERLAPS[name]
    scene = build_scene({"rods": clump_group(positions, orientation=orientation)}, domain=PERIODIC)
    with pytest.raises(SceneError) as caught:
        refuse_initial_overlaps(scene, initial_particles(scene))
    assert [part for part in parts if part not in str(caught.value)] == []


def test_sphere_that_overlaps_a_sphere_of_a_clump_is_refused():
    ball = particle_group([[6e-3, 0, 0]], 0.004)
    scene = build_scene({"rods": clump_group([[0, 0, 0], [0.05, 0, 0]]), "balls": ball})
    with pytest.raises(
        SceneError, match=r"particles rods\[0\] at .* and particles balls\[0\] at .* by 0.5 of"
    ):
        refuse_initial_overlaps(scene, initial_particles(scene))


def floored(group, height):
    """Warnings about clumps inside a floor at a height [m]."""
    scene = build_scene({"rods": group}, walls={"floor": plane([0.0, 0.0, height], [0.0, 0.0, 1.0])})
    plan = plan_for(scene)
    return list(particle_warnings(plan, initial_particles(scene)))


def test_only_rods_whose_spheres_are_inside_a_wall_are_reported():
    """Rods of radius 2 mm and length 10 mm, 2.5 mm above a floor: lying at a gap of 0.5 mm; a standing one
    has a sphere

    center 0.5 mm below the floor, an overlap of 2.5 mm or 1.25 R; one inclined by 30 degrees has its center
    at 1 mm, an overlap of 1 mm.
    """
    at = [[0.0, 0.0, 2.5e-3]]
    assert floored(clump_group(at), 0.0) == []
    for degrees, overlap in ((90.0, 1.25), (30.0, 0.5)):
        (warning,) = floored(clump_group(at, orientation=about([0, 1, 0], degrees)), 0.0)
        assert (
            f"1 of 1 particles are inside walls.floor at the start, by up to {overlap:.3g} of the radius"
            in warning
        )
    both = clump_group(
        [[0.0, 0.0, 2.5e-3], [0.02, 0.0, 2.5e-3]], orientation=[about([0, 1, 0], a) for a in (0.0, 90.0)]
    )
    assert "1 of 2 particles" in floored(both, 0.0)[0]


@pytest.mark.parametrize(("degrees", "clearance"), [(0.0, 1.8e-3), (90.0, 4.8e-3)])
def test_rods_whose_spheres_overlap_a_wall_are_left_out(degrees, clearance):
    """Centers of rods are at z = 5 to 15 mm, and the floor at 3 mm.

    Overlaps above 0.1 R start at 1.8 mm: none of the lying rods, and the standing ones up to 3 + 1.8 mm.
    """
    group = clump_group([[0.0, 0.0, 0.0]], orientation=about([0, 1, 0], degrees)) | {"count": 3}
    region = {"box": {"min": [0.0, 0.0, 0.0], "max": [0.04, 0.04, 0.02]}}
    rods = group | {"count": 12, "insert": {"kind": "pack", "region": region}}
    scene = build_scene({"rods": rods}, walls={"floor": plane([0.0, 0.0, 3e-3], [0.0, 0.0, 1.0])})
    height = initial_particles(scene).position[:, 2]
    remaining, _, warnings = initial_state(plan_for(scene), None, None)
    assert (remaining.position[:, 2] == height[height >= 3e-3 + clearance]).all()
    assert len(remaining) == len(remaining.orientation)
    left_out = 12 - len(remaining)
    assert (left_out > 0) == (degrees > 0.0) == (len(warnings) > 0)
    assert not warnings or f"{left_out} of 12 particles are left out" in warnings[0]
