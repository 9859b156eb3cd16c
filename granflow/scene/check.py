"""Consistency checks between the parts of a scene: names, material pairs, times, regions.

Each check is a function from a `PartialScene` to violations: (key path, fault). `_CHECKS` lists the sections that must
be complete before a check runs, so that one mistake does not cause consequential messages.
"""

import math
from collections.abc import Iterable, Iterator
from itertools import combinations_with_replacement, product

from granflow.contact import registry
from granflow.contact.options import FRICTION
from granflow.fields import FLOW_METER_QUANTITIES, INSERTION_QUANTITIES, OUTLET_QUANTITIES, WALL_FORCE_QUANTITIES
from granflow.scene.check_analysis import expected_metrics, field_grids, metrics
from granflow.scene.check_lees_edwards import lees_edwards
from granflow.scene.document import KeyPath, Problem
from granflow.scene.messages import problem_at
from granflow.scene.schema.fields import Fault, Vector3
from granflow.scene.schema.insertion import (
    BoxRegion,
    CylinderRegion,
    DiscFace,
    FileInsertion,
    InletInsertion,
    PositionsInsertion,
    RainInsertion,
    RectangleFace,
)
from granflow.scene.schema.materials import RestitutionFit
from granflow.scene.schema.scene import Plane, Scene, Stage, Wall
from granflow.scene.schema.walls import FreeWallSpec, ServoSpec, VibrationSpec
from granflow.scene.suggest import nearest, suggestion_or_list
from granflow.scene.validation import PartialScene
from granflow.scene.violations import Check, Violation, unknown

ASSUMED_COUNT = 2
"""Assumed number of particles of a group without a known count: enough for contacts within the group."""

_AXES = "xyz"
_MAX_ENTRIES = {
    "materials": 50, "pairs": 1275, "walls": 1000, "particles": 100, "outlets": 50, "stages": 1000, "expect": 1000
}  # fmt: skip
"""Largest number of entries of each section: the cost of some checks grows with its square."""


def checked(scene_parts: PartialScene) -> list[Problem]:
    """All problems within and between the parts of a scene that may be incomplete.

    The problems are not sorted. If a section has too many entries, checks between parts are omitted, because the time
    of some of them grows with the square of the number of entries.
    """
    violations = list(scene_parts.faults())
    overfull = list(_overfull_sections(scene_parts))
    violations += overfull
    for needed, check in _CHECKS if not overfull else ():
        if scene_parts.complete.issuperset(needed):
            violations += check(scene_parts)
    return [problem_at(scene_parts.document, path, fault) for path, fault in violations]


def _overfull_sections(scene_parts: PartialScene) -> Iterator[Violation]:
    """Violations for sections with more entries than _MAX_ENTRIES."""
    for section, max_entries in _MAX_ENTRIES.items():
        node = scene_parts.document.root.child(section)
        found = len(node.entries or node.items or ()) if node is not None else 0
        if found > max_entries:
            yield (
                (section,),
                Fault((), f"has {found} entries, but the limit is {max_entries}", whole=True),
            )


def _materials(scene_parts: PartialScene) -> Iterator[Violation]:
    """Materials of walls and groups must exist."""
    known = scene_parts.names("materials")
    for section in ("walls", "particles"):
        for name, part in getattr(scene_parts.scene, section).items():
            if part.material not in known:
                yield unknown((section, name, "material"), part.material, known, "material")


def _some_particles(scene_parts: PartialScene) -> Iterator[Violation]:
    """At least one group of particles must be given."""
    node = scene_parts.document.root.child("particles")
    if node is not None and node.entries == {}:
        yield ("particles",), Fault((), "at least one group of particles is required")


