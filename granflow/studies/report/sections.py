"""Parts of the report page on the run as a whole, each from its files; the page omits empty parts.

A run in progress or without a result has parts from its log and time series only.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from granflow import Run, explain, plan_for
from granflow.errors import GranflowError
from granflow.fields import unit_of
from granflow.io.log_reader import explanation, sessions, warnings_and_errors
from granflow.studies.report.topics import NEGLIGIBLE, READINGS, shown, table_of
from granflow.studies.tables import PageTable
from granflow.visible_text import in_degrees

FROM_LOG = "From run.log."


SEPARATE = ("run", "timings", "expect", *(each.key for each in READINGS.values()))
"""Sections of result.json that the page shows separately."""

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
    return name.replace("_", " "), shown(number), unit + (in_degrees(number, unit) if number is not None else "")


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
        (each.started, each.arch, each.precision, each.threads, each.compiled and f"{each.compiled} s", each.versions,
         each.resumed_from)
        for each in sessions(record.log)
    ]  # fmt: skip
    header = ("start", "backend", "precision", "threads", "compilation", "versions and system", "")
    return PageTable(header, rows, FROM_LOG)


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
