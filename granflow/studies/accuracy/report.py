"""`granflow accuracy` without a scene: measures all lines of the two-particle study, and writes its files.

`measure_two_bodies` measures the lines, `write_two_bodies` writes `accuracy.csv`, the figures and the page.
Between them, each line gets its fitted order of convergence and its requirement: the steps per collision, and
their cost, that a target error takes. The recommendation names the cheapest requirement.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from granflow.errors import GranflowError
from granflow.scene.blocks.run import Numerics
from granflow.studies.accuracy import two_particles
from granflow.studies.accuracy.two_particles import (
    QUANTITIES,
    QUANTITY_LABELS,
    REPEATS,
    STUDIED_LAWS,
    StudyLine,
    StudyPoint,
    columns,
    measured_line,
)
from granflow.studies.figures import COLORS, MARKERS, Drawing, PageTable, stacked_panels
from granflow.studies.page import write_study


@dataclass(frozen=True)
class TwoBodyStudy:
    """All measured lines, and descriptions of the rejected time steps."""

    lines: tuple[StudyLine, ...]
    refused: tuple[str, ...]
    target: float

    @property
    def recommendation(self) -> str:
        """Concluding sentence of the study."""
        return recommendation(self.lines, self.target)


def measure_two_bodies(
    target: float, full: bool = False, report: Callable[[str], None] = lambda text: None
) -> TwoBodyStudy:
    """Measure every combination.

    `target`: relative error of the restitution. `full`: more time steps and repeats. `report` receives
    progress messages.
    """
    counts = two_particles.FULL_STEPS if full else two_particles.STEPS
    repeats = 3 * REPEATS if full else REPEATS
    lines = []
    refused = []
    for precision in two_particles.PRECISIONS:
        for studied_law in STUDIED_LAWS:
            report(f"{studied_law.name}, {precision}")
            line, problems = measured_line(studied_law, precision, counts, repeats, threads=1)
            lines.append(line)
            refused += problems
    return TwoBodyStudy(tuple(lines), tuple(dict.fromkeys(refused)), target)


def write_two_bodies(out: Path, study: TwoBodyStudy) -> None:
    """Write accuracy.csv with one row per point, and the page, with figures if matplotlib is installed.

    Raises GranflowError at the end if it is not, after all other files are written.
    """
    lines = study.lines
    target = study.target
    missing = write_study(
        out / "accuracy.html",
        "accuracy.html",
        tables={"accuracy.csv": columns([point for line in lines for point in line.points])},
        figures={
            "accuracy.png": Drawing(draw_work(lines, target), 6.4),
            "accuracy_convergence.png": Drawing(draw_convergence(lines, target), 3.0),
            "accuracy_quantities.png": Drawing(draw_quantities(lines), 8.4),
        },
        study=study,
        axes=two_particles,
        target=f"{100.0 * target:g}",
        default=default_sentence(lines, target),
        requirements=PageTable(table_heads(target), table_rows(lines, target)),
        by_velocity=PageTable(*velocity_rows(lines, target)),
        orders=_orders(lines),
    )
    if missing:
        raise GranflowError(missing)


# ---------------------------------------------------------------- orders of convergence
#
# They are fitted where the errors decrease with the time step and exceed the round-off floor:
#
#     error = C steps^-p
#
# p: order of convergence; the leapfrog scheme has p = 2 for smooth forces.

ASYMPTOTIC = 0.05
"""The fit begins at the first error below this value."""
DECREASE = 0.9
"""Required ratio of successive errors.

