"""Groups of particles of a script: which particles a name means, and which of them the script does not move.

The scene has forces and walls for all particles. Particles that no fix integrates, or that a fix freeze
holds, are fixed; another fix on a part of the moving particles has no counterpart.
"""

from collections.abc import Callable
from math import pi
from typing import Any

import numpy as np

from granflow.importing.deck import Deck, Fix, Group, Points, Translation, Words
from granflow.importing.language import Command, DeckError, NotKnown
from granflow.importing.regions import contains, region_of
from granflow.importing.report import Entry
from granflow.importing.scene_text import plain_name
from granflow.io.tables import is_number

INTEGRATORS = (
    "nve",
    "nve/sphere",
    "nve/limit",
    "rigid",
    "rigid/small",
    "rigid/nve",
    "rigid/nve/small",
    "multisphere",
)
"""Styles of fixes that move particles."""
MOVERS = ("nve", "nvt", "npt", "nph", "rigid", "multisphere")
"""First parts of the styles of all fixes of the codes that move particles, also of those without a
counterpart."""
FORCES = ("gravity", "addforce", "viscous", "damping/cundall", "wall/gran", "wall/gran/region")
"""Styles of fixes that act on all moving particles of a scene."""
BODIES = ("rigid", "rigid/small", "rigid/nve", "rigid/nve/small")
"""Styles of fixes that join particles to rigid bodies."""

# The command

GROUP_STYLES = (
    *("region", "type", "id", "molecule", "variable", "include", "subtract", "union", "intersect"),
    *("dynamic", "static", "clear", "empty", "delete"),
)
"""Styles of groups of both codes."""


def group(deck: Deck, command: Command, entry: Entry) -> None:
    """group ID STYLE ...: its particles become members, in addition to those of an earlier command."""
    words = Words(deck, command, command.words)
    name = words.word("the name of the group")
    style = words.word("the style of the group")
    if style not in GROUP_STYLES:
        raise DeckError(command, f"groups have no style {style}; they have {', '.join(GROUP_STYLES)}.")
    entry.not_needed("forces, walls and output of the scene apply to all particles")
    points: Points | None = deck.family.get("points")
    masks = {} if points is None else points.members
    if style == "delete":
        deck.groups.pop(name, None)
        masks.pop(name, None)
        return
    if style == "static":
        words.skip()
        return
    before = deck.groups.get(name)
    is_alone = before is None or style in ("clear", "empty", "dynamic")
    rule = style if is_alone else SEVERAL
    deck.groups[name] = Group(name, rule, words.rest, entry, deck.time)
    if points is not None:
        mask = _mask_of(deck, command, points, style, deck.groups[name].words)
        earlier = None if is_alone else masks.get(name)
        masks[name] = mask if is_alone else None if mask is None or earlier is None else mask | earlier


SEVERAL = "several"
"""Rule of a group to which several commands add particles."""


def _mask_of(
    deck: Deck, command: Command, points: Points, style: str, words: tuple[str, ...]
) -> np.ndarray | None:
    """Mask (n,) of the particles that a rule chooses now; None for a rule that is not known."""
    none = np.zeros(len(points.type), bool)
    if style in ("clear", "empty"):
        return none
    if style == "region" and words and deck.time == 0.0:
        return contains(deck, region_of(deck, command, words[0]), points.position)
    if style in ("type", "id"):
        return _compared(points.type if style == "type" else points.id, words)
    if style == "variable" and words and deck.time == 0.0:
        return particle_values(deck, command, points, words[0]) != 0.0
    if style in ("union", "subtract", "intersect"):
        masks = [chosen_points(deck, command, points, "group", each) for each in words]
        if any(each is None for each in masks):
            return None
        if style == "subtract":
            return np.asarray(masks[0] & ~np.any(masks[1:], axis=0))
        return np.asarray((np.any if style == "union" else np.all)(masks, axis=0))
    return None


COMPARISONS: dict[str, Callable[..., np.ndarray]] = {
    "<": np.less,
    ">": np.greater,
    "<=": np.less_equal,
    ">=": np.greater_equal,
    "==": np.equal,
    "!=": np.not_equal,
    "<>": lambda numbers, low, high: (numbers >= low) & (numbers <= high),
}
"""Comparisons of groups by type or id; <> has both ends."""


