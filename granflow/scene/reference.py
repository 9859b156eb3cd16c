"""Reference of the keys of a scene: the JSON Schema, and what `granflow schema KEY` prints.

`json_schema` exports the pydantic schema. The rest of this file reads that export: `parts` and `keys` are the
blocks and their keys, `type_text` and `range_text` describe a value in words, `example_of` gives an example,
`places_of` finds the key that a path such as walls.belt.motion.velocity means, and `reference_of` is the text
for a terminal. The documentation site uses the same functions.
"""

import json
import re
import textwrap
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from pydantic.json_schema import GenerateJsonSchema
from ruamel.yaml import YAML

from granflow.io.files import example_paths
from granflow.scene.blocks.scene import SceneInput
from granflow.schema.messages import nearest
from granflow.schema.model import DEFAULT_IN_WORDS, DIMENSION, NOTES
from granflow.units import DIMENSIONS, Dimension

# JSON Schema of scene files, for completion and validation in editors

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_TITLE = "granflow scene"


def json_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of scene files.

    Numbers may be plain (SI) or text with a unit. `granflow check` also detects inconsistencies between
    parts, such as a missing pair. The result contains plain Python data only and can be written as JSON.
    """
    return {"$schema": _DIALECT, **_without_notes(_schema_with_notes()), "title": _TITLE}


def _schema_with_notes() -> dict[str, Any]:
    """The schema with the NOTES of its keys."""
    schema = SceneInput.model_json_schema(by_alias=True, schema_generator=_SortedSchema)
    simplified: dict[str, Any] = _simplified(schema)
    return simplified


class _SortedSchema(GenerateJsonSchema):
    """Sorts the schema as pydantic does, but not the keys of examples."""

    def sort(self, value: Any, parent_key: str | None = None) -> Any:
        """The value with sorted keys; `parent_key`: the key that has it."""
        if parent_key == "examples":
            return value
        if isinstance(value, list):
            return [self.sort(each, parent_key) for each in value]
        if not isinstance(value, dict):
            return value
        names = value if parent_key in ("properties", "default") else sorted(value)
        return {name: self.sort(value[name], name) for name in names}


def _without_notes(value: Any) -> Any:
    """A schema without NOTES."""
    if isinstance(value, list):
        return [_without_notes(each) for each in value]
    if not isinstance(value, dict):
        return value
    return {key: _without_notes(each) for key, each in value.items() if key not in NOTES}


def _simplified(value: Any) -> Any:
    """The schema without titles that pydantic derives from names, and without examples in Python.

    Mappings by name accept no other names.
    """
    if isinstance(value, str):
        return value.partition("\n\n>>> ")[0]
    if isinstance(value, list):
        return [_simplified(each) for each in value]
    if not isinstance(value, dict):
        return value
    closed = {"additionalProperties": False} if "patternProperties" in value else {}
    titles = {"title"} if isinstance(value.get("title"), str) else set()
    return {key: _simplified(each) for key, each in value.items() if key not in titles} | closed


def clear_schema() -> None:
    """Clear what was derived from the schema; required after a change of the schema."""
    parts.cache_clear()
    places.cache_clear()


# Parts of the schema and their keys

ROOT = "scene"
"""Name of the part with the keys of the first level."""
REFERENCE = "#/$defs/"
ANY_NAME = "NAME"
"""Placeholder of a name in a key path, such as walls.NAME.radius."""


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
    def default_in_words(self) -> str:
        """What applies without the key, as its description says; empty if the default is a value."""
        return str(self.schema.get(DEFAULT_IN_WORDS, ""))

    @property
    def default(self) -> str:
        """Default as YAML or in words; "required" or "none" without one."""
        if self.is_required:
            return "required"
        value = self.schema.get("default")
        if value is None and self.default_in_words:
            return self.default_in_words
        if isinstance(value, dict) and value:
            return "its defaults"
        return "none" if value in (None, {}, []) else as_yaml(value)


@cache
def parts() -> dict[str, dict[str, Any]]:
    """Schemas of all parts of a scene by name; the first is ROOT."""
    schema = _schema_with_notes()
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
    """Key paths at which each part occurs; paths of nested parts start at the first one of their owner."""
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


def variant(part: str) -> str:
    """Key and value that select a part of a union, such as `shape: cone`; empty for other parts."""
    constants = {
        key: value["const"] for key, value in parts()[part].get("properties", {}).items() if "const" in value
    }
    return next((f"{key}: {value}" for key, value in constants.items()), "")


def first_key(part: str) -> str:
    """First required key of a part, which selects it in a union of parts without a key such as `kind`."""
    schema = parts()[part]
    return next(iter(schema.get("required") or schema["properties"]))


PLAIN_TEXT = re.compile(r"[\w./^+%°-][\w./^+%° -]*")
"""Text that YAML does not require in quotes."""


def as_yaml(value: Any) -> str:
    """A value as YAML on one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(as_yaml(each) for each in value)}]"
    if isinstance(value, dict):
        entries = [f"{key}: {as_yaml(each)}" for key, each in value.items() if each is not None]
        return "{" + ", ".join(entries) + "}"
    if isinstance(value, str) and not PLAIN_TEXT.fullmatch(value):
        return json.dumps(value, ensure_ascii=False)
    return str(value)


