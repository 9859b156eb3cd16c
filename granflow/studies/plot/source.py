"""Sources of `granflow plot`: time series, and the counts of collisions over time or over their energy."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from granflow.errors import GranflowError
from granflow.io.collision_energies import CollisionTable, collision_table, has_collisions
from granflow.io.tables import Table, is_number
from granflow.io.time_series import STAGE, TIME, SeriesColumn, TimeSeriesTable, series_in, table_of_run
from granflow.scene.schema.units import UnitError, column_factor, si_unit_of, split_heading, to_si
from granflow.studies.plot.expression import WORD
from granflow.visible_text import numbered

ENERGIES = ("energy", "energy_min", "energy_max")
"""Columns [J] of the classes of collisions; one of them on the horizontal axis selects the distribution at the end."""

_BEGUN = re.compile(r"[-+]|[-+]?([0-9]*\.?[0-9]*(?<=[0-9.])(e[-+]?)?|n|na|i|in)", re.IGNORECASE)
"""Beginning of a number that is not a number yet, such as 1.5e-."""


def series_of(source: Path, x: str) -> tuple[Path, TimeSeriesTable]:
    """File and columns of the directory of a run, or of a CSV file with a column `time` or with counts of collisions.

    Numbers are converted to SI by the units in the header; a unit that is not known remains. `x`: quantity of the
    horizontal axis. The last line may be incomplete if it does not end with a newline: a run writes it. Raises
    GranflowError if there is no such file, if it has neither rows nor known columns, if the header is damaged, if a row
    has another number of cells or a cell that is not a number, or if the unit of the times is not one of time.
    """
    path = source / "timeseries.csv" if source.is_dir() else source
    if not path.exists():
        reason = f"{source} contains no timeseries.csv" if source.is_dir() else f"{source} does not exist"
        raise GranflowError(f"{reason}; give the directory of a run, such as out/hopper, or a CSV file with times.")
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
    """Raise GranflowError for brackets not in pairs, another separator, and a time that does not end with its unit."""
    names, reason = table.names, ""
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
                f"{path}:{table.heading_line}: the header '{','.join(names)}' cannot be read: {reason}; separate the "
                "columns by commas and give their units in brackets, such as time [s],mass [kg]."
            )


def _without_begun_number(table: Table) -> Table:
    """The table without what another program is still writing: a short last row, or a last cell such as 1.5e-."""
    if table.is_terminated or not table.rows:
        return table
    line, cells = table.rows[-1]
    if len(cells) < len(table.names):
        return replace(table, rows=table.rows[:-1])
    if is_number(cells[-1]) or not _BEGUN.fullmatch(cells[-1]):
        return table
    return replace(table, rows=(*table.rows[:-1], (line, [*cells[:-1], ""])))


def _refuse_damaged_rows(table: Table, path: Path) -> None:
    """Raise GranflowError for the first row of another length, or with a cell in place of a number that is none.

    A run leaves cells empty that have no value, except the time. A column without a unit and without numbers is text.
    """
    width = len(table.names)
    problems = [
        (line, f"the row '{','.join(cells)[:80]}' has {numbered(len(cells), 'value')}, but the header has {width}.")
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
    return TimeSeriesTable(seconds * series.time, series.stage, tuple(map(_column_in_si, series.columns)), stages)


def _column_in_si(column: SeriesColumn) -> SeriesColumn:
    """A column in the SI unit; unchanged if its unit is unknown, or one of several dimensions, such as g."""
    try:
        factor = to_si(f"1 {column.unit}".strip(), "any")
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
            columns += [SeriesColumn(f"{quantity}.{kind}_{name}", "", values[:, k]) for k, name in enumerate(low_high)]
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
