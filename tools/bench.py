"""Particle-steps per second on settled beds, each point in a process of its own.

    python tools/bench.py BED.data[.gz]:SIDE ... [--threads 1 2] [--law hertz zhou] [--precision f64]

A bed is a LAMMPS data file (columns id type diameter density x y z) of spheres at rest in a box of the given side
[m] with five frictional walls. Material and step are those of the peers' inputs: E 10 MPa, nu 0.25, friction 0.5,
restitution 0.9, step 1e-5 s.
"""

import argparse
import gzip
import json
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

SCENE = """
title: Settled bed
gravity: [0, 0, -9.81]
materials: {{m: {{young_modulus: 10 MPa, poisson_ratio: 0.25, density: 2500}}}}
pairs: {{m-m: {{restitution: 0.9, friction: 0.5}}}}
contact: {{normal: {law}, tangential: mindlin, rolling: none}}
walls:
  floor: {{shape: plane, point: [0, 0, 0], normal: [0, 0, 1], material: m}}
  left: {{shape: plane, point: [0, 0, 0], normal: [1, 0, 0], material: m}}
  right: {{shape: plane, point: [{side}, 0, 0], normal: [-1, 0, 0], material: m}}
  front: {{shape: plane, point: [0, 0, 0], normal: [0, 1, 0], material: m}}
  back: {{shape: plane, point: [0, {side}, 0], normal: [0, -1, 0], material: m}}
particles:
  bed: {{material: m, diameter: {diameters}, place: {{kind: list, positions: {positions}}}}}
domain: {{min: [-0.01, -0.01, -0.01], max: [{high}, {high}, 2], leaving: error}}
run: {{duration: 1 s, time_step: 1e-5, velocity_max: 0.3 m/s, precision: {precision}}}
numerics: {{skin: 0.2 mm}}
output: {{interval: 1 s}}
"""
WINDOWS = 5


def main() -> None:
    """Measure every combination and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("beds", nargs="+", metavar="BED:SIDE")
    parser.add_argument("--threads", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--law", nargs="+", default=["hertz", "zhou"])
    parser.add_argument("--precision", default="f64", choices=("f64", "f32", "mixed"))
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measure(options.beds[0], options.law[0], options.precision, options.threads[0])))
        return
    print("spheres  law    threads  M particle-steps/s (min, max)   contacts/sphere  searches/1000 steps  "
          "compile [s]  kB/sphere")  # fmt: skip
    for bed in options.beds:
        for law in options.law:
            for threads in options.threads:
                print(row(child(bed, law, options.precision, threads)), flush=True)


def child(bed: str, law: str, precision: str, threads: int) -> dict[str, Any]:
    """Measure one point in a new process: Taichi starts once per process."""
    command = [sys.executable, __file__, bed, "--law", law, "--precision", precision, "--threads", str(threads)]
    done = subprocess.run([*command, "--one"], check=True, text=True, stdout=subprocess.PIPE)
    return json.loads(done.stdout.splitlines()[-1]) | {"law": law, "threads": threads}


def row(point: dict[str, Any]) -> str:
    """One line of the table."""
    rates = point["rates"]
    return (
        f"{point['count']:7d}  {point['law']:<6} {point['threads']:7d}  {statistics.median(rates):8.2f} "
        f"({min(rates):.2f}, {max(rates):.2f})   {point['contacts']:17.2f}  {point['searches']:19.1f}  "
        f"{point['compile']:11.2f}  {point['kilobytes']:9.2f}"
    )


def measure(bed: str, law: str, precision: str, threads: int) -> dict[str, Any]:
    """Rates of WINDOWS windows after a warm-up."""
    from granflow.device.backend import start
    from granflow.device.engine import Engine
    from granflow.plan import plan_for
    from granflow.scene import load
    from granflow.scene.generate import Grains

    path, _, side = bed.rpartition(":")
    grains = read_bed(Path(path))
    with tempfile.TemporaryDirectory() as folder:
        scene_file = Path(folder) / "bed.yaml"
        scene_file.write_text(scene_text(grains, law, precision, float(side)))
        plan = plan_for(load(scene_file))
    backend, count = start("cpu", precision, threads), len(grains)  # type: ignore[arg-type]
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    engine = Engine(plan, backend)
    still = np.zeros((count, 3))
    none = np.zeros(count, np.int32)
    engine.insert(Grains(grains[:, 1:4], still, still, 0.5 * grains[:, 0], none, none))
    engine.set_walls([True] * 5, [()] * 5)
    engine.refresh()
    steps = max(int(4e6 / count), 20)
    engine.advance(2 * steps)
    rates = [timed(engine, steps) * count / 1e6 for _ in range(WINDOWS)]
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    return {
        "count": count,
        "rates": rates,
        "contacts": engine.survey.measure()["contact_count"] / count,
        "searches": 1000.0 * (engine.timing.search_count - 1) / engine.timing.step_count,
        "compile": engine.timing.compile,
        "kilobytes": used / count,
    }


def timed(engine: Any, steps: int) -> float:
    """Steps per second of one window."""
    began = time.perf_counter()
    engine.advance(steps)
    return steps / (time.perf_counter() - began)


def read_bed(path: Path) -> np.ndarray:
    """Diameter and centre (n, 4) [m] of every sphere of a LAMMPS data file."""
    opened = gzip.open(path, "rt") if path.suffix == ".gz" else open(path)
    with opened as lines:
        rows = [line.split() for line in lines]
    return np.array([[float(row[2]), *map(float, row[4:7])] for row in rows if len(row) == 7])


def scene_text(grains: np.ndarray, law: str, precision: str, side: float) -> str:
    """The bed as a scene; two spheres stand for the sizes, the rest comes in as arrays."""
    smallest, largest = float(grains[:, 0].min()), float(grains[:, 0].max())
    sizes = [smallest, largest] + [largest] * (len(grains) - 2)
    places = [[0.0, 0.0, 0.0]] * len(grains)
    return SCENE.format(
        law=law, precision=precision, side=side, high=side + 0.01, diameters=sizes, positions=places
    )  # fmt: skip


if __name__ == "__main__":
    main()
