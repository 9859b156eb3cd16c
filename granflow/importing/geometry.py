"""Box and walls of a script: boundaries, fix wall/gran and wall/gran/region."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import pi
from typing import Any

import numpy as np

from granflow.importing import deformation, meshes, region_walls
from granflow.importing.deck import MOST_TYPES, Deck, Fix, Run, Translation, Words, impossible
from granflow.importing.heat import wall_temperature
from granflow.importing.language import Command, DeckError
from granflow.importing.materials import (
    OLD_NAMES,
    OPTIONS,
    Model,
    WallContact,
    granular_model,
    liggghts_model,
    named_model,
    old_model,
    option,
    wall_contact,
    with_part,
)
from granflow.importing.meshes import Mesh, measure, mesh_keys, surface_motions, wear_keys
from granflow.importing.motion import mesh_motions, vibration
from granflow.importing.region_walls import Face, RegionWall
from granflow.importing.regions import region_of
from granflow.importing.report import Entry
from granflow.importing.scene_text import Draft, motions_of, quantities, quantity
from granflow.importing.schedule import STAGED, stages_of_runs

EDGE_SHARE = 0.02
"""Distance of a plane from the box over its size, below which the plane is a boundary of the box."""

# Box


def boundary(deck: Deck, command: Command, entry: Entry) -> None:
    """boundary X Y Z, each one letter for both sides or two."""
    words = Words(deck, command, command.words)
    _read_boundary(deck, words, entry)


def _read_boundary(deck: Deck, words: Words, entry: Entry) -> None:
    letters: list[str] = []
    for axis in "xyz":
        word = words.word(f"the boundary of {axis}")
        if not 1 <= len(word) <= 2 or set(word) - set("pfsm"):
            raise DeckError(words.command, f"the boundary of {axis} is {word}; give p, f, s or m.")
        if "p" in word and set(word) != {"p"}:
            raise DeckError(words.command, f"the boundary of {axis} is {word}; p belongs to both sides.")
        letters += [word[0], word[-1]]
    first, second, third, fourth, fifth, sixth = letters
    deck.boundary = (first, second, third, fourth, fifth, sixth)
    deck.boundary_entry = entry


def change_box(deck: Deck, command: Command, entry: Entry) -> None:
    """change_box GROUP boundary X Y Z | x final LO HI ..., before the first run."""
    words = Words(deck, command, command.words)
    words.word("a group")
    while words:
        key = words.word("a keyword")
        if key == "boundary":
            _read_boundary(deck, words, entry)
        elif key in ("x", "y", "z") and words.next == "final" and deck.box is not None and not deck.runs:
            words.word("final")
            box = list(deck.box)
            k = 2 * "xyz".index(key)
            box[k], box[k + 1] = words.number("the low end", "length"), words.number("the high end", "length")
            deck.box = tuple(box)
            entry.translated("domain")
        elif key == "units":
            words.word("box or lattice")
        elif key == "ortho":
            pass
        else:
            entry.impossible(f"change_box {key}", "another box at the start")
            words.skip()


def create_box(deck: Deck, command: Command, entry: Entry) -> None:
    """create_box N REGION"""
    words = Words(deck, command, command.words)
    deck.types = words.whole_between("the number of types", most=MOST_TYPES)
    region = region_of(deck, command, words.word("the name of a region"))
    if words.next.startswith(("bond/", "angle/", "extra/")):  # storage of molecules
        words.skip()
    if region.kind != "block":
        raise DeckError(command, f"region {region.name} is a {region.kind}; a box needs a block.")
    if not np.isfinite(region.numbers).all():
        raise DeckError(command, f"region {region.name} is not finite; give six numbers.")
    deck.box = region.numbers
    deck.box_entry = entry
    region.entry.translated("domain")


def freeze(deck: Deck, fix: Fix) -> None:
    """fix ID group freeze: particles that do not move."""
    Words(deck, fix.entry.command, fix.words)
    fix.data = fix.group


def _freeze(deck: Deck) -> None:
    """Make the inserted particles fixed that fix freeze holds: those of its group by their insertion."""
    templates = {fix.group for fix in deck.all_fixes if fix.style.startswith("particle")}
    for fix in deck.fixes_of("freeze"):
        if not deck.acting(fix):
            continue
        frozen = [
            each
            for each in deck.particles
            for command in [each.entries[0].command]
            if command.name == "fix" and fix.group in {"all", command.words[1], *templates}
        ]
        if not frozen and not any("fixed" in each.keys for each in deck.particles):
            fix.entry.not_needed("the group has no particles")
        for each in frozen:
            each.keys["fixed"] = True
            fix.entry.translated(f"particles.{each.name}.fixed")
        if len(deck.acting(fix)) < sum(run.steps > 0 for run in deck.runs):
            fix.entry.approximated("the particles are fixed in all runs")


# Walls

PLANES = ("xplane", "yplane", "zplane")
CYLINDERS = ("xcylinder", "ycylinder", "zcylinder")
SHAPE_WORDS = ("primitive", "type", "mesh", "mesh/gran", *PLANES, *CYLINDERS)
"""Words that begin the shape of a wall, after its model."""


@dataclass
class Primitive:
    """A plane or a cylinder of fix wall/gran.

    style:    such as zplane
    numbers:  positions [m] of planes by side ("low", "high", "only"), or radius and center of a cylinder
    moves:    wiggle and shear: (axis, amplitude [m], period [s]) and (axis, velocity [m/s], or of a
              cylinder of LIGGGHTS that turns [rad/s])
    """

    style: str
    planes: dict[str, float]
    cylinder: tuple[float, ...]
    contact: WallContact
    is_lammps: bool
    wiggle: tuple[str, float, float] | None = None
    shear: tuple[str, float] | None = None


def wall_gran_named(deck: Deck, fix: Fix) -> None:
    """fix ID group wall/gran/MODEL ... of LIGGGHTS 1 and 2."""
    name = fix.style.removeprefix("wall/gran/")
    fix.style = "wall/gran"
    words = Words(deck, fix.entry.command, fix.words)
    _wall(deck, fix, words, named_model(deck, words, fix.entry, name, SHAPE_WORDS))


def wall_gran(deck: Deck, fix: Fix) -> None:
    """fix ID group wall/gran MODEL ...: primitive or mesh (LIGGGHTS), zplane LO HI, zcylinder R (LAMMPS)."""
    words = Words(deck, fix.entry.command, fix.words)
    _wall(deck, fix, words, _model(deck, fix, words, SHAPE_WORDS))


def _wall(deck: Deck, fix: Fix, words: Words, model: Model) -> None:
    """Read the shape of a wall after its model."""
    style = words.word("the shape of the wall")
    if style == "mesh/gran":  # LIGGGHTS 1: the number of the meshes and their names
        count = words.whole("the number of meshes")
        meshes = [words.mesh() for _ in range(count)]
        fix.data = MeshWalls(
            [
                (each, wall_contact(deck, model, each.data.type))
                for each in meshes
                if isinstance(each.data, Mesh)
            ]
        )
        return
    if style == "mesh":
        _mesh_wall(deck, fix, words, model)
        return
    type = 0
    is_lammps = deck.code == "lammps" or style not in ("primitive", "type")
    if style in ("primitive", "type"):
        if style == "primitive" and words.word("type") != "type":
            raise DeckError(fix.entry.command, "the type of the wall is missing: primitive type N ...")
        type, is_lammps = words.type(), False
        style = words.word("the shape of the wall")
    if style not in PLANES + CYLINDERS:
        shapes = ", ".join(PLANES + CYLINDERS)
        raise DeckError(fix.entry.command, f"there is no wall {style}; there are {shapes} and meshes.")
    wall = Primitive(style, {}, (), WallContact(type, model), is_lammps)
    if style in PLANES and is_lammps:
        for side in ("low", "high"):
            if words.next == "NULL":
                words.word("a position")
            else:
                wall.planes[side] = words.number("a position", "length")
    elif style in PLANES:
        wall.planes["only"] = words.number("the position", "length")
    elif is_lammps:
        wall.cylinder = (words.number("the radius", "length"), 0.0, 0.0)
    else:
        wall.cylinder = (words.number("the radius", "length"), *(words.number("c", "length") for _ in "12"))
    if deck.code == "liggghts" and is_lammps and words:  # LIGGGHTS 1: the type at the end
        type = words.type()
    _wall_keywords(fix, words, wall)
    wall.contact = wall_contact(deck, wall.contact.model, type)
    if wall.shear is not None and style == "ycylinder" and wall.shear[0] != "y":
        fix.entry.approximated("the cylinder turns; LIGGGHTS 3.8 computes no friction of such a ycylinder")
    fix.data = wall


def _model(deck: Deck, fix: Fix, words: Words, stop: tuple[str, ...]) -> Model:
    """The contact model of a wall, of both codes."""
    first = words.next
    if first == "granular":
        words.word("granular")
        return granular_model(deck, words, fix.entry, stop)
    if first in ("hooke", "hooke/history", "hertz/history") and deck.code == "lammps":
        model = old_model(deck, words, fix.entry, words.word("the model"))
        if first != "hooke" and model.numbers["mu"]:
            fix.entry.approximated(
                f"friction at walls is that of LAMMPS of 2021, and of particles; the walls {first} of LAMMPS "
                "22 Jul 2025 have less of it"
            )
        return model
    if first[:1].isdigit() or first[:1] in ".-":
        main: Model | None = deck.family.get("model")
        style = "hertz/history" if main is not None and main.normal.startswith("hertz") else "hooke/history"
        return old_model(deck, words, fix.entry, style)
    return liggghts_model(deck, words, fix.entry, stop)


def _wall_keywords(fix: Fix, words: Words, wall: Primitive) -> None:
    """Read wiggle, shear and the keywords of the output of forces."""
    while words:
        key = words.word("a keyword")
        if key == "wiggle":
            axis = words.word("the axis of the wiggle")
            wall.wiggle = (axis, words.number("the amplitude", "length"), words.number("the period", "time"))
        elif key == "shear":
            axis = words.word("the axis of the shear")
            turns = bool(wall.cylinder) and not wall.is_lammps and axis != wall.style[0]
            wall.shear = (axis, words.number("the velocity", "angular_velocity" if turns else "velocity"))
        elif key in ("store_force", "store_force_contact", "store_force_contact_stress"):
            if words.flag(key):
                fix.entry.approximated("output.contacts has the force of each contact with a wall")
        elif key == "contacts":
            fix.entry.approximated("output.contacts has the force of each contact with a wall")
        elif key in OPTIONS and not wall.is_lammps:
            model = wall.contact.model
            options = {**model.options, key: option(words, key, fix.entry)}
            wall.contact.model = replace(model, options=options)
        elif key in ("rolling_friction", "cohesion") and not wall.is_lammps:  # LIGGGHTS 2
            wall.contact.model = with_part(wall.contact.model, words, fix.entry, key)
        elif key == "temperature":
            wall_temperature(words.deck, fix, words.plain("the temperature"))
        elif key == "contact_area":
            style = words.word("the style of the area")
            if style != "overlap":
                words.skip()
                fix.entry.impossible(f"contact_area {style} of a wall", "contact_area overlap")
        else:
            fix.entry.impossible(f"the keyword {key} of a wall", "a mesh with a motion")
            words.skip()
        for given in (wall.wiggle, wall.shear):
            if given is not None and given[0] not in ("x", "y", "z"):
                raise DeckError(words.command, f"the axis is {given[0]}; give x, y or z.")


@dataclass
class MeshWalls:
    """The meshes of a fix wall/gran with their contacts."""

    meshes: list[tuple[Fix, WallContact]]


def _mesh_wall(deck: Deck, fix: Fix, words: Words, model: Model) -> None:
    """... mesh n_meshes N meshes NAMES"""
    count = None
    meshes: list[Fix] = []
    unknown = ""
    while words:
        key = words.word("a keyword")
        if key == "n_meshes":
            count = words.whole("the number of meshes")
        elif key == "meshes":
            if count is None or len(words.words) - words.at < count:
                number = "missing" if count is None else f"{count}, but fewer names follow"
                raise DeckError(
                    words.command,
                    f"n_meshes is {number} (meshes {' '.join(words.rest)}): n_meshes N meshes NAME ...",
                )
            meshes = [words.mesh() for _ in range(count)]
            if words.next in deck.fixes and deck.fixes[words.next].style.startswith("mesh/surface"):
                raise DeckError(
                    words.command,
                    f"n_meshes is {count}, but the mesh {words.next} follows; give {count + 1}.",
                )
        elif key in ("store_force", "store_force_contact", "store_force_contact_stress"):
            if words.flag(key):
                fix.entry.approximated("output.contacts has the force of each contact with a wall")
        elif key in OPTIONS:
            model = replace(model, options={**model.options, key: option(words, key, fix.entry)})
        elif key in ("rolling_friction", "cohesion"):  # LIGGGHTS 2
            model = with_part(model, words, fix.entry, key)
        else:
            fix.entry.impossible(f"the keyword {key} of a mesh wall")
            unknown = f" before the unknown keyword {key}"
            words.skip()
    if not meshes:
        raise DeckError(words.command, f"the meshes are missing{unknown}: mesh n_meshes N meshes NAME ...")
    fix.data = MeshWalls(
        [(mesh, wall_contact(deck, model, mesh.data.type)) for mesh in meshes if isinstance(mesh.data, Mesh)]
    )


def wall_gran_region(deck: Deck, fix: Fix) -> None:
    """fix ID group wall/gran/region MODEL ... region NAME"""
    words = Words(deck, fix.entry.command, fix.words)
    model = _model(deck, fix, words, ("region",))
    if words.word("region") != "region":
        raise DeckError(fix.entry.command, "the region is missing: wall/gran/region ... region NAME.")
    region = region_of(deck, fix.entry.command, words.word("the name of a region"))
    while words:
        key = words.word("a keyword")
        if key == "contacts":
            fix.entry.approximated("output.contacts has the force of each contact with a wall")
        else:
            fix.entry.impossible(f"the keyword {key} of a wall")
            words.skip()
    fix.data = RegionWall(region.name, wall_contact(deck, model, 0))


# Floors

FLOOR_POINTS = 5
"""Points along each side of a region, below which a floor is looked for."""
FLOOR_SHARE = 0.8
"""Share of these points with a floor, from which on the region is closed below."""


def has_floor(
    deck: Deck, runs: Sequence[Run], extent: Sequence[float], gravity: Sequence[float], reach: float
) -> bool:
    """Whether a plane or meshes close a region toward gravity, so that particles stay in it.

    extent:  low and high end of the region along x, y and z [m]
    reach:   distance [m] of the floor below the region up to which it counts
    """
    k = int(np.argmax(np.abs(gravity)))
    if not runs or not gravity[k]:
        return False
    down = float(np.sign(gravity[k]))
    ends = sorted(down * each for each in extent[2 * k : 2 * k + 2])  # along gravity
    sides = [each for each in range(3) if each != k]
    shares = (np.arange(FLOOR_POINTS) + 0.5) / FLOOR_POINTS
    grid = [extent[2 * i] + shares * (extent[2 * i + 1] - extent[2 * i]) for i in sides]
    points = np.stack(np.meshgrid(*grid), axis=-1).reshape(-1, 2)
    found = np.zeros(len(points), bool)

    def is_near(along: Any) -> Any:
        return (ends[0] < down * along) & (down * along <= ends[1] + reach)

    for fix in deck.fixes_of("wall/gran"):
        if fix.data is None or not any(fix.acts_in(run) for run in runs):
            continue
        if isinstance(fix.data, Primitive) and fix.data.style == PLANES[k]:
            found |= any(is_near(np.array(each)) for each in fix.data.planes.values())
        for mesh, _ in fix.data.meshes if isinstance(fix.data, MeshWalls) else ():
            for corners in mesh.data.triangles():
                weights = _weights(corners[:, sides], points)
                inside = (weights >= 0.0).all(axis=1)
                found |= inside & is_near(weights @ corners[:, k])
    return bool(found.mean() >= FLOOR_SHARE)


def _weights(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Barycentric coordinates (n, 3) of points (n, 2) in a triangle (3, 2); -1 for one of no area."""
    (a, b), (c, d) = corners[1:] - corners[0]
    area = a * d - b * c
    if area == 0.0:
        return np.full((len(points), 3), -1.0)
    x, y = (points - corners[0]).T
    second, third = (x * d - y * c) / area, (y * a - x * b) / area
    return np.column_stack((1.0 - second - third, second, third))


