"""YAML 1.2 text as a tree with the source position of each key and value.

`granflow.scene.yaml12` builds it.
"""

from dataclasses import dataclass, field
from typing import Any

_LONGEST_SHOWN = 60  # characters of a value shown in a message

KeyPath = tuple[str | int, ...]
"""Keys and list indices from the root of a scene, such as ("stages", 0, "duration")."""


@dataclass(frozen=True, slots=True)
class SourcePosition:
    """A position in a file, or an override (`line` is 0). Lines and columns count from 1."""

    source: str
    line: int = 0
    column: int = 0

    def __str__(self) -> str:
        return f"{self.source}:{self.line}:{self.column}" if self.line else self.source

    @property
    def sort_key(self) -> tuple[bool, int, int]:
        """Sort key: positions in the order of the file, overrides last."""
        return self.line == 0, self.line, self.column


@dataclass(frozen=True, slots=True)
class Problem:
    """One error message with its source position."""

    position: SourcePosition
    sentence: str

    def __str__(self) -> str:
        """The message with its position, unless it begins with that; invisible characters are shown as escapes."""
        words = self.sentence.lstrip(" ")  # a key may begin with spaces, which are invisible
        position = "" if words.startswith(f"{self.position} ") else f"{self.position}: "
        text = position + r"\x20" * (len(self.sentence) - len(words)) + words
        return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class DocumentError(Exception):
    """Text that is not valid YAML 1.2, or uses a feature that scenes do not support; `problem` has the position."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(str(problem))
        self.problem = problem


@dataclass(slots=True)
class Node:
    """A value: a scalar with its source text, a list of nodes, or a mapping of entries.

    `scalar`: converted value; `text`: as written; `size`: number of values in this node, itself included.
    """

    position: SourcePosition
    scalar: Any = None
    text: str = ""
    items: "list[Node] | None" = None
    entries: "dict[str, MappingEntry] | None" = None
    size: int = 1

    def data(self) -> Any:
        """The value as plain Python: dict, list, str, int, float, bool, None."""
        if self.entries is not None:
            return {key: entry.node.data() for key, entry in self.entries.items()}
        if self.items is not None:
            return [node.data() for node in self.items]
        return self.scalar

    def child(self, key: str | int) -> "Node | None":
        """The value under a key or at an index; None if it does not exist. A face of a box has the value of the box."""
        if self.entries is not None and (written := self.written_key(key)) is not None:
            return self.entries[written].node
        if self.items is not None and isinstance(key, int) and 0 <= key < len(self.items):
            return self.items[key]
        return None

    def written_key(self, key: str | int) -> str | None:
        """The key in the file: that of the box for one of its faces, such as box.left; None if there is none."""
        words = [str(key), str(key).rpartition(".")[0]]
        return next((word for word in words if word in (self.entries or {})), None)

    @property
    def is_empty(self) -> bool:
        """Whether the value is missing in the file."""
        return self.entries is None and self.items is None and self.scalar is None and not self.text

    def shown(self) -> str | None:
        """The value for a message: as written, shortened; None if it is too long.

        Scalars are cut after 60 characters; mappings and lists are shown on one line or not at all.
        """
        if self.entries is not None:
            parts = [(key, entry.node.shown()) for key, entry in self.entries.items()]
            text = "{" + ", ".join(f"{key}: {part}" for key, part in parts) + "}"
            return text if len(text) <= _LONGEST_SHOWN and all(part for _, part in parts) else None
        if self.items is not None:
            shown = [node.shown() for node in self.items[:_LONGEST_SHOWN]]
            text = "[" + ", ".join(part or "" for part in shown) + "]"
            return text if len(text) <= _LONGEST_SHOWN and all(shown) else None
        text = " ".join(self.text.split())
        if not text:
            return "empty"
        return text if len(text) <= _LONGEST_SHOWN else text[:_LONGEST_SHOWN] + "..."


@dataclass(slots=True)
class MappingEntry:
    """A value in a mapping, with the source position of its key."""

    key_position: SourcePosition
    node: Node


@dataclass
class Document:
    """The tree of one file, and its problems that do not prevent reading (duplicate keys).

    `subject`: what the file describes, at the beginning of messages about the whole.
    """

    source: str
    root: Node
    problems: list[Problem] = field(default_factory=list)
    subject: str = "the scene"

    def find(self, path: KeyPath) -> Node | None:
        """The value at a path of keys and indices; None if it does not exist.

        Union tags are not part of the path; see `messages.path_in_file`.
        """
        node: Node | None = self.root
        for key in path:
            node = node.child(key) if node is not None else None
        return node

    def key_position(self, path: KeyPath) -> SourcePosition:
        """Source position of the key at a path, or of the nearest existing parent key."""
        position = SourcePosition(self.source, 1, 1) if self.root.position.line else self.root.position
        node: Node | None = self.root
        for key in path:
            entries = node.entries if node is not None else None
            child = node.child(key) if node is not None else None
            if child is None:
                return position
            written = node.written_key(key) if node is not None and entries is not None else None
            position = child.position if entries is None or written is None else entries[written].key_position
            node = child
        return position

    def value_position(self, path: KeyPath) -> SourcePosition:
        """Source position of the value at a path, or of the nearest existing parent key."""
        node = self.find(path)
        return self.key_position(path) if node is None else node.position

    def where(self, path: KeyPath) -> str:
        """Line of the key at a path, or of the nearest existing parent key, as `file:line`."""
        position = self.key_position(path)
        return f"{position.source}:{position.line}" if position.line else position.source
