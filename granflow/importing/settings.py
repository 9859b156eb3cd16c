"""Commands that change particles: set and velocity.

Before the first run they change the particles that the script has put into the box; the temperature, and heat
sources, at the start of a stage.
"""

from dataclasses import dataclass
from math import inf, pi
from typing import Any

import numpy as np

from granflow.importing.deck import Deck, Fix, Points, Region, Translation, Words
from granflow.importing.groups import chosen_points, group_named, in_range, particle_values
from granflow.importing.heat import HEAT
from granflow.importing.insertion import group_name
from granflow.importing.language import Command, DeckError, NotKnown, shortest
from granflow.importing.regions import lattice_spacing, region_of
from granflow.importing.report import Entry
from granflow.importing.scene_text import Draft, number, quantities, quantity
from granflow.importing.schedule import stage_names
from granflow.schema.messages import suggestion_sentence

CHANGES = "a stage with set (temperatures, sources of heat), or a Python program (simulation.particles)"
PROPERTIES = {"Temp": ("temperature", "number", "K"), "heatSource": ("heat_source", "power", "W")}
"""Key of a setting, dimension and unit of a property of the particles that the script sets."""


@dataclass(frozen=True)
class Setting:
    """A property that particles take at a time of the script.

    time:    [s]
    chosen:  the keys groups or region, one mapping for each part of the region
    types:   atom types of the particles; empty for all
    """

    time: float
    entry: Entry
    key: str
    value: str
    chosen: tuple[dict[str, Any], ...]
    types: tuple[int, ...] = ()


# Commands


def set_(deck: Deck, command: Command, entry: Entry) -> None:
    """set group|type|atom|region WHICH KEYWORD VALUE ..."""
    words = _with_values(deck, command)
    style, which = words.word("the style"), words.word("the name")
    if style == "region":
        region_of(deck, command, which)
    if words.next.startswith("property/"):
        _set_property(deck, words, entry, style, which)
        return
    points: Points | None = deck.family.get("points")
    if points is None and deck.time == 0.0:
        words.skip()
        entry.not_needed("the box has no particles yet, so that it changes none")
        return
    if points is None or deck.time > 0.0:
        entry.impossible("changes of particles during the simulation", CHANGES)
        return
    chosen = chosen_points(deck, command, points, style, which)
    if chosen is None:
        entry.impossible(f"the particles of {style} {which}", "set region, type or atom")
        return
    while words:
        key = words.word("a keyword")
        if key == "type":
            points.type[chosen] = words.type()
        elif key in ("type/fraction", "type/ratio", "type/subset"):
            _set_types(words, points, chosen, entry, key)
        elif key == "diameter":
            _set_diameter(deck, words, points, chosen, entry)
        elif key == "density":
            points.density[chosen] = _positive(words, points, chosen, "the density", "density")
        elif key == "mass":
            mass = _positive(words, points, chosen, "the mass", "mass")
            points.density[chosen] = mass / (4.0 / 3.0 * pi * points.radius[chosen] ** 3)
            deck.own("with_mass", set).update(points.id[chosen].tolist())
        elif key in ("x", "y", "z"):
            column = "xyz".index(key)
            points.position[chosen, column] = _values(words, points, chosen, "the position", "length")
        elif key in ("vx", "vy", "vz"):
            column = "xyz".index(key[1])
            points.motion[chosen, column] = _values(words, points, chosen, "the velocity", "velocity")
        elif key in ("omegax", "omegay", "omegaz"):
            column = 3 + "xyz".index(key[5])
            points.motion[chosen, column] = _values(words, points, chosen, "the rate", "angular_velocity")
        elif key == "omega":
            for column in (3, 4, 5):
                points.motion[chosen, column] = _values(words, points, chosen, "the rate", "angular_velocity")
        else:
            entry.impossible(f"the keyword {key} of set", "type, diameter, density, mass, x, vx, omegax")
            words.skip()
    entry.translated("particles")


def _set_types(words: Words, points: Points, chosen: np.ndarray, entry: Entry, key: str) -> None:
    """type/fraction and type/ratio TYPE SHARE SEED, type/subset TYPE COUNT SEED: random particles."""
    type = words.type()
    numbers = np.arange(len(points.type))[chosen]
    if key == "type/subset":
        count = words.whole_between("the number of particles", 0, len(numbers))
        share = 0.0
    else:
        share = words.number("the share")
        if not 0.0 <= share <= 1.0:
            raise DeckError(words.command, f"the share is {share:g}; give one from 0 to 1, such as 0.5.")
        count = round(share * len(numbers))
    random = np.random.default_rng(words.whole_between("the seed"))
    if key == "type/fraction":
        taken = numbers[random.random(len(numbers)) < share]
    else:
        taken = random.choice(numbers, count, replace=False)
    points.type[taken] = type
    entry.approximated("the particles of the type are other random ones than those of the code")


