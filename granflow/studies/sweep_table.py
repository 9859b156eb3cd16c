"""Tables of a sweep: one row per point (`sweep.csv`) and one per run (`runs.csv`).

`SweepTable` has SI numbers, as the files have; `ShownTable` gives them in the units of the page: in that of
the sweep file for parameters, and in degrees for angles.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite, nan, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from granflow.io.files import replacing
from granflow.io.tables import write_table
from granflow.scene.blocks.output import unit_of
from granflow.studies.checked_run import CheckedRun
from granflow.studies.interactive_plots import escaped, level_text, short_names
from granflow.studies.run_process import (
    DONE,
    REFUSED,
    UNFINISHED,
    Outcome,
    error_name,
    numbers_of,
    reason_without,
    warnings_of,
    worst,
)
from granflow.studies.sweep_design import DesignPoint, SweepInput, ValueList, ValueRange
from granflow.studies.yield_locus import Locus
from granflow.units import common_unit, in_unit
from granflow.visible_text import numbered

# Rows and tables


@dataclass(frozen=True)
class RunRow:
    """One run of a point: `run` is None if the point was refused before.

    A run that has ended has numbers and warnings.
    """

    run: CheckedRun | None
    outcome: Outcome
    numbers: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


ROUNDING = 1e-14
"""Scatter of equal results relative to them: rounding of their mean."""


def standard_error_of_mean(values: Sequence[float], errors: Sequence[float]) -> float:
    """Standard error of the mean of runs with different seeds; `errors`: that the runs give.

    It is nan for fewer than two values without errors of their own; otherwise the larger one of s / sqrt(n)
    and sqrt(sum e^2) / n: the scatter s between seeds contains the errors e that the runs give
    (`angle_of_repose_error`), but few seeds may agree by chance.
    """
    scatter = float(np.std(values, ddof=1) / sqrt(len(values))) if len(values) > 1 else nan
    if scatter <= ROUNDING * float(np.abs(values).max(initial=0.0)):
        scatter = 0.0
    combined = float(np.linalg.norm(errors) / len(errors)) if len(errors) else nan
    return float(np.fmax(scatter, combined))


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
        return SEPARATOR.join(dict.fromkeys(sentence for each in self.runs for sentence in each.warnings))

    def mean(self, name: str) -> float:
        """Mean of a number over the seeds whose runs have it; nan without."""
        values = self._values(name)
        return float(np.mean(values)) if values else nan

    def standard_error(self, name: str) -> float:
        """Standard error of the mean over the seeds, see `standard_error_of_mean`."""
        return standard_error_of_mean(self._values(name), self._values(error_name(name)))

    def _values(self, name: str) -> list[float]:
        return [value for each in self.runs if isfinite(value := each.numbers.get(name, nan))]

    @property
    def directories(self) -> list[str]:
        """Names of the run directories."""
        return [each.run.directory.name for each in self.runs if each.run is not None]


SEPARATOR = " | "
"""Between the warnings of a run in a table."""


def warning_sentence(rows: Sequence[PointRow]) -> str:
    """How many points have warnings, and the first of them; empty without warnings."""
    warned = [sentence for row in rows for sentence in dict.fromkeys(s for r in row.runs for s in r.warnings)]
    count = sum(bool(row.warnings) for row in rows)
    if not warned:
        return ""
    more = f" ({len(warned) - 1} more)" if len(warned) > 1 else ""
    verb = "has" if count == 1 else "have"
    points = f"{count} of {numbered(len(rows), 'point')}"
    return f"{points} {verb} warnings, see sweep.csv; the first: {warned[0]}{more}"


STANDARD_ERROR = "standard_error"
"""Prefix of the columns with the standard errors of the means over seeds."""


@dataclass(frozen=True)
class SweepTable:
    """All points of a sweep with their runs; `parameters`, `quantities`: names of the columns; `loci`: of an
    evaluation to yield loci."""

    parameters: tuple[str, ...]
    quantities: tuple[str, ...]
    seed_count: int
    rows: tuple[PointRow, ...]
    loci: tuple[Locus, ...] = ()

    @property
    def is_complete(self) -> bool:
        """Whether all runs are done and meet the expectations of their scenes, and all yield loci exist."""
        return all(row.outcome.status == DONE for row in self.rows) and all(each.line for each in self.loci)

    def columns(self) -> dict[str, list[Any]]:
        """Columns of `sweep.csv`: parameters, status, reason, warnings, seconds, quantities, run directories.

        With several seeds, each quantity is the mean, followed by its standard error; with one seed, the
        standard error follows the quantities of which the runs give one. None for missing numbers.
        """
        outcomes = [row.outcome for row in self.rows]
        found: dict[str, list[Any]] = {
            name: [_plain(row.point.values[name]) for row in self.rows] for name in self.parameters
        }
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
        """Columns of `runs.csv`: parameters, seed, status, reason, warnings, seconds, quantities, run
        directory."""
        pairs = [(row.point, each) for row in self.rows for each in row.runs]
        found: dict[str, list[Any]] = {
            name: [_plain(point.values[name]) for point, _ in pairs] for name in self.parameters
        }
        found["seed"] = [each.run.seed if each.run else None for _, each in pairs]
        found["status"] = [each.outcome.status for _, each in pairs]
        found["reason"] = [each.outcome.reason for _, each in pairs]
        found["warnings"] = [SEPARATOR.join(each.warnings) for _, each in pairs]
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


def label(name: str) -> str:
    """Column name of a number with its unit, as in timeseries.csv: `mass_flow.outlet [kg/s]`."""
    unit = unit_of(name)
    return f"{name} [{unit}]" if unit else name


def _plain(value: Any) -> Any:
    """A value of a parameter for a table: a mapping or list as YAML on one line."""
    return level_text(value) if isinstance(value, dict | list | tuple) else value


def _cell(value: float) -> float | None:
    return value if isfinite(value) else None


# Files


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


# Numbers in the units of the page


@dataclass(frozen=True)
class ShownTable:
    """A sweep whose numbers are in the units of the page.

    `units`: unit in which the sweep file gives the values of each parameter; empty: SI. `logarithmic`:
    parameters with `scale: log`. `in_plots`: names and values are escaped, because plotly reads markup;
    tables of a page are not.
    """

    table: SweepTable
    units: Mapping[str, str]
    logarithmic: frozenset[str]
    in_plots: bool = False

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.table.parameters

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of the quantities."""
        return self.table.quantities

    @property
    def rows(self) -> tuple[PointRow, ...]:
        """The points, with SI numbers."""
        return self.table.rows

    @property
    def rows_with_numbers(self) -> list[PointRow]:
        """The points with at least one number."""
        return [row for row in self.rows if any(isfinite(row.mean(name)) for name in self.quantities)]

    def value(self, row: PointRow, parameter: str) -> Any:
        """The value of a parameter; text unchanged."""
        found = row.point.values[parameter]
        return in_unit(found, self.units[parameter]) if isinstance(found, float) else self._text(found)

    def _text(self, value: Any) -> Any:
        """A text as the page shows it, mappings and lists as text; other values unchanged."""
        value = _plain(value)
        return escaped(value) if self.in_plots and isinstance(value, str) else value

    def mean(self, row: PointRow, quantity: str) -> float:
        """Mean of a quantity over the seeds."""
        return _in_unit(row.mean(quantity), quantity)

    def standard_error(self, row: PointRow, quantity: str) -> float:
        """Standard error of the mean of a quantity."""
        return _in_unit(row.standard_error(quantity), quantity)

    def short_name(self, parameter: str) -> str:
        """The last keys of the path of a parameter."""
        return str(self._text(short_names(self.parameters)[parameter]))

    def parameter_label(self, parameter: str) -> str:
        """Short name of a parameter with its unit, for an axis."""
        return _with_unit(self.short_name(parameter), str(self._text(self.units[parameter])))

    def label(self, quantity: str) -> str:
        """Name of a quantity with its unit."""
        return _with_unit(quantity, _unit(quantity))


