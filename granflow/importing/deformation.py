"""Deformation of the box by fix deform: a simple shear, or axes whose widths change."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, log
from typing import Any

import numpy as np

from granflow.importing.deck import Deck, Fix, Run, Translation, Words
from granflow.importing.language import DeckError
from granflow.importing.scene_text import Draft, quantity
from granflow.importing.schedule import STAGED, stage_names

LARGEST_DEVIATION = 1e-3
"""Deviation of a width from that of the script, over the width, above which it is reported."""
NUMBERS = {"final": 2, "delta": 2, "scale": 1, "vel": 1, "erate": 1, "trate": 1}
"""Numbers of the styles of fix deform for an axis."""


@dataclass
class BoxChange:
    """One fix deform.

    shear:  axes such as xy and rate [1/s]; None without shear
    axes:   style and numbers by axis; lengths in m, rates in 1/s
    """

    shear: tuple[str, float] | None
    axes: dict[str, tuple[str, tuple[float, ...]]]
    remap: str


def deform(deck: Deck, fix: Fix) -> None:
    """fix ID group deform N xy erate RATE | x erate|trate|vel|scale|final|delta NUMBERS [remap x|v|none]"""
    words = Words(deck, fix.entry.command, fix.words)
    words.whole("the interval in steps")
    shears: list[tuple[str, float]] = []
    axes: dict[str, tuple[str, tuple[float, ...]]] = {}
    remap = "x"
    while words:
        key = words.word("a keyword")
        if key == "remap":
            remap = words.word("x, v or none")
            continue
        if key in ("flip", "units"):
            words.word(f"a value of {key}")
            continue
        style = words.word("the style of the deformation")
        if key in ("xy", "xz", "yz") and style == "erate":
            shears.append((key, words.number("the rate", "rate")))
        elif key in ("x", "y", "z") and style in NUMBERS:
            unit = {"vel": "velocity", "erate": "rate", "trate": "rate", "scale": "number"}.get(
                style, "length"
            )
            axes[key] = (
                style,
                tuple(words.number(f"a number of {style}", unit) for _ in range(NUMBERS[style])),
            )
        else:
            fix.entry.impossible(
                f"the deformation {key} {style} of the box",
                "a simple shear (xy erate RATE), or domain.deformation: {x: {strain_rate: RATE}} or {x: "
                "{pressure: P}} of a box without walls",
            )
            return
    if len(shears) > 1 or shears and axes:
        fix.entry.impossible("shear in several planes, or shear of a box that also changes its widths", "one")
        return
    if axes or shears:
        fix.data = BoxChange(shears[0] if shears else None, axes, remap)


# Shear


def shear(deck: Deck) -> None:
    """Lees-Edwards boundaries for a shear of the box."""
    for fix in deck.fixes_of("deform"):
        runs = deck.acting(fix)
        given: BoxChange | None = fix.data
        if given is None or given.shear is None or not runs:
            continue
        axes, rate = given.shear
        if not (_is_periodic(deck, axes[0]) and _is_periodic(deck, axes[1])):
            raise DeckError(fix.entry.command, f"a shear {axes} needs periodic boundaries along both axes.")
        keys: dict[str, Any] = {"flow": axes[0], "gradient": axes[1], "rate": quantity(rate, "rate")}
        if runs[0].start > 0.0:
            keys["start"] = quantity(runs[0].start, "time")
        if runs[-1].end < deck.end:
            fix.entry.approximated("the shear goes on to the end of the run")
        if given.remap != "v":
            moves = "moves all particles with the box" if given.remap == "x" else "changes no velocity"
            fix.entry.approximated(
                f"remap {given.remap} of the script {moves}; in the scene a particle that crosses a face of "
                f"the axis {axes[1]} takes its velocity, as with remap v"
            )
        deck.family["lees_edwards"] = keys
        fix.entry.translated("domain.lees_edwards")


def _is_periodic(deck: Deck, axis: str) -> bool:
    return deck.boundary[2 * "xyz".index(axis)] == "p"


# Widths


def build(deck: Deck, draft: Draft) -> None:
    """Write the deformation of the domain and of the stages, after these are written."""
    fixes = [fix for fix in deck.fixes_of("deform") if fix.data is not None and fix.data.axes]
    fixes = [fix for fix in fixes if deck.acting(fix)]
    if not fixes:
        return
    others = [*(draft.get("walls") or {}), *(["damping"] if draft.get("damping") else [])]
    if others:
        for fix in fixes:
            fix.entry.impossible(
                f"a box that deforms, together with {' and '.join(others)}, for which no frame is at rest",
                "walls that move in a box at rest, or a script without walls and without fix viscous",
            )
        return
    rates = {id(fix): _rates(deck, fix) for fix in fixes}
    names = stage_names(deck)
    before: dict[str, float] = {}
    for index, run in enumerate(deck.runs):
        if not run.steps:
            continue
        present = {axis: r for fix in fixes if fix.acts_in(run) for axis, r in rates[id(fix)].items()}
        if present == before:
            continue
        shown = {**dict.fromkeys(before, 0.0), **present}
        keys = {axis: {"strain_rate": quantity(rate, "rate")} for axis, rate in sorted(shown.items())}
        before = present
        if run.start == 0.0:
            draft.blocks["domain"]["deformation"] = keys
            path = "domain.deformation"
        else:
            stage = next(each for each in draft.get("stages") if each["name"] == names[index])
            stage["deformation"] = keys
            path = f"stages.{names[index]}.deformation"
        for fix in fixes:
            if fix.acts_in(run):
                fix.entry.translated(path, "its lower corner and faces are at rest, in the script its center")


def _rates(deck: Deck, fix: Fix) -> dict[str, float]:
    """Logarithmic strain rates [1/s] by axis that give the widths of the script at the end of the fix."""
    runs = deck.acting(fix)
    given: BoxChange = fix.data
    found = {}
    if given.remap != "x":
        fix.entry.approximated(
            f"particles move with the box; with remap {given.remap} of the script they do not"
        )
    for axis, (style, numbers) in given.axes.items():
        if not _is_periodic(deck, axis):
            fix.entry.impossible(
                f"a width along {axis} that changes without periodic boundaries", "a wall with a motion"
            )
            continue
        assert deck.box is not None
        k = 2 * "xyz".index(axis)
        width = deck.box[k + 1] - deck.box[k]
        widths = _widths(style, numbers, width, runs)
        if widths.min() <= 0.0:
            raise DeckError(fix.entry.command, f"the width along {axis} becomes {widths.min():.3g} m.")
        duration = runs[-1].end - runs[0].start
        rate = log(widths[-1] / width) / duration
        found[axis] = float(f"{rate:.9g}")
        share = np.linspace(0.0, 1.0, len(widths))
        deviation = np.abs(widths / (width * np.exp(rate * duration * share)) - 1.0).max()
        if deviation > LARGEST_DEVIATION:
            fix.entry.approximated(
                f"the width along {axis} changes at a constant logarithmic strain rate, up to "
                f"{100 * deviation:.2g} % from that of the script, and is equal at the end"
            )
    return found


SAMPLES = 200
"""Number of widths in a fix at which the deviation is evaluated."""


def _widths(style: str, numbers: Sequence[float], width: float, runs: Sequence[Run]) -> np.ndarray:
    """Widths [m] at equal times from the start of the first run to the end of the last.

    Each run begins with the width that the one before has left: erate, vel, scale, final and delta change it
    linearly in time, trate exponentially.
    """
    times, widths = [0.0], [width]
    for run in runs:
        duration, start = run.end - run.start, widths[-1]
        end = _width_after(style, numbers, start, duration)
        share = np.linspace(0.0, 1.0, SAMPLES)[1:]
        times += (times[-1] + duration * share).tolist()
        widths += (
            start * (end / start) ** share
            if style == "trate" and end > 0.0
            else start + (end - start) * share
        ).tolist()
    return np.interp(np.linspace(0.0, times[-1], SAMPLES * len(runs)), times, widths)


def _width_after(style: str, numbers: Sequence[float], start: float, duration: float) -> float:
    """Width [m] at the end of a run that lasts `duration` [s]."""
    match style:
        case "erate":
            return start * (1.0 + numbers[0] * duration)
        case "trate":
            return start * exp(numbers[0] * duration)
        case "vel":
            return start + numbers[0] * duration
        case "scale":
            return start * numbers[0]
        case "final":
            return numbers[1] - numbers[0]
        case _:  # delta
            return start + numbers[1] - numbers[0]


# Tables

COMMANDS: dict[str, Translation] = {}
FIXES: dict[str, Translation] = {
    "deform": Translation(
        deform,
        "domain.lees_edwards, domain.deformation",
        "shear xy, xz or yz (erate); x, y, z: erate, trate, vel, scale, final, delta as a constant rate "
        "of the logarithmic strain",
    ),
}
STAGED.add("deform")
