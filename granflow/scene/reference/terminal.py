"""Text of the reference of scene keys for a terminal: one key, or the keys of a block."""

import textwrap
from collections.abc import Iterator

from granflow.scene.reference.examples import example_of
from granflow.scene.reference.key_paths import Place, places_of, suggestion
from granflow.scene.reference.schema_keys import ROOT, Key, keys, parts, variant
from granflow.scene.reference.value_types import first_key, range_text, type_text

WIDTH = 100
"""Characters of a line."""

MOST_VARIANTS = 1
"""Number of variants of a block whose keys are listed; more are listed by name only."""


def reference_of(path: str) -> str:
    """Type, unit, default, range, example and meaning of a key, and the keys of the block to which a path leads.

    Raises KeyError with a sentence if there is no such key.
    """
    found = [Place("", None, (ROOT,))] if not path else places_of(path)
    if not found:
        hint = suggestion(path)
        remedy = f"Did you mean {hint}?" if hint else "List the blocks with granflow schema scene."
        raise KeyError(f"{path} is not a key of a scene. {remedy}")
    return "\n\n".join("\n".join(_lines(place)) for place in found)


def _lines(place: Place) -> Iterator[str]:
    """Lines of a key with its facts, or of a block with its keys."""
    if place.key is not None and place.key.schema:
        yield from _key_lines(place.key, place.path)
    elif len(place.parts) != MOST_VARIANTS or not variant(place.parts[0]):
        yield place.path or ROOT
    if len(place.parts) > MOST_VARIANTS:
        yield from ("", f"Add one of these to the path to list its keys, such as {place.path}.{_name(place.parts[0])}:")
        yield from _columns([(_name(part), _first_sentence(part)) for part in place.parts])
    for part in place.parts if len(place.parts) <= MOST_VARIANTS else ():
        yield from _part_lines(place, part)


def _key_lines(key: Key, path: str) -> Iterator[str]:
    yield path
    facts = {
        "meaning": key.description,
        "value": _plain(type_text(key.schema)),
        "allowed": _plain(range_text(key.schema)),
        "default": "none: the key is required" if key.is_required else key.default,
        "example": example_of(key),
    }
    yield from _columns([(name, text) for name, text in facts.items() if text])


def _part_lines(place: Place, part: str) -> Iterator[str]:
    """Description of a block, and one line for each of its keys."""
    if variant(part):
        yield f"{place.path} with {variant(part)}".strip()
    description = "" if part == ROOT else str(parts()[part].get("description", ""))
    yield from ("", *(f"  {line}".rstrip() for line in description.splitlines()), *([""] if description else []))
    rows = []
    for key in keys(part):
        default = "; required" if key.is_required else f"; default: {key.default}"
        default = "" if "default:" in key.description else default
        rows.append((key.name, f"{_plain(type_text(key.schema))}{default}. {key.description}"))
    yield from _columns(rows)


def _name(part: str) -> str:
    """Word that selects a variant of a block: the value of its `kind`, or its first key."""
    return variant(part).partition(": ")[2] or first_key(part)


def _first_sentence(part: str) -> str:
    return str(parts()[part].get("description", "")).partition("\n")[0]


def _plain(text: str) -> str:
    """Text without the marks of Markdown."""
    return text.replace("`", "")


def _columns(rows: list[tuple[str, str]]) -> Iterator[str]:
    """Names and wrapped texts in two columns."""
    width = max((len(name) for name, _ in rows), default=0) + 4
    for name, text in rows:
        wrapped = textwrap.wrap(text, max(WIDTH - width, 30), break_on_hyphens=False) or [""]
        yield f"  {name:{width - 2}}{wrapped[0]}"
        yield from (" " * width + line for line in wrapped[1:])
