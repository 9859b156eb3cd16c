"""The page of a sweep: tables, interactive plots by plotly.express, and Sobol indices by SALib.

`write_sweep_page` puts the parts together; the functions below return them in the order of the page.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from math import floor, inf, log10
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granflow.io.files import replacing, write_text
from granflow.io.tables import read_series, write_table
from granflow.studies.figures import (
    COLORS,
    MARKERS,
    Drawing,
    PageTable,
    without_empty_ends,
    write_figures,
)
from granflow.studies.interactive_plots import (
    Plot,
    escaped,
    express_library,
    level_text,
    plot_of_figure,
    shown_unit,
    thinned,
)
from granflow.studies.page import SCREEN_WIDTH, page_text
from granflow.studies.sweep_design import Grid, SobolSampling, SweepInput
from granflow.studies.sweep_table import PointRow, ShownTable, SweepTable, shown
from granflow.studies.yield_locus import remarks_of, shown_table

PAGE = "sweep.html"
NO_LIBRARY = (
    "Plots require plotly and pandas, which are not installed: pip install plotly pandas, then repeat the "
    "command."
)


SOBOL = "sobol.csv"
"""Sobol indices of all quantities, with the half widths of their 95 % confidence intervals."""
FIGURE = "sweep.png"
"""Figure of all quantities over all parameters, with standard errors."""


def write_sweep_page(
    out: Path, sweep: SweepInput, table: SweepTable, figures: Mapping[str, Drawing] | None = None
) -> None:
    """Write `sweep.html`, FIGURE and, for a Sobol sampling, SOBOL to the directory of the sweep; without
    plotly, the page has tables only, and without matplotlib, there is no figure.

    `figures`: images of the evaluation in this directory, by file name.
    """
    script = express_library()
    found = shown(sweep, table)
    drawn = replace(found, in_plots=True)
    points = frame_of(drawn) if script else None
    has_plots = points is not None and len(points) > 0 and len(drawn.parameters) > 0
    indices, why_none = sobol_indices(sweep, table)
    text = page_text(
        "sweep.html",
        plotly=script,
        title=sweep.title or f"Sweep of {Path(sweep.scene).stem}",
        lead=sweep.description or f"{len(table.rows)} points of {sweep.scene}.",
        statuses=_statuses(table),
        folder=out,
        figures={name: SCREEN_WIDTH * each.width for name, each in (figures or {}).items()},
        loci=shown_table(table.loci),
        locus_remarks=remarks_of(table.loci),
        no_library="" if script else NO_LIBRARY,
        effects=[main_effects(drawn, points, each) for each in drawn.quantities] if has_plots else [],
        heat_maps=heat_maps(drawn, points) if has_plots and isinstance(sweep.sampling, Grid) else [],
        all_columns=all_columns(drawn, points) if has_plots else [],
        sobol=[sobol_plot(drawn, each) for each in indices if each.is_known] if script else [],
        sobol_numbers=sobol_table(found, indices),
        why_no_sobol=why_none,
        series=series_plots(drawn) if script else [],
        points=_points(found),
    )
    write_text(out / PAGE, text)
    if indices:
        columns = sobol_columns(table.parameters, indices)
        with replacing(out / SOBOL) as temporary:
            write_table(temporary, columns, zip(*columns.values(), strict=True))
    drawing = figure_of(found)
    if drawing is not None:
        write_figures(out, {FIGURE: drawing})


PANEL = (3.2, 2.4)
"""Width and height of a panel [inch]."""
MOST_PANELS = 6
"""Largest number of rows and of columns of panels: of quantities and of parameters."""


def figure_of(table: ShownTable) -> Drawing | None:
    """Each quantity over each parameter, with the standard errors of the means; None without any number, or
    without parameters."""
    rows = table.rows_with_numbers
    if not rows or not table.parameters:
        return None
    quantities = table.quantities[:MOST_PANELS]
    parameters = table.parameters[:MOST_PANELS]

    def draw(figure: Any) -> None:
        panels = figure.subplots(len(quantities), len(parameters), squeeze=False, sharex="col", sharey="row")
        for line, quantity in zip(panels, quantities, strict=True):
            for axes, parameter in zip(line, parameters, strict=True):
                _draw_panel(axes, table, rows, quantity, parameter)
            line[0].set_ylabel(table.label(quantity))
            means = np.array([table.mean(row, quantity) for row in rows])
            means = means[np.isfinite(means)]
            if len(means) and means.min() > 0.0 and means.max() > DECADES * means.min():
                line[0].set_yscale("log")
        for axes, parameter in zip(panels[-1], parameters, strict=True):
            axes.set_xlabel(table.parameter_label(parameter))

    return Drawing(draw, 0.4 + PANEL[1] * len(quantities), 0.5 + PANEL[0] * len(parameters))


DECADES = 100.0
"""Ratio of the largest to the smallest of positive values from which their axis is logarithmic."""


def _draw_panel(
    axes: Any, table: ShownTable, rows: Sequence[PointRow], quantity: str, parameter: str
) -> None:
    """Points of one quantity over one parameter with their standard errors; with two parameters, a line for
    each value of the other one, if these are at most as many as there are colors."""
    values = [table.value(row, parameter) for row in rows]
    is_number = all(isinstance(each, int | float) and not isinstance(each, bool) for each in values)
    levels = list(dict.fromkeys(map(level_text, values)))
    positions = np.array(values if is_number else [levels.index(level_text(each)) for each in values], float)
    means = np.array([table.mean(row, quantity) for row in rows])
    errors = np.array([table.standard_error(row, quantity) for row in rows])
    others = [name for name in table.parameters if name != parameter]
    groups = [level_text(table.value(row, others[0]), 4) if len(others) == 1 else "" for row in rows]
    names = list(dict.fromkeys(groups))
    if len(names) > len(COLORS):
        groups = [""] * len(rows)
        names = [""]
    for k, name in enumerate(names):
        chosen = np.flatnonzero([each == name for each in groups])
        chosen = chosen[np.argsort(positions[chosen], kind="stable")]
        is_curve = len(set(positions[chosen].tolist())) == len(chosen) and len(others) < 2
        style = {
            "marker": MARKERS[k % len(MARKERS)], "markersize": 4.0, "markerfacecolor": "white",
            "color": COLORS[k % len(COLORS)], "linestyle": "-" if is_curve and is_number else "none",
        }  # fmt: skip
        axes.errorbar(
            positions[chosen], means[chosen], np.nan_to_num(errors[chosen]), capsize=2.0, label=name, **style
        )
    if parameter in table.logarithmic:
        axes.set_xscale("log")
    if not is_number:
        axes.set_xticks(range(len(levels)), levels, rotation=30.0, ha="right")
        axes.set_xticks([], minor=True)
    if names != [""]:
        axes.legend(title=table.short_name(others[0]), title_fontsize="small")


def _statuses(table: SweepTable) -> PageTable:
    """Number of points with each status."""
    statuses = [row.outcome.status for row in table.rows]
    return PageTable(
        ("status", "points"), [(each, str(statuses.count(each))) for each in dict.fromkeys(statuses)]
    )


def frame_of(table: ShownTable) -> Any:
    """The points with at least one number as a pandas DataFrame: parameters, quantities, run directories."""
    import pandas

    rows = table.rows_with_numbers
    columns: dict[str, Any] = {
        table.parameter_label(name): [table.value(row, name) for row in rows] for name in table.parameters
    }
    columns |= {table.label(name): [table.mean(row, name) for row in rows] for name in table.quantities}
    return pandas.DataFrame({**columns, "runs": [" ".join(row.directories) for row in rows]})


MOST_LEVELS = 12
"""Largest number of values of a parameter with a mean of their own; more are combined in BINS intervals."""
BINS = 8


def main_effects(table: ShownTable, points: Any, quantity: str) -> Plot:
    """Points, and mean over all points with the same value of a parameter, one plot for each parameter."""
    import plotly.express as px
    from plotly.subplots import make_subplots

    label = table.label(quantity)
    figure = make_subplots(1, len(table.parameters), shared_yaxes=True)
    for k, name in enumerate(table.parameters, 1):
        each = table.parameter_label(name)
        means = mean_over(points, each, label, name in table.logarithmic)
        dots = px.scatter(
            points, x=each, y=label, opacity=0.6, hover_data=list(points), color_discrete_sequence=[COLORS[5]]
        )
        line = px.line(means, x=each, y=label, markers=True, color_discrete_sequence=[COLORS[0]])
        figure.add_traces([*dots.data, *line.data], 1, k)
        figure.update_xaxes(title_text=each, type="log" if name in table.logarithmic else "-", col=k)
    figure.update_yaxes(title_text=label, col=1)
    caption = (
        f"{label}: all points (light), and mean over all points with the same value of a parameter, or in "
        f"one of {BINS} equal intervals of it if it has more than {MOST_LEVELS} values (line)"
    )
    return plot_of_figure(caption, figure)


def mean_over(points: Any, parameter: str, quantity: str, logarithmic: bool) -> Any:
    """Mean of a quantity at each value of a parameter, or in each interval of it, as a DataFrame.

    logarithmic:  whether the intervals have equal ratios
    """
    import pandas

    values = points[parameter]
    is_number = pandas.api.types.is_numeric_dtype(values)
    if not is_number or values.nunique() <= MOST_LEVELS:
        return points.groupby(parameter, sort=is_number)[quantity].mean().reset_index()
    intervals = pandas.cut(np.log(values) if logarithmic else values, BINS)
    return points[[parameter, quantity]].groupby(intervals, observed=True).mean()


MOST_HEAT_MAPS = 6
"""Largest number of pairs of parameters with a heat map for each quantity."""


def heat_maps(table: ShownTable, points: Any) -> list[Plot]:
    """Each quantity over each two parameters of a grid, averaged over the other parameters."""
    import plotly.express as px

    labels = [table.parameter_label(name) for name in table.parameters]
    shown = points.assign(**{each: points[each].map(level_text) for each in labels})
    found = []
    for quantity in map(table.label, table.quantities):
        for first, second in list(combinations(labels, 2))[:MOST_HEAT_MAPS]:
            if shown[first].nunique() * shown[second].nunique() > len(shown):
                continue  # parameters that vary together
            levels = {each: list(dict.fromkeys(shown[each])) for each in (first, second)}
            orders = {first: levels[first], second: levels[second][::-1]}  # of an axis y from its upper end
            figure = px.density_heatmap(
                shown, x=first, y=second, z=quantity, histfunc="avg", category_orders=orders
            )
            figure.update_xaxes(type="category")
            figure.update_yaxes(type="category")
            figure.update_coloraxes(colorbar_title={"text": quantity, "side": "right"})
            found.append(plot_of_figure(f"{quantity} over {first} and {second}", figure))
    return found


MATRIX_CELL = 150
"""Height of a row of the scatter matrix [pixels]."""


def all_columns(table: ShownTable, points: Any) -> list[Plot]:
    """Parallel coordinates of the columns with numbers, and each column against each other if there are more
    than two."""
    import plotly.express as px

    columns = list(points)[:-1]
    color = table.label(table.quantities[0])
    numbers = [each for each in columns if points[each].dtype.kind == "f" or points[each].dtype.kind == "i"]
    known = points.dropna(subset=[color])
    found = []
    if len(numbers) > 1 and len(known):
        lines = px.parallel_coordinates(known, dimensions=numbers, color=color)
        caption = f"Each line is a point, colored by {color}; drag along an axis to select lines"
        found.append(plot_of_figure(caption, lines, margin={"l": 90, "r": 20, "t": 60, "b": 30}))
    if len(columns) > 2:
        matrix = px.scatter_matrix(points, dimensions=columns, opacity=0.7, hover_data=list(points))
        matrix.update_traces(diagonal_visible=False, showupperhalf=False, marker_size=4)
        logarithmic = {table.parameter_label(name) for name in table.logarithmic}
        for k, each in enumerate(columns, 1):
            look = {"automargin": True, "type": "log" if each in logarithmic else "-"}
            matrix.update_layout({f"xaxis{k}": look, f"yaxis{k}": look})
        caption = "All parameters and quantities against each other"
        height = MATRIX_CELL * len(columns) + 110
        found.append(plot_of_figure(caption, matrix, height, font_size=10))
    return found


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

    @property
    def largest_interval(self) -> float:
        """The largest half width."""
        return float(np.max([self.first_interval, self.total_interval]))

    @property
    def is_known(self) -> bool:
        """Whether the intervals are smaller than the range of an index, which is a share."""
        return self.largest_interval < 1.0


WIDE = 0.3
"""Half width of an interval from which a sentence says that the samples are few."""


def sobol_indices(sweep: SweepInput, table: SweepTable) -> tuple[list[SobolIndices], str]:
    """First-order and total Sobol indices of each quantity, and sentences if some are missing or have wide
    intervals.

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
    missing += [
        f"The Sobol indices of {each.quantity} have 95 % intervals of up to +-{each.largest_interval:.2g}, "
        f"but are shares between 0 and 1: {sweep.sampling.count} base samples are too few. Raise "
        "sampling.count, for example to 64 or more."
        for each in found
        if each.largest_interval > WIDE
    ]
    return found, " ".join(missing)


