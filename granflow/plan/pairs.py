"""Pairs of materials and possible contacts of a scene.

The pairs of materials give the constants of the contact laws, the pairs of groups and walls the cases from
which the time step is chosen.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from granflow.contact import registry
from granflow.contact.law import SLOTS, ContactModel, ModelRequest
from granflow.contact.material import (
    PairMaterial,
    modulus_eff,
    shear_modulus_eff,
    yield_strength,
)
from granflow.contact.registry import ContactLaws
from granflow.errors import SceneError
from granflow.geometry.sphere import sphere_mass
from granflow.load import Scene
from granflow.particles.group import SceneGroup
from granflow.plan.pair_case import PairCase
from granflow.scene.blocks.materials import Material, MaterialPair
from granflow.visible_text import alternatives

PairMaterials = Mapping[tuple[str, str], PairMaterial]
"""Mixed constants of two materials by their names in either order."""


def build_laws(
    scene: Scene,
    groups: Sequence[SceneGroup],
    models: Mapping[str, ContactModel],
    pairs: PairMaterials,
    velocity: float,
) -> ContactLaws:
    """The contact laws of the scene from its active models.

    `velocity` [m/s]: maximum expected impact velocity, for which a model may compute its constants. The bound
    theta^2 M of the unloading tangent refers to the mass of a sphere, also where M is that of a clump:
    eccentric contacts move less mass.
    """
    materials = tuple(pairs[first, second] for first, second in (key.split("-") for key in scene.pairs))
    unloading_angle = scene.numerics.unloading_angle / max(map(_mass_ratio, groups)) ** 0.5
    laws = []
    for slot, model in models.items():
        request = ModelRequest(
            scene.contact.options(slot),
            materials,
            velocity,
            unloading_angle,
            scene.output.energy_budget,
            max(0.5 * group.diameters[1] for group in scene.particles.values()),
        )
        laws.append(model.law.from_scene(request))
    found = ContactLaws(tuple(laws))
    if found.damped_slots and not found.normal.has_dashpot():
        _refuse_dashpot(scene, found.damped_slots[0])
    if not found.attracts:
        _refuse_tension(scene)
    return found


def _refuse_tension(scene: Scene) -> None:
    """Raise SceneError for a negative target pressure of a deforming box: contacts that do not attract never
    reach it."""
    for path, deformation in scene.deformations():
        for axis, each in deformation.by_axis.items():
            if each.pressure is not None and each.pressure < 0.0:
                key = (*path, axis, "pressure")
                raise SceneError(
                    f"{scene.locate(*key)}: {'.'.join(map(str, key))} is {each.pressure:g} Pa, but "
                    f"{scene.contact.name('normal')} contacts without contact.cohesion do not pull; give a "
                    "pressure of at least 0 Pa, or a cohesion model."
                )


def _refuse_dashpot(scene: Scene, slot: str) -> None:
    """Raise SceneError for the dashpot of a slot if the normal model provides none, of which it is a
    multiple."""
    damping = scene.contact.options(slot).damping
    raise SceneError(
        f"{scene.locate('contact', slot, 'damping')}: contact.{slot}.damping is {damping:g}, a multiple of "
        "the dashpot from which the normal model obtains the restitution, but "
        f"{scene.contact.name('normal')} has no such dashpot; write 0, or choose "
        f"{alternatives(registry.dashpot_models())} as normal model."
    )


def adhesion_velocity(laws: ContactLaws, cases: Iterable[PairCase]) -> float:
    """Velocity [m/s] to add to the impact velocity for the time step: cohesion stiffens contacts, see
    `CohesionLaw`."""
    law = laws.cohesion
    if law is None:
        return 0.0
    return max(law.equivalent_velocity(case.pair, case.radius_eff, case.mass_eff) for case in cases)


def with_resistance(laws: ContactLaws, cases: tuple[PairCase, ...]) -> tuple[PairCase, ...]:
    """The contacts with the largest resistances of the viscous force of the cohesion model."""
    law = laws.cohesion
    if law is None or not law.is_viscous:
        return cases
    return tuple(replace(case, resistance=law.resistance(case.pair, case.radius_eff)) for case in cases)


def pair_materials(scene: Scene, models: Mapping[str, ContactModel]) -> dict[tuple[str, str], PairMaterial]:
    """Mixed constants of each two materials that can come into contact, by their names in either order."""
    found = {}
    for a, b in product(scene.materials, scene.materials):
        if scene.pair_key(a, b) in scene.pairs:
            found[a, b] = _pair_material(
                scene, models, scene.pair(a, b), scene.materials[a], scene.materials[b]
            )
    return found


def _pair_material(
    scene: Scene, models: Mapping[str, ContactModel], pair: MaterialPair, a: Material, b: Material
) -> PairMaterial:
    """Mixed constants of two materials, symmetric under their exchange.

    The restitution is a number, a fit e(v) (Zhou 2011, Eq. 12) with its limit velocity (Eq. 11 unless given),
    or None.
    """
    surface = [model for slot, model in models.items() if SLOTS[slot].on_surface]
    properties = {key: getattr(pair, key, None) or 0.0 for key in registry.pair_properties()}
    tangential = scene.contact.options("tangential")
    return PairMaterial(
        modulus_eff(a, b),
        getattr(tangential, "stiffness_factor", 1.0) * shear_modulus_eff(a, b),
        pair.restitution_of(a, b),
        yield_strength(a, b),
        properties,
        (a, b),
        has_tangential_force=any(model.acts([pair]) for model in surface),
        tangential_stiffness=getattr(tangential, "stiffness", None),
    )


def pair_table(
    scene: Scene, laws: ContactLaws, pairs: PairMaterials, materials: tuple[str, ...]
) -> np.ndarray:
    """Constants of each pair of materials (materials^2, constants); NaN for pairs without contacts.

    Row i * materials + j, columns as in `ContactLaws.constant_names`. Raises SceneError if a contact model
    does not support a pair.
    """
    count = len(materials)
    table = np.full((count * count, sum(map(len, laws.constant_names.values()))), np.nan)
    for row, both in enumerate(product(materials, materials)):
        if both in pairs:
            table[row] = _constants(scene, laws, pairs[both], both)
    return table


def _constants(
    scene: Scene, laws: ContactLaws, pair: PairMaterial, materials: tuple[str, str]
) -> tuple[float, ...]:
    """Row of the pair constants. Raises SceneError if the contact model cannot reach the restitution."""
    try:
        return laws.pair_constants(pair)
    except ValueError as error:
        key = scene.pair_key(*materials)
        location = scene.locate("pairs", key, "restitution")
        raise SceneError(f"{location}: pairs.{key}.restitution cannot be obtained: {error}.") from None


def pair_cases_of(scene: Scene, groups: Sequence[SceneGroup], pairs: PairMaterials) -> tuple[PairCase, ...]:
    """The possible contacts between two groups and between a group and a wall, each for the smallest
    particles.

    A group of one particle does not collide with itself: that contact limits the time step, but has no
    `pair_key`. If no contact is possible, the contact of the first group with itself limits the time step.
    Fixed particles collide neither with each other nor with walls; for other particles they are walls with
    the radius of the largest of them.
    """
    pair_cases = []
    for n, group in enumerate(groups):
        for other in groups[n:]:
            both = (group.spec.material, other.spec.material)
            if not (group.spec.fixed and other.spec.fixed) and both in pairs:
                mobile, partner = (other, group) if group.spec.fixed else (group, other)
                both = (mobile.spec.material, partner.spec.material)
                key = scene.pair_key(*both) if group is not other or group.spec.count > 1 else None
                case = _pair_case(f"{group.name}-{other.name}", both, pairs[both], mobile, partner)
                pair_cases.append(replace(case, pair_key=key))
        walls = dict.fromkeys(wall.material for wall in scene.walls.values() if wall.holds(group.name))
        for wall in walls if not group.spec.fixed else ():
            both = (group.spec.material, wall)
            key = scene.pair_key(*both)
            case = _pair_case(f"{group.name}-{wall} wall", both, pairs[both], group, None)
            pair_cases.append(replace(case, pair_key=key))
    if not pair_cases:
        group = groups[0]
        own = group.material
        both = (group.spec.material, group.spec.material)
        nothing = dict.fromkeys(registry.pair_properties(), 0.0)
        elastic_pair = PairMaterial(
            modulus_eff(own, own), shear_modulus_eff(own, own), 1.0, properties=nothing
        )
        pair_cases.append(_pair_case(f"{group.name}-{group.name}", both, elastic_pair, group, group))
    contacts = max(sum(group.spec.count for group in groups) + len(scene.walls) - 1, 1)
    return tuple(replace(pair_case, contact_count=contacts) for pair_case in pair_cases)


def _pair_case(
    name: str,
    materials: tuple[str, str],
    pair: PairMaterial,
    group: SceneGroup,
    other: SceneGroup | None,
) -> PairCase:
    """Contact of the smallest particle of a group with the smallest of another, the largest fixed, or a wall
    (None)."""
    smallest = 0.5 * group.spec.diameters[0]
    largest = 0.5 * group.spec.diameters[1]
    radius_eff = smallest
    mass_eff = sphere_mass(smallest, group.density)
    if other is not None:
        other_smallest = 0.5 * other.spec.diameters[0]
        other_largest = 0.5 * other.spec.diameters[1]
        largest = min(largest, other_largest)
        partner = other_largest if other.spec.fixed else other_smallest
        radius_eff = smallest * partner / (smallest + partner)
        if not other.spec.fixed:
            other_mass = sphere_mass(other_smallest, other.density)
            mass_eff = mass_eff * other_mass / (mass_eff + other_mass)
    return PairCase(
        name,
        materials,
        pair,
        radius_eff,
        mass_eff,
        radius=smallest,
        overlap_radius=largest,
        solid=group.material,
        mass_ratio=max(_mass_ratio(group), _mass_ratio(other)),
    )


def _mass_ratio(group: SceneGroup | None) -> float:
    """Mass of a clump over that of its smallest sphere; 1 for spheres and walls."""
    if group is None:
        return 1.0
    smallest = 0.5 * group.spec.diameters[0]
    return group.spec.shape.mass_of_sphere(smallest, 1.0) / sphere_mass(smallest, 1.0)
