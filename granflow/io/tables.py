"""Tables of text with named columns (CSV): reading, writing, and the tables that a run writes.

`table_in` reads every table of granflow, of particles, time series or measurements, as text cells (`Table`);
`write_table` writes one at once. A run writes its tables row by row with a `RowFile`, which a resumed run
continues. Two of these tables are also read as numbers: `timeseries.csv` and `collision_energies.csv`.
"""

import csv
import os
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from io import FileIO, StringIO
from pathlib import Path
from typing import Any

import numpy as np

from granflow.errors import FileError, GranflowError
from granflow.io.files import (
    LostFiles,
    identity_of,
    named_errors,
    read_text,
    replacing,
    separate_from_links,
)
from granflow.units import UnitError, factor_of

# Reading

COMMENT = "#"
"""First character of lines that are ignored; a header may begin with it as well."""
MOST_COMMENTS = 100
"""Number of lines that may precede the header."""
SEPARATORS = (";", ",", "\t", None)
"""Separators of input tables, in the order in which they are tried; None stands for white space."""
SEPARATOR_LINE = re.compile('"?sep=(.)"?', re.IGNORECASE)
"""First line of a table that names the separator."""
UNIT = re.compile(r"\s*[\[(]([^\])]*)[\])]\s*$")
"""The unit in brackets at the end of a column name."""


@dataclass(frozen=True)
class Table:
    """A table as text; its rows may be shorter or longer than the header, see `complete`.

    names:          of the columns
    separator:      of the cells; None: white space
    heading_line:   line number of the header; lines count from 1
    rows:           line number and cells of each row
    is_terminated:  whether the file ends with a newline; otherwise a program may still be writing its last
                    line
    """

    names: tuple[str, ...]
    separator: str | None
    heading_line: int
    rows: tuple[tuple[int, list[str]], ...]
    is_terminated: bool = True

    def complete(self) -> "Table":
        """The table without rows of another length than the header, such as an incomplete last line."""
        return replace(self, rows=tuple(row for row in self.rows if len(row[1]) == len(self.names)))

    def texts(self, column: int) -> list[str]:
        """Cells of a column of a complete table."""
        return [cells[column] for _, cells in self.rows]

    def numbers(self, column: int) -> np.ndarray:
        """A column (rows,) of a complete table as float64; NaN for cells that are not numbers.

        A decimal comma is accepted if the separator is not a comma.
        """
        cells = self.texts(column)
        if self.separator != ",":
            cells = [cell.replace(",", ".") for cell in cells]
        try:
            return np.array(cells, dtype=str).astype(np.float64)
        except ValueError:
            return np.array([float(cell) if is_number(cell) else np.nan for cell in cells])


def unit_factor(path: Path, table: Table, index: int, dimension: str) -> float:
    """Factor of a column of a dimension to SI, from the unit after its name; 1 without a unit.

    Raises FileError for an invalid unit.
    """
    name = table.names[index]
    unit = UNIT.search(name)
    if unit is None or not unit[1].strip():
        return 1.0
    try:
        return factor_of(unit[1].strip(), dimension)
    except UnitError as error:
        raise FileError(f"{path}:{table.heading_line}: the unit of {name} is invalid: {error}.") from None


