"""The GPU code path, executed on the CPU: one particle per chunk, one chunk per task, no chunk queue."""

import hashlib

import numpy as np
from scene_builders import box, build_scene, particle_group, run_to_end
from subprocess_runner import in_subprocess

ARRAYS = ("id", "position", "velocity", "angular_velocity", "force", "torque", "coordination_number")


def falling_lattice():
    """A lattice falls into a vibrating box: friction, rolling friction, a moving wall, energy budget, rebuilds."""
    walls = box(0.06)
    walls["low_z"] |= {"motion": {"kind": "vibration", "direction": [0, 0, 1], "amplitude": 1e-3, "frequency": 60.0}}
    rng = np.random.default_rng(4)
    positions = 0.0065 * (np.argwhere(np.ones((8, 8, 4))) + 0.75)
    lattice = particle_group(
        positions, rng.uniform(0.004, 0.006, len(positions)), velocity=rng.normal(0.0, 0.3, positions.shape)
    )
    return build_scene(
        {"lattice": lattice},
        walls=walls,
        rolling="epsd",
        gravity=[0.0, 0.0, -9.81],
        numerics={"chunk_size": 1},
        pair={"friction": 0.4, "rolling_friction": 0.1, "restitution": 0.1},
        run={"duration": 0.015, "velocity_max": 2.0, "time_step": 2e-6},
        output={"interval": 1.0, "energy_budget": True},
    )


def fingerprint(as_on_gpu):
    from granflow.engine import backend, stepper

    stepper.SINGLE_WORKER_PARTICLES = 0  # by default, a scene of this size uses one worker
    if as_on_gpu:
        backend.Backend.on_cpu = property(lambda self: False)
    last, simulation = run_to_end(falling_lattice(), threads=2)
    digest = hashlib.sha256(b"".join(np.ascontiguousarray(last.particles[name]).tobytes() for name in ARRAYS))
    return digest.hexdigest(), simulation.engine.state.stride, last.totals["contact_count"], last.totals["energy_error"]


def test_gpu_code_path_is_bit_identical_to_the_cpu_code_path():
    cpu, gpu = in_subprocess(fingerprint, False), in_subprocess(fingerprint, True)
    assert gpu[1] == 1 and cpu[1] > 1, "the code paths differ"
    assert cpu[2] > 20
    assert gpu[0] == cpu[0]
    assert gpu[2:] == cpu[2:]
