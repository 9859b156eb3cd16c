"""Memory of the fields of a plan before allocation; a test compares it with the allocated memory."""

from dataclasses import dataclass
from itertools import groupby
from typing import get_args

from granflow.arguments import refuse_other, shown
from granflow.errors import GranflowError
from granflow.plan.capacities import Capacities
from granflow.plan.device_arrays import (
    Precision,
    cell_arrays,
    mesh_arrays,
    neighbor_arrays,
    particle_arrays,
    sum_arrays,
)
from granflow.plan.plan import Plan


@dataclass(frozen=True)
class MemoryEstimate:
    """Initial device memory [bytes]; neighbor lists grow if they are too short.

    `per_particle`, `per_neighbor`: for one particle and one list entry; all others: totals.
    """

    per_particle: int
    per_neighbor: int
    """Per list entry: partner index, contact history, and the share of an entry saved during a rebuild."""
    particles: int
    neighbor_lists: int
    cells: int
    meshes: int = 0
    sums: int = 0
    """Energies and wall forces: per chunk, on a GPU per particle."""

    @property
    def total(self) -> int:
        """Total device memory [bytes]."""
        return self.particles + self.neighbor_lists + self.cells + self.meshes + self.sums


def largest_block(plan: Plan, capacities: Capacities) -> int:
    """Bytes of the largest array, or arrays that are interleaved entry by entry."""
    arrays = [*particle_arrays(plan), *neighbor_arrays(plan, capacities), *cell_arrays(plan), *sum_arrays(plan)]
    blocks = groupby(arrays, key=lambda array: array.block or array.name)
    return max(sum(array.size(plan.precision) for array in block) for _, block in blocks)


def estimate_memory(plan: Plan, precision: Precision, capacities: Capacities | None = None) -> MemoryEstimate:
    """Sum of the sizes [bytes] of all arrays that scale with particles, contacts, cells or triangles.

    capacities:  of the neighbor lists; None: those at the start

    >>> gf.estimate_memory(gf.plan_for(gf.load_scene("two.yaml")), "f64").total > 0
    True
    """
    refuse_other("plan", plan, Plan, "a plan of granflow.plan_for")
    if precision not in get_args(Precision):
        raise GranflowError(f"precision is {shown(precision)}; give one of {', '.join(get_args(Precision))}.")
    capacities = capacities or plan.capacities
    lists, cells = neighbor_arrays(plan, capacities), cell_arrays(plan)
    particles = sum(each.size(precision) for each in (*particle_arrays(plan), *lists, *cells) if each.per_particle)
    list_bytes = sum(each.size(precision) for each in lists if not each.per_particle)
    return MemoryEstimate(
        per_particle=particles // capacities.particles,
        per_neighbor=list_bytes // capacities.list_entries,
        particles=particles,
        neighbor_lists=list_bytes,
        cells=sum(each.size(precision) for each in cells if not each.per_particle),
        meshes=sum(each.size(precision) for each in mesh_arrays(plan)) if plan.meshes else 0,
        sums=sum(each.size(precision) for each in sum_arrays(plan)),
    )
