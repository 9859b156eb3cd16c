"""Schedule of a script: time step, runs, forces on all particles, output, and settings of the codes.

The runs of the script become stages where something that acts changes between them, otherwise one duration.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, hypot, radians, sin
from typing import Any

import numpy as np

from granflow.geometry.sphere import sphere_mass
from granflow.importing.deck import (
    DEFAULT_STEPS,
    Deck,
    Fix,
    Run,
    Translation,
    Vector,
    Words,
    impossible,
    not_needed,
)
from granflow.importing.groups import exclude, setforce
from granflow.importing.language import Command, DeckError, NotKnown
from granflow.importing.regions import Track, track_variables
from granflow.importing.report import Entry
from granflow.importing.scene_text import Draft, quantities, quantity
from granflow.io.tables import is_number
from granflow.scene.blocks.gravity import MOST_ROWS
from granflow.scene.blocks.run import LARGEST_CUNDALL
from granflow.schema.messages import suggestion_sentence

LARGEST_FRAMES = 2000
"""Number of frames above which an interval of output is enlarged."""

# Time


def timestep(deck: Deck, command: Command, entry: Entry) -> None:
    """timestep DT"""
    deck.time_step = Words(deck, command, command.words).number("the time step", "time")
    if deck.time_step <= 0.0:
        raise DeckError(command, f"the time step is {command.words[0]}; give a time above 0, such as 1e-5.")
    deck.time_step_entry = entry
    deck.interpreter.facts["dt"] = float(command.words[0])


def run(deck: Deck, command: Command, entry: Entry) -> None:
    """run N keywords"""
    words = Words(deck, command, command.words)
    steps = words.whole("the number of steps")
    if steps < 0:
        raise DeckError(command, f"the number of steps is {steps}; give one of at least 0, such as 1000.")
    while words:
        keyword = words.word("a keyword")
        if keyword == "upto":
            steps = max(0, steps - deck.step)
        elif keyword in ("pre", "post"):
            words.word("yes or no")
        elif keyword in ("start", "stop"):
            words.whole("a step")
        else:
            raise DeckError(command, f"run has no keyword {keyword}; it has upto, start, stop, pre and post.")
    if deck.time_step is None:
        deck.time_step = deck.step_here
        deck.interpreter.facts["dt"] = DEFAULT_STEPS[deck.units]
    facts = deck.interpreter.facts
    if _separates(deck):
        deck.own("separating", list).append(entry)
    end = deck.time + steps * deck.time_step
    active = tuple(deck.fixes)
    if steps == 0:
        entry.not_needed("it has no steps")
    deck.runs.append(Run(deck.time, end, deck.time_step, steps, deck.step, entry, active))
    for follow in deck.own("at_run", list):
        follow(deck, deck.runs[-1])
    deck.time = end
    deck.step += steps
    facts.update(step=deck.step, elapsed=0.0, time=facts["time"] + steps * facts["dt"])


def _separates(deck: Deck) -> bool:
    """Whether the next run separates random particles, by a limited displacement or a soft potential."""
    is_limited = any(fix.style == "nve/limit" for fix in deck.fixes.values())
    return bool(deck.own("fills", list)) and (is_limited or deck.family.get("pair_style") == "soft")


def reset_timestep(deck: Deck, command: Command, entry: Entry) -> None:
    """reset_timestep N"""
    deck.step = Words(deck, command, command.words).whole("the step")
    deck.interpreter.facts["step"] = deck.step
    entry.not_needed("granflow counts time, not steps")


def unfix(deck: Deck, command: Command, entry: Entry) -> None:
    """unfix ID"""
    name = Words(deck, command, command.words).word("the name of a fix")
    if name in deck.fixes and deck.fixes[name].style == "nve/limit":
        deck.drop_separating_runs()
    if name not in deck.fixes:
        raise DeckError(
            command, f"there is no fix {name} to unfix. Fixes: {', '.join(deck.fixes) or 'none'}."
        )
    fix = deck.fixes[name]
    user = _user_of(deck, fix)
    if user is not None:
        raise DeckError(command, f"fix {user.name} uses the mesh {name}; unfix {user.name} before it.")
    del deck.fixes[name]
    fix.end = deck.time
    entry.not_needed(f"it ends fix {name}, see its line")


def _user_of(deck: Deck, mesh: Fix) -> Fix | None:
    """A wall or a motion that acts with a mesh; the code does not end the mesh before."""
    if not mesh.style.startswith("mesh/surface"):
        return None
    users = (each for each in deck.fixes.values() if each.style in ("wall/gran", "move/mesh"))
    return next((each for each in users if mesh.name in each.words), None)


# Forces on all particles


@dataclass
class GravityFix:
    """One fix gravity whose numbers are variables.

    style:    vector, chute or spherical
    numbers:  magnitude and numbers of the direction; NaN for those of variables
    track:    of the variables, in their order
    """

    style: str
    numbers: list[float]
    track: Track

    def at(self, values: np.ndarray, unit: float) -> Vector:
        """Gravity [m/s2] for values (n,) of the variables; `unit` [m/s2]: of the magnitude."""
        rest = iter(values)
        numbers = [float(next(rest)) if each != each else each for each in self.numbers]
        return _vector_of(self.style, numbers[0] * unit, numbers[1:])


def _vector_of(style: str, magnitude: float, numbers: Sequence[float]) -> Vector:
    """Gravity [m/s2] of the numbers of a style; ValueError for a direction of no length."""
    if style == "vector":
        direction = (numbers[0], numbers[1], numbers[2])
    elif style == "chute":
        angle = radians(180.0 - numbers[0])
        direction = (sin(angle), 0.0, cos(angle))
    else:
        phi, theta = map(radians, numbers)
        direction = (sin(theta) * cos(phi), sin(theta) * sin(phi), cos(theta))
    length = hypot(*direction)
    if length == 0.0:
        raise ValueError
    x, y, z = (magnitude * round(each / length, 12) + 0.0 for each in direction)
    return x, y, z


GRAVITY_NUMBERS = {"vector": 3, "chute": 1, "spherical": 2}
"""Numbers of the direction by the style of gravity."""


def gravity(deck: Deck, fix: Fix) -> None:
    """fix ID group gravity MAGNITUDE vector X Y Z | chute ANGLE | spherical PHI THETA; numbers or v_NAME"""
    words = Words(deck, fix.entry.command, fix.words)
    names: list[str] = []

    def number(what: str) -> float:
        """A number, or NaN for the next variable."""
        if not words.next.startswith("v_"):
            return words.plain(what)
        names.append(words.word(what)[2:])
        return float("nan")

    numbers = [number("the magnitude of gravity")]
    style = words.word("vector, chute or spherical")
    if style not in GRAVITY_NUMBERS:
        fix.entry.impossible(f"gravity in the style {style}", f"one of {', '.join(GRAVITY_NUMBERS)}")
        return
    numbers += [number(f"a number of {style}") for _ in range(GRAVITY_NUMBERS[style])]
    if words:
        fix.entry.impossible(f"the keyword {words.next} of gravity", "no keyword")
    unit = deck.si(1.0, "acceleration")
    try:
        if not names:
            fix.data = _vector_of(style, numbers[0] * unit, numbers[1:])
            return
        varying = GravityFix(style, numbers, Track(tuple(names), fix.entry))
        fix.data = varying.at(np.array([deck.interpreter.value_at(each) for each in names]), unit)
    except ValueError:
        raise DeckError(
            fix.entry.command, "the direction of gravity is zero; give one, such as 0 0 -1."
        ) from None
    except NotKnown as error:
        if not error.is_result:
            raise DeckError(fix.entry.command, f"{error}; define it before this line.") from None
        fix.entry.impossible(
            f"gravity that follows the simulation ({error})",
            "gravity that time determines: a table, gravity: {times: [..], vectors: [..]}",
        )
        return
    deck.own("varying_gravity", dict)[id(fix)] = varying
    track_variables(deck, varying.track, lambda: fix.end is None)


def nve_sphere(deck: Deck, fix: Fix) -> None:
    """fix ID group nve/sphere [update dipole] [disc] [implicit_integration yes|no]"""
    words = Words(deck, fix.entry.command, fix.words)
    if words.next == "update":
        words.word("update")
        words.word("dipole")
    if words.next == "disc":
        words.skip()
        fix.entry.impossible("moments of inertia of discs", "spheres")
    if words.next == "implicit_integration":
        words.word("implicit_integration")
        words.flag("implicit_integration")
    fix.entry.not_needed("particles that are not fixed are integrated")


def nve(deck: Deck, fix: Fix) -> None:
    """fix ID group nve: positions and velocities only"""
    fix.entry.approximated("fix nve does not integrate the rotation; in the scene the particles rotate")


def viscous(deck: Deck, fix: Fix) -> None:
    """fix ID group viscous GAMMA: a force -GAMMA v, which is a rate for particles of one mass."""
    words = Words(deck, fix.entry.command, fix.words)
    fix.data = words.number("gamma", "damping")
    if words:
        fix.entry.impossible(f"the keyword {words.next} of viscous", "one coefficient for all types")


def cundall(deck: Deck, fix: Fix) -> None:
    """fix ID group damping/cundall GAMMA_L GAMMA_A: forces and torques that are lower if they accelerate."""
    words = Words(deck, fix.entry.command, fix.words)
    fix.data, angular = words.not_negative("gamma_l"), words.not_negative("gamma_a")
    if words:
        fix.entry.impossible(f"the keyword {words.next} of damping/cundall", "one ratio for all types")
    if fix.data > LARGEST_CUNDALL:
        fix.entry.impossible(f"a ratio above {LARGEST_CUNDALL}", f"damping: {{cundall: {LARGEST_CUNDALL}}}")
        fix.data = None
    elif angular != fix.data:
        fix.entry.approximated(f"torques are damped by {fix.data:g} as forces, in the script by {angular:g}")


def addforce(deck: Deck, fix: Fix) -> None:
    """fix ID group addforce FX FY FZ: a constant force, an acceleration of particles of one mass."""
    if all(map(is_number, fix.words[:3])) and len(fix.words) == 3:
        fix.data = np.array(Words(deck, fix.entry.command, fix.words).vector("the force", "force"))
    else:
        fix.entry.impossible(
            "a force that changes, or acts in a region", "gf.ParticleForces of a Python program"
        )


# Output


def dump(deck: Deck, command: Command, entry: Entry) -> None:
    """dump ID GROUP STYLE N FILE ..."""
    words = Words(deck, command, command.words)
    words.word("the name of the dump")
    group = words.word("a group")
    style = words.word("the style")
    steps = words.whole("the interval in steps")
    if style in ("image", "movie"):
        words.skip()
        entry.not_needed("granflow render writes images and films of a run")
        return
    words.word("the file")
    if group != "all":
        entry.approximated(f"frames have all particles, not only those of {group}")
    deck.own("dumps", list).append((steps, style, entry, words.rest))


def thermo(deck: Deck, command: Command, entry: Entry) -> None:
    """thermo N"""
    if command.words[:1] and command.words[0].startswith("v_"):
        entry.approximated("rows of timeseries.csv have the interval of the frames")
        return
    deck.family["thermo"] = (Words(deck, command, command.words).whole("the interval in steps"), entry)


KNOWN_COLUMNS = {
    **dict.fromkeys(("step", "elapsed", "dt", "time"), "time"),
    **dict.fromkeys(("atoms",), "particle_count"),
    **dict.fromkeys(("ke",), "kinetic_energy_translation"),
}


def thermo_style(deck: Deck, command: Command, entry: Entry) -> None:
    """thermo_style custom KEYWORDS"""
    entry.not_needed("timeseries.csv always has time, particle count, energies and momentum")


def thermo_modify(deck: Deck, command: Command, entry: Entry) -> None:
    """thermo_modify KEYWORDS"""
    words = Words(deck, command, command.words)
    lost = ""
    while words:
        key = words.word("a keyword")
        if key not in THERMO_KEYWORDS:
            remedy = suggestion_sentence(key, THERMO_KEYWORDS, "keywords")
            raise DeckError(command, f"thermo_modify has no keyword {key}. {remedy}")
        value = words.word(f"the value of {key}")
        if key == "lost":
            lost = value
        elif key in ("format", "colname") and value not in ("none", "default"):
            words.word(f"the second value of {key}")
    if lost:
        deck.family["lost"] = lost
        deck.family["lost_entry"] = entry
    else:
        entry.not_needed("settings of the printed table")


THERMO_KEYWORDS = (
    *("lost", "lost/bond", "warn", "norm", "flush", "line", "colname", "format", "temp", "press"),
    *("triclinic/general", "window"),
)
"""Keywords of thermo_modify; format and colname have two values."""


def restart(deck: Deck, command: Command, entry: Entry) -> None:
    """restart N FILE"""
    words = Words(deck, command, command.words)
    steps = words.whole("the interval in steps")
    words.skip()
    if steps:
        deck.family["restart"] = (steps, entry)
        deck.own("restart_steps", list).append((steps, deck.step))
    else:
        entry.not_needed("checkpoints are written anyway")


def compute(deck: Deck, command: Command, entry: Entry) -> None:
    """compute ID GROUP STYLE: quantities that granflow always writes, or has as metrics."""
    words = Words(deck, command, command.words)
    name = words.word("the name of the compute")
    words.word("a group")
    style = words.word("the style")
    words.skip()
    deck.computes[name] = entry
    counterpart = COMPUTES.get(style)
    if counterpart is None:
        entry.impossible(f"compute {style}", "metrics and fields of the block output, or granflow analyze")
    else:
        entry.not_needed(counterpart)


COMPUTES = {
    **dict.fromkeys(("erotate/sphere", "erotate", "erotate/multisphere", "ke", "ke/multisphere"),
                    "timeseries.csv has the kinetic energies of translation and rotation"),
    **dict.fromkeys(("temp", "temp/sphere", "temp/region"), "its energy is in timeseries.csv"),
    **dict.fromkeys(("pe", "pe/atom", "ke/atom", "erotate/sphere/atom"), "output.energy_budget has energies"),
    **dict.fromkeys(("reduce", "reduce/region", "property/atom", "property/local", "property/molecule"),
                    "the particle files have these properties"),
    **dict.fromkeys(("chunk/atom", "temp/chunk", "com/chunk", "vcm/chunk", "property/chunk", "reduce/chunk"),
                    "output.fields has averages on a grid"),
    **dict.fromkeys(("contact/atom", "contact/atom/gran", "coord/gran"),
                    "a metric has the number of contacts"),
    **dict.fromkeys(("pair/gran/local", "wall/gran/local", "pair/local"),
                    "output.contacts writes the contacts with their forces"),
    **dict.fromkeys(("stress/atom", "pressure"), "output.fields has the stress"),
    **dict.fromkeys(("com", "displace/atom", "msd", "gyration"), "it follows from the particle files"),
    **dict.fromkeys(("rigid", "nparticles/tracer/region", "multisphere", "multisphere/single", "slice"),
                    "the particle files have these properties"),
    **dict.fromkeys(("rdf", "cluster/atom", "coord/atom", "fabric", "group/group", "crosssection"),
                    "it follows from the files of particles and contacts"),
}  # fmt: skip
"""Styles of compute whose results granflow has in another form."""


def lost_in(deck: Deck) -> str:
    """What happens to particles that leave the box: ignore, warn or error.

    Without thermo_modify lost, LIGGGHTS deletes them (measured with 3.8.0), and LAMMPS stops.
    """
    return str(deck.family.get("lost", "ignore" if deck.code == "liggghts" else "error"))


# The blocks


def build(deck: Deck, draft: Draft) -> None:
    """Write gravity, domain, damping, stages, run, numerics and output."""
    _domain(deck, draft)
    _stages(deck, draft)
    _gravity(deck, draft)
    _damping(deck, draft)
    if deck.time_step is not None:
        steps = sorted({run.time_step for run in deck.runs if run.steps})
        entries = [deck.time_step_entry] if deck.time_step_entry else []
        draft.put(("run", "time_step"), quantity(steps[0] if steps else deck.time_step, "time"), *entries)
        if len(steps) > 1 and entries:
            entries[0].approximated(
                f"runs have time steps from {steps[0]:g} to {steps[-1]:g} s; the smallest is taken for all"
            )
    draft.put(
        ("numerics", "max_overlap"),
        0.8,
        remark="the script has no limit; without this key, overlaps above 0.1 are reported, and above 0.5 "
        "stop the run",
    )
    _output(deck, draft)


Gravity = Vector | dict[str, Any]
"""A constant vector [m/s2], or the times and vectors of a table."""


def gravity_in(deck: Deck, run: Run) -> Gravity:
    """Gravity in a run, with times from its start; zero without a fix that acts.

    Both codes add the forces of all fixes. Those of other groups than that of the newest fix are left out:
    fixes on parts of the particles are refused, and each of these has its own gravity.
    """
    acting = [fix for fix in deck.fixes_of("gravity") if fix.data and fix.acts_in(run)]
    acting = [fix for fix in acting if fix.group == acting[-1].group]
    courses: list[tuple[np.ndarray, np.ndarray]] = [
        (np.zeros(1), np.array([fix.data])) for fix in acting if not _varying(deck, fix)
    ]
    unit = deck.si(1.0, "acceleration")
    for fix in acting:
        if varying := _varying(deck, fix):
            times, values = varying.track.over([run])
            courses.append((times - run.start, np.array([varying.at(row, unit) for row in values])))
    courses = [each for each in courses if len(each[0])]
    times = np.unique(np.concatenate([np.zeros(1), *(each for each, _ in courses)]))
    times = times[:: -(-len(times) // MOST_ROWS)]
    total = np.zeros((len(times), 3))
    for at, vectors in courses:
        total += np.stack([np.interp(times, at, column) for column in vectors.T], axis=1)
    if np.ptp(total, axis=0).max() <= 1e-9 * np.abs(total).max():
        x, y, z = total[0].tolist()
        return x, y, z
    rounded = [[float(f"{each:.9g}") + 0.0 for each in row] for row in total.tolist()]
    return {"times": [float(f"{each:.12g}") for each in times.tolist()], "vectors": rounded}


def gravity_at(deck: Deck, run: Run) -> Vector:
    """Gravity [m/s2] at the beginning of a run; zero without a fix that acts."""
    if not any(fix.data and fix.acts_in(run) for fix in deck.fixes_of("gravity")):
        return (0.0, 0.0, 0.0)
    found = gravity_in(deck, run)
    x, y, z = found["vectors"][0] if isinstance(found, dict) else found
    return x, y, z


def _varying(deck: Deck, fix: Fix) -> GravityFix | None:
    """The variables of a fix gravity; None for one of numbers."""
    found: GravityFix | None = deck.own("varying_gravity", dict).get(id(fix))
    return found


def _added(deck: Deck, run: Run) -> np.ndarray:
    """Acceleration (3,) [m/s2] by the fixes addforce in a run."""
    total = np.zeros(3)
    for fix in _pushes(deck):
        if fix.acts_in(run):
            total += fix.data / _masses(deck)[0]
    return total


def _pushes(deck: Deck) -> list[Fix]:
    """The fixes addforce that are an acceleration: all particles are spheres of one mass."""
    masses = _masses(deck)
    is_one = masses and max(masses) <= 1.000001 * min(masses)
    has_clumps = any("clump" in each.keys for each in deck.particles)
    return [
        fix
        for fix in deck.fixes_of("addforce")
        if fix.data is not None and deck.acting(fix) and is_one and not has_clumps
    ]


def _masses(deck: Deck) -> list[float]:
    """Smallest and largest mass [kg] of the particles of each group."""
    return [float(sphere_mass(radius, each.density)) for each in deck.particles for radius in each.radii]


def _with_added(deck: Deck, run: Run) -> Gravity:
    """Gravity and the acceleration by fixes addforce in a run."""
    found = gravity_in(deck, run)
    added = _added(deck, run)
    if not added.any():
        return found
    if isinstance(found, dict):
        return {**found, "vectors": (np.array(found["vectors"]) + added).tolist()}
    x, y, z = (float(f"{each:.9g}") + 0.0 for each in np.array(found) + added)
    return x, y, z


def _gravity(deck: Deck, draft: Draft) -> None:
    """Gravity of the scene, and of the stages in which it is another one than before."""
    pushes = _pushes(deck)
    for fix in deck.fixes_of("addforce"):
        if fix.data is not None and deck.acting(fix) and fix not in pushes:
            fix.entry.impossible(
                "a constant force on particles of different masses, or on clumps",
                "gf.ParticleForces of a Python program",
            )
    fixes = [fix for fix in deck.fixes_of("gravity") if fix.data and deck.acting(fix)] + pushes
    runs = [run for run in deck.runs if run.steps]
    present = _with_added(deck, runs[0])
    entries = [fix.entry for fix in fixes if fix.acts_in(runs[0])]
    absent = "" if entries else "the first run of the script has no fix gravity"
    draft.put(("gravity",), _key_of(present), *entries, remark=absent)
    names = stage_names(deck)
    for index, name in names.items():
        value = _with_added(deck, deck.runs[index])
        if value != present:
            next(each for each in draft.get("stages") if each["name"] == name)["gravity"] = _key_of(value)
            present = value
    for fix in fixes:
        if fix.entry not in entries:
            fix.entry.translated("stages.NAME.gravity")


def _key_of(gravity: Gravity) -> Any:
    """The key gravity of a scene or a stage."""
    return gravity if isinstance(gravity, dict) else [*gravity]


def _domain(deck: Deck, draft: Draft) -> None:
    if deck.box is None or deck.box_entry is None:
        return
    low, high = list(deck.box[::2]), list(deck.box[1::2])
    periodic = [axis for k, axis in enumerate("xyz") if deck.boundary[2 * k] == "p"]
    sides = [k for k in range(6) if deck.boundary[k] != "p"]
    growing = [k for k in sides if deck.boundary[k] in "ms"]
    lost = lost_in(deck)
    entries = [each for each in (deck.boundary_entry, deck.family.get("lost_entry")) if each]
    keys: dict[str, object] = {}
    if not sides:
        on_exit = "error"
    elif len(growing) == len(sides):
        on_exit = "expand"
    else:
        on_exit = "error" if lost == "error" else "delete"
        for k in growing:
            corner = high if k % 2 else low
            corner[k // 2] += (2 * (k % 2) - 1) * (deck.box[k // 2 * 2 + 1] - deck.box[k // 2 * 2])
        if growing:
            names = ", ".join(f"{'xyz'[k // 2]}{('lo', 'hi')[k % 2]}" for k in growing)
            entries[0].approximated(
                f"only some sides grow with the particles: {names} is enlarged by the size of the box"
            )
    keys = {"min": quantities(low, "length"), "max": quantities(high, "length")}
    if periodic:
        keys["periodic"] = periodic
    if "lees_edwards" in deck.family:
        keys["lees_edwards"] = deck.family["lees_edwards"]
    draft.put(("domain",), {**keys, "on_exit": on_exit}, deck.box_entry, *entries)


def stage_names(deck: Deck) -> dict[int, str]:
    """Name of the stage of each run, by its index; runs that nothing separates share one; empty with one
    stage."""
    names: dict[int, str] = {}
    changes = {
        round(time, 12)
        for fix in deck.all_fixes
        if fix.style in STAGED and deck.acting(fix)
        for time in (fix.start, fix.end)
        if time is not None
    }
    changes |= {round(time, 12) for time in deck.own("changes", set)}
    count = 0
    before: Gravity | None = None
    for index, run in enumerate(deck.runs):
        if not run.steps:
            continue
        present = gravity_in(deck, run)
        is_changed = any(abs(time - run.start) <= run.slack and run.start > 0 for time in changes)
        if not names or is_changed or present != before:
            count += 1
        before = present
        names[index] = f"stage_{count}"
    return names if count > 1 else {}


STAGED: set[str] = {"viscous", "damping/cundall", "addforce"}
"""Styles of fixes whose begin or end makes a new stage; the families add theirs."""


def stages_of(deck: Deck, fix: Fix) -> list[str] | None:
    """Names of the stages in which a fix acts; None if it acts in all."""
    return stages_of_runs(deck, [run for run in deck.runs if fix.acts_in(run)])


def stages_of_runs(deck: Deck, runs: Sequence[Run]) -> list[str] | None:
    """Names of the stages of some runs; None if these are all."""
    names = stage_names(deck)
    chosen = {names[index] for index, run in enumerate(deck.runs) if index in names and run in runs}
    ordered = [name for name in dict.fromkeys(names.values()) if name in chosen]
    return None if len(chosen) == len(set(names.values())) else ordered


def _stages(deck: Deck, draft: Draft) -> None:
    runs = [run for run in deck.runs if run.steps]
    entries = [run.entry for run in runs]
    names = stage_names(deck)
    if not names:
        draft.put(("run", "duration"), quantity(sum(run.end - run.start for run in runs), "time"), *entries)
        return
    lengths: dict[str, float] = {}
    for index, name in names.items():
        lengths[name] = lengths.get(name, 0.0) + deck.runs[index].end - deck.runs[index].start
        deck.runs[index].entry.translated(f"stages ({name})")
    draft.put(("stages",), [{"name": name, "duration": quantity(t, "time")} for name, t in lengths.items()])


def _damping(deck: Deck, draft: Draft) -> None:
    """The damping of the scene: the sum of all fixes, in the stages of all runs in which it is the same."""
    masses = _masses(deck)
    fixes = [each for each in deck.fixes_of("viscous", "damping/cundall") if isinstance(each.data, float)]
    fixes = [each for each in fixes if each.data and deck.acting(each)] if masses else []
    if not fixes:
        return
    if "lees_edwards" in deck.family:
        for fix in fixes:
            fix.entry.impossible(
                "damping in a box that is sheared, in which no frame is at rest",
                "a scene that settles the particles with damping, and one that shears them (start_from)",
            )
        return
    found: dict[tuple[float, float], list[Run]] = {}
    for run in (each for each in deck.runs if each.steps):
        acting = [fix for fix in fixes if fix.acts_in(run)]
        drag = sum(fix.data for fix in acting if fix.style == "viscous") / (sum(masses) / len(masses))
        ratios = [fix for fix in acting if fix.style == "damping/cundall"]
        for fix in ratios[1:]:
            fix.entry.impossible("two Cundall ratios at a time", "one fix damping/cundall")
        if acting:
            found.setdefault((drag, ratios[0].data if ratios else 0.0), []).append(run)
    (drag, ratio), runs = next(iter(found.items()))
    entries = [fix.entry for fix in fixes if any(fix.acts_in(run) for run in runs)]
    keys: dict[str, Any] = {"drag": quantity(drag, "rate")} if drag else {}
    keys |= {"cundall": ratio} if ratio else {}
    stages = stages_of_runs(deck, runs)
    draft.put(("damping",), {**keys, **({"stages": stages} if stages else {})}, *entries)
    for fix in fixes:
        if fix.entry not in entries:
            fix.entry.impossible(
                "damping that changes between runs", "a scene for each, the second with start_from"
            )
        if fix.style == "viscous":
            if max(masses) > 1.000001 * min(masses):
                spread = 100 * (max(masses) / min(masses) - 1)
                fix.entry.approximated(
                    f"the drag of granflow is proportional to the mass, which differs by {spread:.3g} %"
                )
            fix.entry.approximated("the drag of granflow also damps the rotation")


def _output(deck: Deck, draft: Draft) -> None:
    step = deck.time_step or 0.0
    length = deck.end
    dumps = [each for each in deck.family.get("dumps", []) if each[0] > 0]
    entries = [entry for _, _, entry, _ in dumps]
    interval = min((steps for steps, *_ in dumps), default=0) * step
    if interval and length / interval > LARGEST_FRAMES:
        entries[0].approximated(f"at most {LARGEST_FRAMES} frames are written")
        interval = length / LARGEST_FRAMES
    if interval == 0.0 or interval > length > 0.0:
        interval = length / 50
    draft.put(("output", "interval"), quantity(interval, "time"), *entries)
    if "thermo" in deck.family:
        steps, entry = deck.family["thermo"]
        if steps:
            draft.put(("output", "timeseries_interval"), quantity(min(steps * step, length), "time"), entry)
    if "restart" in deck.family:
        steps, entry = deck.family["restart"]
        draft.put(("output", "checkpoint"), {"interval": quantity(steps * step, "time")}, entry)
    for _, style, entry, _ in dumps:
        if "local" in style or style == "pair/gran/local":
            draft.put(("output", "contacts"), True, entry)


# Tables

_COMMUNICATION = "communication between processors"
_NEIGHBOR = "granflow chooses the neighbor list"

COMMANDS: dict[str, Translation] = {
    "timestep": Translation(timestep, "run.time_step"),
    "run": Translation(run, "run.duration, stages", "stages where walls, motions, damping, gravity change"),
    "unfix": Translation(unfix, "stages", "the end of what the fix does"),
    "reset_timestep": Translation(reset_timestep, "not needed", "granflow counts time"),
    "dump": Translation(dump, "output.interval, contacts", "the properties of a particle file are fixed"),
    "thermo": Translation(thermo, "output.timeseries_interval"),
    "thermo_style": Translation(thermo_style, "not needed", "the columns of timeseries.csv are fixed"),
    "thermo_modify": Translation(thermo_modify, "domain.on_exit", "of its keywords lost has a counterpart"),
    "restart": Translation(restart, "output.checkpoint.interval"),
    "compute": Translation(compute, "not needed or output.metrics", "most results are in timeseries.csv"),
    "rerun": impossible("rerun", "granflow analyze"),
    "read_dump": impossible("read_dump", "read_data, or insert: {kind: file}"),
    "write_data": not_needed("a run writes the particles at its end"),
    "write_dump": not_needed("a run writes the particles at its end"),
    "undump": not_needed("frames are written to the end of the run"),
    "uncompute": not_needed("results are written to the end of the run"),
    "dump_modify": not_needed("the form of the files is fixed"),
    "compute_modify": not_needed("settings of temperatures"),
    "run_style": not_needed("the integrator is a leapfrog"),
    "neighbor": not_needed(_NEIGHBOR),
    "neigh_modify": Translation(exclude, "not needed", "exclude is not possible"),
    "newton": not_needed(_COMMUNICATION),
    "communicate": not_needed(_COMMUNICATION),
    "comm_modify": not_needed(_COMMUNICATION),
    "comm_style": not_needed(_COMMUNICATION),
    "processors": not_needed(_COMMUNICATION),
    "partitioner_style": not_needed(_COMMUNICATION),
    "thermo_log": not_needed("text of the code"),
    "balance": not_needed(_COMMUNICATION),
    "package": not_needed("settings of accelerators"),
    "suffix": not_needed("settings of accelerators"),
    "timers": not_needed("granflow writes its timings"),
    "timer": not_needed("granflow writes its timings"),
    "atom_modify": not_needed("storage of particles"),
    "modify_timing": not_needed("granflow writes its timings"),
    "soft_particles": not_needed("numerics.max_overlap permits large overlaps"),
    "hard_particles": not_needed("moduli have no upper limit"),
    "special_bonds": not_needed("particles have no bonds"),
    "reset_atoms": not_needed("particles keep their ids"),
    "reset_atom_ids": not_needed("particles keep their ids"),
    "write_header": not_needed("text of the code"),
}  # fmt: skip

FIXES: dict[str, Translation] = {
    "gravity": Translation(gravity, "gravity", "vector, chute, spherical; variables of time become a table"),
    "viscous": Translation(viscous, "damping.drag", "a rate: the coefficient over the mass"),
    "damping/cundall": Translation(cundall, "damping.cundall", "one ratio for forces and torques"),
    "nve/sphere": Translation(nve_sphere, "not needed", "particles that are not fixed are integrated"),
    "nve": Translation(nve, "not needed", "in the scene the particles rotate"),
    "check/timestep/gran": not_needed("granflow check verifies the time step"),
    "print": not_needed("timeseries.csv has the results"),
    "balance": not_needed(_COMMUNICATION),
    "ave/time": not_needed("timeseries.csv has the results; means of wall forces too"),
    "ave/atom": not_needed("metrics and fields of the block output average"),
    "ave/histo": not_needed("granflow plot --x energy, or the particle files"),
    "ave/spatial": not_needed("output.fields has averages on a grid"),
    "ave/chunk": not_needed("output.fields has averages on a grid"),
    "ave/euler": not_needed("output.fields has averages on a grid"),
    "ave/euler/stress": not_needed("output.fields has averages on a grid"),
    "diam/max": not_needed("granflow knows the largest diameter"),
    **dict.fromkeys(
        ("contacthistory", "contacthistory/mesh", "contactproperty/atom", "contactproperty/atom/wall"),
        not_needed("granflow keeps the history of contacts"),
    ),
    **dict.fromkeys(
        ("property/atom/tracer", "property/atom/tracer/stream", "property/atom/timetracer",
         "property/atom/regiontracer/time"),
        not_needed("a particle keeps its id in the particle files; flow meters have residence times"),
    ),
    "store/force": not_needed("the particle files have the forces"),
    "store/state": not_needed("the particle files have the state at the start"),
    "ave/correlate": not_needed("it follows from timeseries.csv"),
    "remove": impossible(
        "particles that are removed at a rate", "outlets of the scene, or delete of a stage (fraction)"
    ),
    "setforce": Translation(setforce, "particles.NAME.fixed", "0 0 0 of particles without velocity"),
    "addforce": Translation(addforce, "gravity", "the force over the mass, if all particles have one mass"),
    "aveforce": impossible("aveforce", "a Python program that sets forces"),
    **dict.fromkeys(
        ("planeforce", "lineforce", "oneway"),
        impossible("motion along some directions only", "a layer one diameter thick between two planes"),
    ),
    **dict.fromkeys(
        ("spring", "spring/self", "spring/chunk", "spring/rg", "drag", "addtorque", "addtorque/group",
         "viscous/sphere", "smd", "restrain", "tmd"),
        impossible("forces and torques beside those of contacts", "gf.ParticleForces of a Python program"),
    ),
    "nve/noforce": impossible("particles that keep their velocity", "fix move linear VX VY VZ"),
    "dt/reset": impossible(
        "a time step that follows the simulation", "run.time_step: adaptive, or a constant timestep"
    ),
    "halt": impossible("the end of a run at a condition", "stages.NAME.until of the scene"),
    **dict.fromkeys(
        ("evaporate", "deposit"),
        impossible("particles that come or go at random", "insert: {kind: rain}, or outlets of the scene"),
    ),
    "heat/flow": impossible("temperatures of LAMMPS", "particles.NAME.temperature and contact.heat"),
    "efield": impossible("electric fields", "a Python program that adds forces (notebook drag_and_field)"),
    "buoyancy": impossible("buoyancy", "a Python program that adds forces"),
    "enforce2d": impossible("two-dimensional simulations", "a layer one diameter thick between two walls"),
    "momentum": impossible("momentum", "thermal: {zero_momentum: true} at the start"),
    **dict.fromkeys(
        ("press/berendsen", "nph", "npt", "nph/sphere", "npt/sphere"),
        impossible(
            "a barostat", "domain.deformation: {x: {pressure: P}} of a box without walls, for each axis"
        ),
    ),
    **dict.fromkeys(
        ("temp/berendsen", "temp/rescale", "langevin", "nvt", "nvt/sphere"),
        impossible("a thermostat", "thermal: {velocity_rms: V} of a group at the start, or damping.drag"),
    ),
    **dict.fromkeys(
        ("couple/cfd", "couple/cfd/force", "couple/cfd/force/implicit", "couple/cfd/convection"),
        impossible("coupling with a fluid", "a Python program that adds forces"),
    ),
    "external": impossible("forces of another program", "a Python program that adds forces"),
    "nve/superquadric": impossible("superquadrics", "clumps of spheres: particles.NAME.clump"),
    "nve/asphere": impossible("ellipsoids", "clumps of spheres: particles.NAME.clump"),
    "multicontact/halfspace": impossible("corrections for many contacts", "contacts without them"),
    "poems": impossible("coupled rigid bodies", "clumps: particles.NAME.clump"),
}  # fmt: skip
