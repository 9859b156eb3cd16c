"""Walls that touch or overlap act as one surface: each contact counts once, and its history follows the
contact point.

Spheres with friction and rolling friction cross seams during a collision. The expected motion is that on one
plane, because all surfaces lie in the plane z = 0.
"""

import numpy as np
import pytest
from geometry.meshes import cube, sheet, write
from scene_builders import build_scene, column, particle_group, plane, run_and_sample

RADIUS = 2e-3
VELOCITY = np.array([0.4, 0.15, -0.5])
GAP = 1e-4
TIME_TO_SEAM = 4.6e-4
"""From the start to the middle of the collision: 0.2 ms of flight, and half of the loading and unloading."""

PAIR = {"restitution": 0.3, "friction": 0.4, "rolling_friction": 0.1}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working directory, from which scenes without a file read meshes."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def mesh_wall(file, **more):
    return {"shape": "mesh", "file": file, "material": "glass", **more}


def rectangle(corner, *sides):
    return {
        "shape": "rectangle",
        "corner": list(corner),
        "sides": [list(side) for side in sides],
        "material": "glass",
    }


def disc(center, radius, hole_radius=0.0):
    return {
        "shape": "disc", "center": list(center), "normal": [0, 0, 1], "radius": radius, "hole_radius": hole_radius,
        "material": "glass",
    }  # fmt: skip


def brick(low, high):
    """Points and triangles of a closed box."""
    points, corners = cube()
    return np.array(low) + (np.array(high, float) - low) * points, corners


def flat(low, high):
    """Points and triangles of a rectangle in the plane z = 0."""
    points, corners = sheet(1)
    return [*low, 0.0] + (points + [0.5, 0.5, 0.0]) * [high[0] - low[0], high[1] - low[1], 1.0], corners


def together(*surfaces):
    """One surface with the points and triangles of several."""
    starts = np.cumsum([0, *(len(points) for points, _ in surfaces)])
    corners = [corners + start for (_, corners), start in zip(surfaces, starts, strict=False)]
    return np.concatenate([points for points, _ in surfaces]), np.concatenate(corners)


def on_seam(x, y, shares=(-0.4, 0.05, 0.4)):
    """Positions of spheres that cross the line of this x at three times of the collision, near y."""
    start = np.array([x, y, RADIUS + GAP]) - VELOCITY * [TIME_TO_SEAM, TIME_TO_SEAM, 0.0]
    return [start + [share * RADIUS * 0.1, 6e-3 * k, 0.0] for k, share in enumerate(shares)]


