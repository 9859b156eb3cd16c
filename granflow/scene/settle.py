"""Settling a scene: what rests on several of its parts, or on files, becomes plain numbers, once after reading.

Counts from masses and from streams that end, what files of particles hold, and equipment of another `size`. A settled
scene settles to itself; it is what a run writes down and goes on with.
"""

from collections.abc import Iterator
from math import pi
from typing import Any, get_args

import numpy as np
from pydantic.fields import FieldInfo

from granflow.errors import SceneError
from granflow.scene.fields import Model
from granflow.scene.filed import rows_of, unclaimed
from granflow.scene.grains import random_for
from granflow.scene.groups import Group
from granflow.scene.nearness import near_pairs
from granflow.scene.numbers import LARGEST_COUNT, Number
from granflow.scene.places import Found, FromFile, Inlet, Rain
from granflow.scene.schema import Scene
from granflow.scene.sizes import count_for_volume
from granflow.scene.table import Table

ALMOST = 1e-9
"""Share of a particle that is taken for rounding where a stream ends."""


def settled(scene: Scene, read: bool = False) -> Scene:
    """The scene with every count, at size 1. Raises SceneError.

    `read`: have files of particles read again of which is said already what they hold, where they are there.
    """
    scene, remarks = _at_size_1(scene)
    groups: dict[str, Group] = {}
    problems: list[str] = []
    for name in scene.particles:
        try:
            groups[name], said = _settled_group(scene, name, read)
            remarks += said
        except SceneError as error:
            problems += error.problems
    problems += [] if problems or not read else unclaimed(scene)
    if problems:
        raise SceneError(problems)
    found = scene.model_copy(update={"particles": groups})
    found._remarks = (*scene.remarks, *remarks)
    return found


def _settled_group(scene: Scene, name: str, read: bool) -> tuple[Group, list[str]]:
    """One group with its count, and what is to be said of it."""
    group, place = scene.particles[name], scene.particles[name].place
    if not isinstance(place, FromFile):
        return _with_count(scene, name), []
    if place.found is not None and not (read and (scene.folder / place.file).exists()):
        return group, []
    return _with_rows(scene, name, place)


def _at_size_1(scene: Scene) -> tuple[Scene, list[str]]:
    """Equipment and amounts as the size says; expectations of size 1 are left out, unless they say otherwise."""
    if scene.size == 1.0:
        return scene, []
    for name, group in scene.particles.items():
        if group.place.kind in ("list", "file"):
            raise SceneError(
                f"{scene.place('size')}: size is {scene.size:g}, but the positions of particles.{name} are given one "
                "by one; leave size out."
            )
    larger = scaled(scene, scene.size)
    kept = tuple(each for each in scene.expect if each.any_size)
    said = f"size {scene.size:g}"
    times = f"{scene.size:g} times those written, numbers and masses of particles {scene.size**3:.4g} times"
    remarks = [f"{said}: lengths of the equipment are {times}; diameters, velocities and times are as written."]
    if len(kept) < len(scene.expect):
        remarks.append(f"{said}: {len(scene.expect) - len(kept)} of expect were made for size 1, and are not judged.")
    return larger.model_copy(update={"size": 1.0, "expect": kept}), remarks


def scaled(part: Any, factor: float) -> Any:
    """A part of a scene whose lengths are `factor` times as large, and whose amounts of particles its cube.

    What grows, and with which power, stands in the types of the schema (Number.scaling).
    """
    changes = {
        name: _scaled_value(getattr(part, name), _power(field), factor)
        for name, field in type(part).model_fields.items()
    }
    return part.model_copy(update=changes)


def _scaled_value(value: Any, power: int, factor: float) -> Any:
    if isinstance(value, Model):
        return scaled(value, factor)
    if isinstance(value, dict):
        return {key: _scaled_value(each, power, factor) for key, each in value.items()}
    if isinstance(value, tuple):
        return tuple(_scaled_value(each, power, factor) for each in value)
    if not power or isinstance(value, bool | str) or value is None:
        return value
    larger = value * factor**power
    return max(round(larger), 1) if isinstance(value, int) else larger


def _power(field: FieldInfo) -> int:
    """The power of the size with which the numbers of a field grow."""

    def powers(annotation: Any) -> Iterator[int]:
        if isinstance(annotation, Number):
            yield annotation.scaling
        for each in get_args(annotation):
            yield from powers(each)

    return max((*powers(field.annotation), *(each for meta in field.metadata for each in powers(meta))), default=0)


