"""Geometry of a script: box, regions, groups, walls, meshes and their motions."""

from math import inf, nan
from pathlib import Path

from granflow.importing.deck import Deck, Fix, Group, Region, Translation, Words, not_needed
from granflow.importing.language import Command, DeckError
from granflow.importing.materials import WallContact, liggghts_model, wall_contact
from granflow.importing.report import Entry
from granflow.importing.scene_text import Draft, quantities, quantity
from granflow.importing.schedule import STAGED, stages_of

# Box


def boundary(deck: Deck, command: Command, entry: Entry) -> None:
    """boundary X Y Z, each one letter for both sides or two."""
    words = Words(deck, command, command.words)
    letters: list[str] = []
    for axis in "xyz":
        word = words.word(f"the boundary of {axis}")
        if not 1 <= len(word) <= 2 or set(word) - set("pfsm"):
            raise DeckError(command, f"the boundary of {axis} is {word}; give p, f, s or m.")
        letters += [word[0], word[-1]]
    first, second, third, fourth, fifth, sixth = letters
    deck.boundary = (first, second, third, fourth, fifth, sixth)
    deck.boundary_entry = entry


def create_box(deck: Deck, command: Command, entry: Entry) -> None:
    """create_box N REGION"""
    words = Words(deck, command, command.words)
    deck.types = words.whole("the number of types")
    region = region_of(deck, command, words.word("the name of a region"))
    if region.kind != "block":
        raise DeckError(command, f"region {region.name} is a {region.kind}; a box needs a block.")
    deck.box = region.numbers
    deck.box_entry = entry
    region.entry.translated("domain")


# Regions

NUMBERS: dict[str, tuple[str, ...]] = {
    "block": ("xlo", "xhi", "ylo", "yhi", "zlo", "zhi"),
    "cylinder": ("c1", "c2", "radius", "lo", "hi"),
    "cone": ("c1", "c2", "radlo", "radhi", "lo", "hi"),
    "sphere": ("x", "y", "z", "radius"),
    "plane": ("px", "py", "pz", "nx", "ny", "nz"),
}
"""Numbers of a region by its style."""
KEYWORDS = {"side": 1, "units": 1, "open": 1, "move": 3, "rotate": 7, "seed": 1, "volume_limit": 1}
"""Keywords of regions with the number of their words."""


def region(deck: Deck, command: Command, entry: Entry) -> None:
    """region ID STYLE NUMBERS KEYWORDS | region ID delete"""
    words = Words(deck, command, command.words)
    name = words.word("the name of the region")
    style = words.word("the style of the region")
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
    elif style in NUMBERS:
        if style in ("cylinder", "cone"):
            axis = words.word("the axis")
            if axis not in "xyz":
                raise DeckError(command, f"the axis is {axis}; give x, y or z.")
        numbers = tuple(_bound(words, each) for each in NUMBERS[style])
    else:
        entry.impossible(f"regions of the style {style}", "block, cylinder, cone or sphere")
        return
    found = Region(name, style, axis, numbers, entry, parts)
    others: list[str] = []
    opened: list[int] = []
    while words:
        key = words.word("a keyword")
        if key not in KEYWORDS:
            raise DeckError(command, f"regions have no keyword {key}. Keywords: {', '.join(KEYWORDS)}.")
        values = [words.word(f"a value of {key}") for _ in range(KEYWORDS[key])]
        if key == "side":
            found.inside = values[0] == "in"
        elif key == "units":
            if values[0] == "lattice":
                entry.impossible("lengths in units of a lattice", "units box")
        elif key == "open":
            opened.append(int(values[0]))
        elif key in ("move", "rotate"):
            others += [key, *values]
    found.open, found.words = tuple(opened), tuple(others)
    deck.regions[name] = found


def _bound(words: Words, what: str) -> float:
    """A coordinate; INF is infinite, EDGE not a number."""
    if words.next == "EDGE":
        words.word(what)
        return nan
    if words.next in ("-INF", "INF", "+INF"):
        return -inf if words.word(what) == "-INF" or what.endswith("lo") else inf
    is_direction = what in ("nx", "ny", "nz")
    return words.number(what, "number" if is_direction else "length")


