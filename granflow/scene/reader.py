"""Scene reader: a file becomes a tree, overrides change the tree, the schema and the checks validate it.

`document_in` reads the tree of a file, `scene_in` makes a `SceneInput` of a tree. All problems are reported
at once, in the order of the file. `granflow.load` resolves the scene afterwards.
Other YAML files, such as sweeps, get the same messages by `validated_file`.
"""

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from granflow.arguments import refuse_other
from granflow.contact.law import SLOTS
from granflow.errors import FileError, SceneError
from granflow.io.files import wide_encoding
from granflow.scene.blocks.scene import SceneInput
from granflow.scene.checks import PartialScene, consistency_problems, partial_scene_of
from granflow.schema.document import (
    Document,
    DocumentError,
    MappingEntry,
    Node,
    Problem,
    SourcePosition,
    document_of,
    node_of,
    parse,
)
from granflow.schema.messages import dotted, model_at, nearest, problem_at, problems_of, suggestion_sentence
from granflow.schema.model import Model, faults_of

M = TypeVar("M", bound=Model)

SCENE_KEYS = {"materials", "particles"}
"""Required keys of a scene that no other file has."""

STUDIES = {"sweep": ("sweep", {"scene", "vary"}), "calibration": ("calibrate", {"scenes", "targets"})}
"""Other files by what they describe: the verb that reads them, and required keys that no scene has."""


def validated_file(path: Path, schema: type[M], kind: str) -> tuple[M, Document]:
    """The content of a YAML file as `schema`, and its document, which has the position of each key.

    `kind`: what the file describes, for messages, such as "sweep". Raises FileError with all problems, each
    as `file:line:column: sentence`; for a scene, only that it is one.
    """
    try:
        document = document_in(path, kind)
    except SceneError as error:
        raise FileError(error.problems) from None
    if SCENE_KEYS <= set(document.root.entries or ()):
        keys = ", ".join(name for name, field in schema.model_fields.items() if field.is_required())
        raise FileError([f"{path}: this is a scene, not a {kind} file; give a file with the keys {keys}."])
    return validated(document, schema), document


def validated_source(
    source: str | os.PathLike[str] | Mapping[str, Any], schema: type[M], kind: str
) -> tuple[M, Document, Path, str]:
    """As `validated_file`, for the path of a file or a mapping with its keys, whose positions are key paths.

    Also returns the folder to which paths in it are relative, the working directory for a mapping, and its
    name, `kind` for a mapping. Raises GranflowError for a source of another type.
    """
    refuse_other(
        "source", source, (str, os.PathLike, Mapping), "the path of a file, or a mapping with its keys"
    )
    if isinstance(source, Mapping):
        document = document_of(source)
        return validated(document, schema), document, Path(), kind
    path = Path(source)
    return *validated_file(path, schema, kind), path.parent, path.stem


def validated(document: Document, schema: type[M]) -> M:
    """The content of a document as `schema`. Raises FileError with all problems."""
    problems = list(document.problems)
    content = None
    try:
        content = schema.model_validate(document.root.data())
        problems += [problem_at(document, fault) for fault in faults_of(content)]
    except ValidationError as error:
        problems += problems_of(document, error.errors(include_url=False, include_input=False), schema)
    if content is None or problems:
        raise FileError(map(str, in_file_order(problems)))
    return content


_MAX_SHOWN = 100  # problems


def scene_in(document: Document, overrides: Sequence[str] = (), folder: Path | None = None) -> SceneInput:
    """The validated scene of a document; paths are relative to `folder` (default: the working directory).

    The scene is not resolved: counts from masses, contents of files and `scale` are not applied yet. Raises
    the same errors as `load_scene`.
    """
    problems = list(document.problems)
    keys = set(document.root.entries or ())
    for kind, (verb, its_keys) in STUDIES.items():
        if its_keys <= keys and not keys & SCENE_KEYS:
            raise SceneError(
                f"{document.root.position}: this is a {kind}, not a scene; "
                f"granflow {verb} reads it, and its --dry-run checks it."
            )
    before = document.root
    for override in overrides:
        problems += _apply_override(document, override)
    scene, found = _validated(document)
    problems += found
    if scene is None or problems:
        ordered = in_file_order(problems)
        shown = [str(problem) for problem in ordered[:_MAX_SHOWN]]
        more = len(ordered) - _MAX_SHOWN
        if more > 0:
            last = ordered[-1].position
            shown.append(f"{last}: this is the last of {more} more problems, which are not shown.")
        raise SceneError(shown)
    scene._document = document
    scene._folder = folder or Path()
    scene._remarks = tuple(_unchanged_aliases(document, before, overrides))
    return scene


