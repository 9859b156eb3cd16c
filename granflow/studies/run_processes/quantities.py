"""Names of the numbers that the result of a run of a scene contains."""

from granflow import Scene
from granflow.fields import (
    FLOW_METER_QUANTITIES,
    INSERTION_QUANTITIES,
    OUTLET_QUANTITIES,
    RUN_QUANTITIES,
    TOTAL_QUANTITIES,
    WALL_FORCE_QUANTITIES,
    WALL_QUANTITIES,
)
from granflow.scene.schema.analysis import METRIC_QUANTITIES_BY_KIND
from granflow.scene.suggest import nearest

PHASES = ("neighbor_list", "forces", "integration", "output", "compile", "exchange", "waiting")
"""Phases of a run with a wall-clock time, `timings.PHASE`; the last two on MPI ranks."""


def result_names(scene: Scene) -> tuple[str, ...]:
    """The names that a run of the scene can have, as in its `expect:` block."""
    names = [*TOTAL_QUANTITIES, *RUN_QUANTITIES, *(f"timings.{phase}" for phase in PHASES)]
    for meter in scene.output.flow_meters:
        parts = [meter, *(f"{meter}.{part}" for part in scene.flow_meter_parts(meter))]
        names += [f"{quantity}.{part}" for quantity in FLOW_METER_QUANTITIES for part in parts]
    for name, metric in scene.output.metrics.items():
        quantities = METRIC_QUANTITIES_BY_KIND[metric.kind]
        names += [f"{quantity}{end}.{name}" for quantity in quantities for end in ("", "_mean")]
    names += [f"{quantity}.{wall}" for quantity in WALL_FORCE_QUANTITIES for wall in scene.measured_walls]
    names += [f"{quantity}.{wall}" for quantity in WALL_QUANTITIES for wall, each in scene.walls.items() if each.motion]
    names += [f"{quantity}.{outlet}" for quantity in OUTLET_QUANTITIES for outlet in scene.outlets]
    names += [f"{quantity}.{group}" for quantity in INSERTION_QUANTITIES for group in scene.particles]
    return tuple(names)


def unknown_quantity(name: str, scene: Scene) -> str:
    """Why a run of the scene has no number of this name, with the closest name; empty if it has one."""
    known = result_names(scene)
    if name in known:
        return ""
    near = nearest(name, known)
    with_parts = ", ".join(each for each in known if "." in each and not each.startswith("timings."))
    remedy = f"Did you mean {near}?" if near else f"Apart from totals such as kinetic_energy it has {with_parts}."
    return f"{name} is not a number of a run of {scene.path.name or 'the scene'}. {remedy}"


def error_name(quantity: str) -> str:
    """Name of the standard error of a number, such as angle_of_repose_error_mean.left; few quantities have one."""
    name, dot, part = quantity.partition(".")
    base, end = (name[: -len("_mean")], "_mean") if name.endswith("_mean") else (name, "")
    return f"{base}_error{end}{dot}{part}"
