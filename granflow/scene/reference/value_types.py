"""Type, unit and allowed range of the value of a key in words, from its JSON Schema."""

from collections.abc import Callable, Iterator
from typing import Any

from granflow.scene.reference.schema_keys import alternatives, dimension_of, parts, referenced, si_unit, variant

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
    if len(found) > 1:
        found = [each for each in found if each != "number"] if any("with unit" in each for each in found) else found
    return " or ".join(found)


def range_text(schema: dict[str, Any]) -> str:
    """Allowed values: bounds of numbers, words, lengths of lists, mappings beside them; empty if there is no limit."""
    found = list(dict.fromkeys(_ranges(schema)))
    return "; ".join([*found, *_mappings(schema)] if found else found)


def first_key(part: str) -> str:
    """First required key of a part, which selects it in a union of parts without a key such as `kind`."""
    schema = parts()[part]
    return next(iter(schema.get("required") or schema["properties"]))


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
            yield _number(each, si_unit(dimensions[0]) if dimensions else "")
        elif "enum" in each or "const" in each:
            yield "word"
        elif "pattern" not in each or each["pattern"].startswith("^["):
            yield {"string": "text", "boolean": "true or false"}[each["type"]]
        elif not dimensions:
            yield "number or text with unit"


def _number(schema: dict[str, Any], unit: str) -> str:
    """Type of a number with the SI unit."""
    if schema["type"] == "integer":
        return "whole number"
    return f"number [{unit}]" if unit else "number"


def _ranges(schema: dict[str, Any]) -> Iterator[str]:
    for each in alternatives(schema):
        yield from _bounds(each)
        if words := each.get("enum") or ([each["const"]] if "const" in each else []):
            yield ", ".join(f"`{word}`" for word in words)
        if "minItems" in each and "prefixItems" not in each:
            yield f"at least {each['minItems']} item"
        for inner in [*each.get("prefixItems", ())[:1], *([each["items"]] if "items" in each else [])]:
            yield from _ranges(inner)


def _mappings(schema: dict[str, Any]) -> Iterator[str]:
    """Mappings that a key accepts, by the key that selects them: `law`: `linear`, `luding`."""
    selected: dict[str, list[str]] = {}
    for each in alternatives(schema):
        if part := referenced(each):
            key, _, word = (variant(part) or first_key(part)).partition(": ")
            selected.setdefault(key, []).extend([f"`{word}`"] if word else [])
    for key, words in selected.items():
        yield f"mapping with `{key}`" + (f": {', '.join(words)}" if words else "")


def _bounds(schema: dict[str, Any]) -> Iterator[str]:
    """Bounds of a number."""
    low, above, high = (schema.get(key) for key in ("minimum", "exclusiveMinimum", "maximum"))
    words = [("at least", low), ("above", above), ("at most", high)]
    text = " and ".join(f"{word} {bound:g}" for word, bound in words if bound is not None)
    if text:
        yield text
