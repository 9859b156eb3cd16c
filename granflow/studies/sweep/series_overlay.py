"""Time series of several runs in one plot; a menu selects the quantity, the legend the runs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from granflow.io.time_series import SeriesColumn, TimeSeriesTable, read_series
from granflow.studies.figures import COLORS
from granflow.studies.report.plots import DASHES, Plot, escaped, shown_unit
from granflow.studies.report.series import thinned
from granflow.studies.sweep.axes import axis, layout, plain

MOST_RUNS = 60
"""Largest number of runs in the plot."""

MOST_COLUMNS, MOST_POINTS = 12, 160
"""Largest number of quantities, and of points of a curve."""

HEIGHT = 460
"""Height of the plot [pixels]."""


class NamedRun(NamedTuple):
    """A run in the plot: its name in the legend, its text at the pointer, and its directory."""

    name: str
    hover: str
    directory: Path


def series_overlay(runs: Sequence[NamedRun], first: Sequence[str], named_by: str) -> Plot | None:
    """Time series of the runs; None if none of them has rows.

    `first`: quantities that are shown first; the others follow in the order of the files; `named_by`: what the names of
    the runs contain. A click on a name in the legend hides a run, a double click shows only this run.
    """
    shown = runs[:: -(-len(runs) // MOST_RUNS)] if runs else ()
    found = {run: series for run in shown if (series := read_series(run.directory / "timeseries.csv"))}
    if not found:
        return None
    columns = _columns(list(found.values()), first)
    curves = {column.name: [_curve(series, column.name) for series in found.values()] for column in columns}
    data = [
        {"type": "scatter", "mode": "lines", "name": run.name, "x": x, "y": y,
         "line": {"color": COLORS[k % len(COLORS)], "dash": DASHES[k // len(COLORS) % len(DASHES)]},
         "hovertext": run.hover, "hovertemplate": "%{y:.4~g}<br>%{hovertext}<extra></extra>"}
        for k, (run, (x, y)) in enumerate(zip(found, curves[columns[0].name], strict=True))
    ]  # fmt: skip
    menu = {
        "buttons": [_button(column, curves[column.name]) for column in columns],
        "x": 0,
        "xanchor": "left",
        "y": 1.16,
    }
    axes = {"xaxis": axis("time (s)"), "yaxis": axis(_title(columns[0]))}
    caption = (
        f"Time series of {len(found)} of {len(runs)} runs, named by {named_by}. The menu selects the quantity; a click "
        "in the legend hides a run, a double click shows only this run."
    )
    look = layout(HEIGHT, updatemenus=[menu], **axes) | {"showlegend": True}
    return Plot(caption, {"data": data, "layout": look | {"margin": {"l": 70, "r": 20, "t": 70, "b": 55}}})


def _columns(found: Sequence[TimeSeriesTable], first: Sequence[str]) -> list[SeriesColumn]:
    """The columns that all runs have, those in `first` first and in its order; at most MOST_COLUMNS."""
    common = set.intersection(*({column.name for column in series.columns} for series in found))
    columns = [column for column in found[0].columns if column.name in common]
    places = {name: place for place, name in enumerate(first)}
    return sorted(columns, key=lambda column: places.get(column.name, len(places)))[:MOST_COLUMNS]


def _curve(series: TimeSeriesTable, name: str) -> tuple[list[Any], list[Any]]:
    """Times [s] and values of one column in the unit of plots, thinned."""
    column = next(each for each in series.columns if each.name == name)
    time, values = thinned(series.time, shown_unit(column.unit)[0] * column.values, MOST_POINTS)
    return [plain(each) for each in time.tolist()], [plain(each) for each in values.tolist()]


def _button(column: SeriesColumn, curves: Sequence[tuple[list[Any], list[Any]]]) -> dict[str, Any]:
    """Entry of the menu: shows the curves of one column."""
    data = {"x": [x for x, _ in curves], "y": [y for _, y in curves]}
    return {"method": "update", "label": escaped(column.text), "args": [data, {"yaxis.title.text": _title(column)}]}


def _title(column: SeriesColumn) -> str:
    text = escaped(column.text)
    return f"{text} ({shown_unit(column.unit)[1]})" if column.unit else text
