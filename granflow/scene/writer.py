"""Writes a scene as YAML with all defaults; the text loads to an equal scene.

Numbers are plain SI values with all digits that they need.
"""

import json
import re
from typing import Any

from granflow.scene.yaml12 import resolve

_WIDTH = 110  # characters of the longest line with a whole mapping or list
_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_. /-]*[A-Za-z0-9_]|[A-Za-z_]")


def to_yaml(value: Any, indent: int = 0) -> str:
    """YAML text of plain data (dict, list or tuple, str, bool, int, float); short values are on one line.

    `indent`: number of leading spaces. Floats have as many digits as their value requires; text that YAML would read as
    another type is quoted.
    """
    pad = " " * indent
    if isinstance(value, dict):
        return "".join(f"{pad}{key}:{_below(each, indent)}" for key, each in value.items())
    return "".join(f"{pad}- {_in_list(each, indent)}" for each in value)


def _below(value: Any, indent: int) -> str:
    """The value of a key: on the same line if it fits, else indented below."""
    line = _inline(value)
    if len(line) + indent <= _WIDTH or not isinstance(value, dict | list | tuple):
        return f" {line}\n"
    return "\n" + to_yaml(value, indent + 2)


def _in_list(value: Any, indent: int) -> str:
    """An item of a list: on the same line if it fits, else its first line after the hyphen."""
    line = _inline(value)
    if len(line) + indent <= _WIDTH or not isinstance(value, dict | list | tuple):
        return f"{line}\n"
    return to_yaml(value, indent + 2).lstrip(" ")


def _inline(value: Any) -> str:
    """A value on one line, in the notation of YAML flow collections."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_inline(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_inline(each) for each in value) + "]"
    if isinstance(value, str):
        plain = _PLAIN.fullmatch(value) and isinstance(resolve(value), str) and ": " not in value
        return value if plain else '"' + "".join(map(_escaped, value)) + '"'
    return json.dumps(value)


def _escaped(character: str) -> str:
    """A character with the escape that double-quoted YAML text requires."""
    if character in '"\\':
        return "\\" + character
    return character if character.isprintable() else f"\\U{ord(character):08x}"