def sobol_columns(parameters: Sequence[str], indices: Sequence[SobolIndices]) -> dict[str, list[Any]]:
    """Columns of SOBOL: a row for each quantity and parameter."""
    columns: dict[str, list[Any]] = {
        "quantity": [each.quantity for each in indices for _ in parameters],
        "parameter": [*parameters] * len(indices),
    }
    for name in ("first", "first_interval", "total", "total_interval"):
        columns[name] = [float(value) for each in indices for value in getattr(each, name)]
    return columns


def sobol_table(table: ShownTable, indices: Sequence[SobolIndices]) -> PageTable:
    """The indices as a table of the page."""
    rows = [
        (table.label(each.quantity), table.short_name(name), *(f"{number:.2f}" for number in numbers))
        for each in indices
        for name, *numbers in zip(table.parameters, *each[1:], strict=True)
    ]
    return PageTable(("quantity", "parameter", "first order", "+-", "total", "+-"), rows)


def sobol_plot(table: ShownTable, indices: SobolIndices) -> Plot:
    """First-order and total indices of one quantity, with their 95 % confidence intervals."""
    import pandas
    import plotly.express as px

    names = [table.short_name(name) for name in table.parameters]
    bars = {
        "parameter": 2 * names,
        "share of the variance": [*indices.first, *indices.total],
        "interval": [*indices.first_interval, *indices.total_interval],
        "index": len(names) * ["first order"] + len(names) * ["total"],
    }
    figure = px.bar(
        pandas.DataFrame(bars), x="parameter", y="share of the variance", error_y="interval", color="index",
        barmode="group",
    )  # fmt: skip
    caption = f"Sobol indices of {table.label(indices.quantity)} with 95 % confidence intervals"
    return plot_of_figure(caption, figure, showlegend=True)


