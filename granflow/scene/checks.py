"""Consistency checks between the blocks of a scene, such as a pair for each two materials in contact.

A check is a function from a `PartialScene`, which has the valid parts of a scene, to faults. `_CHECKS` at the
end lists all checks with the sections that must be complete before they run, so that one mistake does not
cause consequential messages. Checks within one block are `Model.faults` of its class.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from itertools import combinations_with_replacement, product
from typing import Annotated, Any, get_args, get_origin

from pydantic import BaseModel, Field, create_model

from granflow.contact import registry
from granflow.contact.law import SLOTS, Remedy
from granflow.fields import INSERTION_QUANTITIES
from granflow.geometry.periodic_box import AXES
from granflow.scene.blocks.contact import Contact, LawSettings
from granflow.scene.blocks.domain import Domain
from granflow.scene.blocks.gravity import bound_of
from granflow.scene.blocks.insertions import TimedInsertion
from granflow.scene.blocks.materials import RestitutionFit
from granflow.scene.blocks.motions import MotionSpec, TimedMotion
from granflow.scene.blocks.primitives import Box
from granflow.scene.blocks.run import Damping
from granflow.scene.blocks.scene import SceneInput
from granflow.scene.blocks.walls.box import FACES
from granflow.scene.blocks.walls.wall import Wall
from granflow.scene.run_numbers import is_result_only, reason_without
from granflow.schema.document import Document, Problem
from granflow.schema.faults import Fault, KeyPath, missing, whole
from granflow.schema.messages import nearest, problem_at, suggestion_or_list, unknown, unknown_names
from granflow.schema.model import faults_of
from granflow.visible_text import alternatives


@dataclass(frozen=True)
class PartialScene:
    """A scene that may lack parts.

    scene:     the complete sections, and the valid entries of sections with several entries; it may lack
               required parts and must not be used for a run
    complete:  names of the sections without errors
    indices:   for each list with errors, the index in the file of each valid item
    """

    document: Document
    scene: SceneInput
    complete: frozenset[str] = frozenset(SceneInput.model_fields)
    indices: Mapping[str, Sequence[int]] = field(default_factory=dict)

    def names(self, section: str) -> tuple[str, ...]:
        """All names in a section of the file, including invalid entries, and names in lowercase.

        Checks of references use them, so that an invalid entry does not cause an error wherever it is named.
        """
        node = self.document.root.child(section)
        names = tuple(node.entries) if node is not None and node.entries else ()
        if section == "walls":
            names = self._wall_names(names)
        return tuple(dict.fromkeys((*names, *(name.lower() for name in names))))

    def _wall_names(self, written: Sequence[str]) -> tuple[str, ...]:
        """Names of the walls with the faces of boxes in place of the boxes; an invalid box has all six."""
        faces = [name for name in self.scene.walls if "." in name]
        valid = {name.partition(".")[0] for name in faces}
        shapes = {name: self.document.find(("walls", name, "shape")) for name in written}
        boxes = [name for name, shape in shapes.items() if shape is not None and shape.scalar == "box"]
        faces += [f"{box}.{face}" for box in boxes for face in FACES if box not in valid]
        return (*(name for name in written if name not in boxes), *faces)

    @cached_property
    def contact_models(self) -> Contact | None:
        """The block `contact`, with default options if it has faults; None if a model is not known."""
        if "contact" in self.complete:
            return self.scene.contact
        node = self.document.root.child("contact")
        return None if node is None else Contact.with_default_options(node.data())

    def faults(self) -> Iterator[Fault]:
        """Inconsistencies between the fields of each valid part, with the full key path of the fault."""
        for fault in faults_of(self.scene):
            section, *rest = fault.path
            if section in self.indices:
                yield replace(fault, path=(section, self.indices[str(section)][int(rest[0])], *rest[1:]))
            else:
                yield fault


def partial_scene_of(document: Document, data: Mapping[str, Any], errors: Iterable[KeyPath]) -> PartialScene:
    """The valid parts of a scene: all sections and entries of sections without errors.

    `data`: plain data of the document; `errors`: locations of the errors of the schema, as in pydantic.
    """
    # a section with several entries loses the broken entry only: ("walls", "floor"), but ("run",)
    broken = {loc[:2] if loc[0] in _several() else loc[:1] for loc in errors}
    sections = {name: value for name, value in data.items() if (name,) not in broken}
    indices: dict[str, list[int]] = {}
    for name in {str(loc[0]) for loc in broken} & set(sections):
        items = sections[name]
        if isinstance(items, dict):
            sections[name] = {key: item for key, item in items.items() if (name, key) not in broken}
        else:
            indices[name] = [index for index in range(len(items)) if (name, index) not in broken]
            sections[name] = [items[index] for index in indices[name]]
    valid = SceneInput.model_construct(**dict(_without_required_keys().model_validate(sections)))
    required = {name for name, each in SceneInput.model_fields.items() if each.is_required()}
    absent = required - set(data)
    complete = frozenset(SceneInput.model_fields) - absent - {loc[0] for loc in broken}
    return PartialScene(document, valid, complete, indices)


@cache
def _several() -> frozenset[str]:
    """The sections with several entries: mappings by name, and lists of models."""
    return frozenset(
        name for name, each in SceneInput.model_fields.items() if get_origin(each.annotation) in (dict, tuple)
    )


@cache
def _without_required_keys() -> type[BaseModel]:
    """The schema of a scene in which every key is optional.

    Missing mappings are empty, other missing parts None.
    """
    fields: dict[str, Any] = {}
    for name, each in SceneInput.model_fields.items():
        kind: Any = each.annotation
        for meta in each.metadata:
            kind = Annotated[kind, meta]
        if each.is_required():
            default: Any = {} if get_origin(each.annotation) is dict else None
        else:
            default = each.get_default(call_default_factory=True)
        fields[name] = (kind, Field(default))
    return create_model("PartialSections", __config__=SceneInput.model_config, **fields)


def clear_schema() -> None:
    """Clear what was derived from the schema; required after a change of the schema."""
    _several.cache_clear()
    _without_required_keys.cache_clear()


# Materials, their pairs, and the keys of pairs that the contact models require


def materials_exist(parts: PartialScene) -> Iterator[Fault]:
    """Materials of walls and groups must exist."""
    known = parts.names("materials")
    for section in ("walls", "particles"):
        for name, part in getattr(parts.scene, section).items():
            if part.material not in known:
                yield unknown((section, name, "material"), part.material, known, "material")


def material_names(parts: PartialScene) -> Iterator[Fault]:
    """Pairs of unknown materials, and duplicate pairs: A-B and B-A are the same pair."""
    known = parts.names("materials")
    seen: dict[frozenset[str], str] = {}
    for key in parts.names("pairs"):
        both = key.split("-")
        if len(both) != 2 or " " in key:  # no name of a pair, which another message says
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


ASSUMED_COUNT = 2
"""Assumed number of particles of a group without a known count: enough for contacts within the group."""


def possible_contacts_have_a_pair(parts: PartialScene) -> Iterator[Fault]:
    """Each two materials that can come into contact must have an entry under `pairs`.

    A pair with a misspelled name counts as the one with the closest known name: another check reports it.
    """
    known = parts.names("materials")
    groups = parts.scene.particles
    existing = {
        frozenset(nearest(name, known) or name for name in key.split("-")) for key in parts.names("pairs")
    }
    mobile = _counts(parts.scene, set(known), fixed=False)
    fixed = _counts(parts.scene, set(known), fixed=True)
    walls = {
        name: (wall.material, {each.material for group, each in groups.items() if wall.holds(group)})
        for name, wall in parts.scene.walls.items()
        if wall.material in known
    }
    for both, why in possible_contacts(mobile, fixed, walls).items():
        if both not in existing:
            yield missing(("pairs", pair_name(both)), f"{why}; give at least its restitution and friction")


def possible_contacts(
    mobile: Mapping[str, int], fixed: Iterable[str], walls: Mapping[str, tuple[str, Set[str]]]
) -> dict[frozenset[str], str]:
    """Material pairs whose particles or walls can come into contact, with the reason.

    mobile:  number of mobile particles for each of their materials
    fixed:   materials of fixed particles, which touch neither each other nor walls
    walls:   material of each wall, and materials of the particles that touch it

    A material with a single particle does not touch itself.
    """
    found: dict[frozenset[str], str] = {}
    for a, b in combinations_with_replacement(mobile, 2):
        if a != b or mobile[a] > 1:
            other = f"particles of {b}" if a != b else "each other"
            found[frozenset((a, b))] = f"particles of {a} can be in contact with {other}"
    for a, b in product(mobile, fixed):
        found.setdefault(frozenset((a, b)), f"particles of {a} can be in contact with fixed ones of {b}")
    for (name, (material, touching)), a in product(walls.items(), mobile):
        if a in touching:
            reason = f"particles of {a} can be in contact with the wall {name} of {material}"
            found.setdefault(frozenset((a, material)), reason)
    return found


def pair_name(both: frozenset[str]) -> str:
    """Key of a pair of materials under `pairs`."""
    names = sorted(both)
    return f"{names[0]}-{names[-1]}"


def _counts(scene: SceneInput, materials: set[str], fixed: bool) -> dict[str, int]:
    """Number of fixed particles, or of mobile ones, for each of these materials.

    A group with a mass or an end time in place of a count is assumed to have ASSUMED_COUNT particles, and a
    group to which a program adds particles at least as many.
    """
    found: dict[str, int] = {}
    for group in scene.particles.values():
        if group.material in materials and group.fixed == fixed:
            count = group.count_given or ASSUMED_COUNT
            if group.insert.from_program:
                count = max(count, ASSUMED_COUNT)
            found[group.material] = found.get(group.material, 0) + count
    return found


def pair_properties(parts: PartialScene) -> Iterator[Fault]:
    """Keys of pairs require the contact model that declares them, and vice versa."""
    contact = parts.contact_models
    if contact is None:
        return
    for key, pair in parts.scene.pairs.items():
        for name, each in registry.pair_properties().items():
            path: KeyPath = ("pairs", key, name)
            value = getattr(pair, name)
            known = registry.models_with(name)
            users = {slot: contact.name(slot) for slot, names in known.items() if contact.name(slot) in names}
            if users and value is None:
                slot, user = next(iter(users.items()))
                remedy = next((note for note in each.metadata if isinstance(note, Remedy)), Remedy()).text
                yield missing(path, f"contact.{slot} is {user}; {remedy}")
            elif value and not users and not _is_switched_off(contact, known):
                slot, names = next(iter(known.items()))
                required = type(pair).model_fields[name].is_required()
                remedy = "write 0" if required else f"remove {name}"
                reason = f"contact.{slot} is {contact.name(slot)}; {remedy}, or choose {alternatives(names)}"
                yield Fault(path, reason)


def _is_switched_off(contact: Contact, slots: Iterable[str]) -> bool:
    """Whether a key is one of a cohesion that is none: it is unused then, with a warning of the plan.

    A comparison with and without cohesion changes `contact.cohesion` only.
    """
    return "cohesion" in slots and contact.name("cohesion") == "none"


def restitution(parts: PartialScene) -> Iterator[Fault]:
    """Restitution in the form that the normal contact model requires; none if it follows from the materials.

    The forms are: nothing, a number, a positive number, a number or a fit (`ContactModel.restitution`).
    """
    contact = parts.contact_models
    if contact is None:
        return
    normal = contact.normal
    for key, pair in parts.scene.pairs.items():
        path: KeyPath = ("pairs", key, "restitution")
        if normal.record.restitution == "nothing":
            if pair.restitution is not None:
                yield Fault(path, f"the contact model {normal.law} derives it from the materials; remove it")
            elif len(_without_yield_strength(parts, key)) == len(set(key.split("-"))):
                names = " or ".join(dict.fromkeys(key.split("-")))
                reason = (
                    f"requires a yield strength (contact model {normal.law}): give the yield_strength of "
                    f"{names}"
                )
                yield whole(("pairs", key), reason)
        elif pair.restitution is None:
            yield missing(path, "restitution coefficient, a number in [0, 1]")
        elif pair.fit:
            yield from _restitution_fit(parts, normal, key, pair.fit)
        elif pair.restitution == 0 and normal.record.restitution == "positive number":
            yield Fault(path, f"the contact model {normal.law} requires a number above 0 and at most 1")


def _restitution_fit(
    parts: PartialScene, normal: LawSettings, key: str, fit: RestitutionFit
) -> Iterator[Fault]:
    """A restitution fit (Zhou 2011, Eq. 12) is valid only with a contact model that accepts it.

    Without a limit velocity, it requires the yield strengths of its materials (Eq. 11).
    """
    path = ("pairs", key, "restitution")
    without_yield = _without_yield_strength(parts, key)
    fixed = [key for key, word in normal.record.options.with_numbers.items() if getattr(normal, key) == word]
    if normal.record.restitution != "number or fit":
        yield Fault(path, f"the contact model {normal.law} requires a number, above 0 and at most 1")
    elif fixed:
        given = getattr(normal, fixed[0])
        known = get_args(type(normal).model_fields[fixed[0]].annotation)
        words = [word for word in known if word != given]
        reason = f"contact.normal.{fixed[0]} is {given}, which requires a number; "
        yield Fault(path, f"{reason}or write {' or '.join(words)}")
    elif fit.limit_velocity is None and without_yield:
        remedy = (
            f"give limit_velocity, or the yield_strength of {' and '.join(without_yield)} (Zhou 2011, Eq. 11)"
        )
        yield whole(path, f"has no limit velocity: {remedy}")


def _without_yield_strength(parts: PartialScene, key: str) -> list[str]:
    """The materials of a pair without a yield strength; invalid materials are not included."""
    materials = parts.scene.materials
    names = dict.fromkeys(key.split("-"))
    return [name for name in names if name in materials and not materials[name].yield_strength]


# Particle groups: regions, clumps, liquid, properties that equations integrate


def some_particles(parts: PartialScene) -> Iterator[Fault]:
    """At least one group of particles must be given."""
    node = parts.document.root.child("particles")
    if node is not None and node.entries == {}:
        yield Fault(("particles",), "at least one group of particles is required")


def inside_domain(parts: PartialScene) -> Iterator[Fault]:
    """Initial positions and insertion regions must lie inside the domain.

    Centers only: a particle may extend beyond the domain. Inverted domains are reported by another check.
    """
    low, high = parts.scene.domain.min, parts.scene.domain.max
    for name, group in parts.scene.particles.items():
        path: KeyPath = ("particles", name, "insert")
        for index, point in enumerate(group.insert.points):
            if not all(a <= x <= b or b <= a for a, x, b in zip(low, point, high, strict=True)):
                yield Fault((*path, "positions", index), "it lies outside the domain")
        place = group.insert.place
        for axis, (a, b) in enumerate(place.extent() if place is not None else ()):
            if low[axis] < high[axis] and (a < low[axis] or b > high[axis]):
                reach = f"extends from {a:.4g} to {b:.4g} m in {AXES[axis]}"
                reason = f"{reach}, beyond the domain, {low[axis]:g} to {high[axis]:g} m"
                yield whole((*path, group.insert.place_key), reason)


def unsupported_shapes(parts: PartialScene) -> Iterator[Fault]:
    """The first group of each shape of particles excludes parts of the scene."""
    groups = {type(group.shape): name for name, group in reversed(parts.scene.particles.items())}
    for name in groups.values():
        yield from parts.scene.particles[name].shape.faults_in_scene(parts.scene, name)


def liquid_content(parts: PartialScene) -> Iterator[Fault]:
    """Every group requires a liquid content with a cohesion model that transfers liquid, and vice versa.

    With `contact.cohesion: none` the content is unused. Earlier runs have no films.
    """
    scene = parts.scene
    name = parts.scene.contact.name("cohesion")
    transfers = name in registry.liquid_models()
    for group_name, group in scene.particles.items():
        path: KeyPath = ("particles", group_name, "liquid_content")
        if transfers and group.liquid_content is None:
            yield missing(
                path, f"contact.cohesion is {name}; give the volume of the film over that of a particle, or 0"
            )
        elif group.liquid_content and not transfers and name != "none":
            remedy = f"remove liquid_content, or choose {' or '.join(registry.liquid_models())}"
            yield Fault(path, f"contact.cohesion is {name}; {remedy}")
    if transfers and scene.start_from is not None:
        reason = (
            f"cannot be combined with contact.cohesion: {name}: it reads no liquid; remove one of the two"
        )
        yield whole(("start_from",), reason)


def equation_values(parts: PartialScene) -> Iterator[Fault]:
    """A particle equation requires an initial value of each group, and its keys of their materials.

    A value for an equation that does not act would have no effect, nor would a source of a flow that no model
    has.
    """
    scene = parts.scene
    present = {name for model in scene.chosen_models.values() for name in model.law.flows}
    needed = {each.name: each.flows for each in registry.equations()}
    for name, flows in (needed | {name: (flow,) for name, (flow, _) in registry.sources().items()}).items():
        for path in scene.places_of(name) if not present.issuperset(flows) else ():
            missing_flow = f"no contact model of this scene has the flow {alternatives(flows)}"
            reason = f"has no effect: {missing_flow}{' that changes it' if name in needed else ''}"
            choices = [
                f"contact.{slot}: {model}"
                for slot in SLOTS
                for model, each in registry.models(slot).items()
                if set(flows) <= each.law.flows.keys()
            ]
            yield whole(path, f"{reason}; remove it, or select such a model, {alternatives(choices)}")
    for equation in scene.equations:
        for name, group in scene.particles.items():
            if getattr(group, equation.name) is None:
                value = f"give the initial value, {equation.meaning} [{equation.unit}]"
                yield missing(("particles", name, equation.name), value)
        used = dict.fromkeys(group.material for group in scene.particles.values())
        for name in (each for each in used if each in scene.materials):
            for key, each in equation.material_properties.model_fields.items():
                if getattr(scene.materials[name], key) is None:
                    reason = f"{each.description}, for the equation of the {equation.name}"
                    yield missing(("materials", name, key), reason)


def wall_values(parts: PartialScene) -> Iterator[Fault]:
    """Keys of walls that contact models declare require such a model, and must agree with each other."""
    scene = parts.scene
    known = {
        key: f"contact.{slot}: {name}"
        for slot in SLOTS
        for name, model in registry.models(slot).items()
        for key in model.law.wall_properties.model_fields
    }
    chosen = [model.law.wall_properties for model in scene.chosen_models.values()]
    for name, wall in scene.walls.items():
        read = {key for each in chosen for key in each.model_fields}
        for key, user in known.items():
            if getattr(wall, key) is not None and key not in read:
                reason = f"has no effect: no contact model reads it; remove it, or select {user}"
                yield whole(("walls", name, key), reason)
        for each in chosen:
            for fault in each.wall_faults(wall):
                yield replace(fault, path=("walls", name, *fault.path))


def attached_particles(parts: PartialScene) -> Iterator[Fault]:
    """Particles move with an existing wall that is present in the whole run and has no surface velocity."""
    known = parts.names("walls")
    for name, group in parts.scene.particles.items():
        if group.attached_to is None:
            continue
        path: KeyPath = ("particles", name, "fixed", "to")
        wall = parts.scene.walls.get(group.attached_to)
        if group.attached_to not in known:
            yield unknown(path, group.attached_to, known, "wall")
        elif wall is not None and not wall.is_permanent:
            reason = "particles need a wall that is present in the whole run; remove its stages or times"
            yield Fault(path, f"the wall appears or vanishes, but {reason}")
        elif wall is not None and wall.has_belt:
            reason = "which moves its surface and not its geometry, with which the particles move"
            yield Fault(path, f"the wall has a surface velocity, {reason}; use another wall")
        elif getattr(wall, "heat_flux", None) is not None:
            reason = "which particles receive that touch it, and those that move with it touch no wall"
            yield Fault(path, f"the wall has a heat_flux, {reason}; give the group a heat_source instead")


def values_of_attached_particles(parts: PartialScene) -> Iterator[Fault]:
    """Particles that move with a wall have its values of properties that equations change."""
    for name, group in parts.scene.particles.items():
        wall = parts.scene.walls.get(group.attached_to or "")
        for equation in parts.scene.equations:
            given = getattr(group, equation.name)
            held = getattr(wall, equation.name, None)
            if given is not None and held is not None and given != held:
                reason = f"the particles are parts of {group.attached_to}, which has {held:g} {equation.unit}"
                yield Fault(("particles", name, equation.name), f"{reason}; give the same value")


def wear_materials(parts: PartialScene) -> Iterator[Fault]:
    """Coefficients of wear are those of materials, and each material of particles has one."""
    scene = parts.scene
    known = parts.names("materials")
    used = dict.fromkeys(group.material for group in scene.particles.values())
    for name, wall in scene.walls.items():
        given = None if wall.wear is None else wall.wear.materials
        if given is None:
            continue
        path: KeyPath = ("walls", name, "wear", "coefficient")
        for material in given:
            if material not in known:
                yield unknown((*path, material), material, known, "material")
        for material in (each for each in used if each not in given and each in scene.materials):
            yield missing((*path, material), "coefficient for the particles of this material")


def heat_options(parts: PartialScene) -> Iterator[Fault]:
    """The losses of contacts are known with the energy budget only; radiation requires emissivities; gas
    conducts less than the solids."""
    scene = parts.scene
    gas = getattr(scene.contact.options("heat"), "gas", None)
    if gas is not None:
        yield from _gas_faults(scene, gas)
    if getattr(scene.contact.options("heat"), "surroundings", None) is not None:
        for name in dict.fromkeys(group.material for group in scene.particles.values()):
            if name in scene.materials and scene.materials[name].emissivity is None:  # type: ignore[attr-defined]
                reason = "emissivity of the surface, in [0, 1], with contact.heat.surroundings"
                yield missing(("materials", name, "emissivity"), reason)
    if getattr(scene.contact.options("heat"), "from_dissipation", False) and not scene.output.energy_budget:
        reason = "it needs the losses of the energy budget; set output.energy_budget to true as well"
        yield Fault(("contact", "heat", "from_dissipation"), reason)


def _gas_faults(scene: Any, gas: Any) -> Iterator[Fault]:
    """Solids that conduct too little for the gas between them."""
    used = {group.material for group in scene.particles.values()}
    used |= {wall.material for wall in scene.walls.values() if getattr(wall, "temperature", None) is not None}
    for name in [each for each in scene.materials if each in used]:
        conductivity = getattr(scene.materials[name], "thermal_conductivity", None)
        if conductivity is not None and gas.conductivity > LARGEST_GAS_SHARE * conductivity:
            reason = (
                f"it must be at most {LARGEST_GAS_SHARE:g} of materials.{name}.thermal_conductivity, "
                f"{conductivity:g} W/m/K: the paths of the heat are those of a gas that conducts less than "
                "the solid"
            )
            yield Fault(("contact", "heat", "gas", "conductivity"), reason)


LARGEST_GAS_SHARE = 0.9
"""Largest conductivity of the gas over that of a solid; the closed form of paths through both divides by the
difference."""


def material_values(parts: PartialScene) -> Iterator[Fault]:
    """A contact model requires its keys of the materials of particles, and of walls that have a value of a
    property of the particles."""
    scene = parts.scene
    for slot, model in scene.active_models.items():
        keys = [*model.law.wall_properties.model_fields]
        exchanged = [key for key in model.law.particle_properties if key in keys]
        users: dict[str, str] = {}
        for name, group in scene.particles.items():
            users.setdefault(group.material, f"particles.{name}")
        for name, wall in scene.walls.items():
            if any(getattr(wall, key) is not None for key in exchanged):
                users.setdefault(wall.material, f"walls.{name}")
        for name, user in users.items():
            for key, each in model.material_properties.model_fields.items():
                known = scene.materials.get(name)
                if each.is_required() and known is not None and getattr(known, key) is None:
                    reason = f"{each.description}, of {user} with contact.{slot}: {model.name}"
                    yield missing(("materials", name, key), reason)


# Features that Lees-Edwards boundaries exclude


def lees_edwards(parts: PartialScene) -> Iterator[Fault]:
    """Lees-Edwards boxes exclude walls, insertion during the run and flow meters: the images move.

    One fault names all features of the scene that are not supported.
    """
    scene = parts.scene
    if scene.domain.lees_edwards is None:
        return
    inserted = [name for name, group in scene.particles.items() if isinstance(group.insert, TimedInsertion)]
    unsupported = {
        "walls": list(scene.walls),
        "particles inserted during the run": inserted,
        "flow meters": list(scene.output.flow_meters),
    }
    found = [f"{kind} ({', '.join(names)})" for kind, names in unsupported.items() if names]
    if scene.damping is not None:
        reason = "domain.lees_edwards is given, and no frame is at rest in uniform shear; remove one of them"
        yield Fault(("damping",), reason)
    if found:
        reason = f"cannot be combined with {alternatives(found)}: the periodic images move"
        yield whole(("domain", "lees_edwards"), reason)


def _component(axis: str, gravity: Sequence[float]) -> float:
    """Magnitude of a component of gravity [m/s2]."""
    return abs(float(gravity[AXES.index(axis)]))


def deformation(parts: PartialScene) -> Iterator[Fault]:
    """A deforming box has periodic axes, and spheres alone: all else would have to move with it. No gravity
    acts along an axis that deforms, because nothing carries the weight.

    One fault names all features of the scene that are not supported.
    """
    scene = parts.scene
    given = list(scene.deformations())
    for path, each in given:
        for axis in each.by_axis:
            if axis not in scene.domain.periodic:
                periodic = ", ".join(scene.domain.periodic) or "none"
                reason = f"requires a periodic axis, but domain.periodic is {periodic}"
                yield whole((*path, axis), f"{reason}; add {axis} there")
    if not given:
        return
    deforming = sorted({axis for _, each in given for axis in each.by_axis})
    for path, gravity in scene.given_gravities():
        along = [axis for axis in deforming if bound_of(gravity, partial(_component, axis), 1.0) > 0.0]
        if along:
            reason = f"acts along {', '.join(along)}, along which the periodic box deforms"
            yield whole(path, f"{reason}, and no wall carries the weight; write [0, 0, 0]")
    groups = scene.particles.items()
    unsupported = {
        "walls": list(scene.walls),
        "clumps": [name for name, group in groups if group.shape.body is not None],
        "fixed particles": [name for name, group in groups if group.fixed],
        "particles inserted during the run": [
            name for name, group in groups if isinstance(group.insert, TimedInsertion)
        ],
        "flow meters": list(scene.output.flow_meters),
        "outlets": list(scene.outlets),
        "fields": list(scene.output.fields),
        "metrics of stress, in whose place the time series has box_pressure": [
            name for name, metric in scene.output.metrics.items() if metric.kind == "stress"
        ],
    }
    found = [f"{kind} ({', '.join(names)})" for kind, names in unsupported.items() if names]
    if scene.domain.lees_edwards is not None:
        found.append("domain.lees_edwards")
    if scene.damping is not None:
        found.append("damping, for which no frame is at rest")
    if found:
        yield whole(given[0][0], f"cannot be combined with {alternatives(found)}: remove one of them")


# Stages, and what is limited to stages; motions of walls


def stage_names(parts: PartialScene) -> Iterator[Fault]:
    """Unique stage names, and references of walls, motions, insertions and damping to existing stages only.

    A scene without stages has the single stage "run".
    """
    known = parts.scene.stage_names
    for index, name in enumerate(known):
        if name in known[:index]:
            reason = f"stages.{known.index(name)} has the same name; give each stage a different name"
            yield Fault(("stages", index, "name"), reason)
    named = [*_walls(parts.scene), *_motions(parts.scene), *_flows(parts.scene), *_damping(parts.scene)]
    for path, part in [*named, *parts.scene.gravity_motions()]:
        for index, name in enumerate(part.stages or ()):
            location = (*path, "stages", index)
            if name not in known and parts.scene.stages:
                yield unknown(location, name, known, "stage")
            elif name not in known:
                remedy = "remove stages" if path == ("damping",) else "give times instead of stages"
                yield Fault(location, f"the scene has no stages; {remedy}")
    for path, motion in [*_motions(parts.scene), *parts.scene.gravity_motions()]:
        if motion.run_out and motion.stages is not None:
            yield from _pauses(path, motion.stages, known)


def _pauses(path: KeyPath, stages: Sequence[str], known: Sequence[str]) -> Iterator[Fault]:
    """A fault for stages between those of a motion that stops slowly: it would have to stop before each."""
    places = sorted(known.index(name) for name in stages if name in known)
    between = [known[place] for place in range(places[0], places[-1])] if places else []
    if missed := [name for name in between if name not in stages]:
        reason = f"the motion pauses in {', '.join(missed)}; give one motion for the stages before, one after"
        yield Fault((*path, "end_ramp_duration"), reason)


def gravity_stages(parts: PartialScene) -> Iterator[Fault]:
    """Stages of a motion of gravity are those in which this gravity acts: until a stage has its own."""
    scene = parts.scene
    begins = [0, *(index for index, each in enumerate(scene.stages) if each.gravity is not None)]
    ends = [*begins[1:], len(scene.stages)]
    paths: list[tuple[str | int, ...]] = [
        ("gravity",),
        *(("stages", index, "gravity") for index in begins[1:]),
    ]
    acting = {
        path: scene.stage_names[begin:end] for path, begin, end in zip(paths, begins, ends, strict=True)
    }
    for path, motion in scene.gravity_motions():
        names = acting[path[:-2]]
        for index, name in enumerate(motion.stages or ()):
            if name in scene.stage_names and name not in names and scene.stages:
                which = f"only in {', '.join(names)}" if names else "in no stage"
                reason = f"this gravity acts {which}; give the motion to the gravity that acts in {name}"
                yield Fault((*path, "stages", index), reason)


def wall_groups(parts: PartialScene) -> Iterator[Fault]:
    """Groups that touch a wall must exist and move: fixed particles touch no wall."""
    known = parts.names("particles")
    for path, wall in _walls(parts.scene):
        yield from unknown_names((*path, "groups"), wall.groups, known, "group")
        for index, name in enumerate(wall.groups or ()):
            group = parts.scene.particles.get(name)
            if group is not None and group.fixed:
                reason = f"the particles of {name} are fixed and touch no wall; remove {name}"
                yield Fault((*path, "groups", index), reason)


def duration(parts: PartialScene) -> Iterator[Fault]:
    """Exactly one of `run.duration` and `stages` must be given."""
    is_given = parts.scene.run.duration is not None
    if not is_given and not parts.scene.stages:
        yield missing(("run", "duration"), "give the simulated time, such as 2 s, or stages")
    if is_given and parts.scene.stages:
        yield Fault(("run", "duration"), "the stages have durations; remove run.duration")


def gamma_requires_gravity(parts: PartialScene) -> Iterator[Fault]:
    """Gamma, the peak acceleration over gravity, requires gravity."""
    if any(parts.scene.usual_gravity):
        return
    for path, motion in _motions(parts.scene):
        if motion.key_for_gravity is not None:
            yield Fault((*path, motion.key_for_gravity), "gravity is zero; give amplitude and frequency")


def force_controlled_walls(parts: PartialScene) -> Iterator[Fault]:
    """Prescribed pressures require a wall with an area, or walls between which they act; force-controlled
    walls require a constant time step.

    Walls with errors count as names: they have their own messages. The limits of gain and mass are computed
    for one time step.
    """
    scene = parts.scene
    controlled = [(path, each) for path, each in _motions(scene) if each.force_controlled]
    for path, motion in controlled:
        names = getattr(motion, "between", None)
        yield from unknown_names((*path, "between"), names, parts.names("walls"), "wall")
        for number, name in enumerate(names or ()):
            reason = _unfit_for_section(scene, path, motion, name) if name in scene.walls else None
            if reason is not None:
                yield Fault((*path, "between", number), f"walls.{name} {reason}")
        key = motion.key_for_area
        wall = scene.walls[str(path[1])]
        if key is not None and not wall.has_area(scene.domain):
            reason = f"a {wall.shape} is infinite and has no area; give force, or use a rectangle"
            yield Fault((*path, key), reason)
    if controlled and scene.run.time_step == "adaptive":
        path, motion = controlled[0]
        reason = f"walls.{path[1]} is {motion.kind}, which requires a constant time step; write auto"
        yield Fault(("run", "time_step"), reason)


def _unfit_for_section(scene: SceneInput, path: KeyPath, motion: TimedMotion, wall: str) -> str | None:
    """Why a wall cannot bound the section of a servo, the motion at `path`, with the remedy; None for a wall
    that can."""
    if not all(each.force_controlled for each in scene.walls[wall].motion):
        return "has a prescribed motion; give walls that servos move, or walls at rest"
    if not _is_present_during(scene, scene.walls[wall], motion, scene.walls[str(path[1])]):
        return "is absent during a part of this motion; give the motion the stages or times of that wall"
    return None


def _is_present_during(scene: SceneInput, wall: Wall, motion: TimedMotion, moved: Wall) -> bool:
    """Whether a wall is present as long as a motion of the wall `moved` can act.

    A motion in stages acts from the first of them to the last.
    """
    names = scene.stage_names
    given = [names.index(name) for name in motion.stages or names if name in names]
    during = names[min(given, default=0) : max(given, default=-1) + 1]
    acting = [name for name in during if moved.stages is None or name in moved.stages]
    return (
        (wall.stages is None or set(acting) <= set(wall.stages))
        and wall.start_time <= max(motion.start_time, moved.start_time)
        and min(motion.end_time, moved.end_time) <= wall.end_time
    )


def _walls(scene: SceneInput) -> Iterator[tuple[KeyPath, Wall]]:
    """Each wall with its key path."""
    yield from ((("walls", name), wall) for name, wall in scene.walls.items())


def _motions(scene: SceneInput) -> Iterator[tuple[KeyPath, MotionSpec]]:
    """Each motion of a wall with its key path."""
    for path, wall in _walls(scene):
        yield from (((*path, "motion", index), motion) for index, motion in enumerate(wall.motion))


def _flows(scene: SceneInput) -> Iterator[tuple[KeyPath, TimedInsertion]]:
    """The insertions during the run with their key paths."""
    for name, group in scene.particles.items():
        if isinstance(group.insert, TimedInsertion):
            yield ("particles", name, "insert"), group.insert


def _damping(scene: SceneInput) -> Iterator[tuple[KeyPath, Damping]]:
    """The damping with its key path, if there is one."""
    if scene.damping is not None:
        yield ("damping",), scene.damping


# Output: grids, metrics and wall forces


def field_grids(parts: PartialScene) -> Iterator[Fault]:
    """Field grids: number of cells within the limit, existing stages, full extent along periodic axes."""
    stages = [stage.name for stage in parts.scene.stages]
    domain = parts.scene.domain
    for name, grid in parts.scene.output.fields.items():
        path: KeyPath = ("output", "fields", name)
        yield from (replace(fault, path=(*path, *fault.path)) for fault in grid.too_many_cells(domain))
        if grid.region is not None:
            yield from _periodic_extent(domain, (*path, "region"), grid.region)
        yield from unknown_names((*path, "stages"), grid.stages, stages, "stage")
        named = grid.quantities or ()
        if "temperature" in named and parts.scene.contact.name("heat") == "none":
            index = named.index("temperature")
            reason = "particles have no temperature: contact.heat is none; write conduction, or remove it"
            yield Fault((*path, "quantities", index), reason)


def residence_time(parts: PartialScene) -> Iterator[Fault]:
    """Residence times begin at a flow meter or an inserted group, and end at a flow meter."""
    given = parts.scene.output.residence_time
    if given is None:
        return
    path: KeyPath = ("output", "residence_time")
    meters = parts.scene.output.flow_meters
    groups = parts.names("particles")
    if given.to not in meters:
        yield unknown((*path, "to"), given.to, meters, "flow meter")
    if given.from_ is not None and given.from_ not in meters and given.from_ not in groups:
        remedy = suggestion_or_list(given.from_, [*meters, *groups], "names")
        yield Fault((*path, "from"), f"there is no such flow meter or group of particles. {remedy}")
    yield from unknown_names((*path, "groups"), given.groups, groups, "group of particles")
    if given.from_ in groups and given.from_ not in meters and given.groups is not None:
        yield Fault((*path, "groups"), "from is a group, which alone counts; remove one of the two")


def metrics(parts: PartialScene) -> Iterator[Fault]:
    """What the kinds of metrics require of the scene, such as existing groups, or gravity."""
    domain = parts.scene.domain
    for name, metric in parts.scene.output.metrics.items():
        region = getattr(metric, "region", None)
        if isinstance(region, Box) and domain.on_exit != "expand":
            sides = zip(region.min, region.max, domain.min, domain.max, strict=True)
            if any(high <= lower or low >= upper for low, high, lower, upper in sides):
                reason = (
                    "lies outside the domain, so that it never contains a particle; move it, or remove it"
                )
                yield whole(("output", "metrics", name, "region"), reason)
                continue
        for fault in metric.faults_in(parts):
            yield replace(fault, path=("output", "metrics", name, *fault.path))


def _periodic_extent(domain: Domain, path: KeyPath, region: Box) -> Iterator[Fault]:
    """A fault for each periodic axis along which a region does not cover exactly the domain [m]."""
    for axis in domain.periodic:
        k = "xyz".index(axis)
        if (region.min[k], region.max[k]) != (domain.min[k], domain.max[k]):
            reach = f"{domain.min[k]:g} to {domain.max[k]:g} m"
            yield whole(path, f"must extend from {reach} in {axis}, where the domain is periodic")


def wall_forces(parts: PartialScene) -> Iterator[Fault]:
    """Wall forces are those of existing walls; reference points of torques are those of measured walls."""
    requested = parts.scene.output.wall_forces
    known = parts.names("walls")
    if not isinstance(requested, bool):
        yield from unknown_names(("output", "wall_forces"), requested, known, "wall")
    measured = known if requested is True else requested or ()
    for name, given in parts.scene.walls.items():
        if given.torque_point is not None and name not in measured:
            reason = f"has no effect: output.wall_forces does not include {name}; remove it, or add {name}"
            yield whole(("walls", name, "torque_point"), reason)


# Expectations and conditions of stages


def expected_numbers(parts: PartialScene) -> Iterator[Fault]:
    """A run of the scene must have the numbers of expectations and of conditions of stages."""
    invalid = {
        name
        for section in ("walls", "outlets", "particles")
        for name in set(parts.names(section)) - set(getattr(parts.scene, section))
    }
    for path, name in _named_numbers(parts.scene):
        if path[0] == "stages" and is_result_only(name):
            continue  # reported by `condition_columns`
        if name.partition(".")[2] not in invalid and (reason := reason_without(parts.scene, name)):
            yield Fault(path, reason)


def stage_settings(parts: PartialScene) -> Iterator[Fault]:
    """Settings of stages name existing groups."""
    for number, stage in enumerate(parts.scene.stages):
        for index, setting in enumerate(stage.set_):
            path: KeyPath = ("stages", number, "set", index, "groups")
            yield from unknown_names(path, setting.groups, parts.names("particles"), "group of particles")


def stage_deletions(parts: PartialScene) -> Iterator[Fault]:
    """Deletions of stages name existing groups; the first stage has none."""
    for number, stage in enumerate(parts.scene.stages):
        if stage.delete and not number:
            yield Fault(("stages", 0, "delete"), "the first stage begins without particles; remove delete")
        for index, deletion in enumerate(stage.delete):
            path: KeyPath = ("stages", number, "delete", index, "groups")
            yield from unknown_names(path, deletion.groups, parts.names("particles"), "group of particles")


def condition_columns(parts: PartialScene) -> Iterator[Fault]:
    """Conditions of stages must refer to columns of the time series, not to results of the whole run."""
    for number, stage in enumerate(parts.scene.stages):
        for index, condition in enumerate(stage.until):
            path: KeyPath = ("stages", number, "until", index, "quantity")
            if is_result_only(condition.quantity):
                quantity, point, part = condition.quantity.partition(".")
                instead = (
                    (f"inserted_count.{part}" if point else "inserted_count, the sum of all groups")
                    if quantity in INSERTION_QUANTITIES
                    else "particle_count, deleted_mass or wall_force_z.NAME"
                )
                yield Fault(
                    path,
                    f"it is a result of the whole run; give a column of timeseries.csv, such as {instead}",
                )


def _named_numbers(scene: SceneInput) -> Iterator[tuple[KeyPath, str]]:
    """Key path and name of the number of each expectation and each condition of a stage."""
    for index, expectation in enumerate(scene.expect):
        yield ("expect", index, "quantity"), expectation.quantity
    for number, stage in enumerate(scene.stages):
        for index, condition in enumerate(stage.until):
            yield ("stages", number, "until", index, "quantity"), condition.quantity


# All checks

_MAX_ENTRIES = {
    "materials": 50,
    "pairs": 1275,
    "walls": 1000,
    "particles": 100,
    "outlets": 50,
    "stages": 1000,
    "expect": 1000,
}
"""Largest number of entries of each section: the cost of some checks grows with its square."""
_CHECKS: tuple[tuple[tuple[str, ...], Callable[[PartialScene], Iterator[Fault]]], ...] = (
    ((), materials_exist),
    ((), material_names),
    (("particles",), possible_contacts_have_a_pair),
    ((), pair_properties),
    ((), restitution),
    (("stages",), stage_names),
    (("gravity", "stages"), gravity_stages),
    (("particles",), wall_groups),
    (("stages", "run"), duration),
    (("gravity", "stages"), gamma_requires_gravity),
    (("run", "domain", "stages"), force_controlled_walls),
    ((), some_particles),
    (("domain",), inside_domain),
    (("domain", "particles", "output"), lees_edwards),
    (("domain", "gravity", "particles", "output", "stages"), deformation),
    (("domain", "run", "output"), unsupported_shapes),
    (("contact",), liquid_content),
    (("contact", "pairs", "stages"), equation_values),
    (("contact",), wall_values),
    (("particles",), attached_particles),
    (("particles", "contact", "walls"), values_of_attached_particles),
    (("particles", "materials"), wear_materials),
    (("contact", "output"), heat_options),
    (("contact", "pairs"), material_values),
    (("output", "stages", "domain", "contact"), field_grids),
    (("output", "gravity", "stages", "domain"), metrics),
    (("output",), residence_time),
    (("output", "expect", "stages", "contact", "domain", "gravity"), expected_numbers),
    (("output", "expect", "stages", "domain"), wall_forces),
    (("stages",), stage_settings),
    (("stages",), stage_deletions),
    (("stages", "walls"), condition_columns),
)
"""Sections that must be complete, and the check that needs them."""


def consistency_problems(parts: PartialScene) -> list[Problem]:
    """All problems within and between the parts of a scene that may be incomplete, in no particular order.

    If a section has too many entries, checks between parts are omitted, because the time of some of them
    grows with the square of the number of entries.
    """
    faults = list(parts.faults())
    overfull = list(_overfull_sections(parts))
    if not overfull:
        for needed, check in _CHECKS:
            if parts.complete.issuperset(needed):
                faults += check(parts)
    return [problem_at(parts.document, fault) for fault in (*faults, *overfull)]


def _overfull_sections(parts: PartialScene) -> Iterator[Fault]:
    """Faults of sections with more entries than _MAX_ENTRIES."""
    for section, limit in _MAX_ENTRIES.items():
        node = parts.document.root.child(section)
        count = len(node.entries or node.items or ()) if node is not None else 0
        if count > limit:
            yield whole((section,), f"has {count} entries, but the limit is {limit}")
