"""Balls on meshes: as on the walls they stand for."""

import numpy as np
import pytest
from trials import balls, finished, plane, trial
from walls.meshes import sheet, tube, write


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder that scenes without a file look for meshes in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def wall(file, **more):
    return {"shape": "mesh", "file": file, "material": "glass", **more}


def bouncing(walls, **parts):
    """Forty spinning balls that hit the plane z = 0 askew, some right above corners and seams of a grid of 0.0125."""
    rng = np.random.default_rng(0)
    lattice = 0.019 * np.array([[x, y] for x in range(-4, 4) for y in range(-2, 3)])
    places = np.concatenate([lattice + rng.uniform(-0.003, 0.003, (40, 2)), np.full((40, 1), 0.0051)], axis=1)
    places[0, :2], places[20, :2], places[22, :2] = -0.075, [0.0, -0.0375], 0.0
    velocity = rng.normal(0.0, 0.3, (40, 3))
    velocity[:, 2], velocity[22, :2] = -1.0, 0.0
    group = balls(places, 0.01, velocity=velocity, spin=rng.normal(0.0, 50.0, (40, 3)))
    given = {"pair": {"friction": 0.3, "restitution": 0.7}, "run": {"duration": 1.2e-3, "velocity_max": 1.5}}
    domain = {"min": [-0.2] * 3, "max": [0.2] * 3, "leaving": "error"}
    return trial({"balls": group}, walls=walls, domain=domain, **(given | parts))


@pytest.mark.parametrize("law", ["zhou", "hertz"])
def test_a_flat_mesh_gives_the_bits_of_a_plane(taichi_f64, folder, law):
    """Over two triangles and over 2048, while contacts slide over seams with what they remember."""
    write(folder / "two.stl", *sheet(1, 0.4))
    write(folder / "many.obj", *sheet(32, 0.4))
    floors = {"plane": plane([0, 0, 0], [0, 0, 1]), "two": wall("two.stl"), "many": wall("many.obj")}
    output = {"interval": 1.0, "energy": True}
    ends = {name: finished(bouncing({"floor": each}, normal=law, output=output))[0] for name, each in floors.items()}
    assert np.all(ends["plane"].particles["velocity"][:, 2] > 0.5), "all have left the floor"
    for name in ("two", "many"):
        for quantity in ("position", "velocity", "spin"):
            np.testing.assert_array_equal(ends[name].particles[quantity], ends["plane"].particles[quantity])
        assert ends[name].totals["energy_error"] == ends["plane"].totals["energy_error"]


def test_a_ball_hits_the_middle_of_a_facet_as_it_hits_the_tube(taichi_f64, folder):
    """From within, on facets that touch the tube: the normal is the same there."""
    write(folder / "tube.ply", *tube(24, 0.1, 0.4))
    inside = [
        0.0939 * np.cos(a) * np.array([1, 0, 0]) + 0.0939 * np.sin(a) * np.array([0, 1, 0]) + [0, 0, 0.2]
        for a in (0.0, np.pi / 2, np.pi)
    ]
    group = balls(inside, 0.01, velocity=[[1, 0, 0.4], [0, 1, -0.4], [-1, 0, 0.0]])
    parts = {"pair": {"friction": 0.3, "restitution": 0.7}, "run": {"duration": 2.2e-3, "velocity_max": 1.5}}
    primitive = {"shape": "cylinder", "from": [0, 0, 0], "to": [0, 0, 0.4], "radius": 0.1, "material": "glass"}
    ends = [finished(trial({"b": group}, walls={"tube": each}, **parts))[0] for each in (primitive, wall("tube.ply"))]
    for quantity in ("velocity", "spin"):
        exact, found = (each.particles[quantity] for each in ends)
        np.testing.assert_allclose(found, exact, rtol=0.0, atol=1e-6 * np.abs(exact).max())
    assert ends[0].particles["velocity"][0, 0] < -0.5
