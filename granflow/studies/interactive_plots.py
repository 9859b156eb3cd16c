"""Interactive plots, drawn by plotly inside a page, without a network connection.

A `Plot` is data and layout in the format of plotly, as plain dictionaries; the script of the page draws it
with the library that `library` embeds in the page. The first part has what all plots share: style, axes,
texts and numbers. The second part makes plots of a time series: columns of one unit that belong together are
the curves of one plot.
"""

import json
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from itertools import takewhile
from math import isfinite
from typing import Any, NamedTuple
from zlib import compress

import numpy as np

from granflow.io.tables import SeriesColumn, TimeSeriesTable
from granflow.schema.document import yaml_inline
from granflow.studies.figures import COLORS
from granflow.visible_text import distinct_endings

# Plots and their style


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


def express_library() -> str:
    """As `library`, for pages whose plots are made by plotly.express, which needs pandas; sets its colors."""
    try:
        import pandas  # noqa: F401
        import plotly.express as px
    except ImportError:
        return ""
    px.defaults.template = "none"
    px.defaults.color_discrete_sequence = list(COLORS)
    px.defaults.color_continuous_scale = COLOR_SCALE
    return library()


def deflated(data: bytes) -> str:
    """Base64 text of the data in zlib format, `deflate` of DecompressionStream in a browser."""
    return b64encode(compress(data, 9)).decode("ascii")


FONT = {"family": "system-ui, sans-serif", "size": 13}
COLOR_SCALE = "Viridis"
DASHES = ("solid", "dash", "dot", "dashdot")
"""Line styles: one for each repetition of the colors, or for each quantity of parts."""
AXIS = {"showline": True, "zeroline": False, "exponentformat": "SI"}
"""Style of axes in the format of plotly; the script of the page adds its colors, also to text and
background."""
STANDOFF = 6
"""Distance of the title of the horizontal axis from its labels [pixels], so that it is above the legend."""
LEGEND = {"orientation": "h", "x": 0, "y": -0.25, "yanchor": "top", "maxheight": 1.0}
"""Legend below the plot; the script of the page makes room for its rows."""


def layout(height: int, **more: Any) -> dict[str, Any]:
    """Layout of a plot with the style of all pages; `height` [pixels]."""
    return {
        "height": height,
        "margin": {"l": 70, "r": 20, "t": 30, "b": 55},
        "font": FONT,
        "showlegend": False,
        "legend": LEGEND,
        "hovermode": "closest",
        **more,
    }


HEIGHT = 340
"""Height of a plot without its legend [pixels]."""


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


def plot_of_figure(caption: str, figure: Any, height: int = HEIGHT, **more: Any) -> Plot:
    """A figure of plotly as a plot in the style of all pages; `more`: of its layout."""
    figure.update_xaxes(AXIS | {"exponentformat": "power", "automargin": True, "title_standoff": STANDOFF})
    figure.update_yaxes(AXIS | {"exponentformat": "power", "automargin": True, "title_standoff": STANDOFF})
    figure.update_layout(layout(height) | more)
    return Plot(caption, json.loads(figure.to_json()))


# Texts and numbers in plots


def escaped(text: str) -> str:
    """Text of the input for plotly, which reads tags, links and entities in titles, names and values."""
    return escape(text, quote=False)


DIGITS = 6
"""Significant digits of a number in the page."""


def plain_numbers(values: np.ndarray) -> list[float]:
    """Numbers with DIGITS digits, as Python floats for JSON."""
    return [float(f"{value:.{DIGITS}g}") for value in values.tolist()]


def shown_unit(unit: str) -> tuple[float, str]:
    """Factor from the unit of a column to the unit in plots, and that unit: degrees for angles."""
    return (float(np.degrees(1.0)), "deg") if unit == "rad" else (1.0, unit)


def plain_number(value: Any, digits: int = 6) -> Any:
    """A number with few digits for the page, None if it is not finite; other values as text."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    return float(f"{value:.{digits}g}") if isfinite(value) else None


def level_text(value: Any, digits: int = 6) -> str:
    """Text of a value of a parameter: 18 for the float 18.0, YAML for a mapping or list, other values as they
    are."""
    if isinstance(value, dict | list | tuple):
        return yaml_inline(value)
    number = plain_number(value, digits)
    return f"{number:.{digits}g}" if isinstance(number, int | float) else str(value)


def short_names(names: Sequence[str]) -> dict[str, str]:
    """Short name of each parameter for an axis: the last two keys of its path, or as many as make all
    different."""
    endings = distinct_endings([name.split(".") for name in names], least=2)
    return {name: ".".join(parts) for name, parts in zip(names, endings, strict=True)}


MOST_POINTS = 800
"""Maximum number of points of a curve; more are not distinguishable on a screen."""


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


# Plots of a time series


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
    """Property that a column shares with others of its unit: quantity, last word or first word.

    It is the quantity of the column if there is none.
    """
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
        "x": plain_numbers(time),
        "y": plain_numbers(values),
        "hovertemplate": f"%{{y:.5~g}} {unit}",
        **look,
    }


STAGE_ROW = 14
"""Vertical offset of every second stage name, so that names of closely spaced stages do not overlap
[pixels]."""


def _stage_marks(series: TimeSeriesTable) -> dict[str, Any]:
    """A line and a name at the start of each stage if the run has several."""
    stages = series.stages if len(series.stages) > 1 else ()
    line = {"width": 1, "dash": "dot"}
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
                "yshift": STAGE_ROW * (k % 2),
            }
            for k, (time, name) in enumerate(stages)
        ],
    }
