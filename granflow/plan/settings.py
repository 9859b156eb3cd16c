"""Optional settings of a scene: their values, and their origin (given in a line, from a preset, or
default).

`granflow explain` lists them, so that no default acts unseen. They are found by a walk through the models
of the scene.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from granflow.load import Scene
from granflow.scene.blocks.contact import LawSettings

KeyPath = tuple[str | int, ...]
"""Keys and list indices from the root of a scene."""
_UNIT = re.compile(r"\[([A-Za-z][A-Za-z0-9/]*)\]")
"""Unit in brackets in a description of the schema."""


@dataclass(frozen=True)
class OptionalSetting:
    """One optional value of the scene: key path with dots, value with its unit, origin (line, preset or
    default)."""

    key: str
    value: str
    origin: str


def settings_of(scene: Scene) -> tuple[OptionalSetting, ...]:
    """All optional settings in the order of the schema, including values of presets.

    Optional parts that are absent (a motion, the radius of a meter) are not listed. Units are those in the
    descriptions of the schema.
    """
    return tuple(_in_model(scene, scene, ()))


def _in_model(scene: Scene, model: BaseModel, path: KeyPath) -> Iterator[OptionalSetting]:
    """Optional settings of one part of the scene and of its parts; `path`: key path of the part."""
    for name, key_field in type(model).model_fields.items():
        key = (*path, key_field.alias or name)
        value = getattr(model, name)
        if not _is_leaf(value):
            yield from _in_value(scene, value, key)
        elif value is not None and (_has_default(key_field) or _is_preset(scene, model, key)):
            unit = _UNIT.search(key_field.description or "")
            text = as_written(value) + (f" {unit.group(1)}" if unit and not isinstance(value, str) else "")
            given = scene.is_given(*key)
            origin = f"given ({scene.where(*key)})" if given else _filled_in(scene, model, key)
            yield OptionalSetting(".".join(map(str, key)), text, origin)


def _in_value(scene: Scene, value: Any, path: KeyPath) -> Iterator[OptionalSetting]:
    """Optional settings in a value: a part, or a mapping or list of parts."""
    if isinstance(value, BaseModel):
        yield from _in_model(scene, value, path)
    elif isinstance(value, dict):
        for key, each in value.items():
            yield from _in_value(scene, each, (*path, key))
    elif isinstance(value, tuple):
        for index, each in enumerate(value):
            yield from _in_value(scene, each, (*path, index))


def _is_leaf(value: Any) -> bool:
    if isinstance(value, tuple):
        return bool(value) and all(_is_leaf(each) for each in value)
    return not isinstance(value, BaseModel | dict)


def _has_default(field: FieldInfo) -> bool:
    return field.default_factory is not None or (not field.is_required() and field.default is not None)


def _is_preset(scene: Scene, model: BaseModel, path: KeyPath) -> bool:
    return getattr(model, "preset", None) is not None and not scene.is_given(*path)


def _filled_in(scene: Scene, model: BaseModel, path: KeyPath) -> str:
    """Origin of a value that the file does not give."""
    if _is_preset(scene, model, path):
        return f"preset {getattr(model, 'preset', '')} ({scene.where(*path[:-1], 'preset')})"
    if (
        isinstance(model, LawSettings)
        and path[:2] == ("contact", "normal")
        and model.fixed_by_numbers().get(str(path[-1])) == getattr(model, str(path[-1]))
    ):
        return "the restitution of every pair is a number, independent of the velocity"
    return _REASONS.get(path[-1], "default")


_REASONS: dict[str | int, str] = {
    "timeseries_interval": "default: output.interval",
    "unloading_angle": "default: bound on sqrt(K/M) dt, where K is the unloading stiffness",
}
"""Origin of default values that are copied from other keys or need an explanation."""
_MANY_ROWS = 3
"""Lists with more entries are shown by their length."""


def as_written(value: Any) -> str:
    """A value in the notation of scenes: true, false, numbers with six digits, lists; long lists as their
    length."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple) and len(value) > _MANY_ROWS:
        return f"{len(value)} rows"
    if isinstance(value, tuple):
        return f"[{', '.join(map(as_written, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)