def _compared(numbers: np.ndarray, words: tuple[str, ...]) -> np.ndarray | None:
    """Which numbers (n,) are chosen by a comparison, or by ranges N, LOW:HIGH and LOW:HIGH:STEP."""
    if words and words[0] in COMPARISONS:
        given = words[1:]
        if len(given) == (2 if words[0] == "<>" else 1) and all(each.isdigit() for each in given):
            return np.asarray(COMPARISONS[words[0]](numbers, *map(int, given)))
        return None
    chosen = np.zeros(len(numbers), bool)
    for word in words:
        parts = word.split(":")
        if len(parts) > 3 or not all(each.isdigit() for each in parts):
            return None
        low, high, step = ([int(each) for each in parts] + [int(parts[0]), 1][len(parts) - 1 :])[:3]
        chosen |= (numbers >= low) & (numbers <= high) & ((numbers - low) % max(step, 1) == 0)
    return chosen


# Which particles a name means


def chosen_points(deck: Deck, command: Command, points: Points, style: str, which: str) -> Any:
    """Mask (n,) of the particles that a style and a name choose; None if it is not known."""
    if style == "group" and which != "all":
        group_named(deck, command, which)
        return points.members.get(which)
    if style == "group":
        return np.ones(len(points.type), bool)
    if style in ("type", "atom"):
        return in_range(command, points.type if style == "type" else points.id, which)
    if style == "region":
        return contains(deck, region_of(deck, command, which), points.position)
    raise DeckError(command, f"set has no style {style}; it has group, type, atom and region.")


def particle_values(deck: Deck, command: Command, points: Points, name: str) -> np.ndarray:
    """The values (n,) of a variable in the units of the script, one for each particle. Raises DeckError."""
    length, velocity = deck.si(1.0, "length"), deck.si(1.0, "velocity")
    mass = points.density * points.radius**3 * 4.0 / 3.0 * pi / deck.si(1.0, "mass")
    columns = {
        **{"id": points.id, "type": points.type, "mass": mass, "radius": points.radius / length},
        **{axis: points.position[:, k] / length for k, axis in enumerate("xyz")},
        **{f"v{axis}": points.motion[:, k] / velocity for k, axis in enumerate("xyz")},
        **{f"omega{axis}": points.motion[:, 3 + k] * deck.si(1.0, "time") for k, axis in enumerate("xyz")},
    }
    rows = np.stack([np.asarray(each, float) for each in columns.values()], axis=1).tolist()
    try:
        found = [deck.interpreter.value_at(name, **dict(zip(columns, row, strict=True))) for row in rows]
    except NotKnown as error:
        raise DeckError(
            command,
            f"v_{name} has no number for each particle: {error}; give a formula of x, y, z, id or type.",
        ) from None
    return np.array(found)


def in_range(command: Command, numbers: np.ndarray, which: str) -> np.ndarray:
    """Whether numbers (n,) are in a range such as 3, 2*4, *4 or 2*. Raises DeckError."""
    low, star, high = which.partition("*")
    if not all(each.isdigit() or (star and not each) for each in (low, high if star else low)):
        raise DeckError(command, f"{which} is neither a number nor a range, such as 2*4.")
    first = int(low) if low else 1
    last = (int(high) if high else 10**12) if star else first
    return np.asarray((numbers >= first) & (numbers <= last))


def group_named(deck: Deck, command: Command, name: str) -> Group:
    """A group by its name. Raises DeckError."""
    if name not in deck.groups:
        raise DeckError(command, f"there is no group {name}. Groups: {', '.join(['all', *deck.groups])}.")
    return deck.groups[name]


# What fixes leave out


def exclude(deck: Deck, command: Command, entry: Entry) -> None:
    """neigh_modify KEYWORDS: settings of neighbor lists, and with exclude, contacts that are left out."""
    words = list(command.words)
    entry.not_needed("granflow chooses the neighbor list")
    while "exclude" in words:
        del words[: words.index("exclude") + 1]
        style, first, second = [*words, "", "", ""][:3]
        if style == "none":
            continue
        deck.own("excluded", list).append((entry, style, first, second))


