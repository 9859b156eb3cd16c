"""Measured restitution as a function of velocity, read from a CSV file; all invalid rows are reported."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np

from granflow.errors import FileError, GranflowError
from granflow.io.regular_files import read_regular
from granflow.io.tables import table_in
from granflow.scene.schema.units import UnitError, to_si, with_unit

HEADINGS = {
    "velocity": ("velocity", "v", "approach_velocity", "impact_velocity"),
    "restitution": ("restitution", "e", "restitution_coefficient"),
    "deviation": ("deviation", "standard_deviation", "error", "std"),
    "weight": ("weight", "w"),
}
"""Accepted names of each column; the first one is preferred."""

DIMENSION = {"velocity": "velocity", "restitution": "number", "deviation": "number", "weight": "number"}
"""Dimension of each column, in which units of values are converted to SI."""

LARGEST_FILE = 2**26
"""Maximum size of a file in bytes; sufficient for more than a million measurements."""

SEPARATORS = (";", "\t", ",")
"""Separators of cells, in the order of precedence."""


@dataclass(frozen=True)
class Measurements:
    """Rows of a file: approach velocity (n,) [m/s], restitution (n,), and uncertainty of the restitution (n,).

    `uncertainty` is the standard deviation; if `absolute` is False, only its ratios are meaningful.
    """

    velocity: np.ndarray
    restitution: np.ndarray
    uncertainty: np.ndarray
    absolute: bool

    def __len__(self) -> int:
        return len(self.velocity)


def read_measurements(path: Path) -> Measurements:
    """Read a table with the columns `velocity` and `restitution`, and optionally `deviation` or `weight`.

    Columns are separated by commas, semicolons or tabs; empty lines and lines that begin with # are ignored; a value
    or the name of a column may have a unit. Velocities are converted to m/s.

    Raises FileError with all invalid rows as `file:line: sentence`, and GranflowError if the file is not UTF-8 text.
    """
    table_read = table_in(_text(path), path, SEPARATORS)
    if table_read is None:
        raise FileError(f"{path}: the file has no rows; the first row must name the columns: velocity,restitution.")
    width = len(table_read.names)
    columns = _columns(path, table_read.heading_line, table_read.names)
    units = _units(path, table_read.heading_line, table_read.names, columns)
    problems: list[str] = []
    values: list[dict[str, float]] = []
    for line, cells in table_read.rows:
        problems_of_row = _extra_cells(cells, width) or list(_read_row(cells, columns, units, values))
        problems.extend(f"{path}:{line}: {fault}." for fault in problems_of_row)
    if problems:
        raise FileError(problems)
    if not values:
        raise FileError(f"{path}: the file has no measurements below the header.")
    table = {name: np.array([row[name] for row in values]) for name in columns}
    return Measurements(table["velocity"], table["restitution"], _spread(table), "deviation" in table)


def _spread(table: Mapping[str, np.ndarray]) -> np.ndarray:
    """Uncertainty (n,) of each row: the given deviation, 1 / sqrt(weight), or 1."""
    if "deviation" in table:
        return table["deviation"]
    return 1.0 / np.sqrt(table["weight"]) if "weight" in table else np.ones(len(table["velocity"]))


def _text(path: Path) -> str:
    """Text of a UTF-8 file, without a byte order mark. Raises GranflowError for another encoding."""
    try:
        return read_regular(path, LARGEST_FILE).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise GranflowError(f"{path} is not UTF-8 text; save it as CSV in UTF-8.") from None


def _columns(path: Path, line: int, cells: Sequence[str]) -> dict[str, int]:
    """Index of each known column by its name in HEADINGS.

    Units in brackets are no part of the names. Raises FileError if a column is missing or duplicated.
    """
    names = [cell.split("[")[0].split("(")[0].strip().lower().replace(" ", "_") for cell in cells]
    found: dict[str, int] = {}
    for name, aliases in HEADINGS.items():
        columns = [n for n, each in enumerate(names) if each in aliases]
        if len(columns) > 1:
            raise FileError(f"{path}:{line}: the header has {len(columns)} columns for {name}; keep one.")
        if columns:
            found[name] = columns[0]
    missing = [name for name in ("velocity", "restitution") if name not in found]
    if missing:
        raise FileError(
            f"{path}:{line}: the header is {', '.join(cells)}, which does not name {' and '.join(missing)}; "
            "the first row must name the columns, such as velocity,restitution."
        )
    if "deviation" in found and "weight" in found:
        raise FileError(f"{path}:{line}: the header has both deviation and weight; keep one.")
    return found


def _units(path: Path, line: int, cells: Sequence[str], columns: Mapping[str, int]) -> dict[str, str]:
    """Unit of each column from its heading, empty without one. Raises FileError for a unit of another dimension."""
    units = {name: cells[place].replace("(", "[").partition("[")[2].rstrip(")] ") for name, place in columns.items()}
    for name, unit in units.items():
        try:
            to_si(with_unit("1", unit if unit not in ("-", "1") else ""), DIMENSION[name])
        except UnitError as error:
            raise FileError(f"{path}:{line}: the column of {name} is in {unit}, but {error}.") from None
    return {name: unit if unit not in ("-", "1") else "" for name, unit in units.items()}


def _extra_cells(cells: Sequence[str], width: int) -> list[str]:
    """Message for a row that is longer than the header."""
    if not any(cells[width:]):
        return []
    return [f"the row has {len(cells)} values, but the header has {width} columns; use a point as decimal separator"]


def _read_row(
    cells: Sequence[str], columns: Mapping[str, int], units: Mapping[str, str], values: list[dict[str, float]]
) -> Iterator[str]:
    """Append the numbers of a row to `values`; yield a message for each invalid number."""
    numbers = {}
    for name, place in columns.items():
        text = cells[place] if place < len(cells) else ""
        try:
            numbers[name] = _number(name, with_unit(text, units[name]))
        except UnitError as error:
            yield f"{name} is {text or 'empty'}, but {error}"
    if len(numbers) == len(columns):
        values.append(numbers)


def _number(name: str, text: str) -> float:
    """Number of a cell in SI units. Raises UnitError if it is missing, not finite or out of range."""
    value = to_si(text, DIMENSION[name]) if text else float("nan")
    if not isfinite(value):
        raise UnitError("a number is required; remove the row if nothing was measured")
    if name == "restitution" and not 0.0 <= value <= 1.0:
        raise UnitError("a restitution coefficient must be in [0, 1]")
    if name != "restitution" and not value > 0.0:
        raise UnitError("it must be above 0")
    return value
