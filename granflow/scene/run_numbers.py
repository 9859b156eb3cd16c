"""The numbers that a run of a scene has, QUANTITY or QUANTITY.PART, as `expect` names them.

`granflow.fields` defines the quantities; here are the conditions under which a scene has a total, and the
parts of a scene that have a quantity. Checks of `expect` and of the conditions of stages use them, and
studies, which read numbers of their runs.
"""

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass

from granflow.contact import registry
from granflow.contact.law import SLOTS, ContactModel
from granflow.contact.particle_equation import ParticleEquation
from granflow.fields import (
    BOX_QUANTITIES,
    CONTROLLED_WALL_PARTS,
    ENERGY_BUDGET_QUANTITIES,
    FLOW_METER_PARTS,
    INSERTION_PARTS,
    METRIC_PARTS,
    OUTLET_PARTS,
    PART_KINDS,
    RESIDENCE_PARTS,
    RUN_QUANTITIES,
    STAGE_PARTS,
    STAGE_QUANTITIES,
    TIMING_PARTS,
    TOTAL_QUANTITIES,
    WALL_FLOW_PARTS,
    WALL_FORCE_PARTS,
    WEAR_PARTS,
    PartQuantities,
    parts_with,
    whole_quantity,
)
from granflow.geometry.periodic_box import AXES
from granflow.scene.blocks.insertions import TimedInsertion
from granflow.scene.blocks.scene import SceneInput
from granflow.schema.messages import nearest, no_such

# Totals that only some scenes have


@dataclass(frozen=True)
class Condition:
    """Totals that a scene has if `holds`; otherwise `remedy` says what gives them."""

    totals: Collection[str]
    holds: Callable[[SceneInput], bool]
    remedy: str


def _is_deformed(scene: SceneInput) -> bool:
    """Whether the widths of the periodic box change."""
    return bool(list(scene.deformations()))


CONDITIONS = (
    Condition(
        ENERGY_BUDGET_QUANTITIES,
        lambda scene: scene.output.energy_budget,
        "output.energy_budget is false; set it to true",
    ),
    Condition(
        BOX_QUANTITIES,
        _is_deformed,
        "it requires a box that deforms; give domain.deformation, or the deformation of a stage",
    ),
    Condition(
        ("shear_strain",),
        lambda scene: scene.domain.lees_edwards is not None,
        "it requires a sheared box; give domain.lees_edwards",
    ),
    Condition(
        tuple(f"gravity_{axis}" for axis in AXES),
        lambda scene: scene.gravity_changes,
        "gravity is constant; give it a motion, a table, or other values in stages",
    ),
    Condition(("gravity_work",), lambda scene: scene.gravity_changes, "gravity is constant"),
    Condition(("boundary_work",), lambda scene: bool(scene.domain.periodic), "it requires domain.periodic"),
    Condition(
        ("free_wall_energy", "free_wall_work"),
        lambda scene: bool(_controlled_walls(scene, "free_wall_energy")),
        "no wall is moved by forces; give one a motion of the kind servo or free",
    ),
    Condition(
        ("queued_count",),
        lambda scene: bool(_inserted_groups(scene, "queued_count")),
        "no group of particles is inserted during the run",
    ),
    Condition(("wall_contact_count",), lambda scene: bool(scene.walls), "the scene has no walls"),
    Condition(
        ("liquid_film_volume", "liquid_bridge_volume"),
        lambda scene: scene.contact.name("cohesion") in registry.liquid_models(),
        "it requires a cohesion model with transfer of liquid",
    ),
)
"""Conditions of the totals of `granflow.fields`; `_added_totals` has those that contact models add."""