# Type, unit and allowed range of a value in words


def dimension_of(schema: dict[str, Any]) -> Dimension | None:
    """Dimension of a number with a unit; None for other schemas and for a number of any dimension."""
    return DIMENSIONS.get(schema.get(DIMENSION, ""))


Link = Callable[[str, str], str]
"""Function of the name of a part and a label that returns the text for the part."""


def plain_label(part: str, label: str) -> str:
    """The key that selects a part, or the label."""
    return variant(part) or label


def type_text(schema: dict[str, Any], link: Link = plain_label) -> str:
    """Types that a key accepts, with unit; never empty.

    `link`: function of the name of a part and a label that returns the text for the part.
    """
    found = list(dict.fromkeys(_types(schema, link)))
    if len(found) > 1 and any("with unit" in each for each in found):
        found = [each for each in found if each != "number"]
    return " or ".join(found)


def _types(schema: dict[str, Any], link: Link) -> Iterator[str]:
    """Types of the alternatives; a number and its text with unit are one type."""
    options = list(alternatives(schema))
    is_union = sum(referenced(each) is not None for each in options) > 1
    dimensions = [each for each in map(dimension_of, options) if each is not None]
    for each in options:
        if part := referenced(each):
            yield link(part, f"mapping with {first_key(part)}" if is_union else "mapping")
        elif "prefixItems" in each:
            yield f"list of {len(each['prefixItems'])}: {type_text(each['prefixItems'][0], link)}"
        elif "items" in each:
            yield f"list of {type_text(each['items'], link)}"
        elif "patternProperties" in each:
            inner = next(iter(each["patternProperties"].values()))
            yield f"names, each with {type_text(inner, link)}"
        elif each.get("type") in ("number", "integer"):
            yield _number(each, dimensions[0].si_unit if dimensions else "")
        elif "enum" in each or "const" in each:
            yield "word"
        elif DIMENSION not in each:
            yield {"string": "text", "boolean": "true or false"}[each["type"]]
        elif not dimensions:
            yield "number or text with unit"


def _number(schema: dict[str, Any], unit: str) -> str:
    """Type of a number with the SI unit."""
    if schema["type"] == "integer":
        return "whole number"
    return f"number [{unit}]" if unit else "number"


def range_text(schema: dict[str, Any]) -> str:
    """Allowed values: bounds, words, lengths of lists, mappings beside them; empty without a limit."""
    found = list(dict.fromkeys(_ranges(schema)))
    if found:
        found += _mappings(schema)
    return "; ".join(found)


def _ranges(schema: dict[str, Any]) -> Iterator[str]:
    for each in alternatives(schema):
        yield from _bounds(each)
        words = each.get("enum", ())
        if "const" in each:
            words = [each["const"]]
        if words:
            yield ", ".join(f"`{word}`" for word in words)
        if "minItems" in each and "prefixItems" not in each:
            yield f"at least {each['minItems']} item"
        inner = list(each.get("prefixItems", ())[:1])
        if "items" in each:
            inner.append(each["items"])
        for item in inner:
            yield from _ranges(item)


def _bounds(schema: dict[str, Any]) -> Iterator[str]:
    """Bounds of a number."""
    words = {"minimum": "at least", "exclusiveMinimum": "above", "maximum": "at most"}
    bounds = [f"{word} {schema[key]:g}" for key, word in words.items() if key in schema]
    text = " and ".join(bounds)
    if text:
        yield text