def region_of(deck: Deck, command: Command, name: str) -> Region:
    """A region by its name. Raises DeckError."""
    if name not in deck.regions:
        raise DeckError(command, f"there is no region {name}. Regions: {', '.join(deck.regions) or 'none'}.")
    return deck.regions[name]


def group(deck: Deck, command: Command, entry: Entry) -> None:
    """group ID STYLE ..."""
    words = Words(deck, command, command.words)
    name = words.word("the name of the group")
    style = words.word("the style of the group")
    deck.groups[name] = Group(name, style, words.rest, entry)
    entry.not_needed("forces, walls and output of the scene apply to all particles")


# Walls of LIGGGHTS


def wall_gran(deck: Deck, fix: Fix) -> None:
    """fix ID group wall/gran MODEL primitive type N STYLE NUMBERS | mesh n_meshes N meshes NAMES"""
    words = Words(deck, fix.entry.command, fix.words)
    model = liggghts_model(deck, words, fix.entry, ("primitive", "mesh"))
    kind = words.word("primitive or mesh")
    if kind == "primitive":
        if words.word("type") != "type":
            raise DeckError(fix.entry.command, "the type of the wall is missing: primitive type N ...")
        contact = wall_contact(deck, model, words.whole("the type"))
        style = words.word("the shape of the wall")
        shapes = {"plane": 1, "cylinder": 3}
        if style[:1] not in "xyz" or style[1:] not in shapes:
            fix.entry.impossible(f"the wall {style}", "xplane, yplane, zplane or a cylinder")
            return
        numbers = tuple(words.number("a number of the wall", "length") for _ in range(shapes[style[1:]]))
        fix.data = ("primitive", style, numbers, contact)
        if words:
            fix.entry.impossible(f"the keyword {words.next} of a wall", "a mesh with a motion")
        return
    names: list[str] = []
    while words:
        key = words.word("a keyword")
        if key == "n_meshes":
            words.whole("the number of meshes")
        elif key == "meshes":
            names = list(words.rest)
        else:
            fix.entry.impossible(f"the keyword {key} of a mesh wall")
    contacts = []
    for name in names:
        mesh = deck.fixes.get(name)
        if mesh is None or mesh.data is None:
            raise DeckError(fix.entry.command, f"there is no fix mesh/surface {name}.")
        contacts.append((mesh, wall_contact(deck, model, mesh.data["type"])))
    fix.data = ("mesh", contacts)


def mesh_surface(deck: Deck, fix: Fix) -> None:
    """fix ID group mesh/surface file NAME type N [scale S] [move X Y Z] [rotate axis X Y Z angle A] ..."""
    words = Words(deck, fix.entry.command, fix.words)
    data: dict[str, object] = {"steps": []}
    steps: list[tuple[object, ...]] = []
    while words:
        key = words.word("a keyword")
        if key == "file":
            data["file"] = words.word("the file")
        elif key == "type":
            data["type"] = words.whole("the type")
        elif key == "scale":
            steps.append(("scale", words.number("the scale")))
        elif key == "move":
            steps.append(("move", words.vector("the displacement", "length")))
        elif key == "rotate":
            words.word("axis")
            axis = words.vector("the axis")
            words.word("angle")
            steps.append(("rotate", axis, words.number("the angle")))
        elif key in ("verbose", "heal", "curvature", "precision", "element_exclusion_list"):
            words.word(f"a value of {key}")
        else:
            fix.entry.impossible(f"the keyword {key} of a mesh")
            words.skip()
    if "file" not in data or "type" not in data:
        raise DeckError(fix.entry.command, "a mesh needs file NAME and type N.")
    data["steps"] = steps
    data["path"] = deck.family["folder"] / str(data["file"])
    if not Path(str(data["path"])).is_file():
        raise DeckError(fix.entry.command, f"the mesh {data['path']} does not exist.")
    fix.data = data


# The blocks


