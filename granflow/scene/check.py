"""Checks between the parts of a scene: names that must exist, pairs that must be there, times, places."""

import math
from collections.abc import Iterable, Iterator
from itertools import combinations_with_replacement, product

from granflow.quantities import FEED_QUANTITIES, LOAD_QUANTITIES, METER_QUANTITIES, OUTLET_QUANTITIES
from granflow.scene.check_analysis import expected_indices, field_grids, indices
from granflow.scene.check_domain import shear
from granflow.scene.document import KeyPath, Problem
from granflow.scene.draft import Draft
from granflow.scene.fields import Fault, Vector3
from granflow.scene.findings import Check, Finding, unknown
from granflow.scene.matter import RestitutionFit
from granflow.scene.places import BoxRegion, CylinderRegion, DiscFace, FromFile, Inlet, Listed, Rain, RectangleFace
from granflow.scene.schema import Plane, Scene, Stage, Wall
from granflow.scene.shapes import Free, Servo, Vibration
from granflow.scene.suggest import known_or_meant, nearest
from granflow.scene.words import problem_of

SEVERAL = 2
"""Particles taken to be in a group whose count is not known yet: they can touch each other."""

_AXES = "xyz"
_MOST = {
    "materials": 50, "pairs": 1275, "walls": 1000, "particles": 100, "outlets": 50, "stages": 1000, "expect": 1000
}  # fmt: skip
"""Entries of a section: what is worked out for every two of them must stay quick."""


def checked(draft: Draft) -> list[Problem]:
    """All that is wrong within and between the parts of the draft."""
    findings = list(draft.faults())
    crowded = list(_crowds(draft))
    findings += crowded
    for needed, check in _CHECKS if not crowded else ():
        if draft.whole.issuperset(needed):
            findings += check(draft)
    return [problem_of(draft.document, path, fault) for path, fault in findings]


def _crowds(draft: Draft) -> Iterator[Finding]:
    """Sections with more entries than a scene can hold."""
    for section, most in _MOST.items():
        node = draft.document.root.child(section)
        found = len(node.entries or node.items or ()) if node is not None else 0
        if found > most:
            yield (section,), Fault((), f"has {found} entries, but a scene holds at most {most} of them", whole=True)


def _materials(draft: Draft) -> Iterator[Finding]:
    known = draft.names("materials")
    for section in ("walls", "particles"):
        for name, part in getattr(draft.scene, section).items():
            if part.material not in known:
                yield unknown((section, name, "material"), part.material, known, "material")


def _some_particles(draft: Draft) -> Iterator[Finding]:
    node = draft.document.root.child("particles")
    if node is not None and node.entries == {}:
        yield ("particles",), Fault((), "at least one group of particles is needed")


def _pair_names(draft: Draft) -> Iterator[Finding]:
    """Pairs of materials that do not exist, and pairs given twice."""
    known = draft.names("materials")
    seen: dict[frozenset[str], str] = {}
    for key in draft.names("pairs"):
        both = key.split("-")
        for name in dict.fromkeys(both):
            if name not in known and len(both) == 2:
                remedy = known_or_meant(name, known, "materials")
                yield ("pairs", key), Fault((), f"names {name}, which is not under materials. {remedy}", whole=True)
        first = seen.setdefault(frozenset(both), key) if len(both) == 2 else key
        if first != key:
            line = draft.document.key_place(("pairs", first)).line
            there = f"at line {line} as {first}" if line else f"as {first}"
            yield ("pairs", key), Fault((), f"is given already {there}; keep one of them", whole=True)


def _missing_pairs(draft: Draft) -> Iterator[Finding]:
    known = draft.names("materials")
    there = {frozenset(nearest(name, known) or name for name in key.split("-")) for key in draft.names("pairs")}
    for both, why in _touching(draft.scene, known).items():
        if both not in there:
            key = "-".join(sorted(both) * (3 - len(both))) if len(both) == 1 else "-".join(sorted(both))
            reason = f"is missing: {why}; give at least its restitution and friction"
            yield ("pairs", key), Fault((), reason, whole=True)


