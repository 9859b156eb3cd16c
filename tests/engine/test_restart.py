"""Taichi is restarted for new structures and settings: kernels come from the cache on disk, bits stay the
same."""

import os
from hashlib import sha256
from pathlib import Path

import pytest
from scene_builders import build_scene, particle_group
from subprocess_runner import in_subprocess

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


def run_of(friction, settings=None):
    """Digest of the positions and velocities at the end of a run, and its precision."""
    with Simulation(scene_of(friction), **(settings or {})) as simulation:
        simulation.run()
        particles = simulation.snapshot().particles
        precision = simulation.engine.state.backend.precision
    data = b"".join(particles[name].tobytes() for name in ("position", "velocity"))
    return sha256(data).hexdigest(), precision


def alternating(folder):
    """Digests of runs of alternating structures and settings, and kernels in the cache after each.

    Taichi writes them when it stops.
    """
    os.environ["GRANFLOW_CACHE"] = folder
    one = {"precision": "f64", "threads": 1}
    settings = [(friction, one) for friction in (FRICTIONLESS, FRICTIONAL, FRICTIONLESS, FRICTIONAL)]
    settings += [(FRICTIONLESS, one | {"threads": 2})]
    settings += [(FRICTIONLESS, {"precision": "f32", "threads": 2}), (FRICTIONLESS, one)]
    return [(run_of(*each), len(list(Path(folder).glob(KERNELS)))) for each in settings]


def test_alternating_structures_and_settings_are_compiled_once_and_keep_their_bits(tmp_path):
    """In f64 with one thread, in f64 and f32 with two."""
    found, counts = zip(*in_subprocess(alternating, str(tmp_path)), strict=True)
    digests = [digest for digest, _ in found]
    assert digests[0] == digests[2] == digests[4] == digests[6] != digests[1] == digests[3]
    assert 0 < counts[1] < counts[2] == counts[5] < counts[6]
    assert digests[5] not in digests[:5]
    assert [precision for _, precision in found[4:]] == ["f64", "f32", "f64"]


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


@pytest.mark.slow
def test_fields_of_the_program_and_simulations_in_use_survive():
    message, values, moved = in_subprocess(error_with_fields_of_the_program)
    assert message.endswith(
        "your program has made with Taichi; start cpu with mixed and all threads in a separate process."
    )
    assert values == [7.0] * 3
    assert 0.0 < moved < 1e-3