def _mappings(schema: dict[str, Any]) -> Iterator[str]:
    """Mappings that a key accepts, by the key that selects them: `law`: `linear`, `luding`."""
    selected: dict[str, list[str]] = {}
    for each in alternatives(schema):
        if part := referenced(each):
            key, _, word = (variant(part) or first_key(part)).partition(": ")
            selected.setdefault(key, []).extend([f"`{word}`"] if word else [])
    for key, words in selected.items():
        yield f"mapping with `{key}`" + (f": {', '.join(words)}" if words else "")


# Examples: that of the key, else the most frequent value in the shipped scenes, else one of the type


def example_of(key: Key) -> str:
    """Key and example value as YAML on one line."""
    examples = key.schema.get("examples")
    value = as_yaml(examples[0]) if examples else _from_scenes(key) or _typical(key.schema)
    return f"{key.name}: {value}"


PLAIN_NUMBER = DIMENSIONS["number"].example
"""Example of a number without unit; as the last component of a vector it is replaced by 1."""
NO_SCENES = ("sweeps/", "calibration/")
"""Folders of shipped files that are not scenes."""
LONGEST = 72
"""Characters of the longest example from a scene."""


def _from_scenes(key: Key) -> str:
    """The most frequent value in the shipped scenes, else the shortest; empty if all are long."""
    found = _harvest().get((key.part, key.name), Counter())
    short = [text for text in found if len(text) <= LONGEST]
    return min(short, key=lambda text: (-found[text], len(text), text), default="")


@cache
def _harvest() -> dict[tuple[str, str], Counter[str]]:
    """Values of all keys in the shipped scenes as YAML, by part and key.

    Scenes in subfolders count only for keys that no other scene has.
    """
    found: dict[tuple[str, str], Counter[str]] = {}
    scenes = {name: path for name, path in example_paths().items() if not name.startswith(NO_SCENES)}
    for depth in (0, 1):
        known = set(found)
        for path in [path for name, path in scenes.items() if name.count("/") == depth]:
            for part, name, value in _values(ROOT, YAML(typ="safe").load(path)):
                if (part, name) not in known:
                    found.setdefault((part, name), Counter())[as_yaml(value)] += 1
    return found


def _values(part: str, mapping: dict[str, Any]) -> Iterator[tuple[str, str, Any]]:
    """Part, key and value of every key in a mapping, nested ones included."""
    for name, schema in parts()[part].get("properties", {}).items():
        if name in mapping:
            yield part, name, mapping[name]
            yield from _inside(schema, mapping[name])


def _inside(schema: dict[str, Any], value: Any) -> Iterator[tuple[str, str, Any]]:
    """Values of the parts that a value contains."""
    for each in alternatives(schema):
        part = referenced(each)
        if part and isinstance(value, dict) and _fits(part, value):
            yield from _values(part, value)
            return
        if isinstance(value, dict):
            for inner in each.get("patternProperties", {}).values():
                for item in value.values():
                    yield from _inside(inner, item)
        elif isinstance(value, list) and isinstance(each.get("items"), dict):
            for item in value:
                yield from _inside(each["items"], item)


def _fits(part: str, value: dict[str, Any]) -> bool:
    """Whether a mapping is a value of a part: its keys are known, and a key such as `kind` fits."""
    known = parts()[part].get("properties", {})
    return set(value) <= set(known) and all(
        known[key].get("const", each) == each for key, each in value.items()
    )


def _typical(schema: dict[str, Any]) -> str:
    """The example of a key, else its default, else a value of its type."""
    if examples := schema.get("examples"):
        return as_yaml(examples[0])
    if default := schema.get("default"):
        return as_yaml(default)
    options = list(alternatives(schema))
    first = options[0]
    for each in options:
        if dimension := dimension_of(each):
            return dimension.example
    if part := referenced(first):
        return _mapping(part)
    if "const" in first or "enum" in first:
        return str(first.get("const") or first["enum"][0])
    if "prefixItems" in first:
        last = _typical(first["prefixItems"][-1])
        zeros = ["0"] * (len(first["prefixItems"]) - 1)
        return f"[{', '.join([*zeros, '1' if last == PLAIN_NUMBER else last])}]"
    if "items" in first:
        return f"[{_typical(first['items'])}]"
    if "patternProperties" in first:
        return f"{{first: {_typical(next(iter(first['patternProperties'].values())))}}}"
    return {"boolean": "true", "integer": "100", "number": "0.5", "string": "glass"}[first["type"]]


def _mapping(part: str) -> str:
    """A mapping with the required keys of a part."""
    schema = parts()[part]
    required = [name for name in schema["properties"] if name in schema.get("required", ())]
    return "{" + ", ".join(f"{name}: {_typical(schema['properties'][name])}" for name in required) + "}"


