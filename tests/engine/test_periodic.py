"""Periodic axes: minimum images, no seam at the boundary, conservation of momentum and energy across it."""

import numpy as np
import pytest
from geometry.meshes import write
from scene_builders import (
    assert_lists_hold,
    build_scene,
    column,
    particle_group,
    plane,
    prepared_simulation,
    run_and_sample,
    run_to_end,
    times,
)
from scipy.spatial import cKDTree

from granflow.errors import SceneError
from granflow.load import Scene
from granflow.particles.insertion import initial_particles
from granflow.plan.build import plan_for

GRAVITY = 9.81


def domain(size, axes):
    """A box from the origin that is periodic along some axes."""
    return {"min": [0.0] * 3, "max": list(size), "periodic": list(axes), "on_exit": "error"}


@pytest.mark.parametrize("axes", ["xyz", pytest.param("xy", marks=pytest.mark.slow)])
def test_neighbor_list_holds_exactly_the_candidate_pairs_of_minimum_images(taichi_f64, axes):
    """Compared with a search over all pairs; the grid has eight cells along x, three along y and two along
    z."""
    size = np.array([0.15, 0.06, 0.037])
    skin = 0.002
    rng = np.random.default_rng(5)
    positions = size * rng.random((500, 3))
    diameter = rng.uniform(0.006, 0.016, 500)
    simulation = prepared_simulation(
        in_box(
            {"balls": particle_group(positions, diameter)},
            size,
            axes,
            numerics={"chunk_size": 37, "skin": skin},
        )
    )
    periodic = np.array([axis in axes for axis in "xyz"])
    tree = cKDTree(positions, boxsize=np.where(periodic, size, 10.0))
    pairs = tree.query_pairs(0.018, output_type="ndarray")
    distance = positions[pairs[:, 0]] - positions[pairs[:, 1]]
    distance -= np.where(periodic, np.round(distance / size) * size, 0.0)
    is_candidate = np.linalg.norm(distance, axis=1) < 0.5 * diameter[pairs].sum(axis=1) + skin
    assert is_candidate.sum() > 200
    assert_lists_hold(simulation, pairs[is_candidate])
    simulation.free()


def in_box(groups, size, axes, **parts):
    """A scene in a box from the origin; the box that is periodic along x and y has a floor that ends at its
    boundary and has no friction, all others no wall."""
    corner = {"corner": [0, 0, 0], "sides": [[size[0], 0, 0], [0, size[1], 0]]}
    walls = {"floor": {"shape": "rectangle", "material": "steel"} | corner} if axes == "xy" else None
    usual = {
        "pair": {"friction": 0.4, "restitution": 0.7},
        "output": {"interval": 0.01, "energy_budget": True},
    }
    usual |= {"pairs": {"glass-steel": {"friction": 0.0, "restitution": 0.7}}} if walls else {}
    return build_scene(groups, walls, domain=domain(size, axes), **(usual | parts))


def gas(shift, **run):
    """Rough particles that start on a close lattice, collide and cross every face of a box of 4 cm.

    The chunk size is that of the neighbor lists above: one structure.
    """
    rng = np.random.default_rng(3)
    positions = 0.01 * (np.argwhere(np.ones((4, 4, 4))) + 0.5)
    velocity = rng.normal(0.0, 0.3, positions.shape)
    group = particle_group((positions + shift) % 0.04, 0.0099, velocity=velocity - velocity.mean(axis=0))
    run = {"duration": 0.02, "velocity_max": 5.0} | run
    return in_box({"balls": group}, [0.04] * 3, "xyz", run=run, numerics={"chunk_size": 37, "skin": 0.001})


def test_shifting_all_particles_by_half_a_box_changes_rounding_only(taichi_f64):
    """A lattice across the boundary and one in the middle agree to rounding, including angular velocities."""
    (middle, simulation), (shifted, _) = run_to_end(gas(0.0)), run_to_end(gas([0.02, 0.017, 0.0]))
    assert simulation.engine.timing.rebuild_count > 4
    assert middle.totals["friction_dissipation"] > 1e-3
    for name in ("velocity", "angular_velocity", "force"):
        largest = np.abs(middle.particles[name]).max()
        np.testing.assert_allclose(
            middle.particles[name], shifted.particles[name], atol=1e-6 * largest, rtol=0
        )
    separation = (shifted.particles["position"] - middle.particles["position"] - [0.02, 0.017, 0.0]) / 0.04
    np.testing.assert_allclose(separation, np.round(separation), atol=1e-9)
    assert np.all((shifted.particles["position"] >= 0.0) & (shifted.particles["position"] <= 0.04))


