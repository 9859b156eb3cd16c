"""Particles of a script: templates, distributions, insertions, pour, read_data and create_atoms.

`collect` makes the groups of the scene before materials are known, `build` writes them.
"""

from dataclasses import dataclass, field
from math import acos, ceil, degrees, floor, hypot, inf, pi, sqrt
from typing import Any

import numpy as np

from granflow.importing.deck import (
    Deck,
    Fix,
    ParticleGroup,
    Region,
    Translation,
    Vector,
    Words,
    impossible,
)
from granflow.importing.geometry import has_floor
from granflow.importing.language import DeckError
from granflow.importing.materials import MOST_SIZES, is_by_size, material_of
from granflow.importing.meshes import FlatFace, flat_face
from granflow.importing.pouring import Pouring
from granflow.importing.regions import region_of
from granflow.importing.report import Entry
from granflow.importing.scene_text import Draft, plain_name, quantities, quantity
from granflow.importing.schedule import gravity_at, stage_names
from granflow.io.tables import is_number
from granflow.schema.messages import suggestion_sentence
from granflow.units import to_si

MOST_BATCHES = 12
"""Number of batches of an insertion that become groups of their own; more become a constant rate."""
MOST_FILLED = 0.327
OVERHANG = 0.65
"""Largest solid fraction that insert/pack reaches in the box of the centers with sides that are longer by
this number of diameters, because particles at its faces have neighbors on one side only. Measured with
LIGGGHTS."""
AT_REST = 0.58
"""Solid fraction of particles at rest on a floor."""
BURST = 0.02
"""Duration of the insertion of a batch over the time between two batches."""

# Templates and distributions (LIGGGHTS)


@dataclass
class Template:
    """A particle template: type, density [kg/m3], radius [m]; `clump` has the keys of a multisphere."""

    type: int
    density: float
    radius: float
    entry: Entry
    clump: dict[str, Any] | None = None
    volume: float = 0.0
    """Volume [m3] of the particle."""
    sizes: dict[str, Any] | None = None
    """The key diameter of a random radius."""

    @property
    def radii(self) -> tuple[float, float]:
        """Smallest and largest radius [m], that of three standard deviations of a normal distribution."""
        if self.sizes is None:
            return self.radius, self.radius
        low, high = (0.5 * to_si(self.sizes[key], "length") for key in ("min", "max"))
        return low, high


def template_sphere(deck: Deck, fix: Fix) -> None:
    """fix ID group particletemplate/sphere SEED atom_type N density constant D radius constant R"""
    words = Words(deck, fix.entry.command, fix.words)
    if words.next not in ("atom_type", "density", "radius"):
        words.word("the seed")
    type, density, radius = 1, deck.si(1.0, "density"), deck.si(1.0, "length")
    sizes: dict[str, Any] | None = None
    cube = 0.0
    while words:
        key = words.word("a keyword")
        if key == "atom_type":
            type = words.type()
        elif key in ("density", "radius"):
            dimension = "density" if key == "density" else "length"
            style = words.word("constant")
            if words.next in ("number", "mass"):  # what the shares of a random radius refer to
                words.word("number or mass")
            number = words.number(f"the {key}", dimension)
            if style != "constant":
                other = words.number(f"the second number of the {key}", dimension)
                number, drawn, cube = _random(fix, key, style, number, other)
                sizes = drawn or sizes
            if number <= 0.0:
                raise DeckError(fix.entry.command, f"the {key} is {number:g}; give a number above 0.")
            density, radius = (number, radius) if key == "density" else (density, number)
        elif key == "volume_limit":
            words.word("the smallest volume")
        elif key == "relative":
            if words.flag(key):
                fix.entry.impossible(
                    "a radius in percent of another one (relative)", "radius constant R in m"
                )
        else:
            fix.entry.impossible(f"the keyword {key} of a template")
            words.skip()
    cube = cube if sizes else radius**3
    fix.data = Template(type, density, radius, fix.entry, None, 4.0 / 3.0 * pi * cube, sizes)


def _random(
    fix: Fix, key: str, style: str, first: float, second: float
) -> tuple[float, dict[str, Any] | None, float]:
    """Mean, key diameter and mean cube of a radius or density.

    `first`, `second`: limits (uniform), or mean and standard deviation (gaussian).
    """
    if style not in ("uniform", "gaussian"):
        raise DeckError(fix.entry.command, f"the {key} is {style}; give constant, uniform or gaussian.")
    mean = 0.5 * (first + second) if style == "uniform" else first
    if key == "density":
        fix.entry.approximated(f"the density is {style}; the mean, {mean:g}, is taken")
        return mean, None, 0.0
    if style == "uniform":
        ends = {"min": quantity(2.0 * first, "length"), "max": quantity(2.0 * second, "length")}
        return mean, {"distribution": "uniform", **ends}, (first + second) * (first**2 + second**2) / 4.0
    low, high = max(first - 3.0 * second, 0.1 * first), first + 3.0 * second
    fix.entry.approximated("the normal distribution of the radius is cut at three standard deviations")
    sizes = {
        "distribution": "normal",
        "mean": quantity(2.0 * first, "length"),
        "deviation": quantity(2.0 * second, "length"),
        "min": quantity(2.0 * low, "length"),
        "max": quantity(2.0 * high, "length"),
    }
    return mean, sizes, first**3 + 3.0 * first * second**2


@dataclass
class Distribution:
    """Templates with their shares, by mass or by number."""

    templates: list[Template]
    shares: list[float]
    by: str
    entry: Entry

    def number_shares(self) -> list[float]:
        """Shares by number with the sum 1."""
        if self.by == "number":
            weights = list(self.shares)
        else:
            weights = [s / (t.volume * t.density) for s, t in zip(self.shares, self.templates, strict=True)]
        return [each / sum(weights) for each in weights]

    @property
    def mean_volume(self) -> float:
        """Mean volume of a particle [m3]."""
        shares = self.number_shares()
        return sum(s * t.volume for s, t in zip(shares, self.templates, strict=True))

    @property
    def mean_mass(self) -> float:
        """Mean mass of a particle [kg]."""
        shares = self.number_shares()
        return sum(s * t.volume * t.density for s, t in zip(shares, self.templates, strict=True))


