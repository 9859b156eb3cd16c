"""Runs are bit-identical for any thread count, chunk size and feature set."""

import hashlib
import os

import numpy as np
import pytest
from scene_builders import (
    DASHPOTS,
    LIQUID,
    SPRINGS,
    box,
    build_scene,
    moving_lattice,
    particle_group,
    plane,
    run_to_end,
    vibrating_box,
)
from subprocess_runner import each_in_subprocess, in_subprocess

from granflow.engine import backend
from granflow.engine import threads as workers
from granflow.simulation import Simulation

MORE_THAN_POOL = 4 * (os.cpu_count() or 1)
"""Number of workers that exceeds the number of threads in Taichi's pool."""

ARRAYS = ("id", "position", "velocity", "angular_velocity", "force", "torque", "coordination_number")


def falling_lattice(particles=None, **changes):
    """A lattice of 256 particles falls into a vibrating box: friction, rolling friction, a moving wall,
    rebuilds."""
    lattice = moving_lattice((8, 8, 4), largest=0.006, speed=0.3)
    return build_scene(
        {"lattice": lattice} | (particles or {}), walls=vibrating_box(0.06), rolling="epsd", gravity=[0.0, 0.0, -9.81],
        pair={"friction": 0.4, "rolling_friction": 0.1, "restitution": 0.1}, **changes,
    )  # fmt: skip


def complex_scene():
    """The falling lattice and rain, in several chunks."""
    region = {"box": {"min": [0.005, 0.005, 0.045], "max": [0.055, 0.055, 0.059]}}
    rain = {
        "material": "glass", "count": 60, "diameter": 0.005,
        "insert": {"kind": "rain", "region": region, "rate": 3000.0},
    }  # fmt: skip
    return falling_lattice(
        {"rain": rain}, numerics={"chunk_size": 64}, run={"duration": 0.03, "velocity_max": 2.0, "time_step": 2e-6},
        output={"interval": 1.0, "wall_forces": True, "collision_energies": {"min": 1e-9, "max": 1e-2, "classes": 14}},
    )  # fmt: skip


def digest_of(last, *more, signed_zeros=True):
    """Digest of the particles of a snapshot and of further arrays; zeros have their sign or none."""
    arrays = (*(np.ascontiguousarray(last.particles[name]) for name in ARRAYS), *more)
    if not signed_zeros:
        arrays = [each + 0.0 for each in arrays]
    return hashlib.sha256(b"".join(each.tobytes() for each in arrays)).hexdigest()


def fingerprint(threads, workers_from, precision="f64", cores=None):
    """Digest of the final state, number of particles, of contacts and of neighbor-list rebuilds.

    workers_from:  number of particles from which several workers are used; by default, this scene uses one
    cores:         number of cores of the process; None: all
    """
    workers.SINGLE_WORKER_PARTICLES = workers_from
    if threads == MORE_THAN_POOL or cores:
        backend.worker_count = lambda requested: (requested, "")
    if cores:
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:cores])
    last, simulation = run_to_end(complex_scene(), threads=threads, precision=precision)
    counts = (
        last.totals["particle_count"],
        last.totals["contact_count"],
        simulation.engine.timing.rebuild_count,
    )
    return [digest_of(last, *last.impulses.values(), *last.collisions.values()), *counts]


def test_results_are_bit_identical_for_any_thread_count():
    """Two threads with two workers and with one; more workers than threads in the pool; two workers on one
    core.

    A worker that waits too long at a barrier leaves the launch and frees its thread, so no worker blocks it.
    """
    calls = [(1, 0), (2, 0), (2, 10**6), (MORE_THAN_POOL, 0)]
    if hasattr(os, "sched_setaffinity"):
        calls.append((2, 0, "f64", 1))
    one, *others = each_in_subprocess(fingerprint, calls)
    _, particles, contacts, rebuilds = one
    assert particles == 316.0
    assert contacts > 20
    assert rebuilds > 20
    assert others == [one] * len(others)


def models_fingerprint(threads, in_parallel):
    """Digests of short runs with dashpots and with springs in all slots of the contact models."""
    if in_parallel:
        workers.SINGLE_WORKER_PARTICLES = 0
    found = []
    for models in (DASHPOTS, SPRINGS):
        last, _ = run_to_end(bed(numerics={"chunk_size": 16}, **models), threads=threads)
        assert np.mean(last.particles["angular_velocity"].any(axis=1)) > 0.5, "most particles had contacts"
        found.append(digest_of(last))
    return found


def test_tangential_rolling_and_twisting_models_are_bit_identical_for_any_thread_count():
    one, two = each_in_subprocess(models_fingerprint, [(1, False), (2, True)])
    assert one == two


