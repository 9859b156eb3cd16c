"""Overrides from the command line, `key.path=value`, applied to the tree of a scene before validation."""

from collections.abc import Sequence
from dataclasses import replace

from granflow.contact.model import SLOTS
from granflow.scene.document import Document, DocumentError, MappingEntry, Node, Problem, SourcePosition
from granflow.scene.messages import dotted, model_at
from granflow.scene.schema.scene import SceneInput
from granflow.scene.suggest import suggestion_or_list
from granflow.scene.yaml12 import parse

SINGLE_ITEMS = ("motion",)
"""Keys with a list, or with one of its items in place of the list. Resolved scenes have the list; with both forms of a
scene the same override is valid, with or without the index 0."""

SHORT_LAWS = [["contact", slot] for slot in SLOTS]
"""Keys with the name of a contact model, or with a mapping that begins with the key `law`."""


class _Refused(Exception):
    """An override that does not fit the scene; the message of the exception is the error message."""


def apply(document: Document, override: str) -> list[Problem]:
    """Apply one override to the document; return its problems.

    `override`: key.path=value, where the value is YAML and list items have indices from 0. Missing parents that the
    schema knows are created. The root of the document is replaced by a modified copy. Problems have the override as
    their position.
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
        raise _Refused(f"{parent or 'the scene'} is {node.shown()}, which has no keys; set {parent} as a whole.")
    key = _key(node.entries, keys[depth])
    entry = node.entries.get(key)
    if entry is None and depth + 1 < len(keys):
        entry = MappingEntry(position, _new_part(node.entries, keys, depth, position))
    child = _with(entry.node if entry else value, keys, value, position, depth + 1)
    key_position = position if depth + 1 == len(keys) or entry is None else entry.key_position
    return replace(node, entries=node.entries | {key: MappingEntry(key_position, child)})


def _with_item(node: Node, keys: Sequence[str], value: Node, position: SourcePosition, depth: int) -> Node:
    """Copy of a list node with one item replaced. Raises _Refused for an invalid index."""
    items = list(node.items or ())
    index = keys[depth]
    if keys[depth - 1] in SINGLE_ITEMS and len(items) == 1 and not index.isdigit():
        return replace(node, items=[_with(items[0], keys, value, position, depth)])
    if not (index.isascii() and index.isdigit() and int(index) < len(items)):
        numbers = f"items 0 to {len(items) - 1}" if len(items) > 1 else f"{len(items)} item" + "s" * (not items)
        raise _Refused(f"{dotted(keys[:depth])} is a list of {numbers}, so the index {index} is invalid.")
    items[int(index)] = _with(items[int(index)], keys, value, position, depth + 1)
    return replace(node, items=items)


def _key(entries: dict[str, MappingEntry], key: str) -> str:
    """The key in the order of the scene: an override may name a pair in either order."""
    reversed_key = "-".join(reversed(key.split("-")))
    return reversed_key if key not in entries and reversed_key in entries else key


def _new_part(entries: dict[str, MappingEntry], keys: Sequence[str], depth: int, position: SourcePosition) -> Node:
    """An empty mapping for a part that is missing in the file, such as `numerics`.

    Raises _Refused for an unknown part.
    """
    model = model_at(SceneInput, tuple(keys[:depth]))
    if model is None or model_at(SceneInput, tuple(keys[: depth + 1])) is None:
        known = list(entries) if model is None else [field.alias or key for key, field in model.model_fields.items()]
        kind = f"keys in {dotted(keys[:depth])}" if model is None else "known keys"
        remedy = suggestion_or_list(keys[depth], known, kind)
        missing = "is not in the scene" if model is None else "is not a known key"
        raise _Refused(f"{dotted(keys[: depth + 1])} {missing}. {remedy.rstrip('.')}".rstrip() + _dot(remedy))
    return Node(position, entries={})


def _dot(text: str) -> str:
    return "" if text.endswith("?") else "."