# The blocks


def build(deck: Deck, draft: Draft) -> None:
    """Write the block walls, flow meters and outlets."""
    region_walls.release_periodic_axes(deck)
    deformation.shear(deck)
    _freeze(deck)
    walls: dict[tuple[str, float, str], tuple[Fix, WallContact, list[Fix]]] = {}
    for fix in deck.fixes_of("wall/gran"):
        for mesh, contact in fix.data.meshes if isinstance(fix.data, MeshWalls) else ():
            if deck.acting(fix):
                wall = walls.setdefault((mesh.name, mesh.start, contact.material), (mesh, contact, []))
                wall[2].append(fix)
    for mesh, contact, fixes in walls.values():
        _mesh(deck, draft, fixes, mesh, contact)
    for fix in deck.fixes_of("wall/gran", "wall/gran/region"):
        if fix.data is None or not deck.acting(fix):
            continue
        if isinstance(fix.data, Primitive):
            _primitive(deck, draft, fix, fix.data)
        elif isinstance(fix.data, RegionWall):
            region_walls.build(deck, draft, fix, fix.data)
    meshes.build(deck, draft)


def _put_wall(
    deck: Deck, draft: Draft, name: str, keys: dict[str, Any], runs: list[Run], entries: tuple[Entry, ...]
) -> str:
    """Write a wall that exists during some runs; returns its name.

    A wall that follows on an equal one at rest, such as that of the next script, is the same wall.
    """
    shape = {key: value for key, value in keys.items() if key != "motion"}
    known: dict[str, tuple[dict[str, Any], list[Run]]] = deck.own("resting_walls", dict)
    motions = motions_of(keys)
    is_limited = all({"stages", "start"} & set(each) for each in motions)
    for other, (equal, before) in known.items():
        if equal == shape and is_limited and before[-1].end <= runs[0].start + runs[0].slack:
            known[other] = (shape, [*before, *runs])
            if motions:
                del known[other]
            stages = stages_of_runs(deck, [*before, *runs])
            draft.put(("walls", other), {**keys, **({} if stages is None else {"stages": stages})}, *entries)
            return other
    stages = stages_of_runs(deck, runs)
    if stages is not None:
        keys["stages"] = stages
    free = region_walls.wall_name(draft, name)
    if not motions:
        known[free] = (shape, runs)
    draft.put(("walls", free), keys, *entries)
    return free