def tell_excluded(deck: Deck) -> None:
    """Refuse contacts that a script leaves out, except those between particles that do not move."""
    frozen = {fix.group for fix in deck.fixes_of("freeze")}
    moved = {fix.group for fix in deck.fixes_of(*INTEGRATORS)}
    for entry, style, first, second in deck.own("excluded", list):
        at_rest = style == "group" and first == second and (first in frozen or not {first, "all"} & moved)
        in_bodies = style.startswith("molecule") and deck.fixes_of(*BODIES)
        if not at_rest and not in_bodies:
            entry.impossible(
                f"contacts that are left out (exclude {style} {first} {second})",
                "fixed: true for particles that have no contacts with each other",
            )


def tell_inserted(deck: Deck) -> None:
    """Tell which fixes do not act on inserted particles: these are members of all, and of the groups of their
    insertion, distribution and template, only."""
    inserting = {
        entry.command.words[1]
        for group in deck.particles
        for entry in group.entries[:1]
        if entry.command.name == "fix"
    }
    if not inserting:
        return
    templates = [fix.group for fix in deck.all_fixes if fix.style.startswith("particle")]
    members = {"all", *inserting, *templates}
    for fix in deck.fixes_of("setforce"):
        if fix.data in members:
            fix.entry.impossible("inserted particles whose force is set", HELD)
        elif fix.data is not None and not deck.family.get("points"):
            fix.entry.not_needed("the group has no particles")
    for fix in deck.fixes_of("move"):
        if fix.group in members or not deck.family.get("points"):
            fix.entry.impossible("inserted particles that are moved", MOVED)
    integrators = [fix for fix in deck.fixes_of(*INTEGRATORS) if fix.group in members and deck.acting(fix)]
    runs = [run for run in deck.runs if run.steps]
    if integrators and not all(any(fix.acts_in(run) for fix in integrators) for run in runs):
        integrators[-1].entry.approximated(
            "particles that are integrated in some runs only move in all of them"
        )
    acting = [fix for fix in deck.fixes_of(*FORCES, *INTEGRATORS) if deck.acting(fix) and fix.start == 0.0]
    for fix in acting:
        group = deck.groups.get(fix.group)
        if fix.group in members or group is None or group.rule in ("dynamic", "union", "subtract"):
            continue
        if fix.style in FORCES:
            fix.entry.impossible(
                f"{fix.style} on the group {fix.group} only: inserted particles are members of "
                f"{' and '.join(sorted(members))}",
                "the group all",
            )
        elif not any(each.group in members for each in acting if each.style in INTEGRATORS):
            fix.entry.approximated(
                f"the code does not move the inserted particles, which are no members of {fix.group}; the "
                "scene does"
            )


def tell_bodies(deck: Deck, has_points: bool) -> None:
    """Refuse rigid bodies of particles at given positions, and what holds bodies."""
    for fix in deck.fixes_of(*BODIES):
        if has_points:
            fix.entry.impossible(
                "rigid bodies of particles at given positions, which are single spheres in the scene",
                "clumps: particles.NAME.clump with insert: {kind: file}",
            )
        held = [each for each in ("force", "torque", "langevin", "temp", "infile") if each in fix.words]
        if held:
            fix.entry.impossible(f"the keyword {held[0]} of {fix.style}", "clumps that move freely")


def fixed_points(deck: Deck, points: Points) -> np.ndarray:
    """Mask (n,) of the particles that never move; tells fixes on other parts of the particles."""
    none = np.zeros(len(points.type), bool)
    fixes = [fix for fix in deck.fixes_of(*INTEGRATORS) if deck.acting(fix)]
    runs = [run for run in deck.runs if run.steps]
    moved = [
        np.any([none, *(_of_fix(deck, points, fix) for fix in fixes if fix.acts_in(run))], axis=0)
        for run in runs
    ]
    moves = np.any(moved, axis=0) if fixes else ~none
    if fixes and (moves & ~np.all(moved, axis=0)).any():
        fixes[-1].entry.approximated("particles that are integrated in some runs move in all of them")
    fixed = ~moves
    carried = [_of_fix(deck, points, each) for each in deck.fixes_of("move") if each.data is not None]
    for fix in deck.fixes_of("freeze"):
        if deck.acting(fix) and (frozen := _of_fix(deck, points, fix)).any():
            fixed |= frozen
            fix.entry.translated("particles.NAME.fixed")
            _tell_velocity(points, frozen, fix)
    for fix in deck.fixes_of("setforce"):
        if fix.data is not None:
            fixed |= _held(deck, points, fix, fixed)
    for fix in fixes:
        if fix.group != "all" and fixed.any():
            fix.entry.translated("particles.NAME.fixed of the others")
            _tell_velocity(points, ~moves & ~np.any([none, *carried], axis=0), fix)
    for fix in deck.fixes_of(*FORCES):
        if deck.acting(fix) and (~fixed & ~_of_fix(deck, points, fix)).any():
            fix.entry.impossible(
                f"{fix.style} on the group {fix.group} only: it acts on all particles that move",
                "the group all, or fixed: true for particles that do not move",
            )
    return fixed


