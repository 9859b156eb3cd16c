"""Heap of particles at rest: kinetic energy and creep with and without rest damping, for the page of the
model zhou.

    python tools/rest_study.py [--seconds 10] [--out docs/pages/assets/rest.png]

Particles fall as a pyramid onto a layer of fixed particles and form a heap.
"""

import argparse

import matplotlib
import numpy as np

import granflow as gf

DIAMETER = 0.01
CASES = {
    "rest_damping 0": ({"law": "zhou", "rest_damping": 0.0}, "none"),
    "rest_damping 0.1 (default)": ("zhou", "none"),
    "rest_damping 0.1, rolling sds": ("zhou", "sds"),
}
"""Normal and rolling model of each curve."""


def scene(normal: object, rolling: str, seconds: float) -> gf.Scene:
    """A pyramid of 180 particles above 13 x 13 fixed particles."""
    floor = [[DIAMETER * i, DIAMETER * j, 0.0] for i in range(-6, 7) for j in range(-6, 7)]
    layers = ((7, 0), (6, 1), (5, 2), (5, 3), (4, 4), (4, 5), (3, 6))
    pyramid = [
        [
            1.05 * DIAMETER * (i - 0.5 * (side - 1)),
            1.05 * DIAMETER * (j - 0.5 * (side - 1)),
            DIAMETER * (1.1 + layer),
        ]
        for side, layer in layers
        for i in range(side)
        for j in range(side)
    ]
    shifts = np.random.default_rng(3).uniform(-0.02 * DIAMETER, 0.02 * DIAMETER, (len(pyramid), 3))
    usual = {"material": "glass", "diameter": DIAMETER}
    friction = {} if rolling == "none" else {"rolling_friction": 0.05, "rolling_damping": 0.3}
    return gf.Scene.from_dict(
        {
            "title": "Heap at rest",
            "gravity": [0, 0, -9.81],
            "materials": {"glass": {"young_modulus": 1e7, "poisson_ratio": 0.25, "density": 2500}},
            "pairs": {"glass-glass": {"restitution": 0.6, "friction": 0.5} | friction},
            "contact": {"normal": normal, "tangential": "mindlin", "rolling": rolling},
            "particles": {
                "floor": usual | {"fixed": True, "insert": {"kind": "positions", "positions": floor}},
                "heap": usual
                | {"insert": {"kind": "positions", "positions": (np.array(pyramid) + shifts).tolist()}},
            },
            "domain": {"min": [-0.2, -0.2, -0.05], "max": [0.2, 0.2, 0.2], "on_exit": "delete"},
            "run": {"duration": seconds, "velocity_max": 1.0},
            "numerics": {"time_step_fraction": 0.2},
            "output": {"interval": seconds, "energy_budget": True},
        }
    )


def measure(heap: gf.Scene, seconds: float, samples: int) -> dict[str, np.ndarray]:
    """Times [s], kinetic energies [J] of translation and rotation, and largest speed [radii/s] over each
    interval."""
    rows = []
    before = None
    with gf.Simulation(heap) as simulation:
        for _ in range(samples):
            simulation.run(duration=seconds / samples)
            snapshot = simulation.snapshot()
            position = snapshot.particles["position"]
            moved = np.nan
            if before is not None and len(before) == len(position):
                path = np.linalg.norm(position - before, axis=1).max()
                moved = path / (0.5 * DIAMETER) * samples / seconds
            before = position
            totals = snapshot.totals
            rows.append((snapshot.time, totals["kinetic_energy"], totals["rotational_energy"], moved))
        print(f"  elastic energy {totals['elastic_energy']:.3g} J, energy error {totals['energy_error']:.2g}")
    return dict(zip(("time", "kinetic", "rotational", "speed"), np.array(rows).T, strict=True))


def draw(curves: dict[str, dict[str, np.ndarray]], path: str) -> None:
    """Kinetic energy and largest speed over time."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, (left, right) = pyplot.subplots(1, 2, figsize=(10, 3.6), constrained_layout=True)
    for name, curve in curves.items():
        left.semilogy(curve["time"], curve["kinetic"], label=name)
        right.semilogy(curve["time"], curve["speed"], label=name)
    left.set(xlabel="time [s]", ylabel="kinetic energy [J]")
    right.set(xlabel="time [s]", ylabel="largest speed [radii/s]")
    right.axhline(1e-6, color="0.6", linewidth=0.8)
    left.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Simulate all cases, print their ends, draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--out", default="docs/pages/assets/rest.png")
    options = parser.parse_args()
    curves = {}
    for name, (normal, rolling) in CASES.items():
        print(name, flush=True)
        curves[name] = curve = measure(scene(normal, rolling, options.seconds), options.seconds, 50)
        for key in ("kinetic", "rotational", "speed"):
            print(f"  {key}: " + " ".join(f"{value:.2g}" for value in curve[key][4::5]), flush=True)
    draw(curves, options.out)


if __name__ == "__main__":
    main()