def _touching(scene: Scene, known: Iterable[str]) -> dict[frozenset[str], str]:
    """The pairs of materials that can touch, with the reason."""
    names = set(known)
    grains, fixed = _counts(scene, names, fixed=False), _counts(scene, names, fixed=True)
    found: dict[frozenset[str], str] = {}
    for a, b in combinations_with_replacement(grains, 2):
        if a != b or grains[a] > 1:
            found[frozenset((a, b))] = f"particles of {a} can touch " + (
                f"particles of {b}" if a != b else "each other"
            )
    for a, b in product(grains, fixed):
        found.setdefault(frozenset((a, b)), f"particles of {a} can touch fixed ones of {b}")
    for name, wall in scene.walls.items():
        for grain in grains if wall.material in names else ():
            found.setdefault(
                frozenset((grain, wall.material)), f"particles of {grain} can touch the wall {name} of {wall.material}"
            )
    return found


def _counts(scene: Scene, names: set[str], fixed: bool) -> dict[str, int]:
    """How many fixed particles, or others, there are of each of these materials."""
    found: dict[str, int] = {}
    for group in scene.particles.values():
        if group.material in names and group.fixed == fixed:
            found[group.material] = found.get(group.material, 0) + (group.count_asked or SEVERAL)
    return found


def _friction(draft: Draft) -> Iterator[Finding]:
    """Friction where there is a law for it, and only there."""
    contact = draft.scene.contact
    for key, pair in draft.scene.pairs.items():
        rolling = ("pairs", key, "rolling_friction")
        if pair.friction > 0 and contact.tangential == "none":
            yield ("pairs", key, "friction"), Fault((), "contact.tangential is none; write 0, or choose mindlin")
        if pair.rolling_friction is None and contact.rolling != "none":
            reason = f"is missing: contact.rolling is {contact.rolling}; give the coefficient, 0 for none"
            yield rolling, Fault((), reason, whole=True)
        if pair.rolling_friction and contact.rolling == "none":
            yield rolling, Fault((), "contact.rolling is none; leave it out, or choose epsd or cdt")


def _cohesion(draft: Draft) -> Iterator[Finding]:
    """A cohesion energy density in every pair where there is adhesion, and only there."""
    adhesion = draft.scene.contact.adhesion
    for key, pair in draft.scene.pairs.items():
        path: KeyPath = ("pairs", key, "cohesion_energy_density")
        if adhesion == "none" and pair.cohesion_energy_density is not None:
            yield path, Fault((), "contact.adhesion is none; leave it out, or choose sjkr")
        if adhesion != "none" and pair.cohesion_energy_density is None:
            reason = f"is missing: contact.adhesion is {adhesion}; give it in J/m3, 0 for none"
            yield path, Fault((), reason, whole=True)


def _restitution(draft: Draft) -> Iterator[Finding]:
    """A restitution that the normal law can give, or none where it follows from the materials."""
    normal = draft.scene.contact.normal
    for key, pair in draft.scene.pairs.items():
        path: KeyPath = ("pairs", key, "restitution")
        if normal.kind.restitution == "nothing":
            if pair.restitution is not None:
                yield path, Fault((), f"the law {normal.law} has it from the materials; leave it out")
            elif not _yielding(draft, key):
                names = " or ".join(dict.fromkeys(key.split("-")))
                reason = f"needs a yield strength for the law {normal.law}: give the yield_strength of {names}"
                yield ("pairs", key), Fault((), reason, whole=True)
        elif pair.restitution is None:
            yield path, Fault((), "is missing: restitution coefficient, a number in [0, 1]", whole=True)
        elif isinstance(pair.restitution, RestitutionFit):
            yield from _fit(draft, key, pair.restitution)
        elif pair.restitution == 0 and normal.kind.restitution == "positive number":
            yield path, Fault((), f"the law {normal.law} needs a number above 0 and at most 1")


def _yielding(draft: Draft, key: str) -> bool:
    """Whether one of the materials of a pair has a yield strength; True where one is not sound itself."""
    materials = draft.scene.materials
    return any(name not in materials or materials[name].yield_strength for name in key.split("-"))


def _fit(draft: Draft, key: str, fit: RestitutionFit) -> Iterator[Finding]:
    """Restitution by Eq. 12 where the law takes it."""
    normal, path = draft.scene.contact.normal, ("pairs", key, "restitution")
    settings = normal.settings()
    fixed = [name for name, word in normal.fixed_by_numbers().items() if settings[name] == word]
    if normal.kind.restitution != "number or fit":
        yield path, Fault((), f"the law {normal.law} needs a number, above 0 and at most 1")
    elif fixed:
        reason = f"contact.normal.{fixed[0]} is {settings[fixed[0]]}, which needs a number; or write onset or peak"
        yield path, Fault((), reason)
    else:
        yield from _limit_velocity(draft, key, fit)


