"""Checks of fields and indices against the rest of a scene."""

import math
from collections.abc import Iterator

from granflow.quantities import INDEX_QUANTITIES
from granflow.scene.analysis import QUANTITIES_OF, CellGrid, LaceyIndex, ReposeIndex
from granflow.scene.document import KeyPath
from granflow.scene.draft import Draft
from granflow.scene.fields import Fault
from granflow.scene.findings import Finding, unknown
from granflow.scene.places import Box
from granflow.scene.schema import Domain

MOST_CELLS = 2_000_000
"""Of a grid: a frame of that many takes about a gigabyte of memory."""


def field_grids(draft: Draft) -> Iterator[Finding]:
    """Fields with no more cells than memory holds, in stages that exist, across the domain where that is periodic."""
    stages, domain = [stage.name for stage in draft.scene.stages], draft.scene.domain
    for name, grid in draft.scene.output.fields.items():
        path: KeyPath = ("output", "fields", name)
        yield from _cells(domain, path, grid)
        if grid.region is not None:
            yield from _across(domain, (*path, "region"), grid.region)
        for index, stage in enumerate(grid.stages or ()):
            if stage not in stages:
                yield unknown((*path, "stages", index), stage, stages, "stage")


def indices(draft: Draft) -> Iterator[Finding]:
    """Indices of groups and materials that exist, slopes where there is an upward direction."""
    for name, asked in draft.scene.output.indices.items():
        path: KeyPath = ("output", "indices", name)
        if isinstance(asked, LaceyIndex):
            yield from _cells(draft.scene.domain, path, asked)
            for key, known, kind in (("groups", "particles", "group"), ("materials", "materials", "material")):
                for index, each in enumerate(getattr(asked, key) or ()):
                    if each not in draft.names(known):
                        yield unknown((*path, key, index), each, draft.names(known), kind)
        if isinstance(asked, ReposeIndex) and not any(draft.scene.gravity):
            yield (*path, "kind"), Fault((), "gravity is zero, so there is no slope; leave this index out")


def expected_indices(draft: Draft) -> Iterator[Finding]:
    """Expectations of indices that exist and have such a number."""
    known = draft.scene.output.indices
    for index, expectation in enumerate(draft.scene.expect):
        quantity, dot, name = expectation.quantity.partition(".")
        path: KeyPath = ("expect", index, "quantity")
        if not dot or quantity not in INDEX_QUANTITIES:
            continue
        if name not in known:
            yield unknown(path, name, known, "index")
        elif quantity.removesuffix("_mean") not in QUANTITIES_OF[known[name].kind]:
            numbers = ", ".join(f"{each}.{name}" for each in QUANTITIES_OF[known[name].kind])
            yield path, Fault((), f"{name} is of kind {known[name].kind}; it gives {numbers}")


def _cells(domain: Domain, path: KeyPath, grid: CellGrid) -> Iterator[Finding]:
    if (grid.cell is None) == (grid.cells is None):
        return
    count = math.prod(grid.counts_in(domain))
    if count > MOST_CELLS:
        key = "cell" if grid.cells is None else "cells"
        reason = f"that makes {count:_} cells, and a grid holds at most {MOST_CELLS:_}".replace("_", " ")
        yield (*path, key), Fault((), reason)


def _across(domain: Domain, path: KeyPath, region: Box) -> Iterator[Finding]:
    for axis in domain.periodic:
        k = "xyz".index(axis)
        if (region.min[k], region.max[k]) != (domain.min[k], domain.max[k]):
            reach = f"{domain.min[k]:g} to {domain.max[k]:g} m"
            yield path, Fault((), f"must reach from {reach} in {axis}, where the domain is periodic", whole=True)
