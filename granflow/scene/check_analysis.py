"""Consistency checks of fields and metrics with the rest of a scene.

They concern grids, references to groups, materials and stages, and the quantities of expectations.
"""

import math
from collections.abc import Iterator

from granflow.fields import METRIC_QUANTITIES
from granflow.scene.document import KeyPath
from granflow.scene.schema.analysis import METRIC_QUANTITIES_BY_KIND, GridSpec, LaceyMetric, ReposeMetric
from granflow.scene.schema.fields import Fault
from granflow.scene.schema.insertion import Box
from granflow.scene.schema.scene import Domain
from granflow.scene.validation import PartialScene
from granflow.scene.violations import Violation, unknown

MOST_CELLS = 2_000_000
"""Largest number of cells of a grid: one frame of this size takes about 1 GB of memory."""


def field_grids(scene_parts: PartialScene) -> Iterator[Violation]:
    """Field grids: number of cells within the limit, existing stages, full extent along periodic axes."""
    stages, domain = [stage.name for stage in scene_parts.scene.stages], scene_parts.scene.domain
    for name, grid in scene_parts.scene.output.fields.items():
        path: KeyPath = ("output", "fields", name)
        yield from _cells(domain, path, grid)
        if grid.region is not None:
            yield from _check_periodic_extent(domain, (*path, "region"), grid.region)
        for index, stage in enumerate(grid.stages or ()):
            if stage not in stages:
                yield unknown((*path, "stages", index), stage, stages, "stage")


def metrics(scene_parts: PartialScene) -> Iterator[Violation]:
    """Metrics must refer to existing groups and materials; an angle of repose requires gravity."""
    for name, metric in scene_parts.scene.output.metrics.items():
        path: KeyPath = ("output", "metrics", name)
        if isinstance(metric, LaceyMetric):
            yield from _cells(scene_parts.scene.domain, path, metric)
            for key, known, kind in (("groups", "particles", "group"), ("materials", "materials", "material")):
                for index, each in enumerate(getattr(metric, key) or ()):
                    if each not in scene_parts.names(known):
                        yield unknown((*path, key, index), each, scene_parts.names(known), kind)
        if isinstance(metric, ReposeMetric) and not any(scene_parts.scene.gravity):
            yield (*path, "kind"), Fault((), "gravity is zero, so the slope is undefined; remove this metric")


def expected_metrics(scene_parts: PartialScene) -> Iterator[Violation]:
    """Expectations must refer to existing metrics that provide the quantity, or its time average NAME_mean."""
    known = scene_parts.scene.output.metrics
    for index, expectation in enumerate(scene_parts.scene.expect):
        quantity, dot, name = expectation.quantity.partition(".")
        path: KeyPath = ("expect", index, "quantity")
        if not dot or quantity not in METRIC_QUANTITIES:
            continue
        if name not in known:
            yield unknown(path, name, known, "metric")
        elif quantity.removesuffix("_mean") not in METRIC_QUANTITIES_BY_KIND[known[name].kind]:
            numbers = ", ".join(f"{each}.{name}" for each in METRIC_QUANTITIES_BY_KIND[known[name].kind])
            yield path, Fault((), f"{name} is of kind {known[name].kind}; its quantities are {numbers}")


def _cells(domain: Domain, path: KeyPath, grid: GridSpec) -> Iterator[Violation]:
    """A violation for a grid with more than MOST_CELLS cells; none if the number of cells is not defined."""
    if (grid.cell is None) == (grid.cells is None):
        return
    count = math.prod(grid.cell_counts(domain))
    if count > MOST_CELLS:
        key = "cell" if grid.cells is None else "cells"
        reason = f"this gives {count:_} cells, and the limit is {MOST_CELLS:_}".replace("_", " ")
        yield (*path, key), Fault((), reason)


def _check_periodic_extent(domain: Domain, path: KeyPath, region: Box) -> Iterator[Violation]:
    """A violation for each periodic axis along which a region does not cover exactly the domain [m]."""
    for axis in domain.periodic:
        k = "xyz".index(axis)
        if (region.min[k], region.max[k]) != (domain.min[k], domain.max[k]):
            reach = f"{domain.min[k]:g} to {domain.max[k]:g} m"
            yield path, Fault((), f"must extend from {reach} in {axis}, where the domain is periodic", whole=True)
