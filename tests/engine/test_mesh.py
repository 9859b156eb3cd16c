"""Mesh contacts on the device: equal to the numpy reference; bit-identical for any thread count and on
restart."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from geometry.meshes import cube, sheet, tube, write
from resume.runs import last_state
from scene_builders import build_scene, particle_group, plane
from subprocess_runner import each_in_subprocess

from granflow.engine import backend
from granflow.engine import threads as workers
from granflow.engine.state import State
from granflow.geometry.mesh_contact import triangle_contacts, triangle_distances
from granflow.geometry.surface import FAR_AWAY
from granflow.io.checkpoint import read_checkpoint
from granflow.kernel_language import ti
from granflow.plan.build import plan_for
from granflow.simulation import Simulation


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Working directory, in which scenes without a file look for meshes."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def wall(file, **more):
    return {"shape": "mesh", "file": file, "material": "glass", **more}


def all_meshes(folder):
    """A plan with a cube, a bumpy sheet and a tube, all rotated so that no coordinate is round."""
    rotation = {"axis": [1, 2, 3], "angle": 0.7}
    for name, surface in (("cube", cube()), ("hills", sheet(5, bumps=0.03)), ("tube", tube(20, rings=3))):
        write(folder / f"{name}.ply", *surface)
    walls = {name: wall(f"{name}.ply", rotate=rotation) for name in ("cube", "hills", "tube")}
    domain = {"min": [-5.0] * 3, "max": [5.0] * 3, "on_exit": "error"}
    return plan_for(build_scene({"b": particle_group([0.0, 0.0, 4.0], 0.3)}, walls=walls, domain=domain))


def test_device_contacts_match_the_reference_implementation(taichi_f64, folder):
    """Owner, gap and normal agree with the reference to rounding; all possible owners nearby are found."""
    plan = all_meshes(folder)
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


VIBRATION = {"kind": "vibration", "direction": [0, 0, 1], "amplitude": 5e-4, "frequency": 80.0}
ROTATION = {"kind": "rotation", "point": [0, 0, 0.019], "axis": [1, 0, 0], "angular_velocity": 20.0}


def mixing_scene(out):
    """A scene in the folder `out`: particles over a vibrating bumpy floor with a rotating cube of plates
    among them."""
    out.mkdir(exist_ok=True)
    write(out / "hills.ply", *sheet(12, 0.1, bumps=5e-4))
    points, corners = cube()
    write(out / "cube.stl", points - 0.5, corners)
    block = wall("cube.stl", scale=0.02, translate=[0, 0, 0.019], motion=[ROTATION])
    sides = {f"{name}{end}": plane([0.025 * (2 * end - 1) * (axis == k) for k in range(3)],
                                   [(1 - 2 * end) * (axis == k) for k in range(3)])
             for axis, name in enumerate("xy") for end in (0, 1)}  # fmt: skip
    rng = np.random.default_rng(4)
    positions = 0.0062 * (np.argwhere(np.ones((7, 7, 2))) - [3, 3, 0]) + [0.0, 0.0, 0.0048]
    positions = positions[np.abs(positions - [0, 0, 0.019]).max(axis=1) > 0.0135]
    positions[0] = [0.003, 0.004, 0.0325]  # falls on the block
    particles = particle_group(
        positions, rng.uniform(0.004, 0.006, len(positions)), velocity=rng.normal(0.0, 0.2, positions.shape)
    )
    scene = build_scene(
        {"particles": particles},
        walls={"hills": wall("hills.ply", motion=[VIBRATION]), "block": block, **sides},
        rolling="epsd",
        pair={"friction": 0.4, "rolling_friction": 0.1, "restitution": 0.4},
        gravity=[0.0, 0.0, -9.81],
        numerics={"chunk_size": 16, "max_overlap": 0.3},
        run={"duration": 0.012, "velocity_max": 2.0, "time_step": 4e-6},
        output={
            "interval": 0.004,
            "energy_budget": True,
            "contacts": True,
            "checkpoint": {"interval": 0.004, "keep": 9},
        },
    )
    scene._folder = out
    return scene


def run_and_resume(folder, threads, precision):
    """Final states of a run and of one resumed from its first checkpoint, contact and rotation checks, energy
    error."""
    workers.SINGLE_WORKER_PARTICLES = 0
    first = Path(folder) / f"run{threads}{precision}"
    resumed_folder = Path(folder) / f"again{threads}{precision}"
    simulation = Simulation(mixing_scene(first), out=first, threads=threads, precision=precision)
    simulation.run()
    last = simulation.snapshot()
    contacts_and_rotation = [last.totals["contact_count"], abs(last.particles["angular_velocity"][0]).max()]
    simulation.free()
    shutil.copytree(first, resumed_folder)
    checkpoint = read_checkpoint(sorted(resumed_folder.glob("checkpoint_*.npz"))[0])
    simulation = Simulation(
        mixing_scene(resumed_folder),
        out=resumed_folder,
        threads=threads,
        precision=precision,
        resume=checkpoint,
    )
    simulation.run()
    totals = simulation.snapshot().totals
    simulation.free()
    return [last_state(first), last_state(resumed_folder), contacts_and_rotation, totals["energy_error"]]


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("precision", ["f64", "mixed", "f32"])
def test_results_are_bit_identical_for_any_thread_count_and_after_restart(tmp_path, precision):
    """Two moving meshes among planes, with friction, rolling springs and the energy budget."""
    one, two = each_in_subprocess(
        run_and_resume, [(str(tmp_path), n, precision) for n in (1, 2)], seconds=1000
    )
    whole, resumed, contacts_and_rotation, energy_error = one
    assert whole == resumed
    assert one == two
    assert min(contacts_and_rotation) > 0, "particles touch the floor, and the block rotates one of them"
    assert energy_error < 0.02