def _pair_names(scene_parts: PartialScene) -> Iterator[Violation]:
    """Pairs of unknown materials, and duplicate pairs.

    A-B and B-A are the same pair.
    """
    known = scene_parts.names("materials")
    seen: dict[frozenset[str], str] = {}
    for key in scene_parts.names("pairs"):
        both = key.split("-")
        for name in dict.fromkeys(both):
            if name not in known and len(both) == 2:
                remedy = suggestion_or_list(name, known, "materials")
                yield ("pairs", key), Fault((), f"names {name}, which is not under materials. {remedy}", whole=True)
        first = seen.setdefault(frozenset(both), key) if len(both) == 2 else key
        if first != key:
            line = scene_parts.document.key_position(("pairs", first)).line
            existing = f"{first} at line {line}" if line else first
            yield ("pairs", key), Fault((), f"is a duplicate of the pair {existing}; keep one of them", whole=True)


def _missing_pairs(scene_parts: PartialScene) -> Iterator[Violation]:
    """Each two materials that can come into contact must have an entry under `pairs`.

    A pair with a misspelled name counts as the one with the closest known name: another check reports it.
    """
    known = scene_parts.names("materials")
    existing = {
        frozenset(nearest(name, known) or name for name in key.split("-")) for key in scene_parts.names("pairs")
    }
    for both, why in _possible_contacts(scene_parts.scene, known).items():
        if both not in existing:
            key = "-".join(sorted(both) * (3 - len(both))) if len(both) == 1 else "-".join(sorted(both))
            reason = f"is missing: {why}; give at least its restitution and friction"
            yield ("pairs", key), Fault((), reason, whole=True)


def _possible_contacts(scene: Scene, known: Iterable[str]) -> dict[frozenset[str], str]:
    """Material pairs whose particles or walls can come into contact, with the reason.

    Fixed particles touch neither each other nor walls; a material with a single particle does not touch itself.
    """
    names = set(known)
    mobile, fixed = _counts(scene, names, fixed=False), _counts(scene, names, fixed=True)
    found: dict[frozenset[str], str] = {}
    for a, b in combinations_with_replacement(mobile, 2):
        if a != b or mobile[a] > 1:
            found[frozenset((a, b))] = f"particles of {a} can touch " + (
                f"particles of {b}" if a != b else "each other"
            )
    for a, b in product(mobile, fixed):
        found.setdefault(frozenset((a, b)), f"particles of {a} can touch fixed ones of {b}")
    for name, wall in scene.walls.items():
        for mobile_material in mobile if wall.material in names else ():
            found.setdefault(
                frozenset((mobile_material, wall.material)),
                f"particles of {mobile_material} can touch the wall {name} of {wall.material}",
            )
    return found


def _counts(scene: Scene, names: set[str], fixed: bool) -> dict[str, int]:
    """Number of fixed particles, or of mobile ones, for each of these materials.

    A group with a mass or an end time in place of a count is assumed to have ASSUMED_COUNT particles.
    """
    found: dict[str, int] = {}
    for group in scene.particles.values():
        if group.material in names and group.fixed == fixed:
            found[group.material] = found.get(group.material, 0) + (group.count_given or ASSUMED_COUNT)
    return found


def _pair_options(scene_parts: PartialScene) -> Iterator[Violation]:
    """Keys of pairs require the contact model that declares them, and vice versa."""
    contact = scene_parts.scene.contact
    for key, pair in scene_parts.scene.pairs.items():
        for option in registry.pair_options().values():
            path: KeyPath = ("pairs", key, option.key)
            value, known = getattr(pair, option.key), registry.models_with(option.key)
            users = {slot: contact.name(slot) for slot, names in known.items() if contact.name(slot) in names}
            if users and value is None:
                slot, name = next(iter(users.items()))
                yield path, Fault((), f"is missing: contact.{slot} is {name}; {option.remedy}", whole=True)
            elif value and not users:
                slot, names = next(iter(known.items()))
                remedy = "write 0" if option.key == FRICTION.key else f"remove {option.key}"
                reason = f"contact.{slot} is {contact.name(slot)}; {remedy}, or choose {' or '.join(names)}"
                yield path, Fault((), reason)