def _primitive(deck: Deck, draft: Draft, fix: Fix, wall: Primitive) -> None:
    axis = "xyz".index(wall.style[0])
    assert deck.box is not None
    runs = deck.acting(fix)
    motions = _primitive_motions(wall, axis, runs)
    for side, position in wall.planes.items():
        face = _plane(deck, axis, side, position, fix)
        keys = {**face.keys(), "material": wall.contact.material, **_motion(motions)}
        name = fix.name if len(wall.planes) == 1 else f"{fix.name}_{side}"
        _put_wall(deck, draft, name, keys, runs, (fix.entry,))
    if wall.cylinder:
        radius, *center = wall.cylinder
        low, high = deck.box[2 * axis], deck.box[2 * axis + 1]
        margin = 0.0 if deck.boundary[2 * axis] == "p" else high - low
        ends = []
        for along in (low - margin, high + margin):
            end = np.zeros(3)
            end[axis] = along
            end[[k for k in range(3) if k != axis]] = center
            ends.append(end)
        face = Face("cylinder", {"from": ends[0], "to": ends[1]}, {}, {"radius": radius})
        keys = {**face.keys(), "material": wall.contact.material, **_motion(motions)}
        _put_wall(deck, draft, fix.name, keys, runs, (fix.entry,))


def _motion(motions: list[dict[str, Any]]) -> dict[str, Any]:
    """The key motion, if there is a motion."""
    return {"motion": motions[0] if len(motions) == 1 else motions} if motions else {}


