"""Long runs: 100 000 frames, and a million steps of 1000 particles with monitored memory and file
descriptors."""

import os
import time
from pathlib import Path

import numpy as np
from scene_builders import build_scene, particle_group

from adversarial.beads import BEADS, changed, scene, solid
from adversarial.case import Case
from adversarial.sandbox import FinishedProcess, Sandbox, Skip

FRAMES = 100_000
STEPS = 1_000_000
WARM = 20.0
"""Time [s] after the first frame until kernels, buffers and file caches are allocated."""

GROWTH = 1.02
"""Largest ratio of the final resident memory to that after WARM."""


def many_frames(sandbox: Sandbox) -> FinishedProcess:
    """Runs one falling particle with one frame per step."""
    return sandbox.run("run beads.yaml --out out")


def all_frames(sandbox: Sandbox, finished: FinishedProcess) -> None:
    """Asserts that each frame is listed once."""
    listed = sandbox.path("out/particles.pvd").read_text().count("particles_")
    found = sum(1 for _ in sandbox.path("out").glob("particles_*.vtu"))
    assert found == listed and found >= FRAMES, (found, listed)


FRAMES_SCENE = changed(
    BEADS,
    ("run: {duration: 50 ms}", f"run: {{duration: {FRAMES * 1e-6}, time_step: 1e-6}}"),
    ("output: {interval: 10 ms}", "output: {interval: 1e-6, timeseries_interval: 1 s, walls: false}"),
    ("count: 10", "count: 1"),
)


def settled_bed():
    """Scene of 1000 particles in a box with a vibrating floor, for a million steps of 10 us."""
    side = 0.06
    step = 1e-5
    shake = {"kind": "vibration", "direction": [0, 0, 1], "amplitude": 1e-3, "frequency": 20.0}
    walls = {"floor": solid([0, 0, 0], [0, 0, 1]) | {"motion": [shake]}}
    for axis, name in enumerate("xy"):
        unit = np.eye(3)[axis]
        walls[f"low_{name}"] = solid([0.0] * 3, unit.tolist())
        walls[f"high_{name}"] = solid((side * unit).tolist(), (-unit).tolist())
    positions = 0.0058 * (np.argwhere(np.ones((10, 10, 10))) + 0.7)
    duration = STEPS * step
    return build_scene(
        {
            "beads": particle_group(
                positions, np.random.default_rng(5).uniform(0.0046, 0.0054, len(positions))
            )
        },
        walls,
        pair={"friction": 0.4, "restitution": 0.6},
        gravity=[0.0, 0.0, -9.81],
        domain={"min": [-0.01] * 3, "max": [0.07, 0.07, 0.5], "on_exit": "error"},
        materials={"glass": {"young_modulus": 5e6, "poisson_ratio": 0.25, "density": 2500.0}},
        run={"duration": duration, "time_step": step, "velocity_max": 2.0},
        output={"interval": duration / 100.0, "contacts": True, "checkpoint": {"interval": duration / 50.0}},
    )


def run_and_sample(sandbox: Sandbox) -> FinishedProcess:
    """Samples resident memory [kB] and open files of the process; asserts that they do not grow after
    WARM."""
    if not Path("/proc/self/statm").exists():
        raise Skip("memory and open files are read from /proc")
    running = sandbox.start("run beads.yaml --out out")
    samples: list[tuple[float, int, int]] = []
    while running.poll() is None and not sandbox.path("out/particles_0001.vtu").exists():
        time.sleep(0.1)
    began = time.monotonic()
    while time.monotonic() - began < sandbox.seconds:
        try:
            pages = int(Path(f"/proc/{running.pid}/statm").read_text().split()[1])
            files = len(os.listdir(f"/proc/{running.pid}/fd"))
        except OSError:
            break
        if not pages:  # an ended process has no memory
            break
        samples.append((time.monotonic() - began, pages * os.sysconf("SC_PAGE_SIZE") // 1024, files))
        time.sleep(1.0)
    finished = sandbox.finish(running, "run beads.yaml --out out")
    late = [sample for sample in samples if sample[0] > WARM]
    assert len(late) > 5, f"the run is too short for sampling: {samples}"
    memory = [sample[1] for sample in late]
    files = [sample[2] for sample in late]
    assert max(memory) <= GROWTH * memory[0], f"resident memory [kB] grows: {memory[::10]}"
    # a frame of three files and a checkpoint may be written; a file left open by each frame would be a
    # hundred
    assert max(files) <= min(files) + 5, f"open files: {sorted(set(files))}"
    return finished


def all_particles(sandbox: Sandbox, finished: FinishedProcess) -> None:
    """Asserts a million steps with all particles inside the box."""
    import json

    result = json.loads(sandbox.path("out/result.json").read_text())
    assert result["totals"]["particle_count"] == 1000
    rows = sandbox.path("out/timeseries.csv").read_text().splitlines()
    assert float(rows[-1].split(",")[0]) >= STEPS * 1e-5 * (1 - 1e-9)


CASES = [
    Case(
        "long runs",
        "long_frames",
        "100 000 frames",
        act=many_frames,
        code=0,
        prepare=scene(FRAMES_SCENE),
        verify=all_frames,
        verified="every frame is listed once",
        seconds=1500,
    ),
    Case(
        "long runs",
        "long_steps",
        "1 000 000 steps of 1000 particles",
        act=run_and_sample,
        code=0,
        prepare=lambda sandbox: sandbox.write("beads.yaml", settled_bed().to_yaml()),
        verify=all_particles,
        verified="resident memory grows by less than 2 %, open files stay constant",
        seconds=1500,
    ),
]
