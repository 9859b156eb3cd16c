"""Groups of particles from files: which rows are whose, and the grains they make."""

from dataclasses import replace

import numpy as np

from granflow.errors import SceneError
from granflow.regular_files import resolved
from granflow.scene.grains import Grains, grains_of
from granflow.scene.places import FromFile
from granflow.scene.schema import Scene
from granflow.scene.table import Table, read_table


def table_of(scene: Scene, name: str) -> Table:
    """All rows of the file of a group. Raises SceneError."""
    place = scene.particles[name].place
    if not isinstance(place, FromFile):
        raise ValueError(f"{name} is not read from a file.")
    try:
        folder = resolved(scene.folder)
        path = resolved(folder / place.file)
    except OSError as error:
        raise SceneError(f"{scene.folder / place.file}: the file cannot be read: {error.strerror}.") from None
    if not path.is_relative_to(folder):
        where = scene.place("particles", name, "place", "file")
        raise SceneError(f"{where}: {place.file} leads out of the scene's folder; put the file itself there.")
    return read_table(scene.folder / place.file)


def rows_of(scene: Scene, name: str) -> Table:
    """The rows of a group: those of its material where the file names materials, by name or number, else all.

    Raises SceneError.
    """
    table = table_of(scene, name)
    if table.material is None:
        return table
    mine = np.isin(table.material, _names_of(scene, scene.particles[name].material))
    if not mine.any():
        where, material = scene.place("particles", name, "material"), scene.particles[name].material
        others = ", ".join(sorted(set(table.material.tolist()))[:5])
        raise SceneError(f"{where}: no row of {table.path} is of {material}; its materials are {others}.")
    return table.part(mine)


def unclaimed(scene: Scene) -> list[str]:
    """A sentence for each file with rows of a material that no group takes from it."""
    files: dict[str, list[str]] = {}
    for name, group in scene.particles.items():
        if isinstance(group.place, FromFile) and (scene.folder / group.place.file).exists():
            files.setdefault(group.place.file, []).append(name)
    problems = []
    for names in files.values():
        table = table_of(scene, names[0])
        if table.material is not None:
            taken = [known for name in names for known in _names_of(scene, scene.particles[name].material)]
            left = ~np.isin(table.material, taken)
            if left.any():
                row, material = table.line[left][0], table.material[left][0]
                problems.append(
                    f"{table.path}:{row}: this particle is of {material}, but no group takes those; add one."
                )
    return problems


def grains_from(scene: Scene, name: str) -> Grains:
    """The grains of a group from a file, as the file has them. Raises SceneError where it is another by now."""
    rows, group = rows_of(scene, name), scene.particles[name]
    if len(rows) != group.count:
        raise SceneError(f"{rows.path}: this file has changed: {group.count} particles were in it, now {len(rows)}.")
    grains = grains_of(scene, name, rows.position, rows.radius)
    if group.fixed:
        return grains
    moving = {key: getattr(rows, key) for key in ("velocity", "spin") if getattr(rows, key) is not None}
    return replace(grains, **moving)


def _names_of(scene: Scene, material: str) -> list[str]:
    """How a file may call a material: its name, or its number in the scene, from 0."""
    return [material, str(list(scene.materials).index(material))]
