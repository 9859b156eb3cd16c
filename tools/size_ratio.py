"""Cost of polydispersity: neighbor-list rebuilds with one cell grid per size class and with one grid for all
sizes.

    python tools/size_ratio.py [--count 20000] [--ratios 1 2 3 5 10 20] [--rounds 3]

Each bed has equal masses of its sizes, which increase by a factor of about two, periodic sides and a floor.
Both methods start from the same settled state and are measured in turn on one thread. The table shows the
smallest CPU time of all rounds.
"""

import argparse
import time
from math import ceil, inf, log2

import numpy as np

from granflow.engine.checkpoint import restore_state, saved_state
from granflow.load import Scene
from granflow.plan import size_classes
from granflow.simulation import Simulation

SMALLEST = 1e-3
"""Smallest diameter [m]."""

STEPS_PER_REBUILD = 50
"""Assumed steps between rebuilds of a flowing bed, for the total rate."""

SOLID_FRACTION = 0.5
STEPS = 200


def scene_of(ratio: float, count: int) -> Scene:
    """Scene of a bed of `count` particles with a ratio `ratio` of the largest to the smallest diameter."""
    steps = max(ceil(log2(ratio)), 1)
    diameters = SMALLEST * ratio ** (np.arange(steps + 1) / steps) if ratio > 1.0 else np.array([SMALLEST])
    volume = count * len(diameters) * np.pi / 6.0 / np.sum(diameters**-3.0)
    width = max((volume / SOLID_FRACTION) ** (1 / 3), 2.1 * diameters[-1] + 0.5 * SMALLEST)
    height = max(volume / SOLID_FRACTION / width**2, diameters[-1])
    classes = [{"diameter": float(each), "fraction": 1.0 / len(diameters)} for each in diameters]
    return Scene.from_dict({
        "title": f"Bed of sizes 1 : {ratio:g}",
        "gravity": [0.0, 0.0, -9.81],
        "materials": {"glass": {"young_modulus": 1e7, "poisson_ratio": 0.25, "density": 2500.0}},
        "pairs": {"glass-glass": {"restitution": 0.5, "friction": 0.5}},
        "contact": {"normal": "hertz", "tangential": "mindlin", "rolling": "none"},
        "walls": {"floor": {"shape": "plane", "point": [0, 0, 0], "normal": [0, 0, 1], "material": "glass"}},
        "particles": {
            "bed": {
                "material": "glass", "count": count,
                "diameter": {"distribution": "classes", "by": "mass", "classes": classes},
                "insert": {"kind": "pack", "region": {"box": {"min": [0, 0, 0], "max": [width, width, 1.1 * height]}}},
            }
        },
        "domain": {"min": [0, 0, -0.1], "max": [width, width, 3 * height], "periodic": ["x", "y"], "on_exit": "error"},
        "run": {"duration": 0.05, "velocity_max": 1.0},
        "numerics": {"chunk_size": 1024, "max_overlap": 0.3, "rayleigh_fraction": 0.3},
        "output": {"interval": 1.0},
    })  # fmt: skip


def settled_beds(ratio: float, count: int) -> tuple[Simulation, Simulation]:
    """The same settled bed twice: with one grid per size class, and with one grid."""
    scene = scene_of(ratio, count)
    threshold = size_classes.CLASSES_FROM_RATIO
    size_classes.CLASSES_FROM_RATIO = 1.0 + 1e-9
    by_class = Simulation(scene, threads=1)
    by_class.run()
    size_classes.CLASSES_FROM_RATIO = inf
    one_grid = Simulation(scene, threads=1)
    size_classes.CLASSES_FROM_RATIO = threshold
    restore_state(one_grid.engine, saved_state(by_class.engine), [()])
    return by_class, one_grid


def cpu_seconds(simulation: Simulation) -> tuple[float, float]:
    """CPU time [s] of one rebuild, and of one step without rebuild."""
    stepper = simulation.engine.stepper
    began = time.process_time()
    stepper.rebuild_neighbor_lists(0)
    rebuild = time.process_time() - began
    rebuilds_before = stepper.timing.rebuild_count
    stepper.forces(history_step=0.0)
    stepping = time.process_time()
    simulation.engine.advance(STEPS)
    ended = time.process_time()
    rebuilds = stepper.timing.rebuild_count - rebuilds_before
    return rebuild, max(ended - stepping - rebuilds * rebuild, 0.0) / STEPS


def row(ratio: float, count: int, rounds: int) -> str:
    """One row of the table."""
    both = settled_beds(ratio, count)
    for simulation in both:
        cpu_seconds(simulation)
    times = np.array([[cpu_seconds(simulation) for simulation in both] for _ in range(rounds)]).min(axis=0)
    (rebuild, step), (rebuild_one_grid, step_one_grid) = times.tolist()
    classes = len(both[0].plan.size_classes)
    contacts = both[0].snapshot().totals["contact_count"]
    speedup = (rebuild_one_grid + STEPS_PER_REBUILD * step_one_grid) / (rebuild + STEPS_PER_REBUILD * step)
    rate = count / (rebuild / STEPS_PER_REBUILD + step) / 1e6
    for simulation in both:
        simulation.free()
    return (
        f"| 1 : {ratio:g} | {classes} | {contacts / count:.2f} | {1e6 * rebuild_one_grid / count:.2f} | "
        f"{1e6 * rebuild / count:.2f} | {rebuild_one_grid / rebuild:.2f} | "
        f"{1e6 * step / count:.3f} | {rate:.2f} | {speedup:.2f} |"
    )


def main() -> None:
    """Prints the table, each row when it is measured."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=20_000, help="particles in a bed (20000)")
    parser.add_argument(
        "--ratios",
        type=float,
        nargs="+",
        default=[1, 2, 3, 5, 10, 20],
        help="ratios of the largest to the smallest diameter",
    )
    parser.add_argument("--rounds", type=int, default=3, help="rounds (3)")
    options = parser.parse_args()
    print(
        f"{options.count} particles, CPU time in us per particle; one rebuild every {STEPS_PER_REBUILD} "
        "steps:"
    )
    print(
        "| sizes | classes | contacts | rebuild, one grid | per class | speedup | step | M steps/s | total "
        "speedup |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for ratio in options.ratios:
        print(row(ratio, options.count, options.rounds), flush=True)


if __name__ == "__main__":
    main()