def distribution(deck: Deck, fix: Fix) -> None:
    """fix ID group particledistribution/discrete[/massbased|/numberbased] SEED N TEMPLATE SHARE ..."""
    words = Words(deck, fix.entry.command, fix.words)
    words.word("the seed")
    count = words.whole("the number of templates")
    templates, shares = [], []
    for _ in range(count):
        name = words.word("the name of a template")
        share = words.number(f"the share of {name}")
        found = deck.fixes.get(name)
        if found is None or not isinstance(found.data, Template):
            known = ", ".join(each.name for each in deck.fixes.values() if isinstance(each.data, Template))
            raise DeckError(
                fix.entry.command, f"there is no particle template {name}. Templates: {known or 'none'}."
            )
        templates.append(found.data)
        shares.append(share)
    if words or not shares or sum(shares) <= 0.0:
        raise DeckError(fix.entry.command, f"{count} templates with shares above 0 are expected.")
    by = "number" if fix.style.endswith("numberbased") else "mass"
    fix.data = Distribution(templates, shares, by, fix.entry)


# Insertions (LIGGGHTS)


@dataclass
class Insertion:
    """One insertion as the script gives it, in SI units; `None`: not given."""

    distribution: Distribution
    region: Region | None = None
    face: Fix | None = None
    count: float | None = None
    mass: float | None = None
    rate: float | None = None
    mass_rate: float | None = None
    fraction: float | None = None
    every: int | None = None
    """Steps between insertions; 0 for once."""
    start: int | None = None
    velocity: Vector = (0.0, 0.0, 0.0)
    fluctuation: Vector | None = None
    omega: Vector = (0.0, 0.0, 0.0)
    all_in: bool = False
    extrude: float = 0.0
    duration: int | None = None
    orientation: Any = "template"
    """Of multispheres: template, random, or a quaternion with the real part first."""
    notes: list[str] = field(default_factory=list)


def insertion(deck: Deck, fix: Fix) -> None:
    """fix ID group insert/pack|stream|rate/region seed N distributiontemplate ID KEYWORDS"""
    words = Words(deck, fix.entry.command, fix.words)
    found: Insertion | None = None
    given: dict[str, Any] = {}
    while words:
        key = words.word("a keyword")
        if key == "distributiontemplate":
            name = words.word("the name of a distribution")
            each = deck.fixes.get(name)
            if each is None or not isinstance(each.data, Distribution):
                raise DeckError(fix.entry.command, f"there is no fix particledistribution/discrete {name}.")
            found = Insertion(each.data)
        elif key == "region":
            given["region"] = region_of(deck, fix.entry.command, words.word("the name of a region"))
        elif key == "insertion_face":
            given["face"] = words.mesh_with_triangles()
        elif key in ("nparticles", "particles_in_region"):
            given["count"] = words.number_or_infinite("the number of particles", "number")
        elif key in ("mass", "mass_in_region"):
            given["mass"] = words.number_or_infinite("the mass", "mass")
        elif key == "particlerate":
            given["rate"] = words.number("the rate", "rate")
        elif key == "massrate":
            given["mass_rate"] = words.number("the mass rate", "mass_flow")
        elif key == "volumefraction_region":
            given["fraction"] = words.number("the volume fraction")
            if not 0.0 < given["fraction"] < 1.0:
                raise DeckError(
                    words.command,
                    f"the volume fraction is {given['fraction']:g}; give one below 1, such as 0.3.",
                )
        elif key == "insert_every":
            given["every"] = (
                0 if words.next == "once" and words.word("once") else words.whole("a number of steps")
            )
        elif key == "start":
            given["start"] = words.whole("the first step")
        elif key == "duration":
            given["duration"] = words.whole("the duration in steps")
        elif key == "extrude_length":
            given["extrude"] = words.number("the length", "length")
        elif key == "all_in":
            given["all_in"] = words.flag(key)
        elif key == "vel":
            style = words.word("constant, uniform or gaussian")
            given["velocity"] = words.vector("the velocity", "velocity")
            if style in ("uniform", "gaussian"):
                given["fluctuation"] = words.vector("the fluctuation", "velocity")
                scale = 1.0 if style == "gaussian" else 1.0 / sqrt(3.0)
                given["fluctuation"] = tuple(scale * each for each in given["fluctuation"])
            elif style != "constant":
                raise DeckError(fix.entry.command, f"vel is {style}; give constant, uniform or gaussian.")
        elif key == "omega":
            words.word("constant")
            given["omega"] = words.vector("the angular velocity", "angular_velocity")
        elif key == "orientation":
            style = words.word("random, template or constant")
            if style not in ("random", "template", "constant"):
                raise DeckError(
                    fix.entry.command, f"orientation is {style}; give random, template or constant."
                )
            given["orientation"] = [words.number("q") for _ in range(4)] if style == "constant" else style
        elif key == "overlapcheck":
            if not words.flag(key):
                fix.entry.approximated("particles are inserted without overlap")
        elif key == "set_property":
            fix.entry.impossible(f"the initial property {words.word('a property')}")
            words.number("its value")
        elif key in IGNORED:
            if words.word(f"a value of {key}") == "uncorrelated":
                fix.entry.approximated("the numbers of particles of each size are exact, not random")
        else:
            remedy = suggestion_sentence(key, [*KEYWORDS, *IGNORED], "keywords")
            raise DeckError(fix.entry.command, f"{fix.style} has no keyword {key}. {remedy}")
    if found is None:
        raise DeckError(fix.entry.command, "distributiontemplate is missing.")
    for key, value in given.items():
        setattr(found, key, value)
    fix.data = found


KEYWORDS = (
    *("distributiontemplate", "region", "insertion_face", "nparticles", "particles_in_region", "mass"),
    *("mass_in_region", "particlerate", "massrate", "volumefraction_region", "insert_every", "start"),
    *("duration", "extrude_length", "all_in", "vel", "omega", "orientation", "overlapcheck", "set_property"),
)
"""Keywords of insertions that are translated."""
IGNORED = (
    *(
        "seed",
        "verbose",
        "maxattempt",
        "random_distribute",
        "compress_tags",
        "check_dist_from_subdomain_border",
    ),
    *("ntry_mc", "parallel", "warn_boxentent", "warn_region"),
)
"""Keywords of insertions that have no counterpart because granflow does without."""


