"""Impacts of wet spheres: LIGGGHTS' `easo/capillary/viscous` and granflow, from the same start.

    python tools/validation/viscous_bridge.py --out out/viscous_bridge

Runs `inputs/in.viscous_bridge.liggghts` with the program `liggghts`, and the same two impacts in granflow. The
bridge stops the spheres of the first pair after the impact; that of the second pair ruptures. Prints the
distance at which the first pair stops and the speed of the second one, the numbers in
docs/pages/contact_models/capillary.md. LIGGGHTS ruptures bridges as with a contact angle of 0.
"""

import argparse
import subprocess
from pathlib import Path

import numpy as np

import granflow as gf

INPUT = Path(__file__).parent / "inputs" / "in.viscous_bridge.liggghts"
TIME_STEP, STEPS = 2.5e-7, 160000
RADIUS = 1e-3


def scene() -> gf.Scene:
    """The pairs of the input file."""
    viscous = {"viscosity": 0.1, "min_separation_ratio": 0.05}
    spheres = {
        "material": "glass",
        "count": 4,
        "diameter": 2.0 * RADIUS,
        "liquid_content": 0.2,
        "velocity": [[0.1, 0, 0], [-0.1, 0, 0], [0.4, 0, 0], [-0.4, 0, 0]],
        "insert": {
            "kind": "positions",
            "positions": [[-1.5e-3, 0, 0], [1.5e-3, 0, 0], [-1.5e-3, 0.01, 0], [1.5e-3, 0.01, 0]],
        },
    }
    return gf.Scene.from_dict(
        {
            "title": "Impacts of wet spheres",
            "gravity": [0, 0, 0],
            "materials": {"glass": {"young_modulus": 1e7, "poisson_ratio": 0.3, "density": 2500}},
            "pairs": {
                "glass-glass": {"restitution": 1, "friction": 0, "surface_tension": 1e-12, "contact_angle": 0}
            },
            "contact": {
                "normal": "hertz",
                "tangential": "none",
                "rolling": "none",
                "cohesion": {
                    "law": "capillary_transfer",
                    "max_bridge_volume": 1e-9,
                    "viscous_force": viscous,
                },
            },
            "particles": {"spheres": spheres},
            "domain": {"min": [-0.02] * 3, "max": [0.02] * 3, "on_exit": "error"},
            "run": {"duration": STEPS * TIME_STEP, "time_step": TIME_STEP, "velocity_max": 1},
            "output": {"interval": STEPS * TIME_STEP},
        }
    )


def main() -> None:
    """Run both codes and print the distance and the speed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/viscous_bridge"), metavar="DIR", help="files")
    directory = parser.parse_args().out
    directory.mkdir(parents=True, exist_ok=True)
    with open(directory / "log.txt", "w") as log:
        subprocess.run(["liggghts", "-in", str(INPUT)], cwd=directory, stdout=log, check=True)
    position, velocity = np.loadtxt(directory / f"dump.{STEPS}.txt", skiprows=9)[:, 1:].T
    with gf.Simulation(scene()) as simulation:
        simulation.run()
        particles = simulation.snapshot().particles
    print("           gap of the first pair [mm]   speed of the second pair [m/s]")
    for name, x, v in (
        ("LIGGGHTS", position, velocity),
        ("granflow", particles["position"][:, 0], particles["velocity"][:, 0]),
    ):
        print(f"{name}{1e3 * (x[1] - x[0] - 2.0 * RADIUS):26.6f}{v[3]:32.6f}")


if __name__ == "__main__":
    main()
