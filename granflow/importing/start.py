"""Particles of a script that are there at its start: read_data and create_atoms.

Their positions become tables beside the scene. Random fills of a region whose particles overlap, which
scripts separate before the simulation proper, become packings without overlap.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from granflow.geometry.close_pairs import near_pairs
from granflow.geometry.periodic_box import PeriodicBox
from granflow.importing.deck import (
    LARGEST,
    Deck,
    ParticleGroup,
    Points,
    Region,
    Translation,
    Words,
    entry_of,
    impossible,
)
from granflow.importing.groups import carried_points, fixed_points
from granflow.importing.insertion import extent_of, scene_region
from granflow.importing.language import Command, DeckError
from granflow.importing.regions import Lattice, contains, lattice_spacing, region_of
from granflow.importing.report import Entry
from granflow.importing.scene_text import Draft, quantities, quantity

MOST_CELLS = 1_000_000
"""Number of cells of a lattice above which its scale is taken to be wrong."""
MOST_DRAWS = 1000
"""Number of draws of random points after which a region is taken to be empty."""
TOUCHING = 0.01
"""Overlap over the smaller radius from which random particles are packed without overlap."""
MOST_CLASSES = 12
"""Number of diameters of a random fill that become classes; more are joined to classes of equal counts."""


@dataclass
class Fill:
    """One `create_atoms random`: its region, None for the box."""

    region: Region | None
    entry: Entry


LATER = "particles at given positions that appear after the first run"
NEAREST_LATER = "particles at the start, or an insertion (insert: {kind: rain}) with a start"

# Commands


def read_data(deck: Deck, command: Command, entry: Entry) -> None:
    """read_data FILE: box and particles (atom_style sphere or granular)."""
    words = Words(deck, command, command.words)
    path = deck.family["folder"] / words.word("the file")
    if words:
        entry.impossible(f"the keyword {words.next} of read_data", "one file with all particles")
    if deck.time > 0.0:
        entry.impossible(LATER, NEAREST_LATER)
        return
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise DeckError(command, f"{path} cannot be read: {error.strerror}.") from None
    box = [0.0] * 6
    section, rows, velocities = "", [], {}

    def floats(words: list[str]) -> list[float]:
        """Words of a row as numbers. Raises DeckError."""
        try:
            found = [float(each) for each in words]
        except ValueError:
            raise DeckError(
                command,
                f"{path.name}:{number}: {' '.join(words)} has a word that is not a number.",
            ) from None
        if not all(abs(each) <= LARGEST for each in found):  # nan as well
            raise DeckError(
                command,
                f"{path.name}:{number}: {' '.join(words)} has a number that is not below {LARGEST:g}.",
            )
        return found

    for number, raw in enumerate(lines[1:], 2):
        parts = raw.split("#")[0].split()
        if not parts:
            continue
        if parts[0][0].isalpha():
            section = parts[0]
            if section not in ("Atoms", "Velocities"):
                entry.impossible(f"the section {section} of {path.name}", "Atoms and Velocities")
        elif parts[-2:] in (["xlo", "xhi"], ["ylo", "yhi"], ["zlo", "zhi"]):
            k = 2 * "xyz".index(parts[-1][0])
            box[k], box[k + 1] = (deck.si(each, "length") for each in floats(parts[:2]))
        elif parts[-3:] == ["xy", "xz", "yz"]:
            if any(floats(parts[:3])):
                entry.impossible("a tilted box", "a box of right angles, or domain.lees_edwards for shear")
        elif len(parts) >= 3 and parts[-2:] == ["atom", "types"]:
            deck.types = int(floats(parts[:1])[0])
        elif section == "Atoms":
            if len(parts) < 7:
                raise DeckError(command, f"{path.name}:{number}: an atom has id type diameter density x y z.")
            rows.append(floats(parts[:7]))
            if min(rows[-1][2:4]) <= 0.0:
                raise DeckError(
                    command,
                    f"{path.name}:{number}: diameter and density are {parts[2]} and {parts[3]}; give numbers "
                    "above 0.",
                )
        elif section == "Velocities":
            velocities[int(floats(parts[:1])[0])] = floats(parts[1:7])
    deck.box, deck.box_entry = tuple(box), entry
    if not rows:
        return
    unit = {name: deck.si(1.0, name) for name in ("length", "density", "velocity", "angular_velocity")}
    table = np.array(rows)
    table[:, 2] *= unit["length"]
    table[:, 3] *= unit["density"]
    table[:, 4:7] *= unit["length"]
    motion = np.array([velocities.get(int(row[0]), [0.0] * 6) + [0.0] * 6 for row in rows])[:, :6]
    motion[:, :3] *= unit["velocity"]
    motion[:, 3:] *= unit["angular_velocity"]
    given = (table[:, 1], table[:, 2] / 2.0, table[:, 3], table[:, 4:7], motion)
    _add_points(deck, *given, entry, id=table[:, 0])


def _add_points(
    deck: Deck,
    type: Any,
    radius: Any,
    density: Any,
    position: Any,
    motion: Any,
    entry: Entry,
    fill: int = -1,
    id: Any = None,
) -> None:
    """Add particles at given positions, or those of a random fill; they are members of no group so far."""
    found: Points | None = deck.family.get("points")
    count = len(type)
    id = np.arange(count) + (1 if found is None else found.id.max(initial=0) + 1) if id is None else id
    added = {
        "id": np.array(id, int),
        "type": np.array(type, int),
        "radius": np.array(radius, float),
        "density": np.array(density, float),
        "position": np.array(position, float),
        "motion": np.array(motion, float),
        "fill": np.full(count, fill),
    }
    outside = np.zeros(count, bool)
    if found is None:
        known = {name: None if each.rule == "dynamic" else outside for name, each in deck.groups.items()}
        deck.family["points"] = Points(**added, entries=[entry], members=known)
        return
    for name, value in added.items():
        setattr(found, name, np.concatenate([getattr(found, name), value]))
    found.members = {
        name: None if mask is None else np.concatenate([mask, outside])
        for name, mask in found.members.items()
    }
    found.entries.append(entry)


def create_atoms(deck: Deck, command: Command, entry: Entry) -> None:
    """create_atoms TYPE single X Y Z | random N SEED REGION | region ID | box [units box|lattice]"""
    words = Words(deck, command, command.words)
    type = words.type()
    style = words.word("the style")
    if deck.time > 0.0:
        words.skip()
        entry.impossible(LATER, NEAREST_LATER)
        return
    spacing = 1.0 if words.rest_has("units", "box") or style != "single" else lattice_spacing(deck, command)
    fill = -1
    if style == "single":
        place = words.vector("the position", "length")
        points = spacing * np.array([place])
    elif style == "random":
        count = words.whole_between("the number", 0)
        random = np.random.default_rng(words.whole_between("the seed"))
        name = words.word("the name of a region")
        points = _random_points(deck, command, random, count, name)
        fills: list[Fill] = deck.own("fills", list)
        fill = len(fills)
        fills.append(Fill(None if name == "NULL" else region_of(deck, command, name), entry))
    elif style in ("region", "box"):
        region = region_of(deck, command, words.word("the name of a region")) if style == "region" else None
        points = lattice_points(deck, command, region)
        if region is not None:
            points = points[contains(deck, region, points)]
            region.entry.translated("particles")
    else:
        entry.impossible(f"create_atoms {style}", "insert: {kind: lattice, region: ...}")
        return
    while words:
        key = words.word("a keyword")
        if key in ("overlap", "maxtry"):  # kind: pack places particles without overlap
            words.number(key)
        elif key != "units":
            entry.impossible(f"the keyword {key} of create_atoms", "particles of a file: read_data")
            words.skip()
        elif words.word("box or lattice") not in ("box", "lattice"):
            raise DeckError(command, "units is box or lattice.")
    count = len(points)
    ones = np.ones(count)
    radius, density = 0.5 * deck.si(1.0, "length"), deck.si(1.0, "density")
    given = (type * ones, radius * ones, density * ones, points, np.zeros((count, 6)))
    _add_points(deck, *given, entry, fill)


def lattice_points(deck: Deck, command: Command, region: Region | None) -> np.ndarray:
    """The points (n, 3) [m] of the lattice in the box, without those on its upper faces; those far from a
    region are left out. Raises DeckError."""
    lattice: Lattice | None = deck.family.get("lattice_cell")
    if lattice is None or not len(lattice.basis) or deck.box is None:
        raise DeckError(
            command, "particles on a lattice need create_box and a lattice, such as lattice sc 0.001."
        )
    unit = deck.si(1.0, "length")
    low, high = np.array(deck.box[::2]), np.array(deck.box[1::2])
    around: np.ndarray = np.array(
        extent_of(deck, region) if region and region.inside and not region.parts else deck.box
    ).reshape(3, 2)
    around = np.clip(around, low[:, None], high[:, None])
    ends = np.stack(np.meshgrid(*around, indexing="ij"), axis=-1).reshape(-1, 3)
    places = np.linalg.solve(unit * lattice.cell.T, (ends - unit * lattice.origin).T)
    lowest, highest = np.floor(places.min(axis=1)) - 1, np.ceil(places.max(axis=1)) + 1
    if np.prod(highest - lowest) > MOST_CELLS:
        raise DeckError(command, f"the lattice has more than {MOST_CELLS} cells in the box; check its scale.")
    cells = [np.arange(a, b) for a, b in zip(lowest, highest, strict=True)]
    corners = np.stack(np.meshgrid(*cells, indexing="ij"), axis=-1).reshape(-1, 1, 3)
    points = unit * (lattice.origin + ((corners + lattice.basis) @ lattice.cell).reshape(-1, 3))
    slack = 1e-6 * (high - low)
    return np.asarray(points[((points >= low - slack) & (points < high - slack)).all(axis=1)])


def _random_points(
    deck: Deck, command: Command, random: np.random.Generator, count: int, name: str
) -> np.ndarray:
    """Random points (count, 3) [m] in a region, or in the box for NULL. Raises DeckError."""
    region = None if name == "NULL" else region_of(deck, command, name)
    extent = (deck.box or (0.0,) * 6) if region is None else extent_of(deck, region)
    found = np.zeros((0, 3))
    for _ in range(MOST_DRAWS):
        points = random.uniform(extent[::2], extent[1::2], (count, 3))
        found = np.concatenate([found, points if region is None else points[contains(deck, region, points)]])
        if len(found) >= count:
            return found[:count]
    raise DeckError(command, f"the region {name} has no volume inside the box.")


# The groups


def relaxation(what: str, nearest: str) -> Translation:
    """A command or fix that separates overlapping particles."""

    def told(*given: Any) -> None:
        given[0].own("relaxations", list).append((entry_of(*given), what, nearest))

    note = "not needed after create_atoms random, which becomes kind: pack"
    return Translation(told, "not possible", f"{note}; otherwise nearest: {nearest}")


def add_points(deck: Deck, draft: Draft) -> None:
    """The groups of particles at given positions, and of random fills."""
    points: Points | None = deck.family.get("points")
    found = None if points is None or not len(points.type) else points
    packed = set() if found is None else _overlapping_fills(deck, found)
    rest = None if found is None else found.position[~np.isin(found.fill, [*packed])]
    if found is not None and rest is not None:
        held = fixed_points(deck, found)
        carried = carried_points(deck, found, held)
        in_tables = ~np.isin(found.fill, [*packed])
        for fix, *_ in deck.own("carriers", dict).values():
            if (carried[~in_tables] != "").any():
                fix.entry.impossible("random particles that overlap and are moved", "insert: {kind: file}")
        if packed:
            _add_fills(deck, found, held, packed)
        if len(rest):
            _add_tables(deck, draft, found, held, carried, in_tables)
    for number, fill in enumerate(deck.own("fills", list)):
        fill.entry.approximated(
            "the positions overlap and are replaced by those of kind: pack, without overlap"
            if number in packed
            else "random positions differ from those of the code"
        )
    for entry, what, nearest in deck.own("relaxations", list):
        if found is not None and (found.fill >= 0).any():
            entry.not_needed("the random particles are placed without overlap")
        else:
            entry.impossible(what, nearest)


def _overlapping_fills(deck: Deck, points: Points) -> set[int]:
    """Numbers of the random fills of which a particle overlaps with another one."""
    if not (points.fill >= 0).any():
        return set()
    assert deck.box is not None
    low, high = np.array(deck.box[::2]), np.array(deck.box[1::2])
    box = PeriodicBox(tuple(k for k in range(3) if deck.boundary[2 * k] == "p"), low, high - low)
    position, radius, owner = box.images(box.wrap(points.position), points.radius)
    first, second = near_pairs(position, radius, 0.0)
    depth = radius[first] + radius[second] - np.linalg.norm(position[first] - position[second], axis=1)
    above = depth > TOUCHING * np.minimum(radius[first], radius[second])
    involved = points.fill[owner[np.concatenate([first[above], second[above]])]]
    return {int(each) for each in involved if each >= 0}


def _add_fills(deck: Deck, points: Points, held: np.ndarray, packed: set[int]) -> None:
    """Packings in place of random fills that overlap, one for each type and density."""
    fills: list[Fill] = deck.own("fills", list)
    rows_of = (points.fill, points.type, points.density, held)
    for number, type, density, is_held in sorted(set(zip(*(each.tolist() for each in rows_of), strict=True))):
        if number not in packed:
            continue
        rows = np.all(
            [a == b for a, b in zip(rows_of, (number, type, density, is_held), strict=True)], axis=0
        )
        radius, motion = points.radius[rows], points.motion[rows]
        fill = fills[number]
        smallest, largest = float(radius.min()), float(radius.max())
        if fill.region is None:
            box = np.array(deck.box)
            ends = {
                "min": quantities(box[::2].tolist(), "length"),
                "max": quantities(box[1::2].tolist(), "length"),
            }
            region: dict[str, Any] = {"box": ends}
        else:
            region = scene_region(deck, fill.region, fill.entry, smallest)
            fill.region.entry.translated("particles.NAME.insert.region")
        keys: dict[str, Any] = {
            "count": int(rows.sum()),
            "diameter": _diameters(radius),
            "insert": {"kind": "pack", "region": region},
        }
        mean = motion.mean(axis=0)
        random = np.sqrt(((motion - mean)[:, :3] ** 2).sum() / len(motion))
        if is_held:
            keys["fixed"] = True
        else:
            if np.abs(mean[:3]).max() > 1e-9 * random:
                keys["velocity"] = quantities(mean[:3].tolist(), "velocity")
            if np.abs(mean[3:]).max():
                keys["angular_velocity"] = mean[3:].tolist()
            if random > 1e-9 * np.linalg.norm(mean[:3]):
                keys["thermal"] = {"velocity_rms": quantity(float(f"{random:.6g}"), "velocity")}
        name = f"fill_{number + 1}_type{type}"
        name = name if len(set(points.density[points.type == type].tolist())) == 1 else f"{name}_{density:g}"
        sort = (type, density, (smallest, largest), _mean_radius(radius))
        deck.particles.append(ParticleGroup(name, *sort, keys, tuple(points.entries)))


def _mean_radius(radius: np.ndarray) -> float:
    """Mean radius [m] by mass of particles of one density."""
    return float((radius**4).sum() / (radius**3).sum())


def _diameters(radius: np.ndarray) -> Any:
    """The key diameter of particles with some radii (n,) [m]: one, classes, or classes of equal counts."""
    values, counts = np.unique(radius, return_counts=True)
    if len(values) == 1:
        return quantity(2.0 * float(values[0]), "length")
    if len(values) > MOST_CLASSES:
        parts = np.array_split(np.sort(radius), MOST_CLASSES)
        values = np.array([np.cbrt((each**3).mean()) for each in parts])
        counts = np.array([len(each) for each in parts])
    classes = [
        {"diameter": quantity(float(f"{2.0 * r:.9g}"), "length"), "fraction": round(n / len(radius), 9)}
        for r, n in zip(values.tolist(), counts.tolist(), strict=True)
    ]
    return {"distribution": "classes", "by": "number", "classes": classes}


def _add_tables(
    deck: Deck, draft: Draft, points: Points, held: np.ndarray, carried: np.ndarray, chosen: np.ndarray
) -> None:
    """The groups of particles at given positions: one table, one group for each type, density and motion."""
    columns = [each[chosen].tolist() for each in (points.type, points.density, held, carried)]
    kinds = sorted(set(zip(*columns, strict=True)))
    for type, density, is_held, wall in kinds:
        rows = chosen & (points.type == type) & (points.density == density) & (held == is_held)
        rows &= carried == wall
        name = (
            f"type{type}"
            if len({t for t, *_ in kinds}) == len({(t, d) for t, d, *_ in kinds})
            else f"type{type}_{density:g}".replace(".", "_")
        )
        name += f"_{wall}" if wall else "_fixed" if is_held else ""
        table = [points.position[rows], points.radius[rows, None]]
        heads = ["x", "y", "z", "r"]
        if points.motion[rows].any() and not is_held:
            table.append(points.motion[rows])
            heads += ["vx", "vy", "vz", "wx", "wy", "wz"]
        lines = [",".join(heads)] + [",".join(f"{v:.15g}" for v in row) for row in np.hstack(table)]
        file = draft.add_file(f"{name}.csv", ("\n".join(lines) + "\n").encode())
        radii = (float(points.radius[rows].min()), float(points.radius[rows].max()))
        keys: dict[str, Any] = {"insert": {"kind": "file", "file": file}}
        if is_held:
            keys["fixed"] = {"to": wall} if wall else True
        deck.particles.append(
            ParticleGroup(
                f"start_{name}",
                type,
                density,
                radii,
                _mean_radius(points.radius[rows]),
                keys,
                tuple(points.entries),
            )
        )


# Tables

COMMANDS: dict[str, Translation] = {
    "read_data": Translation(
        read_data, "particles.NAME.insert (kind: file)", "atom_style sphere or granular"
    ),
    "create_atoms": Translation(
        create_atoms,
        "particles.NAME.insert (kind: file, pack)",
        "single, region, box; random: a packing if its particles overlap",
    ),
    "minimize": relaxation("minimize", "a stage with damping: {cundall: 0.5}"),
    "displace_atoms": impossible("displacement of particles", "other positions in the table"),
}
FIXES: dict[str, Translation] = {
    "nve/limit": relaxation("a limit of the displacement", "kind: pack, which inserts without overlap"),
}
