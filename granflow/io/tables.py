"""Tables of text with named columns: one reader for particles, time series and measurements, and one writer (CSV)."""

import csv
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from granflow.errors import FileError
from granflow.io.atomic_files import replacing
from granflow.io.regular_files import LARGEST_FILE, read_regular_text

COMMENT = "#"
"""First character of lines that are ignored; a header may begin with it as well."""

MOST_COMMENTS = 100
"""Number of lines that may precede the header."""


@dataclass(frozen=True)
class Table:
    """A table as text: column names, separator (None: white space), line number of the header, and rows with theirs.

    Lines count from 1. Rows may be shorter or longer than the header (see `complete`). `is_terminated`: whether the
    file ends with a newline; otherwise a program may still be writing its last line.
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


def is_number(cell: str) -> bool:
    """Whether the cell is a number, possibly NaN or infinite."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def read_table(path: Path) -> Table | None:
    """The table in a CSV file, UTF-8; None without a header.

    Raises OSError if the file cannot be read, and FileError for a row that is not CSV.
    """
    return table_in(read_regular_text(path, LARGEST_FILE), path)


def table_in(
    text: str,
    path: Path,
    separators: Sequence[str | None] = (",",),
    is_header: Callable[[Sequence[str]], bool] = lambda names: False,
) -> Table | None:
    """The table in the text of the file `path`; None without a header.

    The header is the first line that is not empty and not a comment, or a comment before it whose names `is_header`
    accepts. The separator is the first of those in the header with accepted names, otherwise the first of them. Raises
    FileError for a row that is not CSV, and for a header with a name twice.
    """
    lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip()]
    for index, (n, line) in enumerate(lines[:MOST_COMMENTS]):
        is_comment = _is_comment(line)
        heading = line.strip().lstrip(COMMENT) if is_comment else line
        used = [mark for mark in separators if mark is None or mark in heading] or separators[-1:]
        headers = [(_names(heading, mark, path, n), mark) for mark in used]
        accepted = [header for header in headers if is_header(header[0])]
        if accepted or not is_comment:
            names, mark = (accepted or headers)[0]
            _refuse_repetition(names, path, n)
            rows = ((m, _cells(row, mark, path, m)) for m, row in lines[index + 1 :] if not _is_comment(row))
            trimmed = tuple((m, _trimmed(cells, len(names))) for m, cells in rows)
            return Table(tuple(names), mark, n, trimmed, text.endswith(("\n", "\r")))
    return None


def _refuse_repetition(names: Sequence[str], path: Path, line: int) -> None:
    """Raise FileError for two columns whose names differ at most in case and in the unit in square brackets."""
    found: dict[str, str] = {}
    for name in names:
        plain = name.partition("[")[0].strip().lower()
        if plain in found and plain and not is_number(plain):
            both = f"{name} twice" if found[plain] == name else f"both {found[plain]} and {name}"
            raise FileError(f"{path}:{line}: the header has {both}; keep one of the columns.")
        found[plain] = name


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(COMMENT)


def _names(heading: str, separator: str | None, path: Path, line: int) -> list[str]:
    """Column names of a header; if they are separated by white space, a unit in brackets belongs to the name."""
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
