"""From a script to the text of a scene and a report."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from granflow.errors import GranflowError
from granflow.importing import (
    deformation,
    deletion,
    geometry,
    groups,
    heat,
    insertion,
    materials,
    meshes,
    motion,
    multisphere,
    region_walls,
    regions,
    restart,
    schedule,
    settings,
    start,
    waiting,
)
from granflow.importing.deck import UNITS, Deck, Fix, Translation, Words, plain_style
from granflow.importing.groups import MOVERS, group_named, tell_bodies, tell_excluded, tell_inserted
from granflow.importing.language import Command, DeckError, Interpreter
from granflow.importing.report import NOT_POSSIBLE, Entry, Report
from granflow.importing.restart import begin_script
from granflow.importing.scene_text import Draft

CODES = ("liggghts", "lammps")
"""Values of --code."""
FAMILIES = (
    schedule,
    materials,
    regions,
    groups,
    geometry,
    deformation,
    meshes,
    motion,
    insertion,
    start,
    restart,
    deletion,
    multisphere,
    heat,
    settings,
)
"""Families of commands; each has the tables COMMANDS and FIXES."""
SHAPES = {"sphere", "granular"}
"""Atom styles of spheres."""
STEP = ("run", "time_step")
"""Key of the time step."""


@dataclass(frozen=True)
class Imported:
    """A translated script.

    draft:   the blocks of the scene; None if what is not possible leaves no scene
    origin:  what the scene was made from, for its first line
    files:   files beside the scene by name
    """

    draft: Draft | None
    origin: str
    files: Mapping[str, bytes]
    report: Report
    code: str
    printed: tuple[str, ...]

    @property
    def text(self) -> str:
        """The scene as YAML; empty without one."""
        return "" if self.draft is None else self.draft.text(self.origin)

    def make_step_automatic(self, reason: str) -> None:
        """Leave the choice of the time step to granflow; `reason`: why that of the script is not taken."""
        if self.draft is None:
            return
        for entry in self.draft.owners.get(STEP, ()):
            entry.approximated(f"{reason}; the step is automatic")
        self.draft.remove(*STEP)


def units(deck: Deck, command: Command, entry: Entry) -> None:
    """units STYLE"""
    style = Words(deck, command, command.words).word("the unit system")
    if deck.box is not None:
        raise DeckError(
            command, "units follows the box; the code requires it before create_box or read_data."
        )
    deck.family["has_units"] = True
    if style not in UNITS:
        entry.impossible(f"units {style}", "si, cgs or micro")
        return
    deck.units = style
    if style == "lj":
        entry.approximated("numbers without units are taken as SI: lengths in m, masses in kg, times in s")
    else:
        entry.not_needed("all numbers are converted to SI")


def atom_style(deck: Deck, command: Command, entry: Entry) -> None:
    """atom_style STYLE"""
    words = Words(deck, command, command.words)
    style = words.word("the atom style")
    if words.next in ("0", "1"):  # whether radii change
        words.skip()
    if plain_style(style, SHAPES) in SHAPES:
        entry.not_needed("particles are spheres or clumps")
    else:
        entry.impossible(f"atom_style {style}", "spheres, or clumps of spheres")


def dimension(deck: Deck, command: Command, entry: Entry) -> None:
    """dimension N"""
    deck.dimension = Words(deck, command, command.words).whole("the dimension")
    if deck.dimension == 3:
        entry.not_needed("granflow is three-dimensional")
    else:
        entry.impossible("two dimensions", "a layer one diameter thick")


def clear(deck: Deck, command: Command, entry: Entry) -> None:
    """clear: the next command begins another simulation, if there was one before."""
    entry.not_needed("no simulation precedes it, or none follows")
    if deck.box is not None:
        deck.family["cleared"] = entry


OWN: dict[str, Translation] = {
    "clear": Translation(
        clear, "not needed", "before the simulation and after it; a second one is not possible"
    ),
    "units": Translation(units, "all numbers", "si, cgs, micro, nano; lj is taken as SI"),
    "atom_style": Translation(atom_style, "not needed", "sphere, granular"),
    "dimension": Translation(dimension, "not needed", "3"),
}


def all_commands() -> dict[str, Translation]:
    """Translations of all commands by name."""
    found = dict(OWN)
    for family in FAMILIES:
        found |= family.COMMANDS
    return found


def all_fixes() -> dict[str, Translation]:
    """Translations of all fixes by style."""
    found: dict[str, Translation] = {}
    for family in FAMILIES:
        found |= family.FIXES
    return found


def fix(deck: Deck, command: Command, entry: Entry, fixes: Mapping[str, Translation]) -> None:
    """fix ID GROUP STYLE ...; one of the same name replaces the earlier one."""
    words = Words(deck, command, command.words)
    name, group, style = words.word("the name of the fix"), words.word("a group"), words.word("a style")
    if group != "all":
        group_named(deck, command, group)
    earlier = deck.fixes.pop(name, None)
    if earlier is not None:
        earlier.end = deck.time
    made = Fix(name, group, plain_style(style, fixes), words.rest, entry, deck.time, deck.step)
    deck.fixes[name] = made
    deck.all_fixes.append(made)
    translation = fixes.get(made.style)
    if translation is None:
        entry.impossible(f"fix {style} is not known", _similar(style, fixes))
        return
    translation.handler(deck, made)


SLIP = 0.85
"""Similarity of words from which one is a slip of the pen for the other."""


def _similar(word: str, known: Iterable[str]) -> str:
    """The known word that an unknown one probably means, or what to do without it."""
    found = get_close_matches(word, list(known), n=1, cutoff=SLIP)
    return found[0] if found else "the script without the line, if it does not act on particles (--partial)"


def _tell_box(deck: Deck) -> None:
    """Let formulas know the box, in the units of the script."""
    if deck.box is None:
        return
    low_high = [each / deck.si(1.0, "length") for each in deck.box]
    facts = deck.interpreter.facts
    for k, axis in enumerate("xyz"):
        facts[f"{axis}lo"], facts[f"{axis}hi"] = low_high[2 * k : 2 * k + 2]
        facts[f"l{axis}"] = facts[f"{axis}hi"] - facts[f"{axis}lo"]
    facts["vol"] = facts["lx"] * facts["ly"] * facts["lz"]


def code_of(path: Path, commands: Iterable[Command]) -> str:
    """The code that a script is for: LIGGGHTS has properties, templates and models of its own."""
    for each in commands:
        is_own = (
            each.words[:1] == ("gran",)
            or each.words[2:3]
            and each.words[2].startswith(
                (
                    "property/global",
                    "mesh/surface",
                    "insert/",
                    "particletemplate",
                    "heat/gran",
                    "check/timestep",
                )
            )
        )
        if is_own or each.words[:1] == ("granular",) and each.name == "atom_style":
            return "liggghts"
        if each.name == "run":
            break
    return "lammps"


def convert(
    path: Path,
    given: Mapping[str, str] | None = None,
    code: str | None = None,
    after: Sequence[Path] = (),
) -> Imported:
    """Translate a script. Raises DeckError for an error of the script, with its line.

    given:  values of variables
    after:  scripts whose restart file the next one reads; the last one writes that of the script
    """
    settings = dict(given or {})
    commands, fixes = all_commands(), all_fixes()
    unneeded = {name for name, each in commands.items() if each.is_unneeded}
    unneeded |= {f"fix {name}" for name, each in fixes.items() if each.is_unneeded}
    if code is None:
        try:
            first = [*after, path][0]
            code = code_of(first, Interpreter(given=settings, unneeded=unneeded).commands(first))
        except GranflowError:
            code = "lammps"  # the same error follows below, with its line
    report = Report()

    def executed(command: Command, problem: str) -> None:
        """Report a command of the language itself."""
        if problem:
            report.entry(command).impossible(problem, "run it before the import")
        elif command.name == "shell":
            report.entry(command).not_needed("granflow makes the folders of its output")
        else:
            report.entry(command).not_needed("executed: the scene has the result")

    interpreter = Interpreter(given=settings, unneeded=unneeded, on_executed=executed)
    deck = Deck(code, interpreter, report)
    interpreter.on_defined = deck.has
    interpreter.on_result = lambda where, condition: waiting.decide(deck, where, condition)
    for script in (*after, path):
        if script is not (*after, path)[0]:
            begin_script(deck)
        _read(deck, script, commands, fixes)
    try:
        draft = _draft(deck, path)
    except GranflowError:
        if report.is_complete:
            raise
        draft = None  # what is missing is probably one of the lines that are not possible
    code_name = {"liggghts": "LIGGGHTS", "lammps": "LAMMPS"}[code]
    names = " and ".join(each.name for each in (*after, path))
    kind = f"a script of {code_name}" if not after else f"scripts of {code_name}"
    origin = f"Made by granflow import from {names}, {kind}; comments have its lines."
    files = {} if draft is None else draft.files
    return Imported(draft, origin, files, report, code, tuple(interpreter.printed))


def _read(
    deck: Deck, path: Path, commands: Mapping[str, Translation], fixes: Mapping[str, Translation]
) -> None:
    """Execute one script. Raises DeckError."""
    report = deck.report
    deck.family["folder"] = path.parent
    is_script = False
    for command in deck.interpreter.commands(path):
        is_script = is_script or command.name in ("fix", *commands)
        if "cleared" in deck.family:
            deck.family["cleared"].remarks.clear()
            deck.family["cleared"].impossible(
                "a second simulation in one script",
                "a script for each, or one value for the variable of its loop (--set NAME=VALUE)",
            )
            break
        entry = report.entry(command)
        try:
            if command.name == "fix":
                fix(deck, command, entry, fixes)
            elif command.name in commands:
                commands[command.name].handler(deck, command, entry)
            else:
                entry.impossible(f"the command {command.name} is not known", _similar(command.name, commands))
        except DeckError as error:
            if all(each is entry or each.kind != NOT_POSSIBLE for each in report.entries):
                raise
            entry.impossible(
                f"{error.reason.removesuffix('.')} (what is not possible before may be the cause)"
            )
        deck.report_unread(entry)
        _tell_box(deck)
    if not is_script:
        raise GranflowError(
            f"{path}: no line begins with a command of LIGGGHTS or LAMMPS; give a script, such as in.bed."
        )


def _draft(deck: Deck, path: Path) -> Draft:
    """Build the blocks of the scene."""
    if not any(run.steps for run in deck.runs):
        raise GranflowError(f"{path}: the script has no run, so that there is nothing to simulate.")
    if deck.box is None:
        raise GranflowError(
            f"{path}: the script has no create_box or read_data, so that the box is not known."
        )
    first = next(run for run in deck.runs if run.steps)
    if "has_units" not in deck.family and deck.box_entry is not None:
        deck.box_entry.approximated(
            "the script has no units; numbers of the default lj are taken as SI: m, kg, s"
        )
    if deck.time_step_entry is None:
        first.entry.translated(f"run.time_step (no timestep is given: the default of units {deck.units})")
    if not any(fix.style.startswith(MOVERS) for fix in deck.all_fixes):
        first.entry.approximated(
            "no fix such as nve/sphere integrates the particles, so that the code does not move them; the "
            "scene does"
        )
    draft = Draft(with_files=len({each.command.file for each in deck.report.entries}) > 1)
    draft.put(("title",), path.name)
    region_walls.note_jumps(deck)
    start.add_points(deck, draft)
    insertion.collect(deck)
    tell_inserted(deck)
    tell_excluded(deck)
    tell_bodies(deck, bool(deck.family.get("points")))
    materials.build(deck, draft)
    geometry.build(deck, draft)
    insertion.build(deck, draft)
    motion.carry(deck, draft)
    schedule.build(deck, draft)
    waiting.build(deck, draft)
    deformation.build(deck, draft)
    heat.build(deck, draft)
    settings.build(deck, draft)
    deletion.build(deck, draft)
    materials.report_properties(deck)
    return draft


__all__ = ["CODES", "DeckError", "Imported", "convert"]
