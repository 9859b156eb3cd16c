"""Heat conduction in a bed: LIGGGHTS' example `heatTransfer_1` and granflow, from the same particles.

    python tools/validation/heat.py --out out/heat

Runs `inputs/in.heat.liggghts` with the program `liggghts` and continues its settled bed of 890 spheres in
granflow. Prints the mean temperature of the heated half minus that of the other, the number in
docs/pages/contact_models/conduction.md. LIGGGHTS takes the square root of the contact area for the contact
radius: its conductivity is sqrt(2 pi) times smaller than that of granflow.
"""

import argparse
import math
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

import granflow as gf

INPUT = Path(__file__).parent / "inputs" / "in.heat.liggghts"
FIRST, LAST, BETWEEN = 40000, 70000, 2000
"""Steps of the dumps."""
TIME_STEP = 2.5e-5
HOT, COLD = 800.0, 300.0


def dump_of(directory: Path, step: int) -> np.ndarray:
    """Rows of a dump in the order of ids: id, position (3), velocity (3), radius, temperature."""
    return np.loadtxt(directory / f"dump.{step}.txt", skiprows=9)


def scene_of(start: np.ndarray, is_hot: np.ndarray) -> gf.Scene:
    """The bed of LIGGGHTS at the first dump."""

    def group(mask: np.ndarray, temperature: float) -> dict[str, Any]:
        return {
            "material": "solid",
            "diameter": 2.0 * float(start[0, 7]),
            "temperature": temperature,
            "velocity": start[mask, 4:7].tolist(),
            "insert": {"kind": "positions", "positions": start[mask, 1:4].tolist()},
        }

    solid = {
        "young_modulus": 5e6,
        "poisson_ratio": 0.45,
        "density": 8000.0,
        "thermal_conductivity": 100.0 * math.sqrt(2.0 * math.pi),
        "heat_capacity": 10.0,
    }
    tube = {"shape": "cylinder", "from": [0, 0, 0], "to": [0, 0, 0.15], "radius": 0.05, "material": "solid"}
    return gf.Scene.from_dict(
        {
            "title": "Heat conduction in a bed",
            "gravity": [0, 0, -9.81],
            "materials": {"solid": solid},
            "pairs": {"solid-solid": {"restitution": 0.7, "friction": 0.05}},
            "contact": {
                "normal": "hertz",
                "tangential": {"law": "mindlin", "damping": 1.0},
                "rolling": "none",
                "heat": "conduction",
            },
            "particles": {"hot": group(is_hot, HOT), "cold": group(~is_hot, COLD)},
            "walls": {
                "floor": {"shape": "plane", "point": [0, 0, 0], "normal": [0, 0, 1], "material": "solid"},
                "tube": tube,
            },
            "domain": {"min": [-0.06, -0.06, -0.01], "max": [0.06, 0.06, 0.16], "on_exit": "error"},
            "run": {"duration": 0.75, "time_step": TIME_STEP, "velocity_max": 0.5},
            "numerics": {"max_overlap": 0.2},
            "output": {"interval": 0.75},
        }
    )


def difference(temperature: np.ndarray, is_hot: np.ndarray) -> float:
    """Mean temperature [K] of the heated half minus that of the other."""
    return float(temperature[is_hot].mean() - temperature[~is_hot].mean())


def main() -> None:
    """Run both codes and print the differences of temperature."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/heat"), metavar="DIR", help="files of LIGGGHTS")
    directory = parser.parse_args().out
    directory.mkdir(parents=True, exist_ok=True)
    with open(directory / "log.txt", "w") as log:
        subprocess.run(["liggghts", "-in", str(INPUT)], cwd=directory, stdout=log, check=True)
    start = dump_of(directory, FIRST)
    is_hot = start[:, 8] > 0.5 * (HOT + COLD)
    order = np.argsort(np.argsort(~is_hot, kind="stable"))  # hot particles have the first ids in granflow
    print("time [s]   LIGGGHTS [K]   granflow [K]")
    with gf.Simulation(scene_of(start, is_hot)) as simulation:
        for step in range(FIRST, LAST + 1, BETWEEN):
            own = simulation.snapshot().particles["temperature"][order]
            other = dump_of(directory, step)[:, 8]
            time = (step - FIRST) * TIME_STEP
            print(f"{time:8.3f}{difference(other, is_hot):15.3f}{difference(own, is_hot):15.3f}")
            if step < LAST:
                simulation.step(BETWEEN)


if __name__ == "__main__":
    main()
