"""The page of a sweep: tables, interactive plots, and Sobol indices by SALib.

`write_sweep_page` puts the parts together; the functions below return them in the order of the page.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from math import floor, inf, log10
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granflow.io.files import write_text
from granflow.io.tables import SeriesColumn, TimeSeriesTable, read_series
from granflow.studies.figures import COLORS, PageTable, without_empty_ends
from granflow.studies.interactive_plots import (
    COLOR_SCALE,
    DASHES,
    STANDOFF,
    Plot,
    axis,
    escaped,
    layout,
    level_text,
    library,
    plain_number,
    row_of_axes,
    shown_unit,
    thinned,
)
from granflow.studies.page import page_text
from granflow.studies.sweep_design import Grid, SobolSampling, SweepInput
from granflow.studies.sweep_table import PointRow, ShownTable, SweepTable, shown

PAGE = "sweep.html"
NO_LIBRARY = "Plots require plotly, which is not installed: pip install plotly, then repeat the command."


def write_sweep_page(out: Path, sweep: SweepInput, table: SweepTable) -> None:
    """Write `sweep.html` to the directory of the sweep; without plotly, it has tables only."""
    script = library()
    found = shown(sweep, table)
    drawn = replace(found, in_plots=True)
    has_plots = bool(script and usable_rows(found))
    indices, why_none = sobol_indices(sweep, table)
    gridded = isinstance(sweep.sampling, Grid)
    text = page_text(
        "sweep.html",
        plotly=script,
        title=sweep.title or f"Sweep of {Path(sweep.scene).stem}",
        lead=sweep.description or f"{len(table.rows)} points of {sweep.scene}.",
        statuses=_statuses(table),
        no_library="" if script else NO_LIBRARY,
        effects=[main_effects(drawn, each) for each in found.quantities] if has_plots else [],
        heat_maps=heat_maps(drawn) if has_plots and gridded else [],
        parallel=parallel_coordinates(drawn) if has_plots else None,
        matrix=scatter_matrix(drawn) if has_plots else None,
        sobol=[sobol_plot(drawn, each) for each in indices] if script else [],
        why_no_sobol=why_none,
        overlay=series_overlay(_named_runs(drawn), table.quantities, _named_by(found)) if script else None,
        points=_points(found),
    )
    write_text(out / PAGE, text)


def _statuses(table: SweepTable) -> PageTable:
    """Number of points with each status."""
    statuses = [row.outcome.status for row in table.rows]
    return PageTable(
        ("status", "points"), [(each, str(statuses.count(each))) for each in dict.fromkeys(statuses)]
    )


def usable_rows(table: ShownTable) -> list[PointRow]:
    """The rows with at least one number."""
    return [row for row in table.rows if any(np.isfinite(table.mean(row, name)) for name in table.quantities)]


HEIGHT = 340
"""Height of a plot [pixels]."""


def hover(row: PointRow, table: ShownTable) -> str:
    """Text at the pointer: parameters, quantities and run directories."""
    lines = [
        f"{table.parameter_label(name)} = {level_text(table.value(row, name), 4)}"
        for name in table.parameters
    ]
    lines += [f"{table.label(name)} = {plain_number(table.mean(row, name), 4)}" for name in table.quantities]
    return "<br>".join([*lines, *(f"runs/{name}" for name in row.directories)])


# Main effects

MOST_LEVELS = 12
"""Largest number of values of a parameter with a mean of their own; more are combined in BINS intervals."""
BINS = 8
EDGE_ROUNDING = 1e-4
"""A value on the common edge of two intervals is in the upper one, also if rounding puts it below by this
share."""


def main_effects(table: ShownTable, quantity: str) -> Plot:
    """Points, and mean over all points with the same value of a parameter, one plot for each parameter."""
    rows = [row for row in table.rows if np.isfinite(table.mean(row, quantity))]
    data: list[dict[str, Any]] = []
    binned = False
    for k, name in enumerate(table.parameters):
        axes = {"xaxis": f"x{k + 1}" if k else "x", "yaxis": f"y{k + 1}" if k else "y"}
        values = [plain_number(table.value(row, name)) for row in rows]
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "x": values,
                "y": [plain_number(table.mean(row, quantity)) for row in rows],
                "marker": {"color": COLORS[5], "size": 5, "opacity": 0.6},
                "hoverinfo": "text",
                "hovertext": [hover(row, table) for row in rows],
                **axes,
            }
        )
        groups = _groups(values, name in table.logarithmic)
        data.append({**_mean_line(table, groups, values, rows, quantity), **axes})
        binned = binned or len(groups) < len(set(values))
    has_errors = any(any(each["error_y"]["array"]) for each in data if "error_y" in each)
    caption = (
        f"{table.label(quantity)}: mean over all points with the same value of a parameter"
        f"{', or in equal intervals of it' if binned else ''} "
        f"(line){', with its standard error' if has_errors else ''}, and all points (light)"
    )
    row = row_of_axes([table.parameter_label(name) for name in table.parameters], table.label(quantity))
    for k, name in enumerate(table.parameters):
        row[f"xaxis{k + 1 if k else ''}"] |= _scale(table, name)
    return Plot(caption, {"data": data, "layout": layout(HEIGHT, **row)})


def _scale(table: ShownTable, name: str) -> dict[str, Any]:
    """Type of the axis of a parameter or quantity, if it is not linear."""
    return {"type": "log", "exponentformat": "none"} if name in table.logarithmic else {}


def _groups(values: Sequence[Any], logarithmic: bool) -> list[tuple[Any, list[int]]]:
    """Indices of the points with each value, or in each of BINS intervals with their mean value, in order.

    logarithmic:  whether the intervals have equal ratios, and the means are geometric
    """
    distinct = (
        sorted(set(values)) if all(isinstance(v, float) for v in values) else list(dict.fromkeys(values))
    )
    if len(distinct) <= MOST_LEVELS or not all(isinstance(v, float) for v in distinct):
        return [(value, [k for k, each in enumerate(values) if each == value]) for value in distinct]
    scaled = np.log(values) if logarithmic else np.array(values)
    fraction = (scaled - scaled.min()) / (scaled.max() - scaled.min())
    number = np.minimum(fraction * BINS + EDGE_ROUNDING, BINS - 1).astype(int)
    members = [np.flatnonzero(number == k).tolist() for k in range(BINS)]
    means = [float(scaled[each].mean()) for each in members if each]
    positions = np.exp(means) if logarithmic else means
    return list(zip((plain_number(float(each)) for each in positions), filter(None, members), strict=True))


def _mean_line(
    table: ShownTable,
    groups: Sequence[tuple[Any, list[int]]],
    values: Sequence[Any],
    rows: Sequence[PointRow],
    quantity: str,
) -> dict[str, Any]:
    """Means with standard errors over the values of one parameter, for each of the `groups`.

    The error of a mean follows from the scatter over the seeds; within an interval, from the scatter of its
    points.
    """
    means = []
    errors = []
    positions = []
    for position, members in groups:
        numbers = np.array([table.mean(rows[k], quantity) for k in members])
        seeds = np.array([table.standard_error(rows[k], quantity) for k in members])
        binned = len({values[k] for k in members}) > 1
        scatter = numbers.std(ddof=1) / np.sqrt(len(numbers)) if len(numbers) > 1 and binned else np.nan
        from_seeds = float(np.sqrt((seeds**2).sum())) / len(seeds)
        positions.append(position)
        means.append(plain_number(float(numbers.mean())))
        errors.append(plain_number(float(scatter if binned else from_seeds)) or 0.0)
    return {
        "type": "scatter",
        "mode": "lines+markers",
        "x": positions,
        "y": means,
        "hoverinfo": "x+y",
        "error_y": {"type": "data", "array": errors, "color": COLORS[0]},
        "line": {"color": COLORS[0], "width": 2},
        "marker": {"size": 7},
    }


# Heat maps

MOST_HEAT_MAPS = 6
"""Largest number of pairs of parameters with a heat map for each quantity."""


def heat_maps(table: ShownTable) -> list[Plot]:
    """Each quantity over each two parameters of a grid, averaged over the other parameters."""
    levels = {
        name: list(dict.fromkeys(plain_number(table.value(row, name)) for row in table.rows))
        for name in table.parameters
    }
    pairs = list(combinations(table.parameters, 2))[:MOST_HEAT_MAPS]
    small = [pair for pair in pairs if len(levels[pair[0]]) * len(levels[pair[1]]) <= len(table.rows)]
    return [_heat_map(table, quantity, *pair, levels) for quantity in table.quantities for pair in small]


def _heat_map(
    table: ShownTable, quantity: str, first: str, second: str, levels: dict[str, list[Any]]
) -> Plot:
    """One quantity over two parameters."""
    cells: dict[tuple[Any, Any], list[PointRow]] = {}
    for row in table.rows:
        cells.setdefault(
            (plain_number(table.value(row, first)), plain_number(table.value(row, second))), []
        ).append(row)

    def mean(x: Any, y: Any) -> float | None:
        values = [value for row in cells.get((x, y), ()) if np.isfinite(value := table.mean(row, quantity))]
        return plain_number(float(np.mean(values))) if values else None

    def text(x: Any, y: Any) -> str:
        members = cells.get((x, y), [])
        return hover(members[0], table) if len(members) == 1 else f"mean of {len(members)} points"

    means = [[mean(x, y) for x in levels[first]] for y in levels[second]]
    names = [[level_text(each) for each in levels[name]] for name in (first, second)]
    data = {
        "type": "heatmap",
        "x": names[0],
        "y": names[1],
        "colorscale": COLOR_SCALE,
        "hoverinfo": "text+z",
        "z": means,
        "text": [[text(x, y) for x in levels[first]] for y in levels[second]],
        "colorbar": _color_bar(
            table.label(quantity), [value for line in means for value in line if value is not None]
        ),
    }
    axes = {
        "xaxis": axis(table.parameter_label(first), type="category"),
        "yaxis": axis(table.parameter_label(second), type="category"),
    }
    caption = f"{table.label(quantity)} over {first} and {second}"
    return Plot(caption, {"data": [data], "layout": layout(HEIGHT, **axes)})


def _color_bar(title: str, values: Sequence[float]) -> dict[str, Any]:
    """A narrow color bar; equal values have one label, where plotly would show a range of 1 about 0."""
    bar: dict[str, Any] = {"title": {"text": title, "side": "right"}, "thickness": 14}
    if len(set(values)) == 1:
        bar |= {"tickvals": [values[0]], "ticktext": [level_text(values[0], 4)]}
    return bar


# Parallel coordinates

MOST_LINES = 500
"""Largest number of runs in the parallel coordinates."""


def parallel_coordinates(table: ShownTable) -> Plot:
    """One line per point over all parameters and quantities, each scaled to its range.

    The color shows the first quantity.
    """
    rows = usable_rows(table)
    shown = rows[:: -(-len(rows) // MOST_LINES)]
    columns = {
        table.parameter_label(name): [table.value(row, name) for row in rows] for name in table.parameters
    }
    columns |= {table.label(name): [table.mean(row, name) for row in rows] for name in table.quantities}
    logarithmic = {table.parameter_label(name) for name in table.logarithmic}
    shares = {
        name: dict(
            zip(map(id, rows), _shares(np.log(values) if name in logarithmic else values), strict=True)
        )
        for name, values in columns.items()
    }
    names = list(columns)
    color = table.label(table.quantities[0])
    data = [
        {
            "type": "scatter",
            "mode": "lines+markers",
            "x": names,
            "y": [shares[name][id(row)] for name in names],
            "line": {"color": _color(shares[color][id(row)]), "width": 1.5},
            "marker": {"size": 5},
            "hovertext": hover(row, table),
            "hoverinfo": "text",
        }
        for row in shown
    ]
    ends = [
        f"{name.replace('.', '.<br>')}<br>{_end(values, min)} to {_end(values, max)}"
        for name, values in columns.items()
    ]
    x_axis = axis("", tickvals=names, ticktext=ends)
    y_axis = axis("share of the range")
    caption = (
        f"Each line is a point; {len(shown)} of {len(rows)} points, colored from low (blue) to high (orange) "
        f"{color}"
    )
    return Plot(caption, {"data": data, "layout": layout(HEIGHT + 60, xaxis=x_axis, yaxis=y_axis)})


def _shares(values: Sequence[Any] | np.ndarray) -> list[float | None]:
    """Positions of the values in their range, 0 to 1; of text in the order of its first appearance."""
    if not all(isinstance(each, int | float) for each in values):
        names = list(dict.fromkeys(map(str, values)))
        return [names.index(str(each)) / max(len(names) - 1, 1) for each in values]
    numbers = np.array(values, dtype=float)
    if not np.isfinite(numbers).any():
        return [None] * len(values)
    low, high = np.nanmin(numbers), np.nanmax(numbers)
    return [plain_number(float(each)) for each in (numbers - low) / (high - low if high > low else 1.0)]


def _end(values: Sequence[Any], end: Any) -> str:
    """Smallest or largest of the values that are numbers; of text the first or last in the alphabet."""
    numbers = [each for each in values if isinstance(each, int | float) and each == each]
    return level_text(end(numbers), 3) if numbers else end(map(str, values), default="")


def _color(share: float | None) -> str:
    """Color from blue to orange at a share of a range; gray without a number."""
    if share is None:
        return "#999999"
    low, high = ([int(color[k : k + 2], 16) for k in (1, 3, 5)] for color in (COLORS[0], COLORS[4]))
    return "#" + "".join(f"{round(a + share * (b - a)):02x}" for a, b in zip(low, high, strict=True))


# Scatter matrix

MATRIX_CELL = 150
"""Height of a row of the scatter matrix [pixels]."""


def scatter_matrix(table: ShownTable) -> Plot | None:
    """Each parameter and quantity against each other; None for two, which the plots of effects show."""
    rows = usable_rows(table)
    if len(table.parameters) + len(table.quantities) <= 2:
        return None
    dimensions = [
        {
            "label": in_lines(table.parameter_label(name)),
            "values": [plain_number(table.value(row, name)) for row in rows],
        }
        for name in table.parameters
    ] + [
        {
            "label": in_lines(table.label(name)),
            "values": [plain_number(table.mean(row, name)) for row in rows],
        }
        for name in table.quantities
    ]
    data = {
        "type": "splom",
        "dimensions": dimensions,
        "text": [hover(row, table) for row in rows],
        "hoverinfo": "text",
        "marker": {"color": COLORS[0], "size": 4, "opacity": 0.7},
        "diagonal": {"visible": False},
        "showupperhalf": False,
    }
    look = layout(MATRIX_CELL * len(dimensions) + 110)
    look |= {"margin": look["margin"] | {"b": 100}, "font": look["font"] | {"size": 10}}
    for k, (name, dimension) in enumerate(
        zip((*table.parameters, *table.quantities), dimensions, strict=True)
    ):
        title = {
            "text": dimension["label"],
            "standoff": STANDOFF,
        }  # with a standoff, all lines are outside the ticks
        for along in "xy":
            look[f"{along}axis{k + 1 if k else ''}"] = {
                "automargin": True,
                "title": title,
                **_scale(table, name),
            }
    return Plot("All parameters and quantities against each other", {"data": [data], "layout": look})


def in_lines(text: str, width: int = 14) -> str:
    """A label in lines of up to `width` characters, which end at a dot, an underline or before a unit."""
    lines = [""]
    for part in re.split(r"(?<=[._])|(?= \[)", text):
        if len(lines[-1] + part) > width and lines[-1]:
            lines.append("")
        lines[-1] += part
    return "<br>".join(line.strip() for line in lines)


# Sobol indices of a sweep with Saltelli's design, by SALib

RESAMPLES = 1000
"""Bootstrap samples for the confidence intervals."""


class SobolIndices(NamedTuple):
    """Indices of one quantity, each (parameters,), with the half widths of their 95 % confidence intervals.

    `first`: share of the variance that each parameter explains alone; `total`: share including its
    interactions.
    """

    quantity: str
    first: np.ndarray
    first_interval: np.ndarray
    total: np.ndarray
    total_interval: np.ndarray


def sobol_indices(sweep: SweepInput, table: SweepTable) -> tuple[list[SobolIndices], str]:
    """First-order and total Sobol indices of each quantity, and a sentence if some are missing.

    Neither for other samplings than Saltelli's design.

    (I. M. Sobol, Math. Comput. Simul. 55 (2001) 271; A. Saltelli et al., Comput. Phys. Commun. 181 (2010)
    259.)
    """
    if not isinstance(sweep.sampling, SobolSampling):
        return [], ""
    try:
        from SALib.analyze import sobol
    except ImportError:
        return [], "Sobol indices require SALib, which is not installed: pip install SALib"
    problem = {"num_vars": len(table.parameters), "names": list(table.parameters)}
    found = []
    missing = []
    for name in table.quantities:
        values = np.array([row.mean(name) for row in table.rows])
        if not np.isfinite(values).all():
            missing.append(
                f"{name} is missing at {int((~np.isfinite(values)).sum())} of {len(values)} points."
            )
        elif values.std() == 0.0:
            missing.append(f"{name} is the same at all points.")
        else:
            indices = sobol.analyze(
                problem, values, calc_second_order=False, num_resamples=RESAMPLES, seed=sweep.sampling.seed
            )
            found.append(
                SobolIndices(name, *(np.asarray(indices[key]) for key in ("S1", "S1_conf", "ST", "ST_conf")))
            )
    return found, " ".join(missing)


def sobol_plot(table: ShownTable, indices: SobolIndices) -> Plot:
    """First-order and total indices of one quantity, with their 95 % confidence intervals."""
    names = [table.short_name(name) for name in table.parameters]
    bars = (
        ("first order", indices.first, indices.first_interval),
        ("total", indices.total, indices.total_interval),
    )
    data = [
        {
            "type": "bar",
            "name": name,
            "x": names,
            "y": [plain_number(float(v)) for v in values],
            "error_y": {"type": "data", "array": [plain_number(float(v)) for v in interval]},
            "marker": {"color": COLORS[k]},
        }
        for k, (name, values, interval) in enumerate(bars)
    ]
    caption = f"Sobol indices of {table.label(indices.quantity)} with 95 % confidence intervals"
    axes = {"xaxis": axis(""), "yaxis": axis("share of the variance")}
    return Plot(
        caption, {"data": data, "layout": layout(HEIGHT, barmode="group", **axes) | {"showlegend": True}}
    )


# Time series of several runs in one plot; a menu selects the quantity, the legend the runs

MOST_RUNS = 60
"""Largest number of runs in the plot."""
MOST_COLUMNS = 12
"""Largest number of quantities in the menu."""
MOST_POINTS = 160
"""Largest number of points of a curve."""
SERIES_HEIGHT = 460
"""Height of the plot [pixels]."""


class NamedRun(NamedTuple):
    """A run in the plot: its name in the legend, its text at the pointer, and its directory."""

    name: str
    hover: str
    directory: Path


def series_overlay(runs: Sequence[NamedRun], first: Sequence[str], named_by: str) -> Plot | None:
    """Time series of the runs; None if none of them has rows.

    `first`: quantities that are shown first; the others follow in the order of the files; `named_by`: what
    the names of the runs contain. A click on a name in the legend hides a run, a double click shows only this
    run.
    """
    shown = runs[:: -(-len(runs) // MOST_RUNS)] if runs else ()
    found = {run: series for run in shown if (series := read_series(run.directory / "timeseries.csv"))}
    if not found:
        return None
    columns = _columns(list(found.values()), first)
    curves = {column.name: [_curve(series, column.name) for series in found.values()] for column in columns}
    data = [
        {
            "type": "scatter",
            "mode": "lines",
            "name": run.name,
            "x": x,
            "y": y,
            "line": {"color": COLORS[k % len(COLORS)], "dash": DASHES[k // len(COLORS) % len(DASHES)]},
            "hovertext": run.hover,
            "hovertemplate": "%{y:.4~g}<br>%{hovertext}<extra></extra>",
        }
        for k, (run, (x, y)) in enumerate(zip(found, curves[columns[0].name], strict=True))
    ]
    menu = {
        "buttons": [_button(column, curves[column.name]) for column in columns],
        "x": 0,
        "xanchor": "left",
        "y": 1.16,
    }
    axes = {"xaxis": axis("time (s)"), "yaxis": axis(_title(columns[0]))}
    caption = (
        f"Time series of {len(found)} of {len(runs)} runs, named by {named_by}. The menu selects the "
        "quantity; a click in the legend hides a run, a double click shows only this run."
    )
    look = layout(SERIES_HEIGHT, updatemenus=[menu], **axes) | {"showlegend": True}
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
    return [plain_number(each) for each in time.tolist()], [plain_number(each) for each in values.tolist()]


def _button(column: SeriesColumn, curves: Sequence[tuple[list[Any], list[Any]]]) -> dict[str, Any]:
    """Entry of the menu: shows the curves of one column."""
    data = {"x": [x for x, _ in curves], "y": [y for _, y in curves]}
    return {
        "method": "update",
        "label": escaped(column.text),
        "args": [data, {"yaxis.title.text": _title(column)}],
    }


def _title(column: SeriesColumn) -> str:
    text = escaped(column.text)
    return f"{text} ({shown_unit(column.unit)[1]})" if column.unit else text


def _named_runs(table: ShownTable) -> list[NamedRun]:
    """The runs that have begun, named by their parameters and their seed."""
    found = []
    for row in table.rows:
        values = [level_text(table.value(row, name), 4) for name in table.parameters]
        texts = [
            f"{table.parameter_label(name)} = {value}"
            for name, value in zip(table.parameters, values, strict=True)
        ]
        for each in row.runs:
            if each.run is not None and each.run.directory.is_dir():
                seed = [str(each.run.seed)] if table.table.seed_count > 1 else []
                hover = [*texts, *(f"seed = {number}" for number in seed), f"runs/{each.run.directory.name}"]
                found.append(NamedRun(", ".join(values + seed), "<br>".join(hover), each.run.directory))
    return found


def _named_by(table: ShownTable) -> str:
    """What the names of the runs contain."""
    return ", ".join([*map(table.parameter_label, table.parameters), *["seed"][: table.table.seed_count - 1]])


# The table of all points


def _points(table: ShownTable) -> PageTable:
    """All points: parameters, status, quantities with standard errors, run directories, reasons and warnings
    if any."""
    rows = []
    for row in table.rows:
        values = [level_text(table.value(row, name)) for name in table.parameters]
        numbers = [
            with_error(table.mean(row, name), table.standard_error(row, name)) for name in table.quantities
        ]
        ends = (" ".join(row.directories), row.outcome.reason, row.warnings)
        rows.append([*values, row.outcome.status, *numbers, *ends])
    parameters = map(table.parameter_label, table.parameters)
    quantities = map(table.label, table.quantities)
    return without_empty_ends([*parameters, "status", *quantities, "runs", "reason", "warnings"], rows)


FIXED_POINT = (1e-4, 1e3)
"""Standard errors between these bounds are written without an exponent."""


def with_error(value: float, error: float) -> str:
    """A number and its standard error with two digits, if there is one: 19.1 ± 4.1.

    A value that is not a number is a dash.
    """
    if value != value:
        return "–"
    if error != error:
        return f"{value:.5g}"
    if not 0.0 < error < inf or not abs(value) < inf:
        return f"{value:.5g} ± {error:.2g}"
    last = floor(log10(error)) - 1  # power of ten of the last digit
    if FIXED_POINT[0] <= error < FIXED_POINT[1]:
        return " ± ".join(f"{round(each, -last):.{max(-last, 0)}f}" for each in (value, error))
    digits = max(floor(log10(abs(value) or error)) - last, 0)
    return f"{value:.{digits}e} ± {error:.1e}"
