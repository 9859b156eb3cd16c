"""Mesh contacts on the device equal the numpy reference."""

import numpy as np
from geometry.meshes import cube, sheet, tube, write
from scene_builders import build_scene, particle_group

from granflow.engine import backend
from granflow.engine.state import State
from granflow.geometry.mesh_contact import triangle_contacts, triangle_distances
from granflow.geometry.surface import FAR_AWAY
from granflow.kernel_language import ti
from granflow.plan.build import plan_for


def all_meshes(folder):
    """A plan with a cube, a bumpy sheet and a tube, all rotated so that no coordinate is round."""
    walls = {}
    for name, surface in (("cube", cube()), ("hills", sheet(5, bumps=0.03)), ("tube", tube(20, rings=3))):
        write(folder / f"{name}.ply", *surface)
        rotation = {"axis": [1, 2, 3], "angle": 0.7}
        walls[name] = {"shape": "mesh", "file": f"{name}.ply", "material": "glass", "rotate": rotation}
    domain = {"min": [-5.0] * 3, "max": [5.0] * 3, "on_exit": "error"}
    return plan_for(build_scene({"b": particle_group([0.0, 0.0, 4.0], 0.3)}, walls=walls, domain=domain))


def test_device_contacts_match_the_reference_implementation(taichi_f64, tmp_path, monkeypatch):
    """Owner, gap and normal agree with the reference to rounding; all possible owners nearby are found."""
    monkeypatch.chdir(tmp_path)  # in which scenes without a file look for meshes
    plan = all_meshes(tmp_path)
    state = State(plan, backend.start("cpu", "f64", 2))

    @ti.kernel
    def measure(
        points: ti.types.ndarray(ti.f64, 2), gap: ti.types.ndarray(ti.f64, 2), normal: ti.types.ndarray(ti.f64, 3),
        bare: ti.types.ndarray(ti.f64, 2), near: ti.types.ndarray(ti.i32, 2), slack: ti.f64,
    ):  # fmt: skip
        for i in range(points.shape[0]):
            point = ti.Vector([points[i, 0], points[i, 1], points[i, 2]])
            for t in range(gap.shape[1]):
                gap[i, t], direction = state.mesh.triangle_contact(t, point)
                bare[i, t] = state.mesh.from_nearest(t, point).norm()
                near[i, t] = state.mesh.may_own(t, point, slack)
                for axis in ti.static(range(3)):
                    normal[i, t, axis] = direction[axis]

    rng = np.random.default_rng(7)
    slack = 0.05
    first = 0
    count = sum(mesh.triangle_count for mesh in plan.meshes.values())
    low = np.min([mesh.points.min(axis=0) for mesh in plan.meshes.values()], axis=0)
    high = np.max([mesh.points.max(axis=0) for mesh in plan.meshes.values()], axis=0)
    corners = np.concatenate([mesh.points for mesh in plan.meshes.values()])
    corners += rng.normal(0.0, 1e-3, corners.shape)
    points = np.concatenate([rng.uniform(low - 0.2, high + 0.2, (300, 3)), corners])
    gap, bare, near = (np.zeros((len(points), count), kind) for kind in (float, float, np.int32))
    normal = np.zeros((len(points), count, 3))
    measure(points, gap, normal, bare, near, slack)
    moved = points + 0.999 * slack * np.array([0.6, 0.0, -0.8])
    for mesh in plan.meshes.values():
        own = slice(first, first + mesh.triangle_count)
        first += mesh.triangle_count
        triangles = np.tile(np.arange(mesh.triangle_count), len(points))
        repeated = np.repeat(points, mesh.triangle_count, axis=0)
        expected, direction = triangle_contacts(mesh.adjacency, triangles, repeated)
        distance = triangle_distances(mesh.adjacency.vertex[triangles], repeated)
        np.testing.assert_allclose(gap[:, own].reshape(-1), expected, rtol=0.0, atol=2e-15)
        owned = expected < FAR_AWAY
        found = normal[:, own].reshape(-1, 3)[owned & (expected > 0.0)]
        np.testing.assert_allclose(found, direction[owned & (expected > 0.0)], rtol=0.0, atol=1e-13)
        np.testing.assert_allclose(bare[:, own].reshape(-1), distance, rtol=0.0, atol=2e-15)
        gap_after_move, _ = triangle_contacts(
            mesh.adjacency, triangles, np.repeat(moved, mesh.triangle_count, axis=0)
        )
        assert np.all(near[:, own].reshape(-1)[(gap_after_move < FAR_AWAY) | owned] == 1)
        assert near[:, own].mean() < 0.7, "most triangles are excluded"
    state.free()