def seams(folder):
    """Walls at z = 0 with seams, and positions of spheres that cross them."""
    walls = {}
    positions = []
    # Two closed bodies in one file, whose triangles share no vertex; the second one is deeper and narrower.
    write(folder / "blocks.stl", *together(brick([-0.08, -0.08, -0.02], [-0.06, -0.05, 0]),
                                           brick([-0.06, -0.075, -0.03], [-0.045, -0.053, 0])))  # fmt: skip
    walls["blocks"] = mesh_wall("blocks.stl")
    positions += on_seam(-0.06, -0.072)
    # Overlapping patches of one file, and a rib of the same file that ends at the plate from below.
    write(folder / "patches.stl", *together(flat([-0.03, -0.08], [-0.008, -0.05]),
                                            flat([-0.012, -0.078], [0.01, -0.052]),
                                            brick([-0.0121, -0.09, -0.01], [-0.0101, -0.04, 0])))  # fmt: skip
    walls["patches"] = mesh_wall("patches.stl")
    positions += on_seam(-0.0101, -0.072)
    # A T-junction of two files: the edges of one plate end within the edge of the other.
    write(folder / "wide.stl", *flat([0.02, -0.08], [0.04, -0.04]))
    write(
        folder / "narrow.stl",
        *together(flat([0.04, -0.08], [0.06, -0.069]), flat([0.04, -0.069], [0.06, -0.04])),
    )
    walls |= {"wide": mesh_wall("wide.stl"), "narrow": mesh_wall("narrow.stl")}
    positions += on_seam(0.04, -0.075)
    # Rectangles side by side, and overlapping.
    walls["left"] = rectangle([-0.08, -0.03, 0], [0.02, 0, 0], [0, 0.03, 0])
    walls["right"] = rectangle([-0.06, -0.03, 0], [0.02, 0, 0], [0, 0.03, 0])
    positions += on_seam(-0.06, -0.024)
    walls["below"] = rectangle([-0.03, -0.03, 0], [0.02, 0, 0], [0, 0.03, 0])
    walls["above"] = rectangle([-0.012, 0, 0], [0.03, 0, 0], [0, -0.03, 0])
    positions += on_seam(-0.0118, -0.024)
    # A plug in a floor with a hole; a disc next to a mesh and on a flange of a tube with the same outer
    # radius.
    walls["floor"] = disc([0.05, -0.01, 0], 0.02, 0.01)
    walls["plug"] = disc([0.05, -0.01, 0], 0.01)
    positions += on_seam(0.06, -0.016)
    walls["tube"] = {"shape": "cylinder", "from": [-0.06, 0.02, -0.03], "to": [-0.06, 0.02, 0], "radius": 0.01,
                     "material": "glass"}  # fmt: skip
    walls["cover"] = disc([-0.06, 0.02, 0], 0.01)
    walls["flange"] = disc([-0.06, 0.02, 0], 0.02, 0.01)
    positions += on_seam(-0.05, 0.014)
    write(folder / "frame.stl", *flat([-0.02, 0.005], [0.0, 0.035]))
    walls["frame"] = mesh_wall("frame.stl")
    walls["adjacent"] = rectangle([0.0, 0.005, 0], [0.02, 0, 0], [0, 0.03, 0])
    positions += on_seam(0.0, 0.011)
    # A mesh across the periodic faces.
    write(folder / "across.stl", *flat([-0.1, 0.05], [0.1, 0.09]))
    walls["across"] = mesh_wall("across.stl")
    positions += on_seam(0.1, 0.06, (-0.6, -0.3, 0.0, 0.3))
    # Both sides of a plate without thickness, divided along different diagonals.
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    write(folder / "folded.stl", [-0.08, 0.1, 0] + 0.04 * square,
          np.array([[0, 1, 2], [0, 2, 3], [1, 2, 3], [0, 1, 3]]))  # fmt: skip
    walls["folded"] = mesh_wall("folded.stl")
    positions += on_seam(-0.05, 0.11)
    return walls, np.array(positions)


AWAY, GROUND = 0.2, -0.05
"""Shift along y [m] of the walls with corners, and height [m] of the plane without seams."""


