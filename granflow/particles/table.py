"""Particle tables: text with named columns in common formats, or a VTU frame."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path

import numpy as np

from granflow.errors import SceneError
from granflow.io.regular_files import read_regular_text
from granflow.io.vtu_reader import VtuError, read_vtu
from granflow.scene.schema.units import UnitError, to_si

LARGEST_FILE = 2**30
"""Largest file size [B]: about ten million particles."""

MOST_SHOWN = 20
"""Largest number of problems shown per file; the message gives the number of the others."""

RowProblem = tuple[int, str]
"""Line number and error message."""

AXES = "xyz"
COLUMN_NAMES = {
    "position": ("", "p", "pos", "position", "point", "points", "coord", "coordinate", "coordinates", "center"),
    "velocity": ("v", "vel", "velocity"),
    "angular_velocity": ("w", "omega", "spin", "angular_velocity", "angvel", "angularvelocity"),
}
"""Names of each vector without its axis, in lowercase without punctuation; with an empty name, the axis alone."""

SIZE_NAMES = {"radius": ("r", "rad", "radius"), "diameter": ("d", "dia", "diam", "diameter")}
"""Names of the column with the size of the particles."""

MATERIAL_NAMES = ("material", "mat", "materialname", "materialid")
"""Names of the column with the material: its name, or its number in the scene."""

DIMENSIONS = {
    "position": "length",
    "radius": "length",
    "diameter": "length",
    "velocity": "velocity",
    "angular_velocity": "angular_velocity",
}
"""Dimension of each quantity, in which the unit of its columns is converted to SI."""

_UNIT = re.compile(r"\s*[\[(]([^\])]*)[\])]\s*$")


@dataclass(frozen=True)
class ParticleTable:
    """Arrays of the n particles of a file.

    `position` (n, 3) [m], `radius` (n,) [m]; `velocity` (n, 3) [m/s], `angular_velocity` (n, 3) [rad/s] and `material`
    (n,) (text), or None if the file does not have them; `line` (n,): line number from 1, or for a frame the point
    number from 0. Floats are float64.
    """

    path: Path
    position: np.ndarray
    radius: np.ndarray
    velocity: np.ndarray | None
    angular_velocity: np.ndarray | None
    material: np.ndarray | None
    line: np.ndarray

    def __len__(self) -> int:
        return len(self.radius)

    def subset(self, selection: np.ndarray) -> "ParticleTable":
        """The rows selected by indices (k,) or by a mask (n,) bool, as a new table."""
        optional = (self.velocity, self.angular_velocity, self.material)
        velocity, angular_velocity, material = (None if each is None else each[selection] for each in optional)
        return ParticleTable(
            self.path,
            self.position[selection],
            self.radius[selection],
            velocity,
            angular_velocity,
            material,
            self.line[selection],
        )


def read_table(path: Path) -> ParticleTable:
    """The particles in a file: text (CSV or columns separated by semicolons, tabs or spaces), or a VTU frame.

    Numbers are converted to SI by the units in the header; without a unit they are SI. A file is read once per
    modification time and size (cache).

    Raises SceneError with a message for each invalid row, up to `MOST_SHOWN`, or one message if the file is not
    readable, too large, or has no particles.
    """
    try:
        status = path.stat()
        if not path.is_file():
            raise SceneError(f"{path}: this is not a regular file; give a table of particles.")
        if status.st_size > LARGEST_FILE:
            raise SceneError(f"{path}: this file is larger than {LARGEST_FILE // 2**30} GiB, too large for a table.")
        return _read(path, status.st_mtime_ns, status.st_size)
    except FileNotFoundError:
        raise SceneError(f"{path}: there is no such file.") from None
    except OSError as error:
        raise SceneError(f"{path}: the file cannot be read: {error.strerror}.") from None


@lru_cache(maxsize=4)
def _read(path: Path, changed: int, size: int) -> ParticleTable:
    """Content of a file; the cache key includes its modification time `changed` [ns] and its size [B].

    Raises SceneError with at most MOST_SHOWN invalid rows, or if the file contains no particles.
    """
    table, problems = _frame(path) if path.suffix.lower() == ".vtu" else _text(path)
    problems = [*problems, *_value_problems(table)]
    if problems:
        shown = [f"{path}:{line}: {sentence}" for line, sentence in problems[:MOST_SHOWN]]
        more = len(problems) - MOST_SHOWN
        raise SceneError([*shown, *([f"{path}: {more} more rows have problems, which are not shown."] * (more > 0))])
    if not len(table):
        raise SceneError(f"{path}: the file contains no particles.")
    return table


def _value_problems(table: ParticleTable) -> Iterator[RowProblem]:
    """Values that are not finite, and radii that are not positive."""
    for name in ("position", "radius", "velocity", "angular_velocity"):
        values = getattr(table, name)
        if values is not None:
            bad = ~np.isfinite(np.atleast_2d(values.T)).all(axis=0)
            yield from ((int(line), f"the {name} is not finite.") for line in table.line[bad])
    yield from ((int(line), "the radius must be above 0.") for line in table.line[table.radius <= 0.0])


def _frame(path: Path) -> tuple[ParticleTable, list[RowProblem]]:
    """Particles of a VTU file: points with `radius` or `diameter`, optionally velocities and `material`.

    `radius` has priority. Raises SceneError for a missing array or one with another number of components.
    """
    try:
        mesh = read_vtu(path, LARGEST_FILE)
    except VtuError as error:
        raise SceneError(f"{path}: this file {error}.") from None
    data = mesh.point_data
    known = [name for name in ("radius", "diameter") if name in data]
    if not known:
        raise SceneError(f"{path}: the points have no array radius; their arrays are: {', '.join(data) or 'none'}.")
    count = len(mesh.points)
    for name in (known[0], *COLUMN_NAMES):
        if name in data and data[name].size != count * (3 if name in COLUMN_NAMES else 1):
            raise SceneError(
                f"{path}: the array {name} has {data[name].size // max(count, 1)} components per point, "
                f"but {3 if name in COLUMN_NAMES else 1} are expected."
            )
    radius = np.asarray(data[known[0]], float).reshape(count) * (0.5 if known[0] == "diameter" else 1.0)
    vectors = {name: np.asarray(data[name], float).reshape(count, 3) if name in data else None for name in COLUMN_NAMES}
    material = np.asarray(data["material"]).astype(str) if "material" in data else None
    position = np.asarray(mesh.points, float)
    table = ParticleTable(
        path, position, radius, vectors["velocity"], vectors["angular_velocity"], material, np.arange(count)
    )
    return table, []


@dataclass(frozen=True)
class _Heading:
    """Content of the header line: separator, column names, columns of each quantity, and factors to SI.

    `separator`: None for white space; `columns`, `factors`: quantity -> one entry per component.
    """

    separator: str | None
    names: list[str]
    columns: dict[str, list[int]]
    factors: dict[str, list[float]]

    def cells(self, line: str) -> list[str]:
        """The cells of a line, without an empty last cell."""
        cells = [cell.strip().strip('"') for cell in line.strip().split(self.separator)]
        return cells[:-1] if len(cells) == len(self.names) + 1 and not cells[-1] else cells


def _text(path: Path) -> tuple[ParticleTable, list[RowProblem]]:
    """Particles of a text file, and the problems of its rows, sorted by line. Lines that begin with # are comments."""
    lines = read_regular_text(path, LARGEST_FILE).splitlines()
    heading, first = _heading(path, lines)
    numbered = [(n, line) for n, line in enumerate(lines[first:], first + 1) if line.strip() and line.strip()[0] != "#"]
    rows = [(n, heading.cells(line)) for n, line in numbered]
    width = len(heading.names)
    problems = [
        (n, f"the row has {len(row)} values, but the header has {width} columns.")
        for n, row in rows
        if len(row) != width
    ]
    complete_rows = [(n, row) for n, row in rows if len(row) == width]
    cells = [row for _, row in complete_rows]
    numbers = {}
    for name, columns in heading.columns.items():
        if name != "material":
            found = [_column(complete_rows, column, heading, problems) for column in columns]
            numbers[name] = np.stack(found, axis=1) * heading.factors[name]
    radius = numbers["radius"] if "radius" in numbers else 0.5 * numbers["diameter"]
    material_names = [row[heading.columns["material"][0]] for row in cells] if "material" in heading.columns else None
    line = np.array([n for n, _ in complete_rows], dtype=np.int64)
    material = None if material_names is None else np.array(material_names, dtype=str)
    motion_columns = numbers.get("velocity"), numbers.get("angular_velocity")
    return ParticleTable(path, numbers["position"], radius.reshape(-1), *motion_columns, material, line), sorted(
        problems
    )


