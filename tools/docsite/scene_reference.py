"""Reference page of scene keys: one section per part, one row per key."""

from collections.abc import Iterator
from typing import Any

from docsite.markdown import anchor, code, table
from granflow.scene.reference import (
    ROOT,
    Key,
    example_of,
    first_key,
    keys,
    parts,
    places,
    range_text,
    type_text,
    variant,
)

INTRODUCTION = """\
# Scene keys

This page is generated from the schema that reads scenes; `granflow schema` prints the same schema for editors, and
`granflow schema walls.motion.servo` one block or key of it. A
number without a unit is in the SI unit in brackets; text with a unit is accepted as well, such as `4 mm`, `1 GPa`,
`30 deg` ([units](units.md)). In a path, `NAME` is a name of your choice (lowercase letters, digits and `_`), and `[]`
is an item of a list. Material and contact properties have no defaults. `granflow check SCENE` reports all errors of a
scene at once.
"""

FIRST_LEVEL = "The blocks of a scene file. A scene with only the required blocks is complete."


class UndocumentedError(Exception):
    """A key of the schema has no description or type."""


def page() -> str:
    """The page in Markdown. Raises UndocumentedError for a key without description or type."""
    ordered = [part for part in places() if part in parts()]
    if unreachable := set(parts()) - set(ordered):
        raise UndocumentedError(f"no key path leads to {', '.join(sorted(unreachable))}")
    return "\n".join([INTRODUCTION, *(section(part) for part in ordered)])


def section(part: str) -> str:
    """Heading, description and keys of a part."""
    description = FIRST_LEVEL if part == ROOT else str(parts()[part].get("description", "")).strip()
    lines = [f"## {title(part)} {{ #{anchor(part)} }}\n", f"{description}\n"]
    if len(places()[part]) > 1:
        lines.append(f"Used at {', '.join(map(code, places()[part]))}.\n")
    lines.append(table(("key", "value [SI unit]", "meaning and example"), map(row, keys(part))))
    lines += _requirements(parts()[part])
    return "\n".join(lines)


def title(part: str) -> str:
    """Heading of a part: its first key path, and the key that selects it."""
    if part == ROOT:
        return "First level"
    place = places()[part][0]
    is_shared = sum(each[0] == place for each in places().values()) > 1
    chosen = variant(part) or (first_key(part) if is_shared else "")
    return code(place) + (f" with {code(chosen)}" if chosen else "")


def row(key: Key) -> tuple[str, ...]:
    """Cells of a key. Raises UndocumentedError without description or type."""
    kind = type_text(key.schema, part_link)
    if not key.description or not kind:
        path = f"{places()[key.part][0]}.{key.name}".lstrip(".")
        raise UndocumentedError(f"{path} has no {'type' if key.description else 'description'} in the schema")
    name = f'<span id="{key_anchor(key)}"></span>{code(key.name)}'
    default = "required" if key.default == "required" else f"default: {code(key.default)}"
    value = [kind, range_text(key.schema), default]
    return name, "<br>".join(filter(None, value)), f"{key.description}<br>{code(example_of(key))}"


def part_link(part: str, label: str) -> str:
    """Link to the section of a part: the key that selects it, or the label."""
    return f"[{variant(part) or label}](#{anchor(part)})"


def key_anchor(key: Key) -> str:
    """Identifier of a key in the page."""
    return anchor(f"{key.part} {key.name}")


def _requirements(schema: dict[str, Any]) -> Iterator[str]:
    """Sentence on keys of which one set is required."""
    sets = [each["required"] for each in schema.get("anyOf", ()) if "required" in each]
    if sets:
        yield f"Required: {' or '.join(', '.join(map(code, names)) for names in sets)}.\n"
