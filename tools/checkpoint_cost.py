"""Cost of checkpoints: size and time of a checkpoint of 50 000 particles, and the share of the hopper run.

    python tools/checkpoint_cost.py --out DIR [--every SECONDS]

Writes checkpoint_cost.json into DIR. The hopper runs once, with a checkpoint every SECONDS of wall clock.
"""

import argparse
import json
import re
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PARTICLE_COUNT = (50, 40, 25)
"""Particles along each axis of a block in which each particle has six neighbors."""
SPACING = 4.01e-3

BLOCK = """\
title: Block of particles with small gaps
gravity: [0, 0, 0]
materials: {{glass: {{young_modulus: 50 MPa, poisson_ratio: 0.23, density: 2500}}}}
pairs: {{glass-glass: {{restitution: 0.8, friction: 0.5}}}}
contact: {{normal: zhou, tangential: mindlin, rolling: none}}
particles:
  beads:
    material: glass
    count: {count}
    diameter: 4 mm
    insert: {{kind: lattice, region: {{box: {{min: [0, 0, 0], max: {corner}}}}}}}
domain: {{min: [-1, -1, -1], max: [1, 1, 1], on_exit: delete}}
run: {{duration: 1 ms, velocity_max: 1 m/s}}
output: {{interval: 1 s, particles: false, walls: false}}
"""
TIMES = 5


def main() -> int:
    """Measures, prints and writes the results."""
    parser = argparse.ArgumentParser(description="Measures the cost of checkpoints.")
    parser.add_argument("--out", type=Path, required=True, help="directory of the results")
    parser.add_argument("--every", type=float, default=10.0, help="wall seconds between checkpoints of the hopper (10)")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    found = {"block": block(options.out / "block"), "hopper": hopper(options.out / "hopper", options.every)}
    (options.out / "checkpoint_cost.json").write_text(json.dumps(found, indent=2) + "\n")
    print(json.dumps(found, indent=2))
    return 0


def block(out: Path) -> dict[str, float]:
    """Size [bytes] and median time [s] of a checkpoint of a block of particles, and the time to read it."""
    from granflow.io.checkpoint import read_checkpoint
    from granflow.load import scene_of
    from granflow.simulation import Simulation

    count = PARTICLE_COUNT[0] * PARTICLE_COUNT[1] * PARTICLE_COUNT[2]
    text = BLOCK.format(count=count, corner=[SPACING * number for number in PARTICLE_COUNT])
    simulation = Simulation(scene_of(text, "block"), out=out)
    simulation.run(until=2e-5)
    seconds = []
    for _ in range(TIMES):
        began = time.perf_counter()
        simulation.save()
        seconds.append(time.perf_counter() - began)
    path = max(out.glob("checkpoint_*.npz"))
    began = time.perf_counter()
    contacts = read_checkpoint(path).saved["engine"]["contacts"]
    return {
        "particles": count,
        "contacts_per_particle": len(contacts["partner"]) / count,
        "bytes": path.stat().st_size,
        "bytes_per_particle": path.stat().st_size / count,
        "seconds": sorted(seconds)[TIMES // 2],
        "seconds_to_read": time.perf_counter() - began,
    }


def hopper(out: Path, every: float) -> dict[str, float]:
    """Number, time [s] and share of wall clock of the checkpoints of a complete hopper run."""
    command = [
        sys.executable,
        "-m",
        "granflow",
        "run",
        str(ROOT / "scenes" / "hopper.yaml"),
        "--out",
        str(out),
        "--overwrite",
    ]
    subprocess.run([*command, "--set", f"output.checkpoint.wall_clock={every}"], check=True, cwd=ROOT)
    log = (out / "run.log").read_text()
    seconds = [float(found) for found in re.findall(r"checkpoint at .* written in (\S+) s", log)]
    wall_clock = json.loads((out / "result.json").read_text())["run"]["wall_clock"]
    spent = sum(seconds)
    size = max(path.stat().st_size for path in out.glob("checkpoint_*.npz"))
    return {
        "checkpoints": len(seconds), "seconds_each": spent / len(seconds), "first": seconds[0],
        "wall_clock": wall_clock, "share": spent / wall_clock, "bytes": size,
    }  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