def _column(
    rows: Sequence[tuple[int, list[str]]], column: int, heading: _Heading, problems: list[RowProblem]
) -> np.ndarray:
    """One column as numbers (n,), not yet in SI; an invalid cell becomes 0 and adds a problem.

    If the separator is not a comma, a decimal comma is accepted.
    """
    cells = [row[column] for _, row in rows]
    if heading.separator != ",":
        cells = [cell.replace(",", ".") for cell in cells]
    try:
        return np.array(cells, dtype=str).astype(float)
    except ValueError:
        return np.array(
            [_number(cell, row, heading.names[column], problems) for cell, row in zip(cells, rows, strict=True)]
        )


def _number(cell: str, row: tuple[int, list[str]], name: str, problems: list[RowProblem]) -> float:
    """A cell as a number; 0 and a problem if it is none."""
    try:
        return float(cell)
    except ValueError:
        problems.append((row[0], f"{name} is {cell or 'empty'}, but a number is expected."))
        return 0.0


def _heading(path: Path, lines: Sequence[str]) -> tuple[_Heading, int]:
    """The header line, with or without a leading #, and the number of lines up to and including it.

    Separators are tried in the order semicolon, comma, tab, white space. Raises SceneError if the first line that is
    not a comment is not a header, or if a unit is invalid.
    """
    nonempty = [(n, line) for n, line in enumerate(lines) if line.strip()]
    for n, line in islice(nonempty, 100):
        text = line.strip().lstrip("#")
        for separator in (";", ",", "\t", None):
            names = _names(text, separator)
            columns = _columns(names)
            if "position" in columns and ("radius" in columns or "diameter" in columns):
                factors = {key: [_factor(path, n + 1, names[c], key) for c in each] for key, each in columns.items()}
                return _Heading(separator, names, columns, factors), n + 1
        if not line.strip().startswith("#"):
            shown = " ".join(line.split())[:60]
            required = "x, y, z and r (or radius, or diameter)"
            raise SceneError(
                f"{path}:{n + 1}: the first line must be a header with the columns {required}, but it is {shown}."
            )
    raise SceneError(f"{path}: the file contains no particles.")


