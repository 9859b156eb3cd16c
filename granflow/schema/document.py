"""Documents: YAML 1.2 text or a Python mapping as a tree with the source position of each key and value.

`parse` reads the text of a file, `document_of` a mapping; both return a `Document`, whose positions messages
name. `yaml_text` writes plain data as YAML that loads to equal data.
"""

import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel
from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import (
    AliasEvent,
    DocumentStartEvent,
    Event,
    MappingEndEvent,
    MappingStartEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
)

from granflow.schema.faults import KeyPath

# The tree


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
        """The message with its position, unless it begins with that; invisible characters as escapes."""
        words = self.sentence.lstrip(" ")  # a key may begin with spaces, which are invisible
        position = "" if words.startswith(f"{self.position} ") else f"{self.position}: "
        text = position + r"\x20" * (len(self.sentence) - len(words)) + words
        return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class DocumentError(Exception):
    """Text that is not YAML 1.2, or uses a feature that scenes do not support."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(str(problem))
        self.problem = problem


_LONGEST_SHOWN = 60  # characters of a value shown in a message


@dataclass(slots=True)
class Node:
    """A value: a scalar with its source text, a list of nodes, or a mapping of entries.

    `scalar`: converted value; `text`: as written.
    """

    position: SourcePosition
    scalar: Any = None
    text: str = ""
    items: "list[Node] | None" = None
    entries: "dict[str, MappingEntry] | None" = None

    def data(self) -> Any:
        """The value as plain Python: dict, list, str, int, float, bool, None."""
        if self.entries is not None:
            return {key: entry.node.data() for key, entry in self.entries.items()}
        if self.items is not None:
            return [node.data() for node in self.items]
        return self.scalar

    def child(self, key: str | int) -> "Node | None":
        """The value under a key or at an index, for a face of a box that of the box; None without one."""
        if self.entries is not None and (written := self.written_key(key)) is not None:
            return self.entries[written].node
        if self.items is not None and isinstance(key, int) and 0 <= key < len(self.items):
            return self.items[key]
        return None

    def at(self, path: KeyPath) -> "Node | None":
        """The value at a path of keys and indices below; None if it does not exist."""
        node: Node | None = self
        for key in path:
            node = node.child(key) if node is not None else None
        return node

    def written_key(self, key: str | int) -> str | None:
        """The key in the file: for a face such as box.left that of the box; None without one."""
        entries = self.entries or {}
        for word in (str(key), str(key).rpartition(".")[0]):
            if word in entries:
                return word
        return None

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
        if isinstance(self.scalar, str) and not isinstance(resolve(text), str):
            text = f'"{text}"'  # text in quotes that would be a number or a word such as true without them
        return text if len(text) <= _LONGEST_SHOWN else text[:_LONGEST_SHOWN] + "..."


@dataclass(slots=True)
class MappingEntry:
    """A value in a mapping, with the source position of its key."""

    key_position: SourcePosition
    node: Node


@dataclass
class Document:
    """The tree of one file, and its problems that do not prevent reading (duplicate keys).

    `subject`: what the file describes, at the beginning of messages about the whole. `aliased`: the nodes
    that several keys share through an alias.
    """

    source: str
    root: Node
    problems: list[Problem] = field(default_factory=list)
    subject: str = "the scene"
    aliased: list[Node] = field(default_factory=list)

    def find(self, path: KeyPath) -> Node | None:
        """The value at a path of keys and indices; None if it does not exist.

        Union tags are not part of the path; see `messages.path_in_file`.
        """
        return self.root.at(path)

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


# YAML 1.2 text to a tree
#
# The core schema is supported: mappings, lists, text, numbers, true, false and null; anchors and aliases; no
# tags, no merge keys. Duplicate keys and aliases that contain themselves are errors.
#
# The scanner and the parser are those of ruamel.yaml; the tree is built from their events. The round-trip
# loader of ruamel.yaml is not used: it reads `1_000`, `0b11` and dates as in YAML 1.1, reports only the
# first duplicate key, drops the source text of values, and takes 1.4 times as long.

_YAML_TAGS = "tag:yaml.org,2002:"
_FORBIDDEN = re.compile("[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def parse(text: str, source: str, *, with_positions: bool = True) -> Document:
    """Read YAML 1.2 text. Without `with_positions`, all positions are the source only (for overrides).

    `source`: name of the file for positions. Duplicate keys are in `Document.problems`; the first one
    applies.

    Raises DocumentError for errors that prevent reading: syntax errors, tags, recursive aliases, and
    several documents.
    """
    return _Composer(source, with_positions).compose(text)


class _Composer:
    """Builds the tree from the parser's events.

    anchors:  nodes by anchor, None while the node is incomplete
    """

    def __init__(self, source: str, with_positions: bool) -> None:
        self.source = source
        self.with_positions = with_positions
        self.anchors: dict[str, Node | None] = {}
        self.problems: list[Problem] = []
        self.aliased: list[Node] = []

    def compose(self, text: str) -> Document:
        """The document with positions, aliases resolved to shared nodes. Raises DocumentError."""
        root: Node | None = None
        self._printable(text)
        try:
            events = iter(YAML(typ="safe", pure=True).parse(text))
            for event in events:
                if isinstance(event, DocumentStartEvent):
                    if root is not None:
                        raise self._error(event, "a second document begins here, but a scene is one document")
                    root = self._node(next(events), events)
        except MarkedYAMLError as error:
            raise DocumentError(self._syntax(error, text)) from None
        except (YAMLError, ValueError, RecursionError) as error:
            first = str(error).partition("\n")[0]
            raise DocumentError(
                Problem(SourcePosition(self.source), f"this is not YAML text: {first}.")
            ) from None
        root = root or Node(self._position(1, 1))
        return Document(self.source, root, self.problems, aliased=self.aliased)

    def _printable(self, text: str) -> None:
        """Raise DocumentError with the position of the first character that YAML does not allow."""
        if found := _FORBIDDEN.search(text):
            lines = text[: found.start()].splitlines() or [""]
            position = self._position(len(lines), len(lines[-1]) + 1)
            code = f"U+{ord(found.group()):04X}"
            raise DocumentError(
                Problem(position, f"the text contains the control character {code}; delete it.")
            )

    def _position(self, line: int, column: int) -> SourcePosition:
        if not self.with_positions:
            return SourcePosition(self.source)
        return SourcePosition(self.source, line, column)

    def _at(self, event: Event) -> SourcePosition:
        return self._position(event.start_mark.line + 1, event.start_mark.column + 1)

    def _error(self, event: Event, sentence: str) -> DocumentError:
        return DocumentError(Problem(self._at(event), sentence + "."))

    def _syntax(self, error: MarkedYAMLError, text: str) -> Problem:
        """The problem of a syntax error of the parser, at the position that helps most."""
        mark = error.problem_mark or error.context_mark
        if error.context_mark and _starts_helps_more(error):
            mark = error.context_mark
        if mark is None:
            return Problem(SourcePosition(self.source), _syntax_sentence(error, ""))
        lines = text.splitlines()
        line, column = mark.line, mark.column
        if "mapping values are not allowed" in str(error.problem):
            line, column, sentence = _second_key(lines, line, column)
        else:
            sentence = _syntax_sentence(error, lines[line] if line < len(lines) else "")
        return Problem(self._position(line + 1, column + 1), sentence)

    def _node(self, event: Any, events: Iterator[Event]) -> Node:
        """The node that begins with an event; consumes its events. Raises DocumentError for a tag."""
        if isinstance(event, AliasEvent):
            return self._alias(event)
        if getattr(event, "tag", None):
            tag = event.tag.replace(_YAML_TAGS, "!!")
            raise self._error(event, f"the tag {tag} is not supported in scenes; remove it")
        if event.anchor:
            self.anchors[event.anchor] = None
        if isinstance(event, ScalarEvent):
            value = resolve(event.value) if event.style is None else event.value
            node = Node(self._at(event), scalar=value, text=event.value)
        elif isinstance(event, SequenceStartEvent):
            node = self._list(event, events)
        else:
            node = self._mapping(event, events)
        if event.anchor:
            self.anchors[event.anchor] = node
        return node

    def _alias(self, event: AliasEvent) -> Node:
        """The node of an anchor. Raises DocumentError for an unknown anchor or a recursive alias."""
        if event.anchor not in self.anchors:
            raise self._error(event, f"the alias *{event.anchor} has no anchor &{event.anchor} above it")
        node = self.anchors[event.anchor]
        if node is None:
            raise self._error(event, f"the alias *{event.anchor} contains itself")
        self.aliased.append(node)
        return node

    def _list(self, start: SequenceStartEvent, events: Iterator[Event]) -> Node:
        """The node of a list."""
        items: list[Node] = []
        while not isinstance(event := next(events), SequenceEndEvent):
            items.append(self._node(event, events))
        return Node(self._at(start), items=items)

    def _mapping(self, start: MappingStartEvent, events: Iterator[Event]) -> Node:
        """The node of a mapping; a duplicate key is a problem."""
        entries: dict[str, MappingEntry] = {}
        while not isinstance(event := next(events), MappingEndEvent):
            key = self._key(event)
            entry = MappingEntry(self._at(event), self._node(next(events), events))
            if entry.node.is_empty:
                entry.node.position = entry.key_position  # the parser reports the position of the next token
            if key in entries:
                first = entries[key].key_position
                self.problems.append(
                    Problem(
                        entry.key_position, f"{key} is a duplicate of the key at line {first.line}. Keep one."
                    )
                )
            else:
                entries[key] = entry
        return Node(self._at(start), entries=entries)

    def _key(self, event: Any) -> str:
        """The text of a key. Raises DocumentError for other values, and for the merge key <<."""
        if not isinstance(event, ScalarEvent) or event.tag:
            raise self._error(event, "a key must be plain text, such as radius")
        if event.value == "<<" and event.style is None:
            raise self._error(event, "the merge key << is not part of YAML 1.2; write the keys out")
        return event.value


def _starts_helps_more(error: MarkedYAMLError) -> bool:
    """Whether the start of the construct is more useful than the point where the parser failed."""
    context = str(error.context)
    return "simple key" in context or "flow" in context or "quoted" in context


_NO_COLON = '"{}" has no colon. Write key: value, with a space after the colon.'
_NO_SPACE = re.compile(r"\s*(-\s+)?[\w-]+:(?=[\w\"'\[{.+-])")


def _second_key(lines: list[str], line: int, column: int) -> tuple[int, int, str]:
    """Line, column and sentence for a colon at a place where no key can be; lines and columns from 0.

    The cause is this line, or the line above that the parser has joined with it: one without a colon, or one
    whose key has a value already.
    """
    start = len(lines[line]) - len(lines[line].lstrip())
    if missing := _NO_SPACE.match(lines[line]):
        return line, missing.end() - 1, "a space is missing after this colon. Write key: value."
    before = [number for number in range(line) if lines[number].partition("#")[0].strip()]
    if before and ": " not in lines[line][:column]:
        above = lines[before[-1]].partition(" #")[0].rstrip()
        indent = len(above) - len(above.lstrip())
        if not re.search(r":(\s|$)", above):
            return before[-1], indent, _NO_COLON.format(above.strip())
        if start > indent:
            reason = "this line is indented more than the line above, whose key has a value already. "
            return line, start, f"{reason}Align both keys, or remove that value."
    sentence = (
        "a second key begins here. Write each key on a separate line, and put text with a colon in quotes."
    )
    return line, column, sentence


_MISPLACED = {
    "-": "a list item begins here, but keys are above it. Remove the hyphen, or begin all of them with one.",
    "?": "a key begins here, but list items are above it. Align it with the keys of its item.",
    "]": "no [ is open for this ]; remove it.",
    "}": "no { is open for this }; remove it.",
    ",": "a value ends before this comma; put lists in [ ] and text with quotes in it in double quotes.",
    "<scalar>": "a value ends before this text. Put text with quotes in double quotes, units into brackets.",
}
"""Sentences on what the parser has found in place of the end of a block."""
_INDENTATION = (
    "the indentation of this line is not that of the entries above, or the key above has a value already. "
    "Align the entries with spaces."
)


def _syntax_sentence(error: MarkedYAMLError, line: str) -> str:
    """A sentence on a syntax error with its remedy; `line`: text of the line with the error."""
    problem = str(error.problem or error.context)
    context = str(error.context)
    if r"\t" in problem or "'\t'" in problem:
        if line[: len(line) - len(line.lstrip())].count("\t"):
            return "the indentation contains a tab, but YAML requires spaces. Replace the tab by spaces."
        return "a tab is before this value, but a space is expected. Replace the tab by a space."
    if "cannot start any token" in problem:
        return f"text cannot begin with {line[error.problem_mark.column]}; put it in quotes."
    found = re.search(r"but found '(.*)'", problem)
    if "expected <block end>" in problem and found:
        return _MISPLACED.get(found[1], _INDENTATION)
    if "simple key" in context:
        return _NO_COLON.format(line.strip())
    if "quoted" in context:
        return "the quote that opens here is not closed."
    if "flow node" in context:
        return "a value is missing here; a negative number has no space after its sign."
    for kind, opening, closing in (("sequence", "[", "]"), ("mapping", "{", "}")):
        if "flow " + kind in context:
            return f"the {opening} that opens here is not closed by {closing}, or a comma is missing in it."
    return f"this is not YAML: {problem}."


_WORDS = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
_INTEGER = re.compile(r"[-+]?[0-9]+")
_BASED = re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_INFINITY = re.compile(r"[-+]?\.(inf|Inf|INF)")
_NAN = re.compile(r"\.(nan|NaN|NAN)")
_MAX_INTEGER_DIGITS = 400  # longer integers exceed the range of float


def resolve(text: str) -> Any:
    """The YAML 1.2 value of plain text (core schema): `012` is 12, `1e-5` is 0.00001, `yes` is text.

    None, bool, int, float or str; an integer with more than 400 digits is infinity.
    """
    if text in _WORDS:
        return _WORDS[text]
    if _INTEGER.fullmatch(text) or _BASED.fullmatch(text):
        base = 0 if text.startswith(("0o", "0x")) else 10
        return int(text, base) if len(text) <= _MAX_INTEGER_DIGITS else math.inf
    if _FLOAT.fullmatch(text):
        return float(text)
    if _INFINITY.fullmatch(text):
        return -math.inf if text.startswith("-") else math.inf
    return math.nan if _NAN.fullmatch(text) else text


# A Python mapping to a tree, whose positions are key paths such as `materials.glass.restitution`

ROOT = "scene"
"""Position of the whole scene in messages."""


def document_of(data: Mapping[str, Any], root: str = ROOT) -> Document:
    """The tree of a mapping of keys to values, as in a scene file; `root`: its name in messages.

    Values: numbers, text with units, lists, tuples, numpy arrays, mappings, paths, and parts of another
    scene. Problems of the document: keys that are not text, and values of other types.
    """
    document = Document(root, Node(SourcePosition(root)), subject="the scene" if root == ROOT else root)
    document.root = node_of(data, (), document)
    return document


def node_of(value: Any, path: KeyPath, document: Document) -> Node:
    """The value at a path of keys and indices, and all values below it; adds problems to the document."""
    position = _path_position(path, document.source)
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
            entries[str(key)] = MappingEntry(
                _path_position(below, document.source), node_of(each, below, document)
            )
        return Node(position, entries=entries)
    if isinstance(value, list | tuple):
        return Node(
            position, items=[node_of(each, (*path, index), document) for index, each in enumerate(value)]
        )
    if isinstance(value, Path):
        value = str(value)
    if not isinstance(value, str | int | float | None):
        kind = type(value).__name__
        document.problems.append(
            Problem(position, f"a value is of type {kind}; give a number, text, list or mapping.")
        )
        value = None
    return Node(position, scalar=value, text=_text_of(value))


def _text_of(value: str | float | None) -> str:
    """The value in the notation of scene files; empty for None."""
    if value is None:
        return ""
    return value if isinstance(value, str) else json.dumps(value)


def _path_position(path: KeyPath, root: str) -> SourcePosition:
    return SourcePosition(".".join(map(str, path)) or root)


# Plain data to YAML text

_WIDTH = 110  # characters of the longest line with a whole mapping or list
_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_. /-]*[A-Za-z0-9_]|[A-Za-z_]")


def yaml_text(value: Any, indent: int = 0) -> str:
    """YAML text of plain data: dict, list or tuple, str, bool, int, float. Short values are on one line.

    `indent`: number of leading spaces. Floats have as many digits as their value requires; text that YAML
    would read as another type is quoted.
    """
    pad = " " * indent
    if isinstance(value, dict):
        return "".join(f"{pad}{key}:{_yaml_below(each, indent)}" for key, each in value.items())
    return "".join(f"{pad}- {_yaml_item(each, indent)}" for each in value)


def _yaml_below(value: Any, indent: int) -> str:
    """The value of a key: on the same line if it fits, else indented below."""
    line = yaml_inline(value)
    if len(line) + indent <= _WIDTH or not isinstance(value, dict | list | tuple):
        return f" {line}\n"
    return "\n" + yaml_text(value, indent + 2)


def _yaml_item(value: Any, indent: int) -> str:
    """An item of a list: on the same line if it fits, else its first line after the hyphen."""
    line = yaml_inline(value)
    if len(line) + indent <= _WIDTH or not isinstance(value, dict | list | tuple):
        return f"{line}\n"
    return yaml_text(value, indent + 2).lstrip(" ")


def yaml_inline(value: Any) -> str:
    """A value on one line, in the notation of YAML flow collections."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {yaml_inline(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(yaml_inline(each) for each in value) + "]"
    if isinstance(value, str):
        plain = _PLAIN.fullmatch(value) and isinstance(resolve(value), str) and ": " not in value
        return value if plain else '"' + "".join(map(_yaml_escaped, value)) + '"'
    return json.dumps(value)


def _yaml_escaped(character: str) -> str:
    """A character with the escape that double-quoted YAML text requires."""
    if character in '"\\':
        return "\\" + character
    return character if character.isprintable() else f"\\U{ord(character):08x}"
