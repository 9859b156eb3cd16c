"""Periodic axes: minimum images, no seam at the boundary, conservation of momentum and energy across it."""

import numpy as np
import pytest
from geometry.meshes import write
from scene_builders import build_scene, column, particle_group, plane, run_and_sample, run_to_end, times

from granflow.errors import SceneError
from granflow.load import Scene
from granflow.particles.insertion import initial_particles
from granflow.plan.build import plan_for

GRAVITY = 9.81


def domain(size, axes):
    """A box from the origin that is periodic along some axes."""
    return {"min": [0.0] * 3, "max": list(size), "periodic": list(axes), "on_exit": "error"}


def in_box(groups, size, axes, **parts):
    """A scene in a box from the origin; the box that is periodic along x and y has a floor that ends at its
    boundary and has no friction, all others no wall. The chunk size is the same: one structure."""
    corner = {"corner": [0, 0, 0], "sides": [[size[0], 0, 0], [0, size[1], 0]]}
    walls = {"floor": {"shape": "rectangle", "material": "steel"} | corner} if axes == "xy" else None
    usual = {
        "pair": {"friction": 0.4, "restitution": 0.7},
        "output": {"interval": 0.01, "energy_budget": True},
    }
    usual |= {"pairs": {"glass-steel": {"friction": 0.0, "restitution": 0.7}}} if walls else {}
    numerics = {"chunk_size": 37} | parts.pop("numerics", {})
    return build_scene(groups, walls, domain=domain(size, axes), numerics=numerics, **(usual | parts))


def gas(shift):
    """Rough particles that start on a close lattice, collide and cross every face of a box of 4 cm."""
    rng = np.random.default_rng(3)
    positions = 0.01 * (np.argwhere(np.ones((4, 4, 4))) + 0.5)
    velocity = rng.normal(0.0, 0.3, positions.shape)
    group = particle_group((positions + shift) % 0.04, 0.0099, velocity=velocity - velocity.mean(axis=0))
    run = {"duration": 0.02, "velocity_max": 5.0}
    return in_box({"balls": group}, [0.04] * 3, "xyz", run=run, numerics={"skin": 0.001})


def test_shifting_all_particles_by_half_a_box_changes_rounding_only(taichi_f64):
    """A lattice across the boundary and one in the middle agree to rounding, including angular velocities.

    Momentum is conserved, the energy budget closes, and branches of contacts are minimum images.
    """
    shift = [0.02, 0.017, 0.013]
    middle, simulation = run_to_end(gas(0.0))
    *_, shifted = run_and_sample(gas(shift), 0.01, contacts=True)
    assert simulation.engine.timing.rebuild_count > 4
    assert middle.totals["friction_dissipation"] > 1e-3
    for name in ("velocity", "angular_velocity", "force"):
        largest = np.abs(middle.particles[name]).max()
        np.testing.assert_allclose(
            middle.particles[name], shifted.particles[name], atol=1e-6 * largest, rtol=0
        )
    position = shifted.particles["position"]
    separation = (position - middle.particles["position"] - shift) / 0.04
    np.testing.assert_allclose(separation, np.round(separation), atol=1e-9)
    assert np.all((position >= 0.0) & (position <= 0.04))
    momentum = shifted.particles["mass"][:, None] * shifted.particles["velocity"]
    np.testing.assert_allclose(momentum.sum(axis=0), 0.0, atol=1e-13 * np.abs(momentum).sum())
    np.testing.assert_allclose(shifted.particles["force"].sum(axis=0), 0.0, atol=1e-9)
    assert abs(shifted.totals["energy_error"]) < 1e-3
    contacts = shifted.contacts
    branches = np.linalg.norm(contacts["position_i"] - contacts["position_j"], axis=1)
    np.testing.assert_allclose(branches, 0.0099 - contacts["overlap"], rtol=1e-9)
    assert np.any(np.abs(contacts["position_j"] - 0.02) > 0.02), "some contacts cross the boundary"


def test_particle_that_falls_out_of_the_box_reenters_at_the_top(taichi_f64):
    """Free fall over s takes t = sqrt(2 s / g); gravity adds m g L per crossing; the meter counts no wrap."""
    size, drop = 0.1, 0.62
    run = {"duration": float(np.sqrt(2.0 * drop / GRAVITY)), "velocity_max": 5.0, "time_step": 1e-5}
    meters = {"middle": {"point": [0.05, 0.05, 0.05], "normal": [0, 0, -1]}}
    output = {"interval": 0.01, "energy_budget": True, "flow_meters": meters}
    ball = {"ball": particle_group([[0.05, 0.05, 0.09]])}
    scene = in_box(ball, [size] * 3, "xyz", gravity=[0.0, 0.0, -GRAVITY], output=output, run=run)
    last, simulation = run_to_end(scene)
    mass = last.particles["mass"][0]
    assert last.totals["boundary_work"] == pytest.approx(6 * mass * GRAVITY * size, rel=1e-12)
    assert last.totals["kinetic_energy"] == pytest.approx(mass * GRAVITY * drop, rel=1e-3)
    assert abs(last.totals["energy_error"]) < 1e-4
    assert last.particles["position"][0, 2] == pytest.approx(0.09 - drop + 6 * size, abs=1e-4)
    assert simulation.observers.readings()["flow_meters"]["middle"]["flow_count"] == 6


