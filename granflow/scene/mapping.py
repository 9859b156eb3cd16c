"""Scenes given as Python mappings: a document with key paths as positions, such as `materials.glass.restitution`."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from granflow.scene.document import Document, KeyPath, MappingEntry, Node, Problem, SourcePosition

ROOT = "scene"
"""Position of the whole scene in messages."""


def document_of(data: Mapping[str, Any], root: str = ROOT) -> Document:
    """The tree of a mapping of keys to values, as in a scene file; `root`: name of the whole mapping in messages.

    Values: numbers, text with units, lists, tuples, numpy arrays, mappings, paths, and parts of another scene. Problems
    of the document: keys that are not text, and values of other types.
    """
    document = Document(root, Node(SourcePosition(root)), subject="the scene" if root == ROOT else root)
    document.root = _node(data, (), document)
    return document


def _node(value: Any, path: KeyPath, document: Document) -> Node:
    """The value at a path of keys and indices, and all values below it."""
    position = _position(path, document.source)
    if isinstance(value, BaseModel):
        value = value.model_dump(by_alias=True, exclude_unset=True, exclude_none=True)
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        entries = {}
        for key, each in value.items():
            if not isinstance(key, str):
                document.problems.append(Problem(position, f"the key {key!r} is not text; put it in quotes."))
            below = (*path, str(key))
            entries[str(key)] = MappingEntry(_position(below, document.source), _node(each, below, document))
        return Node(position, entries=entries)
    if isinstance(value, list | tuple):
        return Node(position, items=[_node(each, (*path, index), document) for index, each in enumerate(value)])
    if isinstance(value, Path):
        value = str(value)
    if not isinstance(value, str | int | float | None):
        kind = type(value).__name__
        document.problems.append(Problem(position, f"a value is of type {kind}; give a number, text, list or mapping."))
        value = None
    return Node(position, scalar=value, text=_text(value))


def _text(value: str | float | None) -> str:
    """The value in the notation of scene files; empty for None."""
    return value if isinstance(value, str) else "" if value is None else json.dumps(value)


def _position(path: KeyPath, root: str) -> SourcePosition:
    return SourcePosition(".".join(map(str, path)) or root)
