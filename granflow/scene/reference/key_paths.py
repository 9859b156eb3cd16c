"""Finds keys and parts of a scene by a path such as walls.belt.motion.velocity or run.time_step."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from granflow.scene.reference.schema_keys import (
    ROOT,
    Key,
    all_keys,
    alternatives,
    keys,
    places,
    referenced,
    variant,
)
from granflow.scene.suggest import nearest


@dataclass(frozen=True)
class Place:
    """A place in a scene: path with NAME and [], the key that leads there, and the parts that its value can be."""

    path: str
    key: Key | None
    parts: tuple[str, ...]


def places_of(path: str) -> list[Place]:
    """Places to which a path leads: from the first level, otherwise those of all keys with its name.

    Names of walls and indices of lists are arbitrary and can be omitted; a variant restricts a block: walls.rectangle.
    Empty if there is no such key.
    """
    words = [word for word in path.replace("[]", "").split(".") if word]
    found = list(_walk(Place("", None, (ROOT,)), words))
    if not found and len(words) == 1:
        found = [
            _at(Place(places()[key.part][0], None, (key.part,)), key) for key in all_keys() if key.name == words[0]
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
    first, rest = words[0], words[1:]
    steps = [_at(replace(place, parts=(part,)), key) for part in place.parts for key in keys(part) if key.name == first]
    chosen = tuple(part for part in place.parts if len(place.parts) > 1 and variant(part).partition(": ")[2] == first)
    if chosen:
        steps.append(replace(place, key=None, parts=chosen))
    if not steps and place.key is not None and (first.isdigit() or _has_names(place.key.schema)):
        steps.append(replace(place, key=replace(place.key, schema={})))
    for step in _merged(steps):
        yield from _walk(step, rest)


def _at(place: Place, key: Key) -> Place:
    """The place of a key of the first part of `place`."""
    inner = tuple(dict.fromkeys(part for part in _parts_of(key.schema)))
    return Place(f"{place.path}.{key.name}{_suffix(key.schema)}".lstrip("."), key, inner)


def _parts_of(schema: dict[str, Any]) -> Iterator[str]:
    """Parts that a value can be or contain."""
    for each in alternatives(schema):
        if part := referenced(each):
            yield part
        inner = [*each.get("patternProperties", {}).values(), *each.get("prefixItems", ())]
        inner += [each["items"]] if isinstance(each.get("items"), dict) else []
        for one in inner:
            yield from _parts_of(one)


def _has_names(schema: dict[str, Any]) -> bool:
    return any("patternProperties" in each for each in alternatives(schema))


def _suffix(schema: dict[str, Any]) -> str:
    """What follows the key in a path: .NAME for names; empty otherwise."""
    return ".NAME" if _has_names(schema) else ""


def _merged(found: Sequence[Place]) -> list[Place]:
    """Places without repetitions of a path with the same key and description."""
    merged: dict[tuple[str, str], Place] = {}
    for place in found:
        description = "" if place.key is None else f"{place.key.description} {place.key.default}"
        merged.setdefault((place.path, description), place)
    return list(merged.values())
