"""Scenes from files, from text and from Python: read, validated and resolved here, and nowhere else."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from granflow.errors import SceneError
from granflow.io.regular_files import resolved
from granflow.particles.resolve import resolved_input
from granflow.scene.document import DocumentError
from granflow.scene.mapping import document_of
from granflow.scene.reader import document_in, scene_in
from granflow.scene.schema.run import Precision
from granflow.scene.schema.scene import SceneInput
from granflow.scene.yaml12 import parse


class FrozenDict(dict[str, Any]):
    """A mapping that cannot be changed; its deep copies can."""

    def _refuse(self, *_: Any, **__: Any) -> Any:
        raise TypeError("A scene is immutable: use Scene.from_dict, or model_copy for another scene.")

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse

    def __reduce__(self) -> tuple[type, tuple[dict[str, Any]]]:
        return dict, (dict(self),)


class Scene(SceneInput):
    """A validated and resolved scene, ready for a run: SI units, all counts known, at scale 1. Immutable.

    `load` and `from_dict` create scenes. A copy with other values (`model_copy`) is neither validated nor resolved.
    """

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], folder: str | os.PathLike[str] | None = None) -> "Scene":
        """The scene of a mapping with the keys of a scene file.

        Values: numbers in SI units or text with units, lists, numpy arrays, mappings. Paths in the scene are relative
        to `folder` (default: the working directory). Raises SceneError with all problems, each with its key path.
        """
        return cls.of(scene_in(document_of(data), folder=Path(folder or "")), read=True)

    @classmethod
    def of(cls, written: SceneInput, read: bool = True) -> "Scene":
        """The resolved form of a scene as written, whose parts are not checked against each other here.

        `read`: read particle files again even if the scene has their summary. Raises SceneError.
        """
        source = resolved_input(written, read)
        fields: dict[str, Any] = {
            name: FrozenDict(value) if isinstance(value, dict) else value for name, value in source
        }
        scene = cls.model_construct(source.model_fields_set, **fields)
        for name in source.__private_attributes__:
            setattr(scene, name, getattr(source, name))
        if read and scene.start_from is not None:
            scene = scene.model_copy(update={"start_from": str(_earlier_run(scene))})
        return scene

    def with_precision(self, precision: Precision) -> "Scene":
        """The same scene with another floating-point precision."""
        return self.model_copy(update={"run": self.run.model_copy(update={"precision": precision})})


def load(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Scene:
    """Read the scene in a YAML file and resolve it.

    `path`: UTF-8 file of at most 4 MiB. The path in `start_from` is relative to the folder of the file. Each override,
    "key.path=value", replaces or adds a value (YAML) before validation. The result is immutable and in SI units.

    Raises SceneError with all problems in the order of the file, each with line and column, at most 100.
    """
    written = scene_in(document_in(Path(path)), overrides, Path(path).parent)
    written._path = Path(path)
    return Scene.of(written, read=True)


def scene_of(text: str, source: str, overrides: Sequence[str] = ()) -> Scene:
    """Read a scene from text, such as that in a checkpoint; paths are relative to the folder of `source`.

    Particle files are not read again if the text contains their summary. Raises the same errors as `load`.
    """
    try:
        written = scene_in(parse(text, source), overrides, Path(source).parent)
    except DocumentError as error:
        raise SceneError(str(error.problem)) from None
    return Scene.of(written, read=False)


def _earlier_run(scene: Scene) -> Path:
    """The directory in `start_from`, relative to the folder of the scene. Raises SceneError if it cannot be read."""
    try:
        return resolved(scene.folder / str(scene.start_from))
    except OSError as error:
        reason = f"start_from is {scene.start_from}, which cannot be read: {error.strerror}"
        raise SceneError(f"{scene.locate('start_from')}: {reason}.") from None
