"""Deletion of particles: delete_atoms before the first run, and between runs, where it is a key of a stage.

Which particles a command deletes is a `Deletion`: entries of the key `delete` of a stage. Conditions on the
particles, such as `z+c_r>0.1`, are half spaces.
"""

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from granflow.geometry.close_pairs import near_pairs
from granflow.importing.deck import Deck, Points, Translation, Words
from granflow.importing.groups import chosen_points, group_named
from granflow.importing.insertion import group_name
from granflow.importing.language import Command, DeckError, NotKnown
from granflow.importing.regions import contains, region_of
from granflow.importing.report import Entry
from granflow.importing.scene_text import Draft, number, quantities
from granflow.importing.settings import scene_regions, stage_of_run

NEAREST = (
    "outlets, or a deletion of a region, a group, a fraction or an atom-style variable of x, y, z and the "
    "radius"
)
STYLES = ("group", "region", "overlap", "porosity", "random", "variable")
POINT_ARRAYS = ("id", "type", "radius", "density", "position", "motion", "fill")


class NoCounterpart(Exception):
    """A choice of particles that a stage cannot make; the text says what."""


@dataclass(frozen=True)
class Deletion:
    """Particles that vanish between two runs.

    time:      [s]
    chosen:    entries of the key `delete`, without their groups
    types:     atom types of the particles; empty for all
    inserters: group of the fixes that have inserted the particles; empty for all
    """

    time: float
    entry: Entry
    chosen: tuple[dict[str, Any], ...]
    types: tuple[int, ...] = ()
    inserters: str = ""


def delete_atoms(deck: Deck, command: Command, entry: Entry) -> None:
    """delete_atoms group ID | region ID | overlap CUTOFF G1 G2 | porosity ID FRACTION SEED | variable NAME"""
    words = Words(deck, command, command.words)
    style = words.word("the style")
    if style not in STYLES:
        raise DeckError(command, f"delete_atoms has no style {style}; it has {', '.join(STYLES)}.")
    points: Points | None = deck.family.get("points")
    if deck.time > 0.0:
        _delete_later(deck, command, words, style, entry)
    elif points is None:
        words.skip()
        entry.not_needed("the box has no particles yet")
    else:
        _delete_points(deck, command, words, style, points, entry)
    while words.next in ("compress", "bond", "mol"):  # storage of particles
        words.flag(words.word("a keyword"))


# Before the first run


def _delete_points(
    deck: Deck, command: Command, words: Words, style: str, points: Points, entry: Entry
) -> None:
    """Leave out particles of the tables."""
    if style == "overlap":
        distance = words.number("the distance", "length")
        groups = [words.word("a group") for _ in "12"]
        first, second = (chosen_points(deck, command, points, "group", each) for each in groups)
        chosen = None if first is None or second is None else _too_near(points, distance, first, second)
    elif style in ("region", "group"):
        chosen = chosen_points(deck, command, points, style, words.word(f"the name of a {style}"))
    elif style == "porosity":
        name, share, seed = _porosity(words)
        random = np.random.default_rng(seed).random(len(points.type)) < share
        chosen = random & contains(deck, region_of(deck, command, name), points.position)
        entry.approximated("the random choice of particles differs from that of the code")
    else:
        chosen = None
    if chosen is None:
        entry.impossible(f"delete_atoms {style} before the first run", "a region, or a group of one")
        return
    kept = _stored(chosen)
    for name in POINT_ARRAYS:
        setattr(points, name, getattr(points, name)[kept])
    points.members = {name: None if mask is None else mask[kept] for name, mask in points.members.items()}
    if not words.rest_has("compress", "no"):
        points.id = np.arange(len(kept)) + 1
    entry.translated("particles")


def _stored(deleted: np.ndarray) -> np.ndarray:
    """Indices of the particles that remain, in the order of the code: the last one fills each gap."""
    order = list(range(len(deleted)))
    i = 0
    while i < len(order):
        if deleted[order[i]]:
            order[i] = order[-1]
            order.pop()
        else:
            i += 1
    return np.array(order, int)


