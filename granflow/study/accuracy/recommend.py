"""What each line of the study needs for an error aimed at, and the one recommendation that follows."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from granflow.scene.schema import Numerics
from granflow.study.accuracy.orders import fitted_order
from granflow.study.accuracy.points import StudyLine, StudyPoint

FOR_LAW = "zhou"
"""The law that the recommendation is made for: choosing a law is physics, choosing a step is not."""
MANY = 1e6
"""Collisions whose cost is told."""


@dataclass(frozen=True)
class Requirement:
    """What a line needs to keep the error of the restitution at the target: None where it cannot.

    `steps` a collision; `share`: largest `numerics.time_step_fraction` that is enough for every kind of collision;
    `seconds` of a collision, median, smallest and largest.
    """

    line: StudyLine
    steps: float
    share: float
    seconds: tuple[float, float, float]


def requirement_of(line: StudyLine, target: float) -> Requirement | None:
    """The longest step of a line with the restitution within the target, for every kind of collision."""
    index = first_within(line.error("restitution"), target)
    if index is None:
        return None
    seconds = tuple(float(line.seconds(which)[index]) for which in ("median", "min", "max"))
    share = min(_share_within(points, target) for points in line.kinds())
    return Requirement(line, float(line.steps[index]), share, seconds)  # type: ignore[arg-type]


def first_within(error: np.ndarray, target: float) -> int | None:
    """First index from which this error and the next are within the target: one alone may be luck."""
    good = error <= target
    good = good & np.append(good[1:], True)
    return int(np.argmax(good)) if good.any() else None


def _share_within(points: Sequence[StudyPoint], target: float) -> float:
    """Time step over the shorter phase that one kind of collision bears; `points` by rising steps."""
    index = first_within(np.array([point.restitution_error for point in points]), target)
    return points[index].share if index is not None else 0.0


def cheapest(requirements: Iterable[Requirement | None]) -> Requirement | None:
    """The need of least cost for FOR_LAW."""
    able = [requirement for requirement in requirements if requirement is not None and requirement.line.law == FOR_LAW]
    return min(able, key=lambda requirement: requirement.seconds[0], default=None)


def recommendation(lines: Sequence[StudyLine], target: float) -> str:
    """The one sentence that the study ends in."""
    best = cheapest(requirement_of(line, target) for line in lines)
    if best is None:
        return f"No time step of this study keeps the restitution within {target:.3g} with {FOR_LAW}."
    median, least, most = (MANY * each for each in best.seconds)
    return (
        f"For {100.0 * target:g} % error in restitution use dt = T/{best.steps:g}, T being the duration of a collision "
        f"(time_step_fraction {best.share:.2g}), precision {best.line.precision}, integrator {best.line.integrator}: "
        f"it costs {median:.3g} s per million collisions ({least:.3g} to {most:.3g})."
    )


def default_sentence(lines: Sequence[StudyLine], target: float) -> str:
    """What the default of `numerics.time_step_fraction` keeps to."""
    default = float(Numerics().time_step_fraction)
    line = next((line for line in lines if line.law == FOR_LAW and line.precision == "f64"), None)
    if line is None:
        return ""
    worst = max(_error_at(points, default) for points in line.kinds())
    verdict = "finer than" if worst <= target else "coarser than"
    return (
        f"The default, time_step_fraction {default:g}, keeps the restitution of {FOR_LAW} in f64 within "
        f"{100.0 * worst:.2g} %: {verdict} this asks for."
    )


def _error_at(points: Sequence[StudyPoint], share: float) -> float:
    """Error of the restitution at a share between those measured, on straight lines between logarithms."""
    shares = np.array([point.share for point in points])[::-1]
    errors = np.array([point.restitution_error for point in points])[::-1]
    return float(np.exp(np.interp(np.log(share), np.log(shares), np.log(np.maximum(errors, 1e-300)))))


def table_heads(target: float) -> tuple[str, ...]:
    """Heads of `table_rows`."""
    requested = f"{100.0 * target:g} %"
    return (
        "law", "integrator", "precision", "order of e (steps fitted)", "least error of e",
        f"steps for {requested}", f"safety for {requested}", "s per million collisions",
    )  # fmt: skip


def table_rows(lines: Iterable[StudyLine], target: float) -> list[tuple[str, ...]]:
    """A row a line."""
    rows: list[tuple[str, ...]] = []
    for line in lines:
        error, requirement = line.error("restitution"), requirement_of(line, target)
        order = fitted_order(line.steps, error)
        least = float(np.nanmin(error))
        needed: tuple[str, str, str] = ("–", "–", "–")
        if requirement is not None:
            median, low, high = (MANY * each for each in requirement.seconds)
            needed = (f"{requirement.steps:g}", f"{requirement.share:.2g}", f"{median:.3g} ({low:.3g}–{high:.3g})")
        rows.append((
            line.law, line.integrator, line.precision, order.words if order else "–", _short(least), *needed,
        ))  # fmt: skip
    return rows


def velocity_rows(lines: Iterable[StudyLine], target: float) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Heads and rows of the steps a line needs at each approach velocity, all restitutions alike."""
    lines = list(lines)
    velocities = sorted({point.velocity for line in lines for point in line.points})
    rows = []
    for line in lines:
        cells = []
        for velocity in velocities:
            part = StudyLine(line.law, line.integrator, line.precision,
                        tuple(point for point in line.points if point.velocity == velocity))  # fmt: skip
            requirement = requirement_of(part, target)
            cells.append(f"{requirement.steps:g}" if requirement else "–")
        rows.append((line.law, line.integrator, line.precision, *cells))
    return ("law", "integrator", "precision", *(f"{velocity:g} m/s" for velocity in velocities)), rows


def _short(value: float) -> str:
    """Two digits and a power of ten, with a minus that does not break a line."""
    return f"{value:.1e}".replace("-", "−")
