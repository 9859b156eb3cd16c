"""Changes from Python that checkpoints contain: capacity, walls, parameters of forces, removed observers, functions.

Functions cannot be stored: a program that resumes the run must register functions of the same names.
"""

from collections.abc import Collection, Sequence
from dataclasses import asdict, astuple, fields, replace
from typing import Any

from granflow.errors import GranflowError
from granflow.geometry.motion import Motion, Placement
from granflow.io.checkpoint import Checkpoint
from granflow.io.checkpoint_parts import LARGEST_REAL, Part
from granflow.plan.external_forces import ExternalForce
from granflow.plan.plan import Plan
from granflow.plan.sum_units import SumUnits
from granflow.plan.wall_changes import MOTIONS, changed_walls, wall_named, with_wall
from granflow.plan.walls import PlannedMotion, PlannedWall
from granflow.runs.observer_list import ObserverList

KEYS = ("particle_capacity", "sum_units", "walls", "external_forces", "forces", "functions", "removed_observers")
"""Keys of the changes in a checkpoint, and of what the plan of another scene would change."""

MOST_PARTICLES = 2**31 - 2
"""Largest capacity: indices on the device are 32-bit integers."""

MATRIX_FIELDS = {"rotation"}
"""Fields of motions with nine numbers; the others are numbers or vectors."""


def saved_changes(plan: Plan, original: Plan, observers: ObserverList) -> dict[str, Any]:
    """Return the changes for a checkpoint: plain numbers, texts, lists and mappings.

    `plan`: present plan; `original`: plan of the scene.
    """
    return {
        "particle_capacity": plan.particle_capacity,
        "sum_units": list(astuple(plan.sum_units)),
        "walls": {name: _saved_wall(wall) for name, wall in changed_walls(plan, original).items()},
        "external_forces": plan.features.external_forces,
        "forces": {
            force.name: {
                name: list(value) if isinstance(value, tuple) else value for name, value in force.values.items()
            }
            for force in plan.external_forces
        },
        "functions": observers.function_names,
        "removed_observers": observers.removed_names,
    }


def changed_plan(plan: Plan, checkpoint: Checkpoint) -> Plan:
    """Return the plan of the scene with the capacity, units of sums, walls and features of the checkpoint.

    Raises CheckpointError for values that are not valid, GranflowError for walls that are too fast.
    """
    part = Part.of(checkpoint)["changes"]
    part.mapping(KEYS)
    # A scene with more particles than that of the checkpoint is refused later, with the keys that differ.
    capacity = max(part["particle_capacity"].integer(1, MOST_PARTICLES), plan.particle_capacity)
    features = replace(plan.features, external_forces=part["external_forces"].flag())
    units = SumUnits(*(each.number() for each in part["sum_units"].items(len(fields(SumUnits)))))
    if not units.are_valid:
        raise part["sum_units"].error("holds a number that is not a power of two")
    plan = replace(plan, particle_capacity=capacity, features=features, saved_sum_units=units)
    part["walls"].mapping()
    for each in part["walls"].parts():
        name = each.key.rsplit("/", 1)[-1]
        if name not in [wall.name for wall in plan.walls]:
            raise each.error("is not a wall of the scene")
        plan = with_wall(plan, _restored_wall(each, wall_named(plan, name)))
    for key in ("functions", "removed_observers"):
        for each in part[key].items():
            each.text()
    return plan


def refuse_other_functions(
    checkpoint: Checkpoint, forces: Sequence[ExternalForce], functions: Collection[str], allow_changes: bool
) -> None:
    """Check that the forces and the functions of observers of a checkpoint are registered again.

    `forces`, `functions`: forces, and names of the functions of observers, of the program that resumes the run.
    `allow_changes`: continue without some of them. Raises GranflowError.
    """
    changes = Part.of(checkpoint)["changes"]
    registered = [force.name for force in forces]
    added = [name for name in registered if name not in changes["forces"].mapping()]
    if added:
        raise GranflowError(
            f"{checkpoint.path}: the run has no force {', '.join(added)}; add it after the start of the resumed "
            "simulation with simulation.forces.append."
        )
    for what, saved, present in (
        ("forces", list(changes["forces"].mapping()), registered),
        ("observers", changes["functions"].value, functions),
    ):
        missing = [name for name in saved if name not in present]
        if missing and not allow_changes:
            raise GranflowError(
                f"{checkpoint.path}: the run has {what} from Python that this program does not register: "
                f"{', '.join(missing)}. Give them to Simulation with {what}=[...], or continue without them with "
                "allow_changes (--allow-changes)."
            )


def saved_parameters(checkpoint: Checkpoint, force: ExternalForce) -> dict[str, Any]:
    """Return the values of the parameters of a force in a checkpoint. Raises CheckpointError for other parameters."""
    part = Part.of(checkpoint)["changes"]["forces"][force.name]
    part.mapping([name for name, _ in force.layout])
    return {name: _numbers(part[name], width) for name, width in force.layout}


def _numbers(part: Part, width: int) -> float | tuple[float, ...]:
    """A number, or a list of `width` numbers as a tuple."""
    if width == 1:
        return part.number(-LARGEST_REAL, LARGEST_REAL)
    return tuple(each.number(-LARGEST_REAL, LARGEST_REAL) for each in part.items(width))


def _saved_wall(wall: PlannedWall) -> dict[str, Any]:
    """End of a changed wall [s], and its motions if a program has changed them, otherwise None."""
    motions = [each.given for each in wall.motions]
    is_placed = bool(motions) and isinstance(motions[0], Placement)
    saved = [{"kind": type(each).__name__, **_lists(asdict(each))} for each in motions] if is_placed else None
    return {"vanishes_at": wall.vanishes_at, "motions": saved}


def _lists(values: Any) -> Any:
    """The values with lists instead of tuples."""
    if isinstance(values, dict):
        return {name: _lists(value) for name, value in values.items()}
    return [_lists(value) for value in values] if isinstance(values, tuple) else values


def _restored_wall(part: Part, wall: PlannedWall) -> PlannedWall:
    """The wall of the scene with the saved changes. Raises CheckpointError."""
    part.mapping(("vanishes_at", "motions"))
    wall = replace(wall, vanishes_at=part["vanishes_at"].number(0.0))
    if part["motions"].value is None:
        return wall
    return replace(wall, motions=tuple(PlannedMotion(_restored(each), None) for each in part["motions"].items()))


def _restored(part: Part) -> Motion:
    """One motion. Raises CheckpointError."""
    kind = MOTIONS[part["kind"].text(MOTIONS)]
    types = {each.name: each.type for each in fields(kind)}
    part.mapping(("kind", *types))
    values: dict[str, Any] = {}
    for name, field_type in types.items():
        if name in MATRIX_FIELDS and kind is Placement:
            values[name] = tuple(_numbers(row, 3) for row in part[name].items(3))
        elif name in ("start", "end"):
            values[name] = part[name].number(0.0)
        else:
            values[name] = _numbers(part[name], 1 if field_type is float else 3)
    motion: Motion = kind(**values)
    return motion
