"""What a script has said so far, as plain data in SI units, and the reader of the words of a command.

The families of commands (`materials`, `geometry`, `insertion`, `schedule`) fill a `Deck` while the script is
executed and build the blocks of the scene from it afterwards. A fix lives from its command to its `unfix`;
its times tell in which stages it acts.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Container
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

import numpy as np

from granflow.importing.language import Command, DeckError, Interpreter
from granflow.importing.report import NOT_POSSIBLE, Entry, Report

Vector = tuple[float, float, float]

# Units

UNITS: dict[str, Vector] = {
    "si": (1.0, 1.0, 1.0),
    "cgs": (1e-3, 1e-2, 1.0),
    "micro": (1e-15, 1e-6, 1e-6),
    "nano": (1e-21, 1e-9, 1e-9),
    "lj": (1.0, 1.0, 1.0),
}
"""Mass [kg], length [m] and time [s] of a unit system; numbers of lj have no unit and are taken as SI."""

DEFAULT_STEPS = {"si": 1e-8, "cgs": 1e-8, "micro": 2.0, "nano": 0.00045, "lj": 0.005}
"""Time step of a script without timestep, in its units."""

DIMENSIONS: dict[str, tuple[int, int, int]] = {
    "number": (0, 0, 0),
    "length": (0, 1, 0),
    "time": (0, 0, 1),
    "mass": (1, 0, 0),
    "velocity": (0, 1, -1),
    "angular_velocity": (0, 0, -1),
    "acceleration": (0, 1, -2),
    "density": (1, -3, 0),
    "pressure": (1, -1, -2),
    "compliance": (-1, 1, 2),
    "stiffness": (1, 0, -2),
    "surface_energy": (1, 0, -2),
    "viscosity": (1, -1, -1),
    "damping": (1, 0, -1),
    "force": (1, 1, -2),
    "torque": (1, 2, -2),
    "energy": (1, 2, -2),
    "rate": (0, 0, -1),
    "mass_flow": (1, 0, -1),
    "volume": (0, 3, 0),
    "hertz_damping": (0, -1, -1),
    "conductivity": (1, 1, -3),
    "heat_capacity": (0, 2, -2),
    "power": (1, 2, -3),
}
"""Exponents of mass, length and time."""
LARGEST_WHOLE = 2**31 - 1
"""Largest number of particles, and largest seed, of the codes."""
MOST_TYPES = 1000
"""Number of atom types above which it is taken to be wrong; each pair of types has coefficients."""
SMALLEST = 1e-30
LARGEST = 1e30
"""Magnitudes of numbers of a script; volumes and energies made from them are floating-point numbers, too."""


# Parts of a deck


@dataclass
class Region:
    """A region of the script.

    kind:     block, cylinder, cone, sphere, plane, ... as in the script
    numbers:  its numbers in SI, infinite for INF and NaN for EDGE; for union and intersect none
    parts:    names of the regions of a union or intersection
    inside:   whether the region is the inside (side in)
    open:     numbers of its open faces (LAMMPS)
    """

    name: str
    kind: str
    axis: str
    numbers: tuple[float, ...]
    entry: Entry
    parts: tuple[str, ...] = ()
    inside: bool = True
    open: tuple[int, ...] = ()
    start: float = 0.0
    """Time of the command [s]."""
    motion: Any = None
    """A `regions.RegionMotion`; None for a region at rest."""


@dataclass
class Group:
    """A group of the script: all particles, those of a region or of types.

    rule:   its style
    start:  time of the command [s], at which the particles that exist become members
    """

    name: str
    rule: str
    words: tuple[str, ...]
    entry: Entry
    start: float = 0.0


@dataclass
class Fix:
    """A fix from its command to its unfix.

    words:  the words after the style
    data:   what its handler makes of them
    """

    name: str
    group: str
    style: str
    words: tuple[str, ...]
    entry: Entry
    start: float
    step: int
    end: float | None = None
    data: Any = None

    def acts_in(self, run: "Run") -> bool:
        """Whether the fix exists in a run; a run can stand behind it at the same time only if it has no
        length."""
        return self.start <= run.start + run.slack and (self.end is None or self.end >= run.end - run.slack)


@dataclass
class Run:
    """One `run`: its times [s] and time step [s]; the schedule joins runs to stages."""

    start: float
    end: float
    time_step: float
    steps: int
    first_step: int
    entry: Entry
    fixes: tuple[str, ...] = ()

    @property
    def slack(self) -> float:
        """Tolerance of times [s]."""
        return 0.01 * self.time_step


@dataclass
class ParticleGroup:
    """A group of particles of the scene, before its material is known.

    type:     atom type
    density:  [kg/m3]
    radii:    smallest and largest radius [m]
    radius:   mean radius by mass [m], at which coefficients that depend on the size are evaluated
    keys:     the keys of the group in the scene, without material
    entries:  the commands that it comes from
    """

    name: str
    type: int
    density: float
    radii: tuple[float, float]
    radius: float
    keys: dict[str, Any]
    entries: tuple[Entry, ...]


@dataclass
class Points:
    """Particles at the start, one row each: id, type, radius [m], density [kg/m3], position, velocity, spin.

    fill:     number of the random fill of a particle, from 0; -1 for particles at given positions
    members:  masks (n,) of the groups of the script, which keep the particles that they have at their
              command; None for a rule that is not known
    """

    id: np.ndarray
    type: np.ndarray
    radius: np.ndarray
    density: np.ndarray
    position: np.ndarray
    motion: np.ndarray
    fill: np.ndarray
    entries: list[Entry]
    members: dict[str, np.ndarray | None]


@dataclass
class Deck:
    """What a script has said so far."""

    code: str
    interpreter: Interpreter
    report: Report
    units: str = "lj"
    boundary: tuple[str, str, str, str, str, str] = ("p", "p", "p", "p", "p", "p")
    boundary_entry: Entry | None = None
    box: tuple[float, ...] | None = None
    """Low and high of x, y and z."""
    box_entry: Entry | None = None
    types: int = 1
    dimension: int = 3
    regions: dict[str, Region] = field(default_factory=dict)
    groups: dict[str, Group] = field(default_factory=dict)
    fixes: dict[str, Fix] = field(default_factory=dict)
    """Those that act now."""
    all_fixes: list[Fix] = field(default_factory=list)
    _by_style: tuple[int, dict[str, list[tuple[int, Fix]]]] | None = None
    """The number of all fixes, and these by style with their index."""
    computes: dict[str, Entry] = field(default_factory=dict)
    time: float = 0.0
    step: int = 0
    time_step: float | None = None
    time_step_entry: Entry | None = None
    runs: list[Run] = field(default_factory=list)
    family: dict[str, Any] = field(default_factory=dict)
    """Data of the families that are no fixes, by the name of the family."""
    particles: list[ParticleGroup] = field(default_factory=list)
    readers: list["Words"] = field(default_factory=list)
    """The readers of the present command."""

    def report_unread(self, entry: Entry) -> None:
        """Report the words of a command that its handler has not read, unless it is not possible anyway."""
        unread = [words for words in self.readers if words]
        self.readers.clear()
        if unread and entry.kind != NOT_POSSIBLE:
            entry.impossible(f"{' '.join(unread[0].rest)} at the end of the line", "the line without it")

    def si(self, value: float, dimension: str) -> float:
        """A number of the script in SI units."""
        factor = 1.0
        for unit, exponent in zip(UNITS[self.units], DIMENSIONS[dimension], strict=True):
            factor *= unit**exponent
        return value * factor

    @property
    def step_here(self) -> float:
        """The time step [s] at this line: that of `timestep`, or the default of the units."""
        return self.time_step or self.si(DEFAULT_STEPS[self.units], "time")

    def own(self, name: str, make: Callable[[], Any]) -> Any:
        """The data of a family, made at the first use."""
        return self.family.setdefault(name, make()) if name not in self.family else self.family[name]

    def drop_separating_runs(self) -> None:
        """Begin here, if all runs so far have separated random particles, which become a packing."""
        separating: list[Entry] = self.own("separating", list)
        if not self.runs or any(all(run.entry is not each for each in separating) for run in self.runs):
            return
        for run in self.runs:
            run.entry.not_needed("the run separates random particles, which are placed without overlap")
        self.runs.clear()
        self.time = 0.0
        for fix in self.all_fixes:
            fix.start, fix.end = 0.0, None if fix.end is None else 0.0

    def fixes_of(self, *styles: str) -> list[Fix]:
        """All fixes of the styles, also ended ones, in the order of the script."""
        if self._by_style is None or self._by_style[0] != len(self.all_fixes):
            by_style: dict[str, list[tuple[int, Fix]]] = {}
            for index, fix in enumerate(self.all_fixes):
                by_style.setdefault(fix.style, []).append((index, fix))
            self._by_style = len(self.all_fixes), by_style
        found = [each for style in styles for each in self._by_style[1].get(style, ())]
        return [fix for _, fix in sorted(found, key=lambda each: each[0])]

    def acting(self, fix: Fix) -> list[Run]:
        """The runs in which a fix acts; they are in the order of time."""
        first = bisect_left(self.runs, fix.start, key=lambda run: run.start + run.slack)
        last = (
            None if fix.end is None else bisect_right(self.runs, fix.end, key=lambda run: run.end - run.slack)
        )
        return [run for run in self.runs[first:last] if run.steps and fix.acts_in(run)]

    def has(self, category: str, name: str) -> bool | None:
        """Whether a fix, compute, region or group exists at this line; None for other categories."""
        known: dict[str, Any] = {
            "fix": self.fixes,
            "compute": self.computes,
            "region": self.regions,
            "group": {"all", *self.groups},
        }
        return name in known[category] if category in known else None

    @property
    def end(self) -> float:
        """Time at the end of the script [s]."""
        return self.runs[-1].end if self.runs else 0.0


# Words of a command


class Words:
    """Reads the words of a command one after the other; each error names what is expected.

    Words that a handler has neither read nor skipped are reported as not possible (`Deck.readers`).
    """

    def __init__(self, deck: Deck, command: Command, words: tuple[str, ...]) -> None:
        deck.readers.append(self)
        self.deck = deck
        self.command = command
        self.words = words
        self.at = 0

    def __bool__(self) -> bool:
        return self.at < len(self.words)

    @property
    def next(self) -> str:
        """The next word without reading it; empty at the end."""
        return self.words[self.at] if self else ""

    @property
    def rest(self) -> tuple[str, ...]:
        """All words that are left, read."""
        found = self.words[self.at :]
        self.at = len(self.words)
        return found

    def rest_has(self, *given: str) -> bool:
        """Whether the words that are left contain these words one after the other."""
        left = self.words[self.at :]
        return any(left[k : k + len(given)] == given for k in range(len(left)))

    def skip(self) -> None:
        """Read all words that are left without using them."""
        self.at = len(self.words)

    def word(self, what: str) -> str:
        """The next word. Raises DeckError at the end."""
        if not self:
            raise DeckError(self.command, f"{what} is missing at the end of the command.")
        self.at += 1
        return self.words[self.at - 1]

    def number(self, what: str, dimension: str = "number") -> float:
        """The next word as a number in SI units. Raises DeckError."""
        return self.deck.si(self.plain(what), dimension)

    def plain(self, what: str, example: str = "0.5") -> float:
        """The next word as a number in the units of the script."""
        word = self.word(what)
        try:
            found = float(word)
        except ValueError:
            reason = f"{what} is {word}, which is not a number; give one, such as {example}."
            if word.startswith("v_"):
                reason = f"{what} is {word}, but it cannot change during a run; give ${{{word[2:]}}}."
            raise DeckError(self.command, reason) from None
        if not isfinite(found):
            raise DeckError(self.command, f"{what} is {word}; give a finite number.")
        if found and not SMALLEST <= abs(found) <= LARGEST:
            raise DeckError(
                self.command, f"{what} is {word}; give 0 or a magnitude from {SMALLEST:g} to {LARGEST:g}."
            )
        return found

    def positive(self, what: str, dimension: str) -> float:
        """The next word as a number above 0 in SI units."""
        found = self.number(what, dimension)
        if found <= 0.0:
            raise DeckError(self.command, f"{what} is {self.words[self.at - 1]}; give a number above 0.")
        return found

    def not_negative(self, what: str, dimension: str = "number") -> float:
        """The next word as a number from 0 in SI units."""
        found = self.number(what, dimension)
        if found < 0.0:
            raise DeckError(self.command, f"{what} is {self.words[self.at - 1]}; give 0 or a number above 0.")
        return found

    def number_or_infinite(self, what: str, dimension: str) -> float | None:
        """The next word as a number in SI units; None for INF."""
        if self.next == "INF":
            self.word(what)
            return None
        return self.number(what, dimension)

    def whole(self, what: str) -> int:
        """The next word as a whole number."""
        found = self.plain(what, "100")
        if found != int(found):
            raise DeckError(self.command, f"{what} is {found:g}; give a whole number.")
        return int(found)

    def whole_between(self, what: str, least: int = 1, most: int = LARGEST_WHOLE) -> int:
        """The next word as a whole number from `least` to `most`. Raises DeckError."""
        found = self.whole(what)
        if not least <= found <= most:
            word = self.words[self.at - 1]
            raise DeckError(self.command, f"{what} is {word}; give a whole number from {least} to {most}.")
        return found

    def type(self) -> int:
        """The next word as an atom type. Raises DeckError for one that create_box does not have."""
        found = self.whole("the type")
        if self.deck.box is not None and not 1 <= found <= self.deck.types:
            few = "only the type 1" if self.deck.types == 1 else f"the types 1 to {self.deck.types}"
            raise DeckError(self.command, f"the type is {found}, but the box is made for {few}.")
        return found

    def mesh(self) -> "Fix":
        """The next word as the name of a fix mesh/surface. Raises DeckError."""
        name = self.word("the name of a mesh")
        meshes = {key: fix for key, fix in self.deck.fixes.items() if fix.style.startswith("mesh/surface")}
        if name not in meshes:
            known = ", ".join(meshes) or "none"
            raise DeckError(self.command, f"there is no fix mesh/surface {name}. Meshes: {known}.")
        return meshes[name]

    def mesh_with_triangles(self) -> "Fix":
        """The next word as the name of a mesh whose file is read. Raises DeckError."""
        mesh = self.mesh()
        if mesh.data is None:
            raise DeckError(self.command, f"the mesh {mesh.name} is not possible, see its line.")
        return mesh

    def vector(self, what: str, dimension: str = "number") -> Vector:
        """The next three words as a vector in SI units."""
        return (self.number(what, dimension), self.number(what, dimension), self.number(what, dimension))

    def flag(self, what: str) -> bool:
        """The next word as yes or no (on or off)."""
        word = self.word(what)
        if word not in ("yes", "no", "on", "off"):
            raise DeckError(self.command, f"{what} is {word}; give yes or no.")
        return word in ("yes", "on")


# Tables of the families


@dataclass(frozen=True)
class Translation:
    """How one command or fix style is translated.

    handler:      function (deck, command, entry) for a command, (deck, fix) for a fix
    counterpart:  keys of a scene, for the table of the documentation
    note:         what differs, for the same table
    is_unneeded:  whether granflow does without it, whatever its words are
    """

    handler: Callable[..., None]
    counterpart: str
    note: str = ""
    is_unneeded: bool = False


def not_needed(reason: str) -> Translation:
    """A command or fix that granflow does without."""
    return Translation(lambda *given: entry_of(*given).not_needed(reason), "not needed", reason, True)


def impossible(reason: str, nearest: str = "") -> Translation:
    """A command or fix without counterpart."""
    return Translation(
        lambda *given: entry_of(*given).impossible(reason, nearest),
        "not possible",
        f"{reason}; nearest: {nearest}" if nearest else reason,
    )


ACCELERATED = ("omp", "kk", "kk/host", "kk/device", "gpu", "intel", "opt")
"""Ends of the names of styles that are computed in another way, with the same result."""


def plain_style(style: str, known: Container[str]) -> str:
    """The name of a style without the variant for an accelerator, such as nve/sphere of nve/sphere/kk."""
    for end in ACCELERATED:
        if style.endswith(f"/{end}") and style.removesuffix(f"/{end}") in known:
            return style.removesuffix(f"/{end}")
    return style


def entry_of(*given: Any) -> Entry:
    """The entry of the arguments of a handler."""
    last = given[-1]
    return last.entry if isinstance(last, Fix) else last