def is_number(cell: str) -> bool:
    """Whether the cell is a number, possibly NaN or infinite."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def read_table(path: Path, is_header: Callable[[Sequence[str]], bool] | None = None) -> Table | None:
    """The table in a CSV file, UTF-8; None without a header.

    With `is_header`, which accepts its names, the separator is any of SEPARATORS, otherwise a comma. Raises
    OSError if the file cannot be read, and FileError for a row that is not CSV.
    """
    if is_header is None:
        return table_in(read_text(path), path)
    return table_in(read_text(path), path, SEPARATORS, is_header)


def table_in(
    text: str,
    path: Path,
    separators: Sequence[str | None] = (",",),
    is_header: Callable[[Sequence[str]], bool] = lambda names: False,
) -> Table | None:
    """The table in the text of the file `path`; None without a header.

    The header is the first line that is not empty and not a comment, or a comment before it whose names
    `is_header` accepts and for which one of the first rows has as many cells. The separator is the first of
    those in the header with accepted names, otherwise the first of them; a first line sep=; as spreadsheets
    write it names another one. Rows may have another separator than accepted names. Raises FileError for a
    row that is not CSV, and for a header with a name twice.
    """
    lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip()]
    if lines and (found := SEPARATOR_LINE.fullmatch(lines[0][1].strip())):
        lines, separators = lines[1:], (found[1],)
    for index, (n, line) in enumerate(lines[:MOST_COMMENTS]):
        is_comment = _is_comment(line)
        heading = line.strip().lstrip(COMMENT) if is_comment else line
        used = [mark for mark in separators if mark is None or mark in heading] or separators[-1:]
        headers = [(_names(heading, mark, path, n), mark) for mark in used]
        accepted = [header for header in headers if is_header(header[0])]
        names, mark = (accepted or headers)[0]
        below = [(m, row) for m, row in lines[index + 1 :] if not _is_comment(row)]
        if accepted and below:
            marks = list(dict.fromkeys([mark, *separators]))
            scores = [_number_count(len(names), each, path, below[:MOST_COMMENTS]) for each in marks]
            if is_comment and max(scores) < 0:
                continue
            mark = marks[scores.index(max(scores))]
        if accepted or not is_comment:
            _refuse_repetition(names, path, n)
            rows = ((m, _cells(row, mark, path, m)) for m, row in below)
            trimmed = tuple((m, _trimmed(cells, len(names))) for m, cells in rows)
            return Table(tuple(names), mark, n, trimmed, text.endswith(("\n", "\r")))
    return None


def _number_count(width: int, separator: str | None, path: Path, rows: Iterable[tuple[int, str]]) -> int:
    """How many cells are numbers in the first of `rows` (line number, text) that has `width` cells; -1
    without such a row."""
    for n, row in rows:
        cells = _trimmed(_cells(row, separator, path, n), width)
        if len(cells) == width:
            return sum(is_number(cell if separator == "," else cell.replace(",", ".")) for cell in cells)
    return -1


def _refuse_repetition(names: Sequence[str], path: Path, line: int) -> None:
    """Raise FileError for two columns whose names differ at most in case and in the unit in square
    brackets."""
    found: dict[str, str] = {}
    for name in names:
        plain = name.partition("[")[0].strip().lower()
        if plain in found and plain and not is_number(plain.replace(",", ".")):
            both = f"{name} twice" if found[plain] == name else f"both {found[plain]} and {name}"
            raise FileError(f"{path}:{line}: the header has {both}; keep one of the columns.")
        found[plain] = name


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(COMMENT)


def _names(heading: str, separator: str | None, path: Path, line: int) -> list[str]:
    """Column names of a header; if they are separated by white space, a unit in brackets belongs to the
    name."""
    joined = re.sub(r"\s+(?=[\[(])", "", heading) if separator is None else heading
    return _trimmed(_cells(joined, separator, path, line), 1)


def _cells(line: str, separator: str | None, path: Path, number: int) -> list[str]:
    """Stripped cells of a line. Raises FileError for one that is not CSV."""
    if separator is None:
        return [cell.strip('"') for cell in line.split()]
    if '"' not in line:
        return [cell.strip() for cell in line.split(separator)]
    try:
        cells = next(csv.reader([line.strip(" ")], delimiter=separator, skipinitialspace=True))
        return [cell.strip() for cell in cells]
    except csv.Error as error:
        raise FileError(f"{path}:{number}: this row cannot be read: {error}.") from None


def _trimmed(cells: list[str], width: int) -> list[str]:
    """The cells without empty ones at the end, but at least `width`."""
    while len(cells) > width and not cells[-1]:
        cells.pop()
    return cells


# Writing


def csv_line(cells: Iterable[Any]) -> str:
    """A row of a CSV file with its newline; numbers in full precision."""
    line = StringIO()
    csv.writer(line, lineterminator="\n").writerow(cells)
    return line.getvalue()


def write_table(path: Path, names: Iterable[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write a CSV file with a header, UTF-8, atomically; the folder is created if necessary."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        file.writelines(csv_line(cells) for cells in (names, *rows))


# A file that grows


class RowFile:
    """Rows of a CSV file, flushed one by one.

    The file replaces an existing one at the first row, unless a state was restored: a resumed run restores
    size and last row of its checkpoint with `load_state_dict`, removes later rows with `truncate`, and
    continues. Before each row, `check` refuses a file that another program has changed or taken away.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: FileIO | None = None
        self._size = 0
        self._unwritten = b""
        self._last = b""

    @property
    def is_empty(self) -> bool:
        """Whether there are no rows yet, not even a header."""
        return not self._size and not self._unwritten

    def write(self, row: Sequence[Any], replaces_last: bool = False) -> None:
        """Write one row and flush it; bytes that could not be written are kept for the next call.

        `replaces_last`: in place of the last row, if that is completely written. Raises LostFiles if another
        program has moved, deleted, replaced or changed the file, OSError if it cannot be written.
        """
        line = csv_line(row).encode()
        self._open()
        self.check()
        if replaces_last and not self._unwritten:
            self._cut(self._size - len(self._last))
        self._unwritten += line
        self._last = line
        self._write_rest()

    def _open(self) -> FileIO:
        if self._file is None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            separate_from_links(self.path)
            self._file = FileIO(self.path, "a" if self._size else "w")
        return self._file

    def _cut(self, size: int) -> None:
        """Remove the bytes after `size` from the open file."""
        file = self._open()
        with named_errors(self.path):
            file.truncate(size)
            file.seek(size)
        self._size = size

    def _write_rest(self) -> None:
        """Write the bytes that are not written yet."""
        file = self._open()
        with named_errors(self.path):
            while self._unwritten:
                written = file.write(self._unwritten)
                self._size += written
                self._unwritten = self._unwritten[written:]

    def check(self) -> None:
        """Raise LostFiles if the path leads to another file than the open one, or if that has another
        size."""
        if self._file is None:
            return
        try:
            found = os.stat(self.path)
        except OSError:
            raise LostFiles(self.path, "it was moved or deleted during the run") from None
        own = os.fstat(self._file.fileno())
        if identity_of(found) != identity_of(own):
            raise LostFiles(self.path, "another file has replaced it during the run")
        if own.st_size != self._size:
            raise LostFiles(
                self.path,
                f"another program has changed it: it has {own.st_size} bytes, and the run wrote {self._size}",
            )

    def close(self) -> None:
        """Close the file; a further row opens it again."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def sync(self) -> None:
        """Flush all rows to the disk. Raises OSError."""
        if self._file is not None:
            os.fsync(self._file.fileno())

    def state_dict(self) -> dict[str, Any]:
        """Return the file size [bytes] without the last row, which a later one may replace, and this row.

        If bytes could not be written: the size, and these bytes.
        """
        last = b"" if self._unwritten else self._last
        return {"size": self._size - len(last), "unwritten": (last or self._unwritten).decode()}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state of `state_dict`; the file is not modified yet."""
        self._size = saved["size"]
        self._unwritten = saved["unwritten"].encode()
        self._last = self._unwritten

    @property
    def is_intact(self) -> bool:
        """Whether the file still contains all rows of the restored state."""
        return self._present_size() >= self._size

    def truncate(self) -> None:
        """Remove the rows after the restored state; if earlier rows are missing, continue with the remaining
        ones.

        Raises OSError if the last row of the restored state cannot be written.
        """
        if self._size:
            self._size = min(self._size, self._present_size())
            if self._size:
                separate_from_links(self.path)
                os.truncate(self.path, self._size)
                self._write_rest()
                self.close()
            else:
                self._unwritten = b""  # the next row follows a new header
                self._last = b""

    def _present_size(self) -> int:
        """Size of the file [bytes]."""
        return self.path.stat().st_size if self.path.is_file() else 0