def _plane(deck: Deck, axis: int, side: str, position: float, fix: Fix) -> Face:
    """A plane of LAMMPS, which has one side, or of LIGGGHTS, which has two.

    A plane of LIGGGHTS inside the box is a rectangle across the box.
    """
    assert deck.box is not None
    low, high = deck.box[2 * axis], deck.box[2 * axis + 1]
    near = EDGE_SHARE * (high - low)
    point, normal = np.zeros(3), np.zeros(3)
    point[axis] = position
    is_inner = side == "only" and low + near < position < high - near
    if is_inner:
        corner, others = point.copy(), [k for k in range(3) if k != axis]
        sides = np.zeros((2, 3))
        for row, k in enumerate(others):
            size = deck.box[2 * k + 1] - deck.box[2 * k]
            margin = 0.0 if deck.boundary[2 * k] == "p" else size
            corner[k] = deck.box[2 * k] - margin
            sides[row, k] = size + 2.0 * margin
        return Face("rectangle", {"corner": corner}, {"sides": sides}, {})
    is_low = side == "low" or side == "only" and position <= 0.5 * (low + high)
    normal[axis] = 1.0 if is_low else -1.0
    return Face("plane", {"point": point}, {"normal": normal}, {})


def _primitive_motions(wall: Primitive, axis: int, runs: list[Run]) -> list[dict[str, Any]]:
    """Wiggle: A - A cos(w t) along an axis. Shear: a velocity of the surface along itself."""
    found: list[dict[str, Any]] = []
    start = runs[0].start
    when = {"start": quantity(start, "time")} if start > 0.0 else {}
    if wall.wiggle is not None:
        name, amplitude, period = wall.wiggle
        direction = np.eye(3)["xyz".index(name)]
        # A (sin(w t + p) - sin(p)) with p = -90 deg
        found.append({**vibration(amplitude * direction, 2.0 * pi / period, -0.5 * pi), **when})
    if wall.shear is not None:
        name, speed = wall.shear
        along = "xyz".index(name)
        if wall.cylinder and along != axis:
            radius, *center = wall.cylinder
            point = np.zeros(3)
            point[[k for k in range(3) if k != axis]] = center
            # LAMMPS: clockwise, with the velocity of the surface; LIGGGHTS: counterclockwise, in rad/s
            rate = quantity(-speed / radius if wall.is_lammps else speed, "angular_velocity")
            place = {"point": quantities(point, "length"), "axis": [int(k == axis) for k in range(3)]}
            found.append({"kind": "rotation", **place, "angular_velocity": rate, **when})
        else:
            velocity = speed * np.eye(3)[along]
            found.append({"kind": "surface_velocity", "velocity": quantities(velocity, "velocity"), **when})
    return found


