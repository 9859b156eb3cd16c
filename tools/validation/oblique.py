"""Validation cases of oblique impacts: Chung & Ooi (2011), tests 4 to 8, and measurements of Kharaz
(2001)."""

import math
from collections.abc import Mapping

import numpy as np

from granflow import Scene, Simulation
from granflow.studies.paper.oblique import (
    KHARAZ,
    SAFETY,
    SPEED_4,
    SPEED_6,
    TEST_6,
    ImpactSweep,
    oblique_figure,
    oblique_run,
    plotted_quantities,
    published,
)
from validation.case import ValidationCase

MEASURED = {
    "tangential_restitution": ("tangential velocity after the impact", "m/s", SPEED_4),
    "rebound_angle": ("rebound angle of the contact patch", "deg", 90.0),
    "spin": ("spin", "rad/s", SPEED_4 / KHARAZ.radius),
}
"""Name and unit of each measured quantity, and the value to which differences are relative. The tangential
restitution is compared as a velocity, because the error of a measured velocity does not depend on the
angle."""
CONFIDENCE = 0.9973
"""Probability that corresponds to three standard deviations."""
SPIN_7, ROUNDING = 5.0, 1e-12
"""Angular velocity [rad/s] of the spheres of test 7, and allowed deviation of numbers that equal 0."""


def oblique_cases() -> list[ValidationCase]:
    """Sliding impacts and opposite rotations against closed forms, and aluminum oxide on glass against
    measurements."""
    run = oblique_run()
    return sliding_cases(run) + symmetric_cases() + measured_cases(run)


def sliding_cases(run: Mapping[str, ImpactSweep]) -> list[ValidationCase]:
    """Largest deviation from the closed forms of impacts that slide throughout; the reference is a ratio of
    1."""
    return [
        ValidationCase(
            "Oblique impacts",
            f"{each.quantity}, at {each.where}: simulated over closed form",
            1.0,
            "momentum balance of a contact that slides throughout (Chung & Ooi 2011), with the lever arm R - "
            "overlap/2",
            1.0 + each.largest,
            "1",
            (0.5 * math.pi * SAFETY) ** 2,
            f"(w dt)^2 of a time step of {100 * SAFETY:g} % of a quarter period",
            remark="Published curves of impacts that stick use other conventions (tests 6 and 8: "
            "contact_models/mindlin.md); the section on these impacts integrates the equations instead",
        )
        for each in oblique_figure(run).deviations
    ]


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
            "Oblique impacts",
            f"test 7, opposite rotations: {name}",
            0.0,
            "symmetry (Chung & Ooi 2011)",
            float(np.abs(values).max()),
            "1",
            ROUNDING,
            "rounding",
            scale=1.0,
        )
        for name, values in found
    ]


def two_spheres(position: np.ndarray, velocity: np.ndarray, spin: np.ndarray) -> Scene:
    """Two spheres of test 6 with these positions, velocities and angular velocities (2, 3) [m, m/s,
    rad/s]."""
    group = {
        "material": "alloy",
        "diameter": 2.0 * TEST_6.radius,
        "velocity": velocity.tolist(),
        "angular_velocity": spin.tolist(),
        "insert": {"kind": "positions", "positions": position.tolist()},
    }
    return Scene.from_dict(
        {
            "title": "Opposite rotations",
            "gravity": [0, 0, 0],
            "materials": {"alloy": dict(TEST_6.sphere)},
            "pairs": {"alloy-alloy": {"restitution": TEST_6.restitution, "friction": TEST_6.friction}},
            "contact": {"normal": "zhou", "tangential": "mindlin", "rolling": "none"},
            "particles": {"spheres": group},
            "domain": {"min": [-1, -1, -1], "max": [1, 1, 1], "on_exit": "error"},
            "run": {"duration": 1.5e-3, "velocity_max": 2.0 * SPEED_6, "precision": "f64"},
            "output": {"interval": 1.0},
        }
    )


def measured_cases(run: Mapping[str, ImpactSweep]) -> list[ValidationCase]:
    """Differences to measured rebounds that stick, against the scatter of the measured rebounds that slide.

    A contact that slides throughout obeys the momentum balance, whatever the tangential model: the
    differences of the measured points to it are the scatter of the measurement. The ratio of both mean
    squares is limited by the quantile of the F distribution.
    """
    from scipy.stats import f as ratio_of_variances

    sweep = run["glass_zhou"]
    found = []
    simulated = plotted_quantities(sweep, "test4")
    measured = published("kharaz_2001")
    for key, (name, unit, scale) in MEASURED.items():
        angle, values = measured[key].T
        slides = np.tan(np.radians(angle)) > 3.5 * KHARAZ.friction * (1.0 + KHARAZ.restitution)
        factor = SPEED_4 * np.sin(np.radians(angle)) if key == "tangential_restitution" else 1.0
        curve = np.interp(angle, sweep.x, simulated[key])
        scatter = _rms((factor * (values - balance_of_sliding(key, angle)))[slides])
        sticks = ~slides
        quantile = ratio_of_variances.ppf(CONFIDENCE, np.sum(sticks), np.sum(slides))
        found.append(
            ValidationCase(
                "Oblique impacts",
                f"oxide on glass, {name}: rms difference over {np.sum(sticks)} measured angles with sticking",
                0.0,
                "Kharaz, Gorham & Salman 2001, doi 10.1016/S0032-5910(01)00283-2, read from the plots",
                _rms((factor * (values - curve))[sticks]),
                unit,
                scatter * float(np.sqrt(quantile)) / scale,
                "scatter of the measured impacts that slide about the momentum balance, times the square "
                f"root of the quantile {CONFIDENCE:g} of F",
                scale,
            )
        )
    return found


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def balance_of_sliding(key: str, angle: np.ndarray) -> np.ndarray:
    """Rebound of a sphere without spin that slides throughout, by the name of the measured quantity.

    angle:  of the impact, from the normal [deg]

    v_t' = v_t - mu (1 + e) v,   R w' = 5/2 mu (1 + e) v
    """
    normal = SPEED_4 * np.cos(np.radians(angle))
    along = SPEED_4 * np.sin(np.radians(angle))
    change = KHARAZ.friction * (1.0 + KHARAZ.restitution) * normal
    if key == "tangential_restitution":
        return np.asarray(1.0 - change / along)
    if key == "spin":
        return np.asarray(-2.5 * change / KHARAZ.radius)
    return np.degrees(np.arctan2(along - 3.5 * change, KHARAZ.restitution * normal))
