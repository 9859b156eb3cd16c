"""Scenes from files and from text: read, validated and resolved."""

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from granflow.errors import SceneError
from granflow.io.regular_files import resolved
from granflow.particles.resolve import resolve_scene
from granflow.scene.document import DocumentError
from granflow.scene.reader import document_in, scene_in
from granflow.scene.schema import scene as schema
from granflow.scene.writer import to_yaml
from granflow.scene.yaml12 import parse


class Scene(schema.Scene):
    """A validated and resolved scene."""

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], folder: str | os.PathLike[str] | None = None) -> "Scene":
        """The scene of a mapping with the keys of a scene file; paths are relative to `folder`.

        Values are numbers, text with units, lists, numpy arrays and mappings. Raises SceneError.
        """
        plain = json.loads(json.dumps(data, default=np.ndarray.tolist))
        return cls._resolved(scene_in(parse(to_yaml(plain), "scene"), folder=Path(folder or "")), read=True)

    @classmethod
    def _resolved(cls, written: schema.Scene, read: bool) -> "Scene":
        """The resolved form of a scene; `read`: read particle files again. Raises SceneError."""
        source = resolve_scene(written, read)
        scene = cls.model_construct(source.model_fields_set, **dict(source))
        for name in source.__private_attributes__:
            setattr(scene, name, getattr(source, name))
        return scene


def load(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Scene:
    """Read the scene in a YAML file and resolve it.

    `path`: UTF-8 file of at most 4 MiB. The path in `start_from` is relative to the folder of the file. Each override,
    "key.path=value", replaces or adds a value (YAML) before validation. The result is immutable and in SI units.

    Raises SceneError with all problems in the order of the file, each with line and column, at most 100.
    """
    scene = scene_in(document_in(Path(path)), overrides, Path(path).parent)
    scene._path = Path(path)
    resolved_scene = Scene._resolved(scene, read=True)
    if scene.start_from is not None:
        return resolved_scene.model_copy(update={"start_from": str(_earlier(path, resolved_scene))})
    return resolved_scene


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
        return Scene._resolved(scene_in(parse(text, source), overrides, Path(source).parent), read=False)
    except DocumentError as error:
        raise SceneError(str(error.problem)) from None
