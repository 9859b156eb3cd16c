"""Scripts that continue with the restart file of another one: both become one scene with stages.

A restart file has the box, the particles, their groups and the step; all fixes are given again.
"""

import re
from pathlib import Path

from granflow.importing.deck import Deck, Translation, Words
from granflow.importing.language import Command
from granflow.importing.report import Entry

NEAREST = "granflow import with --after and the script that writes the file; or write_data and read_data"


def begin_script(deck: Deck) -> None:
    """End what the script before has defined; read_restart gives back its box and particles."""
    for fix in deck.fixes.values():
        fix.end = deck.time
    deck.fixes.clear()
    deck.regions.clear()
    for name in ("lattice", "lattice_cell", "cleared"):
        deck.family.pop(name, None)
    deck.family["restart_box"] = (deck.box, deck.box_entry, deck.types)
    deck.box = None
    deck.interpreter.begin_script()


def write_restart(deck: Deck, command: Command, entry: Entry) -> None:
    """write_restart FILE"""
    words = Words(deck, command, command.words)
    deck.own("restart_files", list).append((Path(words.word("the file")).name, deck.step))
    words.skip()
    entry.not_needed("a run writes a checkpoint at its end")


def read_restart(deck: Deck, command: Command, entry: Entry) -> None:
    """read_restart FILE, of the script before."""
    words = Words(deck, command, command.words)
    name = Path(words.word("the file")).name
    words.skip()
    if "restart_box" not in deck.family:
        entry.impossible("restart files can be read by the code only", NEAREST)
        return
    deck.box, deck.box_entry, deck.types = deck.family.pop("restart_box")
    step = _step_of(deck, name)
    if step is None:
        entry.approximated(
            f"no line of the script before writes {name}; its end, {deck.time:.6g} s, is taken"
        )
    else:
        _cut(deck, step)
        entry.not_needed(f"the scene continues at {deck.time:.6g} s, after step {step}")


def _step_of(deck: Deck, name: str) -> int | None:
    """The step at which a restart file was written, by write_restart or restart; None if it is not known."""
    written = {file.replace("*", str(step)): step for file, step in deck.own("restart_files", list)}
    if name in written:
        return int(written[name])
    numbers = re.findall(r"\d+", name)
    step = int(numbers[-1]) if numbers else -1
    intervals: list[tuple[int, int]] = deck.own("restart_steps", list)
    if any(since < step <= deck.step and step % every == 0 for every, since in intervals):
        return step
    return None


def _cut(deck: Deck, step: int) -> None:
    """Leave out what follows a step of the runs so far."""
    while deck.runs and deck.runs[-1].first_step >= step:
        deck.runs.pop()
    if deck.runs:
        last = deck.runs[-1]
        last.steps = min(last.steps, step - last.first_step)
        last.end = last.start + last.steps * last.time_step
    deck.time, deck.step = deck.end, step
    deck.interpreter.facts.update(step=step)
    for fix in deck.all_fixes:
        fix.start = min(fix.start, deck.time)
        fix.end = deck.time if fix.end is None else min(fix.end, deck.time)


COMMANDS: dict[str, Translation] = {
    "read_restart": Translation(read_restart, "stages", "with --after: the script that writes the file"),
    "write_restart": Translation(write_restart, "not needed", "a run writes a checkpoint at its end"),
}
FIXES: dict[str, Translation] = {}
