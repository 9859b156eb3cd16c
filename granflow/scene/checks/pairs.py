"""Materials, their pairs, and the properties of pairs that the contact models require."""

from collections.abc import Iterable, Iterator, Mapping
from itertools import combinations_with_replacement, product

from granflow.contact import registry
from granflow.contact.options import FRICTION
from granflow.scene.document import KeyPath
from granflow.scene.partial import PartialScene, unknown
from granflow.scene.schema.contact import Contact
from granflow.scene.schema.faults import Fault, missing, whole
from granflow.scene.schema.materials import RestitutionFit
from granflow.scene.schema.scene import SceneInput
from granflow.scene.suggest import nearest, suggestion_or_list

ASSUMED_COUNT = 2
"""Assumed number of particles of a group without a known count: enough for contacts within the group."""


def materials_exist(parts: PartialScene) -> Iterator[Fault]:
    """Materials of walls and groups must exist."""
    known = parts.names("materials")
    for section in ("walls", "particles"):
        for name, part in getattr(parts.scene, section).items():
            if part.material not in known:
                yield unknown((section, name, "material"), part.material, known, "material")


def names(parts: PartialScene) -> Iterator[Fault]:
    """Pairs of unknown materials, and duplicate pairs: A-B and B-A are the same pair."""
    known = parts.names("materials")
    seen: dict[frozenset[str], str] = {}
    for key in parts.names("pairs"):
        both = key.split("-")
        if len(both) != 2:
            continue
        for name in dict.fromkeys(both):
            if name not in known:
                remedy = suggestion_or_list(name, known, "materials")
                yield whole(("pairs", key), f"names {name}, which is not under materials. {remedy}")
        first = seen.setdefault(frozenset(both), key)
        if first != key:
            line = parts.document.key_position(("pairs", first)).line
            existing = f"{first} at line {line}" if line else first
            yield whole(("pairs", key), f"is a duplicate of the pair {existing}; keep one of them")


def possible_contacts_have_a_pair(parts: PartialScene) -> Iterator[Fault]:
    """Each two materials that can come into contact must have an entry under `pairs`.

    A pair with a misspelled name counts as the one with the closest known name: another check reports it.
    """
    known = parts.names("materials")
    existing = {frozenset(nearest(name, known) or name for name in key.split("-")) for key in parts.names("pairs")}
    mobile, fixed = (_counts(parts.scene, set(known), fixed) for fixed in (False, True))
    walls = {name: wall.material for name, wall in parts.scene.walls.items() if wall.material in known}
    for both, why in possible_contacts(mobile, fixed, walls).items():
        if both not in existing:
            yield missing(("pairs", pair_name(both)), f"{why}; give at least its restitution and friction")


def possible_contacts(
    mobile: Mapping[str, int], fixed: Iterable[str], walls: Mapping[str, str]
) -> dict[frozenset[str], str]:
    """Material pairs whose particles or walls can come into contact, with the reason.

    mobile:  number of mobile particles for each of their materials
    fixed:   materials of fixed particles, which touch neither each other nor walls
    walls:   material of each wall

    A material with a single particle does not touch itself.
    """
    found: dict[frozenset[str], str] = {}
    for a, b in combinations_with_replacement(mobile, 2):
        if a != b or mobile[a] > 1:
            other = f"particles of {b}" if a != b else "each other"
            found[frozenset((a, b))] = f"particles of {a} can be in contact with {other}"
    for a, b in product(mobile, fixed):
        found.setdefault(frozenset((a, b)), f"particles of {a} can be in contact with fixed ones of {b}")
    for (name, material), a in product(walls.items(), mobile):
        reason = f"particles of {a} can be in contact with the wall {name} of {material}"
        found.setdefault(frozenset((a, material)), reason)
    return found


def pair_name(both: frozenset[str]) -> str:
    """Key of a pair of materials under `pairs`."""
    return "-".join(sorted(both) * (3 - len(both)))


def _counts(scene: SceneInput, materials: set[str], fixed: bool) -> dict[str, int]:
    """Number of fixed particles, or of mobile ones, for each of these materials.

    A group with a mass or an end time in place of a count is assumed to have ASSUMED_COUNT particles, and a group to
    which a program adds particles at least as many.
    """
    found: dict[str, int] = {}
    for group in scene.particles.values():
        if group.material in materials and group.fixed == fixed:
            least = ASSUMED_COUNT if group.insert.kind == "python" else 1
            found[group.material] = found.get(group.material, 0) + max(group.count_given or ASSUMED_COUNT, least)
    return found