def test_gas_conserves_momentum_and_closes_its_energy_budget(taichi_f64):
    *_, last = run_and_sample(gas(0.013), 0.01, contacts=True)
    mass = last.particles["mass"][:, None]
    scale = np.sum(mass * np.abs(last.particles["velocity"]))
    np.testing.assert_allclose(np.sum(mass * last.particles["velocity"], axis=0), 0.0, atol=1e-13 * scale)
    np.testing.assert_allclose(last.particles["force"].sum(axis=0), 0.0, atol=1e-9)
    assert abs(last.totals["energy_error"]) < 1e-3
    branches = last.contacts["position_i"] - last.contacts["position_j"]
    np.testing.assert_allclose(np.linalg.norm(branches, axis=1), 0.0099 - last.contacts["overlap"], rtol=1e-9)
    assert np.any(np.abs(last.contacts["position_j"] - 0.02) > 0.02), "some contacts cross the boundary"


def test_particle_that_falls_out_of_the_box_reenters_at_the_top(taichi_f64):
    """Free fall over s takes t = sqrt(2 s / g); gravity adds m g L per crossing; the meter counts no wrap."""
    size = 0.1
    drop = 0.62
    duration = float(np.sqrt(2.0 * drop / GRAVITY))
    output = {
        "interval": 0.01, "energy_budget": True,
        "flow_meters": {"middle": {"point": [0.05, 0.05, 0.05], "normal": [0, 0, -1]}},
    }  # fmt: skip
    scene = in_box(
        {"ball": particle_group([[0.05, 0.05, 0.09]])}, [size] * 3, "xyz", gravity=[0.0, 0.0, -GRAVITY], output=output,
        run={"duration": duration, "velocity_max": 5.0, "time_step": 1e-5},
    )  # fmt: skip
    last, simulation = run_to_end(scene)
    mass = last.particles["mass"][0]
    assert last.totals["boundary_work"] == pytest.approx(6 * mass * GRAVITY * size, rel=1e-12)
    assert last.totals["kinetic_energy"] == pytest.approx(mass * GRAVITY * drop, rel=1e-3)
    assert abs(last.totals["energy_error"]) < 1e-4
    assert last.particles["position"][0, 2] == pytest.approx(0.09 - drop + 6 * size, abs=1e-4)
    assert simulation.observers.readings()["flow_meters"]["middle"]["flow_count"] == 6