# Regions and faces of a scene


def volume_of(region: Region) -> float:
    """Volume [m3] of a block, cylinder or sphere; 0 for others."""
    n = region.numbers
    if region.kind == "block":
        return (n[1] - n[0]) * (n[3] - n[2]) * (n[5] - n[4])
    if region.kind == "cylinder":
        return pi * n[2] ** 2 * (n[4] - n[3])
    if region.kind == "sphere":
        return 4.0 / 3.0 * pi * n[3] ** 3
    if region.kind == "cone":
        return pi / 3.0 * (n[2] ** 2 + n[2] * n[3] + n[3] ** 2) * (n[5] - n[4])
    return 0.0


def extent_of(deck: Deck, region: Region) -> tuple[float, ...]:
    """Low and high of x, y and z of a region, within the box."""
    n = region.numbers
    box = deck.box or (-inf, inf) * 3
    if region.kind == "block":
        found = n
    elif region.kind in ("cylinder", "cone"):
        radius = n[2] if region.kind == "cylinder" else max(n[2], n[3])
        ends = n[-2:]
        center = {"x": (None, n[0], n[1]), "y": (n[0], None, n[1]), "z": (n[0], n[1], None)}[region.axis]
        found = tuple(each for c in center for each in (ends if c is None else (c - radius, c + radius)))
    elif region.kind == "sphere":
        found = tuple(each for c in n[:3] for each in (c - n[3], c + n[3]))
    else:
        found = box
    finite = []
    for k, each in enumerate(found):
        limit = box[k]
        finite.append(limit if each != each or abs(each) == inf else each)
    return tuple(finite)


def scene_region(deck: Deck, region: Region, entry: Entry, margin: float = 0.0) -> dict[str, Any]:
    """A region of the scene; `margin` [m] enlarges it, so that centers lie in the region of the script."""
    low_high = list(extent_of(deck, region))
    box = deck.box or (-inf, inf) * 3
    if not region.inside:
        entry.impossible("insertion outside a region", "a region with side in")
    if region.motion is not None:
        entry.impossible("insertion in a region that moves", "a region at rest")
    if region.kind not in ("block", "cylinder", "cone", "sphere"):
        entry.impossible(
            f"insertion in a region of the style {region.kind}", "a block, cylinder, cone or sphere"
        )
        return {"box": {"min": quantities(box[::2], "length"), "max": quantities(box[1::2], "length")}}
    if region.kind == "cylinder":
        k = "xyz".index(region.axis)
        others = [each for each in range(3) if each != k]
        ends = []
        bottom = max(low_high[2 * k] - margin, box[2 * k])
        for along in (bottom, min(low_high[2 * k + 1] + margin, box[2 * k + 1])):
            end = [0.0, 0.0, 0.0]
            end[k] = along
            end[others[0]], end[others[1]] = region.numbers[0], region.numbers[1]
            ends.append(quantities(end, "length"))
        room = [abs(region.numbers[i] - box[2 * k + side]) for i, k in enumerate(others) for side in (0, 1)]
        radius = quantity(max(region.numbers[2], min(region.numbers[2] + margin, *room)), "length")
        return {"cylinder": {"from": ends[0], "to": ends[1], "radius": radius}}
    if region.kind != "block":
        scale = 1.0
        volume = volume_of(region)
        if volume:
            around = np.prod([low_high[2 * k + 1] - low_high[2 * k] for k in range(3)])
            scale = float((volume / around) ** (1.0 / 3.0))
        for k in range(3):
            middle = 0.5 * (low_high[2 * k] + low_high[2 * k + 1])
            half = 0.5 * scale * (low_high[2 * k + 1] - low_high[2 * k])
            low_high[2 * k], low_high[2 * k + 1] = middle - half, middle + half
        entry.approximated(f"the {region.kind} is replaced by a box of the same volume")
    low = [max(each - margin, limit) for each, limit in zip(low_high[::2], box[::2], strict=True)]
    high = [min(each + margin, limit) for each, limit in zip(low_high[1::2], box[1::2], strict=True)]
    return {"box": {"min": quantities(low, "length"), "max": quantities(high, "length")}}


def face_of(mesh: Fix, velocity: Vector, entry: Entry) -> FlatFace:
    """The face of a stream from a flat mesh, with the normal along the velocity. Raises DeckError."""
    face = flat_face(mesh.data, np.array(velocity))
    if face is None:
        raise DeckError(entry.command, f"the mesh {mesh.name} is not flat; an insertion face must be flat.")
    if face.difference:
        entry.approximated(f"the face is replaced by a disc of the same area: {face.difference}")
    return face


# Groups from insertions


def collect(deck: Deck) -> None:
    """Make the groups of the scene from all insertions that act in a run."""
    before = len(deck.particles)
    for fix in deck.all_fixes:
        if isinstance(fix.data, Insertion) and deck.acting(fix):
            _insert(deck, fix, fix.data)
        elif isinstance(fix.data, Pour) and deck.acting(fix):
            _pour(deck, fix, fix.data)
    taken: set[str] = set()
    counts: dict[str, int] = {}
    for group in deck.particles[before:]:
        plain = group_name(group)
        while group_name(group) in taken:
            counts[plain] = counts.get(plain, 1) + 1
            group.name = f"{plain}_{counts[plain]}"
        taken.add(group_name(group))


def _sizes(distribution: Distribution, members: list[Template]) -> Any:
    """The key diameter of some templates of a distribution."""
    shares = dict(zip(map(id, distribution.templates), distribution.shares, strict=True))
    if len(members) == 1:
        if members[0].sizes is not None:
            return members[0].sizes
        return quantity(2.0 * members[0].radius, "length")
    fractions: dict[float, float] = {}
    for each in members:
        fractions[each.radius] = fractions.get(each.radius, 0.0) + shares[id(each)]
    classes = [
        {"diameter": quantity(2.0 * radius, "length"), "fraction": float(f"{share:.12g}")}
        for radius, share in fractions.items()
    ]
    if len(classes) == 1:
        return classes[0]["diameter"]
    return {"distribution": "classes", "by": distribution.by, "classes": classes}


