"""How much memory the fields of a plan take, before they are allocated; a test holds it to what is allocated."""

from dataclasses import dataclass
from typing import Literal

from granflow.plan.capacities import BOUNDS, history_capacity
from granflow.plan.plan import Plan

INTEGER = 4
"""Bytes of the integers on the device."""

VECTOR = 3
LIST_INTEGERS, SAVED_LIST_INTEGERS = 3, 2
"""Where a particle's row of near partners begins, has its last wall, and ends; and where it did before a search."""

SORTED = 2
"""Integers for each particle while the neighbor search sorts: cell and order."""


@dataclass(frozen=True)
class MemoryEstimate:
    """Bytes on the device when a run starts; rows of near partners grow if they turn out too short."""

    per_particle: int
    per_neighbor: int
    """For one near partner: its number, what the contact remembers, and the share of a slot kept during a search."""
    particles: int
    neighbor_lists: int
    cells: int
    meshes: int = 0

    @property
    def total(self) -> int:
        """All of it."""
        return self.particles + self.neighbor_lists + self.cells + self.meshes


def estimate_memory(plan: Plan, precision: Literal["f64", "f32", "mixed"]) -> MemoryEstimate:
    """Count the bytes of every field that grows with particles, contacts or cells."""
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
    """Bytes of the triangles of all mesh walls, their points and grids."""
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
    """Bytes of one particle's own fields."""
    features = plan.features
    velocity, force, radius, mass, number, coordination = VECTOR * real, VECTOR * real, real, real, INTEGER, INTEGER
    sorted_bytes = VECTOR * position + velocity + radius + mass + number
    sorted_bytes += INTEGER * ((not features.one_material) + features.fixed_particles)
    sorted_bytes += VECTOR * real * (features.rotation + features.rate_dependent)
    torque = VECTOR * real * features.rotation
    at_rebuild = VECTOR * position
    return sorted_bytes + force + torque + at_rebuild + coordination
