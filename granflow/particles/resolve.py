"""Resolved scenes: defaults that depend on several parts or on files become plain numbers after reading.

Resolves counts from masses and end times, summaries of particle files, tables of motions, and `scale`.
Resolving is idempotent. The resolved scene is used for the run and saved with it.
"""

from collections.abc import Iterator
from math import pi
from typing import Any, get_args

import numpy as np
from pydantic.fields import FieldInfo

from granflow.errors import SceneError
from granflow.particles.close_pairs import near_pairs
from granflow.particles.file import ParticleTable, rows_of, unassigned_rows, with_motion_files
from granflow.particles.group import SceneGroup, groups_of
from granflow.particles.sizes import count_for_volume
from granflow.scene.blocks.particles import FileInsertion, FileSummary, Group, InletInsertion, RainInsertion
from granflow.scene.blocks.quantities import LARGEST_COUNT, Number
from granflow.scene.blocks.scene import SceneInput
from granflow.scene.model import Model

ROUNDING_SHARE = 1e-9
"""Tolerance for rounding at the end of an insertion, as a fraction of one particle."""


def resolved_input(scene: SceneInput, read: bool) -> SceneInput:
    """The scene with all counts, at scale 1.

    `read`: read existing particle files again even if the scene has their summary, and check that each of
    their rows belongs to a group. Remarks for the user are in `remarks` of the result. The argument is not
    modified.

    Raises SceneError with the problems of all groups.
    """
    scene, remarks = _at_scale_1(with_motion_files(scene, read))
    groups: dict[str, Group] = {}
    problems: list[str] = []
    given = groups_of(scene)
    for name, group in given.items():
        try:
            groups[name] = _resolved_group(group, read)
        except SceneError as error:
            problems += error.problems
    problems += [] if problems or not read else unassigned_rows(given.values())
    if problems:
        raise SceneError(problems)
    resolved_scene = scene.model_copy(update={"particles": groups})
    resolved_scene._remarks = (*scene.remarks, *remarks)
    return resolved_scene


def _resolved_group(group: SceneGroup, read: bool) -> Group:
    """One group with its count. Raises SceneError."""
    insertion = group.spec.insert
    if not isinstance(insertion, FileInsertion):
        return _with_count(group)
    if insertion.found is not None and not (read and (group.folder / insertion.file).exists()):
        return group.spec
    return _with_rows(group, insertion)


def _at_scale_1(scene: SceneInput) -> tuple[SceneInput, list[str]]:
    """The scaled scene at scale 1, and remarks; only expectations with `any_scale` remain.

    Raises SceneError for groups with given positions, which cannot be scaled.
    """
    if scene.scale == 1.0:
        return scene, []
    for name, group in scene.particles.items():
        if group.insert.kind in ("positions", "file"):
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
    """A group with a count, a mass or an end time: its count is the smallest of the resulting counts.

    Raises SceneError if the count exceeds LARGEST_COUNT.
    """
    counts = dict(_counts(group))
    key = min(counts, key=lambda key: counts[key])
    if counts[key] > LARGEST_COUNT:
        path = f"particles.{group.name}.{key}"
        raise SceneError(
            f"{group.locate(*key.split('.'))}: {path} results in {float(counts[key]):.3g} particles, but the "
            f"limit is {LARGEST_COUNT}."
        )
    return group.spec.model_copy(update={"count_given": counts[key], "mass": None})


def _counts(group: SceneGroup) -> Iterator[tuple[str, int]]:
    """Number of particles that follows from each of the keys count, mass and insert.end, if given.

    insert.end: rate * (end - start), or the number with the mass mass_flow * (end - start)
    """
    spec = group.spec
    insertion = group.spec.insert
    if spec.count_given is not None:
        yield "count", spec.count_given
    if spec.mass is not None:
        yield "mass", _count_of_mass(group, spec.mass)
    if isinstance(insertion, RainInsertion | InletInsertion) and insertion.end is not None:
        duration = insertion.end - insertion.start
        if insertion.rate is not None:
            yield "insert.end", max(int(np.ceil(min(insertion.rate * duration - ROUNDING_SHARE, 1e18))), 1)
        elif insertion.mass_flow is not None:
            yield "insert.end", _count_of_mass(group, insertion.mass_flow * duration)


def _count_of_mass(group: SceneGroup, mass: float) -> int:
    """Number of particles with a total mass [kg] nearest to the given one, for the sizes and the material of
    a group.

    sum d^3 = 6 m / (pi rho)
    """
    if group.particle_mass is not None:
        return max(round(min(mass / group.particle_mass, 1e18)), 1)
    return count_for_volume(group.spec.sizes, 6.0 / pi * mass / group.density, group.random)


def _with_rows(group: SceneGroup, insertion: FileInsertion) -> Group:
    """A group from a file with the summary of the file. Raises SceneError for an inconsistent group."""
    rows = rows_of(group)
    problems = [*_inconsistencies(group, rows)]
    if problems:
        raise SceneError(problems)
    overlap, overlap_rows = _overlap(group, rows)
    speed, angular_velocity = (
        0.0 if vectors is None else float(np.linalg.norm(vectors, axis=1).max())
        for vectors in (rows.velocity, rows.angular_velocity)
    )
    diameters = 2.0 * float(rows.radius.min()), 2.0 * float(rows.radius.max())
    summary = FileSummary(
        count=len(rows),
        diameter_min=diameters[0],
        diameter_max=diameters[1],
        speed_max=speed,
        angular_velocity_max=angular_velocity,
        overlap_max=overlap,
        overlap_rows=overlap_rows,
    )
    read_insertion = insertion.model_copy(update={"found": summary})
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
    low, high = np.array(group.domain.min), np.array(group.domain.max)
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