def build(deck: Deck, draft: Draft) -> None:
    """Write the block walls."""
    for fix in deck.fixes_of("wall/gran"):
        if fix.data is None or not deck.acting(fix):
            continue
        if fix.data[0] == "primitive":
            _primitive(deck, draft, fix)
        else:
            for mesh, contact in fix.data[1]:
                _mesh(deck, draft, fix, mesh, contact)


def wall_name(draft: Draft, name: str) -> str:
    """A name of a wall that is not taken, without characters that names do not have."""
    plain = "".join(each if each.isalnum() or each == "_" else "_" for each in name)
    plain = plain if plain[:1].isalpha() else f"wall_{plain}"
    taken = draft.get("walls") or {}
    free = plain
    count = 1
    while free in taken:
        count += 1
        free = f"{plain}_{count}"
    return free


def put_wall(deck: Deck, draft: Draft, fix: Fix, keys: dict[str, object], *entries: Entry) -> None:
    """Write a wall that a fix makes, in the stages of the fix."""
    stages = stages_of(deck, fix)
    if stages is not None:
        keys["stages"] = stages
    draft.put(("walls", wall_name(draft, fix.name)), keys, fix.entry, *entries)


def _primitive(deck: Deck, draft: Draft, fix: Fix) -> None:
    _, style, numbers, contact = fix.data
    axis = "xyz".index(style[0])
    assert deck.box is not None
    low, high = deck.box[2 * axis], deck.box[2 * axis + 1]
    if style[1:] == "plane":
        point, normal = [0.0, 0.0, 0.0], [0, 0, 0]
        point[axis] = numbers[0]
        normal[axis] = 1 if numbers[0] <= 0.5 * (low + high) else -1
        keys: dict[str, object] = {"shape": "plane", "point": quantities(point, "length"), "normal": normal}
    else:
        radius, *center = numbers
        ends = []
        for along in (low - 0.5 * (high - low), high + 0.5 * (high - low)):
            end = [0.0, 0.0, 0.0]
            end[axis] = along
            others = [k for k in range(3) if k != axis]
            end[others[0]], end[others[1]] = center
            ends.append(quantities(end, "length"))
        keys = {"shape": "cylinder", "from": ends[0], "to": ends[1], "radius": quantity(radius, "length")}
    put_wall(deck, draft, fix, {**keys, "material": contact.material})


def _mesh(deck: Deck, draft: Draft, fix: Fix, mesh: Fix, contact: WallContact) -> None:
    path = Path(str(mesh.data["path"]))
    name = draft.add_file(path.name, path.read_bytes())
    keys: dict[str, object] = {"shape": "mesh", "file": name, "material": contact.material}
    for kind, *values in mesh.data["steps"]:
        if kind == "scale":
            keys["scale"] = values[0]
        elif kind == "move":
            keys["translate"] = quantities(values[0], "length")
        else:
            keys["rotate"] = {"axis": [*values[0]], "angle": f"{values[1]:.12g} deg"}
    put_wall(deck, draft, fix, keys, mesh.entry)


# Tables

COMMANDS: dict[str, Translation] = {
    "boundary": Translation(boundary, "domain.periodic, domain.on_exit"),
    "create_box": Translation(create_box, "domain.min, domain.max"),
    "region": Translation(
        region, "walls, insert.region", "block, cylinder, cone, sphere, plane, union, intersect"
    ),
    "group": Translation(group, "not needed"),
    "lattice": not_needed("only create_atoms uses it"),
    "change_box": Translation(boundary, "domain"),
}
FIXES: dict[str, Translation] = {
    "wall/gran": Translation(wall_gran, "walls"),
    "mesh/surface": Translation(mesh_surface, "walls.NAME (shape: mesh)"),
    "mesh/surface/stress": Translation(mesh_surface, "walls.NAME (shape: mesh)"),
    "mesh/surface/planar": Translation(mesh_surface, "walls.NAME (shape: mesh)"),
}
STAGED.update(("wall/gran", "wall/gran/region", "move/mesh"))
