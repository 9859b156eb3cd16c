"""`granflow accuracy SCENE`: sentences, table, CSV, figure and page of the study of one scene."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from granflow.errors import GranflowError
from granflow.studies.accuracy.figures import LINE_STYLES, loglog
from granflow.studies.accuracy.scene_points import ENERGY_ERROR, SIGMAS, ScenePoint, SceneStudy
from granflow.studies.figures import COLORS, Drawing, stacked_panels
from granflow.studies.page import write_study
from granflow.studies.tables import PageTable, percent

MOST_CHOICES = 3
"""Choices with equal costs that the conclusion names; the table has all."""

LOWEST = 1e-7
"""Smaller errors are drawn at this value."""


def scene_recommendation(study: SceneStudy) -> str:
    """Concluding sentence of the study."""
    requested = f"{100.0 * study.target:g} % error in restitution"
    if not study.cheapest:
        return f"No time step of this study satisfies {requested} with all other errors within that limit or the noise."
    best, *others = study.cheapest
    own = (
        f"The unmodified scene uses dt = {study.own_time_step:.3g} s (time_step_fraction {study.own_share:.3g}). "
        "Costs are processor time."
    )
    if others:
        found = "; ".join(f"{_step(point)}, {_cost(point)}" for point in study.cheapest[:MOST_CHOICES])
        if len(study.cheapest) > MOST_CHOICES:
            found += f"; and {len(study.cheapest) - MOST_CHOICES} more of the table"
        return (
            f"For {requested}, the cheapest choices are not distinguished by their costs per simulated second, which "
            f"overlap: {found}. Take any of them, or repeat on an idle machine with more seeds (--full). {own}"
        )
    return (
        f"For {requested} use {_step(best)}: it costs {_cost(best)} per simulated second of this "
        f"scene with {study.particle_count} particles. {own}"
    )


def _step(point: ScenePoint) -> str:
    """Time step and precision of a point, as keys of a scene."""
    step = f"dt = {point.time_step:.3g} s (time_step_fraction {point.share:g})"
    if point.family != "fixed":
        step = f"run.time_step {point.family} with time_step_fraction {point.share:g}"
    return f"{step}, precision {point.precision}"


def _cost(point: ScenePoint) -> str:
    """Median and range of the cost of a point over the seeds."""
    median, least, most = point.cost
    return f"{median:.3g} s ({least:.3g} to {most:.3g})"


def noise_sentence(study: SceneStudy) -> str:
    """Spread over the seeds, and the number of errors above the noise."""
    significant = [point.errors[name] > study.noise[name] for point in study.points if not point.stopped for name in
            study.quantities]  # fmt: skip
    spreads = ", ".join(f"{_label(name)} {percent(spread)}" for name, spread in study.spread.items())
    return (
        f"Granular flow is chaotic. Standard deviation over {study.seed_count} seeds with the finest time step: "
        f"{spreads}. Errors of these quantities above the "
        f"noise of {SIGMAS:g} standard errors: {sum(significant)} of {len(significant)}; the others, marked n, "
        f"are not significant."
    )


def _label(name: str) -> str:
    """Display name of a quantity, with its flow meter."""
    kind, _, meter = name.partition(".")
    return kind.replace("_", " ") + (f", {meter}" if meter else "")


def scene_heads(study: SceneStudy) -> tuple[str, ...]:
    """Column headings of `scene_rows`."""
    return (
        "time step", "precision", "fraction", "dt s", "restitution", "energy budget",
        *(_label(name) for name in study.quantities), "s per simulated s", "within target",
    )  # fmt: skip


def scene_rows(study: SceneStudy) -> list[tuple[str, ...]]:
    """Table rows, one per point: relative errors; n marks errors below the noise."""
    return [_row(study, point) for point in study.points]


def _row(study: SceneStudy, point: ScenePoint) -> tuple[str, ...]:
    """Table cells of one point."""
    first = (point.family, point.precision, f"{point.share:g}", f"{point.time_step:.3g}")
    if point.stopped:
        return (*first, *["–"] * (2 + len(study.quantities)), "–", "aborted")
    errors = []
    for name in study.quantities:
        below = point.errors[name] <= study.noise[name]
        errors.append(percent(point.errors[name]) + (" n" if below else ""))
    median, least, most = point.cost
    return (
        *first, percent(point.restitution_error), percent(point.errors[ENERGY_ERROR]), *errors,
        f"{median:.3g} ({least:.3g}–{most:.3g})", "yes" if study.within_target(point) else "no",
    )  # fmt: skip


def scene_columns(study: SceneStudy) -> dict[str, np.ndarray]:
    """Columns of the CSV, one row per point; nan for aborted runs.

    Values in SI units, errors, noise and spread relative, costs in processor time per simulated time [s/s].
    """
    rows = []
    for point in study.points:
        row: dict[str, Any] = {name: getattr(point, name) for name in
                               ("family", "precision", "share", "time_step", "restitution_error")}  # fmt: skip
        row["energy_error"] = point.errors.get(ENERGY_ERROR, np.nan)
        for name in study.quantities:
            row |= {name: point.values.get(name, np.nan), f"{name}_error": point.errors.get(name, np.nan)}
            row |= {f"{name}_noise": study.noise[name], f"{name}_spread": study.spread[name]}
        row |= dict(zip(("seconds_median", "seconds_min", "seconds_max"), point.cost, strict=True))
        rows.append(row | {"seeds": study.seed_count, "stopped": point.stopped})
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def write_scene(out: Path, study: SceneStudy) -> None:
    """Write CSV and page, with a figure if matplotlib is installed.

    Raises GranflowError at the end if matplotlib is not installed.
    """
    missing = write_study(
        out / "accuracy.html",
        "accuracy_scene.html",
        tables={"accuracy.csv": scene_columns(study)},
        figures={"accuracy.png": Drawing(draw_scene(study), 6.4)},
        study=study,
        recommendation=scene_recommendation(study),
        noise=noise_sentence(study),
        errors=PageTable(scene_heads(study), scene_rows(study)),
    )
    if missing:
        raise GranflowError(missing)


def draw_scene(study: SceneStudy) -> Callable[[Any], None]:
    """Draw every error against processor time, for all precisions."""

    def draw(figure: Any) -> None:
        from matplotlib.ticker import LogLocator

        above, below = stacked_panels(figure, 2, sharex=True, sharey=True)
        for name, color in zip(("restitution", ENERGY_ERROR, *study.quantities), COLORS, strict=False):
            for precision in LINE_STYLES:
                _draw_errors(below if name in study.quantities else above, study, name, precision, color)
        loglog(above, study.target, title="(a) restitution and energy budget")
        loglog(below, study.target, title="(b) bed quantities and their noise")
        below.set_xlabel("processor time (s per simulated s); filled: adaptive time step")
        for axes in (above, below):
            axes.set_ylabel("relative error")
            axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0)))
            axes.xaxis.set_major_formatter("{x:g}")
            axes.xaxis.set_minor_formatter("")
            axes.legend(loc="best")

    return draw


def _draw_errors(axes: Any, study: SceneStudy, name: str, precision: str, color: str) -> None:
    """Plot one error of one precision against processor time; thin line: noise in double precision.

    Points with fixed and with adaptive time step form two lines.
    """
    style, marker = LINE_STYLES[precision]
    label = f"{'energy budget' if name == ENERGY_ERROR else _label(name)}, {precision}"
    line = {"linestyle": style, "marker": marker, "color": color, "markersize": 3.5, "linewidth": 0.9}
    for family in dict.fromkeys(point.family for point in study.points):
        points = [p for p in study.points if (p.precision, p.family) == (precision, family) and not p.stopped]
        errors = [p.restitution_error if name == "restitution" else p.errors[name] for p in points]
        shown = [(p.cost[0], max(error, LOWEST)) for p, error in zip(points, errors, strict=True) if error > 0.0]
        if shown:
            is_fixed = family == "fixed"
            face = {"markerfacecolor": "white"} if is_fixed else {}
            axes.plot(*zip(*sorted(shown), strict=True), label=label if is_fixed else None, **line, **face)
    if precision == "f64" and name in study.quantities:
        axes.axhline(study.noise[name], color=color, linewidth=0.6, alpha=0.6)
