"""Particle tables: text with named columns in common formats, or a VTU frame."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from granflow.errors import FileError, SceneError
from granflow.io.regular_files import FormatError, read_regular_text
from granflow.io.tables import Table, is_number, table_in
from granflow.io.vtu import read_vtu
from granflow.scene.schema.units import UnitError, to_si

LARGEST_FILE = 2**30
"""Largest file size [B]: about ten million particles."""

MOST_SHOWN = 20
"""Largest number of problems shown per file; the message gives the number of the others."""

RowProblem = tuple[int, str]
"""Line number and error message."""

SEPARATORS = (";", ",", "\t", None)
"""Separators of text files, in the order in which they are tried; None stands for white space."""

COLUMN_NAMES = {
    "position": ("", "p", "pos", "position", "point", "points", "coord", "coordinate", "coordinates", "center"),
    "velocity": ("v", "vel", "velocity"),
    "angular_velocity": ("w", "omega", "spin", "angular_velocity", "angvel", "angularvelocity"),
}
"""Names of each vector without its axis, in lowercase without punctuation; with an empty name, the axis alone."""

SCALAR_NAMES = {
    "radius": ("r", "rad", "radius"),
    "diameter": ("d", "dia", "diam", "diameter"),
    "material": ("material", "mat", "materialname", "materialid"),
}
"""Names of the columns with the size of the particles, and with the material: its name, or its number in the scene."""

DIMENSIONS = dict.fromkeys(("position", "radius", "diameter"), "length") | {
    name: name for name in ("velocity", "angular_velocity")
}
"""Dimension of each quantity, in which the unit of its columns is converted to SI."""

ROUNDING = 1e-4
"""Relative difference of a number that is given twice, in text with at least four digits."""

UNIT = re.compile(r"\s*[\[(]([^\])]*)[\])]\s*$")


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
        arrays = {name: each for name, each in vars(self).items() if isinstance(each, np.ndarray)}
        return replace(self, **{name: each[selection] for name, each in arrays.items()})


def read_particles(path: Path) -> ParticleTable:
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
    except FileError as error:
        raise SceneError(error.problems) from None
    except FileNotFoundError:
        raise SceneError(f"{path}: there is no such file.") from None
    except OSError as error:
        raise SceneError(f"{path}: the file cannot be read: {error.strerror}.") from None


@lru_cache(maxsize=4)
def _read(path: Path, changed: int, size: int) -> ParticleTable:
    """Content of a file; the cache key includes its modification time `changed` [ns] and its size [B].

    Raises SceneError with at most MOST_SHOWN invalid rows, or if the file contains no particles.
    """
    if path.suffix.lower() == ".pvtu":
        raise SceneError(
            f"{path}: particles are not read from the files of several ranks; save them as one .vtu file, for example "
            "in ParaView, or continue from the run with start_from."
        )
    table, problems = (_frame(path), []) if path.suffix.lower() == ".vtu" else _text(path)
    reported = {line for line, _ in problems}
    problems = [*problems, *(each for each in _value_problems(table) if each[0] not in reported)]
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


def _frame(path: Path) -> ParticleTable:
    """Particles of a VTU file: points with `radius` or `diameter`, optionally velocities and `material`.

    `radius` has priority. Raises SceneError for a missing array or one with another number of components.
    """
    try:
        mesh = read_vtu(path, LARGEST_FILE)
    except FormatError as error:
        raise SceneError(f"{path}: this file {error}.") from None
    data = mesh.point_data
    known = [name for name in ("radius", "diameter") if name in data]
    if not known:
        raise SceneError(f"{path}: the points have no array radius; their arrays are: {', '.join(data) or 'none'}.")
    count = len(mesh.points)
    if len(known) == 2 and data["radius"].size == data["diameter"].size == count:
        differs = _differ(2.0 * data["radius"].reshape(count), data["diameter"].reshape(count))
        if differs.any():
            raise SceneError(
                f"{path}: the arrays radius and diameter of point {int(differs.argmax())} contradict each other; keep "
                "one of them."
            )
    for name in (known[0], *COLUMN_NAMES):
        components = 3 if name in COLUMN_NAMES else 1
        if name in data and data[name].size != count * components:
            raise SceneError(
                f"{path}: the array {name} has {data[name].size // max(count, 1)} components per point, "
                f"but {components} are expected."
            )
    radius = np.asarray(data[known[0]], float).reshape(count) * (0.5 if known[0] == "diameter" else 1.0)
    velocity, angular_velocity = (
        np.asarray(data[name], float).reshape(count, 3) if name in data else None
        for name in ("velocity", "angular_velocity")
    )
    material = np.asarray(data["material"]).astype(str) if "material" in data else None
    return ParticleTable(
        path, np.asarray(mesh.points, float), radius, velocity, angular_velocity, material, np.arange(count)
    )


def _text(path: Path) -> tuple[ParticleTable, list[RowProblem]]:
    """Particles of a text file, and the problems of its rows, sorted by line. Raises SceneError for the header."""
    table = table_in(read_regular_text(path, LARGEST_FILE), path, SEPARATORS, _is_header)
    if table is None:
        raise SceneError(f"{path}: the file contains no particles.")
    columns, width = _columns(table.names), len(table.names)
    if not _is_header(table.names):
        raise SceneError(
            f"{path}:{table.heading_line}: the first line must be a header with the columns x, y, z and r (or radius, "
            f"or diameter), but it is {(table.separator or ' ').join(table.names)[:60]}."
        )
    _refuse_incomplete(path, table)
    problems = [
        (line, f"the row has {len(cells)} values, but the header has {width} columns.")
        for line, cells in table.rows
        if len(cells) != width
    ]
    table = table.complete()
    problems += _contradictions(path, table)
    material = np.array(table.texts(columns.pop("material")[0]), dtype=str) if "material" in columns else None
    numbers = {}
    for quantity, indices in columns.items():
        factors = [unit_factor(path, table, index, DIMENSIONS[quantity]) for index in indices]
        values = [_numbers(table, index, problems) for index in indices]
        numbers[quantity] = np.stack(values, axis=1) * factors
    radius = numbers["radius"] if "radius" in numbers else 0.5 * numbers["diameter"]
    motion = numbers.get("velocity"), numbers.get("angular_velocity")
    line = np.array([line for line, _ in table.rows], dtype=np.int64)
    return ParticleTable(path, numbers["position"], radius.reshape(-1), *motion, material, line), sorted(problems)


def _refuse_incomplete(path: Path, table: Table) -> None:
    """Raise SceneError for a vector of which the header has some components only."""
    for quantity, components in _matches(table.names).items():
        given = [table.names[columns[0]] for columns in components if columns]
        if 0 < len(given) < len(components):
            raise SceneError(
                f"{path}:{table.heading_line}: the header has {' and '.join(given)}, but not all three components of "
                f"the {quantity.replace('_', ' ')}; add the others, or remove it."
            )


def _contradictions(path: Path, table: Table) -> Iterator[RowProblem]:
    """The first row of each two columns that give different values for one number, such as radius and diameter."""
    matches = _matches(table.names)
    pairs = [
        (quantity, columns[0], other, 1.0)
        for quantity, components in matches.items()
        for columns in components
        for other in columns[1:]
    ]
    (radius,), (diameter,) = matches["radius"], matches["diameter"]
    if radius and diameter:
        pairs.append(("diameter", radius[0], diameter[0], 2.0))
    for quantity, first, other, factor in pairs:
        if problem := _contradiction(path, table, quantity, first, other, factor):
            yield problem


def _contradiction(path: Path, table: Table, quantity: str, first: int, other: int, factor: float) -> RowProblem | None:
    """The first row in which a column is not `factor` times another one, `other`; None without such a row."""
    if quantity == "material":
        differs = np.array(table.texts(first)) != np.array(table.texts(other))
    else:
        units = [unit_factor(path, table, index, DIMENSIONS[quantity]) for index in (first, other)]
        differs = _differ(factor * units[0] * table.numbers(first), units[1] * table.numbers(other))
    if not differs.any():
        return None
    line, cells = table.rows[int(differs.argmax())]
    given = f"{table.names[first]} is {cells[first]}, but {table.names[other]} is {cells[other]}"
    return line, f"{given}: the columns contradict each other; keep one of them."


def _differ(first: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Whether numbers (n,) differ by more than the rounding of text with few digits; NaN does not differ."""
    return np.abs(first - other) > ROUNDING * np.maximum(np.abs(first), np.abs(other))