def _added_totals(
    equations: Iterable[ParticleEquation],
    models: Iterable[ContactModel],
    has_source: Callable[[str], object],
) -> set[str]:
    """Names of the totals of particle equations, and of what flows through contacts of models.

    has_source:  whether particles have a source of this name
    """
    flows = [flow for model in models for flow in model.law.flows.values()]
    return {
        *(total.name for equation in equations for total in equation.totals),
        *(flow.from_surroundings.name for flow in flows if flow.from_surroundings is not None),
        *(flow.source.total.name for flow in flows if flow.source and has_source(flow.source.name)),
    }


def reason_without_total(scene: SceneInput, name: str) -> str:
    """Why a run of the scene has no total of this name; empty if it has one."""
    for condition in CONDITIONS:
        if name in condition.totals and not condition.holds(scene):
            return condition.remedy
    if name in BOX_QUANTITIES:
        periodic = scene.domain.periodic
        needed = tuple(AXES) if name in ("box_pressure", "stress_ratio") else (name.rpartition("_")[2],)
        lacking = ", ".join(axis for axis in AXES if axis in needed and axis not in periodic)
        if lacking:
            present = f"{', '.join(periodic)}; it requires {lacking} there, too"
            return f"domain.periodic is {present if periodic else f'none; it requires {lacking} there'}"
    registered = [model for slot in SLOTS for model in registry.models(slot).values()]
    added = _added_totals(registry.equations(), registered, lambda source: True)
    if name in added - _added_totals(scene.equations, scene.active_models.values(), scene.places_of):
        return "no contact model and no particle equation of the scene has it"
    return ""


# Parts that have a quantity


def _worn_walls(scene: SceneInput, quantity: str) -> list[str]:
    worn = {name: wall for name, wall in scene.walls.items() if wall.wear is not None}
    if quantity in ("wear_volume", "wear_depth_largest"):
        worn = {name: wall for name, wall in worn.items() if wall.wear is not None and wall.wear.has_volume}
    if quantity == "wear_depth_largest":
        worn = {name: wall for name, wall in worn.items() if wall.has_area(scene.domain)}
    return list(worn)


def _measured_walls(scene: SceneInput, quantity: str) -> list[str]:
    return [
        name
        for name in scene.measured_walls
        if "pressure" not in quantity or scene.walls[name].has_area(scene.domain)
    ]


def _giving_walls(scene: SceneInput, quantity: str) -> list[str]:
    read = [key for each in scene.chosen_models.values() for key in each.law.wall_properties.model_fields]
    return [name for name, wall in scene.walls.items() if any(getattr(wall, key) is not None for key in read)]


def _controlled_walls(scene: SceneInput, quantity: str) -> list[str]:
    return [name for name, wall in scene.walls.items() if wall.is_force_controlled]


def _flow_meters(scene: SceneInput, quantity: str) -> list[str]:
    meters = scene.output.flow_meters
    return [*meters, *(f"{name}.{part}" for name in meters for part in scene.flow_meter_parts(name))]


def _inserted_groups(scene: SceneInput, quantity: str) -> list[str]:
    return [name for name, group in scene.particles.items() if isinstance(group.insert, TimedInsertion)]


def _residence_ends(scene: SceneInput, quantity: str) -> list[str]:
    return [] if scene.output.residence_time is None else [scene.output.residence_time.to]


def _metrics(scene: SceneInput, quantity: str) -> list[str]:
    base = quantity.removesuffix("_mean")
    return [
        name
        for name, metric in scene.output.metrics.items()
        if base in [each.name for each in metric.quantities]
    ]


PHASES = ("neighbor_list", "forces", "integration", "output", "compile", "exchange", "waiting")
"""Phases of a run with a wall-clock time, `timings.PHASE`; the last two on MPI ranks."""