def _limit_velocity(draft: Draft, key: str, fit: RestitutionFit) -> Iterator[Finding]:
    materials = draft.scene.materials
    soft = [name for name in dict.fromkeys(key.split("-")) if name in materials and not materials[name].yield_strength]
    if fit.limit_velocity is None and soft:
        reason = f"has no limit velocity: give limit_velocity, or the yield_strength of {' and '.join(soft)} (Eq. 11)"
        yield ("pairs", key, "restitution"), Fault((), reason, whole=True)


def _stage_names(draft: Draft) -> Iterator[Finding]:
    """Each stage once, and only those that exist."""
    names = [stage.name for stage in _schedule(draft)]
    for index, name in enumerate(names):
        if name in names[:index]:
            reason = f"that name is taken by stages.{names.index(name)}; give each stage its own"
            yield ("stages", index, "name"), Fault((), reason)
    for wall_name, wall in draft.scene.walls.items():
        for path, wanted in _stages_wanted(wall):
            for index, name in enumerate(wanted):
                if name in names:
                    continue
                place = ("walls", wall_name, *path, "stages", index)
                if draft.scene.stages:
                    yield unknown(place, name, names, "stage")
                else:
                    yield place, Fault((), "the scene has no stages; give times instead of stages")


def _schedule(draft: Draft) -> tuple[Stage, ...]:
    return draft.scene.stages or (Stage(name="run"),)


def _stages_wanted(wall: Wall) -> Iterator[tuple[KeyPath, tuple[str, ...]]]:
    yield (), wall.stages or ()
    for index, motion in enumerate(wall.motion):
        yield ("motion", index), motion.stages or ()


def _duration(draft: Draft) -> Iterator[Finding]:
    """A duration of the run, or stages with their own."""
    duration = draft.scene.run.duration
    if duration is None and not draft.scene.stages:
        yield ("run", "duration"), Fault((), "is missing: the simulated time, such as 2 s; or give stages", whole=True)
    if duration is not None and draft.scene.stages:
        yield ("run", "duration"), Fault((), "the stages have durations of their own; drop run.duration")


def _gamma(draft: Draft) -> Iterator[Finding]:
    """Gamma means nothing without gravity."""
    if any(draft.scene.gravity):
        return
    for name, wall in draft.scene.walls.items():
        for index, motion in enumerate(wall.motion):
            if isinstance(motion, Vibration) and motion.gamma is not None:
                path = ("walls", name, "motion", index, "gamma")
                yield path, Fault((), "gravity is zero; give amplitude and frequency")


def _regions(draft: Draft) -> Iterator[Finding]:
    """Particles begin inside the domain."""
    low, high = draft.scene.domain.min, draft.scene.domain.max
    for name, group in draft.scene.particles.items():
        path: KeyPath = ("particles", name, "place")
        if isinstance(group.place, Listed):
            for index, point in enumerate(group.place.positions):
                if not all(a <= x <= b or b <= a for a, x, b in zip(low, point, high, strict=True)):
                    yield (*path, "positions", index), Fault((), "it lies outside the domain")
        if isinstance(group.place, Listed | FromFile):
            continue
        key = "face" if isinstance(group.place, Inlet) else "region"
        for axis, (a, b) in enumerate(zip(*_extent(getattr(group.place, key)), strict=True)):
            if low[axis] < high[axis] and (a < low[axis] or b > high[axis]):
                reach = f"reaches from {a:.4g} to {b:.4g} m in {_AXES[axis]}"
                reason = f"{reach}, outside the domain, {low[axis]:g} to {high[axis]:g} m"
                yield (*path, key), Fault((), reason, whole=True)


def _extent(region: BoxRegion | CylinderRegion | RectangleFace | DiscFace) -> tuple[Vector3, Vector3]:
    """Smallest and largest coordinates of a region or a face [m]."""
    if isinstance(region, BoxRegion):
        return region.box.min, region.box.max
    if isinstance(region, RectangleFace):
        corner, (first, second) = region.rectangle.corner, region.rectangle.sides
        sides = [(c, c + p, c + q, c + p + q) for c, p, q in zip(corner, first, second, strict=True)]
        return tuple(map(min, sides)), tuple(map(max, sides))  # type: ignore[return-value]
    if isinstance(region, DiscFace):
        a, axis, radius = region.disc.center, region.disc.normal, region.disc.radius
        b = a
    else:
        a, b, radius = region.cylinder.from_, region.cylinder.to, region.cylinder.radius
        axis = tuple(q - p for p, q in zip(a, b, strict=True))  # type: ignore[assignment]
    length = math.hypot(*axis) or 1.0
    reach = [radius * math.sqrt(max(0.0, 1 - (along / length) ** 2)) for along in axis]
    low = tuple(min(p, q) - r for p, q, r in zip(a, b, reach, strict=True))
    high = tuple(max(p, q) + r for p, q, r in zip(a, b, reach, strict=True))
    return low, high  # type: ignore[return-value]


