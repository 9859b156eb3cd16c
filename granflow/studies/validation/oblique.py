"""Validation cases of oblique impacts: Chung & Ooi (2011), tests 4 to 8, and measurements of Kharaz (2001)."""

from collections.abc import Mapping

import numpy as np

from granflow import Scene, Simulation
from granflow.studies.paper.oblique import SPEED_6, TEST_6, ImpactSweep, oblique_run, plotted_quantities, published
from granflow.studies.paper.oblique_figure import TARGET, oblique_figure
from granflow.studies.validation.case import ValidationCase

MEASURED = (
    ("tangential_restitution", "tangential restitution", "1", 1.0, 0.05),
    ("rebound_angle", "rebound angle of the contact patch", "deg", 90.0, 0.05),
    ("spin", "spin", "rad/s", 600.0, 0.1),
)
"""Published quantity, its name and unit, scale of the plotted axis, and allowed rms deviation over that scale."""
SPIN_7, ROUNDING = 5.0, 1e-12
"""Angular velocity [rad/s] of the spheres of test 7, and allowed deviation of numbers that equal 0."""


def oblique_cases() -> list[ValidationCase]:
    """Sliding impacts and opposite rotations against closed forms, and aluminum oxide on glass against measurements."""
    run = oblique_run()
    return sliding_cases(run) + symmetric_cases() + measured_cases(run)


def sliding_cases(run: Mapping[str, ImpactSweep]) -> list[ValidationCase]:
    """Largest deviation from the closed forms of impacts that slide throughout; the reference is a ratio of 1."""
    return [
        ValidationCase(
            "Oblique impacts", f"{each.quantity}, at {each.where}: simulated over closed form", 1.0,
            "momentum balance of a contact that slides throughout (Chung & Ooi 2011), with the lever arm R - overlap/2",
            1.0 + each.largest, "1", TARGET, "time step of 0.5 % of the shortest phase of the contact",
            remark="Impacts that stick are not compared: the published curves use other conventions "
            "(tests 6 and 8: contact_models/mindlin.md)",
        )
        for each in oblique_figure(run).deviations
    ]  # fmt: skip


def symmetric_cases() -> list[ValidationCase]:
    """Test 7: two equal spheres with opposite rotations collide head-on; their surfaces do not slip."""
    radius = TEST_6.radius
    direction = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    spin = np.array([[0.0, 0.0, SPIN_7], [0.0, 0.0, -SPIN_7]])
    simulation = Simulation(two_spheres(radius * direction, -SPEED_6 * direction, spin))
    simulation.run()
    last = simulation.snapshot().particles
    simulation.free()
    found = (
        ("tangential velocity over that of the surface", last["velocity"][:, 1:] / (SPIN_7 * radius)),
        ("change of spin over spin", (last["angular_velocity"] - spin) / SPIN_7),
    )
    return [
        ValidationCase(
            "Oblique impacts", f"test 7, opposite rotations: {name}", 0.0, "symmetry (Chung & Ooi 2011)",
            float(np.abs(values).max()), "1", ROUNDING, "rounding", scale=1.0,
        )
        for name, values in found
    ]  # fmt: skip


def two_spheres(position: np.ndarray, velocity: np.ndarray, spin: np.ndarray) -> Scene:
    """Two spheres of test 6 with these positions, velocities and angular velocities (2, 3) [m, m/s, rad/s]."""
    group = {
        "material": "alloy", "diameter": 2.0 * TEST_6.radius, "velocity": velocity.tolist(),
        "angular_velocity": spin.tolist(), "insert": {"kind": "positions", "positions": position.tolist()},
    }  # fmt: skip
    return Scene.from_dict({
        "title": "Opposite rotations", "gravity": [0, 0, 0], "materials": {"alloy": dict(TEST_6.sphere)},
        "pairs": {"alloy-alloy": {"restitution": TEST_6.restitution, "friction": TEST_6.friction}},
        "contact": {"normal": "zhou", "tangential": "mindlin", "rolling": "none"}, "particles": {"spheres": group},
        "domain": {"min": [-1, -1, -1], "max": [1, 1, 1], "on_exit": "error"},
        "run": {"duration": 1.5e-3, "velocity_max": 2.0 * SPEED_6, "precision": "f64"},
        "output": {"interval": 1.0},
    })  # fmt: skip


def measured_cases(run: Mapping[str, ImpactSweep]) -> list[ValidationCase]:
    """Root mean square of the differences to measured rebounds, over the axis of the published plot."""
    sweep, found = run["glass_zhou"], []
    simulated, measured = plotted_quantities(sweep, "test4"), published("kharaz_2001")
    for key, name, unit, scale, allowed in MEASURED:
        span = f"{scale:g} {unit}".removesuffix(" 1")
        angle, values = measured[key].T
        rms = float(np.sqrt(np.mean((np.interp(angle, sweep.x, simulated[key]) - values) ** 2)))
        found.append(
            ValidationCase(
                "Oblique impacts", f"oxide on glass, {name}: rms difference over {len(values)} measured angles", 0.0,
                "Kharaz, Gorham & Salman 2001, doi 10.1016/S0032-5910(01)00283-2, read from the plots",
                rms, unit, allowed, f"chosen share of the plotted range, {span}; no error bars",
                scale,
            )
        )  # fmt: skip
    return found
