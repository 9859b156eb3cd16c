"""Equal restitution, different dissipation: columns of spheres on a floor, and a shaken box, with every
normal model.

    python tools/dissipation_study.py [--box-seconds 1.0]

Prints the kinetic energy that a column of N touching spheres keeps in an impact, and the power that a shaken
bed draws.
"""

import argparse

import numpy as np

import granflow as gf

DIAMETER, RESTITUTION, GRAVITY = 0.004, 0.8, 9.81
GAMMA, FREQUENCY = 3.0, 25.0
SPRING = {"stiffness": {"reference_velocity": 0.5}}
MODELS: dict[str, dict[str, object]] = {
    "zhou": {"law": "zhou"},
    "zhou, undamped": {"law": "zhou", "rest_damping": 0.0},
    "walton_braun": {"law": "walton_braun", "unloading": {"reference_velocity": 0.5}, **SPRING},
    "linear": {"law": "linear", **SPRING},
    "hertz": {"law": "hertz"},
}
"""Plastic models first, then viscous ones."""


def scene(normal: dict[str, object], friction: float, **parts: object) -> gf.Scene:
    """A scene of glass spheres of one restitution in all contacts."""
    return gf.Scene.from_dict(
        {
            "title": "Dissipation",
            "materials": {"glass": {"young_modulus": 2e7, "poisson_ratio": 0.25, "density": 2500}},
            "pairs": {"glass-glass": {"restitution": RESTITUTION, "friction": friction}},
            "contact": {"normal": normal, "tangential": "mindlin", "rolling": "none"},
            "domain": {"min": [-0.1, -0.1, -0.1], "max": [0.1, 0.1, 0.4], "on_exit": "error"},
            **parts,
        }
    )


def kept_energy(normal: dict[str, object], count: int, speed: float = 0.5) -> tuple[float, float]:
    """Kinetic energy after the impact of a column over that before: all, and that of its center of mass.

    Without gravity; the spheres just touch. The run ends long after the last contact.
    """
    centers = [[0.0, 0.0, DIAMETER * (0.5 + k) + 1e-5] for k in range(count)]
    spheres = {"material": "glass", "diameter": DIAMETER, "velocity": [0.0, 0.0, -speed]}
    column = scene(
        normal,
        0.0,
        gravity=[0, 0, 0],
        walls={"floor": {"shape": "plane", "point": [0, 0, 0], "normal": [0, 0, 1], "material": "glass"}},
        particles={"column": spheres | {"insert": {"kind": "positions", "positions": centers}}},
        run={"duration": 0.02, "velocity_max": speed},
        output={"interval": 1.0},
    )
    with gf.Simulation(column, threads=1) as simulation:
        simulation.run()
        velocity = simulation.snapshot().particles["velocity"][:, 2]
    return float(np.mean(velocity**2) / speed**2), float(np.mean(velocity) ** 2 / speed**2)


def shaken_box(normal: dict[str, object], count: int, seconds: float) -> dict[str, float]:
    """Power [W] of a box of 40 mm x 20 mm, and its dissipation by kind [W], after five periods."""
    side = 0.04
    depth = 0.02
    height = 0.2
    motion = {"kind": "vibration", "direction": [0, 0, 1], "gamma": GAMMA, "frequency": FREQUENCY}
    usual = {"shape": "plane", "material": "glass", "motion": [motion]}
    faces = {
        "floor": ([0, 0, 0], [0, 0, 1]),
        "left": ([0, 0, 0], [1, 0, 0]),
        "right": ([side, 0, 0], [-1, 0, 0]),
        "front": ([0, 0, 0], [0, 1, 0]),
        "back": ([0, depth, 0], [0, -1, 0]),
    }
    bed = scene(
        normal,
        0.3,
        gravity=[0, 0, -GRAVITY],
        walls={name: usual | {"point": point, "normal": toward} for name, (point, toward) in faces.items()},
        particles={
            "bed": {
                "material": "glass",
                "count": count,
                "diameter": {
                    "distribution": "normal",
                    "mean": "4 mm",
                    "deviation": "0.2 mm",
                    "min": 0.0036,
                    "max": 0.0044,
                },
                "insert": {
                    "kind": "lattice",
                    "region": {"box": {"min": [0, 0, 0], "max": [side, depth, height]}},
                    "jitter": 0.1,
                },
            }
        },
        run={"duration": seconds + 5.0 / FREQUENCY, "velocity_max": 1.5},
        numerics={"time_step_fraction": 0.1},
        output={"interval": seconds, "energy_budget": True},
    )
    with gf.Simulation(bed, threads=1) as simulation:
        simulation.run(duration=5.0 / FREQUENCY)
        first = simulation.snapshot().totals
        simulation.run()
        last = simulation.snapshot().totals
    kinds = ("wall_work", *(f"{name}_dissipation" for name in ("plastic", "damping", "friction")))
    return {name: (last[name] - first[name]) / seconds for name in kinds}


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--box-seconds", type=float, default=1.0)
    parser.add_argument("--box-particles", type=int, default=300)
    options = parser.parse_args()
    counts = (1, 2, 3, 5, 8)
    print("kinetic energy kept by a column of N spheres: all (center of mass); N =", *counts)
    for name, normal in MODELS.items():
        kept = [kept_energy(normal, count) for count in counts]
        print(f"{name:14}", *(f"{total:.3f} ({center:.3f})" for total, center in kept), flush=True)
    print("power of a shaken box [mW]: wall work, plastic, viscous, friction")
    for name, normal in MODELS.items():
        powers = shaken_box(normal, options.box_particles, options.box_seconds)
        print(f"{name:14}", *(f"{1e3 * power:.2f}" for power in powers.values()), flush=True)


if __name__ == "__main__":
    main()