# Keys by path, such as run.time_step


@dataclass(frozen=True)
class Place:
    """A place in a scene: path with NAME and [], the last key of it, and the parts that its value can be."""

    path: str
    key: Key | None
    parts: tuple[str, ...]


def places_of(path: str) -> list[Place]:
    """Places to which a path leads: from the first level, otherwise from all keys with its first name.

    Names of walls and indices of lists are arbitrary and can be omitted; a variant restricts a block:
    walls.rectangle. Empty if there is no such key.
    """
    words = [word for word in path.replace("[]", "").split(".") if word]
    found = list(_walk(Place("", None, (ROOT,)), words))
    if not found and words:
        found = [
            place
            for key in all_keys()
            if key.name == words[0]
            for place in _walk(_at(Place(places()[key.part][0], None, (key.part,)), key), words[1:])
        ]
    return _merged(found)


def suggestion(path: str) -> str:
    """The key nearest to the last word of a path that is not found; empty without one."""
    return nearest(path.rpartition(".")[2], dict.fromkeys(key.name for key in all_keys())) or ""


def _walk(place: Place, words: Sequence[str]) -> Iterator[Place]:
    """Places below `place` that the words lead to."""
    if not words:
        yield place
        return
    first = words[0]
    rest = words[1:]
    steps = [
        _at(replace(place, parts=(part,)), key)
        for part in place.parts
        for key in keys(part)
        if key.name == first
    ]
    chosen = tuple(
        part for part in place.parts if len(place.parts) > 1 and variant(part).partition(": ")[2] == first
    )
    if chosen:
        steps.append(replace(place, key=None, parts=chosen))
    if not steps and place.key is not None and (first.isdigit() or _has_names(place.key.schema)):
        steps.append(replace(place, key=replace(place.key, schema={})))
    for step in _merged(steps):
        yield from _walk(step, rest)


def _at(place: Place, key: Key) -> Place:
    """The place of a key of the first part of `place`."""
    suffix = f".{ANY_NAME}" if _has_names(key.schema) else ""
    inner = tuple(dict.fromkeys(_parts_of(key.schema)))
    return Place(f"{place.path}.{key.name}{suffix}".lstrip("."), key, inner)


def _parts_of(schema: dict[str, Any]) -> Iterator[str]:
    """Parts that a value can be or contain."""
    for each in alternatives(schema):
        if part := referenced(each):
            yield part
        inner = [*each.get("patternProperties", {}).values(), *each.get("prefixItems", ())]
        if isinstance(each.get("items"), dict):
            inner.append(each["items"])
        for item in inner:
            yield from _parts_of(item)


def _has_names(schema: dict[str, Any]) -> bool:
    return any("patternProperties" in each for each in alternatives(schema))


def _merged(found: Sequence[Place]) -> list[Place]:
    """Places without repetitions of a path with the same key and description."""
    merged: dict[tuple[str, str], Place] = {}
    for place in found:
        description = "" if place.key is None else f"{place.key.description} {place.key.default}"
        merged.setdefault((place.path, description), place)
    return list(merged.values())


# Text for a terminal

WIDTH = 100
"""Characters of a line."""
MOST_VARIANTS = 1
"""Number of variants of a block whose keys are listed; more are listed by name only."""


def reference_of(path: str) -> str:
    """Text on the key to which a path leads: meaning, type, unit, range, default, example, and keys below it.

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
        yield ""
        yield f"Add one of these to the path to list its keys, such as {place.path}.{_name(place.parts[0])}:"
        yield from _columns([(_name(part), _first_sentence(part)) for part in place.parts])
    else:
        for part in place.parts:
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
    yield ""
    if description:
        yield from (f"  {line}".rstrip() for line in description.splitlines())
        yield ""
    rows = []
    for key in keys(part):
        if key.default_in_words:
            default = ""
        else:
            default = "; required" if key.is_required else f"; default: {key.default}"
        rows.append((key.name, f"{_plain(type_text(key.schema))}{default}. {key.description}"))
    yield from _columns(rows)


def _name(part: str) -> str:
    """Word that selects a variant of a block: the value of its `kind`, or its first key."""
    return variant(part).partition(": ")[2] or first_key(part)


def _first_sentence(part: str) -> str:
    """The first paragraph of the description of a part, on one line."""
    return " ".join(str(parts()[part].get("description", "")).partition("\n\n")[0].split())


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