def _mesh(deck: Deck, draft: Draft, fixes: list[Fix], mesh: Fix, contact: WallContact) -> None:
    """One mesh; scripts that take another mesh away end the fix of all and give it again for the others."""
    mesh = next(each for each in deck.all_fixes if each.entry is mesh.entry)
    name = region_walls.wall_name(draft, mesh.name)
    keys = {**mesh_keys(draft, mesh.data), "material": contact.material}
    keys |= wear_keys(deck, mesh.data)
    motions = [*surface_motions(deck, mesh, name), *mesh_motions(deck, draft, mesh, name)]
    keys |= _motion(motions)
    runs = [
        run
        for run in deck.runs
        if run.steps and mesh.acts_in(run) and any(each.acts_in(run) for each in fixes)
    ]
    before = set(draft.get("walls") or ())
    name = _put_wall(deck, draft, name, keys, runs, (mesh.entry, *(each.entry for each in fixes)))
    if runs and runs[0].start > 0.0 and name not in before:
        fixes[0].entry.approximated(
            f"{name} appears at {runs[0].start:.4g} s: where it appears within particles, a run of granflow "
            "stops, with which the script continues; move it in from outside of them, or delete its key "
            "stages, so that the particles settle around it"
        )
    measure(draft, mesh, name)


# Tables