# `timeseries.csv`

TIME = "time"
STAGE = "stage"
"""Names of the first two columns."""


@dataclass(frozen=True)
class SeriesColumn:
    """One quantity over time: `name` as in the file, with the part after a dot, unit ("" without a
    dimension), values (n,)."""

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
    """All columns over `time` (n,) [s], the stage of each row (n,), and start time [s] and name of each
    stage."""

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
    """The table in a CSV file that a run wrote; None without a header. Raises GranflowError if it is not
    CSV."""
    try:
        return read_table(path)
    except FileError as error:
        raise GranflowError(f"{path} cannot be read ({error}); remove it, or run again.") from None


def series_in(found: Table) -> TimeSeriesTable | None:
    """Columns of a table without its incomplete rows; None if it has no rows or no column `time`.

    Cells that are not numbers become nan.
    """
    table = found.complete()
    labels = [_split(head) for head in found.names]
    names = [name for name, _ in labels]
    if not table.rows or TIME not in names:
        return None
    numbers = {name: table.numbers(k) for k, name in enumerate(names) if name != STAGE}
    time = numbers.pop(TIME)
    units = dict(labels)
    columns = tuple(SeriesColumn(name, units[name], values) for name, values in numbers.items())
    stage = table.texts(names.index(STAGE)) if STAGE in names else [""] * len(time)
    begins = [
        (float(time[k]), name) for k, name in enumerate(stage) if name and (k == 0 or stage[k - 1] != name)
    ]
    return TimeSeriesTable(time, np.array(stage), columns, tuple(begins))