def _window(deck: Deck, fix: Fix) -> tuple[float, float]:
    """First and last time [s] of a fix."""
    runs = deck.acting(fix)
    return runs[0].start, runs[-1].end


def _travel(gravity: Vector, velocity: Vector, time: float, extent: tuple[float, ...]) -> float:
    """Share of a region that particles leave in a time [s], falling freely from its velocity."""
    left = 1.0
    for k in range(3):
        way = abs(velocity[k] * time + 0.5 * gravity[k] * time**2)
        left *= max(0.0, 1.0 - way / max(extent[2 * k + 1] - extent[2 * k], 1e-300))
    return 1.0 - left


def _insert(deck: Deck, fix: Fix, given: Insertion) -> None:
    """The groups of one insertion of LIGGGHTS: one for each type and density of its templates, and for each
    size if the restitution depends on it."""
    kinds: dict[tuple[int, float, float], list[Template]] = {}
    plain = [each for each in given.distribution.templates if each.clump is None and each.sizes is None]
    by_size = is_by_size(deck) and len({each.radius for each in plain}) <= MOST_SIZES
    for each in given.distribution.templates:
        own = (each.radius if by_size else 0.0) if each in plain else id(each)  # a group of its own
        kinds.setdefault((each.type, each.density, own), []).append(each)
    numbers = given.distribution.number_shares()
    masses = [s * t.volume * t.density for s, t in zip(numbers, given.distribution.templates, strict=True)]
    for index, ((type, density, _), members) in enumerate(kinds.items()):
        chosen = [
            k
            for k, each in enumerate(given.distribution.templates)
            if any(each is member for member in members)
        ]
        share = sum(numbers[k] for k in chosen)
        mass_share = sum(masses[k] for k in chosen) / sum(masses)
        name = plain_name(fix.name if len(kinds) == 1 else f"{fix.name}_{index + 1}", "group")
        clump = members[0].clump
        if clump and given.orientation != "template":
            clump = {**clump, "orientation": _orientation(given.orientation)}
            fix.entry.translated(f"particles.{name}.clump.orientation")
        weights = [masses[k] for k in chosen]
        mean_radius = float(np.average([each.radius for each in members], weights=weights))
        amount = Amount(deck, fix, given, share, mass_share, mean_radius)
        keys: dict[str, Any] = {}
        keys |= {"clump": clump} if clump else {"diameter": _sizes(given.distribution, members)}
        if any(given.velocity):
            keys["velocity"] = list(given.velocity)
        if any(given.omega):
            keys["angular_velocity"] = list(given.omega)
        if given.fluctuation is not None:
            fix.entry.approximated(
                f"velocities fluctuate by {max(given.fluctuation):.3g} m/s in the script; here they are equal"
            )
        radii = [radius for each in members for radius in each.radii]
        for suffix, amounts, insert in amount.parts(min(radii)):
            group = ParticleGroup(
                f"{name}{suffix}",
                type,
                density,
                (min(radii), max(radii)),
                mean_radius,
                {**amounts, **keys, "insert": insert},
                (fix.entry,),
            )
            deck.particles.append(group)
        for each in members:
            each.entry.translated(f"particles.{name}")
        given.distribution.entry.translated(f"particles.{name}.diameter")


def _orientation(given: Any) -> Any:
    """The key orientation of clumps for `random`, or for a quaternion."""
    if given == "random":
        return given
    real, *axis = given
    length = hypot(*given)
    if not any(axis):
        return {"axis": [0, 0, 1], "angle": 0}
    return {"axis": axis, "angle": f"{degrees(2.0 * acos(real / length)):.12g} deg"}


