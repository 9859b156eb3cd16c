"""Files of `granflow plot`: an image by matplotlib, or a page with interactive plots by plotly."""

import ast
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from granflow.errors import GranflowError
from granflow.io.tables import (
    STAGE,
    TIME,
    CollisionTable,
    SeriesColumn,
    Table,
    TimeSeriesTable,
    collision_table,
    has_collisions,
    is_number,
    read_table,
    series_in,
    table_of_run,
)
from granflow.schema.messages import suggestion_sentence
from granflow.studies.figures import COLORS, FULL_WIDTH, draw_to, stacked_panels
from granflow.studies.interactive_plots import (
    DASHES,
    Plot,
    common_title,
    curve_layout,
    escaped,
    level_text,
    library,
    plain_numbers,
    short_names,
    thinned,
)
from granflow.studies.page import write_page
from granflow.units import UnitError, column_factor, factor_of, si_unit_of, split_heading
from granflow.visible_text import distinct_endings, numbered, visible

# Columns of a time series, and arithmetic expressions of them, such as `wall_displacement.lid / 0.1`.

OPERATORS: Mapping[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
"""Operators of an expression."""
FUNCTIONS: Mapping[str, Callable[[Any], Any]] = {"abs": np.abs, "sqrt": np.sqrt, "log": np.log, "exp": np.exp}
"""Functions of an expression."""
WORD = re.compile(r"(?<![\w.])[A-Za-z_][\w.]*")
"""Names in an expression: of functions, and of columns with the part after the dot."""


def quantity_of(series: TimeSeriesTable, text: str, source: str) -> SeriesColumn:
    """The column `text` of a series or, if there is none, the value of the expression `text`, which has no
    unit.

    `source`: file for messages. Angles are converted to degrees. Raises GranflowError for an unknown name or
    an expression that is not arithmetic.
    """
    columns = {TIME: SeriesColumn(TIME, "s", series.time)} | {each.name: each for each in series.columns}
    if text in columns:
        column = columns[text]
        if column.unit == "rad":
            with np.errstate(over="ignore"):
                return SeriesColumn(column.name, "deg", np.degrees(column.values))
        return column
    return SeriesColumn(text, "", _value(columns, text, source))


def _value(columns: Mapping[str, SeriesColumn], text: str, source: str) -> np.ndarray:
    """Value (n,) of an expression of columns in the units of the file."""
    # Column names contain dots and other characters that Python does not permit in a name: the longest come
    # first.
    known = sorted(columns, key=len, reverse=True)
    pattern = re.compile("|".join(rf"(?<![\w.]){re.escape(name)}(?![\w.])" for name in known))
    for word in WORD.findall(
        pattern.sub(" ", text)
    ):  # before the columns are replaced: `_0` is no name of the user
        if word not in FUNCTIONS:
            raise GranflowError(
                f"{source} has no column {word}. {suggestion_sentence(word, columns, 'columns')}"
            )
    coded = pattern.sub(lambda found: f"_{known.index(found[0])}", text)
    try:
        if not coded.isascii():  # Python reads full-width letters as plain ones
            raise ValueError
        tree = ast.parse(coded.strip(), mode="eval").body
        with np.errstate(all="ignore"):
            found = _evaluated(tree, [columns[name].values for name in known])
    except (SyntaxError, ValueError, RecursionError, MemoryError, OverflowError):
        raise GranflowError(
            f"'{text}' is neither a column of {source} nor an arithmetic expression of its columns; "
            "write for example 'wall_displacement.lid / 0.1'."
        ) from None
    return np.broadcast_to(np.asarray(found, dtype=float), columns[TIME].values.shape)


def _evaluated(node: ast.expr, values: list[np.ndarray]) -> Any:
    """Value of a syntax tree; names are `_K` for the K-th of `values`.

    Raises ValueError for what is not arithmetic.
    """
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return np.float64(
                number
            )  # unlike float: x / 0 is infinite, and the root of a negative number is nan
        case ast.Name(id=name) if name not in FUNCTIONS:
            return values[int(name[1:])]
        case ast.UnaryOp(op=sign, operand=operand) if type(sign) in OPERATORS:
            return OPERATORS[type(sign)](_evaluated(operand, values))
        case ast.BinOp(left=left, op=sign, right=right) if type(sign) in OPERATORS:
            return OPERATORS[type(sign)](_evaluated(left, values), _evaluated(right, values))
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in FUNCTIONS:
            return FUNCTIONS[name](_evaluated(argument, values))
    raise ValueError


# Sources of `granflow plot`: time series, and the counts of collisions over time or over their energy.

ENERGIES = ("energy", "energy_min", "energy_max")
"""Columns [J] of the classes of collisions; one of them on the horizontal axis selects the distribution at
the end."""
_BEGUN = re.compile(r"[-+]|[-+]?([0-9]*\.?[0-9]*(?<=[0-9.])(e[-+]?)?|n|na|i|in)", re.IGNORECASE)
"""Beginning of a number that is not a number yet, such as 1.5e-."""


def series_of(source: Path, x: str) -> tuple[Path, TimeSeriesTable]:
    """File and columns of the directory of a run, or of a CSV file with a column `time` or with counts of
    collisions.

    Numbers are converted to SI by the units in the header; a unit that is not known remains. `x`: quantity of
    the horizontal axis. The last line may be incomplete if it does not end with a newline: a run writes it.
    Raises GranflowError if there is no such file, if it has neither rows nor known columns, if the header is
    damaged, if a row has another number of cells or a cell that is not a number, or if the unit of the times
    is not one of time.
    """
    path = source / "timeseries.csv" if source.is_dir() else source
    if not path.exists():
        reason = f"{source} contains no timeseries.csv" if source.is_dir() else f"{source} does not exist"
        raise GranflowError(
            f"{reason}; give the directory of a run, such as out/hopper, or a CSV file with times."
        )
    table = table_of_run(path)
    if table is not None:
        _refuse_damaged_header(table, path)
        table = _without_begun_number(table)
        _refuse_damaged_rows(table, path)
    series = None if table is None else _series_in(table, x, path)
    if series is None:
        raise GranflowError(_reason(path, table))
    return path, series


def _refuse_damaged_header(table: Table, path: Path) -> None:
    """Raise GranflowError for brackets not in pairs, another separator, and a time that does not end with its
    unit."""
    names = table.names
    reason = ""
    separators = [word for mark, word in ((";", "semicolons"), ("\t", "tabs")) if mark in names[0]]
    for name in names:
        unpaired = [pair for pair in ("[]", "()") if name.count(pair[0]) != name.count(pair[1])]
        if len(names) == 1 and separators:
            reason = f"its columns are separated by {separators[0]}"
        elif unpaired:
            reason = f"'{name}' has only one of the brackets {unpaired[0]}"
        elif name.partition("[")[0].strip() == TIME != split_heading(name)[0]:
            reason = f"'{name}' does not end with its unit"
        if reason:
            raise GranflowError(
                f"{path}:{table.heading_line}: the header '{','.join(names)}' cannot be read: {reason}; "
                "separate the columns by commas and give their units in brackets, such as time [s],mass [kg]."
            )


def _without_begun_number(table: Table) -> Table:
    """The table without what another program is still writing: a short last row, or a last cell such as
    1.5e-."""
    if table.is_terminated or not table.rows:
        return table
    line, cells = table.rows[-1]
    if len(cells) < len(table.names):
        return replace(table, rows=table.rows[:-1])
    if is_number(cells[-1]) or not _BEGUN.fullmatch(cells[-1]):
        return table
    return replace(table, rows=(*table.rows[:-1], (line, [*cells[:-1], ""])))


def _refuse_damaged_rows(table: Table, path: Path) -> None:
    """Raise GranflowError for the first row of another length, or with a cell in place of a number that is
    none.

    A run leaves cells empty that have no value, except the time. A column without a unit and without numbers
    is text.
    """
    width = len(table.names)
    problems = [
        (
            line,
            f"the row '{','.join(cells)[:80]}' has {numbered(len(cells), 'value')}, but the header has "
            f"{width}.",
        )
        for line, cells in table.rows
        if len(cells) != width
    ]
    complete = table.complete()
    for index, heading in enumerate(table.names):
        name, unit = split_heading(heading)
        if name in (STAGE, "contact"):
            continue
        wrong = np.flatnonzero(np.isnan(complete.numbers(index)))
        cells = [(complete.rows[k][0], complete.rows[k][1][index]) for k in wrong]
        if name == TIME or unit or len(cells) < len(complete.rows):
            problems += [
                (line, f"{heading} is {cell[:80] or 'empty'}, but a number is expected.")
                for line, cell in cells
                if not is_number(cell) and (cell or name == TIME)
            ]
    if problems:
        line, problem = min(problems)
        raise GranflowError(f"{path}:{line}: {problem}")


def _series_in(table: Table, x: str, path: Path) -> TimeSeriesTable | None:
    """The columns of a table; None without rows or known columns."""
    if not has_collisions(table.names):
        return _in_si(table, path)
    collisions = collision_table(table)
    if collisions is None:
        return None
    return _distribution(collisions) if set(WORD.findall(x)) & set(ENERGIES) else _history(collisions)


def _in_si(table: Table, path: Path) -> TimeSeriesTable | None:
    """The columns of a table of time series [SI]; None without rows or a column of times."""
    headings = [split_heading(name) for name in table.names]
    named = tuple(f"{name} [{unit}]" if unit else name for name, unit in headings)
    series = series_in(replace(table, names=named))
    if series is None:
        return None
    try:
        seconds = column_factor(dict(headings)[TIME], "s")
    except UnitError as error:
        raise GranflowError(f"{path}:{table.heading_line}: the column time is in s, and {error}.") from None
    stages = tuple((seconds * time, name) for time, name in series.stages)
    return TimeSeriesTable(
        seconds * series.time, series.stage, tuple(map(_column_in_si, series.columns)), stages
    )


def _column_in_si(column: SeriesColumn) -> SeriesColumn:
    """A column in the SI unit; unchanged if its unit is unknown, or one of several dimensions, such as g."""
    try:
        factor = factor_of(column.unit, "any")
    except UnitError:
        return column
    return SeriesColumn(column.name, si_unit_of(column.unit), column.values * factor)


def _reason(path: Path, table: Table | None) -> str:
    """Sentence on a file without rows or with unknown columns."""
    names = [] if table is None else [split_heading(name)[0] for name in table.names]
    if TIME in names or has_collisions(() if table is None else table.names):
        return f"{path} has no complete rows yet."
    return (
        f"{path} has neither a column time nor the columns of collision_energies.csv; its columns are: "
        f"{', '.join(names) or 'none'}."
    )


def _history(collisions: CollisionTable) -> TimeSeriesTable:
    """Numbers over time: of all collisions of a kind of contact, and by class."""
    low_high = [f"{low:.4g}_to_{high:.4g}_J" for low, high in collisions.edges]
    columns = []
    for quantity, numbers in _numbers(collisions):
        for kind, values in numbers.items():
            columns.append(SeriesColumn(f"{quantity}.{kind}", "", values.sum(axis=1)))
            columns += [
                SeriesColumn(f"{quantity}.{kind}_{name}", "", values[:, k]) for k, name in enumerate(low_high)
            ]
    return _table(collisions.time, columns)


def _distribution(collisions: CollisionTable) -> TimeSeriesTable:
    """Numbers over the energy of the classes: in the last interval, and since the start of the run."""
    energies = (collisions.energy, *collisions.edges.T)
    columns = [SeriesColumn(name, "J", values) for name, values in zip(ENERGIES, energies, strict=True)]
    columns += [
        SeriesColumn(f"{quantity}.{kind}", "", values[-1])
        for quantity, numbers in _numbers(collisions)
        for kind, values in numbers.items()
    ]
    return _table(np.full(len(collisions.edges), collisions.time[-1]), columns)


def _numbers(collisions: CollisionTable) -> tuple[tuple[str, dict[str, np.ndarray]], ...]:
    return (("count", collisions.counts), ("count_total", collisions.totals))


def _table(time: np.ndarray, columns: list[SeriesColumn]) -> TimeSeriesTable:
    return TimeSeriesTable(time, np.full(len(time), ""), tuple(columns), ())


# Curves of `granflow plot`: the chosen columns of one or more runs, by panel.

MOST_CURVES = 18
"""Largest number of curves of a panel: nine colors with two line styles each."""
LARGEST = 1e250
"""Largest value that can be drawn: ranges and margins of axes, their products and powers must be finite
numbers."""


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

    `stages`: only rows of these stages; empty: all rows. Raises GranflowError for unknown columns or stages,
    for quantities without a finite value or with values above LARGEST, and for more curves than MOST_CURVES.
    """
    found = [series_of(source, x) for source in sources]
    names = legend_names(sources)
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
        _refuse_what_cannot_be_drawn(
            x, text, np.concatenate(points), found[0][0] if len(found) == 1 else None
        )
    largest = max(len(curves) for curves in panels.values())
    if largest > MOST_CURVES:
        raise GranflowError(
            f"{numbered(largest, 'curve')} are too many for one plot; choose at most {MOST_CURVES} with --y "
            "or fewer runs."
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
            f"'{y}' over '{x}' has no finite value in the selected rows of {path or 'any of the runs'}: "
            "there is nothing to draw. Choose another quantity, or other --stages."
        )
    for text, largest in zip((x, y), np.abs(points).max(axis=0), strict=True):
        if largest > LARGEST:
            raise GranflowError(
                f"Values of '{text}' reach {largest:.3g}, but at most {LARGEST:g} can be drawn: divide them, "
                f"such as '({text}) / {largest:.0e}'."
            )


def _panel(curves: Sequence[tuple[str, SeriesColumn, SeriesColumn]]) -> Panel:
    """Panel of curves, each with its name and its columns of x and y; all of one unit."""
    columns = [column for _, _, column in curves]
    title = (
        _label(columns[0]) if len({each.name for each in columns}) == 1 else common_title(columns) or "value"
    )
    found = tuple(Curve(name, horizontal.values, column.values) for name, horizontal, column in curves)
    return Panel(
        _with_unit(_label(curves[0][1]), curves[0][1].unit), _with_unit(title, columns[0].unit), found
    )


def legend_names(sources: Sequence[Path]) -> list[str]:
    """The varied values of runs of a sweep; otherwise the last parts of the paths, as few as make all
    different."""
    runs = [_varied_values(source) for source in sources]
    varied = [name for name in runs[0] if len({run.get(name) for run in runs}) > 1]
    short = short_names(varied)
    named = [", ".join(f"{short[name]} {run.get(name, '-')}" for name in varied) for run in runs]
    if all(runs) and len(set(named)) == len(named):
        return named
    return ["/".join(parts) for parts in distinct_endings([source.resolve().parts for source in sources])]


def _varied_values(source: Path) -> dict[str, str]:
    """Parameters and seed of a run of a sweep by name; empty for another run."""
    run = source.resolve()
    run = run.parent if run.is_file() else run
    path = run.parent.parent / "runs.csv"
    table = read_table(path) if path.exists() else None
    if table is None or not {"seed", "run"} <= set(table.names):
        return {}
    for _, cells in table.complete().rows:
        found = dict(zip(table.names, cells, strict=True))
        if found["run"] == run.name:
            names = table.names[: table.names.index("seed") + 1]
            return {name: level_text(_number_or_text(found[name]), 4) for name in names}
    return {}


def _number_or_text(cell: str) -> float | str:
    return float(cell) if is_number(cell) else cell


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


IMAGES = (".png", ".svg", ".pdf")
"""File types that matplotlib writes."""
PANEL_HEIGHT = 3.2
"""Height of a panel in an image [inch]."""
LINE_STYLES = ("-", "--")
"""Line styles of an image: one for each repetition of the colors."""


def default_path(source: Path, x: str, y: Sequence[str]) -> Path:
    """File for the plot of these quantities in the directory of the first source."""
    folder = source if source.is_dir() else source.parent
    name = re.sub(r"[^\w.]+", "_", f"{'_'.join(y)}_over_{x}").strip("_")
    return folder / f"plot_{name[:100]}.png"


def write_plot(path: Path, panels: Sequence[Panel], logarithmic: str, title: str) -> None:
    """Write the panels, one below the other, as an image or, if the file type is .html, as an interactive
    page.

    `logarithmic`: axes with a logarithmic scale: "", "x", "y" or "xy"; `title`: of a page.
    Raises GranflowError for another file type, for a logarithmic axis without positive values, or if the
    library is not installed.
    """
    if path.suffix not in (*IMAGES, ".html"):
        types = ", ".join((*IMAGES, ".html"))
        raise GranflowError(f"--out {path} is not of a supported type; the name must end in one of {types}.")
    for axis in logarithmic:
        _refuse_without_positive(panels, axis)
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".html":
        _write_page(path, panels, logarithmic, title)
    else:
        draw_to(
            path, lambda figure: _draw(figure, panels, logarithmic), PANEL_HEIGHT * len(panels), FULL_WIDTH
        )


def _refuse_without_positive(panels: Sequence[Panel], axis: str) -> None:
    """Raise GranflowError for a panel without a positive value along a logarithmic `axis`, x or y."""
    for panel in panels:
        values = np.concatenate([getattr(curve, axis) for curve in panel.curves])
        if not (values > 0.0).any():
            title = getattr(panel, f"{axis}_title")
            raise GranflowError(
                f"--log {axis} needs positive values, but {title} has none: omit --log {axis}."
            )


FEW_POINTS = 20
"""Number of points of a curve up to which each has a marker: stages or runs of a sweep, for example."""


def _draw(figure: Any, panels: Sequence[Panel], logarithmic: str) -> None:
    """Draw the panels on an empty matplotlib figure."""
    for panel, axes in zip(panels, stacked_panels(figure, len(panels), sharex=True), strict=True):
        for number, curve in enumerate(panel.curves):
            look = {"color": COLORS[number % len(COLORS)], "linestyle": LINE_STYLES[number // len(COLORS)]}
            point = {"marker": "o", "markersize": 3.0} if len(curve.x) <= FEW_POINTS else {}
            axes.plot(curve.x, curve.y, label=_without_formulas(curve.name), **look, **point)
        axes.set_xlabel(_without_formulas(panel.x_title))
        axes.tick_params(labelbottom=True)
        axes.set_ylabel(_without_formulas(panel.y_title))
        for axis in logarithmic:
            getattr(axes, f"set_{axis}scale")("log")
        if len(panel.curves) > 1:
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _without_formulas(text: str) -> str:
    """Text for matplotlib, which reads text between dollar signs as a formula."""
    return visible(text).replace("$", r"\$")


def _write_page(path: Path, panels: Sequence[Panel], logarithmic: str, title: str) -> None:
    """Write a page with an interactive plot for each panel."""
    script = library()
    if not script:
        raise GranflowError("Interactive plots require plotly, which is not installed: pip install plotly")
    plots = [_plot(panel, logarithmic) for panel in panels]
    if "x" not in logarithmic:
        _share_x(plots, np.concatenate([curve.x for panel in panels for curve in panel.curves]))
    write_page(path, "plot.html", plotly=script, title=title, plots=plots)


def _share_x(plots: Sequence[Plot], x: np.ndarray) -> None:
    """Give all plots the range of x, since curves may begin late or end early."""
    known = x[np.isfinite(x)]
    if len(known) and known.min() < known.max():
        for plot in plots:
            plot.figure["layout"]["xaxis"]["range"] = [float(known.min()), float(known.max())]


def _plot(panel: Panel, logarithmic: str) -> Plot:
    """A panel in the format of plotly."""
    data = []
    for number, curve in enumerate(panel.curves):
        known = np.isfinite(curve.x)
        x, y = thinned(curve.x[known], curve.y[known])
        color = COLORS[number % len(COLORS)]
        dash = DASHES[number // len(COLORS)]
        data.append(
            {
                "type": "scatter",
                "mode": "lines" if len(x) > FEW_POINTS else "lines+markers",
                "name": escaped(visible(curve.name)),
                "x": plain_numbers(x),
                "y": plain_numbers(y),
                "line": {"color": color, "width": 1.8, "dash": dash},
            }
        )
    x_title, y_title = escaped(visible(panel.x_title)), escaped(visible(panel.y_title))
    layout = curve_layout(x_title, y_title, len(data) > 1) | {"hovermode": "closest", "height": 460}
    for axis in logarithmic:
        layout[f"{axis}axis"]["type"] = "log"
    return Plot(f"{panel.y_title} over {panel.x_title}", {"data": data, "layout": layout})
