"""Overrides from the command line, `key.path=value`, put into the tree of a scene before it is validated."""

from collections.abc import Sequence
from dataclasses import replace

from granflow.scene.document import Document, DocumentError, Entry, Node, Place, Problem
from granflow.scene.schema import Scene
from granflow.scene.suggest import known_or_meant
from granflow.scene.words import dotted, model_at
from granflow.scene.yaml12 import parse


class _Refused(Exception):
    """An override that does not fit the scene; the message is the sentence."""


def apply(document: Document, override: str) -> list[Problem]:
    """Put one override into the document; give back what is wrong with it."""
    source = f"--set {override}"
    place = Place(source)
    path, equals, text = override.partition("=")
    keys = [key.strip() for key in path.split(".")]
    if not equals or not all(keys):
        return [Problem(place, "an override is written key.path=value, such as run.duration=2.")]
    if not text.strip():
        return [Problem(place, f"{path.strip()} is given no value; write it after the equals sign.")]
    try:
        value = parse(text, source, placed=False)
        document.root = _with(document.root, keys, value.root, place, depth=0)
    except DocumentError as error:
        return [error.problem]
    except _Refused as refusal:
        return [Problem(place, str(refusal))]
    return value.problems


def _with(node: Node, keys: Sequence[str], value: Node, place: Place, depth: int) -> Node:
    """The tree with the value at keys[depth:] below this node; nodes shared by aliases are not changed."""
    if depth == len(keys):
        return value
    if node.items is not None:
        return _with_item(node, keys, value, place, depth)
    if node.entries is None:
        inside = dotted(keys[:depth])
        raise _Refused(
            f"{inside or 'the scene'} is {node.shown()}, which has nothing inside to set; set {inside} as a whole."
        )
    key = _key(node.entries, keys[depth])
    entry = node.entries.get(key)
    if entry is None and depth + 1 < len(keys):
        entry = Entry(place, _new_part(node.entries, keys, depth, place))
    child = _with(entry.node if entry else value, keys, value, place, depth + 1)
    key_place = place if depth + 1 == len(keys) or entry is None else entry.key_place
    return replace(node, entries=node.entries | {key: Entry(key_place, child)})


def _with_item(node: Node, keys: Sequence[str], value: Node, place: Place, depth: int) -> Node:
    items = list(node.items or ())
    index = keys[depth]
    if not (index.isascii() and index.isdigit() and int(index) < len(items)):
        numbers = f"items 0 to {len(items) - 1}" if len(items) > 1 else f"{len(items)} item" + "s" * (not items)
        raise _Refused(f"{dotted(keys[:depth])} is a list of {numbers}, so {index} is not in it.")
    items[int(index)] = _with(items[int(index)], keys, value, place, depth + 1)
    return replace(node, items=items)


def _key(entries: dict[str, Entry], key: str) -> str:
    """The key as the scene has it: a pair may be named in either order."""
    turned = "-".join(reversed(key.split("-")))
    return turned if key not in entries and turned in entries else key


def _new_part(entries: dict[str, Entry], keys: Sequence[str], depth: int, place: Place) -> Node:
    """An empty mapping for a part that the file leaves out, such as `numerics`."""
    if model_at(Scene, tuple(keys[: depth + 1])) is None or (depth and model_at(Scene, tuple(keys[:depth])) is None):
        known = list(entries) if depth else list(Scene.model_fields)
        around = dotted(keys[:depth]) or "the scene"
        remedy = known_or_meant(keys[depth], known, f"keys in {around}")
        raise _Refused(f"{dotted(keys[: depth + 1])} is not in the scene. {remedy.rstrip('.')}".rstrip() + _dot(remedy))
    return Node(place, entries={})


def _dot(text: str) -> str:
    return "" if text.endswith("?") else "."
