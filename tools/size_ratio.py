"""What wide sizes cost: the search class by class against one grid for all, in the same settled beds.

    python tools/size_ratio.py [--count 20000] [--ratios 1 2 3 5 10 20] [--rounds 3]

Every bed holds the same mass of each of its sizes, which are about twice as wide from one to the next, between
periodic sides over a floor. Both ways of searching go on from the same settled state, in turn, on one thread; CPU time
is counted, and the least of all rounds is printed.
"""

import argparse
import time
from math import ceil, inf, log2

import numpy as np

from granflow.device.checkpoint import EngineCheckpoint
from granflow.plan import size_classes
from granflow.scene import Scene
from granflow.simulation import Simulation

SMALLEST = 1e-3
"""Diameter [m] of the smallest."""

STEPS_A_SEARCH = 50
"""Steps from search to search in a bed that flows, for the rate of both together."""

SOLID_FRACTION = 0.5
STEPS = 200


def scene_of(ratio: float, count: int) -> Scene:
    """A bed of so many particles, whose largest are `ratio` times as wide as the smallest."""
    steps = max(ceil(log2(ratio)), 1)
    diameters = SMALLEST * ratio ** (np.arange(steps + 1) / steps) if ratio > 1.0 else np.array([SMALLEST])
    volume = count * len(diameters) * np.pi / 6.0 / np.sum(diameters**-3.0)
    width = max((volume / SOLID_FRACTION) ** (1 / 3), 2.1 * diameters[-1] + 0.5 * SMALLEST)
    height = max(volume / SOLID_FRACTION / width**2, diameters[-1])
    classes = [{"diameter": float(each), "fraction": 1.0 / len(diameters)} for each in diameters]
    return Scene.model_validate({
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


def relaxed(ratio: float, count: int) -> tuple[Simulation, Simulation]:
    """The same bed at rest, searched class by class and with one grid."""
    scene, wide = scene_of(ratio, count), size_classes.CLASSES_FROM_RATIO
    size_classes.CLASSES_FROM_RATIO = 1.0 + 1e-9
    by_class = Simulation(scene, threads=1)
    by_class.run()
    size_classes.CLASSES_FROM_RATIO = inf
    one_grid = Simulation(scene, threads=1)
    size_classes.CLASSES_FROM_RATIO = wide
    EngineCheckpoint(one_grid.engine).load_state_dict(EngineCheckpoint(by_class.engine).state_dict(), [()])
    return by_class, one_grid


def cpu_seconds(simulation: Simulation) -> tuple[float, float]:
    """CPU seconds of one search, and of one step without."""
    stepper, began = simulation.engine.stepper, time.process_time()
    stepper.rebuild_neighbor_lists()
    searched, searches = time.process_time(), stepper.timing.rebuild_count
    stepper.forces(history_step=0.0)
    stepping = time.process_time()
    simulation.engine.advance(STEPS)
    ended = time.process_time()
    again = stepper.timing.rebuild_count - searches
    return searched - began, max(ended - stepping - again * (searched - began), 0.0) / STEPS


def row(ratio: float, count: int, rounds: int) -> str:
    """One line of the table."""
    both = relaxed(ratio, count)
    for simulation in both:
        cpu_seconds(simulation)
    times = np.array([[cpu_seconds(simulation) for simulation in both] for _ in range(rounds)]).min(axis=0)
    (search, step), (search_one, step_one) = times.tolist()
    classes, contacts = len(both[0].plan.size_classes), both[0].snapshot().totals["contact_count"]
    gain = (search_one + STEPS_A_SEARCH * step_one) / (search + STEPS_A_SEARCH * step)
    rate = count / (search / STEPS_A_SEARCH + step) / 1e6
    for simulation in both:
        simulation.free()
    return (
        f"| 1 : {ratio:g} | {classes} | {contacts / count:.2f} | {1e6 * search_one / count:.2f} | "
        f"{1e6 * search / count:.2f} | {search_one / search:.2f} | {1e6 * step / count:.3f} | {rate:.2f} | {gain:.2f} |"
    )


def main() -> None:
    """Print the table, line by line as it is found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=20_000, help="particles in a bed (20000)")
    parser.add_argument("--ratios", type=float, nargs="+", default=[1, 2, 3, 5, 10, 20], help="largest over smallest")
    parser.add_argument("--rounds", type=int, default=3, help="rounds (3)")
    options = parser.parse_args()
    print(f"{options.count} particles, microseconds of CPU for each; with a search every {STEPS_A_SEARCH} steps:")
    print("| sizes | classes | contacts | search, one grid | by class | faster | step | million a second | faster |")
    print("|---|---|---|---|---|---|---|---|---|")
    for ratio in options.ratios:
        print(row(ratio, options.count, options.rounds), flush=True)


if __name__ == "__main__":
    main()
