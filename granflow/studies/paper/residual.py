"""Figs. 1 and 2: residual overlap against restitution coefficient, exact, closed form and simulated.

x = 1 - y,      y = (4/5) e^2 + (1/5) e^3 y^2.5      (Zhou 2011, Eq. 8)
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from granflow.contact import theory
from granflow.studies.figures import COLORS, POINTS
from granflow.studies.head_on import Outcomes, collide_all
from granflow.studies.paper.cases import PAPER_CASES, STEPS_PER_CONTACT
from granflow.studies.paper.figure_data import FigureData, relative_deviation

CASE = PAPER_CASES[0]
"""Material of the collisions; x(e) and T/Ts depend on the restitution only, not on the material."""

VELOCITY = 1.0
"""Approach velocity [m/s]."""

RESTITUTIONS = np.linspace(0.025, 1.0, 40)
"""Target restitutions of the simulated collisions."""

RESOLVED = 0.1
"""Smallest restitution for which unloading takes enough of the 200 steps for the target accuracy."""

TARGET_RESTITUTION, TARGET_DURATION = 1e-3, 5e-3
"""Targets of the relative deviations of restitution and duration."""


def residual_run(restitutions: np.ndarray = RESTITUTIONS) -> Outcomes:
    """Simulate one pair per restitution (n,), with a diameter such that each collision takes exactly 200 steps.

    The duration is that of Zhou (2011), Eq. 13.
    """
    duration = CASE.duration(1.0, VELOCITY)
    pairs = [
        CASE.head_on(float(e), VELOCITY, CASE.diameter_lasting(duration, float(e), VELOCITY)) for e in restitutions
    ]
    return collide_all("zhou", pairs, duration / STEPS_PER_CONTACT)


def residual_figure(outcomes: Outcomes, e: np.ndarray = RESTITUTIONS) -> FigureData:
    """Fig. 1: x(e) from Eq. 8 (exact root), Eq. 9 and simulation, with the deviations of T and e.

    `e` (n,): restitutions of the outcomes.
    """
    exact = 1.0 - theory.recovery(e)
    simulated = outcomes.overlap_residual / outcomes.overlap_max
    whole = np.full_like(e, STEPS_PER_CONTACT * outcomes.time_step)
    plain, clear = slice(None), e >= RESOLVED - 1e-9

    def at(chosen: Any) -> Any:
        return lambda index: f"e = {e[chosen][index]:.3g}"

    deviations = (
        relative_deviation("x from Eq. 8, relative to δmax", 1.0 + simulated - exact, np.ones_like(e), at(plain)),
        relative_deviation("T from Eq. 13", outcomes.duration, whole, at(plain), TARGET_DURATION),
        relative_deviation(
            f"simulated from given e, for e from {RESOLVED:g} on",
            outcomes.restitution[clear], e[clear], at(clear), TARGET_RESTITUTION,
        ),
        relative_deviation(
            "simulated from given e, for all e", outcomes.restitution, e, at(plain), TARGET_RESTITUTION, _few_steps()
        ),
    )  # fmt: skip
    columns = {
        "restitution": e,
        "residual_exact": exact,
        "residual_equation9": theory.residual_closed_form(e),
        "residual_simulated": simulated,
        "restitution_simulated": outcomes.restitution,
        "duration_over_ts_theory": np.array([theory.LOADING_DURATION + theory.unloading_duration(float(a)) for a in e]),
        "duration_simulated_over_theory": outcomes.duration / whole,
    }
    caption = (
        "Ratio of residual to maximum overlap, x = δ*/δmax, against the restitution coefficient: exact root of Eq. 8 "
        "(line), Eq. 9 of the paper (dashed), and simulated collisions of 200 time steps each (circles)."
    )
    return FigureData("figure1_residual", "Fig. 1: residual overlap", caption, columns, deviations, draw_residual, 3.4)


def _few_steps() -> str:
    steps = [unloading_steps(e) for e in (RESOLVED, 0.5 * RESOLVED)]
    return (
        f"Below e = {RESOLVED:g} unloading takes fewer than {steps[0]:.0f} of the {STEPS_PER_CONTACT} steps "
        f"({steps[1]:.0f} at e = {0.5 * RESOLVED:g}), too few for this accuracy."
    )


def unloading_steps(e: float) -> float:
    """Number of unloading steps among the STEPS_PER_CONTACT of a collision."""
    unloading = theory.unloading_duration(e)
    return STEPS_PER_CONTACT * unloading / (theory.LOADING_DURATION + unloading)


def draw_residual(figure: Any, columns: Mapping[str, np.ndarray]) -> None:
    """Draw theory as lines and simulation as points."""
    e = np.linspace(0.0, 1.0, 401)
    axes = figure.subplots()
    axes.plot(e, 1.0 - theory.recovery(e), color=COLORS[0], label="exact (Eq. 8)")
    axes.plot(e, theory.residual_closed_form(e), "--", color=COLORS[1], label="closed form (Eq. 9)")
    axes.plot(columns["restitution"], columns["residual_simulated"], "o", color=COLORS[6], label="simulated", **POINTS)
    axes.set(xlabel="restitution coefficient $e$", ylabel=r"residual overlap $x = \delta^{*}\!/\delta_{\max}$")
    axes.set(xlim=(0, 1.01), ylim=(-0.01, 1.02))
    axes.legend(loc="lower left")


def error_figure(e: np.ndarray | None = None) -> FigureData:
    """Fig. 2: relative error of Eq. 9 with respect to the exact root of Eq. 8, without simulation."""
    e = np.linspace(0.0, 0.9999, 1000) if e is None else e
    exact = 1.0 - theory.recovery(e)
    closed_form = theory.residual_closed_form(e)
    worst = relative_deviation(
        "x by Eq. 9 from the exact root", closed_form, exact, lambda index: f"e = {e[index]:.4g}"
    )
    columns = {"restitution": e, "error": closed_form / exact - 1.0}
    caption = "Relative error of the closed form of the paper, Eq. 9, with respect to the exact root of Eq. 8."
    return FigureData("figure2_error", "Fig. 2: error of the closed form", caption, columns, (worst,), draw_error, 2.8)


def draw_error(figure: Any, columns: Mapping[str, np.ndarray]) -> None:
    """Draw the error and a zero line."""
    axes = figure.subplots()
    axes.axhline(0.0, color="0.6", linewidth=0.6)
    axes.plot(columns["restitution"], 100.0 * columns["error"], color=COLORS[1])
    axes.set(xlabel="restitution coefficient $e$", ylabel="error of $x$ by Eq. 9 (%)", xlim=(0, 1))
