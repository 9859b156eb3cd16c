"""Reads the JSON Schema of scenes: its parts, their keys, and the type, unit, range and default of each key."""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

from granflow.scene.jsonschema import json_schema
from granflow.scene.schema.units import DIMENSIONS, Dimension

ROOT = "scene"
"""Name of the part with the keys of the first level."""
REFERENCE = "#/$defs/"
ANY_NAME = "NAME"
"""Placeholder of a name in a key path, such as walls.NAME.radius."""
PLAIN_TEXT = re.compile(r"[\w./^+%°-][\w./^+%° -]*")
"""Text that YAML does not require in quotes."""


@dataclass(frozen=True)
class Key:
    """A key of a part of a scene.

    part, name:   name of the part in the schema, and of the key
    schema:       JSON Schema of the value
    is_required:  whether the part requires the key
    """

    part: str
    name: str
    schema: dict[str, Any]
    is_required: bool

    @property
    def description(self) -> str:
        """Description in the schema; empty without one."""
        return str(self.schema.get("description", ""))

    @property
    def default(self) -> str:
        """Default as YAML; "required" or "none" without one."""
        if self.is_required:
            return "required"
        value = self.schema.get("default")
        if value is None and "default:" in self.description:
            return self.description.partition("default:")[2].partition(";")[0].strip()
        if isinstance(value, dict) and value:
            return "its defaults"
        return "none" if value in (None, {}, []) else as_yaml(value)


@cache
def parts() -> dict[str, dict[str, Any]]:
    """Schemas of all parts of a scene by name; the first is ROOT."""
    schema = json_schema()
    return {ROOT: schema, **schema["$defs"]}


def keys(part: str) -> list[Key]:
    """Keys of a part, in the order of the schema."""
    schema = parts()[part]
    always = set(schema.get("required", ()))
    return [Key(part, name, value, name in always) for name, value in schema.get("properties", {}).items()]


def all_keys() -> Iterator[Key]:
    """Keys of all parts."""
    for part in parts():
        yield from keys(part)


def alternatives(schema: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Schemas of the values that a key accepts, without unions; null is omitted."""
    for union in ("anyOf", "oneOf"):
        if union in schema and "properties" not in schema:
            for each in schema[union]:
                yield from alternatives(each)
            return
    if schema.get("type") != "null":
        yield schema


def referenced(schema: dict[str, Any]) -> str | None:
    """Name of the part to which a schema refers; None for other schemas."""
    target = schema.get("$ref", "")
    return target.removeprefix(REFERENCE) if target else None


def children(schema: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Parts that a value can contain, each with the path that leads there: "", ".NAME" or "[]"."""
    for each in alternatives(schema):
        if part := referenced(each):
            yield "", part
        for inner in each.get("patternProperties", {}).values():
            yield from ((f".{ANY_NAME}{path}", part) for path, part in children(inner))
        if isinstance(each.get("items"), dict):
            yield from ((f"[]{path}", part) for path, part in children(each["items"]))
        for inner in each.get("prefixItems", ()):
            yield from ((f"[]{path}", part) for path, part in children(inner))


@cache
def places() -> dict[str, list[str]]:
    """Key paths at which each part occurs, in the order of the scene; those of nested parts start at the first path."""
    found: dict[str, list[str]] = {ROOT: [""]}
    waiting = [ROOT]
    while waiting:
        part = waiting.pop(0)
        for key in keys(part):
            for path, inner in children(key.schema):
                place = f"{found[part][0]}.{key.name}{path}".lstrip(".")
                if inner not in found:
                    waiting.append(inner)
                if place not in found.setdefault(inner, []):
                    found[inner].append(place)
    return found


def clear_schema() -> None:
    """Clear what was derived from the schema; required after a change of the schema."""
    parts.cache_clear()
    places.cache_clear()


def variant(part: str) -> str:
    """Key and value that select a part of a union, such as `shape: cone`; empty for other parts."""
    constants = {key: value["const"] for key, value in parts()[part].get("properties", {}).items() if "const" in value}
    return next((f"{key}: {value}" for key, value in constants.items()), "")


def as_yaml(value: Any) -> str:
    """A value as YAML on one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(as_yaml(each) for each in value)}]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {as_yaml(each)}" for key, each in value.items() if each is not None) + "}"
    text = str(value)
    return text if not isinstance(value, str) or PLAIN_TEXT.fullmatch(text) else json.dumps(text, ensure_ascii=False)


def dimension_of(schema: dict[str, Any]) -> Dimension | None:
    """Dimension of a number with a unit, from the pattern of its text; None for other schemas."""
    units = re.search(r"\((?:\?:)?([^()]*)\)\?\\s\*\$$", schema.get("pattern", ""))
    if units is None:
        return None
    for dimension in DIMENSIONS.values():
        if "|".join(map(re.escape, dimension.units)) == units[1]:
            return dimension
    return None


def si_unit(dimension: Dimension) -> str:
    """SI unit of a dimension; empty for a dimensionless number."""
    unit = next(iter(dimension.units))
    return "" if unit == "%" else unit
