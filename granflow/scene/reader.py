"""Scene reader: file to tree, overrides, schema, consistency checks. Reports all problems at once."""

from collections.abc import Sequence
from pathlib import Path

from pydantic import ValidationError

from granflow.errors import SceneError
from granflow.scene import overrides as overriding
from granflow.scene.document import Document, DocumentError, Problem
from granflow.scene.messages import problems_of
from granflow.scene.partial import PartialScene, partial_scene_of
from granflow.scene.schema.materials import RestitutionFit
from granflow.scene.schema.scene import SceneInput
from granflow.scene.suggest import nearest
from granflow.scene.validation import consistency_problems
from granflow.scene.yaml12 import parse

_MAX_FILE_SIZE = 4 * 2**20  # bytes; reading a file of this size takes seconds
_MAX_SHOWN = 100  # problems


def scene_in(document: Document, overrides: Sequence[str] = (), folder: Path | None = None) -> SceneInput:
    """The validated scene of a document; paths are relative to `folder` (default: the working directory).

    The scene is not resolved: counts from masses, contents of files and `scale` are not applied yet. Raises the same
    errors as `load`.
    """
    problems = list(document.problems)
    for override in overrides:
        problems += overriding.apply(document, override)
    scene, found = _validated(document)
    problems += found
    if scene is None or problems:
        ordered = sorted(set(problems), key=lambda problem: (problem.position.sort_key, problem.sentence))
        raise SceneError([*map(str, ordered[:_MAX_SHOWN]), *_not_shown(ordered)])
    scene._document = document
    scene._folder = folder or Path()
    return scene


def _not_shown(problems: Sequence[Problem]) -> list[str]:
    """A message with the number of problems that are not shown."""
    more = len(problems) - _MAX_SHOWN
    last = problems[-1].position
    return [f"{last}: this is the last of {more} more problems, which are not shown."] if more > 0 else []


def document_in(path: Path, kind: str = "scene") -> Document:
    """The tree of a file; `kind`: what it describes, for messages.

    Raises SceneError for a file that cannot be read, is not YAML 1.2, or is not a mapping.
    """
    try:
        document = parse(_text(path, kind), str(path))
    except DocumentError as error:
        raise SceneError(str(error.problem)) from None
    if document.root.entries is None:
        shown = document.root.shown()
        reason = "the file is empty" if shown == "empty" else "this is not a mapping"
        raise SceneError(
            f"{path}:1:1: {reason}, but a {kind} is a mapping of keys to values, such as title: My {kind}."
        )
    return document


def _text(path: Path, kind: str) -> str:
    """The text of a file.

    Raises SceneError for a directory, a file that is missing, special, too large or unreadable.
    """
    try:
        if path.is_dir():
            raise SceneError(f"{path}: this is a directory; give the {kind} file in it.")
        if path.exists() and not path.is_file():
            raise SceneError(f"{path}: this is not a regular file; give a {kind} file.")
        with path.open("rb") as file:
            raw = file.read(_MAX_FILE_SIZE + 1)  # files of the kernel (/proc) report no size
        if len(raw) > _MAX_FILE_SIZE:
            raise SceneError(f"{path}: this file is larger than {_MAX_FILE_SIZE // 2**20} MiB, too large for a {kind}.")
    except FileNotFoundError:
        raise SceneError(f"{path}: there is no such file.{_similar(path)}") from None
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise SceneError(f"{path}: the file cannot be read: {why}.") from None
    return _decoded(raw, path, kind)


def _similar(path: Path) -> str:
    """A sentence with the scene file in the same folder that has the most similar name, or an empty text."""
    try:
        near = nearest(path.name, [each.name for each in path.parent.glob("*.y*ml")])
    except OSError:
        near = None
    return f" Did you mean {path.parent / near}?" if near else ""


def _decoded(raw: bytes, path: Path, kind: str) -> str:
    """The text of UTF-8 bytes, without a byte order mark. Raises SceneError for another encoding or binary data."""
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise SceneError(f"{path}:1:1: the file is encoded in UTF-16; save it as UTF-8.")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        column = error.start - raw.rfind(b"\n", 0, error.start)
        raise SceneError(f"{path}:{line}:{column}: the file is not valid UTF-8 text; save it as UTF-8.") from None
    if "\0" in text:
        raise SceneError(f"{path}: the file is binary; a {kind} is UTF-8 text.")
    return text


def _validated(document: Document) -> tuple[SceneInput | None, list[Problem]]:
    """The scene, or None if it does not satisfy the schema, and all problems of schema and consistency."""
    data = document.root.data()
    try:
        scene = _resolved_law(SceneInput.model_validate(data))
    except ValidationError as error:
        details = error.errors(include_url=False, include_input=False)
        parts = partial_scene_of(document, data, [each["loc"] for each in details])
        return None, problems_of(document, details, SceneInput) + consistency_problems(parts)
    return scene, consistency_problems(PartialScene(document, scene))


def _resolved_law(scene: SceneInput) -> SceneInput:
    """The scene with the parameters of the normal contact model that follow if every restitution is a number.

    Example: `restitution_at` of zhou becomes constant.
    """
    normal = scene.contact.normal
    has_fit = any(isinstance(pair.restitution, RestitutionFit) for pair in scene.pairs.values())
    if has_fit or not normal.fixed_by_numbers():
        return scene
    fixed = normal.model_copy(update=normal.fixed_by_numbers())
    return scene.model_copy(update={"contact": scene.contact.model_copy(update={"normal": fixed})})