def _too_near(points: Points, distance: float, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Mask (n,) of the particles of the first group that are nearer than a distance [m] to one of the second
    which remains."""
    deleted = np.zeros(len(first), bool)
    for i, j in np.transpose(near_pairs(points.position, np.full(len(first), 0.5 * distance), 0.0)):
        if deleted[i] or deleted[j] or np.linalg.norm(points.position[i] - points.position[j]) >= distance:
            continue
        if first[i] and second[j]:
            deleted[i] = True
        elif first[j] and second[i]:
            deleted[j] = True
    return deleted


def _porosity(words: Words) -> tuple[str, float, int]:
    """Region, fraction and seed: porosity [GROUP] REGION FRACTION SEED."""
    name = words.word("the name of a region")
    if words.next in words.deck.regions:
        if name != "all":
            raise DeckError(words.command, f"the group {name} of porosity is not supported; give all.")
        name = words.word("the name of a region")
    share = words.number("the fraction")
    if not 0.0 < share <= 1.0:
        raise DeckError(words.command, f"the fraction is {share:g}; give one up to 1, such as 0.1.")
    return name, share, words.whole("the seed")


# Between runs


def _delete_later(deck: Deck, command: Command, words: Words, style: str, entry: Entry) -> None:
    """Note what a stage deletes."""
    try:
        if style == "region":
            found = Deletion(deck.time, entry, _of_region(deck, command, words.word("the name of a region")))
        elif style == "group":
            found = _of_group(deck, command, words.word("the name of a group"), entry)
        elif style == "porosity":
            name, share, _ = _porosity(words)
            parts = _of_region(deck, command, name)
            if len(parts) > 1:
                raise NoCounterpart("porosity of a union of regions")
            found = Deletion(deck.time, entry, ({**parts[0], "fraction": number(share)},))
            entry.approximated("the random choice of particles differs from that of the code")
        elif style == "variable":
            name = words.word("the name of a variable")
            found = Deletion(deck.time, entry, (condition(deck, command, name.removeprefix("v_")),))
        else:
            raise NoCounterpart(f"delete_atoms {style} between runs")
    except NoCounterpart as error:
        entry.impossible(str(error), NEAREST)
        return
    if found.chosen:
        deck.own("changes", set).add(deck.time)
        deck.own("deletions", list).append(found)


def _of_region(deck: Deck, command: Command, name: str) -> tuple[dict[str, Any], ...]:
    region = region_of(deck, command, name)
    parts = scene_regions(deck, region)
    if parts is None or region.motion is not None:
        raise NoCounterpart(f"deletion of the particles of the region {name}")
    region.entry.translated("stages.NAME.delete.region")
    return tuple({"region": each} for each in parts)


def _of_group(deck: Deck, command: Command, name: str, entry: Entry) -> Deletion:
    """The deletion of a group: of all, of a region or types at this time, of a fix that inserts, dynamic."""
    everything: tuple[dict[str, Any], ...] = ({},)
    if name == "all":
        return Deletion(deck.time, entry, everything)
    group = group_named(deck, command, name)
    if group.rule == "dynamic":
        return _of_dynamic_group(deck, command, name, group.words[1:], group.start, entry)
    if any(fix.group == name and fix.style in INSERTERS for fix in deck.all_fixes):
        return Deletion(deck.time, entry, everything, inserters=name)
    if group.start < deck.time:
        raise NoCounterpart(f"deletion of particles that were in the group {name} at {group.start:g} s")
    if group.rule == "region":
        return Deletion(deck.time, entry, _of_region(deck, command, group.words[0]))
    if group.rule == "type" and all(each.isdigit() for each in group.words):
        return Deletion(deck.time, entry, everything, tuple(map(int, group.words)))
    raise NoCounterpart(f"deletion of the group {name} of the style {group.rule}")


INSERTERS = ("pour", "insert/pack", "insert/stream", "insert/rate/region")
"""Styles of fixes whose particles belong to their group."""


def _of_dynamic_group(
    deck: Deck, command: Command, name: str, words: tuple[str, ...], start: float, entry: Entry
) -> Deletion:
    """The deletion of a dynamic group, whose members are those of its last evaluation.

    The codes evaluate it at the start of each run, and at multiples of `every`.
    """
    options = dict(zip(words[::2], words[1::2], strict=False))
    every = Words(deck, command, (options.pop("every", "1"),)).whole("every")
    last_run = deck.runs[-1]
    evaluated = max(deck.step // max(every, 1) * max(every, 1), last_run.first_step)
    if evaluated < deck.step:
        if evaluated == 0 and deck.family.get("points") is None:
            entry.not_needed(
                f"the group {name} is evaluated every {every} steps, last at the step 0, at which it has no "
                "particles: the code deletes none"
            )
            return Deletion(deck.time, entry, ())
        entry.approximated(
            f"the group {name} has the particles that it had at the step {evaluated}, the scene those at the "
            f"step {deck.step}"
        )
    if list(options) == ["region"]:
        return Deletion(deck.time, entry, _of_region(deck, command, options["region"]))
    if list(options) == ["var"]:
        return Deletion(deck.time, entry, (condition(deck, command, options["var"]),))
    raise NoCounterpart(f"deletion of the dynamic group {name}")


# Conditions on the particles

POSITIONS = np.random.default_rng(1).uniform(-1.0, 1.0, (8, 4))
"""Values of x, y, z and the radius, in sizes of the box, at which a condition is evaluated."""


def condition(deck: Deck, command: Command, name: str) -> dict[str, Any]:
    """The region, and the part of the particles in it, of an atom-style variable such as z+c_r>0.1.

    Raises DeckError for a variable that does not exist, NoCounterpart for one that is no half space.
    """
    variables = deck.interpreter.variables
    if name not in variables:
        known = ", ".join(variables) or "none"
        raise DeckError(command, f"there is no variable {name}. Variables: {known}.")
    text = variables[name].text
    while (inner := re.fullmatch(r"\s*v_(\w+)\s*", text)) and inner[1] in variables:
        text = variables[inner[1]].text
    text = text.strip()
    if text.startswith("(") and text.endswith(")") and text.count("(") == 1:
        text = text[1:-1]
    sides = re.split(r"<=|>=|<|>", text)
    refusal = NoCounterpart(f"the condition {text} on the particles")
    if len(sides) != 2 or any(each in text for each in ("==", "!=", "&&", "||")):
        raise refusal
    sign = 1.0 if ">" in text else -1.0
    scale = max(map(abs, deck.box or (1.0,))) / deck.si(1.0, "length")
    rows = scale * np.vstack([np.zeros(4), np.eye(4), POSITIONS])
    try:
        values = np.array([sign * _difference(deck, sides, row) for row in rows])
    except NotKnown:
        raise refusal from None
    slopes = (values[1:5] - values[0]) / scale
    expected = values[0] + rows @ slopes
    length = np.linalg.norm(slopes[:3])
    part = np.round(slopes[3] / length, 9) if length else np.nan
    if np.abs(expected - values).max() > 1e-9 * np.abs(values).max() or part not in PARTS:
        raise refusal
    normal = slopes[:3] / length
    point = -values[0] / length * normal * deck.si(1.0, "length")
    plane = {"point": quantities((point + 0.0).tolist(), "length"), "normal": (normal + 0.0).tolist()}
    return {"region": {"half_space": plane}, **PARTS[float(part)]}


PARTS: dict[float, dict[str, Any]] = {0.0: {}, 1.0: {"part": "any"}, -1.0: {"part": "all"}}
"""The key `part` by the factor of the radius in a condition."""


def _difference(deck: Deck, sides: list[str], row: np.ndarray) -> float:
    """Left minus right side of a condition for a particle with x, y, z and radius `row`."""
    x, y, z, radius = map(float, row)
    facts = {"x": x, "y": y, "z": z, "radius": radius, "diameter": 2.0 * radius}
    texts = list(sides)
    for name, entry in deck.computes.items():
        kind, *columns = entry.command.words[2:]
        if kind != "property/atom":
            continue
        for index, column in enumerate(columns, 1):
            texts = [each.replace(f"c_{name}[{index}]", f"c_{name}_{index}") for each in texts]
            if column in facts:
                facts[f"c_{name}" if len(columns) == 1 else f"c_{name}_{index}"] = facts[column]
    left, right = (deck.interpreter.evaluate(each, **facts) for each in texts)
    return left - right


# The scene


def build(deck: Deck, draft: Draft) -> None:
    """Add the deletions to the stages of the scene."""
    runs = [run for run in deck.runs if run.steps]
    for each in deck.own("deletions", list):
        run = next((run for run in runs if abs(run.start - each.time) <= run.slack), None)
        if run is None:
            each.entry.not_needed("no run follows")
            continue
        groups = [
            group_name(group)
            for group in deck.particles
            if (not each.types or group.type in each.types)
            and (not each.inserters or group.entries[0].command.words[1] == each.inserters)
        ]
        stage = stage_of_run(deck, draft, deck.runs.index(run))
        is_limited = each.types or each.inserters or each.chosen == ({},)
        names = {"groups": groups} if is_limited else {}
        stage.setdefault("delete", []).extend({**names, **part} for part in each.chosen)
        draft.remark(("stages",), each.entry)
        each.entry.translated(f"stages.{stage['name']}.delete")


COMMANDS: dict[str, Translation] = {
    "delete_atoms": Translation(
        delete_atoms,
        "particles, stages.NAME.delete",
        "region, group, porosity, variable; overlap before the first run",
    ),
}
FIXES: dict[str, Translation] = {}
