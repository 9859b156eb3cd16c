"""`timeseries.csv` as columns with units."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from granflow.errors import FileError, GranflowError
from granflow.io.tables import Table, read_table

TIME, STAGE = "time", "stage"
"""Names of the first two columns of timeseries.csv."""


@dataclass(frozen=True)
class SeriesColumn:
    """One quantity over time: `name` as in the file, with the part after a dot, unit ("" for a number), values (n,)."""

    name: str
    unit: str
    values: np.ndarray

    @property
    def text(self) -> str:
        """Name for display: "flow mass, outlet"."""
        quantity, _, part = self.name.partition(".")
        return quantity.replace("_", " ") + (f", {part}" if part else "")


@dataclass(frozen=True)
class TimeSeriesTable:
    """All columns over `time` (n,) [s], the stage of each row (n,), and start time [s] and name of each stage."""

    time: np.ndarray
    stage: np.ndarray
    columns: tuple[SeriesColumn, ...]
    stages: tuple[tuple[float, str], ...]


def read_series(path: Path) -> TimeSeriesTable | None:
    """Columns of a time series file; None if it does not exist or has no rows.

    Raises GranflowError if the file is not CSV.
    """
    found = table_of_run(path) if path.exists() else None
    return None if found is None else series_in(found)


def table_of_run(path: Path) -> Table | None:
    """The table in a CSV file that a run wrote; None without a header. Raises GranflowError if it is not CSV."""
    try:
        return read_table(path)
    except FileError as error:
        raise GranflowError(f"{path} cannot be read ({error}); remove it, or run again.") from None


def series_in(found: Table) -> TimeSeriesTable | None:
    """Columns of a table without its incomplete rows; None if it has no rows or no column `time`.

    Cells that are not numbers become nan.
    """
    table, labels = found.complete(), [_split(head) for head in found.names]
    names = [name for name, _ in labels]
    if not table.rows or TIME not in names:
        return None
    numbers = {name: table.numbers(k) for k, name in enumerate(names) if name != STAGE}
    time = numbers.pop(TIME)
    units = dict(labels)
    columns = tuple(SeriesColumn(name, units[name], values) for name, values in numbers.items())
    stage = table.texts(names.index(STAGE)) if STAGE in names else [""] * len(time)
    begins = [(float(time[k]), name) for k, name in enumerate(stage) if name and (k == 0 or stage[k - 1] != name)]
    return TimeSeriesTable(time, np.array(stage), columns, tuple(begins))


def _split(head: str) -> tuple[str, str]:
    """Name and unit of "kinetic_energy [J]"."""
    name, _, unit = head.partition(" [")
    return name, unit.removesuffix("]")
