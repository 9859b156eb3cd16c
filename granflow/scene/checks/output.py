"""Output and expectations: grids, metrics, flow meters and wall forces, and the names to which they refer."""

import math
from collections.abc import Iterable, Iterator

from granflow.fields import (
    ENERGY_BUDGET_QUANTITIES,
    FLOW_METER_QUANTITIES,
    INSERTION_QUANTITIES,
    METRIC_QUANTITIES,
    OUTLET_QUANTITIES,
    RUN_QUANTITIES,
    TOTAL_QUANTITIES,
    WALL_FORCE_QUANTITIES,
    WALL_QUANTITIES,
)
from granflow.scene.document import KeyPath
from granflow.scene.partial import PartialScene, unknown
from granflow.scene.schema.analysis import (
    METRIC_QUANTITIES_BY_KIND,
    CenterOfMassMetric,
    GridSpec,
    ProbeMetric,
    ReposeMetric,
    SlidingMetric,
    TwoComponentGrid,
)
from granflow.scene.schema.domain import Domain
from granflow.scene.schema.faults import Fault, whole
from granflow.scene.schema.insertion import TimedInsertion
from granflow.scene.schema.scene import SceneInput
from granflow.scene.schema.shapes import Box
from granflow.scene.schema.walls import Plane
from granflow.scene.suggest import nearest

MOST_CELLS = 2_000_000
"""Largest number of cells of a grid: one frame of this size takes about 1 GB of memory."""


def field_grids(parts: PartialScene) -> Iterator[Fault]:
    """Field grids: number of cells within the limit, existing stages, full extent along periodic axes."""
    stages, domain = [stage.name for stage in parts.scene.stages], parts.scene.domain
    for name, grid in parts.scene.output.fields.items():
        path: KeyPath = ("output", "fields", name)
        yield from _cells(domain, path, grid)
        if grid.region is not None:
            yield from _periodic_extent(domain, (*path, "region"), grid.region)
        yield from _unknown_names((*path, "stages"), grid.stages, stages, "stage")


def metrics(parts: PartialScene) -> Iterator[Fault]:
    """Metrics must refer to existing groups, materials and walls; an angle of repose requires gravity."""
    for name, metric in parts.scene.output.metrics.items():
        path: KeyPath = ("output", "metrics", name)
        if isinstance(metric, TwoComponentGrid):
            yield from _cells(parts.scene.domain, path, metric)
            yield from _unknown_names((*path, "groups"), metric.groups, parts.names("particles"), "group")
            yield from _unknown_names((*path, "materials"), metric.materials, parts.names("materials"), "material")
        if isinstance(metric, CenterOfMassMetric):
            yield from _unknown_names((*path, "groups"), metric.groups, parts.names("particles"), "group")
        if isinstance(metric, SlidingMetric):
            yield from _unknown_names((*path, "walls"), metric.walls, parts.names("walls"), "wall")
        if isinstance(metric, ProbeMetric):
            yield from _unknown_particle((*path, "id"), metric.id, parts.scene)
        if isinstance(metric, ReposeMetric) and not any(parts.scene.gravity):
            yield Fault((*path, "kind"), "gravity is zero, so the slope is undefined; remove this metric")


def _unknown_particle(path: KeyPath, particle_id: int, scene: SceneInput) -> Iterator[Fault]:
    """A fault for an id that no particle has; none if the number of particles is not given."""
    counts = [group.count_given for group in scene.particles.values()]
    known = sum(count or 0 for count in counts)
    if scene.scale == 1.0 and all(counts) and particle_id >= known:
        yield Fault(path, f"the ids of the {known} particles are 0 to {known - 1}")


def _unknown_names(path: KeyPath, given: Iterable[str] | None, known: Iterable[str], kind: str) -> Iterator[Fault]:
    """Faults of the items of a list that are not known names."""
    yield from (unknown((*path, i), name, known, kind) for i, name in enumerate(given or ()) if name not in known)


