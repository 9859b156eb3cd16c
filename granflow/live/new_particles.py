"""Particles that are added from Python: arguments to arrays."""

from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np

from granflow.errors import GranflowError
from granflow.live.values import array_of, in_domain, named
from granflow.particles.particle_data import ParticleData
from granflow.plan.plan import Plan
from granflow.plan.scene_parts import PlannedGroup
from granflow.scene.checks.pairs import pair_name, possible_contacts
from granflow.scene.suggest import suggestion_sentence

ARGUMENTS = ("position", "diameter", "material", "velocity", "group", "angular_velocity")
"""Arguments of `LiveParticles.add`."""


def refuse_other_arguments(given: Iterable[str]) -> None:
    """Raise GranflowError for the first of these arguments, which `LiveParticles.add` does not have."""
    for name in given:
        remedy = "Give diameter, twice the radius."
        if name != "radius":
            remedy = suggestion_sentence(name, ARGUMENTS, "arguments")
        raise GranflowError(f"particles.add has no argument {name}. {remedy}")


def particle_data(
    plan: Plan,
    position: Any,
    diameter: Any,
    material: str | None,
    velocity: Any,
    group: str | None,
    angular_velocity: Any,
) -> ParticleData:
    """Arrays of new particles from the arguments of `LiveParticles.add`. Raises GranflowError."""
    centers = np.asarray(position, dtype=object)
    count = 1 if centers.ndim == 1 and centers.shape == (3,) else len(centers) if centers.ndim else 0
    number = _group_number(plan, material, group)
    chosen = plan.groups[number]
    position = array_of("position", position, count, 3)
    in_domain(plan, "position", position)
    velocity = array_of("velocity", velocity, count, 3)
    angular_velocity = array_of("angular_velocity", angular_velocity, count, 3)
    if chosen.fixed and (velocity.any() or angular_velocity.any()):
        raise GranflowError(f"group is {chosen.name}, which is fixed: leave out velocity and angular_velocity.")
    return ParticleData(
        position=position,
        velocity=velocity,
        angular_velocity=angular_velocity,
        radius=0.5 * _diameters(plan, chosen, diameter, count),
        material=np.full(count, list(plan.solids).index(chosen.material), dtype=np.int32),
        group=np.full(count, number, dtype=np.int32),
    )


def refuse_without_pair(plan: Plan, counts: np.ndarray) -> None:
    """Raise GranflowError if particles can be in contact without constants of their pair.

    `counts`: number of particles of each group: present, added, and to be inserted.
    """
    mobile, fixed = Counter[str](), Counter[str]()
    for group, count in zip(plan.groups, counts, strict=True):
        if count:
            (fixed if group.fixed else mobile)[group.material] += int(count)
    for both, reason in possible_contacts(mobile, fixed, walls={}).items():
        if (min(both), max(both)) not in plan.pair_materials:
            raise GranflowError(f"{reason} now, but the scene has no pair {pair_name(both)}; add it to pairs.")


def _group_number(plan: Plan, material: str | None, group: str | None) -> int:
    """Number of the group: given, or the only one of the material, or of the scene."""
    names, materials = [each.name for each in plan.groups], [each.material for each in plan.groups]
    if material is not None:
        named("material", material, list(dict.fromkeys(materials)))
    if group is None and material is None and len(names) > 1:
        raise GranflowError(f"group is missing: give one of {', '.join(names)}.")
    if group is None and material is not None and materials.count(material) > 1:
        both = [name for name, each in zip(names, materials, strict=True) if each == material]
        raise GranflowError(f"group is missing: {', '.join(both)} are of {material}.")
    if group is None:
        return 0 if material is None else materials.index(material)
    number = named("group", group, names)
    if material not in (None, materials[number]):
        raise GranflowError(f"material is {material!r}, but the group {group} is of {materials[number]}.")
    return number


def _diameters(plan: Plan, group: PlannedGroup, given: Any, count: int) -> np.ndarray:
    """Diameters (count,) [m]: given, or that of the group. Those of the scene bound them."""
    low, high = group.diameters
    if given is None and low < high:
        raise GranflowError(
            f"diameter is missing: the group {group.name} has diameters from {low:.6g} to {high:.6g} m."
        )
    diameter = array_of("diameter", low if given is None else given, count, None)
    smallest, largest = 2.0 * plan.radius_min, 2.0 * plan.radius_max
    outside = (diameter < smallest) | (diameter > largest)
    if outside.any():
        raise GranflowError(
            f"diameter contains {diameter[outside][0]:.6g} m, but the diameters of the scene, on which time step and "
            f"neighbor lists depend, lie in [{smallest:.6g}, {largest:.6g}] m."
        )
    return diameter