@dataclass
class Amount:
    """How much of a part of an insertion enters where and when."""

    deck: Deck
    fix: Fix
    given: Insertion
    share: float
    mass_share: float
    mean_radius: float
    """Mean radius [m] by mass."""

    def parts(self, radius: float) -> list[tuple[str, dict[str, Any], dict[str, Any]]]:
        """Suffix of the group, its count or mass, and the key insert; `radius` [m] of the smallest "
        "particle."""
        given, fix = self.given, self.fix
        start, end = _window(self.deck, fix)
        if given.start is not None:
            start = max(start, start + (given.start - fix.step) * (self.deck.time_step or 0.0))
        if fix.style == "insert/pack":
            return self._pack(radius, start, end)
        if given.face is not None:
            face, delay = self._face(given.face)
            given.face.entry.translated(f"particles.{plain_name(fix.name, 'group')}.insert.face")
            flow = self._flow(start + delay, end + delay)  # what has appeared passes the mesh after `unfix`
            return [("", self._total(), {"kind": "inlet", "face": face, **flow})]
        keys = self._flow(start, end)
        if given.region is None:
            raise DeckError(fix.entry.command, f"{fix.style} needs a region or an insertion_face.")
        region = scene_region(self.deck, given.region, fix.entry, 0.0 if given.all_in else radius)
        given.region.entry.translated(f"particles.{plain_name(fix.name, 'group')}.insert.region")
        return [("", self._total(), {"kind": "rain", "region": region, **keys})]

    def _face(self, mesh: Fix) -> tuple[dict[str, Any], float]:
        """The face of the inlet, and the time [s] until the first particles of the script pass the mesh.

        In LIGGGHTS the center of a particle passes the mesh with the given velocity, anywhere on it (all_in
        no), after it has moved with constant velocity from at least a radius before it. In granflow a sphere
        lies downstream of the face: the face is moved back and enlarged by the mean radius.
        """
        given, deck, radius = self.given, self.deck, self.mean_radius
        face = face_of(mesh, given.velocity, self.fix.entry)
        speed = float(np.array(given.velocity) @ face.normal)
        if speed <= 0.0:
            raise DeckError(
                self.fix.entry.command, "the velocity has no component across the insertion face; give vel."
            )
        step = deck.time_step or 0.0
        every = (given.every or 0) * step or given.extrude / speed
        lasting = (given.duration or 0) * step or every
        self.fix.entry.approximated(
            f"particles appear at the face at a constant rate; the script has them up to "
            f"{lasting * speed:.3g} m before it, where they move with constant velocity, so that its counts "
            f"include up to {self._batch(every) / self.share:.0f} particles before the face"
            + (f", and a batch passes in {lasting:.3g} s of every {every:.3g} s" if lasting < every else "")
        )
        box = np.array(deck.box or (-inf, inf) * 3).reshape(3, 2)
        whole, face = face, face.within(box)
        if not np.allclose(whole.extent(), face.extent()):
            self.fix.entry.approximated(
                "the face is cut at the box, outside of which the script inserts nothing"
            )
        moved = face.moved(-min(radius, face.room(-face.normal, box)))
        return moved.enlarged(0.0 if given.all_in else radius, box).inlet(), radius / speed

    def _batch(self, every: float) -> float:
        """Particles of this part that the script inserts at once every `every` [s]."""
        given, distribution = self.given, self.given.distribution
        rate = given.rate or (given.mass_rate or 0.0) / distribution.mean_mass
        most = inf if given.count is None else given.count
        most = min(most, inf if given.mass is None else given.mass / distribution.mean_mass)
        return min(rate * every, most) * self.share

    def _total(self) -> dict[str, Any]:
        """The total count or mass; empty for an insertion without end."""
        given = self.given
        if given.count is not None:
            return {"count": max(1, round(given.count * self.share))}
        if given.mass is not None:
            return {"mass": quantity(given.mass * self.mass_share, "mass")}
        return {}

    def _flow(self, start: float, end: float) -> dict[str, Any]:
        """Rate, start and end of a flow."""
        given = self.given
        if given.mass_rate is not None:
            keys = {"mass_flow": quantity(given.mass_rate * self.mass_share, "mass_flow")}
        elif given.rate is not None:
            keys = {"rate": quantity(given.rate * self.share, "rate")}
        else:
            raise DeckError(self.fix.entry.command, f"{self.fix.style} needs particlerate or massrate.")
        return {**keys, **self._times(start, end)}

    def _times(self, start: float, end: float) -> dict[str, Any]:
        """Start and end where they differ from those of the run."""
        keys: dict[str, Any] = {}
        if start > 0.0:
            keys["start"] = quantity(start, "time")
        if end < self.deck.end * (1.0 - 1e-9):
            keys["end"] = quantity(end, "time")
        return keys

    def _pack(
        self, radius: float, start: float, end: float
    ) -> list[tuple[str, dict[str, Any], dict[str, Any]]]:
        """insert/pack once is a pack at the start; repeated, or later, it fills the region in batches."""
        given, deck, fix = self.given, self.deck, self.fix
        if given.region is None:
            raise DeckError(fix.entry.command, "insert/pack needs a region.")
        region = scene_region(deck, given.region, fix.entry, 0.0 if given.all_in else radius)
        given.region.entry.translated(f"particles.{plain_name(fix.name, 'group')}.insert.region")
        mean = given.distribution.mean_volume
        if given.fraction is not None:
            volume = volume_of(given.region) or _box_volume(extent_of(deck, given.region))
            count = given.fraction * volume / mean
        elif given.count is not None:
            count = given.count
        elif given.mass is not None:
            count = given.mass / given.distribution.mean_mass
        else:
            raise DeckError(
                fix.entry.command,
                "insert/pack needs particles_in_region, mass_in_region or volumefraction_region.",
            )
        most = self._saturation(given.region, count) / mean
        if count > most * (1.0 + 1e-9):  # beyond rounding
            fix.entry.approximated(
                f"{count:.0f} particles do not fit by random insertion, which in the script ends at about "
                f"{most:.0f} particles (by volume within 8 % of LIGGGHTS)"
            )
        target, count = count, min(count, most) * self.share
        first = {"count": max(1, round(count))}
        pack = {"kind": "pack", "region": region}
        step = deck.time_step or 0.0
        every = (given.every or 0) * step
        if start > 0.0:
            fix.entry.approximated("the particles enter within 10 ms, not in one step")
            parts: list[tuple[str, dict[str, Any], dict[str, Any]]]
            parts = [("", first, self._rain(region, count / 0.01, start))]
        else:
            parts = [("", first, pack)]
        batches = floor((end - start) / every + 1e-9) if every else 0
        if every and abs(start + batches * every - end) < 1e-9 * end:
            batches -= 1  # the script ends, or the fix, before the next insertion
        if batches <= 0:
            return parts
        extent = extent_of(deck, given.region)
        gravity = gravity_at(deck, deck.acting(fix)[0])
        leaving = _travel(gravity, given.velocity, every, extent)
        refills: list[float]
        if has_floor(deck, deck.acting(fix), extent, gravity, 2.0 * self.mean_radius):
            refills = self._refills_above_floor(count, target * self.share, leaving, batches, extent, gravity)
            numbers = ", ".join(map(str, refills)) or "none"
            fix.entry.approximated(
                f"refills of the region every {every:g} s are {numbers}: particles "
                f"stay above the floor of the region, until {round(target * self.share)} are in it"
            )
        else:
            refills = self._refills_in_fall(count, every, batches, extent, gravity)
            if leaving < 1.0:
                numbers = ", ".join(f"{each / self.share:.0f}" for each in refills[:MOST_BATCHES])
                fix.entry.approximated(
                    f"refills of the region every {every:g} s are {numbers} of {count / self.share:.0f} "
                    "particles: those that have left it by free fall since the one before"
                )
        if len(refills) <= MOST_BATCHES:
            for k, refill in enumerate(map(round, refills), 1):
                if not refill:
                    continue
                times = {"rate": refill / (BURST * every), "start": start + k * every}
                rain = self._rain(region, **times)
                rain["end"] = quantity(
                    start + (k + 0.5) * every, "time"
                )  # those without a place are given up
                parts.append((f"_{k + 1}", {"count": refill}, rain))
            if refills:
                fix.entry.approximated(f"a refill takes {BURST * every:.2g} s, not one step")
            return parts
        batches, total = len(refills), sum(refills)
        # Constant flow, in which a refill is spread over the interval around its time.
        first_time, last_time = start + 0.5 * every, start + (batches + 0.5) * every
        times = {"rate": total / (batches * every), "start": first_time}
        rain = self._rain(region, **times)
        if last_time < deck.end:
            rain["end"] = quantity(last_time, "time")
        fix.entry.approximated(f"{batches} refills every {every:g} s are a constant rate")
        return [*parts, ("_refill", {"count": max(1, round(total))}, rain)]

    def _refills_in_fall(
        self, first: float, every: float, batches: int, extent: tuple[float, ...], gravity: Vector
    ) -> list[float]:
        """Mean numbers of particles of the refills of a region that particles leave by free fall.

        A refill replaces those of all batches before that have left since the last one:

            n_k = sum_j n_j (F(k - j) - F(k - j - 1)),      F(i): share that leaves a region in i intervals
        """
        left = [0.0]
        while left[-1] < 1.0 and len(left) <= batches:
            left.append(max(left[-1], _travel(gravity, self.given.velocity, len(left) * every, extent)))
        from scipy.signal import lfilter  # its import takes a second, and few scripts refill a region

        at_start = np.eye(1, batches + 1)[0]
        counts: list[float] = lfilter([first], [1.0, *-np.diff(left)], at_start).tolist()
        return counts[1:]

    def _refills_above_floor(
        self,
        first: float,
        target: float,
        leaving: float,
        batches: int,
        extent: tuple[float, ...],
        gravity: Vector,
    ) -> list[float]:
        """Numbers of particles of the refills of a region that is closed below, until it has `target`.

        Random insertion fills what is above the particles at rest, whose side has no OVERHANG, and at most
        the share that the particles of the batch before have left, as it fills the whole region: with
        `first` particles.
        """
        region = self.given.region
        assert region is not None
        volume = self.given.distribution.mean_volume / (volume_of(region) or _box_volume(extent))
        sides = np.array([extent[2 * k + 1] - extent[2 * k] for k in range(3)])
        height = float(sides @ np.abs(gravity)) / float(np.linalg.norm(gravity))
        diameter = 2.0 * self.mean_radius
        overhang = OVERHANG * diameter
        inner = height - diameter * self.given.all_in
        present, refills = float(round(first)), list[float]()
        for _ in range(batches):
            filled = height * present * volume / AT_REST
            free = max(0.0, (inner - filled + 0.5 * overhang) / (inner + overhang))
            refill = round(min(first * min(leaving, free), target - present))
            if refill <= 0:
                break
            refills.append(refill)
            present += refill
        return refills

    def _saturation(self, region: Region, count: float) -> float:
        """Volume [m3] of particles at which random insertion of `count` particles into a region ends.

        LIGGGHTS inserts the largest particles first, and ends with the size of which some do not fit. Those
        of a radius r, which fill at most S(r) alone, and smaller ones take up

            n v < S(r) - sum_j [f + (1 - f) r / r_j] n_j v_j,      S = f product_k (l_k + 2 r h)

        f, h: MOST_FILLED, OVERHANG; l: sides of the box of their centers; r_j > r: inserted before.
        """
        extent = extent_of(self.deck, region)
        whole = _box_volume(extent)
        share_of_box = (volume_of(region) or whole) / whole
        sides = np.array([extent[2 * k + 1] - extent[2 * k] for k in range(3)])
        distribution = self.given.distribution
        sizes = zip(distribution.templates, distribution.number_shares(), strict=True)
        inserted: list[tuple[float, float]] = []
        for each, share in sorted(sizes, key=lambda size: -size[0].radius):
            diameter = 2.0 * each.radius
            inner = (sides - diameter * self.given.all_in).clip(min=0.0)
            room = MOST_FILLED * share_of_box * float(np.prod(inner + OVERHANG * diameter))
            room -= sum((MOST_FILLED + (1.0 - MOST_FILLED) * each.radius / r) * v for r, v in inserted)
            wanted = count * share * each.volume
            inserted.append((each.radius, min(wanted, max(room, 0.0))))
            if room < wanted:
                break
        return sum(volume for _, volume in inserted)

    @staticmethod
    def _rain(region: dict[str, Any], rate: float, start: float) -> dict[str, Any]:
        """The key insert of a rain."""
        rounded = float(f"{rate:.6g}")
        keys = {"kind": "rain", "region": region, "rate": quantity(rounded, "rate")}
        return {**keys, "start": quantity(start, "time")}


