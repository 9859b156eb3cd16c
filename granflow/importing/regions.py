"""Regions of a script: blocks, cylinders, cones, spheres and planes; where they are at each time."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import hypot, inf, isnan, nan

import numpy as np

from granflow.importing.deck import Deck, Region, Run, Translation, Vector, Words
from granflow.importing.language import Command, DeckError, NotKnown
from granflow.importing.report import Entry

NUMBERS: dict[str, tuple[str, ...]] = {
    "block": ("xlo", "xhi", "ylo", "yhi", "zlo", "zhi"),
    "cylinder": ("c1", "c2", "radius", "lo", "hi"),
    "cone": ("c1", "c2", "radlo", "radhi", "lo", "hi"),
    "sphere": ("x", "y", "z", "radius"),
    "plane": ("px", "py", "pz", "nx", "ny", "nz"),
    "prism": ("xlo", "xhi", "ylo", "yhi", "zlo", "zhi", "xy", "xz", "yz"),
    "ellipsoid": ("x", "y", "z", "a", "b", "c"),
}
"""Numbers of a region by its style."""
KEYWORDS = {"side": 1, "units": 1, "open": 1, "move": 3, "rotate": 7, "seed": 1, "volume_limit": 1}
"""Keywords of regions with the number of their words."""
FEWEST_SAMPLES, MOST_SAMPLES = 64, 4096
"""Number of times in a run at which a variable of a motion is evaluated."""
LINEAR = 1e-4
"""Largest difference from a linear course, over its range, at which samples are close enough."""


# Motions of regions and meshes that follow variables


@dataclass
class Track:
    """The values of some variables over time, run by run.

    names:    names of the variables; empty for one that is 0
    samples:  for each run its times [s] from its start and values (n, len(names)), in the units of the script
    """

    names: tuple[str, ...]
    entry: Entry
    samples: list[tuple[Run, np.ndarray, np.ndarray]] = field(default_factory=list)
    failed: bool = False

    def sample(self, deck: Deck, run: Run) -> None:
        """Evaluate the variables during a run, which has just been read."""
        if self.failed or not run.steps:
            return
        count = FEWEST_SAMPLES
        try:
            while True:
                steps = np.unique(np.linspace(0, run.steps, count + 1).round())
                values = np.array([[self._value(deck, run, name, s) for name in self.names] for s in steps])
                share = ((steps[1:-1] - steps[:-2]) / (steps[2:] - steps[:-2]))[:, None]
                middle = values[1:-1] - values[:-2] - share * (values[2:] - values[:-2])
                coarse = np.abs(middle).max(initial=0.0) > LINEAR * max(np.ptp(values, axis=0).max(), 1e-300)
                if not coarse or count >= MOST_SAMPLES or len(steps) < count:
                    break
                count *= 4
        except NotKnown as error:
            self.failed = True
            self.entry.impossible(
                f"a motion by variables that follow the simulation ({error})", "a motion that time determines"
            )
            return
        self.samples.append((run, steps * run.time_step, values))

    @staticmethod
    def _value(deck: Deck, run: Run, name: str, step: float) -> float:
        if not name:
            return 0.0
        facts = {
            "step": run.first_step + step,
            "elapsed": step,
            "elaplong": step,
            "run_steps": float(run.steps),
            "time": deck.interpreter.facts["time"] + step * deck.interpreter.facts.get("dt", 0.005),
        }
        return deck.interpreter.value_at(name, **facts)

    def over(self, runs: list[Run], continuous: Sequence[int] = ()) -> tuple[np.ndarray, np.ndarray]:
        """Times [s] and values of some runs, one after the other; those of the variables with the numbers
        `continuous` continue at the beginning of a run from the end of the one before."""
        chosen = [
            (run.start + times, values)
            for run in runs
            for sampled, times, values in self.samples
            if sampled.entry is run.entry and sampled.first_step == run.first_step
        ]
        if not chosen:
            return np.zeros(0), np.zeros((0, len(self.names)))
        parts: list[np.ndarray] = []
        for _, values in chosen:
            moved = values.copy()
            for k in continuous if parts else ():
                moved[:, k] += parts[-1][-1, k] - values[0, k]
            parts.append(moved)
        return np.concatenate([t for t, _ in chosen]), np.concatenate(parts)


@dataclass
class RegionMotion:
    """Motion of a region: displacements along x, y and z, and a rotation about an axis.

    track:  the variables of dx, dy, dz and of the angle
    """

    track: Track
    point: Vector = (0.0, 0.0, 0.0)
    axis: Vector = (0.0, 0.0, 1.0)
    is_symmetric: bool = False
    """Whether the rotation does not change the surface, as that of a cylinder about itself: its angle may
    jump, for example with `elapsed`, which begins at 0 in each run."""

    def over(self, runs: list[Run]) -> tuple[np.ndarray, np.ndarray]:
        """Times [s] and values (n, 4) of the track; the angle of a surface of revolution does not jump."""
        return self.track.over(runs, (3,) if self.is_symmetric else ())


def variable_name(command: Command, word: str) -> str:
    """The name in v_NAME; empty for NULL. Raises DeckError."""
    if word == "NULL":
        return ""
    if not word.startswith("v_"):
        raise DeckError(command, f"{word} is not a variable; give v_NAME, or NULL for no motion.")
    return word[2:]


def track_variables(deck: Deck, track: Track, is_used: Callable[[], bool]) -> None:
    """Evaluate the variables of a track in all runs that follow, while `is_used` is true."""

    def sample(deck: Deck, run: Run) -> None:
        if is_used():
            track.sample(deck, run)

    deck.own("at_run", list).append(sample)


# The command region


def region(deck: Deck, command: Command, entry: Entry) -> None:
    """region ID STYLE NUMBERS KEYWORDS | region ID delete"""
    words = Words(deck, command, command.words)
    name = words.word("the name of the region")
    style = words.word("the style of the region")
    _note_change(deck, name)
    if style == "delete":
        deck.regions.pop(name, None)
        entry.not_needed("walls and insertions keep the region they have used")
        return
    axis = ""
    numbers: tuple[float, ...] = ()
    parts: tuple[str, ...] = ()
    if style in ("union", "intersect"):
        count = words.whole("the number of regions")
        parts = tuple(region_of(deck, command, words.word("a region")).name for _ in range(count))
    elif style == "wedge":
        axis, numbers = _wedge(words)
        entry.impossible("regions of the style wedge", "a cylinder, which --partial takes")
        style = "cylinder"
    elif style in ("mesh/tet", "mesh/hex", "mesh"):
        entry.impossible(f"regions of the style {style}", "a block; --partial takes the whole box")
        while words and words.next not in ("side", "units"):
            words.word("a value")
        style, numbers = "block", (-inf, inf) * 3
    elif style in NUMBERS:
        if style in ("cylinder", "cone"):
            axis = words.word("the axis")
            if axis not in ("x", "y", "z"):
                raise DeckError(command, f"the axis is {axis}; give x, y or z.")
        numbers = tuple(_bound(words, each, entry) for each in NUMBERS[style])
    else:
        raise DeckError(command, f"there is no region style {style}; there are {', '.join(NUMBERS)}.")
    found = Region(name, style, axis, numbers, entry, parts, start=deck.time)
    _read_keywords(deck, words, found)
    if style == "prism":
        _as_block(found)
    elif style == "ellipsoid":
        x, y, z, a, b, c = found.numbers
        found.kind, found.numbers = "block", (x - a, x + a, y - b, y + b, z - c, z + c)
        entry.impossible("regions of the style ellipsoid", "a sphere; --partial takes the block around it")
    _refuse_empty(command, found)
    deck.regions[name] = found
    deck.own("all_regions", list).append(found)


def _note_change(deck: Deck, name: str) -> None:
    """A region of a wall that changes between two runs begins a new stage."""
    if name in deck.regions and any(fix.style == "wall/gran/region" for fix in deck.fixes.values()):
        deck.own("changes", set).add(deck.time)


def _read_keywords(deck: Deck, words: Words, found: Region) -> None:
    """Read side, units, open, move and rotate."""
    command, entry = words.command, found.entry
    opened: list[int] = []
    in_box_units = False
    moves: tuple[str, ...] = ("", "", "")
    rotation: list[str] = []
    while words:
        key = words.word("a keyword")
        if key not in KEYWORDS:
            raise DeckError(command, f"regions have no keyword {key}. Keywords: {', '.join(KEYWORDS)}.")
        values = [words.word(f"a value of {key}") for _ in range(KEYWORDS[key])]
        if key == "side":
            if values[0] not in ("in", "out"):
                raise DeckError(command, f"side is {values[0]}; give in or out.")
            found.inside = values[0] == "in"
        elif key == "units":
            in_box_units = values[0] == "box"
        elif key == "open":
            opened.append(int(values[0]))
        elif key == "move":
            moves = tuple(variable_name(command, each) for each in values)
        elif key == "rotate":
            rotation = values
    found.open = tuple(opened)
    spacing = 1.0 if in_box_units else lattice_spacing(deck, command)
    if spacing != 1.0:
        lengths = 3 if found.kind == "plane" else len(found.numbers)
        found.numbers = tuple(v * (spacing if k < lengths else 1.0) for k, v in enumerate(found.numbers))
    if any(moves) or rotation:
        turn = variable_name(command, rotation[0]) if rotation else ""
        motion = RegionMotion(Track((*moves, turn), entry))
        if rotation:
            numbers = Words(deck, command, tuple(rotation[1:]))
            x, y, z = numbers.vector("the point of the axis", "length")
            motion.point = (x * spacing, y * spacing, z * spacing)
            motion.axis = numbers.vector("the axis")
            length = hypot(*motion.axis)
            if length == 0.0:
                raise DeckError(command, "the axis is zero; give a direction, such as 0 0 1.")
            if abs(length - 1.0) > 1e-3 and deck.code == "lammps":
                entry.approximated(
                    f"walls of LAMMPS drag particles {length:.3g} times as fast as they turn, by the length "
                    "of the axis; here as fast as they turn"
                )
        found.motion = motion
        track_variables(deck, motion.track, lambda: deck.regions.get(found.name) is found)


def _as_block(found: Region) -> None:
    """A prism without tilt is a block; otherwise the block around it is taken."""
    tilts = found.numbers[6:]
    found.kind, found.numbers = "block", found.numbers[:6]
    if any(tilts):
        xy, xz, yz = tilts
        n = list(found.numbers)
        for low, tilt in ((0, xy), (0, xz), (2, yz)):
            n[low + (tilt > 0)] += tilt
        found.numbers = tuple(n)
        found.entry.impossible("a tilted prism", "a block; --partial takes the one around it")


def _refuse_empty(command: Command, found: Region) -> None:
    """Raise DeckError for a block, cylinder or cone without volume, and for a radius below 0."""
    n = found.numbers
    ends = {"block": (0, 2, 4), "cylinder": (3,), "cone": (4,)}.get(found.kind, ())
    for k in ends:
        if n[k] >= n[k + 1]:
            raise DeckError(
                command,
                f"the region {found.name} ends at {n[k + 1]:g} and begins at {n[k]:g}; exchange them.",
            )
    radii = {"cylinder": n[2:3], "cone": n[2:4], "sphere": n[3:4]}.get(found.kind, ())
    if radii and (min(radii) < 0.0 or max(radii) == 0.0):
        raise DeckError(command, f"the radius is {min(radii):g}; give a number above 0.")


def _wedge(words: Words) -> tuple[str, tuple[float, ...]]:
    """The axis and the cylinder of a wedge: axis A center C1 C2 radius R bounds LO HI angle0 A angle B."""
    axis = ""
    given: dict[str, tuple[float, ...]] = {}
    counts = {"center": 2, "radius": 1, "bounds": 2, "angle0": 1, "angle": 1}
    while words and words.next in ("axis", *counts):
        key = words.word("a keyword")
        if key == "axis":
            axis = words.word("the axis")
        else:
            given[key] = tuple(words.number(key, "length") for _ in range(counts[key]))
    if axis not in ("x", "y", "z") or not {"center", "radius", "bounds"} <= set(given):
        raise DeckError(words.command, "a wedge has axis, center, radius, bounds, angle0 and angle.")
    center = given["center"][::-1] if axis == "y" else given["center"]
    return axis, (*center, *given["radius"], *given["bounds"])


def _bound(words: Words, what: str, entry: Entry) -> float:
    """A coordinate; INF is infinite, EDGE not a number."""
    if words.next == "EDGE":
        words.word(what)
        return nan
    if words.next in ("-INF", "INF", "+INF"):
        return -inf if words.word(what) == "-INF" or what.endswith("lo") else inf
    if words.next.startswith("v_"):
        name = words.word(what)[2:]
        entry.impossible(f"a region whose {what} is the variable {name}", "the value at this line")
        try:
            return words.deck.si(words.deck.interpreter.value_at(name), "length")
        except NotKnown as error:
            raise DeckError(words.command, f"{what} has no value: {error}.") from None
    is_direction = what in ("nx", "ny", "nz")
    return words.number(what, "number" if is_direction else "length")


def region_of(deck: Deck, command: Command, name: str) -> Region:
    """A region by its name. Raises DeckError."""
    if name not in deck.regions:
        raise DeckError(command, f"there is no region {name}. Regions: {', '.join(deck.regions) or 'none'}.")
    return deck.regions[name]


def region_at(deck: Deck, name: str, time: float) -> Region | None:
    """The region that has a name at a time [s]: the newest that was defined until then."""
    regions: list[Region] = deck.own("all_regions", list)
    slack = 1e-3 * (deck.time_step or 0.0)
    return next(
        (each for each in reversed(regions) if each.name == name and each.start <= time + slack), None
    )


UNBOUNDED = (-inf, inf) * 3
"""A box in which sides of regions at its edges are nowhere."""


def contains(deck: Deck, region: Region, points: np.ndarray) -> np.ndarray:
    """Whether points (n, 3) [m] are in a region; its sides at edges of the box are there."""
    return in_region(region, points, deck.regions, deck.box or UNBOUNDED)


def in_region(
    region: Region, points: np.ndarray, regions: Mapping[str, Region], box: Sequence[float]
) -> np.ndarray:
    """Whether points (n, 3) [m] are in a region.

    regions:  the parts of unions and intersections by name
    box:      x_low, x_high, y_low, ... [m] for sides at edges of the box
    """
    parts = [in_region(regions[name], points, regions, box) for name in region.parts]
    if region.kind == "union":
        found = np.any(parts, axis=0)
    elif region.kind == "intersect":
        found = np.all(parts, axis=0)
    else:
        found = _in_shape(region, points, box)
    return found if region.inside else ~found


def _in_shape(region: Region, points: np.ndarray, box: Sequence[float]) -> np.ndarray:
    """Whether points (n, 3) [m] are in a block, cylinder, cone, sphere or half space."""
    n = region.numbers
    if region.kind == "block":
        low_high = np.array([box[k] if each != each else each for k, each in enumerate(n)])
        return np.asarray(((points >= low_high[::2]) & (points <= low_high[1::2])).all(axis=1))
    if region.kind == "sphere":
        return np.asarray(((points - n[:3]) ** 2).sum(axis=1) <= n[3] ** 2)
    if region.kind == "plane":
        return np.asarray((points - n[:3]) @ np.array(n[3:]) >= 0.0)
    axis = "xyz".index(region.axis)
    across = [k for k in range(3) if k != axis]
    low, high = (box[2 * axis + k] if each != each else each for k, each in enumerate(n[-2:]))
    along = points[:, axis]
    radius = n[2] if region.kind == "cylinder" else n[2] + (n[3] - n[2]) * (along - low) / (high - low)
    distance = np.hypot(points[:, across[0]] - n[0], points[:, across[1]] - n[1])
    return np.asarray((distance <= radius) & (along >= low) & (along <= high))


# Lattices and groups

_FACES = ((0.0, 0.0, 0.0), (0.5, 0.5, 0.0), (0.5, 0.0, 0.5), (0.0, 0.5, 0.5))

BASIS: dict[str, tuple[Vector, ...]] = {
    "none": (),
    "sc": ((0.0, 0.0, 0.0),),
    "bcc": ((0.0, 0.0, 0.0), (0.5, 0.5, 0.5)),
    "fcc": _FACES,
    "diamond": (*_FACES, *((x + 0.25, y + 0.25, z + 0.25) for x, y, z in _FACES)),
}
"""Positions of the particles in the cell of a lattice, in cells."""


@dataclass(frozen=True)
class Lattice:
    """A lattice in the units of the script.

    cell:    edges of the unit cell as rows (3, 3)
    basis:   positions (n, 3) of the particles in cells
    origin:  position (3,) of the first cell
    """

    cell: np.ndarray
    basis: np.ndarray
    origin: np.ndarray


def lattice(deck: Deck, command: Command, entry: Entry) -> None:
    """lattice STYLE SCALE [a1 X Y Z] [a2 ..] [a3 ..] [basis X Y Z] [origin X Y Z]: the places of particles,
    and the unit of lengths of regions with `units lattice`.

    The scale multiplies the cell; in units lj it is the number of particles per volume.
    """
    words = Words(deck, command, command.words)
    style = words.word("the style of the lattice")
    scale = words.positive("the scale", "number")
    if style not in BASIS and style != "custom":
        entry.impossible(f"the lattice {style}", f"one of {', '.join(BASIS)} and custom, or units box")
        words.skip()
        return
    cell: np.ndarray = np.eye(3)
    origin: np.ndarray = np.zeros(3)
    basis = list(BASIS.get(style, ()))
    while words:
        key = words.word("a keyword")
        if key in ("a1", "a2", "a3") and style == "custom":
            cell[int(key[1]) - 1] = words.vector(key)
        elif key == "basis" and style == "custom":
            basis.append(words.vector(key))
        elif key == "origin":
            origin = np.array(words.vector(key))
        else:
            entry.impossible(f"the keyword {key} of a lattice", "a1, a2, a3, basis and origin")
            words.skip()
    volume = abs(float(np.linalg.det(cell)))
    if volume == 0.0:
        raise DeckError(
            command, "the cell of the lattice has no volume; give three directions a1, a2 and a3."
        )
    if deck.units == "lj" and style != "none":
        scale = (len(basis) / volume / scale) ** (1.0 / 3.0)
    cell *= scale
    spacing = np.abs(cell).sum(axis=0)
    deck.family["lattice_cell"] = Lattice(cell, np.array(basis).reshape(-1, 3), origin * spacing)
    deck.family["lattice"] = float(spacing[0]) if np.ptp(spacing) <= 1e-12 * spacing[0] else nan
    entry.not_needed("lengths are converted")


def lattice_spacing(deck: Deck, command: Command) -> float:
    """The unit of lengths without `units box`. Raises DeckError for a lattice with another one along each
    axis."""
    spacing = float(deck.family.get("lattice", 1.0))
    if isnan(spacing):
        raise DeckError(command, "the lattice has other lengths along x, y and z; give units box.")
    return spacing


# Tables

COMMANDS: dict[str, Translation] = {
    "region": Translation(
        region, "walls, insert.region", "block, cylinder, cone, sphere, plane, union, intersect"
    ),
    "lattice": Translation(lattice, "not needed", "none, sc, bcc, fcc, diamond, custom"),
}
FIXES: dict[str, Translation] = {}
