"""Copies the input files of a scene to the output directory, so that a run can be continued on any machine."""

import shutil
from collections.abc import Iterable, Iterator
from filecmp import cmp
from pathlib import Path

from granflow.io.atomic_files import replacing
from granflow.io.regular_files import resolved
from granflow.load import Scene


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


def inputs_of(scene: Scene, copied: Scene) -> Iterator[tuple[Path, str]]:
    """Yield the absolute paths of the input files of a scene, and those of their copies in `copied_scene`.

    Files that a continued run no longer has are left out.
    """
    for (_, name), (_, copy) in zip(scene.input_names(), copied.input_names(), strict=True):
        source = resolved(scene.folder / name)
        if source.exists():
            yield source, copy
