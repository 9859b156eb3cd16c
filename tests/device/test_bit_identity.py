"""Same bits on any number of threads and in every run, whatever is left out; rounding only where the order changes."""

import hashlib
import os

import numpy as np
import pytest
from scene_builders import box, build_scene, particle_group, plane, run_to_end
from subprocess_runner import in_subprocess

from granflow.device import backend, stepper

MORE_THAN_POOL = 4 * (os.cpu_count() or 1)
"""Workers for which Taichi's pool has too few threads."""

ARRAYS = ("id", "position", "velocity", "angular_velocity", "force", "torque", "coordination_number")


def complex_scene():
    """Rain into a shaken box over a lattice that falls: friction, a moving wall, many searches, several chunks."""
    walls = box(0.06)
    walls["low_z"] |= {"motion": {"kind": "vibration", "direction": [0, 0, 1], "amplitude": 1e-3, "frequency": 60.0}}
    rng = np.random.default_rng(4)
    positions = 0.0065 * (np.argwhere(np.ones((8, 8, 4))) + 0.75)
    lattice = particle_group(
        positions, rng.uniform(0.004, 0.006, len(positions)), velocity=rng.normal(0.0, 0.3, positions.shape)
    )
    region = {"box": {"min": [0.005, 0.005, 0.045], "max": [0.055, 0.055, 0.059]}}
    rain = {
        "material": "glass", "count": 60, "diameter": 0.005,
        "insert": {"kind": "rain", "region": region, "rate": 3000.0},
    }  # fmt: skip
    return build_scene(
        {"lattice": lattice, "rain": rain}, walls=walls, rolling="epsd",
        pair={"friction": 0.4, "rolling_friction": 0.1, "restitution": 0.1},
        gravity=[0.0, 0.0, -9.81], numerics={"chunk_size": 64},
        run={"duration": 0.03, "velocity_max": 2.0, "time_step": 2e-6}, output={"interval": 1.0, "wall_forces": True},
    )  # fmt: skip


def fingerprint(threads, in_parallel, precision="f64"):
    """Digest of what a run leaves behind, how many particles and contacts there are, and how many searches it took."""
    if in_parallel:  # a scene this small would be stepped on one thread
        stepper.SINGLE_WORKER_PARTICLES = 0
    if threads == MORE_THAN_POOL:
        backend.worker_count = lambda requested: (requested, "")
    last, simulation = run_to_end(complex_scene(), threads=threads, precision=precision)
    digest = hashlib.sha256(b"".join(np.ascontiguousarray(last.particles[name]).tobytes() for name in ARRAYS))
    digest.update(b"".join(each.tobytes() for each in last.impulses.values()))
    counts = (last.totals["particle_count"], last.totals["contact_count"], simulation.engine.timing.rebuild_count)
    return [digest.hexdigest(), *counts]


def test_bits_do_not_depend_on_threads_nor_on_the_run():
    one, two, few = (in_subprocess(fingerprint, *how) for how in ((1, False), (2, True), (2, False)))
    _, particles, contacts, searches = one
    assert particles == 316.0
    assert contacts > 20
    assert searches > 20
    assert one == two == few


def test_more_workers_than_threads_in_the_pool_give_the_same_bits():
    """Workers that wait too long leave the launch, so the others get a thread: no worker blocks the launch."""
    assert in_subprocess(fingerprint, MORE_THAN_POOL, True) == in_subprocess(fingerprint, 1, False)


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="affinity of Linux")
def test_two_workers_on_one_core_give_the_same_bits():
    one, shared = in_subprocess(fingerprint, 1, False), in_subprocess(fingerprint_on_one_core)
    assert one == shared


def fingerprint_on_one_core():
    """Two workers that take turns on one core: they leave launches all the time."""
    backend.worker_count = lambda requested: (requested, "")
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    return fingerprint(2, True)


@pytest.mark.parametrize("precision", ["mixed", "f32"])
def test_bits_do_not_depend_on_threads_in_less_precision(precision):
    one, two = in_subprocess(fingerprint, 1, False, precision), in_subprocess(fingerprint, 2, True, precision)
    assert one[1] == 316.0
    assert one == two


def bed(**changes):
    """A block of spheres pressed together at the start, which flies apart."""
    rng = np.random.default_rng(6)
    positions = 0.0098 * (np.argwhere(np.ones((4, 4, 4))) + 0.8)
    group = particle_group(positions, 0.01, velocity=rng.normal(0.0, 0.3, positions.shape))
    parts = {"pair": {"friction": 0.4}} | changes
    return build_scene(
        {"balls": group}, walls=box(0.05) | {"far": plane([0, 0, -0.5], [0, 0, 1], "steel")},
        gravity=[0.0, 0.0, -9.81], run={"duration": 0.003, "velocity_max": 2.0}, **parts,
    )  # fmt: skip


def test_friction_with_no_coefficient_gives_the_bits_of_no_friction(taichi_f64):
    """A rough wall out of reach switches friction on for everybody."""
    smooth = {"friction": 0.0}
    without, plain = run_to_end(bed(pair=smooth))
    idle, rough = run_to_end(bed(pair=smooth, pairs={"glass-steel": {"restitution": 0.8, "friction": 0.5}}))
    assert not plain.plan.features.friction
    assert rough.plan.features.friction
    assert np.all(np.abs(without.particles["velocity"]).max(axis=1) > 0.1), "everything was set in motion"
    for name in ("position", "velocity", "force"):
        np.testing.assert_array_equal(idle.particles[name], without.particles[name])
    assert not idle.particles["angular_velocity"].any()


def test_the_energy_budget_changes_nothing(taichi_f64):
    plain, _ = run_to_end(bed())
    saved, _ = run_to_end(bed(output={"interval": 1.0, "energy_budget": True}))
    assert "energy_error" in saved.totals
    for name in ("position", "velocity", "angular_velocity"):
        np.testing.assert_array_equal(saved.particles[name], plain.particles[name])


def test_chunks_change_no_more_than_rounding(taichi_f64):
    """Chunks change the order of sums only: over 3 ms each difference stays below 1e-10 of the quantity's size."""
    whole, _ = run_to_end(bed())
    parts, _ = run_to_end(bed(numerics={"chunk_size": 5}))
    assert np.any(whole.particles["velocity"] != parts.particles["velocity"])
    for name in ("position", "velocity", "angular_velocity"):
        size = np.abs(whole.particles[name]).max()
        np.testing.assert_allclose(parts.particles[name], whole.particles[name], rtol=0.0, atol=1e-10 * size)
