"""Figures of the two-particle study."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from granflow.studies.accuracy.orders import fitted_order
from granflow.studies.accuracy.points import QUANTITIES, QUANTITY_LABELS, StudyLine
from granflow.studies.figures import COLORS, MARKERS, stacked_panels

LINE_STYLES = {"f64": ("-", "o"), "mixed": ("--", "s"), "f32": (":", "^")}
"""Line style and marker of each precision; contact models have colors."""
LOWEST = 1e-9
"""Smaller errors are drawn at this value."""

HIGHEST = 3.0
"""Upper end of the error axis."""


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


def _plot(
    axes: Any, line: StudyLine, lines: Sequence[StudyLine], x: np.ndarray, error: np.ndarray, **more: Any
) -> None:
    """Plot an error against `x`, with color by contact model and line style by precision."""
    line_index = _names(lines).index(line.law)
    style, marker = LINE_STYLES.get(line.precision, ("-", MARKERS[-1]))
    axes.plot(
        x, error, linestyle=style, marker=marker, color=COLORS[line_index % len(COLORS)], linewidth=0.9,
        markersize=3.0, markerfacecolor="white", markeredgewidth=0.8, **more,
    )  # fmt: skip


def loglog(axes: Any, target: float | None = None, **settings: Any) -> None:
    """Set logarithmic axes and other `settings`; a dotted line shows the `target` error."""
    axes.set(xscale="log", yscale="log", **settings)
    if target is not None:
        axes.axhline(target, color="0.5", linewidth=0.7, linestyle=(0, (1, 2)))


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
    """Draw the restitution error in double precision against the steps per collision: a line per contact model."""
    exact = [line for line in lines if line.precision == "f64"] or list(lines)

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        for line in exact:
            error = np.maximum(line.error("restitution"), LOWEST)
            _plot(axes, line, exact, line.steps, error, label=_with_order(line))
        loglog(
            axes, target, xlabel="time steps per collision", ylabel="restitution error", ylim=(0.3 * LOWEST, HIGHEST)
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
                _plot(axes, line, exact, 1.0 / line.steps, np.maximum(line.error(quantity), LOWEST), label=label)
            loglog(axes, ylim=(0.3 * LOWEST, HIGHEST), title=f"({letter}) {QUANTITY_LABELS[quantity]}")
            axes.legend(loc="lower right")
            axes.set_ylabel("relative error")
        panels[-1].set_xlabel("time step / duration of the collision")

    return draw
