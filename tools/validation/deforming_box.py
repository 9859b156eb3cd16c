"""Validation cases of a deforming periodic box: a simple cubic lattice of Hertz spheres.

Cells of the sides a have one contact along each axis, with the overlap d - a of two spheres of diameter d:

    P_x = F(d - a_x) / (a_y a_z),     F = k overlap^(3/2),     work of the box: 2/5 F overlap for each contact

A packing that is compressed evenly at a strain rate has W = W0 exp(rate t).
"""

import math

import numpy as np
from scipy.optimize import fsolve

from granflow import Scene, Simulation, Snapshot
from validation.case import ValidationCase

AXES = "xyz"
COUNT, DIAMETER = 3, 0.01
"""Spheres along each axis, and their diameter [m]; the cells have this width at the start."""
SOLID = {"young_modulus": 1e8, "poisson_ratio": 0.25, "density": 2500.0}
STIFFNESS = (
    4.0
    / 3.0
    * SOLID["young_modulus"]
    / (2.0 * (1.0 - SOLID["poisson_ratio"] ** 2))
    * math.sqrt(0.25 * DIAMETER)
)
"""k = 4/3 E* sqrt(R*) [N/m^1.5] with E* = E / (2 (1 - nu^2)) and R* = R / 2."""
RATE, COMPRESSION, STEP = -1.0, 0.004, 4e-6
"""Strain rate [1/s] and duration [s] of the compression, and time step [s]."""
TARGETS = (2e3, 3e3, 4e3)
"""Pressures [Pa] along x, y and z in the second stage."""
HERTZ = "Hertz 1882; Christoffersen, Mehrabadi & Nemat-Nasser 1981, doi 10.1115/1.3157619"


def deforming_box_cases() -> list[ValidationCase]:
    """Width, pressure and work of an even compression, and widths at three target pressures."""
    with Simulation(_scene()) as simulation:
        simulation.run(until=COMPRESSION)
        compressed = simulation.snapshot()
        simulation.run()
        controlled = simulation.snapshot()
    return [*_compression_cases(compressed), *_target_cases(controlled)]


def _compression_cases(box: Snapshot) -> list[ValidationCase]:
    cell = DIAMETER * math.exp(RATE * box.time)
    overlap = DIAMETER - cell
    force = STIFFNESS * overlap**1.5
    of_width = RATE**2 * STEP * COMPRESSION
    of_overlap = of_width * cell / overlap
    rows = (
        ("width over that at the start", cell / DIAMETER, box.totals["box_width_x"] / (COUNT * DIAMETER), "1", of_width),
        ("pressure", force / cell**2, box.totals["box_pressure"], "Pa", 1.5 * of_overlap),
        (
            "work of the box",
            3 * COUNT**3 * 0.4 * force * overlap,
            box.totals["boundary_work"] - box.totals["kinetic_energy"],
            "J",
            2.5 * of_overlap,
        ),
    )  # fmt: skip
    return [
        ValidationCase(
            kind="Deforming box",
            name=f"cubic lattice under an isotropic strain rate: {name}",
            reference=reference,
            source=HERTZ,
            value=value,
            unit=unit,
            allowed=allowed,
            derivation="W grows by rate W dt in a step: its relative error is rate^2 t dt / 2, here twice this "
            "number, that of the overlap larger by W over the overlap, times the exponent of the overlap",
        )
        for name, reference, value, unit, allowed in rows
    ]


def _target_cases(box: Snapshot) -> list[ValidationCase]:
    def difference(overlaps: np.ndarray) -> np.ndarray:
        cell = DIAMETER - 1e-5 * overlaps
        pressure = STIFFNESS * (1e-5 * overlaps) ** 1.5 * cell / cell.prod()
        return np.asarray(pressure / TARGETS - 1.0)

    overlaps = 1e-5 * fsolve(difference, np.full(3, 2.0), xtol=1e-12)
    found = [DIAMETER - box.totals[f"box_width_{axis}"] / COUNT for axis in AXES]
    return [
        ValidationCase(
            kind="Deforming box",
            name=f"cubic lattice, target of {target / 1e3:g} kPa along {axis}: overlap",
            reference=float(reference),
            source=HERTZ,
            value=value,
            unit="m",
            allowed=1e-6,
            derivation="rounding of the forces, which are added on a grid",
        )
        for axis, target, reference, value in zip(AXES, TARGETS, overlaps, found, strict=True)
    ]


def _scene() -> Scene:
    """Compression at equal rates, then control of three pressures."""
    positions = DIAMETER * (np.argwhere(np.ones((COUNT,) * 3)) + 0.5)
    control = {axis: {"pressure": target} for axis, target in zip(AXES, TARGETS, strict=True)}
    group = {
        "material": "solid",
        "diameter": DIAMETER,
        "insert": {"kind": "positions", "positions": positions.tolist()},
    }
    return Scene.from_dict(
        {
            "title": "Cubic lattice in a deforming box",
            "gravity": [0, 0, 0],
            "materials": {"solid": SOLID},
            "pairs": {"solid-solid": {"restitution": 1.0, "friction": 0.0}},
            "particles": {"spheres": group},
            "contact": {"normal": "hertz", "tangential": "none", "rolling": "none"},
            "domain": {
                "min": [0, 0, 0],
                "max": [COUNT * DIAMETER] * 3,
                "periodic": list(AXES),
                "on_exit": "error",
                "deformation": {axis: {"strain_rate": RATE} for axis in AXES},
            },
            "stages": [
                {"name": "compress", "duration": COMPRESSION},
                {"name": "control", "duration": 0.05, "deformation": control | {"max_rate": 2.0}},
            ],
            "run": {"velocity_max": 1.0, "time_step": STEP, "precision": "f64"},
            "output": {"interval": 1.0, "energy_budget": True},
        }
    )