def _with_count(scene: Scene, name: str) -> Group:
    """A group that states a count, a mass or an end, with the least of the counts that come of them."""
    group = scene.particles[name]
    counts = {key: count for key, count in _counts(scene, name)}
    key = min(counts, key=lambda key: counts[key])
    if counts[key] > LARGEST_COUNT:
        path = ("particles", name, *key.split("."))
        raise SceneError(
            f"{scene.place(*path)}: {'.'.join(path)} makes {float(counts[key]):.3g} particles, but at most "
            f"{LARGEST_COUNT} can be numbered."
        )
    return group.model_copy(update={"count_asked": counts[key], "mass": None})


def _counts(scene: Scene, name: str) -> Iterator[tuple[str, int]]:
    """How many particles every key asks for that says how many."""
    group, place = scene.particles[name], scene.particles[name].place
    if group.count_asked is not None:
        yield "count", group.count_asked
    if group.mass is not None:
        yield "mass", _count_of_mass(scene, name, group.mass)
    if isinstance(place, Rain | Inlet) and place.end is not None:
        lasts = place.end - place.start
        if place.rate is not None:
            yield "place.end", max(int(np.ceil(min(place.rate * lasts - ALMOST, 1e18))), 1)
        elif place.mass_flow is not None:
            yield "place.end", _count_of_mass(scene, name, place.mass_flow * lasts)


def _count_of_mass(scene: Scene, name: str, mass: float) -> int:
    group = scene.particles[name]
    density = scene.materials[group.material].density
    return count_for_volume(group.sizes, 6.0 / pi * mass / density, lambda: random_for(scene, name))


def _with_rows(scene: Scene, name: str, place: FromFile) -> tuple[Group, list[str]]:
    """A group from a file, with what the file holds."""
    group = scene.particles[name]
    rows = rows_of(scene, name)
    problems = [*_misfits(scene, name, rows)]
    if problems:
        raise SceneError(problems)
    overlap, remarks = _overlap(scene, name, rows)
    speed = 0.0 if rows.velocity is None else float(np.linalg.norm(rows.velocity, axis=1).max())
    diameters = 2.0 * float(rows.radius.min()), 2.0 * float(rows.radius.max())
    found = Found(
        count=len(rows), diameter_min=diameters[0], diameter_max=diameters[1], speed_max=speed, overlap_max=overlap
    )
    there = place.model_copy(update={"found": found})
    return group.model_copy(update={"count_asked": len(rows), "place": there}), remarks


def _misfits(scene: Scene, name: str, rows: Table) -> Iterator[str]:
    """What the scene says of a group and its file does not keep to."""
    group = scene.particles[name]
    if group.count_asked not in (None, len(rows)) and scene.gives("particles", name, "count"):
        place = scene.place("particles", name, "count")
        yield f"{place}: particles.{name}.count is {group.count_asked}, but {rows.path} has {len(rows)} rows for it."
    for key in ("velocity", "spin"):
        if getattr(rows, key) is not None and np.any(getattr(group, key)):
            yield f"{scene.place('particles', name, key)}: particles.{name}.{key} is in {rows.path} too; leave it out."
    low, high = np.array(scene.domain.min), np.array(scene.domain.max)
    outside = ~np.all((rows.position >= low) & (rows.position <= high), axis=1)
    if outside.any():
        first, count = rows.line[outside][0], int(outside.sum())
        others = f" and {count - 1} more lie" if count > 1 else " lies"
        yield f"{rows.path}:{first}: this particle{others} outside the domain."


def _overlap(scene: Scene, name: str, rows: Table) -> tuple[float, list[str]]:
    """Largest overlap over the smaller radius, and a sentence on it; none where overlaps do not matter."""
    if scene.particles[name].fixed:
        return 0.0, []
    first, second = near_pairs(rows.position, rows.radius, 0.0)
    if not len(first):
        return 0.0, []
    apart = np.linalg.norm(rows.position[first] - rows.position[second], axis=1)
    share = (rows.radius[first] + rows.radius[second] - apart) / np.minimum(rows.radius[first], rows.radius[second])
    worst = int(share.argmax())
    kind = "points" if rows.path.suffix.lower() == ".vtu" else "lines"
    lines = f"{kind} {rows.line[first[worst]]} and {rows.line[second[worst]]}"
    pairs = f"{len(first)} pairs overlap" if len(first) > 1 else "one pair overlaps"
    return float(share[worst]), [
        f"particles.{name}: {pairs} in {rows.path}, by up to {share[worst]:.3g} of the smaller radius ({lines})."
    ]
