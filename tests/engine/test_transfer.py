"""A run that continues on an engine with another plan."""

import numpy as np
import pytest
from geometry.meshes import sheet, write
from scene_builders import build_scene, particle_group, plane

from granflow.engine.checkpoint import renumbered, with_plan
from granflow.plan.build import plan_for
from granflow.simulation import Simulation


def on_a_mesh(**walls):
    """A particle that slides over the triangles of a mesh, with friction."""
    mesh = {"shape": "mesh", "file": "hills.ply", "material": "glass"}
    group = particle_group([[0.05, 0.02, 0.005 - 1e-6]], velocity=[1e-3, 5e-4, 0.0])
    parts = {"gravity": [0.0, 0.0, -9.81], "pair": {"friction": 0.5}}
    return build_scene({"ball": group}, walls={"hills": mesh, **walls}, **parts)


@pytest.mark.slow
def test_contacts_with_triangles_survive_another_wall(taichi_f64, tmp_path, monkeypatch):
    """The numbers of triangles follow those of the walls: with another wall they change, the histories do
    not."""
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "hills.ply", *sheet(5))
    with Simulation(on_a_mesh()) as undisturbed:
        undisturbed.step(400)
        expected = undisturbed.snapshot(contacts=True)
    other = plan_for(on_a_mesh(lid=plane([0.0, 0.0, 0.5], [0.0, 0.0, -1.0])))
    with Simulation(on_a_mesh()) as simulation:
        simulation.step(200)
        assert np.any(simulation.snapshot(contacts=True).contacts["triangle"] >= 0)
        simulation._state._engine = with_plan(simulation.engine, other)
        simulation.engine.advance(200)
        found = simulation.snapshot(contacts=True)
    for name in ("position", "velocity", "angular_velocity"):
        np.testing.assert_array_equal(found.particles[name], expected.particles[name])
    np.testing.assert_array_equal(found.contacts["triangle"], expected.contacts["triangle"])


def test_numbers_of_walls_and_particles_remain(taichi_f64):
    ball = {"ball": particle_group([[0.0] * 3])}
    walls = {
        name: plane([0.0, 0.0, 0.5 * z], [0.0, 0.0, -1.0 * z]) for name, z in (("lid", 1), ("floor", -1))
    }
    before, now = (plan_for(build_scene(ball, walls=dict(list(walls.items())[:count]))) for count in (1, 2))
    np.testing.assert_array_equal(renumbered(np.array([7, 0, -1, -2, -9]), before, now), [7, 0, -1, -3, -10])