def gpu_fingerprint(as_on_gpu):
    """Digest, iterations per chunk, number of contacts and energy error of a run with one particle per chunk.

    On a GPU each chunk is a task of its own; here that code path is executed on the CPU.
    """
    workers.SINGLE_WORKER_PARTICLES = 0
    if as_on_gpu:
        backend.Backend.on_cpu = property(lambda self: False)
    scene = falling_lattice(
        numerics={"chunk_size": 1}, run={"duration": 0.015, "velocity_max": 2.0, "time_step": 2e-6},
        output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip
    simulation = Simulation(scene, threads=2)
    simulation.run()
    last = simulation.snapshot()
    return (
        digest_of(last),
        simulation.engine.state.stride,
        last.totals["contact_count"],
        last.totals["energy_error"],
    )


def test_gpu_code_path_is_bit_identical_to_the_cpu_code_path():
    cpu = in_subprocess(gpu_fingerprint, False)
    gpu = in_subprocess(gpu_fingerprint, True)
    assert gpu[1] == 1 and cpu[1] > 1, "the code paths differ"
    assert cpu[2] > 20
    assert gpu[0] == cpu[0]
    assert gpu[2:] == cpu[2:]


def liquid_fingerprint(threads, in_parallel, as_on_gpu=False):
    """Digest of a falling lattice with liquid films, volume of all bridges, and of all liquid [m3]."""
    if in_parallel:
        workers.SINGLE_WORKER_PARTICLES = 0
    if as_on_gpu:
        backend.Backend.on_cpu = property(lambda self: False)
    lattice = moving_lattice((8, 8, 4), largest=0.006, speed=0.3) | {"liquid_content": 0.01}
    scene = build_scene(
        {"lattice": lattice}, walls=vibrating_box(0.06), gravity=[0.0, 0.0, -9.81],
        numerics={"chunk_size": 1 if as_on_gpu else 16},
        run={"duration": 0.015, "velocity_max": 2.0, "time_step": 2e-6}, **LIQUID,
    )  # fmt: skip
    last, _ = run_to_end(scene, threads=threads)
    order = np.argsort(last.particles["id"])
    arrays = [
        np.ascontiguousarray(last.particles[name][order]) for name in ("position", "velocity", "liquid_film")
    ]
    digest = hashlib.sha256(b"".join(each.tobytes() for each in arrays)).hexdigest()
    films, bridges = (last.totals[f"liquid_{name}_volume"] for name in ("film", "bridge"))
    return digest, bridges, films + bridges


def test_liquid_is_bit_identical_for_any_thread_count_and_on_the_gpu_code_path():
    one, two = each_in_subprocess(liquid_fingerprint, [(1, False), (2, True)])
    gpu = in_subprocess(liquid_fingerprint, 2, True, True)
    assert one[1] > 0.0
    assert one == two == gpu


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["mixed", "f32"])
def test_results_are_bit_identical_for_any_thread_count_in_lower_precision(precision):
    one, two = each_in_subprocess(fingerprint, [(1, 0, precision), (2, 0, precision)])
    assert one[1] == 316.0
    assert one == two


def bed(**changes):
    """A block of particles that overlap initially and then separate."""
    rng = np.random.default_rng(6)
    positions = 0.0098 * (np.argwhere(np.ones((4, 4, 4))) + 0.8)
    group = particle_group(positions, 0.01, velocity=rng.normal(0.0, 0.3, positions.shape))
    parts = {"pair": {"friction": 0.4}} | changes
    return build_scene(
        {"balls": group}, walls=box(0.05) | {"far": plane([0, 0, -0.5], [0, 0, 1], "steel")},
        gravity=[0.0, 0.0, -9.81], run={"duration": 0.003, "velocity_max": 2.0}, **parts,
    )  # fmt: skip


def test_friction_coefficient_0_is_bit_identical_to_disabled_friction(taichi_f64):
    """A rough wall out of reach enables friction; all pairs in contact have the coefficient 0."""
    smooth = {"friction": 0.0}
    without, plain = run_to_end(bed(pair=smooth))
    idle, rough = run_to_end(bed(pair=smooth, pairs={"glass-steel": {"restitution": 0.8, "friction": 0.5}}))
    assert plain.plan.laws.names["tangential"] == "none"
    assert rough.plan.laws.names["tangential"] == "mindlin"
    assert np.all(np.abs(without.particles["velocity"]).max(axis=1) > 0.1), "all particles move"
    for name in ("position", "velocity", "force"):
        np.testing.assert_array_equal(idle.particles[name], without.particles[name])
    assert not idle.particles["angular_velocity"].any()


def test_energy_budget_does_not_change_the_motion(taichi_f64):
    without, _ = run_to_end(bed())
    with_budget, _ = run_to_end(bed(output={"interval": 1.0, "energy_budget": True}))
    assert "energy_error" in with_budget.totals
    for name in ("position", "velocity", "angular_velocity"):
        np.testing.assert_array_equal(with_budget.particles[name], without.particles[name])


def test_chunk_size_does_not_change_the_bits(taichi_f64):
    one_chunk, _ = run_to_end(bed())
    many_chunks, _ = run_to_end(bed(numerics={"chunk_size": 5}))
    for name in ARRAYS:
        np.testing.assert_array_equal(many_chunks.particles[name], one_chunk.particles[name])
