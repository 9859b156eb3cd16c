"""Reference pages of scene keys: one page per block, one section per part, one row per key."""

from collections.abc import Iterator
from functools import cache
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

These pages are generated from the schema that reads scenes; `granflow schema` prints the same schema for editors, and
`granflow schema walls.motion.servo` one block or key of it. A
number without a unit is in the SI unit in brackets; text with a unit is accepted as well, such as `4 mm`, `1 GPa`,
`30 deg` ([units](units.md)). In a path, `NAME` is a name of your choice (lowercase letters, digits and `_`), and `[]`
is an item of a list. Material and contact properties have no defaults. `granflow check SCENE` reports all errors of a
scene at once.
"""

FIRST_LEVEL = "The blocks of a scene file. A scene with only the required blocks is complete."


class UndocumentedError(Exception):
    """A key of the schema has no description or type."""


OVERVIEW = "scene"
"""Name of the page of the first level."""


@cache
def pages() -> dict[str, str]:
    """The pages in Markdown by name, without folder and suffix; those of the blocks are in the folder `scene`.

    Raises UndocumentedError for a key without description or type.
    """
    if unreachable := set(parts()) - set(places()):
        raise UndocumentedError(f"no key path leads to {', '.join(sorted(unreachable))}")
    found: dict[str, list[str]] = {OVERVIEW: [INTRODUCTION]}
    for part in places():
        if part in parts():
            block = page_of(part)
            found.setdefault(block, [f"# {code(block.partition('/')[2])}\n"]).append(section(part))
    found[OVERVIEW].append(_index([block for block in found if block != OVERVIEW]))
    return {name: "\n".join(lines) for name, lines in found.items()}


def page_of(part: str) -> str:
    """Name of the page of a part: that of the block of its first key path; motions have their own."""
    place = places()[part][0]
    if not place:
        return OVERVIEW
    block = "motion" if place.startswith("walls.NAME.motion") else place.partition(".")[0].removesuffix("[]")
    return f"{OVERVIEW}/{block}"


def _index(blocks: list[str]) -> str:
    """The table of the pages and their parts."""
    rows = []
    for block in blocks:
        own = [part for part in places() if part in parts() and page_of(part) == block]
        links = ", ".join(f"[{_label(part)}]({block}.md#{anchor(part)})" for part in own)
        rows.append((f"[{code(block.partition('/')[2])}]({block}.md)", links))
    return f"## Pages of the blocks\n\n{table(('block', 'parts'), rows)}"


def _label(part: str) -> str:
    """Words for a part in the table: what selects it, otherwise its key."""
    place = places()[part][0]
    if variant(part):
        return variant(part).partition(": ")[2]
    is_shared = sum(each[0] == place for each in places().values()) > 1
    return first_key(part) if is_shared else place.removesuffix(".NAME").rpartition(".")[2].removesuffix("[]")


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
    kind = type_text(key.schema, lambda part, label: part_link(part, label, page_of(key.part)))
    if not key.description or not kind:
        path = f"{places()[key.part][0]}.{key.name}".lstrip(".")
        raise UndocumentedError(f"{path} has no {'type' if key.description else 'description'} in the schema")
    name = f'<span id="{key_anchor(key)}"></span>{code(key.name)}'
    default = "required" if key.default == "required" else f"default: {code(key.default)}"
    value = [kind, range_text(key.schema), default]
    return name, "<br>".join(filter(None, value)), f"{key.description}<br>{code(example_of(key))}"


def part_link(part: str, label: str, page: str) -> str:
    """Link from a page to the section of a part: the key that selects it, or the label."""
    target = page_of(part)
    if target == page:
        address = ""
    else:
        address = f"{target if page == OVERVIEW else target.removeprefix(OVERVIEW + '/')}.md"
    return f"[{variant(part) or label}]({address}#{anchor(part)})"


def key_anchor(key: Key) -> str:
    """Identifier of a key in the page."""
    return anchor(f"{key.part} {key.name}")


def _requirements(schema: dict[str, Any]) -> Iterator[str]:
    """Sentence on keys of which one set is required."""
    sets = [each["required"] for each in schema.get("anyOf", ()) if "required" in each]
    if sets:
        yield f"Required: {' or '.join(', '.join(map(code, names)) for names in sets)}.\n"