def _numbers(table: Table, index: int, problems: list[RowProblem]) -> np.ndarray:
    """A column as numbers (n,), not yet in SI; each cell that is not a number adds a problem."""
    numbers = table.numbers(index)
    for k in np.flatnonzero(np.isnan(numbers)):
        line, cells = table.rows[k]
        if not is_number(cells[index]):
            problems.append((line, f"{table.names[index]} is {cells[index] or 'empty'}, but a number is expected."))
    return numbers


def _columns(names: Sequence[str]) -> dict[str, list[int]]:
    """Column numbers of each quantity whose components are complete.

    Names are compared in lowercase without units and punctuation, so that "Velocity:0", "v_x" and "vx [m/s]" are
    recognized; see COLUMN_NAMES.
    """
    found = {}
    for quantity, components in _matches(names).items():
        columns = [matching[0] for matching in components if matching]
        if len(columns) == len(components):
            found[quantity] = columns
    return found


def _matches(names: Sequence[str]) -> dict[str, list[list[int]]]:
    """Numbers of all columns with a name of each component of each quantity."""
    plain = [re.sub(r"[^a-z0-9]", "", UNIT.sub("", name).lower()) for name in names]
    wanted: dict[str, list[Sequence[str]]] = {
        quantity: [
            [name for word in words for name in (word + axis, axis + word, *([f"{word}{k}"] if word else []))]
            for k, axis in enumerate("xyz")
        ]
        for quantity, words in COLUMN_NAMES.items()
    }
    wanted |= {name: [words] for name, words in SCALAR_NAMES.items()}
    return {
        quantity: [[column for column, name in enumerate(plain) if name in words] for words in components]
        for quantity, components in wanted.items()
    }


def _is_header(names: Sequence[str]) -> bool:
    """Whether the columns with these names define position and size."""
    columns = _columns(names)
    return "position" in columns and ("radius" in columns or "diameter" in columns)


def unit_factor(path: Path, table: Table, index: int, dimension: str) -> float:
    """Factor of a column of a dimension to SI, from the unit after its name; 1 without a unit.

    Raises SceneError for an invalid unit.
    """
    name = table.names[index]
    unit = UNIT.search(name)
    if unit is None or not unit[1].strip():
        return 1.0
    try:
        return to_si(f"1 {unit[1].strip()}", dimension)
    except UnitError as error:
        raise SceneError(f"{path}:{table.heading_line}: the unit of {name} is invalid: {error}.") from None