def _box_volume(extent: tuple[float, ...]) -> float:
    return (extent[1] - extent[0]) * (extent[3] - extent[2]) * (extent[5] - extent[4])


# pour (LAMMPS, and old LIGGGHTS)


@dataclass
class Pour:
    """A fix pour in SI units; diameters as (diameter, fraction by number), or a range."""

    count: int
    type: int
    region: Region
    diameters: list[tuple[float, float]]
    is_range: bool
    density: float
    fraction: float
    attempts: int
    """Of the code to place a particle of a batch, on average."""
    rate: float
    velocity: Vector
    """At the upper end of the region, in the mean."""
    step: float
    """Time step [s] at the line of the fix."""


def pour(deck: Deck, fix: Fix) -> None:
    """fix ID group pour N TYPE SEED region ID KEYWORDS"""
    words = Words(deck, fix.entry.command, fix.words)
    count, type = words.whole_between("the number of particles"), words.whole("the type")
    words.word("the seed")
    region: Region | None = None
    unit = deck.si(1.0, "length")
    diameters, is_range = [(unit, 1.0)], False
    densities = (deck.si(1.0, "density"),) * 2
    fraction, attempts, rate, velocity = 0.25, 50, 0.0, (0.0, 0.0, 0.0)
    while words:
        key = words.word("a keyword")
        if key == "region":
            region = region_of(deck, fix.entry.command, words.word("the name of a region"))
        elif key == "diam":
            style = words.next
            if style == "one":
                words.word(style)
                diameters, is_range = [(words.positive("the diameter", "length"), 1.0)], False
            elif style == "poly":
                words.word(style)
                number = words.whole("the number of diameters")
                diameters = [
                    (words.positive("a diameter", "length"), words.number("its fraction"))
                    for _ in range(number)
                ]
                is_range = False
            else:
                if style == "range":
                    words.word(style)
                diameters = [(words.positive("a diameter", "length"), 1.0) for _ in range(2)]
                is_range = diameters[0][0] < diameters[1][0]
                diameters = diameters if is_range else diameters[:1]
        elif key == "dens":
            densities = (words.positive("the density", "density"), words.positive("the density", "density"))
        elif key == "vol":
            fraction = words.positive("the volume fraction", "number")
            attempts = words.whole("the number of attempts")
        elif key == "rate":
            rate = words.number("the rate", "velocity")
        elif key == "vel":
            numbers = []
            while words and is_number(words.next):
                numbers.append(words.number("a velocity", "velocity"))
            if len(numbers) >= 5:
                velocity = (0.5 * sum(numbers[:2]), 0.5 * sum(numbers[2:4]), numbers[4])
                if numbers[0] != numbers[1] or numbers[2] != numbers[3]:
                    fix.entry.approximated(
                        "the horizontal velocities of the script are random; the mean is taken"
                    )
        elif key in ("mol", "rigid", "shake", "template"):
            fix.entry.impossible(f"pour of molecules ({key})", "clumps: particles.NAME.clump")
            words.word(f"a value of {key}")
        elif key in ("id", "units", "ignore", "molfrac"):
            if key in ("id", "units"):
                words.word(f"a value of {key}")
        else:
            raise DeckError(fix.entry.command, f"pour has no keyword {key}.")
    if region is None:
        raise DeckError(fix.entry.command, "pour needs a region.")
    if densities[0] != densities[1]:
        fix.entry.approximated(f"densities from {densities[0]:g} to {densities[1]:g}; the mean is taken")
    density = 0.5 * (densities[0] + densities[1])
    if region.kind != "block" and (region.kind, region.axis) != ("cylinder", "z"):
        raise DeckError(
            fix.entry.command,
            f"region {region.name} is a {region.kind}; pour requires a block or a cylinder along z.",
        )
    if region.motion is not None:
        fix.entry.impossible("pour from a region that moves", "a region at rest")
    if type < 1:
        fix.entry.impossible(f"pour of the type {type}", "an atom type from 1")
        return
    values = (diameters, is_range, density, fraction, attempts, rate, velocity, deck.step_here)
    fix.data = Pour(count, type, region, *values)


