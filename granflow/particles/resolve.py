"""Resolved scenes: defaults that depend on several parts or on files become plain numbers after reading.

Resolves motions, sieve curves and clumps from files first, then `scale`, then counts from masses, end times
and the duration, and summaries of particle files. Resolving is idempotent. The resolved scene is used for the
run and saved with it.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from math import pi
from pathlib import Path
from typing import Any, get_args

import numpy as np
from pydantic.fields import FieldInfo

from granflow.errors import FileError, SceneError
from granflow.geometry.close_pairs import near_pairs
from granflow.io.files import FormatError, resolved
from granflow.io.tables import UNIT, Table, read_table, unit_factor
from granflow.particles.file import ParticleTable, read_spheres, rows_of, unassigned_rows
from granflow.particles.group import SceneGroup, groups_of
from granflow.scene.blocks.insertions import FileSummary, TimedInsertion
from granflow.scene.blocks.motions import MOST_ROWS, TABLE_COLUMNS, TableMotion
from granflow.scene.blocks.particle_shapes.clump import MOST_SPHERES, Clump, ClumpSphere
from granflow.scene.blocks.particles import Group
from granflow.scene.blocks.scene import SceneInput
from granflow.scene.blocks.sizes import SizeDistribution
from granflow.schema.messages import nearest
from granflow.schema.model import Model
from granflow.schema.quantities import LARGEST, LARGEST_COUNT, SMALLEST, Number

ROUNDING_SHARE = 1e-9
"""Tolerance for rounding at the end of an insertion, as a fraction of one particle."""


def resolved_input(scene: SceneInput, read: bool) -> SceneInput:
    """The scene with all counts, at scale 1.

    `read`: read existing files again even if the scene has their content or summary, and check that each row
    of particle files belongs to a group. Remarks for the user are in `remarks` of the result. The argument is
    not modified.

    Raises SceneError with the problems of all groups.
    """
    scene, remarks = _at_scale_1(_with_files(scene, read))
    groups: dict[str, Group] = {}
    problems: list[str] = []
    given = groups_of(scene)
    for name, group in given.items():
        try:
            groups[name] = _resolved_group(group, read)
        except SceneError as error:
            problems += error.problems
    if read and not problems:
        problems += unassigned_rows(given.values())
    if problems:
        raise SceneError(problems)
    resolved_scene = scene.model_copy(update={"particles": groups})
    resolved_scene._remarks = (*scene.remarks, *remarks)
    return resolved_scene


def _resolved_group(group: SceneGroup, read: bool) -> Group:
    """One group with its count. Raises SceneError."""
    insertion = group.spec.insert
    if insertion.source is None:
        return _with_count(group)
    if insertion.summary is not None and not (read and (group.scene.folder / insertion.source).exists()):
        return group.spec
    return _with_rows(group)


def _at_scale_1(scene: SceneInput) -> tuple[SceneInput, list[str]]:
    """The scaled scene at scale 1, and remarks; only expectations with `any_scale` remain.

    Raises SceneError for groups with given positions, which cannot be scaled.
    """
    if scene.scale == 1.0:
        return scene, []
    for name, group in scene.particles.items():
        if group.insert.has_rows:
            raise SceneError(
                f"{scene.locate('scale')}: scale is {scene.scale:g}, but particles.{name} has given "
                "positions, which cannot be scaled; leave scale out."
            )
    scaled_scene = scaled(scene, scene.scale)
    kept = tuple(each for each in scene.expect if each.any_scale)
    prefix = f"scale {scene.scale:g}"
    factors = f"{scene.scale:g}, counts and masses of particles by {scene.scale**3:.4g}"
    remarks = [
        f"{prefix}: lengths of the equipment are multiplied by {factors}; diameters, velocities and times "
        "are not."
    ]
    if len(kept) < len(scene.expect):
        remarks.append(
            f"{prefix}: {len(scene.expect) - len(kept)} expectations apply to scale 1 only and are not "
            "evaluated."
        )
    return scaled_scene.model_copy(update={"scale": 1.0, "expect": kept}), remarks


def scaled(part: Any, factor: float) -> Any:
    """A part of a scene with lengths multiplied by `factor`, and numbers of particles by its cube.

    The types of the schema define the exponent of each number (`Number.scaling`). Numbers of particles are
    rounded, and are at least 1.
    """
    changes = {
        name: _scaled_value(getattr(part, name), _power(field), factor)
        for name, field in type(part).model_fields.items()
    }
    return part.model_copy(update=changes)


def _scaled_value(value: Any, power: int, factor: float) -> Any:
    """A value with all its numbers multiplied by `factor` to the given power; texts, flags and None are
    unchanged."""
    if isinstance(value, Model):
        return scaled(value, factor)
    if isinstance(value, dict):
        return {key: _scaled_value(each, power, factor) for key, each in value.items()}
    if isinstance(value, tuple):
        return tuple(_scaled_value(each, power, factor) for each in value)
    if not power or isinstance(value, bool | str) or value is None:
        return value
    scaled_number = value * factor**power
    return max(round(scaled_number), 1) if isinstance(value, int) else scaled_number


def _power(field: FieldInfo) -> int:
    """Exponent of the scale in the numbers of a field."""

    def powers(annotation: Any) -> Iterator[int]:
        if isinstance(annotation, Number):
            yield annotation.scaling
        for each in get_args(annotation):
            yield from powers(each)

    return max(
        (*powers(field.annotation), *(each for meta in field.metadata for each in powers(meta))), default=0
    )


def _with_count(group: SceneGroup) -> Group:
    """A group with its count, the smallest of those that result from a count, a mass and an end time.

    A flow without any of them ends with the run. Raises SceneError if the count exceeds LARGEST_COUNT.
    """
    counts = dict(_counts(group))
    key = min(counts, key=lambda key: counts[key])
    if counts[key] > LARGEST_COUNT:
        path = f"particles.{group.name}.{key}"
        raise SceneError(
            f"{group.locate(*key.split('.'))}: {path} results in {float(counts[key]):.3g} particles, but the "
            f"limit is {LARGEST_COUNT}."
        )
    if group.spec.flows_to_end:
        return group.spec.with_flow_of(counts[key])
    return group.spec.model_copy(update={"count_given": counts[key], "mass": None})


def _counts(group: SceneGroup) -> Iterator[tuple[str, int]]:
    """Number of particles that follows from each of the keys count, mass and insert.end, if given; without
    them, from the longest duration of the run, or of the stages of the flow, as its end.

    end of a flow: rate * (end - start), or the number with the mass mass_flow * (end - start)
    """
    spec = group.spec
    insertion = group.spec.insert
    if spec.count_given is not None:
        yield "count", spec.count_given
    if spec.mass is not None:
        yield "mass", _count_of_mass(group, spec.mass)
    if isinstance(insertion, TimedInsertion) and (insertion.end is not None or spec.flows_to_end):
        key = f"insert.{insertion.flow_key}" if insertion.end is None else "insert.end"
        end = group.scene.longest_duration if insertion.end is None else insertion.end
        duration = max(end - insertion.start, 0.0)
        if insertion.stages is not None:
            first, last = group.scene.stage_range(insertion.stages)
            duration = sum(stage.longest for stage in group.scene.schedule[first : last + 1])
        if insertion.rate is not None:
            yield key, max(int(np.ceil(min(insertion.rate * duration - ROUNDING_SHARE, 1e18))), 1)
        elif insertion.mass_flow is not None:
            yield key, _count_of_mass(group, insertion.mass_flow * duration)


def _count_of_mass(group: SceneGroup, mass: float) -> int:
    """Number of particles with a total mass [kg] nearest to the given one, for the sizes and the material of
    a group.

    sum d^3 = 6 m / (pi rho)
    """
    body = group.spec.shape.body
    if body is not None:
        return max(round(min(mass / (group.density * body.volume), 1e18)), 1)
    return group.spec.sizes.count_for_volume(6.0 / pi * mass / group.density, group.random)


def _with_rows(group: SceneGroup) -> Group:
    """A group from a file with the summary of the file. Raises SceneError for an inconsistent group."""
    rows = rows_of(group)
    problems = list(_inconsistencies(group, rows))
    if problems:
        raise SceneError(problems)
    overlap, overlap_rows = _overlap(group, rows)

    def largest(vectors: np.ndarray | None) -> float:
        return 0.0 if vectors is None else float(np.linalg.norm(vectors, axis=1).max())

    summary = FileSummary(
        count=len(rows),
        diameter_min=2.0 * float(rows.radius.min()),
        diameter_max=2.0 * float(rows.radius.max()),
        speed_max=largest(rows.velocity),
        angular_velocity_max=largest(rows.angular_velocity),
        overlap_max=overlap,
        overlap_rows=overlap_rows,
    )
    read_insertion = group.spec.insert.model_copy(update={"found": summary})
    return group.spec.model_copy(update={"count_given": len(rows), "insert": read_insertion})


def _inconsistencies(group: SceneGroup, rows: ParticleTable) -> Iterator[str]:
    """Contradictions between a group in the scene and the rows of its file, one sentence each."""
    spec = group.spec
    name = group.name
    if spec.count_given not in (None, len(rows)) and group.is_given("count"):
        location = group.locate("count")
        yield (
            f"{location}: particles.{name}.count is {spec.count_given}, but {rows.path} has {len(rows)} rows "
            "for it."
        )
    for key in ("velocity", "angular_velocity"):
        if getattr(rows, key) is not None and np.any(getattr(spec, key)):
            yield f"{group.locate(key)}: particles.{name}.{key} is in {rows.path} too; remove it."
    low, high = np.array(group.scene.domain.min), np.array(group.scene.domain.max)
    outside = ~np.all((rows.position >= low) & (rows.position <= high), axis=1)
    if outside.any():
        first = rows.line[outside][0]
        count = int(outside.sum())
        others = f" and {count - 1} more lie" if count > 1 else " lies"
        yield f"{rows.path}:{first}: this particle{others} outside the domain."


def _overlap(group: SceneGroup, rows: ParticleTable) -> tuple[float, str]:
    """Largest overlap over the smaller radius and the rows of that pair; 0 and no rows for fixed particles.

    (R_i + R_j - |x_i - x_j|) / min(R_i, R_j)
    """
    if group.spec.fixed:
        return 0.0, ""
    first, second = near_pairs(rows.position, rows.radius, 0.0)
    if not len(first):
        return 0.0, ""
    distance = np.linalg.norm(rows.position[first] - rows.position[second], axis=1)
    relative_overlap = (rows.radius[first] + rows.radius[second] - distance) / np.minimum(
        rows.radius[first], rows.radius[second]
    )
    worst = int(relative_overlap.argmax())
    kind = "points" if rows.path.suffix.lower() == ".vtu" else "lines"
    return float(relative_overlap[worst]), f"{kind} {rows.line[first[worst]]} and {rows.line[second[worst]]}"


# Motions of walls, size distributions and clumps from files, whose rows become values of the scene.


def _with_files(scene: SceneInput, read: bool) -> SceneInput:
    """The scene with the contents of all files of motions, size distributions and clumps.

    `read`: see `resolved_input`. Raises SceneError with the problems of all files.
    """
    walls, groups = dict(scene.walls), dict(scene.particles)
    problems = list[str]()

    def filled(
        place: tuple[str | int, ...], file: str, part: Any, is_known: bool, fill: Callable[[Path], Any]
    ) -> Any:
        """A part of the scene with the content of its file; unchanged if it is known or cannot be used."""
        if is_known and not (read and (scene.folder / file).exists()):
            return part
        try:
            return fill(_existing(scene.folder, file))
        except FileError as error:
            problems.extend(error.problems)
        except (FormatError, OSError) as error:
            key = ".".join(each for each in place if isinstance(each, str))
            reason = error.strerror if isinstance(error, OSError) else str(error)
            problems.append(f"{scene.locate(*place)}: {key} is {file}, which cannot be used: {reason}.")
        return part

    for name, wall in scene.walls.items():
        motions = list(wall.motion)
        for index, motion in enumerate(motions):
            if isinstance(motion, TableMotion) and motion.file is not None:
                motions[index] = filled(
                    ("walls", name, "motion", index, "file"),
                    motion.file,
                    motion,
                    motion.times is not None,
                    partial(_with_columns, motion),
                )
        walls[name] = wall.model_copy(update={"motion": tuple(motions)})
    for name, group in scene.particles.items():
        sizes, clump = group.diameter, group.clump
        if isinstance(sizes, SizeDistribution) and sizes.source is not None:
            place = ("particles", name, "diameter", "file")
            found = filled(place, sizes.source, sizes, sizes.is_read, sizes.read)
            groups[name] = groups[name].model_copy(update={"diameter": found})
        if clump is not None and clump.file is not None:
            place = ("particles", name, "clump", "file")
            is_known = clump.spheres is not None
            body = filled(place, clump.file, clump, is_known, partial(_with_spheres, clump))
            groups[name] = groups[name].model_copy(update={"clump": body})
    if problems:
        raise SceneError(problems)
    return scene.model_copy(update={"walls": walls, "particles": groups})


def _existing(folder: Path, file: str) -> Path:
    """The path of a file of the scene. Raises OSError for circular links, FormatError if there is no file."""
    path = folder / file
    if not resolved(path).exists():
        raise FormatError("there is no such file; its path is relative to the folder of the scene")
    return path


# Clumps: the rows of a file become the spheres.


def _with_spheres(clump: Clump, path: Path) -> Clump:
    """The clump with the spheres of its file.

    Raises SceneError for invalid rows, and FormatError for too many spheres.
    """
    table = read_spheres(path)
    if len(table) > MOST_SPHERES:
        raise FormatError(f"it has {len(table)} spheres, but the limit is {MOST_SPHERES}")
    centers, radii = clump.scale * table.position, clump.scale * table.radius
    far = (radii < SMALLEST) | (np.maximum(radii, np.abs(centers).max(axis=1)) > LARGEST)
    if far.any():
        raise SceneError(f"{path}:{table.line[far.argmax()]}: a length of this magnitude is out of range.")
    spheres = [
        ClumpSphere(position=center, radius=radius)
        for center, radius in zip(centers.tolist(), radii.tolist(), strict=True)
    ]
    return clump.model_copy(update={"spheres": tuple(spheres)})


# Motions: the columns of a file become the columns of the motion.

MOTION_KEYS = {
    "time": "times",
    "displacement": "displacements",
    "velocity": "velocities",
    "angle": "angles",
    "angular_velocity": "angular_velocities",
}
"""Names of the columns of a file, and the keys of the motion."""
MOTION_DIMENSIONS = {"times": "time"} | TABLE_COLUMNS
"""Dimension of each key."""


def _with_columns(motion: TableMotion, path: Path) -> TableMotion:
    """The motion with the columns of its file.

    Raises OSError if the file cannot be read, and FileError for an invalid table.
    """
    table = read_table(path, lambda names: "times" in (keys := _motion_keys(names)) and len(keys) > 1)
    if table is None or not table.rows:
        raise FileError([f"{path}: the table has no rows; give a header such as time [s], displacement [m]."])
    columns = _motion_columns(path, table)
    if len(table.rows) > MOST_ROWS:
        raise FileError([f"{path}: the table has {len(table.rows)} rows, and the limit is {MOST_ROWS}."])
    turns = any(key.startswith("ang") for key in columns)
    if turns == (motion.direction is not None):
        given, needed = ("direction", "point and axis") if turns else ("point and axis", "direction")
        name = next(name for name, key in MOTION_KEYS.items() if key in columns and key != "times")
        reason = f"{name} requires {needed}, but the motion has {given}; give {needed}"
        raise FileError([f"{path}:{table.heading_line}: {reason}."])
    return motion.model_copy(update=dict.fromkeys(TABLE_COLUMNS) | columns)


def _motion_keys(names: Sequence[str]) -> dict[str, int]:
    """Keys of the motion and the columns that have them."""
    keys = {MOTION_KEYS.get(UNIT.sub("", name).strip().lower()): index for index, name in enumerate(names)}
    return {key: index for key, index in keys.items() if key is not None}


def _motion_columns(path: Path, table: Table) -> dict[str, tuple[float, ...]]:
    """Columns of the motion by key [SI]. Raises FileError for the header or the first invalid row."""
    indices = {
        key: (index, unit_factor(path, table, index, MOTION_DIMENSIONS[key]))
        for key, index in _motion_keys(table.names).items()
    }
    given = [name for name in TABLE_COLUMNS if name in indices]
    if "times" not in indices or len(given) != 1:
        unknown = next(
            (name for name in table.names if nearest(name, MOTION_KEYS) and name not in MOTION_KEYS), None
        )
        hint = f" Did you mean {nearest(unknown, MOTION_KEYS)} instead of {unknown}?" if unknown else ""
        raise FileError(
            [
                f"{path}:{table.heading_line}: the columns are {', '.join(table.names)}, but time and "
                f"exactly one of {', '.join(list(MOTION_KEYS)[1:])} are expected, with units such as time "
                f"[s], displacement [mm].{hint}"
            ]
        )
    short = next((line for line, cells in table.rows if len(cells) != len(table.names)), None)
    if short is not None:
        raise FileError([f"{path}:{short}: the row must have {len(table.names)} values, as the header."])
    columns = {key: table.numbers(index) * factor for key, (index, factor) in indices.items()}
    invalid = ~np.all([np.isfinite(values) for values in columns.values()], axis=0)
    if invalid.any():
        raise FileError(
            [f"{path}:{table.rows[int(invalid.argmax())][0]}: a finite number is expected in each column."]
        )
    late = np.diff(columns["times"]) <= 0.0
    if late.any() or columns["times"][0] < 0.0:
        line = table.rows[int(late.argmax()) + 1 if late.any() else 0][0]
        raise FileError([f"{path}:{line}: times must ascend from row to row, from 0 or later on."])
    if len(table.rows) < 2:
        raise FileError([f"{path}: the table must have at least two rows."])
    return {key: tuple(values.tolist()) for key, values in columns.items()}
