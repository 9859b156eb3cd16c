"""Loops that run until a result of the simulation is reached: stages that end on it.

Scripts repeat a run until the particles are at rest, or a force is reached, and leave the loop by a jump:

    label loop
    if "${ke} < 1e-6" then "jump SELF done"
    run 10000
    jump SELF loop
    label done
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import pi
from typing import Any

from granflow.importing.deck import Deck, Run
from granflow.importing.language import DeckError, NotKnown
from granflow.importing.meshes import Mesh
from granflow.importing.report import Entry
from granflow.importing.scene_text import Draft, motions_of, plain_name, quantity
from granflow.importing.schedule import stage_names
from granflow.units import to_si

MOST_REPEATS = 100
"""Repetitions after which a stage ends anyway; the loops of scripts have no limit."""
CENTER = re.compile(r"vcm\(all,([xyz])\)")
"""Velocity of the center of mass of all particles."""


@dataclass
class Loop:
    """One loop whose runs end on a condition.

    condition:  the keys of the stage that ends on it; called when all particles are known
    """

    entry: Entry
    condition: Callable[[], dict[str, Any]]
    first: int
    """Index of its first run."""
    runs: list[Run] = field(default_factory=list)


def decide(deck: Deck, where: tuple[str, int], text: str) -> bool | None:
    """Whether a condition on results is true: not at first, but after the first repetition of its loop.

    None if no stage can end on it.
    """
    waiting: dict[tuple[str, int], Loop] = deck.own("waiting", dict)
    if where in waiting:
        loop = waiting.pop(where)
        loop.runs = [run for run in deck.runs[loop.first :] if run.steps]
        if loop.runs:
            deck.own("loops", list).append(loop)
            deck.own("changes", set).update((loop.runs[0].start, deck.time))
        return True
    condition = _condition(deck, text)
    if condition is None:
        return None
    waiting[where] = Loop(deck.report.entries[-1], condition, len(deck.runs))
    return False


def _condition(deck: Deck, text: str) -> Callable[[], dict[str, Any]] | None:
    """The keys of a stage that ends when a comparison is true; None for one that no stage can end on."""
    parts = re.fullmatch(r"([^<>=!&|]+)(<|>)=?([^<>=!&|]+)", text)
    if parts is None:
        return None
    formula, symbol, bound = (each.strip() for each in parts.groups())
    try:
        value = deck.interpreter.evaluate(bound)
    except (NotKnown, ValueError):
        try:
            value, formula, symbol = deck.interpreter.evaluate(formula), bound, "<>"[symbol == "<"]
        except (NotKnown, ValueError):
            return None
    while formula.startswith("(") and formula.endswith(")") and _is_closed(formula[1:-1]):
        formula = formula[1:-1].strip()
    return _rest(deck, formula, symbol, value) or _force(deck, formula, symbol, value)


def _is_closed(text: str) -> bool:
    """Whether each bracket of a text closes one that it opens."""
    depth = 0
    for letter in text:
        depth += (letter == "(") - (letter == ")")
        if depth < 0:
            return False
    return depth == 0


def _rest(deck: Deck, formula: str, symbol: str, value: float) -> Callable[[], dict[str, Any]] | None:
    """An energy of translation, or the speed of the center of mass, that falls below a value."""
    if symbol != "<" or value <= 0.0:
        return None
    known = deck.computes.get(formula.removeprefix("c_")) if formula.startswith("c_") else None
    if formula == "ke" or known is not None and known.command.words[2:3] == ("ke",):
        energy = deck.si(value, "energy")
        until = {"quantity": "kinetic_energy", "below": f"{energy:.12g} J"}
        return lambda: {"until": until}
    if CENTER.search(formula):
        numbers = {"x": "0.36", "y": "0.48", "z": "0.8"}  # a vector of length 1
        try:
            length = deck.interpreter.evaluate(CENTER.sub(lambda each: numbers[each[1]], formula))
        except (NotKnown, ValueError):
            return None
        speed = deck.si(value, "velocity")
        return (lambda: _slow(deck, speed)) if abs(length - 1.0) < 1e-9 else None
    return None


def _slow(deck: Deck, speed: float) -> dict[str, Any]:
    """The end at rest: the mean energy of particles with a speed [m/s], of the smallest ones."""
    radius, density = min((each.radii[0], each.density) for each in deck.particles)
    return {"kinetic_energy_below": f"{0.5 * density * 4.0 / 3.0 * pi * radius**3 * speed**2:.6g} J"}


def _force(deck: Deck, formula: str, symbol: str, value: float) -> Callable[[], dict[str, Any]] | None:
    """A component of the force on a mesh, f_NAME[1] to f_NAME[3], that passes a value."""
    parts = re.fullmatch(r"f_(\w+)\[([123])\]", formula)
    fix = deck.fixes.get(parts[1]) if parts else None
    if parts is None or fix is None or not isinstance(fix.data, Mesh) or not fix.data.measured:
        return None
    column = f"wall_force_{'xyz'[int(parts[2]) - 1]}.{plain_name(parts[1], 'wall')}"
    side = "above" if symbol == ">" else "below"
    until = {"quantity": column, side: f"{deck.si(value, 'force'):.12g} N"}
    return lambda: {"until": until}


def build(deck: Deck, draft: Draft) -> None:
    """End stages on the conditions of loops, and let what follows them begin with its stage."""
    loops: list[Loop] = deck.own("loops", list)
    for loop in loops:
        if not deck.particles:
            raise DeckError(loop.entry.command, "the loop waits for particles, but the script inserts none.")
        name = next(name for k, name in stage_names(deck).items() if deck.runs[k] is loop.runs[0])
        stage = next(each for each in draft.get("stages") if each["name"] == name)
        length = sum(run.end - run.start for run in loop.runs)
        del stage["duration"]
        stage |= {**loop.condition(), "max_duration": quantity(MOST_REPEATS * length, "time")}
        loop.entry.translated(f"stages ({name})")
        end = "as soon as the condition is true"
        if "kinetic_energy_below" in stage:
            end = (
                "at rest, when the mean speed of all particles, not that of their center, is below the value"
            )
        loop.entry.approximated(
            f"the stage ends {end}, at the latest after {MOST_REPEATS} repetitions; the script evaluates "
            f"the condition every {length:.4g} s"
        )
    if loops:
        for keys in _timed(draft):
            _follow_stages(deck, loops, keys)


def _timed(draft: Draft) -> Iterator[dict[str, Any]]:
    """All insertions and motions of the scene."""
    for group in (draft.get("particles") or {}).values():
        if "insert" in group:
            yield group["insert"]
    for wall in (draft.get("walls") or {}).values():
        yield from motions_of(wall)


def _follow_stages(deck: Deck, loops: list[Loop], keys: dict[str, Any]) -> None:
    """Replace times after a loop, which are not known, by stages."""
    start, end = (to_si(keys[key], "time") if key in keys else None for key in ("start", "end"))
    first = loops[0].runs[-1].end
    if (start is None or start < first - 1e-12) and (end is None or end < first + 1e-12):
        return
    names = stage_names(deck)
    runs = {k: deck.runs[k] for k in names}
    begins = {name: min(runs[k].start for k in runs if names[k] == name) for name in names.values()}
    ends = {name: max(runs[k].end for k in runs if names[k] == name) for name in names.values()}
    slack = max(run.slack for run in runs.values())
    chosen = [
        name
        for name in begins
        if begins[name] >= (start or 0.0) - slack and (end is None or ends[name] <= end + slack)
    ]
    fits = chosen and abs(begins[chosen[0]] - (start or 0.0)) <= slack
    if not fits or end is not None and abs(ends[chosen[-1]] - end) > slack:
        loops[0].entry.impossible(
            "a time after a loop of unknown length, at which no run begins or ends",
            "a run of its own for what begins or ends then",
        )
        return
    for key in ("start", "end"):
        keys.pop(key, None)
    keys["stages"] = chosen
