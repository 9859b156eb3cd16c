"""Particles on mesh walls against particles on the primitive walls that the meshes approximate."""

import meshio
import numpy as np
import pytest
from geometry.meshes import cube, sheet, tube, write
from scene_builders import build_scene, particle_group, run_to_end

TURNING = {"kind": "rotation", "point": [0.0, 0.6, 0.0], "axis": [0, 1, 0], "angular_velocity": 30.0}
RISING = {"kind": "translation", "velocity": [0.0, 0.0, 0.2]}
CORNER = {"shape": "rectangle", "corner": [0.6, -0.1, 0.0]}
FRICTION, RADIUS, DIRECTION = 0.3, 0.005, np.array([0.6, 0.8])
OVERLAPS = np.array([1e-5, 4e-5])
"""Overlaps [m] of the spheres at rest on the belt."""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working directory, from which scenes without a file read meshes."""
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "two.stl", *sheet(1, 0.4))
    write(tmp_path / "many.obj", *sheet(32, 0.2))
    write(tmp_path / "cube.vtu", *cube())
    write(tmp_path / "tube.ply", *tube(24, 0.1, 0.4))
    grid, corners = sheet(4, 0.2)
    points = np.concatenate([grid + [0.1, 0, 0], grid[:, [2, 1, 0]] + [0.0, 0.0, 0.1]])
    write(tmp_path / "corner.vtk", points, np.concatenate([corners, corners + len(grid)]))
    return tmp_path


def wall(file, **more):
    return {"shape": "mesh", "file": file, "material": "glass", **more}


def on_floor():
    """Positions, velocities and angular velocities of oblique impacts on z = 0, some on vertices and shared
    edges.

    The spacing of the mesh is 6.25 mm.
    """
    rng = np.random.default_rng(0)
    lattice = 0.019 * np.array([[x, y] for x in range(-2, 3) for y in range(-2, 3)])
    positions = np.full((25, 3), 0.0051)
    positions[:, :2] = lattice + rng.uniform(-0.003, 0.003, (25, 2))
    positions[0, :2], positions[7, :2], positions[12, :2] = -0.0375, [-0.01875, 0.0], 0.0
    velocity = rng.normal(0.0, 2.0, (25, 3))
    velocity[:, 2], velocity[12, :2] = -1.0, 0.0
    angular_velocity = rng.normal(0.0, 50.0, (25, 3))
    angular_velocity[12] = 0.0
    return positions, velocity, angular_velocity


def on_other_walls():
    """The same for six particles in the tube, two in the corner, three at the plate, five at the cube and two on the
    belt."""
    angle = np.pi / 6 * np.arange(6)  # centers of facets
    radial = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    in_tube = 0.0949 * radial + [0.0, 0.0, 0.6], radial + [0.0, 0.0, 0.3]
    in_corner = [[0.6051, 0.01, 0.0051], [0.6053, -0.04, 0.0051]], [[-0.7, 0.2, -0.7], [-1.0, 0.0, -0.9]]
    at_plate = [[x, 0.6, 0.0051] for x in (-0.05, 0.0, 0.05)], [[0.0, 0.3, -0.5]] * 3
    from_cube = np.array([[0, 0, 1], [1, 1, 0], [1, 1, 1], [-1, 0, 1], [-1, -1, -1]], float)
    from_cube /= np.linalg.norm(from_cube, axis=1, keepdims=True)
    nearest = np.array([[0, 0.003, 0.05], [0.05, 0.05, 0.01], [0.05] * 3, [-0.05, 0, 0.05], [-0.05] * 3])
    at_cube = nearest + 0.0051 * from_cube - [0.0, 0.0, 0.6], -from_cube
    on_belt = (
        [[side, -0.6 - side, RADIUS - d] for side, d in zip((0.1, -0.1), OVERLAPS, strict=True)],
        [[0.0] * 3] * 2,
    )
    sources = (in_tube, in_corner, at_plate, at_cube, on_belt)
    positions, velocities = (np.concatenate(each) for each in zip(*sources, strict=True))
    return positions, velocities, np.zeros_like(positions)


def impacts(walls):
    """A scene with all these particles."""
    sources = (on_floor(), on_other_walls())
    positions, velocity, angular_velocity = (np.concatenate(all_of) for all_of in zip(*sources, strict=True))
    group = particle_group(positions, 2 * RADIUS, velocity=velocity, angular_velocity=angular_velocity)
    motion = {"kind": "surface_velocity", "velocity": [*(100.0 * DIRECTION), 0.0]}
    walls = walls | {"belt": wall("two.stl", translate=[0, -0.6, 0], motion=motion)}
    return build_scene(
        {"balls": group}, walls, {"friction": FRICTION, "restitution": 0.7},
        run={"duration": 1.2e-3, "velocity_max": 5.0},
        output={"interval": 1.2e-3, "energy_budget": True, "wall_forces": True},
    )  # fmt: skip


PRIMITIVES = {
    "floor": {
        "shape": "rectangle", "corner": [-0.1, -0.1, 0], "sides": [[0.2, 0, 0], [0, 0.2, 0]], "material": "glass",
    },
    "tube": {"shape": "cylinder", "from": [0, 0, 0.4], "to": [0, 0, 0.8], "radius": 0.1, "material": "glass"},
    "low": CORNER | {"sides": [[0.2, 0, 0], [0, 0.2, 0]], "material": "glass"},
    "side": CORNER | {"sides": [[0, 0.2, 0], [0, 0, 0.2]], "material": "glass"},
    "plate": {
        "shape": "rectangle", "corner": [-0.1, 0.5, 0.0], "sides": [[0.2, 0, 0], [0, 0.2, 0]], "material": "glass",
        "motion": [TURNING, RISING],
    },
}  # fmt: skip
MESHES = {
    "floor": wall("many.obj"),
    "tube": wall("tube.ply", translate=[0, 0, 0.4]),
    "corner": wall("corner.vtk", translate=[0.6, 0, 0]),
    "plate": wall("many.obj", translate=[0, 0.6, 0], motion=[TURNING, RISING]),
    "cube": wall("cube.vtu", scale=0.1, translate=[-0.05, -0.05, -0.65]),
}
"""Mesh walls in place of `PRIMITIVES`, and a cube."""


@pytest.mark.slow
def test_meshes_act_as_the_primitive_walls_that_they_replace(taichi_f64, folder):
    """Bit for bit on a flat mesh, including contact history across shared edges; within rounding on other meshes.

    The belt presses two spheres away with F = 4/3 E* sqrt(R) d^(3/2), E* = E / (2 (1 - nu^2)) (Hertz), as the frames
    have it, and gives them mu times their momentum across the belt, but for the first half step.
    """
    exact, _ = run_to_end(impacts(PRIMITIVES))
    found, simulation = run_to_end(impacts(MESHES), out=folder / "out")
    assert np.all(exact.particles["velocity"][:25, 2] > 0.5), "all particles have rebounded from the floor"
    start = np.concatenate([on_floor()[0], on_other_walls()[0]])
    slip = np.abs(found.particles["position"][:25] - start[:25])[:, :2].max()
    assert slip > 0.00442, "particles slide farther than the height of a triangle, across shared edges"
    for name in ("position", "velocity", "angular_velocity"):
        values, expected = found.particles[name], exact.particles[name]
        np.testing.assert_array_equal(values[:25], expected[:25])
        size = np.abs(expected[:36]).max()
        np.testing.assert_allclose(values[25:36], expected[25:36], rtol=0.0, atol=1e-9 * size)
    rebound = found.particles["velocity"][36:41]
    incoming = on_other_walls()[1][11:16]
    np.testing.assert_allclose(rebound, found.particles["velocity"][12, 2] * -incoming, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found.particles["angular_velocity"][36:41], 0.0, atol=1e-9)

    pushed = found.particles["velocity"][41:]
    assert pushed[:, 2].min() > 0.0
    np.testing.assert_allclose(pushed[:, :2], FRICTION * pushed[:, 2:] * DIRECTION, rtol=2e-2)
    forces = 4.0 / 3.0 * 1e8 / (2.0 * (1.0 - 0.25**2)) * np.sqrt(RADIUS) * OVERLAPS**1.5
    frame = meshio.read(folder / "out" / "walls_0000.vtu")
    of_wall = frame.cell_data["wall"][0]
    assert np.bincount(of_wall).tolist() == [mesh.triangle_count for mesh in simulation.plan.meshes.values()]
    pressure, traction = (frame.cell_data[name][0][of_wall == 5] for name in ("pressure", "traction"))
    centroids = frame.points[frame.cells_dict["triangle"][of_wall == 5]].mean(axis=1)
    below_diagonal = centroids[:, 1] + 0.6 < centroids[:, 0]
    assert below_diagonal.sum() == 1
    np.testing.assert_allclose(pressure, np.where(below_diagonal, *forces) / (0.4 * 0.4 / 2.0), rtol=1e-5)
    np.testing.assert_allclose(traction[:, 2], -pressure, rtol=1e-6)
    np.testing.assert_allclose(traction[:, :2], 0.0, atol=1e-6 * pressure.max())
