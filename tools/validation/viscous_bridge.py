"""Validation cases of viscous bridges: separation of two spheres against the closed form, and impacts of wet
spheres against LIGGGHTS' `easo/capillary/viscous`, from the same start.

    python tools/validation/viscous_bridge.py --out out/viscous_bridge

Spheres that separate at v0 have, with k = 6 pi eta R^2 / m, the velocity v0 - k (1 + ln(x / h)) at the distance
x above the smallest distance h of the model.

The command runs `inputs/in.viscous_bridge.liggghts` with the program `liggghts`, and the same two impacts in granflow. The
bridge stops the spheres of the first pair after the impact; that of the second pair ruptures. Prints the
distance at which the first pair stops and the speed of the second one, the numbers in
docs/pages/contact_models/capillary.md and in LIGGGHTS below. LIGGGHTS ruptures bridges as with a contact angle
of 0.
"""

import argparse
import math
import subprocess
import sys
from pathlib import Path

import numpy as np

import granflow as gf
from granflow.geometry.sphere import sphere_mass

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from validation.case import ValidationCase, shipped_scene  # noqa: E402

INPUT = Path(__file__).parent / "inputs" / "in.viscous_bridge.liggghts"
TIME_STEP, STEPS = 2.5e-7, 160000
RADIUS = 1e-3
LIGGGHTS = {"stopping distance after the impact": 3.0859e-5, "speed after rupture": 0.076779}
"""Figures of LIGGGHTS [m, m/s], which `main` prints."""
LIGGGHTS_RUN = "LIGGGHTS-PUBLIC 3.8.0, run on 2026-11-29 from the same positions and velocities"
VISCOSITY, SMALLEST, VOLUME, ANGLE, STEP = 0.1, 2.5e-5, 1e-11, 0.2, 1e-6
"""Viscosity [Pa s], smallest distance [m], volume [m3], contact angle [rad] and time step [s] of the scene
`viscous_bridge`; the impacts have the same viscosity and smallest distance."""
SPEEDS = (0.2, 0.4)
"""Relative velocities [m/s] at which its two pairs separate."""


def viscous_bridge_cases() -> list[ValidationCase]:
    """Stopping distance of one pair and speed of another after rupture: the closed form, and LIGGGHTS."""
    return [*_separation_cases(), *_impact_cases()]


def _separation_cases() -> list[ValidationCase]:
    """The scene `viscous_bridge`."""
    with gf.Simulation(shipped_scene("verification/viscous_bridge")) as simulation:
        simulation.run()
        particles = simulation.snapshot().particles
    x, v = (particles[name][:, 0] for name in ("position", "velocity"))
    stopping = _stopping(float(particles["mass"][0]))
    rupture = (1.0 + 0.5 * ANGLE) * VOLUME ** (1.0 / 3.0)
    after = SPEEDS[1] - stopping * (1.0 + math.log(rupture / SMALLEST))
    rows = (
        (
            "distance at which two spheres stop",
            SMALLEST * math.exp(SPEEDS[0] / stopping - 1.0),
            float(x[1] - x[0] - 2.0 * RADIUS),
            "m",
            (stopping * STEP / SMALLEST) ** 2,
            "(k dt / h)^2: the scheme is of second order",
        ),
        (
            "speed after rupture",
            after,
            float(v[3] - v[2]),
            "m/s",
            stopping * STEP / rupture,
            "rupture is at the end of a step, in which the relative change of the velocity is k dt / s_c",
        ),
    )
    return [
        ValidationCase(
            kind="Viscous liquid bridges",
            name=f"closed form: {name}",
            reference=reference,
            source="Adams & Perchard 1985: F = 6 pi eta R^2 v / x, integrated",
            value=value,
            unit=unit,
            allowed=allowed,
            derivation=reason,
        )
        for name, reference, value, unit, allowed, reason in rows
    ]


def _stopping(mass: float) -> float:
    """k = 6 pi eta R^2 / m [m/s] of two spheres of this mass [kg], with effective radius and reduced mass."""
    return 6.0 * math.pi * VISCOSITY * (0.5 * RADIUS) ** 2 / (0.5 * mass)


def _impact_cases() -> list[ValidationCase]:
    """The impacts that LIGGGHTS has simulated."""
    distance, speed = _figures_of_impacts()
    stopping = _stopping(float(sphere_mass(RADIUS, 2500.0)))
    return [
        ValidationCase(
            kind="Viscous liquid bridges",
            name=f"LIGGGHTS: {name}",
            reference=LIGGGHTS[name],
            source=LIGGGHTS_RUN,
            value=value,
            unit=unit,
            allowed=2.0 * stopping * TIME_STEP / SMALLEST,
            derivation="a step in contact changes the velocity by k dt / h; the codes differ by one step at the "
            "formation of the bridge and one at its rupture",
        )
        for name, value, unit in zip(LIGGGHTS, (distance, speed), ("m", "m/s"), strict=True)
    ]


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


def _figures_of_impacts() -> tuple[float, float]:
    """Distance [m] at which the first pair stops, and speed [m/s] of the second one."""
    with gf.Simulation(scene()) as simulation:
        simulation.run()
        particles = simulation.snapshot().particles
    x, v = particles["position"][:, 0], particles["velocity"][:, 0]
    return float(x[1] - x[0] - 2.0 * RADIUS), float(v[3])


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
    print("           gap of the first pair [mm]   speed of the second pair [m/s]")
    for name, distance, speed in (
        ("LIGGGHTS", position[1] - position[0] - 2.0 * RADIUS, velocity[3]),
        ("granflow", *_figures_of_impacts()),
    ):
        print(f"{name}{1e3 * distance:26.6f}{speed:32.6f}")


if __name__ == "__main__":
    main()