# Time series of several runs

MOST_RUNS = 60
"""Largest number of runs in a plot."""
MOST_SERIES = 6
"""Largest number of quantities with a plot."""
MOST_POINTS = 160
"""Largest number of points of a curve."""
SERIES_HEIGHT = 460
"""Height of a plot [pixels]."""


def series_plots(table: ShownTable) -> list[Plot]:
    """Time series of the runs, one plot for each common column, first those that the sweep reads.

    A click on a name in the legend hides a run, a double click shows only this run.
    """
    import pandas
    import plotly.express as px

    runs = _named_runs(table)
    shown = runs[:: -(-len(runs) // MOST_RUNS)] if runs else ()
    found = {
        name: series for name, directory in shown if (series := read_series(directory / "timeseries.csv"))
    }
    if not found:
        return []
    common = set.intersection(*({column.name for column in series.columns} for series in found.values()))
    columns = [column for column in next(iter(found.values())).columns if column.name in common]
    places = {name: place for place, name in enumerate(table.quantities)}
    columns.sort(key=lambda column: places.get(column.name, len(places)))
    named_by = ", ".join(
        [*map(table.parameter_label, table.parameters), *["seed"][: table.table.seed_count - 1]]
    )
    plots = []
    for column in columns[:MOST_SERIES]:
        factor, unit = shown_unit(column.unit)
        label = escaped(column.text) + (f" ({unit})" if unit else "")
        parts = []
        for name, series in found.items():
            values = next(each.values for each in series.columns if each.name == column.name)
            time, thin = thinned(series.time, factor * values, MOST_POINTS)
            parts.append(pandas.DataFrame({"time (s)": time, label: thin, "run": name}))
        figure = px.line(pandas.concat(parts), x="time (s)", y=label, color="run", render_mode="svg")
        caption = (
            f"{label} of {len(found)} of {len(runs)} runs, named by {named_by}; a click in the legend hides "
            "a run, a double click shows only this run"
        )
        plots.append(plot_of_figure(caption, figure, SERIES_HEIGHT, showlegend=True))
    return plots


def _named_runs(table: ShownTable) -> list[tuple[str, Path]]:
    """The runs that have begun: their name, made of parameters and seed, and directory."""
    found = []
    for row in table.rows:
        values = [level_text(table.value(row, name), 4) for name in table.parameters]
        for run in (each.run for each in row.runs if each.run is not None and each.run.directory.is_dir()):
            seed = [str(run.seed)] if table.table.seed_count > 1 else []
            found.append((", ".join(values + seed), run.directory))
    return found


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