The fit ends where neither the next error over the last is below it, nor the second next below its square.
"""
MIN_POINTS = 4
"""Minimum number of points of a fit."""


@dataclass(frozen=True)
class Order:
    """error = prefactor * steps^-order from `first` to `last` steps per collision: a fitted order of
    convergence."""

    order: float
    first: float
    last: float
    prefactor: float

    def at(self, steps: np.ndarray) -> np.ndarray:
        """Fitted error (n,) at numbers of steps per collision (n,)."""
        return self.prefactor * steps**-self.order

    @property
    def text(self) -> str:
        """Text for tables."""
        return f"{self.order:.2f} ({self.first:g} to {self.last:g})"


def fitted_order(steps: np.ndarray, error: np.ndarray) -> Order | None:
    """Least-squares line through the logarithms of `error` (n,) over `steps` (n,), in ascending order of
    steps.

    The fit begins at the first error below ASYMPTOTIC and ends where the errors stop decreasing. None if
    fewer than MIN_POINTS points decrease. Errors of nan are not below any bound.
    """
    below = np.flatnonzero(error < ASYMPTOTIC)
    if not len(below):
        return None
    first = last = int(below[0])
    while (ahead := _next_decreasing(error, last)) is not None:
        last = ahead
    if last + 1 - first < MIN_POINTS:
        return None
    part = slice(first, last + 1)
    slope, intercept = np.polyfit(np.log(steps[part]), np.log(error[part]), 1)
    return Order(-float(slope), float(steps[first]), float(steps[last]), float(np.exp(intercept)))


def _next_decreasing(error: np.ndarray, last: int) -> int | None:
    """Index of the next clearly smaller error after `last`; None if the errors no longer decrease.

    One outlier is permitted: the largest error may change from one kind of collision to another.
    """
    for ahead in (1, 2):
        if last + ahead < len(error) and 0.0 < error[last + ahead] < DECREASE**ahead * error[last]:
            return last + ahead
    return None


# ---------------------------------------------------------------- requirements and recommendation

FOR_LAW = "zhou"
"""Contact model of the recommendation: the contact model is a choice of physics, the time step is not."""
MANY = 1e6
"""Number of collisions to which reported costs refer."""


@dataclass(frozen=True)
class Requirement:
    """Requirement of a line for a restitution error within the target.

    `steps` per collision; `share`: largest `numerics.time_step_fraction` that suffices for every kind of
    collision; `seconds`: processor time of one collision [s], median, minimum and maximum.
    """

    line: StudyLine
    steps: float
    share: float
    seconds: tuple[float, float, float]


def requirement_of(line: StudyLine, target: float) -> Requirement | None:
    """Longest time step of a line with a restitution error within the target for every kind of collision.

    `target`: relative error. None if no time step of the line suffices.
    """
    index = first_within(line.error("restitution"), target)
    if index is None:
        return None
    seconds = tuple(float(line.seconds(which)[index]) for which in ("median", "min", "max"))
    share = min(_share_within(points, target) for points in line.kinds())
    return Requirement(line, float(line.steps[index]), share, seconds)  # type: ignore[arg-type]


def first_within(error: np.ndarray, target: float) -> int | None:
    """First index with this error and the next within the target; a single one may be accidental.

    `error` (n,) in the order of decreasing time steps. None without such an index.
    """
    good = error <= target
    good = good & np.append(good[1:], True)
    return int(np.argmax(good)) if good.any() else None


def _share_within(points: Sequence[StudyPoint], target: float) -> float:
    """Largest sufficient time step over the shorter phase for one kind of collision; `points` in ascending
    steps."""
    index = first_within(np.array([point.restitution_error for point in points]), target)
    return points[index].share if index is not None else 0.0


def recommendation(lines: Sequence[StudyLine], target: float) -> str:
    """Concluding sentence of the study: the cheapest time step and precision with errors within the
    target."""
    found = cheapest(requirement_of(line, target) for line in lines)
    if not found:
        return f"No time step of this study limits the restitution error to {target:.3g} with {FOR_LAW}."
    texts = [f"{_choice(each)}: {_cost(each)}" for each in found]
    requested = f"For {100.0 * target:g} % error in restitution"
    if len(found) > 1:
        return (
            f"{requested}, the cheapest choices are not distinguished by their costs per million collisions, "
            f"which overlap: {'; '.join(texts)}. T is the collision time, costs are processor time."
        )
    return (
        f"{requested} use {_choice(found[0])}, where T is the collision time: it costs {_cost(found[0])} of "
        "processor time per million collisions."
    )


def cheapest(requirements: Iterable[Requirement | None]) -> list[Requirement]:
    """Requirement of least cost for FOR_LAW, and those whose ranges of costs overlap with its range."""
    able = [
        requirement
        for requirement in requirements
        if requirement is not None and requirement.line.law == FOR_LAW
    ]
    able.sort(key=lambda requirement: requirement.seconds[0])
    return [requirement for requirement in able if requirement.seconds[1] <= able[0].seconds[2]]


def _choice(requirement: Requirement) -> str:
    """Time step and precision of a requirement."""
    step = f"dt = T/{requirement.steps:g} (time_step_fraction {requirement.share:.2g})"
    return f"{step}, precision {requirement.line.precision}"


def _cost(requirement: Requirement) -> str:
    """Median and range of the cost of a million collisions."""
    median, least, most = (MANY * each for each in requirement.seconds)
    return f"{median:.3g} s ({least:.3g} to {most:.3g})"


def default_sentence(lines: Sequence[StudyLine], target: float) -> str:
    """Sentence on the restitution error with the default of `numerics.time_step_fraction`.

    For FOR_LAW in double precision; empty without such a line.
    """
    default = float(Numerics().time_step_fraction)
    line = next((line for line in lines if line.law == FOR_LAW and line.precision == "f64"), None)
    if line is None:
        return ""
    worst = max(_error_at(points, default) for points in line.kinds())
    relation = "finer than" if worst <= target else "coarser than"
    return (
        f"The default, time_step_fraction {default:g}, limits the restitution error of {FOR_LAW} in f64 to "
        f"{100.0 * worst:.2g} %: it is {relation} the target requires."
    )


def _error_at(points: Sequence[StudyPoint], share: float) -> float:
    """Restitution error at a share, by linear interpolation of the logarithms of the measured values.

    `share`: time step over the shortest phase; outside the measured range, the nearest value.
    """
    shares = np.array([point.share for point in points])[::-1]
    errors = np.array([point.restitution_error for point in points])[::-1]
    return float(np.exp(np.interp(np.log(share), np.log(shares), np.log(np.maximum(errors, 1e-300)))))


# ---------------------------------------------------------------- tables


def table_heads(target: float) -> tuple[str, ...]:
    """Column headings of `table_rows`."""
    requested = f"{100.0 * target:g} %"
    return (
        "contact model",
        "precision",
        "order of e (fitted steps)",
        "smallest error of e",
        f"steps for {requested}",
        f"time_step_fraction for {requested}",
        "s per million collisions",
    )


def table_rows(lines: Iterable[StudyLine], target: float) -> list[tuple[str, ...]]:
    """Table rows, one per line: order of convergence, smallest error, and the requirement for the target."""
    rows: list[tuple[str, ...]] = []
    for line in lines:
        error = line.error("restitution")
        requirement = requirement_of(line, target)
        order = fitted_order(line.steps, error)
        least = float(np.nanmin(error))
        needed: tuple[str, str, str] = ("–", "–", "–")
        if requirement is not None:
            median, low, high = (MANY * each for each in requirement.seconds)
            needed = (
                f"{requirement.steps:g}",
                f"{requirement.share:.2g}",
                f"{median:.3g} ({low:.3g}–{high:.3g})",
            )
        rows.append(
            (
                line.law,
                line.precision,
                order.text if order else "–",
                _short(least),
                *needed,
            )
        )
    return rows


def _short(value: float) -> str:
    """Two digits and a power of ten, with a minus sign that does not break the line."""
    return f"{value:.1e}".replace("-", "−")


def velocity_rows(lines: Iterable[StudyLine], target: float) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Headings and rows of the steps that each line requires per approach velocity, over all restitutions.

    `target`: relative error; a dash where no number of steps suffices.
    """
    lines = list(lines)
    velocities = sorted({point.velocity for line in lines for point in line.points})
    rows = []
    for line in lines:
        cells = []
        for velocity in velocities:
            part = replace(line, points=tuple(point for point in line.points if point.velocity == velocity))
            requirement = requirement_of(part, target)
            cells.append(f"{requirement.steps:g}" if requirement else "–")
        rows.append((line.law, line.precision, *cells))
    return ("contact model", "precision", *(f"{velocity:g} m/s" for velocity in velocities)), rows