def test_floor_that_ends_at_the_boundary_has_no_seam(taichi_f64):
    """A particle that slides across the boundary keeps the height of one in the middle, to the last bit."""
    at = [[0.09, 0.02, 0.0049], [0.05, 0.08, 0.0049]]
    group = particle_group(at, velocity=[[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    scene = in_box(
        {"balls": group}, [0.1] * 3, "xy", gravity=[0.0, 0.0, -GRAVITY], numerics={"skin": 0.002},
        run={"duration": 0.03, "velocity_max": 2.0, "time_step": 1e-5},
    )  # fmt: skip
    snapshots = run_and_sample(scene, 1e-4)
    position = column(snapshots, "position")
    assert np.ptp(position[:, 1, 2]) > 1e-5, "both particles bounce"
    np.testing.assert_array_equal(position[:, 0, 2], position[:, 1, 2])
    np.testing.assert_allclose(position[:, 0, 0], (0.09 + times(snapshots)) % 0.1, atol=1e-12)


def planned(wall, **parts):
    """Plan of a particle and a wall in a box of 10 cm that is periodic along x."""
    ball = {"ball": particle_group([[0.05, 0.05, 0.08]])}
    wall = {"material": "glass"} | wall
    return plan_for(build_scene(ball, {"wall": wall}, domain=domain([0.1] * 3, "x"), **parts))


TUBE = {"shape": "cylinder", "from": [0, 0.05, 0.05], "to": [0.1, 0.05, 0.05], "radius": 0.04}
DISC = {"shape": "disc", "center": [0.05, 0.05, 0.05], "normal": [0, 0, 1], "radius": 0.048}
BAR = {"shape": "rectangle", "corner": [-0.02, 0.05, 0.05], "sides": [[0.14, 0, 0], [0, 0.02, 0]]}
SHORT = {"shape": "rectangle", "corner": [0.02, 0.03, 0.05], "sides": [[0.06, 0, 0], [0, 0.04, 0]]}
WIDE = SHORT | {"corner": [0.02, 0.01, 0.05], "sides": [[0.06, 0, 0], [0, 0.08, 0]]}
LONG = {"shape": "rectangle", "corner": [-0.07, 0, 0.02], "sides": [[0.25, 0, 0], [0, 0.1, 0]]}
FLOOR = plane([0, 0, 0.02], [0, 0, 1])


@pytest.mark.parametrize(
    ("wall", "turns_about", "slides", "fits"),
    [
        (plane([0, 0, 0.02], [1, 0, 1]), None, None, False),
        (TUBE, None, None, True),
        (TUBE | {"to": [0.09, 0.05, 0.05]}, None, None, False),
        (DISC, [0, 0, 1], None, True),  # from 2 to 98 mm, but round
        (DISC, [0, 1, 0], None, False),
        (FLOOR, [0, 1, 0], None, False),
        (BAR, [1, 0, 0], None, True),
        (SHORT, [0, 0, 1], None, True),
        (WIDE, [0, 0, 1], None, False),
        (LONG, None, [0, 0.06, 0.06], True),  # y is not periodic
        (LONG, None, [0.06, 0, 0], True),  # from -10 to 240 mm
        (LONG, None, [0.08, 0, 0], False),  # from 10 mm
    ],
)
def test_wall_without_an_image_at_the_ends_of_a_periodic_axis_is_rejected(wall, turns_about, slides, fits):
    """A wall that turns through the boundary has no image, unless its image is itself; WIDE reaches 50 mm
    sqrt(0.36 + 0.64) from its center to the ends. Of sliding, only the stage counts, which takes 1 s."""
    message = "walls.wall differs between the two ends of the periodic axis x"
    parts = {"run": {"velocity_max": 1.0, "time_step": 1e-6}}
    parts["stages"] = [{"name": "wait", "duration": 9.0}, {"name": "move", "duration": 1.0}]
    if turns_about:
        turn = {"kind": "rotation", "point": [0.05, 0.05, 0.05], "axis": turns_about, "angular_velocity": 3.0}
        wall, message = wall | {"motion": turn}, "walls.wall rotates through the ends of the periodic axis x"
    if slides:
        slide = {"kind": "translation", "velocity": slides, "stages": ["move"]}
        wall, message = wall | {"motion": slide}, "walls.wall ends, and moves along the periodic axis x"
    if fits:
        assert planned(wall, **parts).walls
    else:
        with pytest.raises(SceneError, match=message):
            planned(wall, **parts)


def test_a_periodic_mesh_continues_beyond_both_ends(tmp_path, monkeypatch):
    """A wavy sheet of two whole periods lacks its image next to the ends, unless it goes on there."""
    monkeypatch.chdir(tmp_path)  # in which scenes without a file look for meshes
    for beyond in (0.02, 0.0):
        x, y = np.meshgrid(np.arange(-beyond, 0.1005 + beyond, 0.005), [0.0, 0.1], indexing="ij")
        points = np.stack([x, y, 0.05 + 0.01 * np.sin(40.0 * np.pi * x)], axis=-1).reshape(-1, 3)
        a = np.arange(0, len(points) - 2, 2)
        corners = np.concatenate([[a, a + 1, a + 2], [a + 1, a + 3, a + 2]], axis=1).T
        write(tmp_path / f"wave_{beyond}.obj", points, corners)
    assert planned({"shape": "mesh", "file": "wave_0.02.obj"}).walls
    with pytest.raises(SceneError, match="Continue it by .* m beyond both ends with the shape of its image"):
        planned({"shape": "mesh", "file": "wave_0.0.obj"})


def test_box_too_narrow_for_minimum_images_and_unbounded_turning_walls_are_rejected():
    """Below two maximum diameters plus twice the skin, 21 mm + 2 mm, a particle can touch two images of another."""
    ball = {"balls": particle_group([[0.01, 0.01, 0.01]], 0.0105)}
    numerics = {"skin": 0.001}
    plan_for(build_scene(ball, domain=domain([0.02301] * 3, "xyz"), numerics=numerics))
    with pytest.raises(SceneError, match=r"has y, along which the domain is 0.022 m wide.*at least 0.023 m"):
        plan_for(build_scene(ball, domain=domain([0.1, 0.022, 0.1], "xy"), numerics=numerics))
    turn = [{"kind": "rotation", "point": [0, 0, 0], "axis": [1, 0, 0], "angular_velocity": 1.0}]
    expanding = {"min": [0.0] * 3, "max": [0.1] * 3, "on_exit": "expand"}
    with pytest.raises(SceneError, match="walls.floor is unbounded and rotates"):
        plan_for(build_scene(ball, {"floor": FLOOR | {"motion": turn}}, domain=expanding))


def test_plane_across_the_axis_that_is_not_periodic_has_the_area_of_the_section():
    """A servo with a pressure presses with pressure times area; along one periodic axis the area is infinite, as
    that of an inclined plane."""
    servo = {"kind": "servo", "direction": [0, 0, -1], "pressure": 5e3, "velocity_max": 0.1}
    lid = plane([0, 0, 0.09], [0, 0, -2], motion=servo)

    def scene(axes, lid):
        ball = {"ball": particle_group([[0.05, 0.02, 0.05]])}
        output = {"interval": 0.1, "wall_forces": True}
        return build_scene(ball, {"lid": lid}, domain=domain([0.1, 0.04, 0.1], axes), output=output)

    plan = plan_for(scene("yx", lid))
    assert plan.measured_areas == {"lid": pytest.approx(0.004)}
    assert plan.controlled_motions[0].force == pytest.approx(5e3 * 0.1 * 0.04)
    with pytest.raises(SceneError, match="pressure is 5000.0, but a plane is infinite and has no area"):
        Scene.from_dict(scene("x", lid).to_dict())
    inclined = lid | {"point": [0, 0.04, 0.09], "normal": [0, 1, -1], "motion": []}
    assert plan_for(scene("x", inclined)).measured_areas == {"lid": None}


def test_packing_does_not_overlap_periodic_images():
    """A particle at a corner of the box has seven images, which the packing must not overlap."""
    region = {"box": {"min": [0.0] * 3, "max": [0.1] * 3}}
    pack = {"material": "glass", "count": 300, "diameter": 0.01, "insert": {"kind": "pack", "region": region}}
    corner = particle_group([[0.001, 0.099, 0.001]], 0.04)
    scene = build_scene({"corner": corner, "pack": pack}, domain=domain([0.1] * 3, "xyz"))
    position = initial_particles(scene).position
    images = scene.domain.periodic_box().nearest_images(position[1:], position[:1])
    distance, inside = (np.linalg.norm(each - position[0], axis=1) for each in (images, position[1:]))
    assert distance.min() >= 0.025 and np.count_nonzero(inside - distance > 0.001) > 10