def _restitution(scene_parts: PartialScene) -> Iterator[Violation]:
    """Restitution in the form that the normal contact model requires; none if it follows from the materials.

    The forms are: nothing, a number, a positive number, a number or a fit (`ContactModel.restitution`).
    """
    normal = scene_parts.scene.contact.normal
    for key, pair in scene_parts.scene.pairs.items():
        path: KeyPath = ("pairs", key, "restitution")
        if normal.record.restitution == "nothing":
            if pair.restitution is not None:
                yield path, Fault((), f"the contact model {normal.law} derives it from the materials; remove it")
            elif not _has_yield_strength(scene_parts, key):
                names = " or ".join(dict.fromkeys(key.split("-")))
                reason = f"requires a yield strength (contact model {normal.law}): give the yield_strength of {names}"
                yield ("pairs", key), Fault((), reason, whole=True)
        elif pair.restitution is None:
            yield path, Fault((), "is missing: restitution coefficient, a number in [0, 1]", whole=True)
        elif isinstance(pair.restitution, RestitutionFit):
            yield from _restitution_fit(scene_parts, key, pair.restitution)
        elif pair.restitution == 0 and normal.record.restitution == "positive number":
            yield path, Fault((), f"the contact model {normal.law} requires a number above 0 and at most 1")


def _has_yield_strength(scene_parts: PartialScene, key: str) -> bool:
    """Whether one of the materials of a pair has a yield strength; True if one of the materials is invalid."""
    materials = scene_parts.scene.materials
    return any(name not in materials or materials[name].yield_strength for name in key.split("-"))


def _restitution_fit(scene_parts: PartialScene, key: str, fit: RestitutionFit) -> Iterator[Violation]:
    """A restitution fit (Eq. 12) is valid only with a contact model that accepts it."""
    normal, path = scene_parts.scene.contact.normal, ("pairs", key, "restitution")
    settings = normal.settings()
    fixed = [name for name, word in normal.fixed_by_numbers().items() if settings[name] == word]
    if normal.record.restitution != "number or fit":
        yield path, Fault((), f"the contact model {normal.law} requires a number, above 0 and at most 1")
    elif fixed:
        words = [word for word in normal.words(fixed[0]) if word != settings[fixed[0]]]
        reason = f"contact.normal.{fixed[0]} is {settings[fixed[0]]}, which requires a number; "
        yield path, Fault((), f"{reason}or write {' or '.join(words)}")
    else:
        yield from _limit_velocity(scene_parts, key, fit)


def _limit_velocity(scene_parts: PartialScene, key: str, fit: RestitutionFit) -> Iterator[Violation]:
    """A restitution fit without a limit velocity requires the yield strengths of its materials (Zhou 2011, Eq. 11)."""
    materials = scene_parts.scene.materials
    without_yield = [
        name for name in dict.fromkeys(key.split("-")) if name in materials and not materials[name].yield_strength
    ]
    if fit.limit_velocity is None and without_yield:
        reason = (
            f"has no limit velocity: give limit_velocity, or the yield_strength of "
            f"{' and '.join(without_yield)} (Zhou 2011, Eq. 11)"
        )
        yield ("pairs", key, "restitution"), Fault((), reason, whole=True)


def _stage_names(scene_parts: PartialScene) -> Iterator[Violation]:
    """Unique stage names, and references to existing stages only.

    Walls and their motions refer to stages by name.
    """
    names = [stage.name for stage in _schedule(scene_parts)]
    for index, name in enumerate(names):
        if name in names[:index]:
            reason = f"stages.{names.index(name)} has the same name; give each stage a different name"
            yield ("stages", index, "name"), Fault((), reason)
    for wall_name, wall in scene_parts.scene.walls.items():
        for path, wanted in _stages_wanted(wall):
            for index, name in enumerate(wanted):
                if name in names:
                    continue
                location = ("walls", wall_name, *path, "stages", index)
                if scene_parts.scene.stages:
                    yield unknown(location, name, names, "stage")
                else:
                    yield location, Fault((), "the scene has no stages; give times instead of stages")