def corners(folder):
    """Walls with grooves and corners, and positions, velocities and greatest numbers of contacts of spheres there.

    A sphere that falls on the middle of a right-angled groove rebounds with the restitution of one wall: along each
    normal, its mass and velocity are those of a collision with that wall alone. On an edge that two walls share, the
    sphere has one contact along the line from the edge.
    """
    a = np.cos(np.pi / 4)
    low, wide = AWAY - 0.05, [0, 0.1, 0]
    walls = {
        "ground": rectangle([-0.08, low, 0], [0.08, 0, 0], wide),
        "post": rectangle([-0.05, low, 0], wide, [0, 0, 0.05]),
        "left_groove": rectangle([0.02, low, 0.02], wide, [-0.02 * a, 0, 0.02 * a]),
        "right_groove": rectangle([0.02, low, 0.02], wide, [0.02 * a, 0, 0.02 * a]),
        "top": rectangle([0.06, low, 0.03], [0.02, 0, 0], wide),
        "side": rectangle([0.06, low, 0.03], [0, 0, -0.02], wide),
    }
    write(folder / "ramp.stl", np.array([[0.02, y, 0.06] for y in (-0.05, 0.05)]
          + [[0.02 + 0.02 * side, y, 0.08] for side in (-1, 1) for y in (-0.05, 0.05)]),
          np.array([[0, 1, 3], [0, 3, 2], [0, 1, 5], [0, 5, 4]]))  # fmt: skip
    walls["ramp"] = mesh_wall("ramp.stl", translate=[0, AWAY, 0])
    away = np.array([-a, 0.0, a])
    positions = np.array([
        [-0.05 + RADIUS + 1e-5, AWAY, RADIUS + 1e-5],
        [0.02, AWAY, 0.02 + (RADIUS + 1e-5) / a],
        [0.02, AWAY, 0.06 + (RADIUS + 1e-5) / a],
        np.array([0.06, AWAY, 0.03]) + (RADIUS + 1e-5) * away,
    ])  # fmt: skip
    velocity = 0.5 * np.array([[-a, 0, -a], [0, 0, -1], [0, 0, -1], -away])
    smooth = {wall: each | {"material": "smooth"} for wall, each in walls.items()}
    return smooth, positions, velocity, [2, 2, 2, 1]


def test_walls_that_touch_act_as_one_surface_and_corners_as_two(taichi_f64, folder):
    """On seams, trajectories and contacts are those on one plane, for all owners and across a periodic boundary.

    Corners and grooves give a contact with each side, also where the walls touch; edges and tips give one.
    """
    walls, positions = seams(folder)
    count = len(positions)
    smooth_walls, smooth_positions, smooth_velocity, contacts = corners(folder)
    walls |= smooth_walls | {"plane": plane([0, 0, GROUND], [0, 0, 1])}
    both = np.concatenate([positions, positions + [0, 0, GROUND]])
    groups = {
        "balls": particle_group(both, 2 * RADIUS, velocity=VELOCITY.tolist(), angular_velocity=[20.0, 50.0, 30.0]),
        "drops": particle_group(smooth_positions, 2 * RADIUS, "smooth", velocity=smooth_velocity),
    }  # fmt: skip
    soft = {"young_modulus": 1e7, "poisson_ratio": 0.25, "density": 2500.0}
    frictionless = {"restitution": 0.6, "friction": 0.0, "rolling_friction": 0.0}
    scene = build_scene(
        groups, walls, PAIR, pairs={"smooth-smooth": frictionless}, rolling="epsd",
        domain={"min": [-0.1, -0.1, -0.1], "max": [0.1, 0.3, 0.1], "periodic": ["x"], "on_exit": "error"},
        materials={"glass": soft, "smooth": soft}, run={"duration": 2e-3, "velocity_max": 0.7},
        output={"interval": 4e-3, "energy_budget": True},
    )  # fmt: skip
    snapshots = run_and_sample(scene, 5e-5, 2e-3)
    counts = column(snapshots, "wall_contact_count")
    assert np.all(counts[:, : 2 * count].sum(axis=0) >= 8), "all are in contact for at least eight samples"
    np.testing.assert_array_equal(counts[:, :count], counts[:, count : 2 * count])
    for name, shift in (("position", [0, 0, GROUND]), ("velocity", 0.0), ("angular_velocity", 0.0)):
        values = column(snapshots, name)
        expected = values[:, count : 2 * count] - shift
        size = np.abs(expected).max()
        np.testing.assert_allclose(values[:, :count], expected, rtol=0.0, atol=1e-8 * size, err_msg=name)
    assert abs(snapshots[-1].totals["energy_error"]) < 1e-3
    velocity = snapshots[-1].particles["velocity"]
    np.testing.assert_allclose(velocity[:count, 2], 0.15, rtol=1e-3)
    np.testing.assert_array_equal(counts[:, 2 * count :].max(axis=0), contacts)
    np.testing.assert_allclose(velocity[2 * count :], -0.6 * smooth_velocity, atol=2e-3)
