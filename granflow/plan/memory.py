"""How much memory the fields of a plan take, before they are allocated; a test holds it to what is allocated."""

from dataclasses import dataclass
from typing import Literal

from granflow.plan.plan import Plan
from granflow.plan.slots import BOUNDS, kept_slots

INTEGER = 4
"""Bytes of the integers on the device."""

VECTOR = 3
ROW, ROW_BEFORE = 3, 2
"""Where a particle's row of near partners begins, has its last wall, and ends; and where it did before a search."""

SORTED = 2
"""Integers for each particle while the neighbour search sorts: cell and order."""


@dataclass(frozen=True)
class Memory:
    """Bytes on the device when a run starts; rows of near partners grow if they turn out too short."""

    per_particle: int
    per_slot: int
    """For one near partner: its number, what the contact remembers, and the share of a slot kept during a search."""
    particles: int
    slots: int
    cells: int
    meshes: int = 0

    @property
    def total(self) -> int:
        """All of it."""
        return self.particles + self.slots + self.cells + self.meshes


def memory_of(plan: Plan, precision: Literal["f64", "f32", "mixed"]) -> Memory:
    """Count the bytes of every field that grows with particles, contacts or cells."""
    real = 8 if precision == "f64" else 4
    position = 4 if precision == "f32" else 8
    remembered = real * sum(plan.history.values())
    kept = plan.chunk_capacity * kept_slots(plan.slots_per_chunk) * (INTEGER + remembered) if remembered else 0
    slots = plan.chunk_capacity * plan.slots_per_chunk
    slot_bytes = slots * (INTEGER + (INTEGER + remembered if remembered else 0)) + kept
    listed = plan.listed_cell_capacity
    rows = SORTED + ROW + ROW_BEFORE * bool(remembered) + bool(listed)
    per_particle = _fields(plan, real, position) + INTEGER * rows
    return Memory(
        per_particle=per_particle,
        per_slot=slot_bytes // slots,
        particles=per_particle * plan.particle_capacity,
        slots=slot_bytes,
        cells=2 * INTEGER * (plan.cell_capacity + listed) + 2 * VECTOR * position * BOUNDS,
        meshes=_meshes(plan, position),
    )


def _meshes(plan: Plan, position: int) -> int:
    """Bytes of the triangles of all mesh walls, their points and grids."""
    total = 0
    for index, mesh in plan.meshes.items():
        links, grid = mesh.links, plan.mesh_grids[index]
        arrays = (links.vertex, links.along, links.inward, links.beyond, links.normal, links.length)
        total += position * sum(array.size for array in (*arrays, links.spoke, links.longest))
        numbers = (links.point, links.base, links.tie, links.role, links.owner, links.spoke_start, links.rival_start)
        counts = sum(array.size for array in (*numbers, links.rival, grid.start, grid.triangle))
        total += INTEGER * (counts + mesh.triangle_count)
    return total


def _fields(plan: Plan, real: int, position: int) -> int:
    """Bytes of one particle's own fields."""
    features = plan.features
    velocity, force, radius, mass, number, coordination = VECTOR * real, VECTOR * real, real, real, INTEGER, INTEGER
    travelling = VECTOR * position + velocity + radius + mass + number
    travelling += INTEGER * ((not features.one_material) + features.fixed_grains)
    travelling += VECTOR * real * (features.rotation + features.rate_dependent)
    torque = VECTOR * real * features.rotation
    at_search = VECTOR * position
    return travelling + force + torque + at_search + coordination