def _set_diameter(deck: Deck, words: Words, points: Points, chosen: np.ndarray, entry: Entry) -> None:
    """diameter D: LAMMPS keeps the mass, LIGGGHTS the density (measured with 22 Jul 2025 and 3.8.0)."""
    radius = 0.5 * _positive(words, points, chosen, "the diameter", "length")
    if deck.code == "lammps":
        points.density[chosen] *= (points.radius[chosen] / radius) ** 3
    elif deck.own("with_mass", set) & set(points.id[chosen].tolist()):
        entry.impossible("a diameter after the mass, which the code forgets then", "the diameter first")
    points.radius[chosen] = radius


def _with_values(deck: Deck, command: Command) -> Words:
    """The words of a command with the values of v_NAME; those of atom-style variables remain names."""
    variables = deck.interpreter.variables
    kept = (f"v_{name}" for name, each in variables.items() if each.style == "atom")
    names = {*kept}
    return Words(
        deck,
        command,
        tuple(word if word in names else _value_of(deck, command, word) for word in command.words),
    )


def _values(words: Words, points: Points, chosen: np.ndarray, what: str, dimension: str) -> np.ndarray:
    """The next number in SI units, for each of the chosen particles; of an atom-style variable, too."""
    deck = words.deck
    if words.next.startswith("v_"):
        name = words.word(what).removeprefix("v_")
        values = particle_values(deck, words.command, points, name)[chosen]
        return np.asarray(deck.si(1.0, dimension) * values)
    return np.full(int(chosen.sum()), words.number(what, dimension))


def _positive(words: Words, points: Points, chosen: np.ndarray, what: str, dimension: str) -> np.ndarray:
    """As `_values`, for numbers above 0. Raises DeckError."""
    found = _values(words, points, chosen, what, dimension)
    if len(found) and found.min() <= 0.0:
        raise DeckError(words.command, f"{what} is {words.words[words.at - 1]}; give a number above 0.")
    return found


def _value_of(deck: Deck, command: Command, word: str) -> str:
    """The value of v_NAME; other words as they are. Raises DeckError."""
    if not word.startswith("v_"):
        return word
    try:
        return shortest(deck.interpreter.value_at(word[2:]))
    except NotKnown as error:
        raise DeckError(command, f"{word} has no number: {error}; give one, such as 0.5.") from None


BOLTZMANN = {"si": 1.380649e-23, "cgs": 1.380649e-16, "micro": 1.380649e-8, "nano": 0.01380649, "lj": 1.0}
"""Boltzmann's constant in the units of the script."""


def velocity(deck: Deck, command: Command, entry: Entry) -> None:
    """velocity GROUP set VX VY VZ | create T SEED | scale T | ramp VX LO HI X LO HI | zero linear"""
    words = _with_values(deck, command)
    group = words.word("a group")
    style = words.word("the style")
    points: Points | None = deck.family.get("points")
    if deck.time > 0.0:
        entry.impossible("changes of particles during the simulation", CHANGES)
        return
    if points is None:
        words.skip()
        entry.not_needed("the box has no particles yet, so that it changes none")
        return
    chosen = chosen_points(deck, command, points, "group", group)
    if chosen is None:
        entry.impossible(f"the velocities of the group {group}", "a group of a region, type or id")
        return
    if style not in VELOCITIES:
        entry.impossible(f"velocity {style}", "velocity or thermal of the group")
        return
    VELOCITIES[style](deck, words, points, chosen, entry)
    entry.translated("particles")


def _spacing(deck: Deck, words: Words) -> float:
    """Factor of the velocities of a command: the spacing of the lattice unless `units box` follows."""
    return 1.0 if words.rest_has("units", "box") else lattice_spacing(deck, words.command)


