"""Groups of clumps: counts and masses, orientations, overlaps, messages about invalid combinations."""

import numpy as np
import pytest
from clumps import ROD, about, clump_group
from scene_builders import SOFT, build_scene, particle_group, plane

from granflow.errors import SceneError
from granflow.geometry.clump import clump_body, matrices
from granflow.load import Scene
from granflow.particles.insertion import initial_particles
from granflow.plan.build import plan_for
from granflow.plan.overlaps import particle_warnings, refuse_initial_overlaps

REGION = {"box": {"min": [0.0, 0.0, 0.0], "max": [0.1, 0.1, 0.1]}}


def test_number_of_spheres_of_a_clump_is_limited():
    chain = clump_group([0, 0, 0], [[0.001 * k, 0, 0] for k in range(101)])
    with pytest.raises(SceneError, match="rods.clump.spheres has 101 spheres, but the limit is 100"):
        Scene.from_dict(build_scene({"rods": chain}).to_dict())


def test_mass_of_a_group_gives_the_number_of_clumps():
    """The mass of a clump is density times the volume of the union of its spheres."""
    mass = SOFT["density"] * clump_body(tuple(map(tuple, ROD)), (0.002,) * len(ROD)).volume
    packed = clump_group([[0, 0, 0]]) | {"mass": 37.2 * mass, "insert": {"kind": "pack", "region": REGION}}
    del packed["count"]
    scene = build_scene({"rods": packed})
    assert scene.particles["rods"].count == 37 and plan_for(scene).particle_capacity == 37 * len(ROD)


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


PERIODIC = {"min": [-0.1] * 3, "max": [0.1] * 3, "periodic": ["x", "z"], "on_exit": "error"}
CROSSED = [about([0.0, 0.0, 1.0], 0.0), about([0.0, 0.0, 1.0], 90.0)]
BALL = {"ball": particle_group([[6e-3, 0, 0]], 0.004)}


@pytest.mark.parametrize(("positions", "orientation", "others", "parts"), [
    ([[0, 0, 0], [0, 3e-3, 0]], None, {}, (
        "rods[0] at [0, 0, 0] m and particles rods[1] at [0, 0.003, 0] m overlap by 0.5 of",
        "1 pair overlaps by more). Move them 0.001 m")),
    ([[0, 0, 0], [9e-3, 0, 0], [18e-3, 0, 0]], None, {}, ("overlap by 0.5 of", "2 pairs overlap by more")),
    ([[0, 0, 0], [0, 6e-3, 0]], CROSSED, {}, ("overlap by 0.419 of", "1 pair")),
    ([[-0.096, 0, 0], [0.0955, 0, 0]], None, {}, (
        "rods[0] at [-0.096, 0, 0] m and the periodic image of particles rods[1] at [-0.1045, 0, 0] m "
        "overlap by 0.75 of", "1 pair")),
    ([[0, 0, 0], [0.05, 0, 0]], None, BALL, ("particles rods[0] at", "and particles ball[0] at", "by 0.5 of")),
], ids=["side", "ends", "orientation", "periodic", "sphere"])  # fmt: skip
def test_clumps_whose_spheres_overlap_at_the_start_are_refused(positions, orientation, others, parts):
    """The ends of a rod with a radius of 2 mm are 5 mm from its center; 3.162 mm separate the spheres nearest to
    the end of a crossed rod."""
    rods = {"rods": clump_group(positions, orientation=orientation)}
    scene = build_scene(rods | others, domain=PERIODIC)
    with pytest.raises(SceneError) as caught:
        refuse_initial_overlaps(scene, initial_particles(scene))
    assert [part for part in parts if part not in str(caught.value)] == []


@pytest.mark.parametrize(("degrees", "overlap"), [(0.0, None), (90.0, 1.25), (30.0, 0.5)])
def test_only_rods_whose_spheres_are_inside_a_wall_are_reported(degrees, overlap):
    """Rods of radius 2 mm and length 10 mm, 2.5 mm above a floor: lying at a gap of 0.5 mm; a standing one has a
    sphere center 0.5 mm below the floor, an overlap of 2.5 mm or 1.25 R; one inclined by 30 degrees has its center
    at 1 mm, an overlap of 1 mm. The second rod lies."""
    tilts = [about([0, 1, 0], degrees), about([0, 1, 0], 0.0)]
    rods = clump_group([[0.0, 0.0, 2.5e-3], [0.02, 0.0, 2.5e-3]], orientation=tilts)
    scene = build_scene({"rods": rods}, walls={"floor": plane([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])})
    found = list(particle_warnings(plan_for(scene), initial_particles(scene)))
    assert len(found) == (overlap is not None)
    sentence = f"1 of 2 particles are inside walls.floor at the start, by up to {overlap} of the radius"
    assert not found or sentence in found[0]
