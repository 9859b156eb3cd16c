"""Copies the input files of a scene to the output directory, so that a run can be continued on any machine."""

import re
import shutil
from collections.abc import Iterable, Iterator
from filecmp import cmp
from pathlib import Path

from granflow.io.atomic_files import replacing
from granflow.io.regular_files import resolved
from granflow.load import Scene
from granflow.plan.meshes import mesh_path
from granflow.scene.schema.insertion import FileInsertion
from granflow.scene.schema.walls import MeshWall

RESULTS = re.compile(r"(particles|contacts|walls)_\d+(\.\d+)?\.vtu|timeseries\.csv")
"""Names of result files: a particle file with such a name is not copied, because the run writes its own."""


def copy_inputs(directory: Path, inputs: Iterable[tuple[Path, str]]) -> None:
    """Copy meshes, tables of motions and particle files to the paths that the resolved scene in the directory contains.

    A different file at that path is not overwritten: `.before` is appended to its name. Subdirectories are created.
    `inputs`: as from `inputs_of`. Raises OSError if a file cannot be copied.
    """
    for source, name in inputs:
        target = Path(directory) / name
        if target.exists() and (source == resolved(target) or cmp(source, target, shallow=False)):
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.exists():
            target.replace(target.with_name(target.name + ".before"))
        with replacing(target) as temporary:
            shutil.copyfile(source, temporary)


def input_files(scene: Scene) -> Iterator[tuple[str, Path]]:
    """Yield the key and the path of each input file of the scene: meshes, tables of motions and of particles.

    The key is that of the scene, such as `walls.hopper.file`; the path starts with the folder of the scene. The file
    need not exist.
    """
    return ((key, scene.folder / name) for key, name in scene.input_names())


def inputs_of(scene: Scene) -> Iterator[tuple[Path, str]]:
    """Yield the absolute paths of the input files and their names in the scene.

    Tables that a continued run no longer has are left out.
    """
    for wall in scene.walls.values():
        if isinstance(wall, MeshWall):
            yield mesh_path(scene, wall), wall.file
        for name in (motion.file for motion in wall.motion if motion.kind == "table"):
            if name is not None and resolved(scene.folder / name).exists():
                yield resolved(scene.folder / name), name
    for insertion in (group.insert for group in scene.particles.values()):
        if isinstance(insertion, FileInsertion) and not RESULTS.fullmatch(insertion.file):
            path = resolved(scene.folder / insertion.file)
            if path.exists():
                yield path, insertion.file