def _set_velocity(deck: Deck, words: Words, points: Points, chosen: np.ndarray, entry: Entry) -> None:
    spacing = _spacing(deck, words)
    given: list[np.ndarray | None] = []
    for _ in range(3):
        if words.next == "NULL":
            words.word("a velocity")
            given.append(None)
        else:
            given.append(spacing * _values(words, points, chosen, "a velocity", "velocity"))
    is_added = _options(words, {"sum": "no", "units": "box"})["sum"] == "yes"
    for k, value in enumerate(given):
        if value is not None:
            points.motion[chosen, k] = value + (points.motion[chosen, k] if is_added else 0.0)


def _options(words: Words, defaults: dict[str, str]) -> dict[str, str]:
    """The keywords at the end of a command with their values. Raises DeckError for another keyword."""
    found = dict(defaults)
    while words:
        key = words.word("a keyword")
        if key not in found:
            remedy = suggestion_sentence(key, list(found), "keywords")
            raise DeckError(words.command, f"velocity {words.words[1]} has no keyword {key}. {remedy}")
        found[key] = words.word(f"a value of {key}")
    return found


def _energy_of(deck: Deck, temperature: float, count: int) -> float:
    """Twice the kinetic energy [J] of particles at a temperature of the script: (3 n - 3) k T."""
    return max(3 * count - 3, 0) * deck.si(BOLTZMANN[deck.units] * temperature, "energy")


def _create_velocity(deck: Deck, words: Words, points: Points, chosen: np.ndarray, entry: Entry) -> None:
    """Random velocities with a temperature and without momentum.

    As LAMMPS: components from a uniform distribution (dist gaussian: normal) over the root of the mass,
    without the velocity of the center of mass (mom yes), scaled to the temperature; sum yes adds them.
    """
    temperature = words.number("the temperature")
    random = np.random.default_rng(words.whole("the seed"))
    defaults = {"dist": "uniform", "mom": "yes", "rot": "no", "sum": "no"}
    unused = {"loop": "all", "units": "box", "rigid": "no", "bias": "no", "temp": ""}
    options = _options(words, {**defaults, **unused})
    mass = points.density[chosen] * points.radius[chosen] ** 3 * 4.0 / 3.0 * pi
    shape = (len(mass), 3)
    is_normal = options["dist"] == "gaussian"
    drawn = random.standard_normal(shape) if is_normal else random.uniform(-0.5, 0.5, shape)
    drawn /= np.sqrt(mass)[:, None]
    if options["mom"] == "yes":
        drawn -= mass @ drawn / mass.sum()
    energy = float((mass[:, None] * drawn**2).sum())
    wanted = _energy_of(deck, temperature, len(mass))
    drawn *= np.sqrt(wanted / energy) if energy > 0.0 else 0.0
    points.motion[chosen, :3] = drawn + (points.motion[chosen, :3] if options["sum"] == "yes" else 0.0)
    entry.approximated(
        "the random velocities differ from those of the code; their energy and momentum are equal"
    )
    if options["rot"] == "yes":
        entry.approximated("their angular momentum is not removed")


def _scale_velocity(deck: Deck, words: Words, points: Points, chosen: np.ndarray, entry: Entry) -> None:
    mass = points.density[chosen] * points.radius[chosen] ** 3 * 4.0 / 3.0 * pi
    wanted = _energy_of(deck, words.number("the temperature"), len(mass))
    energy = float((mass[:, None] * points.motion[chosen, :3] ** 2).sum())
    if energy > 0.0:
        points.motion[chosen, :3] *= np.sqrt(wanted / energy)


def _ramp_velocity(deck: Deck, words: Words, points: Points, chosen: np.ndarray, entry: Entry) -> None:
    """ramp VX LO HI X LO HI: a velocity that is linear between two places."""
    spacing = _spacing(deck, words)
    component = words.word("vx, vy or vz")
    low, high = (spacing * words.number("a velocity", "velocity") for _ in "12")
    axis = words.word("x, y or z")
    start, end = (spacing * words.number("a place", "length") for _ in "12")
    if component not in ("vx", "vy", "vz") or axis not in ("x", "y", "z") or start == end:
        raise DeckError(words.command, "a ramp is vx LO HI y LO HI with two different places.")
    is_added = _options(words, {"sum": "no", "units": "box"})["sum"] == "yes"
    share = np.clip((points.position[chosen, "xyz".index(axis)] - start) / (end - start), 0.0, 1.0)
    column = "xyz".index(component[1])
    before = points.motion[chosen, column] if is_added else 0.0
    points.motion[chosen, column] = before + low + share * (high - low)