def _cells(domain: Domain, path: KeyPath, grid: GridSpec) -> Iterator[Fault]:
    """A fault for a grid with more than MOST_CELLS cells; none if the number of cells is not defined."""
    if (grid.cell is None) == (grid.cells is None):
        return
    count = math.prod(grid.cell_counts(domain))
    if count > MOST_CELLS:
        reason = f"this gives {count:_} cells, and the limit is {MOST_CELLS:_}".replace("_", " ")
        yield Fault((*path, "cell" if grid.cells is None else "cells"), reason)


def _periodic_extent(domain: Domain, path: KeyPath, region: Box) -> Iterator[Fault]:
    """A fault for each periodic axis along which a region does not cover exactly the domain [m]."""
    for axis in domain.periodic:
        k = "xyz".index(axis)
        if (region.min[k], region.max[k]) != (domain.min[k], domain.max[k]):
            reach = f"{domain.min[k]:g} to {domain.max[k]:g} m"
            yield whole(path, f"must extend from {reach} in {axis}, where the domain is periodic")


def _expected(scene: SceneInput) -> Iterator[tuple[KeyPath, str, str]]:
    """Key path, quantity and part of each expectation of a quantity with a part, such as mass_flow.outlet."""
    for path, quantity, part in _all_expected(scene):
        if part is not None:
            yield path, quantity, part


def _all_expected(scene: SceneInput) -> Iterator[tuple[KeyPath, str, str | None]]:
    """Key path, quantity and part of each expectation and each condition of a stage.

    The part is None for a quantity of the whole run.
    """
    named: list[tuple[KeyPath, str]] = [
        (("expect", index, "quantity"), each.quantity) for index, each in enumerate(scene.expect)
    ]
    for number, stage in enumerate(scene.stages):
        named += [
            (("stages", number, "until", index, "quantity"), each.quantity) for index, each in enumerate(stage.until)
        ]
    for path, name in named:
        quantity, dot, part = name.partition(".")
        yield path, quantity, part if dot else None


RESULT_ONLY = {
    *(*RUN_QUANTITIES, "timings", "wall_force", "wall_torque"),
    *(name for name in WALL_FORCE_QUANTITIES if name.endswith(("_largest", "_last"))),
}
"""Quantities of the result that rows of the time series do not have."""

_WHOLE = {**TOTAL_QUANTITIES, **RUN_QUANTITIES}
"""Quantities of the whole run."""

_PARTS = {
    **{name: "the name of a flow meter" for name in FLOW_METER_QUANTITIES},
    **{name: "the name of an outlet" for name in OUTLET_QUANTITIES},
    **{name: "the name of a particle group" for name in INSERTION_QUANTITIES},
    **{name: "the name of a wall" for name in (*WALL_FORCE_QUANTITIES, *WALL_QUANTITIES)},
    **{name: "the name of a metric" for name in METRIC_QUANTITIES},
    "timings": "forces or another phase",
}
"""What follows the point after a quantity."""


def expected_names(parts: PartialScene) -> Iterator[Fault]:
    """Expectations must refer to existing quantities, with a name of the kind that the quantity requires."""
    for path, quantity, part in _all_expected(parts.scene):
        if part is not None and quantity not in _PARTS and quantity in _WHOLE:
            yield Fault(path, f"{quantity} is a quantity of the whole run; write {quantity}")
        elif part is None and quantity not in _WHOLE and quantity in _PARTS:
            yield Fault(path, f"{quantity} requires {_PARTS[quantity]}; write {quantity}.NAME")
        elif quantity not in _WHOLE and quantity not in _PARTS:
            yield Fault(path, f"there is no such quantity. {_similar_quantity(quantity, part)}")
        elif quantity in ENERGY_BUDGET_QUANTITIES and not parts.scene.output.energy_budget:
            yield Fault(path, "output.energy_budget is false; set it to true")


