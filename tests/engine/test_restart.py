"""Taichi is restarted for new structures and settings: kernels come from the cache on disk, bits stay the
same."""

import os
from hashlib import sha256
from pathlib import Path

import pytest
from scene_builders import build_scene, particle_group
from subprocess_runner import in_subprocess

from granflow.engine import state_cache
from granflow.engine.kernel_cache import CACHED_KERNELS as KERNELS
from granflow.errors import GranflowError
from granflow.kernel_language import ti
from granflow.simulation import Simulation

FRICTIONLESS, FRICTIONAL = 0.0, 0.4


def scene_of(friction):
    """Particles in oblique collisions; friction needs further fields."""
    positions = [[0.0, 0.0, 0.0], [0.0099, 0.002, 0.0], [0.0, 0.0099, 0.001]]
    velocity = [[1.0, 0.0, 0.0], [-1.0, 0.2, 0.0], [0.0, -1.0, 0.3]]
    return build_scene(
        {"beads": particle_group(positions, 0.01, velocity=velocity)}, pair={"friction": friction},
        run={"duration": 2e-4},
    )  # fmt: skip


def run_of(friction, **settings):
    """Digest of the positions and velocities at the end of a run."""
    simulation = Simulation(scene_of(friction), **settings)
    simulation.run()
    particles = simulation.snapshot().particles
    simulation.free()
    return sha256(b"".join(particles[name].tobytes() for name in ("position", "velocity"))).hexdigest()


def alternating_structures(folder):
    """Digests of each run, and kernels in the cache after it; Taichi writes them when it stops."""
    os.environ["GRANFLOW_CACHE"] = folder
    return [
        (run_of(friction), len(list(Path(folder).glob(KERNELS))))
        for friction in (FRICTIONLESS, FRICTIONAL, FRICTIONLESS, FRICTIONAL, FRICTIONLESS)
    ]


def test_alternating_structures_are_compiled_once_and_keep_their_bits(tmp_path):
    digests, kernel_counts = zip(*in_subprocess(alternating_structures, str(tmp_path)), strict=True)
    assert digests[0] == digests[2] == digests[4] != digests[1] == digests[3]
    assert 0 < kernel_counts[1] < kernel_counts[2] == kernel_counts[4] == len(list(tmp_path.glob(KERNELS)))


def alternating_settings():
    """Digests in f64 with one thread, mixed, f64 with two threads, f32, f64."""
    settings = [("f64", 1), ("mixed", 1), ("f64", 2), ("f32", 2), ("f64", 1)]
    return [run_of(FRICTIONAL, precision=precision, threads=threads) for precision, threads in settings]


def test_precision_and_threads_change_in_one_process():
    first, mixed, two_threads, single, last = in_subprocess(alternating_settings)
    assert first == two_threads == last
    assert len({first, mixed, single}) == 3


def error_with_fields_of_the_program():
    """The message on other settings, and the values of fields and of a simulation in use, whose structures
    differ."""
    run_of(FRICTIONLESS)
    held = Simulation(scene_of(FRICTIONLESS))
    run_of(FRICTIONAL)
    held.step(1)
    moved = float(held.particles.position[0, 0])
    held.free()
    mine = ti.field(ti.f64, 3)
    mine.fill(7.0)
    run_of(FRICTIONAL)
    run_of(FRICTIONLESS)
    try:
        Simulation(scene_of(FRICTIONAL), precision="mixed")
    except GranflowError as error:
        return str(error), mine.to_numpy().tolist(), moved
    return "", mine.to_numpy().tolist(), moved


def test_fields_of_the_program_and_simulations_in_use_survive():
    message, values, moved = in_subprocess(error_with_fields_of_the_program)
    assert message.endswith(
        "your program has made with Taichi; start cpu with mixed and all threads in a separate process."
    )
    assert values == [7.0] * 3
    assert 0.0 < moved < 1e-3


def test_a_kept_structure_is_used_again_without_a_restart(taichi_f64):
    run_of(FRICTIONLESS)
    kept = state_cache._kept[-1]
    run_of(FRICTIONLESS)
    assert kept in state_cache._kept


@pytest.mark.parametrize("precision", ["f64", "mixed"])
def test_runs_in_this_process_have_the_requested_precision(precision):
    simulation = Simulation(scene_of(FRICTIONAL), precision=precision)
    assert simulation.engine.state.backend.precision == precision
    simulation.free()