def _zero_velocity(deck: Deck, words: Words, points: Points, chosen: np.ndarray, entry: Entry) -> None:
    if words.word("linear or angular") != "linear":
        entry.approximated("the angular momentum is not removed")
        return
    mass = points.density[chosen] * points.radius[chosen] ** 3
    points.motion[chosen, :3] -= mass @ points.motion[chosen, :3] / mass.sum()


VELOCITIES = {
    "set": _set_velocity,
    "create": _create_velocity,
    "scale": _scale_velocity,
    "ramp": _ramp_velocity,
    "zero": _zero_velocity,
}
"""Styles of the command velocity."""


def _set_property(deck: Deck, words: Words, entry: Entry, style: str, which: str) -> None:
    """property/atom NAME VALUE: a temperature or a source of heat, from the next stage on."""
    words.word("property/atom")
    name = words.word("the name of the property")
    if name not in PROPERTIES:
        entry.impossible(f"the property {name}", f"one of {', '.join(PROPERTIES)}")
        return
    key, dimension, unit = PROPERTIES[name]
    value = f"{number(words.number('the value', dimension))} {unit}"
    if words:
        raise DeckError(words.command, f"{words.next} follows the value; write one command for each value.")
    add_setting(deck, words.command, entry, style, which, key, value)


def add_setting(
    deck: Deck, command: Command, entry: Entry, style: str, which: str, key: str, value: str
) -> None:
    """Let particles take a value at the present time; a new stage begins then."""
    if deck.time == 0.0 and deck.family.get("points") is None:
        entry.not_needed("the box has no particles yet, so that it changes none")
        return
    chosen = _chosen_later(deck, command, style, which)
    if chosen is None:
        entry.impossible(
            f"values for {style} {which}", "set region with a block, cylinder, sphere or plane; or set type"
        )
        return
    deck.own("changes", set).add(deck.time)
    deck.own("settings", list).append(Setting(deck.time, entry, key, value, *chosen))


def property_atom(deck: Deck, fix: Fix) -> None:
    """fix ID group property/atom NAME STYLE RESTART COMM REVERSE DEFAULT: a source of heat, or own data."""
    words = Words(deck, fix.entry.command, fix.words)
    name = words.word("the name of the property")
    if len(words.rest) < 5 or name not in PROPERTIES:
        fix.entry.not_needed("properties of the particle files are fixed")
        return
    words = Words(deck, fix.entry.command, fix.words[5:])
    if words.next in ("none", "NULL"):
        words.skip()
        fix.entry.not_needed("it has no value")
        return
    key, dimension, unit = PROPERTIES[name]
    deck.own("property_defaults", dict)[key] = (
        f"{number(words.number('the value', dimension))} {unit}",
        fix.entry,
    )


# Which particles, after the first run


def _chosen_later(
    deck: Deck, command: Command, style: str, which: str
) -> tuple[tuple[dict[str, Any], ...], tuple[int, ...]] | None:
    """Regions and atom types of a setting; None if it has none of both."""
    everywhere: tuple[dict[str, Any], ...] = ({},)
    if style == "group" and which != "all":
        group = group_named(deck, command, which)
        if group.start == deck.time and group.rule in ("region", "type"):
            return _chosen_later(deck, command, group.rule, " ".join(group.words))
        return None  # particles that came into the box after the group was made are not its members
    if style == "group":
        return everywhere, ()
    if style == "type":
        types = np.arange(1, deck.types + 1)
        chosen = [n for word in which.split() for n in types[in_range(command, types, word)].tolist()]
        return everywhere, tuple(dict.fromkeys(chosen))
    if style == "region":
        regions = scene_regions(deck, region_of(deck, command, which))
        return None if regions is None else (tuple({"region": each} for each in regions), ())
    return None


FAR = 10.0
"""Where an infinite region ends in a scene, in sizes of the box beyond it."""