def _names(text: str, separator: str | None) -> list[str]:
    """Column names, each with its unit in brackets."""
    joined = re.sub(r"\s+(?=[\[(])", "", text.strip())
    names = [name.strip().strip('"') for name in joined.split(separator)]
    return names[:-1] if len(names) > 1 and not names[-1] else names


def _columns(names: Sequence[str]) -> dict[str, list[int]]:
    """Column numbers of each quantity whose components are complete.

    Names are compared in lowercase without units and punctuation, so that "Velocity:0", "v_x" and "vx [m/s]" are
    recognized; see COLUMN_NAMES.
    """
    plain = [re.sub(r"[^a-z0-9]", "", _UNIT.sub("", name).lower()) for name in names]
    wanted = {
        quantity: [
            [name for word in words for name in (word + axis, axis + word, *([f"{word}{k}"] if word else []))]
            for k, axis in enumerate(AXES)
        ]
        for quantity, words in COLUMN_NAMES.items()
    }
    wanted |= {name: [list(words)] for name, words in SIZE_NAMES.items()} | {"material": [list(MATERIAL_NAMES)]}
    found = {}
    for quantity, components in wanted.items():
        columns = [next((c for c, name in enumerate(plain) if name in words), None) for words in components]
        if None not in columns:
            found[quantity] = [c for c in columns if c is not None]
    return found


def _factor(path: Path, line: int, name: str, quantity: str) -> float:
    """Factor of a column to SI, from the unit after its name; 1 without a unit.

    Raises SceneError for an invalid unit.
    """
    unit = _UNIT.search(name)
    if unit is None or quantity == "material" or not unit[1].strip():
        return 1.0
    try:
        return to_si(f"1 {unit[1].strip()}", DIMENSIONS[quantity])
    except UnitError as error:
        raise SceneError(f"{path}:{line}: the unit of {name} is invalid: {error}.") from None