def _split(head: str) -> tuple[str, str]:
    """Name and unit of "kinetic_energy [J]"."""
    name, _, unit = head.partition(" [")
    return name, unit.removesuffix("]")


RESIDENCE_FILE = "residence_time.csv"
"""Name of the file with a row for each particle whose residence time is known."""

# `collision_energies.csv`

COLLISION_FILE = "collision_energies.csv"
"""Name of the file in the directory of a run."""
COLLISION_COLUMNS = (
    "time_start [s]",
    "time_end [s]",
    "contact",
    "energy_min [J]",
    "energy_max [J]",
    "count",
    "count_total",
)
"""Columns of the file."""


@dataclass(frozen=True)
class CollisionTable:
    """Numbers of collisions by kind of contact ("particle" or "wall"), in i intervals and c classes of impact
    energy.

    time:    ends of the intervals (i,) [s]
    edges:   of the classes (c, 2) [J]; the first one begins at 0, the last one ends at infinity
    counts:  (i, c) contacts that began in the interval, by kind
    totals:  (i, c) contacts that began since the start of the run, by kind
    """

    time: np.ndarray
    edges: np.ndarray
    counts: dict[str, np.ndarray]
    totals: dict[str, np.ndarray]

    @property
    def energy(self) -> np.ndarray:
        """Logarithmic centers (c,) [J] of the classes; nan for the first and the last one, which are open."""
        center = np.full(len(self.edges), np.nan)
        center[1:-1] = np.sqrt(self.edges[1:-1, 0] * self.edges[1:-1, 1])
        return center


def has_collisions(names: Sequence[str]) -> bool:
    """Whether these are the columns of `collision_energies.csv`."""
    return tuple(names) == COLLISION_COLUMNS


def collision_table(table: Table) -> CollisionTable | None:
    """The counts in a table with these columns, without an incomplete last interval; None if none is
    complete."""
    rows = table.complete()
    column = {
        name.partition(" [")[0]: rows.numbers(k)
        for k, name in enumerate(COLLISION_COLUMNS)
        if name != "contact"
    }
    end = column["time_end"]
    kinds = list(dict.fromkeys(rows.texts(COLLISION_COLUMNS.index("contact"))))
    size = int(np.sum(end == end[0])) if len(end) else 0
    if not size or size % len(kinds) or np.isfinite(column["energy_max"][size - 1]):
        return None
    shape = (len(end) // size, len(kinds), size // len(kinds))
    arrays = {name: values[: shape[0] * size].reshape(shape) for name, values in column.items()}
    return CollisionTable(
        arrays["time_end"][:, 0, 0],
        np.stack([arrays["energy_min"][0, 0], arrays["energy_max"][0, 0]], axis=1),
        {kind: arrays["count"][:, k] for k, kind in enumerate(kinds)},
        {kind: arrays["count_total"][:, k] for k, kind in enumerate(kinds)},
    )
