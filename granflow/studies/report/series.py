"""Grouping of the columns of a time series into plots."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile

import numpy as np

from granflow.io.time_series import SeriesColumn

MOST_POINTS = 800
"""Maximum number of points of a curve; more are not distinguishable on a screen."""


@dataclass(frozen=True)
class PlotGroup:
    """Columns of one unit in a common plot."""

    title: str
    unit: str
    columns: tuple[SeriesColumn, ...]


def groups_of(columns: Sequence[SeriesColumn]) -> list[PlotGroup]:
    """Group columns of one unit by quantity, or by a common last or first word.

    `flow_mass.a` and `flow_mass.b` are one quantity; `kinetic_energy` and `elastic_energy` share the last word,
    `overlap_mean` and `overlap_largest` the first. The grouping depends on names and units only.
    """
    kinds: dict[tuple[str, str], list[SeriesColumn]] = {}
    for column in columns:
        kinds.setdefault((column.unit, _kind(column, columns)), []).append(column)
    return [PlotGroup(common_title(members), unit, tuple(members)) for (unit, _), members in kinds.items()]


def _kind(column: SeriesColumn, columns: Sequence[SeriesColumn]) -> str:
    """Common property of a column and others of its unit: quantity, last word or first word; else its own name."""
    quantity = column.name.partition(".")[0]
    other_quantities = {other.name.partition(".")[0] for other in columns if other.unit == column.unit} - {quantity}
    text = quantity.split("_")
    if any(other.split("_")[-1] == text[-1] for other in other_quantities):
        return text[-1]
    if any(other.split("_")[0] == text[0] for other in other_quantities):
        return text[0]
    return quantity


def common_title(members: Sequence[SeriesColumn]) -> str:
    """Common first words of the quantities, or else common last words."""
    if len(members) == 1:
        return members[0].text
    text = [column.name.partition(".")[0].split("_") for column in members]
    begin = _common_prefix(text)
    end = _common_prefix([list(reversed(each)) for each in text])
    return " ".join(begin or reversed(end))


def _common_prefix(text: Sequence[Sequence[str]]) -> list[str]:
    """Common first words of all lists."""
    columns = takewhile(lambda each: len(set(each)) == 1, zip(*text, strict=False))
    return [each[0] for each in columns]


def thinned(time: np.ndarray, values: np.ndarray, most: int = MOST_POINTS) -> tuple[np.ndarray, np.ndarray]:
    """Reduce a curve to at most `most` points, keeping all peaks: minimum and maximum of each interval.

    `time`, `values` (n,); values that are not finite are dropped.
    """
    finite = np.flatnonzero(np.isfinite(values))
    if len(finite) > most:
        parts = np.array_split(finite[1:-1], most // 2 - 1)
        ends = [part[extreme(values[part])] for part in parts for extreme in (np.argmin, np.argmax)]
        finite = np.unique([finite[0], *ends, finite[-1]])
    return time[finite], values[finite]


def largest_of(column: SeriesColumn) -> float:
    """Largest absolute value of a column; values that are not finite are ignored."""
    return float(np.max(np.abs(column.values[np.isfinite(column.values)]), initial=0.0))


def negligible_columns(columns: Sequence[SeriesColumn], share: float) -> list[SeriesColumn]:
    """Columns whose largest absolute value is below `share` of that of all columns of the same unit."""
    largest: dict[str, float] = {}
    for column in columns:
        largest[column.unit] = max(largest.get(column.unit, 0.0), largest_of(column))
    return [column for column in columns if largest_of(column) < share * largest[column.unit]]
