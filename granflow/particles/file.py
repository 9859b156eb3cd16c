"""Particles from files: tables of particles, the rows of each group, and its particles.

A table is text with named columns in the formats of common programs, or a VTU frame. Numbers are converted
to SI by the units in the header. Several groups can share a file with a column of materials.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from granflow.errors import FileError, SceneError
from granflow.io.files import FormatError, resolved
from granflow.io.tables import UNIT, Table, is_number, read_table, unit_factor
from granflow.io.vtu import read_vtu
from granflow.particles.group import ParticleData, SceneGroup, particles_of

# Tables of particles: text with named columns in common formats, or a VTU frame.

PLAIN_COLUMNS = ("x", "y", "z", "r")
"""Columns of the spheres of a clump in a file without a header."""
MOST_SHOWN = 20
"""Largest number of problems shown per file; the message gives the number of the others."""
RowProblem = tuple[int, str]
"""Line number and error message."""
COLUMN_NAMES = {
    "position": (
        "",
        "p",
        "pos",
        "position",
        "point",
        "points",
        "coord",
        "coordinate",
        "coordinates",
        "center",
    ),
    "velocity": ("v", "vel", "velocity"),
    "angular_velocity": ("w", "omega", "spin", "angular_velocity", "angvel", "angularvelocity"),
}
"""Names of each vector without its axis, in lowercase without punctuation; with an empty name, the axis
alone."""
SCALAR_NAMES = {
    "radius": ("r", "rad", "radius"),
    "diameter": ("d", "dia", "diam", "diameter"),
    "material": ("material", "mat", "materialname", "materialid"),
}
"""Names of the columns with the size of the particles, and with the material: its name, or its number in the
scene."""
COLUMN_DIMENSIONS = dict.fromkeys(("position", "radius", "diameter"), "length") | {
    name: name for name in ("velocity", "angular_velocity")
}
"""Dimension of each quantity, in which the unit of its columns is converted to SI."""
ROUNDING = 1e-4
"""Relative difference of a number that is given twice, in text with at least four digits."""


@dataclass(frozen=True)
class ParticleTable:
    """Arrays of the n particles of a file.

    `position` (n, 3) [m], `radius` (n,) [m]; `velocity` (n, 3) [m/s], `angular_velocity` (n, 3) [rad/s] and
    `material` (n,) (text), or None if the file does not have them; `line` (n,): line number from 1, or for a
    frame the point number from 0. Floats are float64.
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

    Numbers are converted to SI by the units in the header; without a unit they are SI. A file is read once
    per modification time and size (cache).

    Raises SceneError with a message for each invalid row, up to `MOST_SHOWN`, or one message if the file is
    not readable, too large, or has no particles.
    """
    return _read_once(path, True)


def read_spheres(path: Path) -> ParticleTable:
    """As `read_particles`, for the spheres of a clump: without a header, the columns are x, y, z and r.

    Other programs write such files, as those for `particletemplate/multisphere` of LIGGGHTS.
    """
    return _read_once(path, False)


def _read_once(path: Path, needs_header: bool) -> ParticleTable:
    try:
        status = path.stat()
        return _read(path, status.st_mtime_ns, status.st_size, needs_header)
    except FileError as error:
        raise SceneError(error.problems) from None
    except FileNotFoundError:
        raise SceneError(f"{path}: there is no such file.") from None
    except OSError as error:
        raise SceneError(f"{path}: the file cannot be read: {error.strerror}.") from None


@lru_cache(maxsize=4)
def _read(path: Path, changed: int, size: int, needs_header: bool) -> ParticleTable:
    """Content of a file; the cache key includes its modification time `changed` [ns] and its size [B].

    Raises SceneError with at most MOST_SHOWN invalid rows, or if the file contains no particles.
    """
    if path.suffix.lower() == ".pvtu":
        raise SceneError(
            f"{path}: particles are not read from the files of several ranks; save them as one .vtu file, "
            "for example in ParaView, or continue from the run with start_from."
        )
    problems: list[RowProblem] = []
    if path.suffix.lower() == ".vtu":
        table = _frame(path)
    else:
        table, problems = _text(path, needs_header)
    reported = {line for line, _ in problems}
    problems = [*problems, *(each for each in _value_problems(table) if each[0] not in reported)]
    if problems:
        shown = [f"{path}:{line}: {sentence}" for line, sentence in problems[:MOST_SHOWN]]
        more = len(problems) - MOST_SHOWN
        if more > 0:
            shown.append(f"{path}: {more} more rows have problems, which are not shown.")
        raise SceneError(shown)
    if not len(table):
        raise SceneError(f"{path}: the file contains no {_content(needs_header)}.")
    return table


def _content(is_of_particles: bool) -> str:
    return "particles" if is_of_particles else "spheres"


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
        mesh = read_vtu(path)
    except FormatError as error:
        raise SceneError(f"{path}: this file {error}.") from None
    data = mesh.point_data
    known = [name for name in ("radius", "diameter") if name in data]
    if not known:
        raise SceneError(
            f"{path}: the points have no array radius; their arrays are: {', '.join(data) or 'none'}."
        )
    count = len(mesh.points)
    if len(known) == 2 and data["radius"].size == data["diameter"].size == count:
        differs = _differ(2.0 * data["radius"].reshape(count), data["diameter"].reshape(count))
        if differs.any():
            raise SceneError(
                f"{path}: the arrays radius and diameter of point {int(differs.argmax())} contradict each "
                "other; keep one of them."
            )
    for name in (known[0], *COLUMN_NAMES):
        components = 3 if name in COLUMN_NAMES else 1
        if name in data and data[name].size != count * components:
            raise SceneError(
                f"{path}: the array {name} has {data[name].size // max(count, 1)} components per point, "
                f"but {components} are expected."
            )
    radius = np.asarray(data[known[0]], float).reshape(count) * (0.5 if known[0] == "diameter" else 1.0)

    def vectors(name: str) -> np.ndarray | None:
        return np.asarray(data[name], float).reshape(count, 3) if name in data else None

    return ParticleTable(
        path=path,
        position=np.asarray(mesh.points, float),
        radius=radius,
        velocity=vectors("velocity"),
        angular_velocity=vectors("angular_velocity"),
        material=np.asarray(data["material"]).astype(str) if "material" in data else None,
        line=np.arange(count),
    )


def _text(path: Path, needs_header: bool) -> tuple[ParticleTable, list[RowProblem]]:
    """Particles of a text file, and the problems of its rows, sorted by line. Raises SceneError for the
    header."""
    table = read_table(path, _is_header)
    if table is None:
        raise SceneError(f"{path}: the file contains no {_content(needs_header)}.")
    expected = f"the header in line {table.heading_line} has {len(table.names)} columns"
    first_row = [name if table.separator == "," else name.replace(",", ".") for name in table.names]
    if not needs_header and len(first_row) == len(PLAIN_COLUMNS) and all(map(is_number, first_row)):
        expected = f"{', '.join(PLAIN_COLUMNS)} are expected"
        first = (table.heading_line, list(table.names))
        table = replace(table, names=PLAIN_COLUMNS, heading_line=0, rows=(first, *table.rows))
    columns = _columns_by_quantity(table.names)
    width = len(table.names)
    if not _is_header(table.names):
        others = "" if needs_header else "have the numbers x, y, z and r of a sphere, or "
        raise SceneError(
            f"{path}:{table.heading_line}: the first line must {others}be a header with the columns x, y, z "
            f"and r (or radius, or diameter), but it is {(table.separator or ' ').join(table.names)[:60]}."
        )
    _refuse_incomplete(path, table)
    problems = [
        (line, f"the row has {len(cells)} values, but {expected}.")
        for line, cells in table.rows
        if len(cells) != width
    ]
    table = table.complete()
    problems += _contradictions(path, table)
    material = np.array(table.texts(columns.pop("material")[0]), dtype=str) if "material" in columns else None
    numbers = {}
    for quantity, indices in columns.items():
        factors = [unit_factor(path, table, index, COLUMN_DIMENSIONS[quantity]) for index in indices]
        values = [_numbers(table, index, problems) for index in indices]
        numbers[quantity] = np.stack(values, axis=1) * factors
    radius = numbers["radius"] if "radius" in numbers else 0.5 * numbers["diameter"]
    particles = ParticleTable(
        path=path,
        position=numbers["position"],
        radius=radius.reshape(-1),
        velocity=numbers.get("velocity"),
        angular_velocity=numbers.get("angular_velocity"),
        material=material,
        line=np.array([line for line, _ in table.rows], dtype=np.int64),
    )
    return particles, sorted(problems)


def _refuse_incomplete(path: Path, table: Table) -> None:
    """Raise SceneError for a vector of which the header has some components only."""
    for quantity, components in _matches(table.names).items():
        given = [table.names[columns[0]] for columns in components if columns]
        if 0 < len(given) < len(components):
            raise SceneError(
                f"{path}:{table.heading_line}: the header has {' and '.join(given)}, but not all three "
                f"components of the {quantity.replace('_', ' ')}; add the others, or remove it."
            )


def _contradictions(path: Path, table: Table) -> Iterator[RowProblem]:
    """The first row of each two columns that give different values for one number, such as radius and
    diameter."""
    matches = _matches(table.names)
    pairs = [
        (quantity, columns[0], other, 1.0)
        for quantity, components in matches.items()
        for columns in components
        for other in columns[1:]
    ]
    radius = matches["radius"][0]
    diameter = matches["diameter"][0]
    if radius and diameter:
        pairs.append(("diameter", radius[0], diameter[0], 2.0))
    for quantity, first, other, factor in pairs:
        if problem := _contradiction(path, table, quantity, first, other, factor):
            yield problem


def _contradiction(
    path: Path, table: Table, quantity: str, first: int, other: int, factor: float
) -> RowProblem | None:
    """The first row in which a column is not `factor` times another one, `other`; None without such a row."""
    if quantity == "material":
        differs = np.array(table.texts(first)) != np.array(table.texts(other))
    else:
        units = [unit_factor(path, table, index, COLUMN_DIMENSIONS[quantity]) for index in (first, other)]
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
            problems.append(
                (line, f"{table.names[index]} is {_quoted(cells[index])}, but a number is expected.")
            )
    return numbers


def _quoted(cell: str) -> str:
    """A cell for a message; in quotes unless it is a word, so that its punctuation is not that of the
    sentence."""
    return (cell if cell.isalnum() else f"'{cell}'") if cell else "empty"


def _columns_by_quantity(names: Sequence[str]) -> dict[str, list[int]]:
    """Column numbers of each quantity whose components are complete.

    Names are compared in lowercase without units and punctuation, so that "Velocity:0", "v_x" and "vx [m/s]"
    are recognized; see COLUMN_NAMES.
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
    columns = _columns_by_quantity(names)
    return "position" in columns and ("radius" in columns or "diameter" in columns)


