"""Sections of the page on quantities: those that the scene expects, then metrics, flow, walls, energies and others."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from granflow import Run
from granflow.fields import (
    ENERGY_BUDGET_QUANTITIES,
    FLOW_METER_QUANTITIES,
    METRIC_QUANTITIES,
    TOTAL_QUANTITIES,
    WALL_FORCE_QUANTITIES,
    unit_of,
)
from granflow.io.time_series import SeriesColumn, TimeSeriesTable
from granflow.studies.report.plots import Plot, plot_of
from granflow.studies.report.series import groups_of, largest_of, negligible_columns
from granflow.studies.tables import PageTable
from granflow.visible_text import in_degrees, readable

NO_LIBRARY = "Plots require plotly, which is not installed: pip install plotly, then granflow report again."


class Topic(NamedTuple):
    """Section of quantities over time; `folded` is shown after a click."""

    title: str
    tables: Sequence[PageTable]
    sentences: Sequence[str]
    plots: Sequence[Plot]
    folded: Sequence[PageTable] = ()


class Readings(NamedTuple):
    """Topic of metrics, flow meters or walls: its quantities, its key in result.json, and the caption of its table."""

    quantities: Iterable[str]
    key: str
    caption: str


METRIC_CAPTION = "Metrics of the bed at the end of the run."
FLOW_CAPTION = "Flow meters at the end of the run; the mass flow rate is the steady one."
FORCE_CAPTION = (
    "Forces of the particles on the walls: means over the last stage, and the largest value of a row in the run."
)
EXPECTED, FORCES, ENERGIES, OTHERS = "Expectations", "Wall forces", "Energy budget", "Over time"
READINGS = {
    "Metrics": Readings(METRIC_QUANTITIES, "metrics", METRIC_CAPTION),
    "Flow": Readings(FLOW_METER_QUANTITIES, "flow_meters", FLOW_CAPTION),
    FORCES: Readings(WALL_FORCE_QUANTITIES, "wall_forces", FORCE_CAPTION),
}
"""Topics with one part, such as a metric, a flow meter or a wall, per row, by title."""

MOST_COLUMNS = 8
"""Largest number of quantities of flow meters or walls that are columns of a table."""

NEGLIGIBLE = 1e-15
"""Share of its largest value in the run below which a quantity is rounding, and shown as 0."""

SMALL = 0.01
"""Share of the largest force or torque of the run below which a component is folded."""


def expected_topic(record: Run, with_plots: bool) -> Topic:
    """Expectations of the scene, their results, and plots of the expected quantities.

    Counts and ratios of the whole run, such as `particle_count` and `energy_error`, have no plot here.
    """
    rows = [
        ("\N{CHECK MARK} satisfied" if entry["met"] else "\N{BALLOT X} not satisfied", entry["sentence"])
        for entry in record.result_sections.get("expect", ())
    ]
    table = PageTable(("", "result"), rows, "Expectations of the scene (expect).")
    columns = [each for each in _expected_columns(record) if not is_zero(each)]
    plots = [plot_of(group, record.series) for group in groups_of(columns)] if record.series and with_plots else []
    return Topic(EXPECTED, [table] if rows else [], [], plots)


def _expected_columns(record: Run) -> list[SeriesColumn]:
    """Columns of expected quantities with a unit or a part, in the order of the scene."""
    if record.series is None or record.scene_problem:
        return []
    columns = {column.name: column for column in record.series.columns}
    names = dict.fromkeys(expectation.quantity for expectation in record.scene.expect)
    return [columns[name] for name in names if name in columns and (columns[name].unit or "." in name)]


def is_zero(column: SeriesColumn) -> bool:
    """Whether a column is zero or nan in every row."""
    return not np.nan_to_num(column.values).any()


def topic_of(column: SeriesColumn, has_budget: bool = True) -> str:
    """Title of the topic of a column; energies have their own only in a run with an energy budget."""
    quantity, _, part = column.name.partition(".")
    topics = (title for title, readings in READINGS.items() if part and quantity in readings.quantities)
    is_energy = has_budget and (column.unit == "J" or quantity.startswith("energy"))
    return next(topics, ENERGIES if is_energy else OTHERS)


def topics(record: Run, with_plots: bool) -> Iterator[Topic]:
    """Sections of metrics, flow, wall forces, energy budget, and all other quantities over time.

    Columns of zeros are listed instead of plotted, a plot of expected quantities only is not repeated, and small
    components of forces and torques are folded. Without an energy budget, energies are among the other quantities.
    `with_plots`: whether the plot library is available.
    """
    series = record.series
    if series is None:
        yield Topic(OTHERS, (), ["The run has written no rows of timeseries.csv yet."], ())
        return
    shown_before = {column.name for column in _expected_columns(record)}
    has_budget = any(column.name in ENERGY_BUDGET_QUANTITIES for column in series.columns)
    for title in (*READINGS, ENERGIES, OTHERS):
        columns = [each for each in _columns_of(title, series, has_budget) if not is_zero(each)]
        small = negligible_columns(_columns_of(FORCES, series), SMALL) if title == FORCES else []
        tables, folded = _folded(_tables(record, title, has_budget), small)
        groups = groups_of([each for each in columns if each not in small])
        groups = [group for group in groups if not {each.name for each in group.columns} <= shown_before]
        plots = [plot_of(group, series) for group in groups] if with_plots else []
        sentences = _sentences(record, title, bool(tables)) + ([NO_LIBRARY] if columns and not with_plots else [])
        if tables or sentences or plots:
            yield Topic(title, tables, sentences, plots, folded)


def _columns_of(title: str, series: TimeSeriesTable, has_budget: bool = True) -> list[SeriesColumn]:
    """Columns of a topic."""
    return [column for column in series.columns if topic_of(column, has_budget) == title]


def _tables(record: Run, title: str, has_budget: bool) -> list[PageTable]:
    """Tables of a topic."""
    if title in READINGS:
        return _readings(record, title)
    return _energy_budget(record.series.columns) if title == ENERGIES and has_budget and record.series else []


def _sentences(record: Run, title: str, has_table: bool) -> list[str]:
    """Sentences of a topic: the energy error, or the columns that are always zero."""
    error = record.result_sections.get("totals", {}).get("energy_error")
    if title == ENERGIES and has_table and error is not None:
        return [f"Energy error: {error:.3g} of the largest energy input."]
    zero_columns = [column.text for column in record.series.columns if is_zero(column)] if record.series else []
    return [f"Always zero: {', '.join(zero_columns)}."] if title == OTHERS and zero_columns else []


def _folded(tables: Sequence[PageTable], small: Sequence[SeriesColumn]) -> tuple[list[PageTable], list[PageTable]]:
    """The tables without rows of small columns, and a table of the largest values of those that are not zero.

    A row is removed if it is a quantity whose column is small for every wall.
    """
    names = {column.name for column in small}
    kept = []
    for table in tables:
        kept.append(table._replace(rows=[row for row in table.rows if not _is_small(row[0], table.heads[1:], names)]))
    caption = f"Components below {SMALL:.0%} of the largest force or torque of a row: largest absolute values."
    rows = [(column.text, f"{largest_of(column):.3g}", column.unit) for column in small if not is_zero(column)]
    return kept, [PageTable(("", "", ""), rows, caption)] if rows else []


def _is_small(head: str, parts: Sequence[str], small: set[str]) -> bool:
    """Whether the row of a quantity contains small columns only; `head`: its name with its unit."""
    quantity = head.partition(" (")[0].replace(" ", "_")
    return all(f"{quantity}.{part}" in small for part in parts)


def _readings(record: Run, title: str) -> list[PageTable]:
    """Final values of metrics, flow meters or walls; from the last row of the time series if there is no result."""
    readings, caption = record.result_sections.get(READINGS[title].key, {}), READINGS[title].caption
    if not readings and record.series is not None:
        caption = "The last row of timeseries.csv."
        for column in record.series.columns:
            quantity, _, part = column.name.partition(".")
            if topic_of(column) == title:
                readings.setdefault(part, {})[quantity] = float(column.values[-1])
    return [table_of(caption, readings)] if readings else []


def table_of(caption: str, parts: Mapping[str, Mapping[str, Any]]) -> PageTable:
    """Table with a row for each part, such as a flow meter or a wall, and a column for each quantity.

    With more than MOST_COLUMNS quantities and fewer parts, the rows are the quantities and the columns the parts.
    """
    names = list(dict.fromkeys(name for numbers in parts.values() for name in numbers))
    units = [unit_of(name + ".x") for name in names]
    heads = [name.replace("_", " ") + (f" ({unit})" if unit else "") for name, unit in zip(names, units, strict=True)]
    columns = list(zip(names, units, strict=True))
    rows = [[part, *(shown(numbers.get(name), unit) for name, unit in columns)] for part, numbers in parts.items()]
    if len(parts) < MOST_COLUMNS < len(names):
        return PageTable(["", *parts], list(zip(heads, *(row[1:] for row in rows), strict=True)), caption)
    return PageTable(["", *heads], rows, caption)


def shown(number: Any, unit: str = "") -> str:
    """A number as text, of an angle [rad] with degrees; another value as it is; empty for None."""
    if isinstance(number, int | float):
        return readable(number) + in_degrees(number, unit)
    return "" if number is None else str(number)


def _energy_budget(columns: Iterable[SeriesColumn]) -> list[PageTable]:
    """Each energy at the start and at the end, and its largest absolute value [J]; NEGLIGIBLE shares of it are 0."""
    rows = []
    for column in columns:
        if column.unit == "J" and not is_zero(column):
            known = TOTAL_QUANTITIES.get(column.name)
            values = column.values[np.isfinite(column.values)]
            numbers = (values[0], values[-1], max(values.max(), values.min(), key=abs))
            kept = (number if abs(number) > NEGLIGIBLE * abs(numbers[-1]) else 0.0 for number in numbers)
            rows.append([column.text, *(f"{number + 0.0:.4g}" for number in kept), known.meaning if known else ""])
    return [PageTable(("", "first", "last", "largest", "meaning"), rows, "Energies in J.")] if rows else []
