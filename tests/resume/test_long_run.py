"""A million steps of a small vibrated bed: constant memory, open files and mass; bounded energy error."""

import os
import sys
from pathlib import Path

import pytest
from scene_builders import build_scene, moving_lattice, vibrating_box
from subprocess_runner import in_subprocess

import granflow as gf

DURATION = 5.0
"""A million steps of 5 us [s], 150 cycles of the floor."""
WARM_UP = 20
"""Samples, of 100, until kernels, file buffers and the history of the flow meters have been allocated."""


def vibrated_bed():
    """64 particles in a box whose floor vibrates with 0.8 mm at 30 Hz, at 2.9 g."""
    walls = vibrating_box(0.028)
    del walls["high_z"]
    walls["low_z"]["motion"] |= {"amplitude": 8e-4, "frequency": 30.0}
    interval = DURATION / 100
    return build_scene(
        {"balls": moving_lattice((4, 4, 4), largest=0.005, speed=0.1)}, walls,
        pair={"friction": 0.4, "restitution": 0.6}, gravity=[0.0, 0.0, -9.81],
        materials={"glass": {"young_modulus": 2e7, "poisson_ratio": 0.25, "density": 2500.0}},
        run={"duration": DURATION, "time_step": 5e-6, "velocity_max": 1.5},
        output={
            "interval": interval, "energy_budget": True, "contacts": True, "checkpoint": {"interval": interval, "keep": 2},
            "flow_meters": {"middle": {"point": [0, 0, 0.02], "normal": [0, 0, 1]}},
        },
    )  # fmt: skip


def run_and_sample(folder):
    """Mass, energy error, resident memory [pages], open files and particle count of each sample; step count."""
    samples = []

    def sample(snapshot):
        memory = int(Path("/proc/self/statm").read_text().split()[1])
        totals = snapshot.totals
        mass = float(snapshot.particles["mass"].sum())
        files = len(os.listdir("/proc/self/fd"))
        samples.append([mass, totals["energy_error"], memory, files, totals["particle_count"]])

    with gf.Simulation(
        vibrated_bed(), out=folder, observers=[gf.on_interval(DURATION / 100, sample)]
    ) as found:
        found.run()
        return samples, found.step_count


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.skipif(sys.platform != "linux", reason="memory and open files are read from /proc")
def test_memory_files_and_energy_are_stable_over_a_million_steps(tmp_path):
    samples, steps = in_subprocess(run_and_sample, str(tmp_path), seconds=7000)
    assert steps >= 1_000_000
    mass, error, memory, files, count = zip(*samples, strict=True)
    assert set(count) == {64.0} and set(mass) == {mass[0]}
    assert max(memory[WARM_UP:]) <= 1.01 * memory[WARM_UP], memory[WARM_UP:]
    # A sample can coincide with the thread that writes a frame; a leak would add a file per frame or checkpoint.
    assert max(files[WARM_UP:]) <= max(files[:WARM_UP]) + 1, files
    assert max(map(abs, error)) < 1e-3
    assert len(list(tmp_path.glob("checkpoint_*.npz"))) == 2