# Particle groups from files: selection of the rows of each group, and their particles.


def table_of(group: SceneGroup) -> ParticleTable:
    """All rows of the file of a group.

    Raises ValueError for a group without a file, and SceneError if the file cannot be read or is invalid.
    """
    source = group.spec.insert.source
    if source is None:
        raise ValueError(f"{group.name} is not read from a file.")
    try:
        path = resolved(group.scene.folder / source)
    except OSError as error:
        raise SceneError(
            f"{group.scene.folder / source}: the file cannot be read: {error.strerror}."
        ) from None
    location = group.locate("insert", "file")
    if not path.exists():
        key = f"particles.{group.name}.insert.file"
        raise SceneError(
            f"{location}: {key} is {source}, but there is no such file; its path is relative to the "
            "folder of the scene."
        )
    return read_particles(group.scene.folder / source)


def rows_of(group: SceneGroup) -> ParticleTable:
    """The rows of a group: all, or those of its material (name or number) if the file has a material column.

    Raises SceneError if no row matches, or if the file cannot be read.
    """
    table = table_of(group)
    if table.material is None:
        return table
    is_own = np.isin(table.material, _material_names(group))
    if not is_own.any():
        location = group.locate("material")
        material = group.spec.material
        others = ", ".join(sorted(set(table.material.tolist()))[:5])
        raise SceneError(f"{location}: no row of {table.path} is of {material}; its materials are {others}.")
    return table.subset(is_own)


