"""Tables of a sweep: one row per point (`sweep.csv`) and one per run (`runs.csv`)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite, nan, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from granflow.fields import unit_of
from granflow.io.atomic_files import replacing
from granflow.io.tables import write_table
from granflow.studies.run_processes.checked import CheckedRun
from granflow.studies.run_processes.outcome import (
    DONE,
    REFUSED,
    UNFINISHED,
    Outcome,
    numbers_of,
    reason_without,
    warnings_of,
    worst,
)
from granflow.studies.run_processes.quantities import error_name
from granflow.studies.sweep.design import DesignPoint

STANDARD_ERROR = "standard_error"
"""Prefix of the columns with the standard errors of the means over seeds."""


@dataclass(frozen=True)
class RunRow:
    """One run of a point: `run` is None if the point was refused before; numbers and warnings, if the run has ended."""

    run: CheckedRun | None
    outcome: Outcome
    numbers: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class PointRow:
    """One point with its runs, one for each seed."""

    point: DesignPoint
    runs: Sequence[RunRow]

    @property
    def outcome(self) -> Outcome:
        """The most severe status of the runs, all reasons, and the sum of the seconds."""
        return worst(each.outcome for each in self.runs)

    @property
    def warnings(self) -> str:
        """The different warnings of the runs."""
        return " ".join(dict.fromkeys(sentence for each in self.runs for sentence in each.warnings))

    def mean(self, name: str) -> float:
        """Mean of a number over the seeds whose runs have it; nan without."""
        values = self._values(name)
        return float(np.mean(values)) if values else nan

    def standard_error(self, name: str) -> float:
        """Standard error of the mean over the seeds; nan for fewer than two values without errors of their own.

        The larger one of s / sqrt(n) and sqrt(sum e^2) / n: the scatter s between seeds contains the errors e that the
        runs give (`angle_of_repose_error`), but few seeds may agree by chance.
        """
        values, own = self._values(name), self._values(error_name(name))
        scatter = float(np.std(values, ddof=1) / sqrt(len(values))) if len(values) > 1 else nan
        combined = float(np.linalg.norm(own) / len(own)) if own else nan
        return float(np.fmax(scatter, combined))

    def _values(self, name: str) -> list[float]:
        return [value for each in self.runs if isfinite(value := each.numbers.get(name, nan))]

    @property
    def directories(self) -> list[str]:
        """Names of the run directories."""
        return [each.run.directory.name for each in self.runs if each.run is not None]


@dataclass(frozen=True)
class SweepTable:
    """All points of a sweep with their runs; `parameters`, `quantities`: names of the columns."""

    parameters: tuple[str, ...]
    quantities: tuple[str, ...]
    seed_count: int
    rows: tuple[PointRow, ...]

    @property
    def is_complete(self) -> bool:
        """Whether all runs are done and meet the expectations of their scenes."""
        return all(row.outcome.status == DONE for row in self.rows)

    def columns(self) -> dict[str, list[Any]]:
        """Columns of `sweep.csv`: parameters, status, reason, warnings, seconds, quantities, run directories.

        With several seeds, each quantity is the mean, followed by its standard error; with one seed, the standard error
        follows the quantities of which the runs give one. None for missing numbers.
        """
        outcomes = [row.outcome for row in self.rows]
        found: dict[str, list[Any]] = {name: [row.point.values[name] for row in self.rows] for name in self.parameters}
        found["status"] = [each.status for each in outcomes]
        found["reason"] = [each.reason for each in outcomes]
        found["warnings"] = [row.warnings for row in self.rows]
        found["seconds"] = [_cell(each.seconds) for each in outcomes]
        for name in self.quantities:
            found[label(name)] = [_cell(row.mean(name)) for row in self.rows]
            if self.seed_count > 1 or any(isfinite(row.standard_error(name)) for row in self.rows):
                head = f"{STANDARD_ERROR}.{label(name)}"
                found[head] = [_cell(row.standard_error(name)) for row in self.rows]
        found["runs"] = [" ".join(row.directories) for row in self.rows]
        return found

    def run_columns(self) -> dict[str, list[Any]]:
        """Columns of `runs.csv`: parameters, seed, status, reason, warnings, seconds, quantities, run directory."""
        pairs = [(row.point, each) for row in self.rows for each in row.runs]
        found: dict[str, list[Any]] = {name: [point.values[name] for point, _ in pairs] for name in self.parameters}
        found["seed"] = [each.run.seed if each.run else None for _, each in pairs]
        found["status"] = [each.outcome.status for _, each in pairs]
        found["reason"] = [each.outcome.reason for _, each in pairs]
        found["warnings"] = [" ".join(each.warnings) for _, each in pairs]
        found["seconds"] = [_cell(each.outcome.seconds) for _, each in pairs]
        for name in self.quantities:
            found[label(name)] = [_cell(each.numbers.get(name, nan)) for _, each in pairs]
        found["run"] = [each.run.directory.name if each.run else None for _, each in pairs]
        return found


def table_of(
    parameters: Sequence[str],
    quantities: Sequence[str],
    points: Sequence[tuple[DesignPoint, Sequence[CheckedRun | str]]],
    outcomes: Mapping[str, Outcome],
) -> SweepTable:
    """The table of points and their runs, or the reasons why these are refused; `outcomes` by directory."""
    rows = [PointRow(point, [_run_row(run, outcomes, quantities) for run in runs]) for point, runs in points]
    return SweepTable(tuple(parameters), tuple(quantities), max(len(runs) for _, runs in points), tuple(rows))


def _run_row(run: CheckedRun | str, outcomes: Mapping[str, Outcome], quantities: Sequence[str]) -> RunRow:
    """The row of a run, or of the reason why it is refused; the reason also states why quantities are NaN."""
    if isinstance(run, str):
        return RunRow(None, Outcome(REFUSED, run, 0.0))
    outcome = outcomes.get(run.request.directory, UNFINISHED)
    if not outcome.has_numbers:
        return RunRow(run, outcome)
    numbers = numbers_of(run.directory)
    without = [name for name in quantities if not isfinite(numbers.get(name, nan))]
    reasons = [f"runs/{run.directory.name}: {reason_without(name, run.directory)}" for name in without]
    reason = " ".join(filter(None, [outcome.reason, *reasons]))
    return RunRow(run, replace(outcome, reason=reason), numbers, warnings_of(run.directory))


def write_tables(out: Path, table: SweepTable) -> None:
    """Write `sweep.csv` and `runs.csv`, and `sweep.parquet` if pyarrow is installed; each atomically."""
    for name, columns in (("sweep.csv", table.columns()), ("runs.csv", table.run_columns())):
        with replacing(out / name) as temporary:
            write_table(temporary, columns, zip(*columns.values(), strict=True))
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        return
    content = {name: _of_one_type(values) for name, values in table.columns().items()}
    with replacing(out / "sweep.parquet") as temporary:
        parquet.write_table(pyarrow.table(content), temporary)


def _of_one_type(values: Sequence[Any]) -> list[Any]:
    """The values of a column for a typed file: numbers as float, a mixture of types as text."""
    if all(each is None or (isinstance(each, int | float) and not isinstance(each, bool)) for each in values):
        return [None if each is None else float(each) for each in values]
    return [None if each is None else str(each) for each in values]


def label(name: str) -> str:
    """Column name of a number with its unit, as in timeseries.csv: `mass_flow.outlet [kg/s]`."""
    unit = unit_of(name)
    return f"{name} [{unit}]" if unit else name


def _cell(value: float) -> float | None:
    return value if isfinite(value) else None