def _pour(deck: Deck, fix: Fix, given: Pour) -> None:
    """The group of a pour: an inlet at the lower end of the region.

    A batch of LAMMPS has fallen from the upper end of the region and is uniform in the time of the fall, so
    that it leaves the lower end at a constant rate and with one velocity. The next batch follows when the one
    before has left, after n steps with n dt = (w + sqrt(w^2 + 2 g h)) / g; w: velocity relative to a region
    that moves. LAMMPS takes dt at the line of the fix.
    """
    extent = extent_of(deck, given.region)
    gravity = gravity_at(deck, deck.acting(fix)[0])
    if not any(gravity):
        raise DeckError(
            fix.entry.command,
            "fix pour needs a fix gravity along -z, such as fix g all gravity 9.81 vector 0 0 -1.",
        )
    if gravity[2] >= 0.0 or max(map(abs, gravity[:2])) > 1e-6 * abs(gravity[2]):
        fix.entry.approximated("gravity is not along -z, for which the code refuses fix pour")
    g = hypot(*gravity)
    height = extent[5] - extent[4]
    down = max(0.0, -given.velocity[2])
    if given.rate:
        fix.entry.approximated("the region of the script moves with rate; here it is at rest")
    relative = given.velocity[2] - given.rate
    root = sqrt(relative**2 + 2.0 * g * height)
    fall = 2.0 * height / (root - relative) if relative < 0.0 else (relative + root) / g
    step = deck.acting(fix)[0].time_step
    interval = max(1, round(fall / given.step)) * step
    parts: list[tuple[float, Any, tuple[float, float], float]] = []
    if given.is_range:
        low, high = given.diameters[0][0], given.diameters[1][0]
        mean_cube = high**3  # a batch of LAMMPS is counted with the largest particle
        sizes: Any = {
            "distribution": "uniform",
            "min": quantity(low, "length"),
            "max": quantity(high, "length"),
        }
        radii = (0.5 * low, 0.5 * high)
        mean_radius = 0.4 * (high**5 - low**5) / (high**4 - low**4)  # of d^3, d from low to high
    else:
        total = sum(share for _, share in given.diameters)
        mean_cube = sum(share / total * d**3 for d, share in given.diameters)
        radii = (0.5 * min(given.diameters)[0], 0.5 * max(given.diameters)[0])
        mean_radius = 0.5 * sum(share / total * d**4 for d, share in given.diameters) / mean_cube
        sizes = quantity(given.diameters[0][0], "length")
        if 1 < len(given.diameters) <= MOST_SIZES and is_by_size(deck):  # a group for each size
            parts = [
                (share / total, quantity(d, "length"), (0.5 * d, 0.5 * d), 0.5 * d)
                for d, share in given.diameters
            ]
        elif len(given.diameters) > 1:
            classes = [{"diameter": quantity(d, "length"), "fraction": share} for d, share in given.diameters]
            sizes = {"distribution": "classes", "by": "number", "classes": classes}
    volume = volume_of(given.region) or _box_volume(extent)
    if given.region.kind == "block":  # LAMMPS takes at least one unit of length along y
        depth = extent[3] - extent[2]
        volume *= max(depth, deck.si(1.0, "length")) / depth
    requested = max(1, floor(given.fraction * volume / (pi / 6.0 * mean_cube)))
    requested = min(requested, given.count)
    batch = max(1.0, round(_pouring(given, extent, requested).batch()))
    if batch < 0.98 * requested:
        fix.entry.approximated(
            f"a batch has about {batch:.0f} particles, at which the code gives up to place {requested} "
            "(less insertions than requested); batches differ by about 10 %"
        )
    given.region.entry.translated(f"particles.{plain_name(fix.name, 'group')}.insert.face")
    start, end = _window(deck, fix)
    speed = sqrt(down**2 + 2.0 * g * height)
    if given.count <= batch:
        interval = fall
    whole = given.count if given.count <= batch else given.count // int(batch) * int(batch)
    flows = [(whole, min(whole, batch) / interval, start)]
    if whole < given.count:  # the last batch leaves as slowly as the others
        flows.append(
            (given.count - whole, (given.count - whole) / interval, start + whole / batch * interval)
        )
    fix.entry.approximated(
        "particles enter at the lower end of the region with the velocity of their fall, "
        f"{flows[0][1]:.4g} per s; in the script a batch of {min(batch, given.count):g} appears above it "
        f"every {interval:.3g} s"
    )
    if given.count > batch and abs(interval / fall - 1.0) > 0.05:
        fix.entry.approximated(
            f"LAMMPS counts this interval with the time step at the line of the fix, {given.step:g} s, so "
            f"that it is not the time of the fall, {fall:.3g} s; batches that overlap are smaller in LAMMPS"
        )
    face = _lower_end(deck, given.region, extent, sum(radii) / 2.0).inlet()
    velocity = quantities([*given.velocity[:2], -speed], "velocity")
    for number, (count, rate, begin) in enumerate(flows, 1):
        insert: dict[str, Any] = {"kind": "inlet", "face": face}
        if begin > 0.0:
            insert["start"] = quantity(begin, "time")
        if begin >= end:
            continue
        if begin + count / rate > end and end < deck.end:
            if any(abs(time - end) <= step for time in _stage_starts(deck)):
                insert["end"] = quantity(end, "time")
                left = count - rate * (end - begin)
                fix.entry.approximated(
                    f"about {left:.0f} particles that are in the region at {end:.6g} s, when a stage begins, "
                    "are left out"
                )
            else:  # the batches that have appeared fall out of the region
                appeared = ceil((end - begin) / interval) * min(batch, count)
                count = int(min(count, appeared))
        name = fix.name if number == 1 else f"{fix.name}_{number}"
        for share, diameter, extremes, mean in parts or [(1.0, sizes, radii, mean_radius)]:
            flow = quantity(float(f"{rate * share:.6g}"), "rate")
            values = {"count": max(1, round(count * share)), "diameter": diameter, "velocity": velocity}
            values["insert"] = {**insert, "rate": flow}
            sort = (given.type, given.density, extremes, mean)
            deck.particles.append(ParticleGroup(name, *sort, values, (fix.entry,)))