def scene_regions(deck: Deck, region: Region) -> list[dict[str, Any]] | None:
    """The region as regions of settings, of which it is the union; None if there are none."""
    if region.kind == "union" and region.inside:
        parts = [scene_regions(deck, deck.regions[name]) for name in region.parts]
        return None if None in parts else [each for part in parts for each in part or ()]
    n = region.numbers
    if region.kind == "block":
        faces = [k for k, each in enumerate(n) if each == each and abs(each) < inf]
        if len(faces) == 1:
            axis, side = divmod(faces[0], 2)
            inward = 1.0 - 2.0 * side
            point, normal = [0.0] * 3, [0.0] * 3
            point[axis], normal[axis] = n[faces[0]], inward if region.inside else -inward
            return [{"half_space": {"point": quantities(point, "length"), "normal": normal}}]
    if region.kind == "plane":
        sign = 1.0 if region.inside else -1.0
        normal = [sign * each + 0.0 for each in n[3:]]
        return [{"half_space": {"point": quantities(n[:3], "length"), "normal": normal}}]
    if not region.inside:
        return None
    if region.kind == "block":
        corners = [_end(deck, k, each) for k, each in enumerate(n)]
        box = {"min": quantities(corners[::2], "length"), "max": quantities(corners[1::2], "length")}
        return [{"box": box}]
    if region.kind == "sphere":
        return [{"sphere": {"center": quantities(n[:3], "length"), "radius": quantity(n[3], "length")}}]
    if region.kind == "cylinder":
        axis = "xyz".index(region.axis)
        ends = []
        for side in (0, 1):
            end = [*n[:2]]
            end.insert(axis, _end(deck, 2 * axis + side, n[3 + side]))
            ends.append(quantities(end, "length"))
        return [{"cylinder": {"from": ends[0], "to": ends[1], "radius": quantity(n[2], "length")}}]
    return None


def _end(deck: Deck, k: int, given: float) -> float:
    """Low or high number k of x, y and z; that of the box for EDGE, far outside of it for INF."""
    box = deck.box or (-1.0, 1.0) * 3
    size = box[k - k % 2 + 1] - box[k - k % 2]
    if given != given:
        return box[k]
    return box[k] + (2 * (k % 2) - 1) * FAR * size if abs(given) == inf else given


# The scene


def build(deck: Deck, draft: Draft) -> None:
    """Add the settings to the stages of the scene."""
    settings: list[Setting] = [*_of_heat(deck), *deck.own("settings", list)]
    defaults: dict[str, tuple[str, Entry]] = deck.own("property_defaults", dict)
    for key, (value, entry) in defaults.items():
        for group in draft.blocks.get("particles", {}).values():
            group[key] = value
        entry.translated(f"particles.NAME.{key}")
    runs = [run for run in deck.runs if run.steps]
    for each in settings:
        time = each.time
        run = next((run for run in runs if abs(run.start - time) <= run.slack), None)
        if run is None:
            if not any(run.end > time for run in runs):
                each.entry.not_needed("no run follows")
            continue
        if "heat" not in draft.blocks["contact"]:
            each.entry.not_needed("no fix heat/gran conducts heat")
            continue
        stage = stage_of_run(deck, draft, deck.runs.index(run))
        groups = [group_name(group) for group in deck.particles if group.type in each.types]
        names = {"groups": groups} if each.types else {}
        stage.setdefault("set", []).extend({each.key: each.value, **names, **part} for part in each.chosen)
        draft.remark(("stages",), each.entry)
        each.entry.translated(f"stages.{stage['name']}.set")


def _of_heat(deck: Deck) -> list[Setting]:
    """The temperature that particles take when a fix heat/gran begins after the first run."""
    fixes = [each for each in deck.fixes_of(*HEAT) if isinstance(each.data, float) and deck.acting(each)]
    return [
        Setting(fix.start, fix.entry, "temperature", f"{number(fix.data)} K", ({},))
        for fix in fixes[:1]
        if fix.start > 0.0
    ]


def stage_of_run(deck: Deck, draft: Draft, run: int) -> dict[str, Any]:
    """The stage of the scene that begins with a run; a scene with one duration gets a stage."""
    stages: list[dict[str, Any]] | None = draft.get("stages")
    if stages is None:
        stages = [{"name": "run", "duration": draft.get("run", "duration")}]
        draft.remove("run", "duration")
        draft.put(("stages",), stages)
    name = stage_names(deck).get(run, "run")
    return next(each for each in stages if each["name"] == name)


# Tables

COMMANDS: dict[str, Translation] = {
    "set": Translation(
        set_, "particles, stages.NAME.set", "before the first run; property/atom Temp, heatSource at any time"
    ),
    "velocity": Translation(
        velocity, "particles", "set, create, scale, ramp, zero; particles that exist at the start"
    ),
}
FIXES: dict[str, Translation] = {
    "property/atom": Translation(
        property_atom, "particles.NAME.heat_source", "heatSource and Temp; others are not needed"
    ),
}
