"""Sections of the page, each from the files of the run; empty sections are omitted.

A run in progress or without a result has sections from its log and time series only.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from granflow.errors import GranflowError
from granflow.fields import FLOW_METER_QUANTITIES, TOTAL_QUANTITIES, WALL_FORCE_QUANTITIES, unit_of
from granflow.plan.build import plan_for
from granflow.plan.explain import explain
from granflow.runs.result import readable
from granflow.studies.page import Code, PagePart, PageTable, Section
from granflow.studies.report.log import explanation, warnings_and_errors
from granflow.studies.report.plots import plot_of
from granflow.studies.report.record import RunRecord
from granflow.studies.report.series import SeriesColumn, groups_of

NO_LIBRARY = "Plots require plotly, which is not installed: pip install granflow[plot], then granflow report again."
TOPICS = {"Flow": FLOW_METER_QUANTITIES, "Wall forces": WALL_FORCE_QUANTITIES}
"""Quantities of flow meters and walls by section of the page."""

SECTIONS = {"Flow": "flow_meters", "Wall forces": "wall_forces"}
"""Keys of result.json by topic."""

CAPTIONS = {
    "Flow": "Flow meters at the end of the run; the mass flow rate is the steady one.",
    "Wall forces": "Forces of the particles on the walls: means over the run, and the largest value of a row.",
}
ENDED_BY = "ended by "
"""Prefix of the log entry of an exception that ended a run."""

PLAN = "Plan of the run"
"""Title of the section with the plan."""

BAR_STEPS = 30
"""Length of the bar of the total wall-clock time, in blocks."""


def summary(record: RunRecord) -> Section:
    """State of the run, simulated time and performance, and the number of satisfied expectations."""
    numbers = record.result.get("run", {})
    rows = []
    if record.time is not None and "simulated_time" not in numbers:
        rows.append(("simulated time", readable(record.time), "s"))
    rows += [_row(name, number) for name, number in numbers.items()]
    rows += [_row(name, record.result.get("totals", {}).get(name)) for name in ("particle_count", "inserted_count")]
    rows = [row for row in rows if row[1]]
    parts: list[PagePart] = [state_of(record)]
    is_met = [entry.get("met") for entry in record.result.get("expect", ())]
    if is_met:
        parts.append(f"{sum(map(bool, is_met))} of {len(is_met)} expectations of the scene are satisfied.")
    elif record.result and record.scene is not None and record.scene.expect:
        parts.append("The run ended early because of --until; the expectations of the scene are not evaluated.")
    return Section("Summary", [*parts, *([PageTable("Progress and performance.", ("", "", ""), rows)] if rows else [])])


def state_of(record: RunRecord) -> str:
    """One sentence on how the run ended."""
    if record.is_running:
        return "The run is in progress; this page shows its present state."
    if record.result:
        parts = len(record.sessions)
        return f"The run is complete; it was resumed ({parts} sessions)." if parts > 1 else "The run is complete."
    text = next((entry.text for entry in reversed(record.entries) if entry.text.startswith(ENDED_BY)), "")
    why = f" ({ENDED_BY}{text.removeprefix(ENDED_BY).partition(':')[0]}: see the warnings)" if text else ""
    resume = f"granflow resume {record.directory} continues from its last checkpoint, if it has one."
    return f"The run did not finish{why}. {resume}"


def _row(name: str, number: Any) -> tuple[str, str, str]:
    return (name.replace("_", " "), "" if number is None else readable(number), unit_of(name))


def expectations(record: RunRecord) -> Section | None:
    """Expectations of the scene and their results."""
    found = record.result.get("expect", ())
    rows = [
        ("\N{CHECK MARK} satisfied" if entry["met"] else "\N{BALLOT X} not satisfied", entry["sentence"])
        for entry in found
    ]
    if not rows:
        return None
    return Section("Expectations", [PageTable("Expectations of the scene (expect).", ("", "result"), rows)])


def warnings(record: RunRecord) -> Section | None:
    """Warnings and errors of the run."""
    rows = list(warnings_and_errors(record.entries))
    if not rows:
        return None
    return Section("Warnings", [PageTable("From run.log.", ("time", "", "message"), rows)])


def is_zero(column: SeriesColumn) -> bool:
    """Whether a column is zero or nan in every row."""
    return not np.nan_to_num(column.values).any()


def topic_of(column: SeriesColumn) -> str:
    """Section of the page that shows a column."""
    quantity, _, part = column.name.partition(".")
    topics = (name for name, quantities in TOPICS.items() if part and quantity in quantities)
    return next(topics, "Energy budget" if column.unit == "J" or quantity.startswith("energy") else "Over time")


def over_time(record: RunRecord, with_plots: bool) -> list[Section]:
    """Sections of flow, wall forces, energy budget, and all other quantities over time.

    Columns of zeros are listed instead of plotted. `with_plots`: whether the plot library is available.
    """
    series = record.series
    if series is None:
        return [Section("Over time", ["The run has written no rows of timeseries.csv yet."])]
    zero_columns = [column.text for column in series.columns if is_zero(column)]
    parts_of: dict[str, list[PagePart]] = {topic: _readings(record, topic) for topic in TOPICS}
    parts_of["Energy budget"] = _energy_budget(record)
    parts_of["Over time"] = [f"Always zero: {', '.join(zero_columns)}."] if zero_columns else []
    found = []
    for topic, parts in parts_of.items():
        columns = [column for column in series.columns if topic_of(column) == topic and not is_zero(column)]
        if columns and not with_plots:
            parts = [*parts, NO_LIBRARY]
        plots = [plot_of(group, series) for group in groups_of(columns)] if with_plots else []
        if parts or plots:
            found.append(Section(topic, [*parts, *plots]))
    return found


def _readings(record: RunRecord, topic: str) -> list[PagePart]:
    """Final values of flow meters or walls; from the last row of the time series if the run has no result."""
    readings = record.result.get(SECTIONS[topic], {})
    if readings:
        return [table_of(CAPTIONS[topic], readings)]
    readings = _last_readings(record.series.columns, topic) if record.series is not None else {}
    return [table_of("The last row of timeseries.csv.", readings)] if readings else []


def table_of(caption: str, parts: Mapping[str, Mapping[str, Any]]) -> PageTable:
    """Table with a row for each part, such as a flow meter or a wall, and a column for each quantity."""
    names = list(dict.fromkeys(name for numbers in parts.values() for name in numbers))
    heads = ["", *(f"{name.replace('_', ' ')} {_bracketed(unit_of(name + '.x'))}".strip() for name in names)]
    return PageTable(
        caption, heads, [[part, *(_shown(each.get(name)) for name in names)] for part, each in parts.items()]
    )


def _last_readings(columns: Sequence[SeriesColumn], topic: str) -> dict[str, dict[str, float]]:
    """Last value of each column of a topic: part -> quantity -> value."""
    found: dict[str, dict[str, float]] = {}
    for column in columns:
        quantity, _, part = column.name.partition(".")
        if topic_of(column) == topic:
            found.setdefault(part, {})[quantity] = float(column.values[-1])
    return found


def _energy_budget(record: RunRecord) -> list[PagePart]:
    """Each energy at the start and at the end, and its largest absolute value [J], and the energy error of the run."""
    assert record.series is not None
    energies = [column for column in record.series.columns if column.unit == "J" and not is_zero(column)]
    if not energies:
        return []
    rows = []
    for column in energies:
        known = TOTAL_QUANTITIES.get(column.name)
        values = column.values[np.isfinite(column.values)]
        numbers = (values[0], values[-1], max(values.max(), values.min(), key=abs))
        rows.append([column.text, *(f"{number + 0.0:.4g}" for number in numbers), known.meaning if known else ""])
    error = record.result.get("totals", {}).get("energy_error")
    statement = [] if error is None else [f"Energy error: {error:.3g} of the largest energy input (docs/energy.md)."]
    return [PageTable("Energies in J.", ("", "first", "last", "largest", "meaning"), rows), *statement]


def profile(record: RunRecord) -> Section | None:
    """Wall-clock time by phase [s], in descending order; None if the run has no timings."""
    seconds = {name: number for name, number in record.result.get("timings", {}).items() if number is not None}
    total = max(record.result.get("run", {}).get("wall_clock") or 0.0, sum(seconds.values()))
    if not seconds or not total > 0.0:
        return None
    seconds["other"] = total - sum(seconds.values())
    rows = [
        (
            name.replace("_", " "),
            f"{number:.2f}",
            f"{number / total:.0%}",
            "\N{FULL BLOCK}" * round(BAR_STEPS * number / total),
        )
        for name, number in sorted(seconds.items(), key=lambda each: -each[1])
    ]
    return Section("Timings", [PageTable(f"Total wall-clock time: {total:.4g} s.", ("", "s", "share", ""), rows)])


def plan(record: RunRecord) -> Section | None:
    """Decisions of the plan with their reasons, from the log, or recomputed from the resolved scene."""
    text = explanation(record.entries)
    if not text and record.scene is not None:
        try:
            text = explain(plan_for(record.scene))
        except GranflowError as error:
            return Section(PLAN, [f"The log does not contain the plan, and it cannot be recomputed: {error}"])
    return Section(PLAN, [Code(text, numbered=False)]) if text else None


def scene(record: RunRecord) -> Section:
    """The resolved scene, with all defaults."""
    if not record.text:
        return Section("Resolved scene", ["scene_as_run.yaml is missing."])
    problem = [f"This version cannot read the scene: {record.scene_problem}"] if record.scene_problem else []
    return Section("Resolved scene", [*problem, Code(record.text)])


def machine(record: RunRecord) -> Section | None:
    """Versions, backend and machine of each session."""
    rows = [
        (
            each.started,
            each.arch,
            each.precision,
            f"{each.compiled} s" if each.compiled else "",
            each.versions,
            each.resumed_from,
        )
        for each in record.sessions
    ]
    if not rows:
        return None
    heads = ("start", "backend", "precision", "compilation", "versions and system", "")
    return Section("Machine and versions", [PageTable("From run.log.", heads, rows)])


def remaining_numbers(record: RunRecord) -> Section | None:
    """Numbers of the result without a separate section."""
    other_sections = ("run", "timings", "expect", *SECTIONS.values())
    parts: list[PagePart] = []
    for name, numbers in record.result.items():
        if name in other_sections or not isinstance(numbers, Mapping) or not numbers:
            continue
        if all(isinstance(each, Mapping) for each in numbers.values()):
            parts.append(table_of(f"{name} in result.json", numbers))
        else:
            rows = [(each.replace("_", " "), _shown(number), unit_of(each)) for each, number in numbers.items()]
            parts.append(PageTable(f"{name} in result.json", ("", "", ""), rows))
    return Section("Other results", parts) if parts else None


def _shown(number: Any) -> str:
    return "" if number is None else readable(number) if isinstance(number, (int, float)) else str(number)


def _bracketed(unit: str) -> str:
    return f"({unit})" if unit else ""