def pair_options(parts: PartialScene) -> Iterator[Fault]:
    """Keys of pairs require the contact model that declares them, and vice versa."""
    contact = parts.scene.contact
    for key, pair in parts.scene.pairs.items():
        for option in registry.pair_options().values():
            path: KeyPath = ("pairs", key, option.key)
            value, known = getattr(pair, option.key), registry.models_with(option.key)
            users = {slot: contact.name(slot) for slot, names in known.items() if contact.name(slot) in names}
            if users and value is None:
                slot, name = next(iter(users.items()))
                yield missing(path, f"contact.{slot} is {name}; {option.remedy}")
            elif value and not users and not _is_switched_off(contact, known):
                slot, names = next(iter(known.items()))
                remedy = "write 0" if option.key == FRICTION.key else f"remove {option.key}"
                reason = f"contact.{slot} is {contact.name(slot)}; {remedy}, or choose {' or '.join(names)}"
                yield Fault(path, reason)


def _is_switched_off(contact: Contact, slots: Iterable[str]) -> bool:
    """Whether an option is one of a cohesion that is none: it is unused then, with a warning of the plan.

    A comparison with and without cohesion changes `contact.cohesion` only.
    """
    return list(slots) == ["cohesion"] and contact.name("cohesion") == "none"


def restitution(parts: PartialScene) -> Iterator[Fault]:
    """Restitution in the form that the normal contact model requires; none if it follows from the materials.

    The forms are: nothing, a number, a positive number, a number or a fit (`ContactModel.restitution`).
    """
    normal = parts.scene.contact.normal
    for key, pair in parts.scene.pairs.items():
        path: KeyPath = ("pairs", key, "restitution")
        if normal.record.restitution == "nothing":
            if pair.restitution is not None:
                yield Fault(path, f"the contact model {normal.law} derives it from the materials; remove it")
            elif len(_without_yield_strength(parts, key)) == len(set(key.split("-"))):
                names = " or ".join(dict.fromkeys(key.split("-")))
                reason = f"requires a yield strength (contact model {normal.law}): give the yield_strength of {names}"
                yield whole(("pairs", key), reason)
        elif pair.restitution is None:
            yield missing(path, "restitution coefficient, a number in [0, 1]")
        elif isinstance(pair.restitution, RestitutionFit):
            yield from _restitution_fit(parts, key, pair.restitution)
        elif pair.restitution == 0 and normal.record.restitution == "positive number":
            yield Fault(path, f"the contact model {normal.law} requires a number above 0 and at most 1")


def _restitution_fit(parts: PartialScene, key: str, fit: RestitutionFit) -> Iterator[Fault]:
    """A restitution fit (Zhou 2011, Eq. 12) is valid only with a contact model that accepts it.

    Without a limit velocity, it requires the yield strengths of its materials (Eq. 11).
    """
    normal, path = parts.scene.contact.normal, ("pairs", key, "restitution")
    settings, without_yield = normal.settings(), _without_yield_strength(parts, key)
    fixed = [name for name, word in normal.fixed_by_numbers().items() if settings[name] == word]
    if normal.record.restitution != "number or fit":
        yield Fault(path, f"the contact model {normal.law} requires a number, above 0 and at most 1")
    elif fixed:
        words = [word for word in normal.words(fixed[0]) if word != settings[fixed[0]]]
        reason = f"contact.normal.{fixed[0]} is {settings[fixed[0]]}, which requires a number; "
        yield Fault(path, f"{reason}or write {' or '.join(words)}")
    elif fit.limit_velocity is None and without_yield:
        remedy = f"give limit_velocity, or the yield_strength of {' and '.join(without_yield)} (Zhou 2011, Eq. 11)"
        yield whole(path, f"has no limit velocity: {remedy}")


def _without_yield_strength(parts: PartialScene, key: str) -> list[str]:
    """The materials of a pair without a yield strength; invalid materials are not included."""
    materials = parts.scene.materials
    names = dict.fromkeys(key.split("-"))
    return [name for name in names if name in materials and not materials[name].yield_strength]