def _counted(scene: Scene) -> list[str]:
    """Names of flow meters, and of what each counts by itself, as `outlet.glass`."""
    names = scene.output.meters
    return [*names, *(f"{name}.{part}" for name in names for part in scene.meter_parts(name))]


def _parts(draft: Draft) -> Iterator[Finding]:
    """Expectations of flow meters, outlets and groups that exist."""
    known: tuple[tuple[Iterable[str], Iterable[str], str], ...] = (
        (METER_QUANTITIES, _counted(draft.scene), "meter"),
        (OUTLET_QUANTITIES, draft.names("outlets"), "outlet"),
        (FEED_QUANTITIES, _coming_in(draft), "stream"),
    )
    for index, expectation in enumerate(draft.scene.expect):
        quantity, dot, part = expectation.quantity.partition(".")
        for quantities, names, kind in known if dot else ():
            if quantity in quantities and part not in names:
                yield unknown(("expect", index, "quantity"), part, names, kind)


def _coming_in(draft: Draft) -> list[str]:
    return [name for name, group in draft.scene.particles.items() if isinstance(group.place, Rain | Inlet)]


def _loads(draft: Draft) -> Iterator[Finding]:
    """Loads of walls that exist, expectations of loads that are measured, pressures where there is an area."""
    asked, known = draft.scene.output.loads, draft.names("walls")
    measured = known if asked is True else asked or ()
    for index, name in enumerate(() if isinstance(asked, bool) else asked):
        if name not in known:
            yield unknown(("output", "loads", index), name, known, "wall")
    for index, expectation in enumerate(draft.scene.expect):
        quantity, dot, wall = expectation.quantity.partition(".")
        path: KeyPath = ("expect", index, "quantity")
        if not dot or quantity not in LOAD_QUANTITIES:
            continue
        if wall not in known:
            yield unknown(path, wall, known, "wall")
        elif wall not in measured:
            yield path, Fault((), f"output.loads does not ask for {wall}; write loads: true, or add it to the list")
        elif "pressure" in quantity and isinstance(draft.scene.walls.get(wall), Plane):
            yield path, Fault((), f"the plane {wall} has no end and so no area; ask for wall_force_z or the like")


def _driven(draft: Draft) -> Iterator[Finding]:
    """Pressures of walls with an area; and a step that stays the same."""
    driven = [
        (("walls", name, "motion", index), wall, motion)
        for name, wall in draft.scene.walls.items()
        for index, motion in enumerate(wall.motion)
        if isinstance(motion, Servo | Free)
    ]
    for path, wall, motion in driven:
        if isinstance(motion, Servo) and motion.pressure is not None and isinstance(wall, Plane):
            yield (*path, "pressure"), Fault((), "a plane has no end and so no area; give force, or take a rectangle")
    if driven and draft.scene.run.time_step == "adaptive":
        path, _, motion = driven[0]
        reason = f"walls.{path[1]} is {motion.kind}, which needs a step that stays the same; write auto"
        yield ("run", "time_step"), Fault((), reason)


_CHECKS: tuple[tuple[tuple[str, ...], Check], ...] = (
    ((), _materials),
    ((), _some_particles),
    ((), _pair_names),
    (("particles",), _missing_pairs),
    (("contact",), _friction),
    (("contact",), _cohesion),
    (("contact",), _restitution),
    (("stages",), _stage_names),
    (("stages", "run"), _duration),
    (("gravity",), _gamma),
    (("domain",), _regions),
    (("domain", "particles", "output"), shear),
    (("output", "expect"), _parts),
    (("output", "stages", "domain"), field_grids),
    (("output", "gravity", "domain"), indices),
    (("output", "expect"), expected_indices),
    (("output", "expect"), _loads),
    (("run",), _driven),
)
