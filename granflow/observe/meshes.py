"""Copies of mesh files beside the results, so that the scene as run finds them and a run can go on anywhere."""

import shutil
from filecmp import cmp
from pathlib import Path

from granflow.observe.files import replacing
from granflow.plan.meshes import mesh_path
from granflow.scene import Scene
from granflow.scene.schema import MeshWall


def copy_meshes(directory: Path, scene: Scene) -> None:
    """Put the mesh files of a scene where the scene as run, in that directory, names them.

    Another file of that name is not lost: it goes aside with `.before` added to its name.
    """
    for wall in scene.walls.values():
        if isinstance(wall, MeshWall):
            source, target = mesh_path(scene, wall), Path(directory) / wall.file
            if target.exists() and (source == target.resolve() or cmp(source, target, shallow=False)):
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            if target.exists():
                target.replace(target.with_name(target.name + ".before"))
            with replacing(target) as temporary:
                shutil.copyfile(source, temporary)
