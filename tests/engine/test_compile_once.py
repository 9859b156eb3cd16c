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
    "rest_damping": 0.1, "free": True, "precision": "f64",
}  # fmt: skip

CHANGES = {
    "count": 90, "diameter": 0.0036, "floor": -0.001, "friction": 0.3, "young_modulus": 2e8, "gravity": -5.0,
    "high": 0.06, "skin": 4e-4, "max_overlap": 0.2, "outlet": -0.002, "rate": 30.0, "mass": 0.2, "threads": 2,
    "rest_damping": 0.05,
}  # fmt: skip

SMALL = {"threads": 1, "free": True, "precision": "f64"}
"""Settings of a run of the other scene."""


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


def oblique_collisions():
    """Three particles without walls: a scene of another structure."""
    positions = [[0.0, 0.0, 0.0], [0.0099, 0.002, 0.0], [0.0, 0.0099, 0.001]]
    velocity = [[1.0, 0.0, 0.0], [-1.0, 0.2, 0.0], [0.0, -1.0, 0.3]]
    beads = particle_group(positions, 0.01, velocity=velocity)
    return build_scene({"beads": beads}, pair={"friction": 0.4}, run={"duration": 2e-4})


def digest_of(case):
    """Digest of all totals, particles and contacts at the end of a run."""
    if case.get("by_kernels"):  # they copy and clear the fields from then on, as on a GPU
        field_block.host_block = lambda fields, on_cpu: None
    scene = scene_of(case) if "count" in case else oblique_collisions()
    simulation = Simulation(scene, precision=case["precision"], threads=case["threads"])
    simulation.run()
    snapshot = simulation.snapshot(contacts=True)
    assert simulation.engine.state.backend.precision == case["precision"]
    if case["free"]:
        simulation.free()
        with pytest.raises(GranflowError, match="has been freed"):
            simulation.engine.state.particles.position.to_numpy()
    arrays = [*snapshot.particles.values(), *snapshot.contacts.values()]
    totals = repr(sorted(snapshot.totals.items())).encode()
    return sha256(totals + b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()


def runs_with_cache(folder, cases):
    """Cases that run one after the other in this process: digest, number of kept states and of kernels on disk
    after each. Taichi writes kernels when it stops."""
    os.environ["GRANFLOW_CACHE"] = folder
    return [
        (digest_of(case), len(state_cache._kept), len(list(Path(folder).glob(KERNELS)))) for case in cases
    ]


def test_changed_numbers_and_alternating_structures_compile_no_kernel_twice_and_keep_their_bits(tmp_path):
    """Also if a simulation is not freed, but deleted, and if kernels copy the fields, as on a GPU."""
    folder = str(tmp_path)
    other = BASE | CHANGES | {"free": False}
    (alone, *_), (base, *_) = in_subprocess(runs_with_cache, folder, [other, BASE | {"by_kernels": True}])
    kernel_count = len(list(tmp_path.glob(KERNELS)))
    cases = [BASE, other | {"threads": 1}, BASE, SMALL]
    cases += [SMALL | {"precision": "f32", "threads": 2}, SMALL | {"threads": 2}]
    digests, states, counts = zip(*in_subprocess(runs_with_cache, folder, cases), strict=True)
    small, single = digests[3:5]
    assert digests == (base, alone, base, small, single, small)
    assert len({base, alone, small, single}) == 4 and states[2] == 1
    assert 0 < counts[0] == counts[3] == kernel_count < counts[4] < counts[5]
    assert counts[5] == len(list(tmp_path.glob(KERNELS)))
