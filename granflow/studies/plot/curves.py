"""Curves of `granflow plot`: the chosen columns of one or more runs, by panel."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from granflow.errors import GranflowError
from granflow.io.time_series import SeriesColumn, TimeSeriesTable
from granflow.studies.plot.expression import WORD, quantity_of
from granflow.studies.plot.source import series_of
from granflow.studies.report.series import common_title
from granflow.visible_text import distinct_endings, numbered

MOST_CURVES = 18
"""Largest number of curves of a panel: nine colors with two line styles each."""


LARGEST = 1e250
"""Largest value that can be drawn: ranges and margins of axes, their products and powers must be finite numbers."""


@dataclass(frozen=True)
class Curve:
    """One curve: its name in the legend, and values (n,) of x and y."""

    name: str
    x: np.ndarray
    y: np.ndarray


@dataclass(frozen=True)
class Panel:
    """Curves with the same axes; the titles contain units."""

    x_title: str
    y_title: str
    curves: tuple[Curve, ...]


def panels_of(sources: Sequence[Path], x: str, y: Sequence[str], stages: Sequence[str] = ()) -> list[Panel]:
    """One panel for each unit of the quantities `y`, with the curves of all sources over `x`.

    `stages`: only rows of these stages; empty: all rows. Raises GranflowError for unknown columns or stages, for
    quantities without a finite value or with values above LARGEST, and for more curves than MOST_CURVES.
    """
    found = [series_of(source, x) for source in sources]
    names = short_names(sources)
    panels: dict[str, list[tuple[str, SeriesColumn, SeriesColumn]]] = {}
    drawn: dict[str, list[np.ndarray]] = {text: [] for text in y}
    for name, (path, series) in zip(names, found, strict=True):
        rows = _rows(series, stages, path)
        horizontal = quantity_of(series, x, str(path))
        for text in y:
            column = quantity_of(series, text, str(path))
            label = ", ".join([name] * (len(found) > 1) + [_label(column)] * (len(y) > 1)) or _label(column)
            parts = (_selected(horizontal, rows), _selected(column, rows))
            drawn[text].append(_points(*parts))
            panels.setdefault(column.unit, []).append((label, *parts))
    for text, points in drawn.items():
        _refuse_what_cannot_be_drawn(x, text, np.concatenate(points), found[0][0] if len(found) == 1 else None)
    largest = max(len(curves) for curves in panels.values())
    if largest > MOST_CURVES:
        raise GranflowError(
            f"{numbered(largest, 'curve')} are too many for one plot; choose at most {MOST_CURVES} with --y or fewer "
            "runs."
        )
    return [_panel(curves) for curves in panels.values()]


def _points(horizontal: SeriesColumn, vertical: SeriesColumn) -> np.ndarray:
    """Points (n, 2) of a curve with two finite coordinates."""
    points = np.stack([horizontal.values, vertical.values], axis=1)
    return points[np.isfinite(points).all(axis=1)]


def _refuse_what_cannot_be_drawn(x: str, y: str, points: np.ndarray, path: Path | None) -> None:
    """Raise GranflowError for a quantity without a finite point in all sources, and for too large values.

    `points` (n, 2): of the quantity `y` over `x` in all sources; `path`: file of the only source.
    """
    if not len(points):
        raise GranflowError(
            f"'{y}' over '{x}' has no finite value in the selected rows of {path or 'any of the runs'}: there is "
            "nothing to draw. Choose another quantity, or other --stages."
        )
    for text, largest in zip((x, y), np.abs(points).max(axis=0), strict=True):
        if largest > LARGEST:
            raise GranflowError(
                f"Values of '{text}' reach {largest:.3g}, but at most {LARGEST:g} can be drawn: divide them, such as "
                f"'({text}) / {largest:.0e}'."
            )


def _panel(curves: Sequence[tuple[str, SeriesColumn, SeriesColumn]]) -> Panel:
    """Panel of curves, each with its name and its columns of x and y; all of one unit."""
    columns = [column for _, _, column in curves]
    title = _label(columns[0]) if len({each.name for each in columns}) == 1 else common_title(columns) or "value"
    found = tuple(Curve(name, horizontal.values, column.values) for name, horizontal, column in curves)
    return Panel(_with_unit(_label(curves[0][1]), curves[0][1].unit), _with_unit(title, columns[0].unit), found)


def short_names(sources: Sequence[Path]) -> list[str]:
    """The last parts of the paths: as few as make all different."""
    return ["/".join(parts) for parts in distinct_endings([source.resolve().parts for source in sources])]


def _rows(series: TimeSeriesTable, stages: Sequence[str], path: Path) -> np.ndarray:
    """Mask (n,) of the rows of the stages, or of all rows. Raises GranflowError if a stage has no rows."""
    names = dict.fromkeys(name for _, name in series.stages)
    for stage in stages:
        if stage not in names:
            raise GranflowError(
                f"{path} has no rows of the stage {stage}; its stages are: {', '.join(names) or 'none'}."
            )
    return np.isin(series.stage, list(stages)) if stages else np.ones(len(series.time), dtype=bool)


def _selected(column: SeriesColumn, rows: np.ndarray) -> SeriesColumn:
    return SeriesColumn(column.name, column.unit, column.values[rows])


def _label(column: SeriesColumn) -> str:
    """Name of a column for display; an expression as it is written."""
    return column.text if WORD.fullmatch(column.name) else column.name


def _with_unit(title: str, unit: str) -> str:
    return title + (f" ({unit})" if unit not in ("", "1") else "")
