"""Copies of files that a scene names, beside the results: the scene as run finds them, and a run can go on anywhere."""

import re
import shutil
from collections.abc import Iterator
from filecmp import cmp
from pathlib import Path

from granflow.observe.files import replacing
from granflow.plan.meshes import mesh_path
from granflow.regular_files import resolved
from granflow.scene import Scene
from granflow.scene.schema import FileInsertion, MeshWall

RESULTS = re.compile(r"(particles|contacts|walls)_\d+\.vtu|timeseries\.csv")
"""Names of results: a file of particles so named is not copied, since the run writes its own there."""


def copy_inputs(directory: Path, scene: Scene) -> None:
    """Put mesh files, and files of particles, where the scene as run, in that directory, names them.

    Another file of that name is not lost: it goes aside with `.before` added to its name.
    """
    for source, name in _inputs(scene):
        target = Path(directory) / name
        if target.exists() and (source == resolved(target) or cmp(source, target, shallow=False)):
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.exists():
            target.replace(target.with_name(target.name + ".before"))
        with replacing(target) as temporary:
            shutil.copyfile(source, temporary)


def input_files(scene: Scene) -> Iterator[tuple[str, Path]]:
    """Key in the scene and path of every file that the scene names: meshes and tables of particles."""
    for name, wall in scene.walls.items():
        if isinstance(wall, MeshWall):
            yield f"walls.{name}.file", scene.folder / wall.file
    for name, group in scene.particles.items():
        if isinstance(group.insert, FileInsertion):
            yield f"particles.{name}.insert.file", scene.folder / group.insert.file


def _inputs(scene: Scene) -> Iterator[tuple[Path, str]]:
    """Files, and the names that the scene gives them; those that a run going on no longer has are left out."""
    for wall in scene.walls.values():
        if isinstance(wall, MeshWall):
            yield mesh_path(scene, wall), wall.file
    for insertion in (group.insert for group in scene.particles.values()):
        if isinstance(insertion, FileInsertion) and not RESULTS.fullmatch(insertion.file):
            path = resolved(scene.folder / insertion.file)
            if path.exists():
                yield path, insertion.file