def _pouring(given: Pour, extent: tuple[float, ...], requested: int) -> Pouring:
    """The random insertion of one batch of the code."""
    radii = 0.5 * np.array([diameter for diameter, _ in given.diameters])
    shares = np.array([share for _, share in given.diameters])

    def draw(rng: np.random.Generator) -> float:
        return float(rng.uniform(*radii) if given.is_range else rng.choice(radii, p=shares / shares.sum()))

    is_block = given.region.kind == "block"
    sides = (extent[1] - extent[0], extent[3] - extent[2]) if is_block else None
    radius = 0.0 if is_block else given.region.numbers[2]
    height = extent[5] - extent[4]
    return Pouring(sides, radius, height, draw, float(radii.max()), requested, given.attempts)


def _stage_starts(deck: Deck) -> list[float]:
    """Times [s] at which stages begin, all commands being read."""

    def starts() -> list[float]:
        names = stage_names(deck)
        first = {name: deck.runs[index].start for index, name in reversed(names.items())}
        return list(first.values())

    return list(deck.own("stage_starts", starts))


def _lower_end(deck: Deck, region: Region, extent: tuple[float, ...], radius: float) -> FlatFace:
    """The face whose particles have their centers in the lower end of a region.

    It lies above it and is wider by a radius [m], as far as the box permits.
    """
    box = np.array(deck.box or (-inf, inf) * 3).reshape(3, 2)
    low, high = np.array(extent[::2]), np.array(extent[1::2])
    point, sides, wide = low, None, 0.0
    if region.kind == "cylinder":
        point, wide = np.array([*region.numbers[:2], low[2]]), region.numbers[2]
    else:
        sides = np.array([[0.0, high[1] - low[1], 0.0], [high[0] - low[0], 0.0, 0.0]])
    face = FlatFace(point, np.array([0.0, 0.0, -1.0]), sides, wide, float(np.max(high - low)))
    return face.moved(-min(radius, face.room(np.array([0.0, 0.0, 1.0]), box))).enlarged(radius, box)


# The block


def build(deck: Deck, draft: Draft) -> None:
    """Write the block particles, of one insertion the largest first, as LIGGGHTS inserts them: the others
    fill the space between them."""
    order = {id(entry): number for number, (entry, *_) in enumerate(each.entries for each in deck.particles)}
    for group in sorted(deck.particles, key=lambda each: (order[id(each.entries[0])], -each.radii[1])):
        keys = {"material": material_of(deck, group), **group.keys}
        draft.put(("particles", group_name(group)), keys, *group.entries)


def group_name(group: ParticleGroup) -> str:
    """Name of a group in the scene."""
    return plain_name(group.name, "group")


# Tables

COMMANDS: dict[str, Translation] = {
    "molecule": impossible("molecules", "clumps: particles.NAME.clump"),
}
FIXES: dict[str, Translation] = {
    "particletemplate/sphere": Translation(template_sphere, "particles.NAME.diameter"),
    "particledistribution/discrete": Translation(distribution, "particles.NAME.diameter (classes)"),
    "particledistribution/discrete/massbased": Translation(distribution, "particles.NAME.diameter (classes)"),
    "particledistribution/discrete/numberbased": Translation(
        distribution, "particles.NAME.diameter (classes)"
    ),
    "insert/pack": Translation(insertion, "insert: {kind: pack}", "repeated: pack and rain"),
    "insert/stream": Translation(insertion, "insert: {kind: inlet}"),
    "insert/rate/region": Translation(insertion, "insert: {kind: rain}"),
    **dict.fromkeys(
        ("pour", "pour/legacy"),
        Translation(
            pour, "insert: {kind: inlet}", "batches become a constant rate at the lower end of the region"
        ),
    ),
    "insert/stream/predefined": impossible(
        "insertions at times of a file", "insert: {kind: inlet}, one group for each time (start, end)"
    ),
    "insert/pack/dense": impossible(
        "packings that grow to a target fraction", "insert: {kind: pack}, then domain.deformation or a servo"
    ),
    "adapt": impossible("diameters that change", "a higher solid fraction by kind: pack (up to 0.55)"),
    "deposit": impossible("fix deposit", "insert: {kind: rain}"),
    "particletemplate/superquadric": impossible("superquadrics", "clumps: particles.NAME.clump"),
}
