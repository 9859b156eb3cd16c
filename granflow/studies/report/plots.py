"""Interactive plots, drawn by plotly inside the page, without a network connection."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from itertools import takewhile
from math import inf
from typing import Any, NamedTuple

import numpy as np

from granflow.io.tables import SeriesColumn, TimeSeriesTable
from granflow.studies.figures import COLORS
from granflow.studies.report.view import deflated

# Grouping of the columns of a time series into plots.

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

    `flow_mass.a` and `flow_mass.b` are one quantity; `kinetic_energy` and `elastic_energy` share the last
    word, `overlap_mean` and `overlap_largest` the first. The grouping depends on names and units only.
    """
    kinds: dict[tuple[str, str], list[SeriesColumn]] = {}
    for column in columns:
        kinds.setdefault((column.unit, _kind(column, columns)), []).append(column)
    return [PlotGroup(common_title(members), unit, tuple(members)) for (unit, _), members in kinds.items()]


def _kind(column: SeriesColumn, columns: Sequence[SeriesColumn]) -> str:
    """Common property of a column and others of its unit: quantity, last word or first word; else its own
    name."""
    quantity = column.name.partition(".")[0]
    other_quantities = {other.name.partition(".")[0] for other in columns if other.unit == column.unit} - {
        quantity
    }
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


DASHES = ("solid", "dash", "dot", "dashdot")
"""Line styles: one for each repetition of the colors, or for each quantity of parts."""
DIGITS = 6
"""Significant digits of a number in the page."""
AXIS = {"showline": True, "zeroline": False, "exponentformat": "SI"}
"""Style of axes in the format of plotly; the script of the page adds its colors, also to text and
background."""
HEIGHT = 340
"""Height of a plot without its legend [pixels]."""
STANDOFF = 6
"""Distance of the title of the horizontal axis from its labels [pixels], so that it is above the legend."""
LEGEND = {"orientation": "h", "x": 0, "y": -0.25, "yanchor": "top", "maxheight": 1.0}
"""Legend below the plot; the script of the page makes room for its rows."""
STAGE_ROW, NEAR = 14, 0.1
"""Vertical offset [pixels] of a stage name that would overlap the previous one; distance as a fraction of the
run."""


class Plot(NamedTuple):
    """An interactive plot; `figure` contains data and layout in the format of plotly."""

    caption: str
    figure: dict[str, Any]


def library() -> str:
    """JavaScript of plotly as compressed text, to embed in the page; empty if plotly is not installed."""
    try:
        from plotly.offline import get_plotlyjs
    except ImportError:
        return ""
    return deflated(get_plotlyjs().encode())


def shown_unit(unit: str) -> tuple[float, str]:
    """Factor from the unit of a column to the unit in plots, and that unit: degrees for angles."""
    return (float(np.degrees(1.0)), "deg") if unit == "rad" else (1.0, unit)


def plot_of(group: PlotGroup, series: TimeSeriesTable) -> Plot:
    """Plot of a group of columns against time, with the stages of the run.

    All columns of a group have the same unit; angles are shown in degrees.
    """
    per_unit, shown = shown_unit(group.unit)
    curves = [
        _curve(look, column, series, per_unit, shown)
        for look, column in zip(_looks(group.columns), group.columns, strict=True)
    ]
    unit = f" ({shown})" if shown else ""
    layout = {
        **curve_layout("time (s)", escaped(group.title + unit), len(curves) > 1),
        **_stage_marks(series),
    }
    return Plot(
        f"{group.title[0].upper()}{group.title[1:]}{unit} over time", {"data": curves, "layout": layout}
    )


def curve_layout(x_title: str, y_title: str, has_legend: bool) -> dict[str, Any]:
    """Layout of a plot of curves in the format of plotly."""
    return {
        "height": HEIGHT,
        "margin": {"l": 70, "r": 20, "t": 45, "b": 50},
        "font": {"family": "system-ui, sans-serif", "size": 13},
        "hovermode": "x unified",
        "showlegend": has_legend,
        "legend": LEGEND,
        "xaxis": {
            **AXIS,
            "title": {"text": x_title, "standoff": STANDOFF},
            "exponentformat": "none",
            "hoverformat": ".6~g",
        },
        "yaxis": {**AXIS, "title": {"text": y_title}},
    }


def _looks(columns: Sequence[SeriesColumn]) -> list[dict[str, Any]]:
    """Color, line style and legend group of each column in the format of plotly.

    Several quantities of several parts, such as components of forces on walls: a color per part, a line style
    per quantity, and a click on a name hides the part. Otherwise a color per column.
    """
    names = [column.name.partition(".") for column in columns]
    quantities, parts = (list(dict.fromkeys(name[k] for name in names)) for k in (0, 2))
    if len(quantities) > 1 and len(parts) > 1 and "" not in parts:
        places = [
            (parts.index(part), quantities.index(quantity), {"legendgroup": part})
            for quantity, _, part in names
        ]
    else:
        places = [(number, number // len(COLORS), {}) for number in range(len(columns))]
    return [
        {
            "line": {"color": COLORS[color % len(COLORS)], "width": 1.8, "dash": DASHES[dash % len(DASHES)]},
            **group,
        }
        for color, dash, group in places
    ]


def _curve(
    look: dict[str, Any], column: SeriesColumn, series: TimeSeriesTable, per_unit: float, unit: str
) -> dict[str, Any]:
    """One curve in the format of plotly, with at most `series.MOST_POINTS` points, in `per_unit` of its
    unit."""
    time, values = thinned(series.time, per_unit * column.values)
    return {
        "type": "scatter",
        "mode": "lines" if len(time) > 1 else "markers",
        "name": escaped(column.text),
        "x": plain(time),
        "y": plain(values),
        "hovertemplate": f"%{{y:.5~g}} {unit}",
        **look,
    }


def escaped(text: str) -> str:
    """Text of the input for plotly, which reads tags, links and entities in titles, names and values."""
    return escape(text, quote=False)


def plain(values: np.ndarray) -> list[float]:
    """Numbers with DIGITS digits, as Python floats for JSON."""
    return [float(f"{value:.{DIGITS}g}") for value in values.tolist()]


def _stage_marks(series: TimeSeriesTable) -> dict[str, Any]:
    """A line and a name at the start of each stage if the run has several."""
    stages = series.stages if len(series.stages) > 1 else ()
    line = {"width": 1, "dash": "dot"}
    rows = _rows([time for time, _ in stages], series.time[-1] - series.time[0])
    return {
        "shapes": [
            {"type": "line", "x0": time, "x1": time, "y0": 0, "y1": 1, "yref": "paper", "line": line}
            for time, _ in stages
        ],
        "annotations": [
            {
                "x": time,
                "y": 1,
                "yref": "paper",
                "text": escaped(name),
                "showarrow": False,
                "xanchor": "left",
                "yanchor": "bottom",
                "font": {"size": 11},
                "yshift": STAGE_ROW * row,
            }
            for (time, name), row in zip(stages, rows, strict=True)
        ],
    }


def _rows(times: Sequence[float], span: float) -> list[int]:
    """Row 0 or 1 of each stage name, so that names of closely spaced stages do not overlap."""
    rows: list[int] = []
    for before, time in zip([-inf, *times], times, strict=False):
        rows.append(1 - rows[-1] if rows and time - before < NEAR * span else 0)
    return rows
