"""Rigid bodies of spheres of a script: templates of LIGGGHTS, and the fixes that move the bodies."""

from math import isfinite
from pathlib import Path

import numpy as np

from granflow.geometry.clump import clump_body
from granflow.importing.deck import Deck, Fix, Translation, Words, impossible, not_needed
from granflow.importing.insertion import Template
from granflow.importing.language import Command, DeckError
from granflow.importing.meshes import clean
from granflow.importing.scene_text import quantities, quantity
from granflow.scene.blocks.particle_shapes.clump import MOST_SPHERES

_BODIES = "clumps move as rigid bodies"


def template_multisphere(deck: Deck, fix: Fix) -> None:
    """fix ID group particletemplate/multisphere SEED atom_type N density constant D nspheres N ntry N
    spheres file NAME [scale S] | X Y Z R ... type N"""
    words = Words(deck, fix.entry.command, fix.words)
    if words.next != "atom_type":
        words.word("the seed")
    type, density, count = 1, deck.si(1.0, "density"), 0
    spheres: np.ndarray | None = None
    while words:
        key = words.word("a keyword")
        if key == "atom_type":
            type = words.type()
        elif key == "density":
            if words.word("constant") != "constant":
                fix.entry.impossible("densities that differ", "density constant")
                words.number("the density", "density")
            density = words.positive("the density", "density")
        elif key == "nspheres":
            count = words.whole("the number of spheres")
        elif key in ("ntry", "type"):
            words.whole(f"the value of {key}")
        elif key == "spheres":
            spheres = _spheres(deck, words, count)
        elif key in ("fflag", "tflag"):
            if [words.word("on or off") for _ in range(3)] != ["on"] * 3:
                fix.entry.impossible(
                    "bodies that do not move along or about some axes", "clumps that move freely"
                )
        elif key == "mass":
            words.number("the mass", "mass")
            fix.entry.impossible("a mass that is given", "the density of the material: mass over volume")
        elif key == "inertia_tensor":
            for _ in range(6):
                words.plain("a moment of inertia")
            fix.entry.impossible("an inertia tensor that is given", "that of the spheres")
        elif key not in ("use_volume", "use_density"):
            fix.entry.impossible(f"the keyword {key} of a template")
            words.skip()
    if spheres is None:
        raise DeckError(words.command, "the spheres are missing: nspheres N ntry N spheres file NAME.")
    if density <= 0.0:
        raise DeckError(words.command, f"the density is {density:g}; give a number above 0.")
    if len(spheres) > MOST_SPHERES:
        fix.entry.impossible(f"a body of {len(spheres)} spheres", f"at most {MOST_SPHERES} spheres")
        spheres = spheres[:MOST_SPHERES]
    fix.data = clump_template(type, density, spheres, fix)


def multisphere(deck: Deck, fix: Fix) -> None:
    """fix ID group multisphere [allow_group_and_set yes|no] [allow_heatsource yes|no] [CAddRhoFluid C RHO]"""
    words = Words(deck, fix.entry.command, fix.words)
    while words.next in ("allow_group_and_set", "allow_heatsource"):
        words.flag(words.word("a keyword"))
    if words.next == "CAddRhoFluid":
        words.skip()
        fix.entry.impossible("the added mass of a fluid (CAddRhoFluid)", "clumps without a fluid")
    fix.entry.not_needed(_BODIES)


def clump_template(type: int, density: float, spheres: np.ndarray, fix: Fix) -> Template:
    """The template of a body with spheres (n, 4): positions and radii [m]."""
    center = tuple(map(tuple, spheres[:, :3].tolist()))
    radius = tuple(spheres[:, 3].tolist())
    body = clump_body(center, radius)
    clump = {
        "spheres": [
            {"position": quantities(clean(row[:3]), "length"), "radius": quantity(row[3], "length")}
            for row in spheres
        ]
    }
    return Template(type, density, min(radius), fix.entry, clump, body.volume)


def _spheres(deck: Deck, words: Words, count: int) -> np.ndarray:
    """Positions and radii (n, 4) [m] of the spheres of a template."""
    command = words.command
    if count < 1:
        raise DeckError(command, "nspheres N must precede the spheres, with a number above 0.")
    unit = deck.si(1.0, "length")
    if words.next == "file":
        words.word("file")
        path = deck.family["folder"] / words.word("the file of the spheres")
        scale = 1.0
        if words.next == "scale":
            words.word("scale")
            scale = words.number("the scale")
        found = _read_spheres(command, path) * scale * unit
    else:
        numbers = [words.number("a position or radius", "length") for _ in range(4 * count)]
        found = np.array(numbers).reshape(count, 4)
        if words.next == "scale":
            words.word("scale")
            found = found * words.number("the scale")
    if len(found) != count:
        raise DeckError(command, f"nspheres is {count}, and there are {len(found)} spheres.")
    if (found[:, 3] <= 0.0).any():
        raise DeckError(command, f"a radius is {found[:, 3].min():g} m; give radii above 0.")
    return np.asarray(found)


def _read_spheres(command: Command, path: Path) -> np.ndarray:
    """The rows x y z r of a file."""
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise DeckError(command, f"{path} cannot be read: {error.strerror}.") from None
    rows = []
    for number, line in enumerate(lines, 1):
        parts = line.split("#")[0].split()
        if not parts:
            continue
        try:
            row = [float(each) for each in parts[:4]]
        except ValueError:
            row = []
        if len(row) < 4 or not all(map(isfinite, row)):
            raise DeckError(
                command, f"{path.name}:{number}: a sphere has four numbers, x y z and the radius."
            )
        rows.append(row)
    return np.array(rows).reshape(-1, 4)


# Tables

COMMANDS: dict[str, Translation] = {}
FIXES: dict[str, Translation] = {
    "particletemplate/multisphere": Translation(
        template_multisphere, "particles.NAME.clump", f"at most {MOST_SPHERES} spheres; mass of their union"
    ),
    "multisphere": Translation(multisphere, "not needed", _BODIES),
    "multisphere/nointegration": not_needed(_BODIES),
    "multisphere/break": impossible("bodies that break", "clumps that do not break"),
    **dict.fromkeys(("rigid/small", "rigid/nve/small", "rigid", "rigid/nve"), not_needed(_BODIES)),
}
