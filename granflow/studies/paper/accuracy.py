"""Deviation of simulated restitution and duration from the given values, by the number of steps per collision."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from granflow.studies.figures import COLORS, MARKERS, POINTS, stacked_panels
from granflow.studies.head_on import Outcomes, collide_all
from granflow.studies.paper.cases import STEPS_PER_CONTACT
from granflow.studies.paper.figure_data import FigureData, relative_deviation
from granflow.studies.paper.residual import CASE, RESOLVED, TARGET_DURATION, TARGET_RESTITUTION, VELOCITY

RESTITUTIONS = np.array([0.05, 0.075, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0])
"""Target restitutions."""

STEPS = np.array([50, 100, 200, 400])
"""Steps per collision."""

PHASES = 8
"""Number of phases of first contact within a step; the largest deviation is shown."""


def accuracy_run() -> tuple[Outcomes, np.ndarray, np.ndarray]:
    """Simulate all restitutions, steps and phases in one scene.

    Returns outcomes, restitution (n,) and steps per contact (n,) of the collisions. The diameters make the duration of
    each collision equal to its number of steps times the common time step.
    """
    steps, e = (np.repeat(each.ravel(), PHASES) for each in np.meshgrid(STEPS, RESTITUTIONS))
    time_step = CASE.duration(1.0, VELOCITY) / STEPS.max()
    pairs = [
        CASE.head_on(float(a), VELOCITY, CASE.diameter_lasting(count * time_step, float(a), VELOCITY))
        for a, count in zip(e, steps, strict=True)
    ]
    return collide_all("zhou", pairs, time_step), e, steps


def accuracy_figure(outcomes: Outcomes, e: np.ndarray, steps: np.ndarray) -> FigureData:
    """Largest deviation over the phases, for each restitution and number of steps.

    `e`, `steps` (n,): from `accuracy_run`. The deviations of the text are those for STEPS_PER_CONTACT steps.
    """
    restitution_error = np.abs(outcomes.restitution / e - 1.0)
    duration_error = np.abs(outcomes.duration / (steps * outcomes.time_step) - 1.0)
    shape = (-1, PHASES)
    columns = {
        "restitution": e.reshape(shape)[:, 0],
        "steps_per_contact": steps.reshape(shape)[:, 0],
        "restitution_deviation": restitution_error.reshape(shape).max(axis=1),
        "duration_deviation": duration_error.reshape(shape).max(axis=1),
    }
    chosen = (columns["steps_per_contact"] == STEPS_PER_CONTACT) & (columns["restitution"] >= RESOLVED)
    e_there = columns["restitution"][chosen]

    def worst(name: str, text: str, target: float) -> Any:
        values = 1.0 + columns[name][chosen]
        return relative_deviation(
            f"{text} at {STEPS_PER_CONTACT} steps, from e = {RESOLVED:g} on",
            values, np.ones_like(values), lambda index: f"e = {e_there[index]:g}", target,
        )  # fmt: skip

    deviations = (
        worst("restitution_deviation", "e", TARGET_RESTITUTION),
        worst("duration_deviation", "T", TARGET_DURATION),
    )
    caption = (
        "Largest deviation of (a) restitution and (b) duration of simulated collisions from the given values, over "
        f"{PHASES} phases of first contact within a step, by the number of steps per collision. Dotted: target with "
        f"{STEPS_PER_CONTACT} steps. With 50 steps e = 0.05 is not reachable because of the bound on the unloading "
        "tangent."
    )
    return FigureData("accuracy", "Accuracy by number of steps", caption, columns, deviations, draw_accuracy, 5.2)


def draw_accuracy(figure: Any, columns: Mapping[str, np.ndarray]) -> None:
    """Panels for e and T, with a line for each number of steps."""
    panels = stacked_panels(figure, 2, sharex=True)
    shown = (("restitution_deviation", TARGET_RESTITUTION, "$e$"), ("duration_deviation", TARGET_DURATION, "$T$"))
    for letter, axes, (name, target, symbol) in zip("ab", panels, shown, strict=True):
        for steps, color, marker in zip(STEPS, COLORS, MARKERS, strict=False):
            mine = columns["steps_per_contact"] == steps
            axes.plot(
                columns["restitution"][mine], 100.0 * columns[name][mine], marker=marker, color=color,
                label=f"{steps} steps", **(POINTS | {"linestyle": "-", "linewidth": 0.8}),
            )  # fmt: skip
        axes.axhline(100.0 * target, linestyle=":", color="0.4", linewidth=0.9)
        axes.set(yscale="log", xlim=(0, 1.02), title=f"({letter}) {'restitution' if symbol == '$e$' else 'duration'}")
        axes.set_ylabel(f"largest deviation of {symbol} (%)")
    panels[-1].set_xlabel("restitution coefficient $e$")
    panels[0].legend(loc="upper right")