def scene_with(document: Document, values: Mapping[str, Any], folder: Path) -> SceneInput:
    """The validated scene of a document, which does not change, with other values by key path.

    Keys and values as for `load_scene` and `Scene.from_dict`. Raises the same errors as `scene_in`.
    """
    changed = replace(document, problems=list(document.problems))
    for path, value in values.items():
        keys = tuple(str(path).split("."))
        position = SourcePosition(str(path))
        try:
            changed.root = _with(changed.root, keys, node_of(value, keys, changed), position, depth=0)
        except _Refused as refusal:
            changed.problems.append(Problem(position, str(refusal)))
    return scene_in(changed, folder=folder)


def in_file_order(problems: Iterable[Problem]) -> list[Problem]:
    """The problems in the order of the file, each once."""
    return sorted(set(problems), key=lambda problem: (problem.position.sort_key, problem.sentence))


def _validated(document: Document) -> tuple[SceneInput | None, list[Problem]]:
    """The scene, or None if it does not satisfy the schema, and all problems of schema and consistency."""
    data = document.root.data()
    try:
        scene = _resolved_law(SceneInput.model_validate(data))
    except ValidationError as error:
        details = error.errors(include_url=False, include_input=False)
        try:
            parts = partial_scene_of(document, data, [each["loc"] for each in details])
        except ValidationError as of_sections:  # checked once all entries are valid, such as names of walls
            details += of_sections.errors(include_url=False, include_input=False)
            parts = partial_scene_of(document, data, [each["loc"] for each in details])
        return None, problems_of(document, details, SceneInput) + consistency_problems(parts)
    return scene, consistency_problems(PartialScene(document, scene))


def _resolved_law(scene: SceneInput) -> SceneInput:
    """The scene with the parameters of the normal contact model that follow if every restitution is a number.

    Example: `restitution_at` of zhou becomes constant.
    """
    normal = scene.contact.normal
    has_fit = any(pair.fit for pair in scene.pairs.values())
    with_numbers = normal.record.options.with_numbers
    if has_fit or not with_numbers:
        return scene
    fixed = normal.model_copy(update=with_numbers)
    return scene.model_copy(update={"contact": scene.contact.model_copy(update={"normal": fixed})})


# From a file to a tree

_MAX_FILE_SIZE = 4 * 2**20  # bytes; reading a file of this size takes seconds


def document_in(path: Path, kind: str = "scene") -> Document:
    """The tree of a file; `kind`: what it describes, for messages.

    Raises SceneError for a file that cannot be read, is not YAML 1.2, or is not a mapping.
    """
    try:
        document = replace(_parsed(_file_text(path, kind), str(path)))  # overrides replace its root
    except DocumentError as error:
        raise SceneError(str(error.problem)) from None
    if document.root.entries is None:
        shown = document.root.shown()
        reason = "the file is empty" if shown == "empty" else "this is not a mapping"
        raise SceneError(
            f"{path}:1:1: {reason}, but a {kind} is a mapping of keys to values, such as title: My {kind}."
        )
    return document


@lru_cache(4)
def _parsed(text: str, source: str) -> Document:
    """As `parse`; cached, because a study reads a scene for each of its runs."""
    return parse(text, source)