def _orders(lines: Sequence[StudyLine]) -> PageTable:
    """Table of the fitted orders of all errors."""
    rows = []
    for line in lines:
        orders = [fitted_order(line.steps, line.error(quantity)) for quantity in QUANTITIES]
        rows.append((line.law, line.precision, *(order.text if order else "–" for order in orders)))
    heads = ("contact model", "precision", *(QUANTITY_LABELS[quantity] for quantity in QUANTITIES))
    return PageTable(heads, rows)


# ---------------------------------------------------------------- figures

LINE_STYLES = {"f64": ("-", "o"), "mixed": ("--", "s"), "f32": (":", "^")}
"""Line style and marker of each precision; contact models have colors."""
LOWEST = 1e-9
"""Smaller errors are drawn at this value."""
HIGHEST = 3.0
"""Upper end of the error axis."""


def draw_work(lines: Sequence[StudyLine], target: float) -> Callable[[Any], None]:
    """Draw the restitution error against processor time, and against the time step with fitted slopes.

    `target`: relative error, drawn as a dotted line. The result is the argument of `figures.draw_to`.
    """

    def draw(figure: Any) -> None:
        work, steps = stacked_panels(figure, 2, sharey=True)
        for line in sorted(lines, key=lambda line: _names(lines).index(line.law)):
            error = np.maximum(line.error("restitution"), LOWEST)
            _plot(work, line, lines, 1e6 * line.seconds(), error, label=_with_order(line))
            ends = (1e6 * line.seconds(which) for which in ("min", "max"))
            work.hlines(error, *ends, color="0.8", linewidth=0.5, zorder=0)
            _plot(steps, line, lines, 1.0 / line.steps, error)
        for axes in (work, steps):
            loglog(axes, target, ylim=(0.3 * LOWEST, HIGHEST))
            axes.set_ylabel("restitution error")
        work.set(xlabel="processor time per collision (µs)", title="(a) work and precision")
        steps.set(xlabel="time step / duration of the collision", title="(b) convergence", xlim=(5e-5, 0.4))
        figure.legend(*work.get_legend_handles_labels(), loc="outside lower center", ncols=2)

    return draw


