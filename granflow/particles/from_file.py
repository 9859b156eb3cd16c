"""Particle groups from files: selection of the rows of each group, and their particles."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from granflow.errors import SceneError
from granflow.io.regular_files import resolved
from granflow.particles.group import SceneGroup
from granflow.particles.particle_data import ParticleData, particles_of
from granflow.particles.table import ParticleTable, read_particles
from granflow.scene.schema.insertion import FileInsertion


def table_of(group: SceneGroup) -> ParticleTable:
    """All rows of the file of a group.

    Raises ValueError for a group without a file, and SceneError if the file cannot be read or is invalid.
    """
    insertion = group.spec.insert
    if not isinstance(insertion, FileInsertion):
        raise ValueError(f"{group.name} is not read from a file.")
    try:
        path = resolved(group.folder / insertion.file)
    except OSError as error:
        raise SceneError(f"{group.folder / insertion.file}: the file cannot be read: {error.strerror}.") from None
    location = group.locate("insert", "file")
    if not path.exists():
        key = f"particles.{group.name}.insert.file"
        raise SceneError(
            f"{location}: {key} is {insertion.file}, but there is no such file; its path is relative to the folder of "
            "the scene."
        )
    return read_particles(group.folder / insertion.file)


def rows_of(group: SceneGroup) -> ParticleTable:
    """The rows of a group: all, or those of its material (name or number) if the file has a material column.

    Raises SceneError if no row matches, or if the file cannot be read.
    """
    table = table_of(group)
    if table.material is None:
        return table
    is_own = np.isin(table.material, _material_names(group))
    if not is_own.any():
        location, material = group.locate("material"), group.spec.material
        others = ", ".join(sorted(set(table.material.tolist()))[:5])
        raise SceneError(f"{location}: no row of {table.path} is of {material}; its materials are {others}.")
    return table.subset(is_own)


def unassigned_rows(groups: Iterable[SceneGroup]) -> list[str]:
    """An error message for each file with rows of a material that no group uses; missing files are skipped."""
    files: dict[str, list[SceneGroup]] = {}
    for group in groups:
        insertion = group.spec.insert
        if isinstance(insertion, FileInsertion) and (group.folder / insertion.file).exists():
            files.setdefault(insertion.file, []).append(group)
    problems = []
    for sharing in files.values():
        table = table_of(sharing[0])
        if table.material is not None:
            used_materials = [known for group in sharing for known in _material_names(group)]
            unassigned = ~np.isin(table.material, used_materials)
            if unassigned.any():
                row, material = table.line[unassigned][0], table.material[unassigned][0]
                problems.append(
                    f"{table.path}:{row}: this particle is of {material}, but no group has this material; add one."
                )
    return problems


def particles_from_file(group: SceneGroup) -> ParticleData:
    """The particles of a group from its file, in the order of its rows.

    Velocities are those of the file if it has them, otherwise those of the group; fixed particles are at rest. Raises
    SceneError if the number of rows has changed since the scene was resolved.
    """
    rows, count = rows_of(group), group.spec.count
    if len(rows) != count:
        raise SceneError(f"{rows.path}: this file has changed: it had {count} particles, and has {len(rows)} now.")
    particles = particles_of(group, rows.position, rows.radius)
    if group.spec.fixed:
        return particles
    moving = {key: getattr(rows, key) for key in ("velocity", "angular_velocity") if getattr(rows, key) is not None}
    return replace(particles, **moving)


def _material_names(group: SceneGroup) -> list[str]:
    """Names of the material of a group in a file: its name, or its number in the scene, from 0."""
    return [group.spec.material, str(group.material_number)]