def shown(sweep: SweepInput, table: SweepTable) -> ShownTable:
    """The table of a sweep in the units of the page."""
    units = {name: _given_unit(variation) for name, variation in sweep.vary.items()}
    ranges = {name: each for name, each in sweep.vary.items() if isinstance(each, ValueRange)}
    return ShownTable(table, units, frozenset(name for name, each in ranges.items() if each.scale == "log"))


def _given_unit(variation: Any) -> str:
    """The unit of the values of a parameter in the sweep file, if it is the same for all."""
    if isinstance(variation, ValueRange):
        return common_unit((variation.start, variation.stop))
    return common_unit(variation.values if isinstance(variation, ValueList) else variation)


def _unit(quantity: str) -> str:
    """Unit of a quantity on the page: deg for angles, otherwise SI."""
    unit = unit_of(quantity)
    return "deg" if unit == "rad" else unit


def _in_unit(value: float, quantity: str) -> float:
    """An SI number in the unit of the page."""
    return in_unit(value, "deg") if unit_of(quantity) == "rad" else value


def _with_unit(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def run_texts(table: ShownTable) -> dict[str, str]:
    """Parameter values and name of each run, and its seed if there are several, by its directory."""
    found = {}
    for row in table.rows:
        values = {
            table.parameter_label(name): level_text(table.value(row, name), 4) for name in table.parameters
        }
        for run in (each.run for each in row.runs if each.run is not None):
            own = values | ({"seed": str(run.seed)} if table.table.seed_count > 1 else {})
            text = ", ".join(f"{name} = {value}" for name, value in own.items())
            found[run.request.directory] = f"{text} ({run.directory.name})"
    return found
