"""The text of a scene: YAML in the style of the shipped scenes, with units and the lines of the script.

The families put blocks into a `Draft`; `Draft.text` writes it. Numbers with units are texts, made by
`quantity`.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from granflow.importing.report import Entry

BLOCKS = (
    *("title", "description", "seed", "gravity", "materials", "pairs", "contact", "damping", "walls"),
    *("start_from", "particles", "outlets", "domain", "stages", "run", "numerics", "output"),
)
"""Blocks in the order of a scene file."""
WIDTH = 110
"""Longest line of a mapping that is written in one line [characters]."""
LONGEST_COMMENT = 100
"""Longest text of a line of the script in a comment [characters]."""
SCALES: dict[str, tuple[tuple[float, str], ...]] = {
    "length": ((1.0, "m"), (1e-3, "mm"), (1e-6, "um")),
    "time": ((1.0, "s"), (1e-3, "ms"), (1e-6, "us"), (1e-9, "ns")),
    "pressure": ((1e9, "GPa"), (1e6, "MPa"), (1e3, "kPa"), (1.0, "Pa")),
    "velocity": ((1.0, "m/s"), (1e-3, "mm/s")),
    "mass": ((1.0, "kg"), (1e-3, "g"), (1e-6, "mg")),
    "mass_flow": ((1.0, "kg/s"), (1e-3, "g/s")),
    "rate": ((1.0, "1/s"),),
    "stiffness": ((1e3, "kN/m"), (1.0, "N/m")),
    "angular_velocity": ((1.0, "rad/s"),),
    "energy_density": ((1e3, "kJ/m3"), (1.0, "J/m3")),
    "surface_energy": ((1.0, "J/m2"), (1e-3, "mJ/m2")),
    "force": ((1.0, "N"), (1e-3, "mN")),
}
"""Units by dimension, the largest first; the first that makes a number of at least 1 is taken."""


def quantity(value: float, dimension: str) -> str | float:
    """A number with its unit, such as `4 mm`; 0 has none."""
    if value == 0.0:
        return 0
    scales = SCALES[dimension]
    scale, unit = next((each for each in scales if abs(value) >= 0.9999999 * each[0]), scales[-1])
    return f"{number(value / scale)} {unit}"


def quantities(values: Iterable[float], dimension: str) -> list[str | float]:
    """A list of numbers with their units."""
    return [quantity(each, dimension) for each in values]


def number(value: float) -> str:
    """A number with at most 12 digits, without an exponent where that is short."""
    return f"{value:.12g}"


def plain_name(name: str, prefix: str) -> str:
    """A name of the script as a scene permits it; `prefix` precedes one that begins with no letter."""
    plain = "".join(each if each.isascii() and each.isalnum() else "_" for each in name).lower()
    return plain if plain[:1].isalpha() else f"{prefix}_{plain}"


def comment_of(entry: Entry, with_file: bool) -> str:
    """The comment with the line of the script; `with_file`: with the name of its file."""
    command = entry.command
    text = command.text
    if len(text) > LONGEST_COMMENT:
        text = f"{text[: LONGEST_COMMENT - 4]} ..."
    return f"{command.where}: {text}" if with_file else f"line {command.line}: {text}"


@dataclass
class Draft:
    """The blocks of a scene before they are text.

    with_files:  whether comments name the file of a line, because the script has several
    files:       files that are written next to the scene, by name: bytes
    """

    with_files: bool = False

    blocks: dict[str, Any] = field(default_factory=dict)
    comments: dict[tuple[str, ...], list[str]] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)
    owners: dict[tuple[str, ...], tuple[Entry, ...]] = field(default_factory=dict)
    """The commands that a key comes from."""

    def put(self, path: Sequence[str], value: Any, *entries: Entry, remark: str = "") -> None:
        """Set the value of a key; the entries become its comments, and are told that they are translated."""
        *parents, last = path
        block = self.blocks
        for key in parents:
            block = block.setdefault(key, {})
        block[last] = value
        self.owners[tuple(path)] = entries
        for entry in entries:
            entry.translated(".".join(path))
        self.remark(path, *entries, remark=remark)

    def remark(self, path: Sequence[str], *entries: Entry, remark: str = "") -> None:
        """Add entries and a remark to the comments of a key."""
        found = [*(comment_of(each, self.with_files) for each in entries), *([remark] if remark else [])]
        notes = self.comments.setdefault(tuple(path), [])
        notes.extend(each for each in found if each not in notes)

    def get(self, *path: str) -> Any:
        """The value of a key; None without one."""
        block: Any = self.blocks
        for key in path:
            block = block.get(key) if isinstance(block, dict) else None
        return block

    def remove(self, *path: str) -> None:
        """Remove a key."""
        *parents, last = path
        block = self.get(*parents) if parents else self.blocks
        if isinstance(block, dict):
            block.pop(last, None)
        self.comments.pop(path, None)

    def add_file(self, name: str, content: bytes) -> str:
        """Add a file beside the scene and return its name, which differs from those of other contents."""
        stem, dot, end = name.rpartition(".")
        for count in range(1, 1000):
            free = name if count == 1 else f"{stem}_{count}{dot}{end}"
            if self.files.setdefault(free, content) == content:
                return free
        raise AssertionError("there are too many files of one name")

    def text(self, origin: str) -> str:
        """The scene as YAML; `origin`: what it was made from, for the first line."""
        lines = [f"# {origin}"]
        for block in BLOCKS:
            value = self.blocks.get(block)
            if value is None or value == {}:
                continue
            lines += [""] if block in BLOCKS[BLOCKS.index("materials") :] else []
            lines += self._key((block,), value, 0)
        return "\n".join(lines) + "\n"

    def _key(self, path: tuple[str, ...], value: Any, depth: int) -> list[str]:
        """The lines of one key, after its comments."""
        indent = "  " * depth
        lines = [f"{indent}# {each}" for each in self.comments.get(path, ())]
        line = f"{indent}{path[-1]}: {flow(value)}"
        inner = isinstance(value, dict) and value
        commented = inner and any(self.comments.get((*path, key)) for key in value)
        opened = inner and depth == 0 and not _is_flat(value)
        if not (commented or opened) and (len(line) <= WIDTH or not inner):
            if isinstance(value, list) and len(line) > WIDTH and isinstance(value[0], dict):
                items = (each for item in value for each in _item(item, f"{indent}  "))
                return [*lines, f"{indent}{path[-1]}:", *items]
            return [*lines, line]
        lines.append(f"{indent}{path[-1]}:")
        for key, each in value.items():
            lines += self._key((*path, key), each, depth + 1)
        return lines


def _item(value: dict[str, Any], indent: str) -> list[str]:
    """The lines of one entry of a list: one, or if that is too long, one for each key."""
    line = f"{indent}- {flow(value)}"
    if len(line) <= WIDTH:
        return [line]
    found = []
    for number, (key, each) in enumerate(value.items()):
        start = f"{indent}{'  ' if number else '- '}{key}:"
        is_long = (
            len(f"{start} {flow(each)}") > WIDTH and isinstance(each, list) and isinstance(each[0], dict)
        )
        found.append(start if is_long else f"{start} {flow(each)}")
        found += [line for item in each for line in _item(item, f"{indent}    ")] if is_long else []
    return found


def motions_of(keys: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The motions in the keys of a wall, whose value is a motion or a list of motions."""
    motion = keys.get("motion", [])
    return motion if isinstance(motion, list) else [motion]


def _is_flat(value: dict[str, Any]) -> bool:
    return not any(isinstance(each, dict) for each in value.values())


def flow(value: Any) -> str:
    """A value in one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {flow(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(flow, value)) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float | int):
        return number(value)
    if re.fullmatch(r"[A-Za-z0-9_./+-][A-Za-z0-9_ ./%+-]*", value):
        return str(value)
    escaped = str(value).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
