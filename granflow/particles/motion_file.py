"""Motions of walls from CSV files: the rows of a file become the columns of the motion in the resolved scene."""

from pathlib import Path

import numpy as np

from granflow.errors import FileError, SceneError
from granflow.io.regular_files import FormatError, resolved
from granflow.io.tables import Table, read_table
from granflow.particles.table import UNIT, unit_factor
from granflow.scene.schema.motions import MOST_ROWS, TABLE_COLUMNS, TableMotion
from granflow.scene.schema.scene import SceneInput
from granflow.scene.suggest import nearest

NAMES = {
    "time": "times",
    "displacement": "displacements",
    "velocity": "velocities",
    "angle": "angles",
    "angular_velocity": "angular_velocities",
}
"""Names of the columns of a file, and the keys of the motion."""

DIMENSIONS = {"times": "time"} | TABLE_COLUMNS
"""Dimension of each key."""


def with_motion_files(scene: SceneInput, read: bool) -> SceneInput:
    """The scene with the columns of all motions from files.

    `read`: read existing files again even if the scene has their columns. Raises SceneError with the problems of all
    files.
    """
    walls, problems = dict(scene.walls), list[str]()
    for name, wall in scene.walls.items():
        motions = list(wall.motion)
        for index, motion in enumerate(motions):
            if isinstance(motion, TableMotion) and motion.file is not None:
                known = motion.times is not None and not (read and (scene.folder / motion.file).exists())
                location = scene.locate("walls", name, "motion", index, "file")
                key = f"walls.{name}.motion.file"
                try:
                    motions[index] = motion if known else _with_columns(scene.folder, motion)
                except FileError as error:
                    problems += error.problems
                except (FormatError, OSError) as error:
                    reason = error.strerror if isinstance(error, OSError) else str(error)
                    problems.append(f"{location}: {key} is {motion.file}, which cannot be used: {reason}.")
        walls[name] = wall.model_copy(update={"motion": tuple(motions)})
    if problems:
        raise SceneError(problems)
    return scene.model_copy(update={"walls": walls})


def _with_columns(folder: Path, motion: TableMotion) -> TableMotion:
    """The motion with the columns of its file.

    Raises OSError or FormatError if the file cannot be read, and FileError for an invalid table.
    """
    path = resolved(folder / str(motion.file))
    if not path.exists():
        raise FormatError("there is no such file; its path is relative to the folder of the scene")
    table, source = read_table(path), folder / str(motion.file)
    if table is None or not table.rows:
        raise FileError([f"{source}: the table has no rows; give a header such as time [s], displacement [m]."])
    columns = _columns(source, table)
    if len(table.rows) > MOST_ROWS:
        raise FileError([f"{source}: the table has {len(table.rows)} rows, and the limit is {MOST_ROWS}."])
    return motion.model_copy(update=dict.fromkeys(TABLE_COLUMNS) | columns)


def _columns(path: Path, table: Table) -> dict[str, tuple[float, ...]]:
    """Columns of the motion by key [SI]. Raises FileError for the header or the first invalid row."""
    indices: dict[str, tuple[int, float]] = {}
    for index, heading in enumerate(table.names):
        key = NAMES.get(UNIT.sub("", heading).strip().lower())
        if key is not None:
            indices[key] = index, unit_factor(path, table, index, DIMENSIONS[key])
    given = [name for name in TABLE_COLUMNS if name in indices]
    if "times" not in indices or len(given) != 1:
        unknown = next((name for name in table.names if nearest(name, NAMES) and name not in NAMES), None)
        hint = f" Did you mean {nearest(unknown, NAMES)} instead of {unknown}?" if unknown else ""
        raise FileError(
            [
                f"{path}:{table.heading_line}: the columns are {', '.join(table.names)}, but time and exactly one of "
                f"{', '.join(list(NAMES)[1:])} are expected, with units such as time [s], displacement [mm].{hint}"
            ]
        )
    short = next((line for line, cells in table.rows if len(cells) != len(table.names)), None)
    if short is not None:
        raise FileError([f"{path}:{short}: the row must have {len(table.names)} values, as the header."])
    columns = {key: table.numbers(index) * factor for key, (index, factor) in indices.items()}
    invalid = ~np.all([np.isfinite(values) for values in columns.values()], axis=0)
    if invalid.any():
        raise FileError([f"{path}:{table.rows[int(invalid.argmax())][0]}: a finite number is expected in each column."])
    late = np.diff(columns["times"]) <= 0.0
    if late.any() or columns["times"][0] < 0.0:
        line = table.rows[int(late.argmax()) + 1 if late.any() else 0][0]
        raise FileError([f"{path}:{line}: times must ascend from row to row, from 0 or later on."])
    if len(table.rows) < 2:
        raise FileError([f"{path}: the table must have at least two rows."])
    return {key: tuple(values.tolist()) for key, values in columns.items()}