def _tell_velocity(points: Points, fixed: np.ndarray, fix: Fix) -> None:
    """Say that particles which do not move have a velocity in the code, which its contacts take as one."""
    if points.motion[fixed].any():
        fix.entry.approximated(
            "fixed particles have no velocity; in the script their velocity acts on their contacts, although "
            "they do not move: set it to 0 there"
        )


def carried_points(deck: Deck, points: Points, fixed: np.ndarray) -> np.ndarray:
    """Name (n,) of the wall with which each particle moves by a fix move; empty for the others."""
    carried = np.full(len(points.type), "", dtype=object)
    for fix in deck.fixes_of("move"):
        if fix.data is None or not deck.acting(fix):
            continue
        chosen = _of_fix(deck, points, fix)
        if (chosen & ~fixed).any():
            fix.entry.impossible("particles that a fix integrates and fix move moves", MOVED)
        elif (carried[chosen] != "").any():
            fix.entry.impossible("several motions of the same particles", MOVED)
        elif not chosen.any():
            fix.entry.not_needed("the group has no particles")
        else:
            wall = plain_name(f"{fix.name}_carrier", "wall")
            carried[chosen] = wall
            first = int(np.argmax(chosen))
            deck.own("carriers", dict)[wall] = (fix, points.position[first], float(points.radius[first]))
    return carried


MOVED = "fixed: {to: WALL}, particles that move with a wall"
"""The nearest to particles that are moved."""


def setforce(deck: Deck, fix: Fix) -> None:
    """fix ID group setforce 0 0 0: particles that keep their velocity, such as those of a rough bottom."""
    words = Words(deck, fix.entry.command, fix.words)
    given = [words.word("a force") for _ in "xyz"]
    if words or not all(is_number(each) and float(each) == 0.0 for each in given):
        words.skip()
        fix.entry.impossible("forces that are set", HELD)
    else:
        fix.data = fix.group


HELD = "fixed: true for particles that do not move"
"""The nearest to forces that are set."""


def _held(deck: Deck, points: Points, fix: Fix, fixed: np.ndarray) -> np.ndarray:
    """Mask (n,) of the particles that rest because their force is 0; `fixed`: those that rest without it."""
    chosen = _of_fix(deck, points, fix)
    moving = chosen & ~fixed
    if not moving.any():
        fix.entry.not_needed("no fix moves these particles, or it holds none")
    elif points.motion[moving, :3].any():
        fix.entry.impossible("particles that move with a constant velocity", "a wall with the motion")
    elif len(deck.acting(fix)) < sum(run.steps > 0 for run in deck.runs):
        fix.entry.impossible("particles that are held in some runs only", HELD)
    else:
        fix.entry.approximated("particles.NAME.fixed; in the script friction can turn these particles")
        return moving
    return np.zeros(len(chosen), bool)


def _of_fix(deck: Deck, points: Points, fix: Fix) -> np.ndarray:
    """Mask (n,) of the particles of the group of a fix; all if the style of the group is not known."""
    found = chosen_points(deck, fix.entry.command, points, "group", fix.group)
    if found is None:
        group = deck.groups[fix.group]
        when = f", made at {group.start:g} s" if group.start else ""
        fix.entry.impossible(
            f"the group {fix.group} of the style {group.rule}{when}",
            "a group of a region, type or id, made before the first run",
        )
        return np.ones(len(points.type), bool)
    return np.asarray(found)


# Tables

COMMANDS: dict[str, Translation] = {
    "group": Translation(group, "not needed", "forces and walls apply to all particles"),
}
FIXES: dict[str, Translation] = {}