def _file_text(path: Path, kind: str) -> str:
    """The text of a file.

    Raises SceneError for a directory, a file that is missing, too large or unreadable.
    """
    try:
        if path.is_dir():
            raise SceneError(f"{path}: this is a directory; give the {kind} file in it.")
        if path.stat().st_size > _MAX_FILE_SIZE:
            raise SceneError(
                f"{path}: this file is larger than {_MAX_FILE_SIZE // 2**20} MiB, too large for a {kind}."
            )
        raw = path.read_bytes()
    except FileNotFoundError:
        raise SceneError(f"{path}: there is no such file.{_similar(path)}") from None
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise SceneError(f"{path}: the file cannot be read: {why}.") from None
    return _decoded(raw, path, kind)


def _decoded(raw: bytes, path: Path, kind: str) -> str:
    """The text of UTF-8 bytes, without a byte order mark. Raises SceneError for other data."""
    if encoding := wide_encoding(raw):
        raise SceneError(f"{path}:1:1: the file is encoded in {encoding}; save it as UTF-8.")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        column = error.start - raw.rfind(b"\n", 0, error.start)
        raise SceneError(
            f"{path}:{line}:{column}: the file is not valid UTF-8 text; save it as UTF-8."
        ) from None
    if "\0" in text:
        raise SceneError(f"{path}: the file is binary; a {kind} is UTF-8 text.")
    return text


def _similar(path: Path) -> str:
    """A sentence with the scene file in the same folder that has the most similar name, or an empty text."""
    try:
        near = nearest(path.name, [each.name for each in path.parent.glob("*.y*ml")])
    except OSError:
        near = None
    return f" Did you mean {path.parent / near}?" if near else ""


# Overrides from the command line, `key.path=value`, applied to the tree before validation

SINGLE_ITEMS = ("motion",)
"""Keys with a list, or with one of its items in place of the list. Resolved scenes have the list; with both
forms of a scene the same override is valid, with or without the index 0."""
SHORT_LAWS = [["contact", slot] for slot in SLOTS]
"""Keys with the name of a contact model, or with a mapping that begins with the key `law`."""


class _Refused(Exception):
    """An override that does not fit the scene; its text is the error message."""


def _apply_override(document: Document, override: str) -> list[Problem]:
    """Apply one override to the document; return its problems.

    `override`: key.path=value, where the value is YAML and list items have indices from 0. Missing parents
    that the schema knows are created. The root of the document is replaced by a modified copy. Problems have
    the override as their position.
    """
    source = f"--set {override}"
    position = SourcePosition(source)
    path, equals, text = override.partition("=")
    keys = [key.strip() for key in path.split(".")]
    if not equals or not all(keys):
        return [Problem(position, "an override has the form key.path=value, such as run.duration=2.")]
    if not text.strip():
        return [Problem(position, f"{path.strip()} has no value; write it after the equals sign.")]
    try:
        value = parse(text, source, with_positions=False)
        document.root = _with(document.root, keys, value.root, position, depth=0)
    except DocumentError as error:
        return [error.problem]
    except _Refused as refusal:
        return [Problem(position, str(refusal))]
    return value.problems


def _with(node: Node, keys: Sequence[str], value: Node, position: SourcePosition, depth: int) -> Node:
    """Copy of the tree with the value at keys[depth:] below this node; nodes shared by aliases do not change.

    Raises _Refused if the path does not exist in the scene or the schema.
    """
    if depth == len(keys):
        return value
    if node.items is not None:
        return _with_item(node, keys, value, position, depth)
    if node.entries is None and keys[:depth] in SHORT_LAWS and isinstance(node.scalar, str):
        node = replace(node, entries={"law": MappingEntry(position, node)}, scalar=None)
    if node.entries is not None and keys[depth] == "0" and keys[depth - 1] in SINGLE_ITEMS:
        return _with(node, keys, value, position, depth + 1)
    if node.entries is None:
        parent = dotted(keys[:depth])
        raise _Refused(
            f"{parent or 'the scene'} is {node.shown()}, which has no keys; set {parent} as a whole."
        )
    key = _key(node.entries, keys[depth])
    entry = node.entries.get(key)
    if entry is None and depth + 1 < len(keys):
        entry = MappingEntry(position, _new_part(node.entries, keys, depth, position))
    child = _with(entry.node if entry else value, keys, value, position, depth + 1)
    key_position = position if depth + 1 == len(keys) or entry is None else entry.key_position
    return replace(node, entries=node.entries | {key: MappingEntry(key_position, child)})


