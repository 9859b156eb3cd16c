"""Kernels are compiled once: scenes that differ in numbers share them in memory and on disk; restarts keep bits."""

import os
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from scene_builders import build_scene, particle_group, plane
from subprocess_runner import in_subprocess

from granflow.engine import fields as field_block
from granflow.engine import state_cache
from granflow.engine.kernel_cache import CACHED_KERNELS as KERNELS
from granflow.errors import GranflowError
from granflow.simulation import Simulation

BASE = {
    "count": 60, "diameter": 0.004, "floor": 0.0, "friction": 0.4, "young_modulus": 1e8, "gravity": -9.81, "high": 0.05,
    "skin": "auto", "max_overlap": 0.3, "outlet": 0.0, "rate": 20.0, "mass": 0.1, "threads": 1,
    "rest_damping": 0.1, "free": True,
}  # fmt: skip

CHANGES = {
    "count": 90, "diameter": 0.0036, "floor": -0.001, "friction": 0.3, "young_modulus": 2e8, "gravity": -5.0,
    "high": 0.06, "skin": 4e-4, "max_overlap": 0.2, "outlet": -0.002, "rate": 30.0, "mass": 0.2, "threads": 2,
    "rest_damping": 0.05,
}  # fmt: skip


def scene_of(case):
    """Particles between a vibrating floor and a falling lid in a box that is periodic along x, with an outlet."""
    sites = np.argwhere(np.ones((5, 5, 4)))[: case["count"]]
    velocity = np.random.default_rng(1).normal(0.0, 0.3, sites.shape)
    group = particle_group(0.0041 * (sites + [0.6, 0.6, 0.7]), case["diameter"], velocity=velocity)
    vibration = {"kind": "vibration", "direction": [0, 0, 1], "amplitude": 1e-4, "frequency": case["rate"]}
    falling = {"kind": "free", "direction": [0.0, 0.0, 1.0], "mass": case["mass"]}
    walls = {
        "floor": plane([0.0, 0.0, case["floor"]], [0.0, 0.0, 1.0], motion=vibration),
        "lid": plane([0.0, 0.0, 0.02], [0.0, 0.0, -1.0], motion=falling),
    }
    outlet = {"half_space": {"point": [0.0, 0.0, case["outlet"] - 0.01], "normal": [0.0, 0.0, -1.0]}}
    glass = {"young_modulus": case["young_modulus"], "poisson_ratio": 0.25, "density": 2500.0}
    return build_scene(
        {"beads": group}, walls, pair={"friction": case["friction"]}, outlets={"below": outlet},
        gravity=[0.0, 0.0, case["gravity"]], materials={"glass": glass},
        normal={"law": "zhou", "rest_damping": case["rest_damping"]},
        domain={"min": [0.0, -0.05, -0.05], "max": [case["high"]] * 3, "on_exit": "delete", "periodic": ["x"]},
        numerics={"skin": case["skin"], "max_overlap": case["max_overlap"], "chunk_size": 32},
        run={"duration": 0.004, "velocity_max": 2.0}, output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip


def digest_of(case):
    """Digest of all totals, particles and contacts at the end of a run."""
    simulation = Simulation(scene_of(case), threads=case["threads"])
    simulation.run()
    snapshot = simulation.snapshot(contacts=True)
    if case["free"]:
        simulation.free()
    arrays = [*snapshot.particles.values(), *snapshot.contacts.values()]
    totals = repr(sorted(snapshot.totals.items())).encode()
    return sha256(totals + b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()


def digests_with_cache(folder, cases, by_kernels=False):
    """Digests of cases that run one after the other in this process, and the number of states that remain.

    by_kernels:  kernels copy and clear the fields, as on a GPU
    """
    os.environ["GRANFLOW_CACHE"] = folder
    if by_kernels:
        field_block.host_block = lambda fields, on_cpu: None
    return [digest_of(case) for case in cases], len(state_cache._kept)


def test_changed_numbers_compile_no_kernel_and_runs_in_one_process_share_arrays(tmp_path):
    """Also if a simulation is not freed, but deleted, and if kernels copy the fields, as on a GPU."""
    folder = str(tmp_path)
    other = BASE | CHANGES | {"free": False}
    (alone,), _ = in_subprocess(digests_with_cache, folder, [other])
    kernels = set(tmp_path.glob(KERNELS))
    cases = [BASE, other | {"threads": 1}, BASE]
    digests, state_count = in_subprocess(digests_with_cache, folder, cases)
    base = digests[0]
    assert kernels and digests == [base, alone, base] and base != alone
    assert state_count == 1 and set(tmp_path.glob(KERNELS)) == kernels
    assert in_subprocess(digests_with_cache, folder, cases[:2], True)[0] == digests[:2]


def run_of(friction, precision, threads):
    """Digest of the positions and velocities after oblique collisions, for which friction needs further fields."""
    positions = [[0.0, 0.0, 0.0], [0.0099, 0.002, 0.0], [0.0, 0.0099, 0.001]]
    velocity = [[1.0, 0.0, 0.0], [-1.0, 0.2, 0.0], [0.0, -1.0, 0.3]]
    beads = particle_group(positions, 0.01, velocity=velocity)
    scene = build_scene({"beads": beads}, pair={"friction": friction}, run={"duration": 2e-4})
    simulation = Simulation(scene, precision=precision, threads=threads)
    simulation.run()
    particles = simulation.snapshot().particles
    assert simulation.engine.state.backend.precision == precision
    simulation.free()
    with pytest.raises(GranflowError, match="has been freed"):
        simulation.engine.state.particles.position.to_numpy()
    return sha256(particles["position"].tobytes() + particles["velocity"].tobytes()).hexdigest()


def alternating(folder):
    """Digests of runs of alternating structures and settings, and kernels in the cache after each.

    Taichi writes them when it stops.
    """
    os.environ["GRANFLOW_CACHE"] = folder
    settings = [
        (0.0, "f64", 1),
        (0.4, "f64", 1),
        (0.0, "f64", 1),
        (0.4, "f64", 1),
        (0.0, "f32", 2),
        (0.0, "f64", 2),
    ]
    return [(run_of(*each), len(list(Path(folder).glob(KERNELS)))) for each in settings]


def test_alternating_structures_and_settings_are_compiled_once_and_keep_their_bits(tmp_path):
    digests, counts = zip(*in_subprocess(alternating, str(tmp_path)), strict=True)
    assert digests[0] == digests[2] == digests[5] != digests[1] == digests[3]
    assert 0 < counts[1] < counts[2] == counts[3] == counts[4] and digests[4] not in digests[:4]
