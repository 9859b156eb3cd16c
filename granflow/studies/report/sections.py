"""Content of the report page, each part from the files of the run; the page omits empty parts.

A run in progress or without a result has parts from its log and time series only.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from granflow import Run, explain, plan_for
from granflow.errors import GranflowError
from granflow.fields import (
    ENERGY_BUDGET_QUANTITIES,
    FLOW_METER_QUANTITIES,
    TOTAL_QUANTITIES,
    WALL_FORCE_QUANTITIES,
    unit_of,
)
from granflow.io.log_reader import explanation, sessions, warnings_and_errors
from granflow.io.time_series import SeriesColumn
from granflow.studies.report.plots import Plot, plot_of
from granflow.studies.report.series import groups_of
from granflow.studies.tables import PageTable
from granflow.visible_text import in_degrees, readable

FROM_LOG = "From run.log."
NO_LIBRARY = "Plots require plotly, which is not installed: pip install granflow[plot], then granflow report again."


class Topic(NamedTuple):
    """Section of quantities over time."""

    title: str
    tables: Sequence[PageTable]
    sentences: Sequence[str]
    plots: Sequence[Plot]


class Readings(NamedTuple):
    """Topic of flow meters or walls: its quantities, its key in result.json, and the caption of its table."""

    quantities: Iterable[str]
    key: str
    caption: str


FLOW_CAPTION = "Flow meters at the end of the run; the mass flow rate is the steady one."
FORCE_CAPTION = (
    "Forces of the particles on the walls: means over the last stage, and the largest value of a row in the run."
)
READINGS = {
    "Flow": Readings(FLOW_METER_QUANTITIES, "flow_meters", FLOW_CAPTION),
    "Wall forces": Readings(WALL_FORCE_QUANTITIES, "wall_forces", FORCE_CAPTION),
}
"""Topics with one part, such as a flow meter or a wall, per row, by title."""

ENERGIES, OTHERS = "Energy budget", "Over time"
"""Titles of the other topics."""

SEPARATE = ("run", "timings", "expect", *(each.key for each in READINGS.values()))
"""Sections of result.json that the page shows separately."""

MOST_COLUMNS = 8
"""Largest number of quantities of flow meters or walls that are columns of a table."""

NEGLIGIBLE = 1e-15
"""Share of its largest value in the run below which a quantity is rounding, and shown as 0."""

ENDED_BY = "ended by "
"""Prefix of the log entry of an exception that ended a run."""

BAR_STEPS = 20
"""Length of the bar of the total wall-clock time, in blocks."""


def state_of(record: Run) -> str:
    """One sentence on how the run ended."""
    if record.is_running:
        return "The run is in progress; this page shows its present state."
    if record.result_sections:
        parts = len(sessions(record.log))
        resumed = f"; it was resumed ({parts} sessions)" if parts > 1 else ""
        if not record.result_sections.get("complete", True):
            return f"The run ended before its last stage{resumed}: granflow resume {record.directory} continues it."
        return f"The run is complete{resumed}."
    text = next((entry.text for entry in reversed(record.log) if entry.text.startswith(ENDED_BY)), "")
    why = f" ({ENDED_BY}{text.removeprefix(ENDED_BY).partition(':')[0]}: see the warnings)" if text else ""
    resume = f"granflow resume {record.directory} continues from its last checkpoint, if it has one."
    return f"The run did not finish{why}. {resume}"


def progress(record: Run) -> PageTable:
    """Simulated time, performance and particle counts."""
    numbers = dict(record.result_sections.get("run", {}))
    if record.time is not None:
        numbers = {"simulated_time": record.time} | numbers
    totals = record.result_sections.get("totals", {})
    numbers |= {name: totals.get(name) for name in ("particle_count", "inserted_count")}
    rows = [row for row in map(_number_row, numbers.items()) if row[1]]
    return PageTable(("", "", ""), rows, "Progress and performance.")


def _number_row(item: tuple[str, Any]) -> tuple[str, str, str]:
    """Name, number and unit."""
    name, number = item
    unit = unit_of(name)
    return name.replace("_", " "), _shown(number), unit + (in_degrees(number, unit) if number is not None else "")


def _shown(number: Any, unit: str = "") -> str:
    """A number as text, of an angle [rad] with degrees; another value as it is; empty for None."""
    if isinstance(number, int | float):
        return readable(number) + in_degrees(number, unit)
    return "" if number is None else str(number)


def expectations(record: Run) -> PageTable:
    """Expectations of the scene and their results."""
    rows = [
        ("\N{CHECK MARK} satisfied" if entry["met"] else "\N{BALLOT X} not satisfied", entry["sentence"])
        for entry in record.result_sections.get("expect", ())
    ]
    return PageTable(("", "result"), rows, "Expectations of the scene (expect).")


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
    """Sections of flow, wall forces, energy budget, and all other quantities over time.

    Columns of zeros are listed instead of plotted. Without an energy budget, energies are among the other quantities.
    `with_plots`: whether the plot library is available.
    """
    series = record.series
    if series is None:
        yield Topic(OTHERS, (), ["The run has written no rows of timeseries.csv yet."], ())
        return
    zero_columns = [column.text for column in series.columns if is_zero(column)]
    has_budget = any(column.name in ENERGY_BUDGET_QUANTITIES for column in series.columns)
    tables = {title: _readings(record, title) for title in READINGS}
    tables |= {ENERGIES: _energy_budget(series.columns)} if has_budget else {}
    error = record.result_sections.get("totals", {}).get("energy_error")
    for title in (*READINGS, ENERGIES, OTHERS):
        sentences = []
        if title == OTHERS and zero_columns:
            sentences.append(f"Always zero: {', '.join(zero_columns)}.")
        if title == ENERGIES and tables.get(ENERGIES) and error is not None:
            sentences.append(f"Energy error: {error:.3g} of the largest energy input.")
        columns = [each for each in series.columns if topic_of(each, has_budget) == title and not is_zero(each)]
        if columns and not with_plots:
            sentences.append(NO_LIBRARY)
        plots = [plot_of(group, series) for group in groups_of(columns)] if with_plots else []
        found = Topic(title, tables.get(title, ()), sentences, plots)
        if any(found[1:]):
            yield found


def _readings(record: Run, title: str) -> list[PageTable]:
    """Final values of flow meters or walls; from the last row of the time series if the run has no result."""
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
    rows = [[part, *(_shown(numbers.get(name), unit) for name, unit in columns)] for part, numbers in parts.items()]
    if len(parts) < MOST_COLUMNS < len(names):
        return PageTable(["", *parts], list(zip(heads, *(row[1:] for row in rows), strict=True)), caption)
    return PageTable(["", *heads], rows, caption)


def _energy_budget(columns: Iterable[SeriesColumn]) -> list[PageTable]:
    """Each energy at the start and at the end, and its largest absolute value [J]; NEGLIGIBLE shares of it are 0."""
    rows = []
    for column in columns:
        if column.unit == "J" and not is_zero(column):
            known = TOTAL_QUANTITIES.get(column.name)
            values = column.values[np.isfinite(column.values)]
            numbers = (values[0], values[-1], max(values.max(), values.min(), key=abs))
            shown = (number if abs(number) > NEGLIGIBLE * abs(numbers[-1]) else 0.0 for number in numbers)
            rows.append([column.text, *(f"{number + 0.0:.4g}" for number in shown), known.meaning if known else ""])
    return [PageTable(("", "first", "last", "largest", "meaning"), rows, "Energies in J.")] if rows else []


def timings(record: Run) -> PageTable | None:
    """Wall-clock time by phase [s], in descending order; None if the run has no timings."""
    seconds = {name: number for name, number in record.result_sections.get("timings", {}).items() if number is not None}
    total = max(record.result_sections.get("run", {}).get("wall_clock") or 0.0, sum(seconds.values()))
    if not seconds or not total > 0.0:
        return None
    seconds["other"] = total - sum(seconds.values())
    rows = []
    for name, number in sorted(seconds.items(), key=lambda each: -each[1]):
        bar = "\N{FULL BLOCK}" * round(BAR_STEPS * number / total)
        rows.append((name.replace("_", " "), f"{number:.2f}", f"{number / total:.0%}", bar))
    return PageTable(("", "s", "share", ""), rows, f"Total wall-clock time: {total:.4g} s.")


def plan(record: Run) -> tuple[str, str]:
    """Decisions of the plan with their reasons, from the log, or recomputed from the resolved scene; or the problem."""
    text = explanation(record.log)
    if not text and not record.scene_problem:
        try:
            text = explain(plan_for(record.scene))
        except GranflowError as error:
            return "", str(error)
    return text, ""


def machine(record: Run) -> PageTable:
    """Versions, backend and machine of each session."""
    rows = [
        (each.started, each.arch, each.precision, each.compiled and f"{each.compiled} s", each.versions,
         each.resumed_from)
        for each in sessions(record.log)
    ]  # fmt: skip
    return PageTable(("start", "backend", "precision", "compilation", "versions and system", ""), rows, FROM_LOG)


def warnings(record: Run) -> PageTable:
    """Warnings and errors of the run."""
    return PageTable(("time", "level", "message"), list(warnings_and_errors(record.log)), FROM_LOG)


def remaining_numbers(record: Run) -> list[PageTable]:
    """Numbers of the result without a separate section."""
    found = []
    for name, numbers in record.result_sections.items():
        if name in SEPARATE or not isinstance(numbers, Mapping) or not numbers:
            continue
        caption = f"{name} in result.json"
        if name == "totals":
            numbers = {key: _unless_negligible(record, key, number) for key, number in numbers.items()}
        if all(isinstance(each, Mapping) for each in numbers.values()):
            found.append(table_of(caption, numbers))
        else:
            found.append(PageTable(("", "", ""), list(map(_number_row, numbers.items())), caption))
    return found


def _unless_negligible(record: Run, name: str, number: Any) -> Any:
    """The last value of a quantity, 0 if it is a NEGLIGIBLE share of its largest value in the time series."""
    columns = record.series.columns if record.series is not None else ()
    largest = max((np.nanmax(np.abs(each.values), initial=0.0) for each in columns if each.name == name), default=0.0)
    return 0.0 if isinstance(number, float) and abs(number) < NEGLIGIBLE * largest else number
