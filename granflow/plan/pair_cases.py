"""Pairs of materials and possible contacts of a scene: contact laws, pair constants, and the cases of the time step."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from granflow.contact import registry
from granflow.contact.law import ModelRequest
from granflow.contact.laws import ContactLaws
from granflow.contact.material import (
    PairMaterial,
    Solid,
    VelocityRestitution,
    limit_velocity,
    modulus_eff,
    shear_modulus_eff,
    yield_strength,
)
from granflow.contact.model import SLOTS, ContactModel
from granflow.errors import SceneError
from granflow.load import Scene
from granflow.plan.size_classes import diameter_range
from granflow.plan.time_step import PairCase
from granflow.scene.schema.materials import Material, MaterialPair, RestitutionFit
from granflow.scene.schema.particles import Group
from granflow.visible_text import alternatives


def active_models(scene: Scene) -> dict[str, ContactModel]:
    """The contact models of the scene by slot.

    A model with pair options is active only if a pair has a value other than 0; slots without an active model are
    absent.
    """
    found = {}
    for slot in SLOTS:
        name = scene.contact.name(slot)
        model = registry.models(slot).get(name)
        if model is not None and _acts(model, scene.pairs.values()):
            found[slot] = model
    return found


def _acts(model: ContactModel, pairs: Iterable[MaterialPair]) -> bool:
    """Whether a model acts between any of the pairs."""
    return not model.pair_options or any(getattr(pair, option.key) for pair in pairs for option in model.pair_options)


def build_laws(scene: Scene, velocity: float) -> ContactLaws:
    """The contact laws of the scene.

    `velocity` [m/s]: maximum expected impact velocity, for which a model may compute its constants. The bound theta^2 M
    of the unloading tangent refers to the mass of a sphere, also where M is that of a clump: eccentric contacts move
    less mass.
    """
    unloading_angle = scene.numerics.unloading_angle / max(map(_mass_ratio, scene.particles.values())) ** 0.5
    pairs = tuple(pair_material(scene, *key.split("-")) for key in scene.pairs)
    laws: dict[str, Any] = {}
    radius_max = max(0.5 * diameter_range(group)[1] for group in scene.particles.values())
    for slot, model in active_models(scene).items():
        request = ModelRequest(
            scene.contact.options(slot),
            pairs,
            velocity,
            unloading_angle,
            scene.output.energy_budget,
            radius_max,
        )
        laws[slot] = model.law.from_scene(request)
    found = ContactLaws(**laws)
    if found.damped_slots and not found.normal.has_dashpot:
        _refuse_dashpot(scene, found.damped_slots[0])
    return found


def _refuse_dashpot(scene: Scene, slot: str) -> None:
    """Raise SceneError for the dashpot of a slot if the normal model provides none, of which it is a multiple."""
    damped = [name for name, model in registry.models("normal").items() if getattr(model.law, "has_dashpot", False)]
    damping = scene.contact.options(slot)["damping"]
    raise SceneError(
        f"{scene.locate('contact', slot, 'damping')}: contact.{slot}.damping is {damping:g}, a multiple of "
        f"the dashpot from which the normal model obtains the restitution, but {scene.contact.name('normal')} has no "
        f"such dashpot; write 0, or choose {alternatives(damped)} as normal model."
    )


def adhesion_velocity(laws: ContactLaws, cases: Iterable[PairCase]) -> float:
    """Velocity [m/s] to add to the impact velocity for the time step: cohesion stiffens contacts, see `CohesionLaw`."""
    law = laws.cohesion
    if law is None:
        return 0.0
    return max(law.equivalent_velocity(case.pair, case.radius_eff, case.mass_eff) for case in cases)


def solid(materials: Mapping[str, Material], material: str) -> Solid:
    """Constants of one material of the scene.

    Young's modulus and yield strength [Pa], density [kg/m3], Poisson ratio. Raises KeyError for an unknown material.
    """
    given = materials[material]
    return Solid(given.young_modulus, given.poisson_ratio, given.density, given.yield_strength)


def pair_material(scene: Scene, first: str, second: str) -> PairMaterial:
    """Mixed constants of two materials, symmetric under their exchange.

    The restitution is a number, a fit e(v) (Zhou 2011, Eq. 12) with its limit velocity (Eq. 11 unless given), or None.
    Raises KeyError if the scene has no such pair.
    """
    pair, a, b = scene.pair(first, second), solid(scene.materials, first), solid(scene.materials, second)
    given = pair.restitution
    restitution: float | VelocityRestitution | None
    if isinstance(given, RestitutionFit):
        restitution = VelocityRestitution(given.sigma, given.psi, given.limit_velocity or limit_velocity(a, b))
    else:
        restitution = given
    models = active_models(scene)
    surface = [models[slot] for slot in ("tangential", "rolling", "twisting") if slot in models]
    options = {key: getattr(pair, key, None) or 0.0 for key in registry.pair_options()}
    return PairMaterial(
        modulus_eff(a, b),
        shear_modulus_eff(a, b),
        restitution,
        pair.friction,
        yield_strength(a, b),
        options,
        has_tangential_force=any(_acts(model, [pair]) for model in surface),
        tangential_stiffness=scene.contact.options("tangential").get("stiffness"),
    )


def pair_materials(scene: Scene, materials: tuple[str, ...]) -> dict[tuple[str, str], PairMaterial]:
    """Mixed constants of each two of the materials that can come into contact, by their names in either order."""
    names = [(first, second) for first in materials for second in materials]
    return {both: pair_material(scene, *both) for both in names if scene.pair_key(*both) in scene.pairs}


def pair_table(scene: Scene, laws: ContactLaws, materials: tuple[str, ...]) -> np.ndarray:
    """Constants of each pair of materials (materials^2, constants); NaN for pairs without contacts.

    Row i * materials + j, columns as in `ContactLaws.constant_names`. Raises SceneError if a contact model does not
    support a pair.
    """
    count = len(materials)
    table = np.full((count * count, sum(map(len, laws.constant_names.values()))), np.nan)
    for i, first in enumerate(materials):
        for j, second in enumerate(materials):
            if scene.pair_key(first, second) in scene.pairs:
                table[i * count + j] = _constants(scene, laws, first, second)
    return table


def _constants(scene: Scene, laws: ContactLaws, first: str, second: str) -> tuple[float, ...]:
    """Row of the pair constants. Raises SceneError if the contact model cannot reach the restitution."""
    try:
        return laws.pair_constants(pair_material(scene, first, second))
    except ValueError as error:
        key = scene.pair_key(first, second)
        location = scene.locate("pairs", key, "restitution")
        raise SceneError(f"{location}: pairs.{key}.restitution cannot be obtained: {error}.") from None


def pair_cases_of(scene: Scene) -> list[PairCase]:
    """The possible contacts between two groups and between a group and a wall, each for the smallest particles.

    A group of one particle does not collide with itself: that contact limits the time step, but has no `pair_key`. If
    no contact is possible, the contact of the first group with itself limits the time step. Fixed particles collide
    neither with each other nor with walls; for other particles they are walls with the radius of the largest of them.
    """
    pair_cases = []
    groups = list(scene.particles.items())
    walls = dict.fromkeys(wall.material for wall in scene.walls.values())
    for n, (name, group) in enumerate(groups):
        for other_name, other in groups[n:]:
            if not (group.fixed and other.fixed) and scene.pair_key(group.material, other.material) in scene.pairs:
                pair = pair_material(scene, group.material, other.material)
                mobile, partner = (other, group) if group.fixed else (group, other)
                occurs = name != other_name or group.count > 1
                key = scene.pair_key(group.material, other.material) if occurs else None
                pair_cases.append(
                    replace(_pair_case(scene, f"{name}-{other_name}", pair, mobile, partner), pair_key=key)
                )
        for wall in walls if not group.fixed else ():
            pair, key = pair_material(scene, group.material, wall), scene.pair_key(group.material, wall)
            pair_cases.append(replace(_pair_case(scene, f"{name}-{wall} wall", pair, group, None), pair_key=key))
    if not pair_cases:
        name, group = groups[0]
        material_solid = solid(scene.materials, group.material)
        elastic_pair = PairMaterial(
            modulus_eff(material_solid, material_solid), shear_modulus_eff(material_solid, material_solid), 1.0, 0.0
        )
        pair_cases.append(_pair_case(scene, f"{name}-{name}", elastic_pair, group, group))
    contacts = max(sum(group.count for _, group in groups) + len(scene.walls) - 1, 1)
    return [replace(pair_case, contact_count=contacts) for pair_case in pair_cases]


def _pair_case(scene: Scene, name: str, pair: PairMaterial, group: Group, other: Group | None) -> PairCase:
    """Contact of the smallest particle of a group with the smallest of another, the largest fixed, or a wall (None)."""
    smallest, largest = (0.5 * diameter for diameter in diameter_range(group))
    material_solid = solid(scene.materials, group.material)
    mass, ratio = _sphere_mass(smallest, material_solid.density), max(_mass_ratio(group), _mass_ratio(other))
    if other is None:
        return PairCase(name, pair, smallest, mass, smallest, largest, material_solid, mass_ratio=ratio)
    other_smallest, other_largest = (0.5 * diameter for diameter in diameter_range(other))
    largest = min(largest, other_largest)
    if other.fixed:
        radius_eff = smallest * other_largest / (smallest + other_largest)
        return PairCase(name, pair, radius_eff, mass, smallest, largest, material_solid, mass_ratio=ratio)
    other_mass = _sphere_mass(other_smallest, solid(scene.materials, other.material).density)
    radius_eff = smallest * other_smallest / (smallest + other_smallest)
    mass_eff = mass * other_mass / (mass + other_mass)
    return PairCase(name, pair, radius_eff, mass_eff, smallest, largest, material_solid, mass_ratio=ratio)


def _mass_ratio(group: Group | None) -> float:
    """Mass of a clump over that of its smallest sphere; 1 for spheres and walls."""
    if group is None or group.clump is None:
        return 1.0
    return group.clump.shape.volume / _sphere_mass(0.5 * diameter_range(group)[0], 1.0)


def _sphere_mass(radius: float, density: float) -> float:
    """Mass 4/3 pi R^3 rho [kg] of a sphere with radius [m] and density [kg/m3]."""
    return 4.0 / 3.0 * np.pi * radius**3 * density
