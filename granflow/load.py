"""Scenes from files and from text: read, validated and resolved."""

import os
from collections.abc import Sequence
from pathlib import Path

from granflow.errors import SceneError
from granflow.io.regular_files import resolved
from granflow.particles.resolve import resolve_scene
from granflow.scene.document import DocumentError
from granflow.scene.reader import document_in, scene_in
from granflow.scene.schema.scene import Scene
from granflow.scene.yaml12 import parse


def load(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Scene:
    """Read the scene in a YAML file and resolve it.

    `path`: UTF-8 file of at most 4 MiB. The path in `start_from` is relative to the folder of the file. Each override,
    "key.path=value", replaces or adds a value (YAML) before validation. The result is immutable and in SI units.

    Raises SceneError with all problems in the order of the file, each with line and column, at most 100.
    """
    scene = scene_in(document_in(Path(path)), overrides, Path(path).parent)
    scene._path = Path(path)
    scene = resolve_scene(scene, read=True)
    if scene.start_from is not None:
        scene = scene.model_copy(update={"start_from": str(_earlier(path, scene))})
    return scene


def _earlier(path: str | os.PathLike[str], scene: Scene) -> Path:
    """The directory in `start_from`, relative to the folder of the scene file.

    Raises SceneError if it cannot be read.
    """
    try:
        return resolved(Path(path).parent / str(scene.start_from))
    except OSError as error:
        reason = f"start_from is {scene.start_from}, which cannot be read: {error.strerror}"
        raise SceneError(f"{scene.locate('start_from')}: {reason}.") from None


def scene_of(text: str, source: str, overrides: Sequence[str] = ()) -> Scene:
    """Read a scene from text, such as that in a checkpoint; paths are relative to the folder of `source`.

    Particle files are not read again if the text contains their summary. Raises the same errors as `load`.
    """
    try:
        return resolve_scene(scene_in(parse(text, source), overrides, Path(source).parent))
    except DocumentError as error:
        raise SceneError(str(error.problem)) from None