def test_floor_that_ends_at_the_boundary_has_no_seam(taichi_f64):
    """A particle that slides across the boundary keeps the height of one in the middle, to the last bit."""
    group = particle_group(
        [[0.09, 0.02, 0.0049], [0.05, 0.08, 0.0049]], velocity=[[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    )
    scene = in_box(
        {"balls": group}, [0.1] * 3, "xy", gravity=[0.0, 0.0, -GRAVITY], numerics={"skin": 0.002},
        run={"duration": 0.03, "velocity_max": 2.0, "time_step": 1e-5},
    )  # fmt: skip
    snapshots = run_and_sample(scene, 1e-4)
    position = column(snapshots, "position")
    time = times(snapshots)
    assert np.ptp(position[:, 1, 2]) > 1e-5, "both particles bounce"
    np.testing.assert_array_equal(position[:, 0, 2], position[:, 1, 2])
    np.testing.assert_allclose(position[:, 0, 0], (0.09 + time) % 0.1, atol=1e-12)


def test_box_too_narrow_for_minimum_images_is_rejected():
    """Below two maximum diameters plus twice the skin, 21 mm + 2 mm, a particle can touch two images of
    another."""
    group = {"balls": particle_group([[0.01, 0.01, 0.01]], 0.0105)}
    parts = {"numerics": {"skin": 0.001}, "pair": {}}
    plan_for(build_scene(group, domain=domain([0.02301] * 3, "xyz"), **parts))
    with pytest.raises(SceneError, match=r"has y, along which the domain is 0.022 m wide.*at least 0.023 m"):
        plan_for(build_scene(group, domain=domain([0.1, 0.022, 0.1], "xy"), **parts))


@pytest.mark.parametrize(
    ("wall", "fits"),
    [
        (plane([0, 0, 0.02], [0, 0, 1]), True),
        (plane([0, 0, 0.02], [1, 0, 1]), False),
        (plane([0, 0, 0.02], [0, 1, 1]), True),
        ({"shape": "cylinder", "from": [0, 0.05, 0.05], "to": [0.1, 0.05, 0.05], "radius": 0.04}, True),
        ({"shape": "cylinder", "from": [0, 0.05, 0.05], "to": [0.09, 0.05, 0.05], "radius": 0.04}, False),
        ({"shape": "cylinder", "from": [0.02, 0.05, 0.05], "to": [0.08, 0.05, 0.05], "radius": 0.04}, True),
        ({"shape": "disc", "center": [0.001, 0.05, 0.05], "normal": [1, 0, 0], "radius": 0.01}, False),
    ],
)
def test_wall_that_differs_at_the_ends_of_a_periodic_axis_is_rejected(wall, fits):
    scene = build_scene(
        {"ball": particle_group([[0.05] * 3])},
        walls={"wall": {"material": "glass"} | wall},
        domain=domain([0.1] * 3, "x"),
    )
    if fits:
        assert plan_for(scene).walls
    else:
        with pytest.raises(
            SceneError, match="walls.wall differs between the two ends of the periodic axis x"
        ):
            plan_for(scene)


@pytest.mark.parametrize("beyond", [0.0, 0.02])
def test_a_periodic_mesh_continues_beyond_both_ends(beyond, tmp_path, monkeypatch):
    """A wavy sheet of two whole periods lacks its image next to the ends, unless it goes on there."""
    monkeypatch.chdir(tmp_path)  # in which scenes without a file look for meshes
    x, y = np.meshgrid(np.arange(-beyond, 0.1005 + beyond, 0.005), [0.0, 0.1], indexing="ij")
    points = np.stack([x, y, 0.05 + 0.01 * np.sin(40.0 * np.pi * x)], axis=-1).reshape(-1, 3)
    a = np.arange(0, len(points) - 2, 2)
    write(tmp_path / "wave.obj", points, np.concatenate([[a, a + 1, a + 2], [a + 1, a + 3, a + 2]], axis=1).T)
    scene = build_scene(
        {"ball": particle_group([[0.05, 0.05, 0.08]])},
        walls={"wall": {"shape": "mesh", "file": "wave.obj", "material": "glass"}},
        domain=domain([0.1] * 3, "x"),
    )
    if beyond:
        assert plan_for(scene).walls
    else:
        with pytest.raises(
            SceneError, match="Continue it by .* m beyond both ends with the shape of its image"
        ):
            plan_for(scene)


DISC = {"shape": "disc", "center": [0.05, 0.05, 0.05], "radius": 0.03}
BAR = {"shape": "rectangle", "corner": [-0.02, 0.05, 0.05], "sides": [[0.14, 0, 0], [0, 0.02, 0]]}
SHORT = {"shape": "rectangle", "corner": [0.02, 0.03, 0.05], "sides": [[0.06, 0, 0], [0, 0.04, 0]]}
"""A bar along the periodic axis x, through both ends, and one in the middle of the box, 20 mm from them."""


@pytest.mark.parametrize(
    ("wall", "axis", "fits"),
    [
        (DISC | {"normal": [1, 0, 0]}, [1, 0, 0], True),
        (DISC | {"normal": [0, 0, 1], "radius": 0.048}, [0, 0, 1], True),  # from 2 to 98 mm, but round
        (DISC | {"normal": [0, 0, 1], "radius": 0.048}, [0, 1, 0], False),
        (plane([0, 0, 0.02], [0, 0, 1]), [0, 0, 1], True),
        (plane([0, 0, 0.02], [0, 0, 1]), [1, 0, 0], True),
        (plane([0, 0, 0.02], [0, 0, 1]), [0, 1, 0], False),
        ({"shape": "cylinder", "from": [0, 0.05, 0.05], "to": [0.1, 0.05, 0.05], "radius": 0.04}, [1, 0, 0], True),
        (BAR, [1, 0, 0], True),
        (BAR, [0, 0, 1], False),
        (SHORT, [0, 0, 1], True),
        (SHORT | {"corner": [0.02, 0.01, 0.05], "sides": [[0.06, 0, 0], [0, 0.08, 0]]}, [0, 0, 1], False),
    ],
)  # fmt: skip
def test_wall_that_rotates_through_a_periodic_boundary_is_rejected(wall, axis, fits):
    """It has no image there, unless its image is itself. The last bar reaches 50 mm sqrt(0.36 + 0.64) from its
    center to the ends."""
    turn = {"kind": "rotation", "point": [0.05, 0.05, 0.05], "axis": axis, "angular_velocity": 3.0}
    scene = build_scene(
        {"ball": particle_group([[0.05, 0.05, 0.08]])}, walls={"wall": {"material": "glass", "motion": turn} | wall},
        domain=domain([0.1] * 3, "x"), run={"duration": 5.0, "velocity_max": 1.0},
    )  # fmt: skip
    if fits:
        assert plan_for(scene).walls
    else:
        with pytest.raises(SceneError, match="walls.wall rotates through the ends of the periodic axis x"):
            plan_for(scene)


SLAB = {"shape": "rectangle", "corner": [0, 0, 0.02], "sides": [[0.1, 0, 0], [0, 0.1, 0]]}
LONG = SLAB | {"corner": [-0.07, 0, 0.02], "sides": [[0.25, 0, 0], [0, 0.1, 0]]}


@pytest.mark.parametrize(
    ("wall", "velocity", "fits"),
    [
        (SLAB, [0.06, 0, 0], False),  # 60 mm in 1 s, more than half of the box
        (SLAB, [0.001, 0, 0], False),
        (SLAB, [10, 0, 0], False),  # many times the width of the box
        (SLAB, [0, 0, 0.06], True),
        (SLAB, [0, 0.06, 0], True),  # y is not periodic
        (LONG, [0.06, 0, 0], True),  # from -10 to 240 mm
        (LONG, [0.08, 0, 0], False),  # from 10 mm
        (plane([0, 0, 0.02], [0, 0, 1]), [10, 0, 0], True),
    ],
)
def test_wall_that_slides_out_of_a_periodic_box_is_rejected(wall, velocity, fits):
    """Only the stage with the motion counts, which takes 1 s."""
    motion = {"kind": "translation", "velocity": velocity, "stages": ["slide"]}
    scene = build_scene(
        {"ball": particle_group([[0.05] * 3])},
        walls={"wall": {"material": "glass", "motion": motion} | wall},
        domain=domain([0.1] * 3, "x"),
        stages=[{"name": "wait", "duration": 9.0}, {"name": "slide", "duration": 1.0}],
        run={"time_step": 1e-6},
    )
    if fits:
        assert plan_for(scene).walls
    else:
        with pytest.raises(SceneError, match="walls.wall ends, and moves along the periodic axis x"):
            plan_for(scene)


def test_plane_across_the_axis_that_is_not_periodic_has_the_area_of_the_section():
    """A servo with a pressure presses with pressure times area; along one periodic axis
    the area is infinite, as that of an inclined plane."""
    lid = plane([0, 0, 0.09], [0, 0, -2]) | {
        "motion": {"kind": "servo", "direction": [0, 0, -1], "pressure": 5e3, "velocity_max": 0.1}
    }

    def scene(axes, **walls):
        ball = {"ball": particle_group([[0.05, 0.02, 0.05]])}
        output = {"interval": 0.1, "wall_forces": True}
        return build_scene(ball, {"lid": lid, **walls}, domain=domain([0.1, 0.04, 0.1], axes), output=output)

    plan = plan_for(scene("yx"))
    assert plan.measured_areas == {"lid": pytest.approx(0.004)}
    assert plan.controlled_motions[0].force == pytest.approx(5e3 * 0.1 * 0.04)
    with pytest.raises(SceneError, match="pressure is 5000.0, but a plane is infinite and has no area"):
        Scene.from_dict(scene("x").to_dict())
    for normal in ([0, 1, -1], [0, -1, 0]):
        other = lid | {"point": [0, 0.04, 0.09], "normal": normal, "motion": []}
        assert plan_for(scene("x", lid=other)).measured_areas == {"lid": None}


def test_packing_does_not_overlap_periodic_images():
    """A particle at a corner of the box has seven images, which the packing must not overlap."""
    scene = build_scene(
        {
            "corner": particle_group([[0.001, 0.099, 0.001]], 0.04),
            "pack": {
                "material": "glass", "count": 300, "diameter": 0.01,
                "insert": {"kind": "pack", "region": {"box": {"min": [0.0] * 3, "max": [0.1] * 3}}},
            },
        },
        domain=domain([0.1] * 3, "xyz"),
    )  # fmt: skip
    particles = initial_particles(scene)
    periodic_box = scene.domain.periodic_box()
    gaps = (
        np.linalg.norm(
            periodic_box.nearest_images(particles.position[1:], particles.position[:1])
            - particles.position[0],
            axis=1,
        )
        - 0.025
    )
    assert gaps.min() >= 0.0
    assert (
        np.count_nonzero(
            np.linalg.norm(particles.position[1:] - particles.position[0], axis=1) - gaps > 0.026
        )
        > 10
    )


def test_unbounded_rotating_wall_is_rejected_in_an_expanding_domain():
    rotation = [{"kind": "rotation", "point": [0, 0, 0], "axis": [1, 0, 0], "angular_velocity": 1.0}]
    parts = {"domain": {"min": [0.0] * 3, "max": [0.1] * 3, "on_exit": "expand"}}
    floor = plane([0, 0, 0], [0, 0, 1], motion=rotation)
    with pytest.raises(SceneError, match="walls.floor is unbounded and rotates"):
        plan_for(build_scene({"ball": particle_group([[0.05] * 3])}, walls={"floor": floor}, **parts))