def _with_item(node: Node, keys: Sequence[str], value: Node, position: SourcePosition, depth: int) -> Node:
    """Copy of a list node with one item replaced, or with one more if the index is that after the last.

    Raises _Refused for an invalid index.
    """
    items = list(node.items or ())
    index = keys[depth]
    if keys[depth - 1] in SINGLE_ITEMS and len(items) == 1 and not index.isdigit():
        return replace(node, items=[_with(items[0], keys, value, position, depth)])
    is_new = index == str(len(items))
    if is_new and depth + 1 == len(keys):
        return replace(node, items=[*items, value])
    if not (index.isascii() and index.isdigit() and int(index) < len(items)):
        if len(items) > 1:
            numbers = f"items 0 to {len(items) - 1}"
        else:
            numbers = "1 item" if items else "0 items"
        parent = dotted(keys[:depth])
        remedy = f" To append an item, give it as a whole: {parent}.{index}={{..}}." if is_new else ""
        raise _Refused(f"{parent} is a list of {numbers}, so the index {index} is invalid.{remedy}")
    items[int(index)] = _with(items[int(index)], keys, value, position, depth + 1)
    return replace(node, items=items)


def _unchanged_aliases(document: Document, before: Node, overrides: Sequence[str]) -> Iterator[str]:
    """A sentence for each override of a part that other keys share through an alias, and that these keep.

    document, before:  with all overrides, and the root of the tree as in the file

    An override changes the key that it names alone, as in a resolved scene, which has no aliases.
    """
    for override in overrides:
        path, _, value = override.partition("=")
        keys = [key.strip() for key in path.split(".")]
        places = tuple(int(key) if key.isdecimal() else key for key in keys)
        is_shared = False
        for depth in range(1, len(keys) + 1):
            node = before.at(places[:depth])
            is_shared |= any(node is each for each in document.aliased)
            if node is None or not is_shared:
                continue
            others = [each for each in _paths_to(node, before) if document.find(each) is node]
            if others:
                same = [dotted([*each, *keys[depth:]]) for each in others]
                keep = "keeps its value" if len(same) == 1 else "keep their values"
                yield (
                    f"--set {dotted(keys)} changes this key alone: {', '.join(same)} of the same YAML anchor "
                    f"{keep}. To change it too, add --set {same[0]}={value.strip()}."
                )
                break


def _paths_to(wanted: Node, node: Node, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """All paths to a node that occurs several times below another."""
    if node is wanted:
        yield path
    parts = node.entries.items() if node.entries else enumerate(node.items or ())
    for key, part in parts:
        yield from _paths_to(wanted, part if isinstance(part, Node) else part.node, (*path, key))


def _key(entries: dict[str, MappingEntry], key: str) -> str:
    """The key in the order of the scene: an override may name a pair in either order."""
    reversed_key = "-".join(reversed(key.split("-")))
    return reversed_key if key not in entries and reversed_key in entries else key


def _new_part(
    entries: dict[str, MappingEntry], keys: Sequence[str], depth: int, position: SourcePosition
) -> Node:
    """An empty mapping for a part that is missing in the file, such as `numerics`.

    Raises _Refused for an unknown part.
    """
    parent = tuple(keys[:depth])
    path = tuple(keys[: depth + 1])
    is_known = model_at(SceneInput, path) is not None
    if is_known and (not depth or model_at(SceneInput, parent) is not None):
        return Node(position, entries={})
    if depth:
        remedy = suggestion_sentence(keys[depth], entries, f"keys in {dotted(parent)}")
        raise _Refused(f"{dotted(path)} is not in the scene. {remedy}")
    if keys[depth] in SceneInput.model_fields:  # a block of named things, none of which the scene has
        raise _Refused(f"{dotted(path)} is not in the scene; write it in the scene file.")
    remedy = suggestion_sentence(keys[depth], SceneInput.model_fields, "known keys")
    raise _Refused(f"{dotted(path)} is not a known key. {remedy}")