def _similar_quantity(quantity: str, part: str | None) -> str:
    """Remedy for an unknown quantity with the name `part` behind the point, or None."""
    found = nearest(quantity, [*_WHOLE, *_PARTS])
    if found is None:
        return "Give one such as kinetic_energy or mass_flow.NAME"
    end = f".{part or 'NAME'}" if found in _PARTS else ""
    return f"Did you mean {found}{end}?"


def condition_columns(parts: PartialScene) -> Iterator[Fault]:
    """Conditions of stages must refer to columns of the time series, not to results of the whole run."""
    for number, stage in enumerate(parts.scene.stages):
        for index, condition in enumerate(stage.until):
            path: KeyPath = ("stages", number, "until", index, "quantity")
            quantity, _, part = condition.quantity.partition(".")
            wall = parts.scene.walls.get(part)
            if quantity in WALL_QUANTITIES and wall and not any(each.force_controlled for each in wall.motion):
                yield Fault(path, f"{part} is neither a servo nor a free wall; its displacement follows from the time")
            elif quantity in RESULT_ONLY or quantity.endswith("_mean") or quantity in INSERTION_QUANTITIES:
                yield Fault(path, "it is a result of the whole run; give a column of timeseries.csv")


def expected_parts(parts: PartialScene) -> Iterator[Fault]:
    """Expectations must refer to existing flow meters, outlets and inserted groups."""
    scene, meters = parts.scene, parts.scene.output.flow_meters
    meter_names = [*meters, *(f"{name}.{part}" for name in meters for part in scene.flow_meter_parts(name))]
    inserted = [name for name, group in scene.particles.items() if isinstance(group.insert, TimedInsertion)]
    known: tuple[tuple[Iterable[str], Iterable[str], str], ...] = (
        (FLOW_METER_QUANTITIES, meter_names, "flow meter"),
        (OUTLET_QUANTITIES, parts.names("outlets"), "outlet"),
        (INSERTION_QUANTITIES, inserted, "inserted group"),
    )
    for path, quantity, part in _expected(scene):
        for quantities, names, kind in known:
            if quantity in quantities and part not in names:
                yield unknown(path, part, names, kind)


def expected_metrics(parts: PartialScene) -> Iterator[Fault]:
    """Expectations must refer to existing metrics that provide the quantity, or its time average NAME_mean."""
    known = parts.scene.output.metrics
    for path, quantity, name in _expected(parts.scene):
        if quantity not in METRIC_QUANTITIES:
            continue
        if name not in known:
            yield unknown(path, name, known, "metric")
        elif quantity.removesuffix("_mean") not in METRIC_QUANTITIES_BY_KIND[known[name].kind]:
            numbers = ", ".join(f"{each}.{name}" for each in METRIC_QUANTITIES_BY_KIND[known[name].kind])
            yield Fault(path, f"{name} is of kind {known[name].kind}; its quantities are {numbers}")


def wall_forces(parts: PartialScene) -> Iterator[Fault]:
    """Wall forces of existing walls, expectations of measured wall forces, pressures of walls with an area.

    An expectation NAME.WALL requires that `output.wall_forces` includes the wall.
    """
    requested, known = parts.scene.output.wall_forces, parts.names("walls")
    if not isinstance(requested, bool):
        yield from _unknown_names(("output", "wall_forces"), requested, known, "wall")
    measured = known if requested is True else requested or ()
    for path, quantity, wall in _expected(parts.scene):
        if quantity not in WALL_FORCE_QUANTITIES:
            continue
        if wall not in known:
            yield unknown(path, wall, known, "wall")
        elif wall not in measured:
            remedy = "write wall_forces: true, or add it to the list"
            yield Fault(path, f"output.wall_forces does not include {wall}; {remedy}")
        elif "pressure" in quantity and isinstance(parts.scene.walls.get(wall), Plane):
            remedy = "use wall_force_x, wall_force_y or wall_force_z"
            yield Fault(path, f"the plane {wall} is infinite and has no area; {remedy}")