def _schedule(scene_parts: PartialScene) -> tuple[Stage, ...]:
    """The stages of the scene; without stages, the single stage "run"."""
    return scene_parts.scene.stages or (Stage(name="run"),)


def _stages_wanted(wall: Wall) -> Iterator[tuple[KeyPath, tuple[str, ...]]]:
    """Key path and names of the stages of a wall and of each of its motions."""
    yield (), wall.stages or ()
    for index, motion in enumerate(wall.motion):
        yield ("motion", index), motion.stages or ()


def _duration(scene_parts: PartialScene) -> Iterator[Violation]:
    """Exactly one of `run.duration` and `stages` must be given."""
    duration = scene_parts.scene.run.duration
    if duration is None and not scene_parts.scene.stages:
        yield ("run", "duration"), Fault((), "is missing: give the simulated time, such as 2 s, or stages", whole=True)
    if duration is not None and scene_parts.scene.stages:
        yield ("run", "duration"), Fault((), "the stages have durations; remove run.duration")


def _gamma_needs_gravity(scene_parts: PartialScene) -> Iterator[Violation]:
    """Gamma, the peak acceleration over gravity, requires gravity."""
    if any(scene_parts.scene.gravity):
        return
    for name, wall in scene_parts.scene.walls.items():
        for index, motion in enumerate(wall.motion):
            if isinstance(motion, VibrationSpec) and motion.gamma is not None:
                path = ("walls", name, "motion", index, "gamma")
                yield path, Fault((), "gravity is zero; give amplitude and frequency")


def _regions(scene_parts: PartialScene) -> Iterator[Violation]:
    """Initial positions and insertion regions must lie inside the domain.

    Centers only: a particle may extend beyond the domain. Inverted domains are reported by another check.
    """
    low, high = scene_parts.scene.domain.min, scene_parts.scene.domain.max
    for name, group in scene_parts.scene.particles.items():
        path: KeyPath = ("particles", name, "insert")
        if isinstance(group.insert, PositionsInsertion):
            for index, point in enumerate(group.insert.positions):
                if not all(a <= x <= b or b <= a for a, x, b in zip(low, point, high, strict=True)):
                    yield (*path, "positions", index), Fault((), "it lies outside the domain")
        if isinstance(group.insert, PositionsInsertion | FileInsertion):
            continue
        key = "face" if isinstance(group.insert, InletInsertion) else "region"
        for axis, (a, b) in enumerate(zip(*_extent(getattr(group.insert, key)), strict=True)):
            if low[axis] < high[axis] and (a < low[axis] or b > high[axis]):
                reach = f"reaches from {a:.4g} to {b:.4g} m in {_AXES[axis]}"
                reason = f"{reach}, outside the domain, {low[axis]:g} to {high[axis]:g} m"
                yield (*path, key), Fault((), reason, whole=True)


def _extent(region: BoxRegion | CylinderRegion | RectangleFace | DiscFace) -> tuple[Vector3, Vector3]:
    """Smallest and largest coordinates (3,), (3,) [m] of a region or a face.

    For a cylinder with the unit axis a, a radius R extends by R sqrt(1 - a_k^2) along axis k from each end.
    """
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


def _flow_meter_names(scene: Scene) -> list[str]:
    """Names of flow meters and of their separate counts per material or group, such as `outlet.glass`."""
    names = scene.output.flow_meters
    return [*names, *(f"{name}.{part}" for name in names for part in scene.flow_meter_parts(name))]


