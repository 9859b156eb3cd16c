"""Measured restitution against velocity, read from a CSV file; every bad row is named."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np

from granflow.errors import FileError, GranflowError
from granflow.regular_files import read_regular
from granflow.scene.units import UnitError, to_si

HEADINGS = {
    "velocity": ("velocity", "v", "approach_velocity", "impact_velocity"),
    "restitution": ("restitution", "e", "restitution_coefficient"),
    "deviation": ("deviation", "standard_deviation", "error", "std"),
    "weight": ("weight", "w"),
}
"""What a column may be called; the first name is the one to use."""

DIMENSION = {"velocity": "velocity", "restitution": "number", "deviation": "number", "weight": "number"}
LARGEST_FILE = 2**26
"""Bytes; more than a million measurements."""

SEPARATORS = (";", "\t", ",")


@dataclass(frozen=True)
class Measurements:
    """Rows of a file: approach velocity [m/s], restitution, and how far each restitution is to be trusted.

    `uncertainty` (n,) is its standard deviation, or a relative one where `absolute` is False.
    """

    velocity: np.ndarray
    restitution: np.ndarray
    uncertainty: np.ndarray
    absolute: bool

    def __len__(self) -> int:
        return len(self.velocity)


def read_measurements(path: Path) -> Measurements:
    """Read a table with the columns `velocity` and `restitution`, and `deviation` or `weight` if there is one.

    Columns are separated by commas, semicolons or tabs; lines that are empty or begin with # are left out; a value
    may carry its unit. Raises FileError with all bad rows as `file:line: sentence`.
    """
    rows = list(_rows(path, _text(path)))
    if not rows:
        raise FileError(f"{path}: there are no rows. The first names the columns: velocity,restitution.")
    columns, width = _columns(path, *rows[0]), len(rows[0][1])
    problems: list[str] = []
    values: list[dict[str, float]] = []
    for line, cells in rows[1:]:
        problems_of_row = _extra_cells(cells, width) or list(_read_row(cells, columns, values))
        problems.extend(f"{path}:{line}: {fault}." for fault in problems_of_row)
    if problems:
        raise FileError(problems)
    if not values:
        raise FileError(f"{path}: there are no measurements below the header.")
    table = {name: np.array([row[name] for row in values]) for name in columns}
    return Measurements(table["velocity"], table["restitution"], _spread(table), "deviation" in table)


def _spread(table: Mapping[str, np.ndarray]) -> np.ndarray:
    if "deviation" in table:
        return table["deviation"]
    return 1.0 / np.sqrt(table["weight"]) if "weight" in table else np.ones(len(table["velocity"]))


def _text(path: Path) -> str:
    try:
        return read_regular(path, LARGEST_FILE).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise GranflowError(f"{path} is not UTF-8 text: save it as CSV in UTF-8.") from None


def _rows(path: Path, text: str) -> Iterator[tuple[int, list[str]]]:
    """Line number and stripped cells of every row; the separator is that of the header."""
    nonempty = [
        (n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip() and not line.lstrip()[0] == "#"
    ]
    if not nonempty:
        return
    separator = next((mark for mark in SEPARATORS if mark in nonempty[0][1]), ",")
    for number, line in nonempty:
        try:
            cells = next(csv.reader([line.strip(" ")], delimiter=separator, skipinitialspace=True))
        except csv.Error as error:
            raise FileError(f"{path}:{number}: this row cannot be read: {error}.") from None
        yield number, [cell.strip() for cell in cells]


def _columns(path: Path, line: int, cells: Sequence[str]) -> dict[str, int]:
    """Where each known column stands. Raises FileError where one is missing or there twice."""
    names = [cell.split("[")[0].split("(")[0].strip().lower().replace(" ", "_") for cell in cells]
    found: dict[str, int] = {}
    for name, aliases in HEADINGS.items():
        columns = [n for n, each in enumerate(names) if each in aliases]
        if len(columns) > 1:
            raise FileError(f"{path}:{line}: the header has {len(columns)} columns for {name}: keep one.")
        if columns:
            found[name] = columns[0]
    missing = [name for name in ("velocity", "restitution") if name not in found]
    if missing:
        raise FileError(
            f"{path}:{line}: the header is {', '.join(cells)}, which does not name {' and '.join(missing)}: "
            "the first row names the columns, such as velocity,restitution."
        )
    if "deviation" in found and "weight" in found:
        raise FileError(f"{path}:{line}: the header has both deviation and weight: keep one.")
    return _unit_checked(path, line, cells, found)


def _unit_checked(path: Path, line: int, cells: Sequence[str], found: dict[str, int]) -> dict[str, int]:
    """The same columns. Raises FileError where a header names a unit other than m/s."""
    unit = cells[found["velocity"]].replace("(", "[").partition("[")[2].rstrip(")] ")
    if unit not in ("", "m/s"):
        raise FileError(
            f"{path}:{line}: the velocities are in {unit}, but m/s is asked: convert them, or write the unit "
            f"with each value, such as 500 {unit}."
        )
    return found


def _extra_cells(cells: Sequence[str], width: int) -> list[str]:
    """What is wrong with a row longer than the header."""
    if not any(cells[width:]):
        return []
    return [f"the row has {len(cells)} values, but the header {width} columns; decimals are written with a point"]


def _read_row(cells: Sequence[str], columns: Mapping[str, int], values: list[dict[str, float]]) -> Iterator[str]:
    """Add the numbers of a row to the values, or say what is wrong with each."""
    numbers = {}
    for name, place in columns.items():
        text = cells[place] if place < len(cells) else ""
        try:
            numbers[name] = _number(name, text)
        except UnitError as error:
            yield f"{name} is {text or 'empty'}, but {error}"
    if len(numbers) == len(columns):
        values.append(numbers)


def _number(name: str, text: str) -> float:
    value = to_si(text, DIMENSION[name]) if text else float("nan")
    if not isfinite(value):
        raise UnitError("a number is asked here; leave the row out if nothing was measured")
    if name == "restitution" and not 0.0 <= value <= 1.0:
        raise UnitError("a restitution coefficient lies in [0, 1]")
    if name != "restitution" and not value > 0.0:
        raise UnitError("it must be above 0")
    return value