_NAMES: dict[PartQuantities, Callable[[SceneInput, str], Iterable[str]]] = {
    METRIC_PARTS: _metrics,
    FLOW_METER_PARTS: _flow_meters,
    STAGE_PARTS: lambda scene, quantity: scene.stage_names,
    OUTLET_PARTS: lambda scene, quantity: scene.outlets,
    RESIDENCE_PARTS: _residence_ends,
    INSERTION_PARTS: _inserted_groups,
    WALL_FORCE_PARTS: _measured_walls,
    CONTROLLED_WALL_PARTS: _controlled_walls,
    WALL_FLOW_PARTS: _giving_walls,
    WEAR_PARTS: _worn_walls,
    TIMING_PARTS: lambda scene, quantity: PHASES,
}
"""For each kind of part, the names of those in a scene that have a quantity."""


def _reason_without_part(scene: SceneInput, kind: PartQuantities, quantity: str, part: str) -> str:
    """Why the scene has no part of this name with a quantity of this kind of part."""
    if kind is METRIC_PARTS and part in scene.output.metrics:
        metric = scene.output.metrics[part]
        numbers = ", ".join(f"{each.name}.{part}" for each in metric.quantities)
        return f"{part} is of kind {metric.kind}; its quantities are {numbers}"
    if kind is RESIDENCE_PARTS and scene.output.residence_time is None:
        return "output.residence_time is missing; give {from: inlet, to: outlet}"
    if kind is WALL_FORCE_PARTS and part in scene.walls:
        if part not in scene.measured_walls:
            remedy = "write wall_forces: true, or add it to the list"
            return f"output.wall_forces does not include {part}; {remedy}"
        remedy = "use wall_force_x, wall_force_y or wall_force_z"
        return f"the {scene.walls[part].shape} {part} is infinite and has no area; {remedy}"
    if kind is CONTROLLED_WALL_PARTS and part in scene.walls:
        return f"{part} is neither a servo nor a free wall; its displacement follows from the time"
    names = scene.walls if kind is WALL_FORCE_PARTS else _NAMES[kind](scene, quantity)
    return no_such(part, names, kind.kind)


# Names of numbers


def reason_without(scene: SceneInput, name: str) -> str:
    """Why a run of the scene has no number of this name, and the remedy; empty if it has one."""
    quantity, point, part = name.partition(".")
    kinds = list(parts_with(quantity))
    is_whole = whole_quantity(quantity) is not None
    if not kinds and not is_whole:
        return f"there is no such quantity. {_similar(quantity, part)}"
    if not point:
        if not is_whole:
            return f"{name} requires {kinds[0].part}; write {name}.NAME"
        return reason_without_total(scene, _total(quantity))
    if not kinds:
        return f"{quantity} is a quantity of the whole run; write {quantity}"
    having = [kind for kind in kinds if part in _NAMES[kind](scene, quantity)]
    if not having:
        return _reason_without_part(scene, kinds[0], quantity, part)
    return reason_without_total(scene, _total(quantity)) if having == [STAGE_PARTS] else ""


def is_result_only(name: str) -> bool:
    """Whether the number, with or without its part, is in the result, but not in rows of the time series."""
    quantity = name.partition(".")[0]
    kinds = list(parts_with(quantity))
    is_known = bool(kinds) or whole_quantity(quantity) is not None
    in_rows = quantity in TOTAL_QUANTITIES or any(kind.in_rows(quantity) for kind in kinds)
    return is_known and not in_rows


def _total(quantity: str) -> str:
    """The total of which a quantity is the mean or the largest value over a stage; otherwise the quantity."""
    return quantity.rpartition("_")[0] if quantity in STAGE_QUANTITIES else quantity


def _similar(quantity: str, part: str) -> str:
    """Remedy for an unknown quantity with the name `part` behind the point, or without one."""
    with_parts = [name for kind in PART_KINDS for name in kind.quantities]
    found = nearest(quantity, [*TOTAL_QUANTITIES, *STAGE_QUANTITIES, *RUN_QUANTITIES, *with_parts])
    if found is None:
        return "Give one such as kinetic_energy or mass_flow.NAME"
    end = f".{part or 'NAME'}" if found in with_parts else ""
    return f"Did you mean {found}{end}?"