def unassigned_rows(groups: Iterable[SceneGroup]) -> list[str]:
    """An error message for each file with rows of a material that no group uses; missing files are
    skipped."""
    files: dict[str, list[SceneGroup]] = {}
    for group in groups:
        source = group.spec.insert.source
        if source is not None and (group.scene.folder / source).exists():
            files.setdefault(source, []).append(group)
    problems = []
    for sharing in files.values():
        table = table_of(sharing[0])
        if table.material is not None:
            used_materials = [known for group in sharing for known in _material_names(group)]
            unassigned = ~np.isin(table.material, used_materials)
            if unassigned.any():
                row = table.line[unassigned][0]
                material = table.material[unassigned][0]
                problems.append(
                    f"{table.path}:{row}: this particle is of {material}, but no group has this material; "
                    "add one."
                )
    return problems


def particles_from_file(group: SceneGroup) -> ParticleData:
    """The particles of a group from its file, in the order of its rows.

    Velocities are those of the file if it has them, otherwise those of the group; fixed particles are at
    rest. Raises SceneError if the number of rows has changed since the scene was resolved.
    """
    rows = rows_of(group)
    count = group.spec.count
    if len(rows) != count:
        raise SceneError(
            f"{rows.path}: this file has changed: it had {count} particles, and has {len(rows)} now."
        )
    particles = particles_of(group, rows.position, rows.radius)
    if group.spec.fixed:
        return particles
    moving = {
        key: getattr(rows, key) for key in ("velocity", "angular_velocity") if getattr(rows, key) is not None
    }
    return replace(particles, **moving)


def _material_names(group: SceneGroup) -> list[str]:
    """Names of the material of a group in a file: its name, or its number in the scene, from 0."""
    return [group.spec.material, str(group.material_number)]