def _parts(scene_parts: PartialScene) -> Iterator[Violation]:
    """Expectations must refer to existing flow meters, outlets and inserted groups."""
    known: tuple[tuple[Iterable[str], Iterable[str], str], ...] = (
        (FLOW_METER_QUANTITIES, _flow_meter_names(scene_parts.scene), "flow meter"),
        (OUTLET_QUANTITIES, scene_parts.names("outlets"), "outlet"),
        (INSERTION_QUANTITIES, _inserted_groups(scene_parts), "inserted group"),
    )
    for index, expectation in enumerate(scene_parts.scene.expect):
        quantity, dot, part = expectation.quantity.partition(".")
        for quantities, names, kind in known if dot else ():
            if quantity in quantities and part not in names:
                yield unknown(("expect", index, "quantity"), part, names, kind)


def _inserted_groups(scene_parts: PartialScene) -> list[str]:
    """Names of the groups that are inserted during the run (rain or inlet)."""
    return [
        name
        for name, group in scene_parts.scene.particles.items()
        if isinstance(group.insert, RainInsertion | InletInsertion)
    ]


def _wall_forces(scene_parts: PartialScene) -> Iterator[Violation]:
    """Wall forces of existing walls, expectations of measured wall forces, pressures of walls with an area.

    An expectation NAME.WALL requires that `output.wall_forces` includes the wall.
    """
    requested, known = scene_parts.scene.output.wall_forces, scene_parts.names("walls")
    measured = known if requested is True else requested or ()
    for index, name in enumerate(() if isinstance(requested, bool) else requested):
        if name not in known:
            yield unknown(("output", "wall_forces", index), name, known, "wall")
    for index, expectation in enumerate(scene_parts.scene.expect):
        quantity, dot, wall = expectation.quantity.partition(".")
        path: KeyPath = ("expect", index, "quantity")
        if not dot or quantity not in WALL_FORCE_QUANTITIES:
            continue
        if wall not in known:
            yield unknown(path, wall, known, "wall")
        elif wall not in measured:
            yield (
                path,
                Fault(
                    (), f"output.wall_forces does not include {wall}; write wall_forces: true, or add it to the list"
                ),
            )
        elif "pressure" in quantity and isinstance(scene_parts.scene.walls.get(wall), Plane):
            yield (
                path,
                Fault(
                    (), f"the plane {wall} is infinite and has no area; use wall_force_x, wall_force_y or wall_force_z"
                ),
            )


def _force_controlled(scene_parts: PartialScene) -> Iterator[Violation]:
    """Prescribed pressures require a wall with an area; force-controlled walls require a constant time step.

    The limits of their gain and mass are computed for one time step.
    """
    force_controlled = [
        (("walls", name, "motion", index), wall, motion)
        for name, wall in scene_parts.scene.walls.items()
        for index, motion in enumerate(wall.motion)
        if isinstance(motion, ServoSpec | FreeWallSpec)
    ]
    for path, wall, motion in force_controlled:
        if isinstance(motion, ServoSpec) and motion.pressure is not None and isinstance(wall, Plane):
            yield (*path, "pressure"), Fault((), "a plane is infinite and has no area; give force, or use a rectangle")
    if force_controlled and scene_parts.scene.run.time_step == "adaptive":
        path, _, motion = force_controlled[0]
        reason = f"walls.{path[1]} is {motion.kind}, which requires a constant time step; write auto"
        yield ("run", "time_step"), Fault((), reason)


_CHECKS: tuple[tuple[tuple[str, ...], Check], ...] = (
    ((), _materials),
    ((), _some_particles),
    ((), _pair_names),
    (("particles",), _missing_pairs),
    (("contact",), _pair_options),
    (("contact",), _restitution),
    (("stages",), _stage_names),
    (("stages", "run"), _duration),
    (("gravity",), _gamma_needs_gravity),
    (("domain",), _regions),
    (("domain", "particles", "output"), lees_edwards),
    (("output", "expect"), _parts),
    (("output", "stages", "domain"), field_grids),
    (("output", "gravity", "domain"), metrics),
    (("output", "expect"), expected_metrics),
    (("output", "expect"), _wall_forces),
    (("run",), _force_controlled),
)
"""Sections that must be complete, and the check that needs them."""