_REFLECT = "walls without friction or contacts"

COMMANDS: dict[str, Translation] = {
    "boundary": Translation(boundary, "domain.periodic, domain.on_exit"),
    "create_box": Translation(create_box, "domain.min, domain.max"),
    "change_box": Translation(change_box, "domain", "boundary and final, before the first run"),
}
FIXES: dict[str, Translation] = {
    "wall/gran": Translation(
        wall_gran, "walls", "planes, cylinders, meshes; wiggle (vibration), shear (surface_velocity)"
    ),
    **dict.fromkeys(
        (f"wall/gran/{name}" for name in OLD_NAMES),
        Translation(wall_gran_named, "walls", "LIGGGHTS 1 and 2: keywords or two flags"),
    ),
    "wall/gran/region": Translation(
        wall_gran_region, "walls", "block, cylinder, cone, sphere, plane, union, intersect"
    ),
    "freeze": Translation(freeze, "particles.NAME.fixed", "groups of types"),
    **dict.fromkeys(
        ("wall/reflect", "wall/region", "wall/lj93", "wall/lj126", "wall/harmonic", "wall/colloid"),
        impossible(_REFLECT, "a plane of LAMMPS: fix wall/gran"),
    ),
    "indent": impossible("an indenter without friction", "a wall with a motion"),
}
STAGED.update(("wall/gran", "wall/gran/region"))