def draw_convergence(lines: Sequence[StudyLine], target: float) -> Callable[[Any], None]:
    """Draw the restitution error in double precision against the steps per collision: a line per contact
    model."""
    exact = [line for line in lines if line.precision == "f64"] or list(lines)

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        for line in exact:
            error = np.maximum(line.error("restitution"), LOWEST)
            _plot(axes, line, exact, line.steps, error, label=_with_order(line))
        loglog(
            axes,
            target,
            xlabel="time steps per collision",
            ylabel="restitution error",
            ylim=(0.3 * LOWEST, HIGHEST),
        )
        axes.legend(loc="lower left")

    return draw


def draw_quantities(lines: Sequence[StudyLine]) -> Callable[[Any], None]:
    """Draw every error against the time step in double precision, with its fitted order."""
    exact = [line for line in lines if line.precision == "f64"] or list(lines)

    def draw(figure: Any) -> None:
        panels = stacked_panels(figure, len(QUANTITIES), sharex=True, sharey=True)
        for letter, axes, quantity in zip("abcd", panels, QUANTITIES, strict=True):
            for line in exact:
                order = fitted_order(line.steps, line.error(quantity))
                label = f"{_label(line)}: {order.order:.2f}" if order else _label(line)
                _plot(
                    axes, line, exact, 1.0 / line.steps, np.maximum(line.error(quantity), LOWEST), label=label
                )
            loglog(axes, ylim=(0.3 * LOWEST, HIGHEST), title=f"({letter}) {QUANTITY_LABELS[quantity]}")
            axes.legend(loc="lower right")
            axes.set_ylabel("relative error")
        panels[-1].set_xlabel("time step / duration of the collision")

    return draw


def loglog(axes: Any, target: float | None = None, **settings: Any) -> None:
    """Set logarithmic axes and other `settings`; a dotted line shows the `target` error."""
    axes.set(xscale="log", yscale="log", **settings)
    if target is not None:
        axes.axhline(target, color="0.5", linewidth=0.7, linestyle=(0, (1, 2)))


def _plot(
    axes: Any, line: StudyLine, lines: Sequence[StudyLine], x: np.ndarray, error: np.ndarray, **more: Any
) -> None:
    """Plot an error against `x`, with color by contact model and line style by precision."""
    line_index = _names(lines).index(line.law)
    style, marker = LINE_STYLES.get(line.precision, ("-", MARKERS[-1]))
    axes.plot(
        x,
        error,
        linestyle=style,
        marker=marker,
        color=COLORS[line_index % len(COLORS)],
        linewidth=0.9,
        markersize=3.0,
        markerfacecolor="white",
        markeredgewidth=0.8,
        **more,
    )


def _names(lines: Sequence[StudyLine]) -> list[str]:
    """Contact models of the lines, in their order."""
    return list(dict.fromkeys(line.law for line in lines))


def _label(line: StudyLine) -> str:
    """Legend entry."""
    return f"{line.law}, {line.precision}"


def _with_order(line: StudyLine) -> str:
    """Legend entry with the fitted order of convergence of the restitution, in double precision."""
    order = fitted_order(line.steps, line.error("restitution")) if line.precision == "f64" else None
    return _label(line) + (f": order {order.order:.2f}" if order else "")
