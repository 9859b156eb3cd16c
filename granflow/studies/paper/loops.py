"""Force-overlap curves of single collisions, for restitutions from 0 to 1 (Zhou 2011, Eq. 4).

The area enclosed by a loop is the dissipated energy.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from granflow.contact import theory
from granflow.studies.figures import COLORS, MARKERS, POINTS
from granflow.studies.head_on import Outcomes
from granflow.studies.paper.cases import STEPS_PER_CONTACT
from granflow.studies.paper.figure_data import FigureData, FigureDeviation
from granflow.studies.paper.residual import CASE, VELOCITY, residual_run

RESTITUTIONS = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
"""Target restitutions, from plastic to elastic."""

DRAWN_EVERY = 6
"""Interval of the drawn simulated steps."""


def loop_run() -> Outcomes:
    """Simulate one pair per restitution, with a diameter such that each collision takes 200 steps."""
    return residual_run(RESTITUTIONS)


def _diameter(outcomes: Outcomes, index: int) -> float:
    """Diameter [m] of the spheres of collision `index`."""
    duration = STEPS_PER_CONTACT * outcomes.time_step
    return CASE.diameter_lasting(duration, float(RESTITUTIONS[index]), VELOCITY)


def loop_force(share: np.ndarray, e: float) -> np.ndarray:
    """Unloading force over the maximum force, at an overlap over the maximum overlap (Zhou 2011, Eq. 4).

        F / Fmax = Lambda(e) (u - x) + e^3 (u - x)^1.5,      u > x

    `share`: u, an array of any shape; x: residual over maximum overlap.
    """
    above = np.maximum(share - 1.0 + float(theory.recovery(e)), 0.0)
    return float(theory.unloading_slope(e)) * above + e**3 * above**1.5


def loop_rows(outcomes: Outcomes, index: int) -> np.ndarray:
    """Columns (m, 4) of all steps with a force: given restitution, overlap, simulated force, theoretical force.

    Overlap and forces are divided by their theoretical maxima. At e = 0 unloading is a vertical line, on which any last
    force between 0 and the maximum lies, and the theoretical force is then the simulated one.
    """
    e = float(RESTITUTIONS[index])
    diameter = _diameter(outcomes, index)
    k = CASE.stiffness(diameter)
    largest = float(theory.overlap_max(k, CASE.mass_eff(diameter), VELOCITY))
    force = outcomes.force[:, index]
    acting = np.flatnonzero(force)
    share = outcomes.overlap[acting, index] / largest
    loading = acting <= np.argmax(outcomes.overlap[:, index])
    simulated, expected = force[acting] / (k * largest**1.5), np.abs(share) ** 1.5
    if e == 0.0:
        expected[-1] = np.clip(simulated[-1], 0.0, 1.0)
    else:
        expected = np.where(loading, expected, loop_force(share, e))
    return np.stack([np.full_like(share, e), share, simulated, expected], axis=1)


def enclosed_share(rows: np.ndarray) -> float:
    """Area of a loop over the area under its loading branch: the fraction of energy lost, 1 - e^2.

    `rows` (m, 4): from `loop_rows`, in the order of the steps.
    """
    share, force = np.pad(rows[:, 1], 1), np.pad(rows[:, 2], 1)
    share[-1] = rows[-1, 1]  # vertical line from the last force; the overlap changes by at most one step there
    work = 0.5 * (force[1:] + force[:-1]) * np.diff(share)
    return float(work.sum() / work[work > 0.0].sum())


def loop_figure(outcomes: Outcomes) -> FigureData:
    """Figure of the loops; the rows are all steps with a force.

    Deviations: force relative to the maximum force (Zhou 2011, Eq. 4), and fraction of energy lost.
    """
    loops = [loop_rows(outcomes, index) for index in range(len(RESTITUTIONS))]
    force_error = [float(np.abs(rows[:, 2] - rows[:, 3]).max()) for rows in loops]
    energy_error = [
        abs(enclosed_share(rows) - (1.0 - float(e) ** 2)) for rows, e in zip(loops, RESTITUTIONS, strict=True)
    ]
    deviations = (
        FigureDeviation(
            "the force from Eq. 4, relative to the maximum force", max(force_error), f"e = {_worst(force_error)}"
        ),
        FigureDeviation("the fraction of energy lost from 1 − e²", max(energy_error), f"e = {_worst(energy_error)}"),
    )
    caption = (
        "Force against overlap in one collision, both divided by their maxima, for restitution coefficients from 0 "
        f"to 1: Eq. 4 (lines) and every {DRAWN_EVERY}th of {STEPS_PER_CONTACT} simulated steps (points)."
    )
    names = ("restitution", "overlap_over_max", "force_over_max", "force_over_max_theory")
    columns = dict(zip(names, np.concatenate(loops).T, strict=True))
    return FigureData("loops", "Force-overlap loops", caption, columns, deviations, draw_loops, 3.6)


def _worst(values: list[float]) -> str:
    return f"{RESTITUTIONS[int(np.argmax(values))]:g}"


def draw_loops(figure: Any, columns: Mapping[str, np.ndarray]) -> None:
    """Draw the common loading branch and the unloading branches from vertical to elastic."""
    axes = figure.subplots()
    fine = np.linspace(0.0, 1.0, 1001)
    axes.plot(fine, fine**1.5, color="0.3")
    for e, color, marker in zip(RESTITUTIONS, COLORS, MARKERS, strict=False):
        mine = columns["restitution"] == e
        if e > 0.0:
            back = np.linspace(1.0 - float(theory.recovery(float(e))), 1.0, 400)
            axes.plot(back, loop_force(back, float(e)), color=color)
        else:
            axes.plot([1.0, 1.0], [0.0, 1.0], color=color)
        share, force = (columns[name][mine][::DRAWN_EVERY] for name in ("overlap_over_max", "force_over_max"))
        axes.plot(share, force, marker, color=color, label=f"$e$ = {e:g}", **POINTS)
    axes.set(xlabel=r"overlap $\delta/\delta_{\max}$", ylabel=r"force $F/F_{\max}$", xlim=(0, 1.04), ylim=(0, 1.06))
    axes.legend(loc="upper left", title="unloading with")
