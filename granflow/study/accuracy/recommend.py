"""What each line of the study needs for an error aimed at, and the one recommendation that follows."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from granflow.scene.schema import Numerics
from granflow.study.accuracy.orders import fitted_order
from granflow.study.accuracy.points import Line, Point

FOR_LAW = "zhou"
"""The law that the recommendation is made for: choosing a law is physics, choosing a step is not."""
MANY = 1e6
"""Collisions whose cost is told."""


@dataclass(frozen=True)
class Need:
    """What a line needs to keep the error of the restitution at the target: None where it cannot.

    `steps` a collision; `share`: largest `numerics.time_step_safety` that is enough for every kind of collision;
    `seconds` of a collision, median, smallest and largest.
    """

    line: Line
    steps: float
    share: float
    seconds: tuple[float, float, float]


def need_of(line: Line, target: float) -> Need | None:
    """The longest step of a line with the restitution within the target, for every kind of collision."""
    index = first_within(line.error("restitution"), target)
    if index is None:
        return None
    seconds = tuple(float(line.seconds(which)[index]) for which in ("median", "min", "max"))
    share = min(_share_within(points, target) for points in line.kinds())
    return Need(line, float(line.steps[index]), share, seconds)  # type: ignore[arg-type]


def first_within(error: np.ndarray, target: float) -> int | None:
    """First index from which this error and the next are within the target: one alone may be luck."""
    good = error <= target
    good = good & np.append(good[1:], True)
    return int(np.argmax(good)) if good.any() else None


def _share_within(points: Sequence[Point], target: float) -> float:
    """Time step over the shorter phase that one kind of collision bears; `points` by rising steps."""
    index = first_within(np.array([point.restitution_error for point in points]), target)
    return points[index].share if index is not None else 0.0


def cheapest(needs: Iterable[Need | None]) -> Need | None:
    """The need of least cost for FOR_LAW."""
    able = [need for need in needs if need is not None and need.line.law == FOR_LAW]
    return min(able, key=lambda need: need.seconds[0], default=None)


def recommendation(lines: Sequence[Line], target: float) -> str:
    """The one sentence that the study ends in."""
    best = cheapest(need_of(line, target) for line in lines)
    if best is None:
        return f"No time step of this study keeps the restitution within {target:.3g} with {FOR_LAW}."
    median, least, most = (MANY * each for each in best.seconds)
    return (
        f"For {100.0 * target:g} % error in restitution use dt = T/{best.steps:g}, T being the duration of a collision "
        f"(time_step_safety {best.share:.2g}), precision {best.line.precision}, integrator {best.line.integrator}: "
        f"it costs {median:.3g} s per million collisions ({least:.3g} to {most:.3g})."
    )


def default_sentence(lines: Sequence[Line], target: float) -> str:
    """What the default of `numerics.time_step_safety` keeps to."""
    default = float(Numerics().time_step_safety)
    line = next((line for line in lines if line.law == FOR_LAW and line.precision == "f64"), None)
    if line is None:
        return ""
    worst = max(_error_at(points, default) for points in line.kinds())
    verdict = "finer than" if worst <= target else "coarser than"
    return (
        f"The default, time_step_safety {default:g}, keeps the restitution of {FOR_LAW} in f64 within "
        f"{100.0 * worst:.2g} %: {verdict} this asks for."
    )


def _error_at(points: Sequence[Point], share: float) -> float:
    """Error of the restitution at a share between those measured, on straight lines between logarithms."""
    shares = np.array([point.share for point in points])[::-1]
    errors = np.array([point.restitution_error for point in points])[::-1]
    return float(np.exp(np.interp(np.log(share), np.log(shares), np.log(np.maximum(errors, 1e-300)))))


def table_heads(target: float) -> tuple[str, ...]:
    """Heads of `table_rows`."""
    asked = f"{100.0 * target:g} %"
    return (
        "law", "integrator", "precision", "order of e (steps fitted)", "least error of e",
        f"steps for {asked}", f"safety for {asked}", "s per million collisions",
    )  # fmt: skip


def table_rows(lines: Iterable[Line], target: float) -> list[tuple[str, ...]]:
    """A row a line."""
    rows: list[tuple[str, ...]] = []
    for line in lines:
        error, need = line.error("restitution"), need_of(line, target)
        order = fitted_order(line.steps, error)
        least = float(np.nanmin(error))
        needed: tuple[str, str, str] = ("–", "–", "–")
        if need is not None:
            median, low, high = (MANY * each for each in need.seconds)
            needed = (f"{need.steps:g}", f"{need.share:.2g}", f"{median:.3g} ({low:.3g}–{high:.3g})")
        rows.append((
            line.law, line.integrator, line.precision, order.words if order else "–", _short(least), *needed,
        ))  # fmt: skip
    return rows


def velocity_rows(lines: Iterable[Line], target: float) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Heads and rows of the steps a line needs at each approach velocity, all restitutions alike."""
    lines = list(lines)
    velocities = sorted({point.velocity for line in lines for point in line.points})
    rows = []
    for line in lines:
        cells = []
        for velocity in velocities:
            part = Line(line.law, line.integrator, line.precision,
                        tuple(point for point in line.points if point.velocity == velocity))  # fmt: skip
            need = need_of(part, target)
            cells.append(f"{need.steps:g}" if need else "–")
        rows.append((line.law, line.integrator, line.precision, *cells))
    return ("law", "integrator", "precision", *(f"{velocity:g} m/s" for velocity in velocities)), rows


def _short(value: float) -> str:
    """Two digits and a power of ten, with a minus that does not break a line."""
    return f"{value:.1e}".replace("-", "−")
