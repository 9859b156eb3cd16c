"""What depends on the precision, and the limits on the code path of a GPU, in one other process."""

import numpy as np
import pytest
from clumps import clump_group
from engine.test_deformation import STIFFNESS, deformed, lattice, of_axes
from engine.test_stability_monitor import warnings_of
from engine.test_wall_dynamics import PRESSURE, compression_scene
from scene_builders import build_scene, particle_group
from subprocess_runner import in_subprocess

from granflow.engine import backend
from granflow.errors import RunError
from granflow.simulation import Simulation


def abort_message(scene, velocity=None):
    """Message of the abort, or an empty string; a velocity is set after planning, which does not refuse it."""
    with Simulation(scene) as simulation:
        if velocity is not None:
            simulation.particles.velocity[:] = velocity
        try:
            simulation.run()
        except RunError as error:
            return str(error)
    return ""


def messages_about_the_limit(precision, chunk_size):
    """Messages just below and just above the limit of a fifth of the radius per step, 100 m/s."""
    group = particle_group([[0.03 * (k % 9) - 0.12, 0.03 * (k // 9) - 0.12, 0.5] for k in range(80)])
    run = {"duration": 2.4e-3, "velocity_max": 1.0, "time_step": 1e-5, "precision": precision}
    scene = build_scene({"fast": group}, run=run, numerics={"skin": 0.003, "chunk_size": chunk_size})
    return [abort_message(scene, [0.0, 0.0, -speed]) for speed in (99.9, 100.1)]


def drifting_rod():
    """Way [m] of a rod that starts at 1 m/s and falls at 1 m/s2, height [m], simulated time, number of rebuilds."""
    scene = build_scene(
        {"rod": clump_group([[0.1, 0.0, 0.0]], velocity=[[1.0, 0.0, 0.0]])},
        run={"duration": 1.0, "velocity_max": 1.0, "time_step": 2.0**-16, "precision": "mixed"},
        domain={"min": [-1.0] * 3, "max": [2.0] * 3, "on_exit": "error"}, gravity=[0.0, 0.0, -1.0],
    )  # fmt: skip
    with Simulation(scene, threads=1) as simulation:
        simulation.step(3 * 2**12 + 1)
        last = simulation.snapshot()
        rebuilds = simulation.engine.timing.rebuild_count
    x, _, z = last.particles["clump_position"][0].tolist()
    return x - 0.1, z, last.time, rebuilds


def kinds_of_warnings_at_rest(precision, **parts):
    """Kinds of warnings for particles released at height: no motion yet, potential energies with rounding
    errors."""
    beads = particle_group([[0.0137 * k, 0.0, 0.731] for k in range(5)], 0.0093)
    run = {"duration": 1e-3, "velocity_max": 1.0, "precision": precision}
    parts |= {"run": run, "numerics": {"chunk_size": 16}}
    return list(warnings_of(build_scene({"beads": beads}, gravity=[0.0, 0.0, -9.81], **parts)))


def bounced_layer(precision):
    """Upward velocities [m/s] of a layer of elastic beads in two chunks that met a floor at 0.5 m/s, and the
    ways [m] since they left it."""
    beads = particle_group(
        [[0.02 * (k % 5), 0.02 * (k // 5), 0.0051] for k in range(20)], velocity=[0.0, 0.0, -0.5]
    )
    floor = {"shape": "plane", "point": [0, 0, 0], "normal": [0, 0, 1], "material": "glass"}
    run = {"duration": 4e-3, "velocity_max": 1.0, "precision": precision}
    scene = build_scene(
        {"beads": beads},
        {"floor": floor},
        {"restitution": 1.0},
        normal="hertz",
        run=run,
        numerics={"chunk_size": 16},
    )
    with Simulation(scene) as simulation:
        simulation.run()
        particles = simulation.snapshot().particles
    return particles["velocity"][:, 2].tolist(), (particles["position"][:, 2] - 0.005).tolist()


def pressure_of_a_servo():
    """Mean pressure [Pa] on the lid of `compression_scene` in its last stage."""
    with Simulation(compression_scene(), precision="mixed") as simulation:
        return simulation.run().numbers["wall_pressure.lid"]


def pressures_of_a_box(precision):
    """Pressures [Pa] of a compressed lattice, and those of Hertz at its widths."""
    scene = deformed(lattice(), {axis: {"strain_rate": -1.0} for axis in "xyz"}, duration=0.004)
    with Simulation(scene, precision=precision) as simulation:
        simulation.run()
        last = simulation.snapshot()
    cell = of_axes(last, "box_width") / 3
    expected = STIFFNESS * (0.01 - cell) ** 1.5 * cell / cell.prod()
    return of_axes(last, "box_pressure").tolist(), expected.tolist()


def flight(height):
    """Message of the abort, or an empty string; a particle flies 4 m from `height` [m] and leaves an
    expanding domain.

    In f32 the spacing is 2^(12 - 23) = 0.49 mm up to 2^13 = 8192 m and 0.98 mm beyond; the limit is 0.5 mm.
    """
    ball = particle_group([[0.0, 0.0, height]], velocity=[0.0, 0.0, 400.0])
    domain = {"min": [-1.0, -1.0, 0.0], "max": [1.0, 1.0, height + 0.1], "on_exit": "expand"}
    run = {"duration": 0.01, "time_step": 2e-6, "precision": "f32"}
    return abort_message(build_scene({"ball": ball}, domain=domain, run=run, numerics={"chunk_size": 16}))


def runs():
    """Results in mixed precision, and in single precision, the last two of them on the code path of a GPU."""
    mixed = (
        messages_about_the_limit("mixed", 16), kinds_of_warnings_at_rest("mixed"), drifting_rod(),
        pressure_of_a_servo(), pressures_of_a_box("mixed"), bounced_layer("mixed"),
    )  # fmt: skip
    expanding = {"min": [-1.0] * 3, "max": [1.0] * 3, "on_exit": "expand"}  # the structure of `flight`
    single = kinds_of_warnings_at_rest("f32", domain=expanding), flight(8186.0), flight(8191.0)
    backend.Backend.on_cpu = property(lambda self: False)
    return mixed, (*single, messages_about_the_limit("f32", 1), pressures_of_a_box("f32"))


def test_mixed_precision_and_single_precision_on_the_code_path_of_a_gpu():
    """The rod moves by 2^-16 m per step, which f64 adds without error; f32 resolves 0.1 m to 7.5e-9 m and 0.03 m to
    1.9e-9 m, of which an overlap of 40 um is a sum of two."""
    mixed, single = in_subprocess(runs)
    (below, above), warnings, (distance, height, time, rebuilds), pressure, box, (rebound, way) = mixed
    assert below == "" and "moves 0.001 m in one step" in above
    assert warnings == [], "rounding of potential energies is no error"
    assert rebuilds > 10 and distance == pytest.approx(time, abs=1e-12)
    assert height == pytest.approx(-0.5 * time**2, rel=1e-6)
    assert pressure == pytest.approx(PRESSURE, rel=0.01)
    np.testing.assert_allclose(*box, rtol=1e-5)
    np.testing.assert_allclose(rebound, 0.5, rtol=1e-4)
    assert min(way) > 0.0 and max(way) - min(way) < 1e-9
    warnings, near, far, (below, above), box = single
    np.testing.assert_allclose(*box, rtol=1.5 * 2.0 * 1.9e-9 / 4e-5)
    assert warnings == [] and near == "" and below == ""
    assert "moves 0.001 m in one step" in above
    resolution = (
        "f32 resolves positions only to 0.000977 m; the required resolution is 0.1 of the smallest radius"
    )
    assert f"where {resolution} 0.005 m" in far
    assert "particle 0 (glass, 400 m/s)" in far and "Use --precision mixed" in far
