"""Memory estimate of the fields of a plan before allocation; a test compares it with the allocated memory."""

from dataclasses import dataclass
from typing import Literal

from granflow.plan.capacities import BOUNDS, history_capacity
from granflow.plan.plan import Plan

INTEGER = 4
"""Size [bytes] of integers on the device."""

VECTOR = 3
"""Components of a vector."""

LIST_INTEGERS, SAVED_LIST_INTEGERS = 3, 2
"""Integers per particle for its neighbor list: begin, end of the walls, end; and begin and end before a rebuild."""

SORTED = 2
"""Integers per particle for sorting: cell and order."""


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

    @property
    def total(self) -> int:
        """Total device memory [bytes]."""
        return self.particles + self.neighbor_lists + self.cells + self.meshes


def estimate_memory(plan: Plan, precision: Literal["f64", "f32", "mixed"]) -> MemoryEstimate:
    """Sum of the sizes [bytes] of all fields that scale with particles, contacts or cells.

    `precision`: f64 has 8 bytes per number, f32 has 4, mixed has 8 for positions and 4 for all other numbers.
    """
    real = 8 if precision == "f64" else 4
    position = 4 if precision == "f32" else 8
    history_bytes = real * sum(plan.history.values())
    saved_bytes = (
        plan.chunk_capacity * history_capacity(plan.list_capacity_per_chunk) * (INTEGER + history_bytes)
        if history_bytes
        else 0
    )
    list_entries = plan.chunk_capacity * plan.list_capacity_per_chunk
    list_bytes = list_entries * (INTEGER + (INTEGER + history_bytes if history_bytes else 0)) + saved_bytes
    class_cells = plan.class_cell_capacity
    list_integers = SORTED + LIST_INTEGERS + SAVED_LIST_INTEGERS * bool(history_bytes) + bool(class_cells)
    per_particle = _fields(plan, real, position) + INTEGER * list_integers
    return MemoryEstimate(
        per_particle=per_particle,
        per_neighbor=list_bytes // list_entries,
        particles=per_particle * plan.particle_capacity,
        neighbor_lists=list_bytes,
        cells=2 * INTEGER * (plan.cell_capacity + class_cells) + 2 * VECTOR * position * BOUNDS,
        meshes=_meshes(plan, position),
    )


def _meshes(plan: Plan, position: int) -> int:
    """Memory [bytes] of the triangles, vertices and grids of all mesh walls.

    `position`: size of a coordinate [bytes].
    """
    total = 0
    for index, mesh in plan.meshes.items():
        adjacency, grid = mesh.adjacency, plan.mesh_grids[index]
        arrays = (
            adjacency.vertex,
            adjacency.edge_direction,
            adjacency.inward,
            adjacency.inward_other,
            adjacency.normal,
            adjacency.length,
        )
        total += position * sum(array.size for array in (*arrays, adjacency.vertex_edge, adjacency.longest))
        numbers = (
            adjacency.point,
            adjacency.base,
            adjacency.owns_tie,
            adjacency.role,
            adjacency.owner,
            adjacency.vertex_edge_start,
            adjacency.competitor_start,
        )
        counts = sum(array.size for array in (*numbers, adjacency.competitor, grid.start, grid.triangle))
        total += INTEGER * (counts + mesh.triangle_count)
    return total


def _fields(plan: Plan, real: int, position: int) -> int:
    """Memory [bytes] of the fields per particle; `real`, `position`: size of a number and of a coordinate [bytes]."""
    features = plan.features
    velocity, force, radius, mass, number, coordination = VECTOR * real, VECTOR * real, real, real, INTEGER, INTEGER
    sorted_bytes = VECTOR * position + velocity + radius + mass + number
    sorted_bytes += INTEGER * ((not features.one_material) + features.fixed_particles)
    sorted_bytes += VECTOR * real * (features.rotation + features.rate_dependent)
    torque = VECTOR * real * features.rotation
    at_rebuild = VECTOR * position
    return sorted_bytes + force + torque + at_rebuild + coordination
