"""A million steps of a small vibrated bed: constant memory, open files and mass; bounded energy error."""

import os
import sys
from pathlib import Path

import pytest
from scene_builders import build_scene, particle_group, plane
from subprocess_runner import in_subprocess

STEPS = 1_000_000
SAMPLES = 100
WARM_UP_SAMPLES = 20
"""Samples until kernels, file buffers and the history of the flow meters have been allocated."""


def vibrated_bed():
    """100 particles in a square box that vibrates at 3 g; 1e6 steps are about 160 cycles."""
    import numpy as np

    side = 0.03
    step = 5e-6
    omega = 2.0 * np.pi * 30.0
    vibration = {
        "kind": "vibration",
        "direction": [0, 0, 1],
        "amplitude": 3.0 * 9.81 / omega**2,
        "frequency": 30.0,
    }
    walls = {"floor": plane([0, 0, 0], [0, 0, 1], motion=[vibration])}
    for axis, name in enumerate("xy"):
        unit = np.eye(3)[axis]
        walls[f"low_{name}"] = plane([0.0] * 3, unit.tolist())
        walls[f"high_{name}"] = plane((side * unit).tolist(), (-unit).tolist())
    positions = 0.0056 * (np.argwhere(np.ones((5, 5, 4))) + 0.6)
    group = particle_group(positions, np.random.default_rng(3).uniform(0.0048, 0.0052, len(positions)))
    duration = STEPS * step
    return build_scene(
        {"balls": group}, walls, pair={"friction": 0.4, "restitution": 0.6}, gravity=[0.0, 0.0, -9.81],
        domain={"min": [-0.01, -0.01, -0.01], "max": [0.04, 0.04, 0.3], "on_exit": "error"},
        materials={"glass": {"young_modulus": 2e7, "poisson_ratio": 0.25, "density": 2500.0}},
        run={"duration": duration, "time_step": step, "velocity_max": 1.5},
        output={
            "interval": duration / SAMPLES, "energy_budget": True, "contacts": True,
            "checkpoint": {"interval": duration / SAMPLES, "keep": 2},
            "flow_meters": {"middle": {"point": [0, 0, 0.02], "normal": [0, 0, 1]}},
        },
    )  # fmt: skip


def run_and_sample(folder):
    """Time, mass, energy error, resident memory [kB], open files and particle count of each sample; step
    count."""
    from granflow.observers.observer import on_interval
    from granflow.simulation import Simulation

    samples = []

    def sample(snapshot):
        memory = int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") // 1024
        files = len(os.listdir("/proc/self/fd"))
        totals = snapshot.totals
        mass = float(snapshot.particles["mass"].sum())
        samples.append([snapshot.time, mass, totals["energy_error"], memory, files, totals["particle_count"]])

    scene = vibrated_bed()
    simulation = Simulation(scene, out=folder, observers=[on_interval(scene.output.interval, sample)])
    simulation.run()
    return samples, simulation.engine.step_count


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.skipif(sys.platform != "linux", reason="memory and open files are read from /proc")
def test_memory_files_and_energy_are_stable_over_a_million_steps(tmp_path):
    samples, steps = in_subprocess(run_and_sample, str(tmp_path), seconds=7000)
    assert steps >= STEPS
    _, mass, error, memory, files, count = zip(*samples, strict=True)
    assert set(count) == {100.0} and set(mass) == {mass[0]}
    assert max(memory[WARM_UP_SAMPLES:]) <= 1.01 * memory[WARM_UP_SAMPLES], (
        f"resident memory [kB] {memory[WARM_UP_SAMPLES:]}"
    )
    assert len(set(files[WARM_UP_SAMPLES:])) == 1
    assert max(map(abs, error)) < 1e-3
    assert len(list(tmp_path.glob("checkpoint_*.npz"))) == 2
    largest = max(map(abs, error))
    memory_range = f"{memory[WARM_UP_SAMPLES]} to {max(memory)} kB"
    print(f"memory {memory_range}, energy error at most {largest:.2g}, files {files[-1]}")
