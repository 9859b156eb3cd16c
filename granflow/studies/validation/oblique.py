"""Validation cases of oblique impacts: Chung & Ooi (2011), tests 4, 5, 6 and 8, and measurements of Kharaz (2001)."""

from collections.abc import Mapping

import numpy as np

from granflow.studies.paper.oblique import ImpactSweep, oblique_run, plotted_quantities, published
from granflow.studies.paper.oblique_figure import TARGET, oblique_figure
from granflow.studies.validation.case import ValidationCase

MEASURED = (
    ("tangential_restitution", "tangential restitution", "1", 1.0, 0.05),
    ("rebound_angle", "rebound angle of the contact patch", "deg", 90.0, 0.05),
    ("spin", "spin", "rad/s", 600.0, 0.1),
)
"""Published quantity, its name and unit, scale of the plotted axis, and allowed rms deviation over that scale."""


def oblique_cases() -> list[ValidationCase]:
    """Sliding impacts against closed forms, and impacts of aluminum oxide on glass against measurements."""
    run = oblique_run()
    return sliding_cases(run) + measured_cases(run)


def sliding_cases(run: Mapping[str, ImpactSweep]) -> list[ValidationCase]:
    """Largest deviation from the closed forms of impacts that slide throughout; the reference is a ratio of 1."""
    return [
        ValidationCase(
            "Oblique impacts", f"{each.quantity}, at {each.where}: simulated over closed form", 1.0,
            "momentum balance of a contact that slides throughout (Chung & Ooi 2011), with the lever arm R - overlap",
            1.0 + each.largest, "1", TARGET, "time step of 0.5 % of the shortest phase of the contact",
            remark="Impacts that stick are not compared: the published curves use other conventions of the stiffness.",
        )
        for each in oblique_figure(run).deviations
    ]  # fmt: skip


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
