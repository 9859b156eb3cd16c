"""Steps and cost that each line of the study requires for a target error, and the resulting recommendation.

A line is one contact model with one precision.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from granflow.scene.schema.run import Numerics
from granflow.studies.accuracy.orders import fitted_order
from granflow.studies.accuracy.points import StudyLine, StudyPoint

FOR_LAW = "zhou"
"""Contact model of the recommendation: the contact model is a choice of physics, the time step is not."""
MANY = 1e6
"""Number of collisions to which reported costs refer."""


@dataclass(frozen=True)
class Requirement:
    """Requirement of a line for a restitution error within the target.

    `steps` per collision; `share`: largest `numerics.time_step_fraction` that suffices for every kind of collision;
    `seconds`: processor time of one collision [s], median, minimum and maximum.
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
    """Largest sufficient time step over the shorter phase for one kind of collision; `points` in ascending steps."""
    index = first_within(np.array([point.restitution_error for point in points]), target)
    return points[index].share if index is not None else 0.0


def cheapest(requirements: Iterable[Requirement | None]) -> list[Requirement]:
    """Requirement of least cost for FOR_LAW, and those whose ranges of costs overlap with its range."""
    able = [requirement for requirement in requirements if requirement is not None and requirement.line.law == FOR_LAW]
    able.sort(key=lambda requirement: requirement.seconds[0])
    return [requirement for requirement in able if requirement.seconds[1] <= able[0].seconds[2]]


def recommendation(lines: Sequence[StudyLine], target: float) -> str:
    """Concluding sentence of the study: the cheapest time step and precision with errors within the target."""
    found = cheapest(requirement_of(line, target) for line in lines)
    if not found:
        return f"No time step of this study limits the restitution error to {target:.3g} with {FOR_LAW}."
    texts = [f"{_choice(each)}: {_cost(each)}" for each in found]
    requested = f"For {100.0 * target:g} % error in restitution"
    if len(found) > 1:
        return (
            f"{requested}, the cheapest choices are not distinguished by their costs per million collisions, which "
            f"overlap: {'; '.join(texts)}. T is the collision time, costs are processor time."
        )
    return (
        f"{requested} use {_choice(found[0])}, where T is the collision time: it costs {_cost(found[0])} of processor "
        "time per million collisions."
    )


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


def table_heads(target: float) -> tuple[str, ...]:
    """Column headings of `table_rows`."""
    requested = f"{100.0 * target:g} %"
    return (
        "contact model", "precision", "order of e (fitted steps)", "smallest error of e",
        f"steps for {requested}", f"time_step_fraction for {requested}", "s per million collisions",
    )  # fmt: skip


def table_rows(lines: Iterable[StudyLine], target: float) -> list[tuple[str, ...]]:
    """Table rows, one per line: order of convergence, smallest error, and the requirement for the target."""
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
            line.law, line.precision, order.text if order else "–", _short(least), *needed,
        ))  # fmt: skip
    return rows


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


def _short(value: float) -> str:
    """Two digits and a power of ten, with a minus sign that does not break the line."""
    return f"{value:.1e}".replace("-", "−")
