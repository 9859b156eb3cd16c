"""How much memory the fields of a plan take, before they are allocated; a test holds it to what is allocated."""

from dataclasses import dataclass
from typing import Literal

from granflow.plan.plan import Plan

INTEGER = 4
"""Bytes of the integers on the device."""

VECTOR = 3
ROW = 2
"""Where a particle's row of near partners begins and ends."""

SORTED = 2
"""Integers for each particle while the neighbour search sorts: cell and order."""


@dataclass(frozen=True)
class Memory:
    """Bytes on the device when a run starts; rows of near partners grow if they turn out too short."""

    per_particle: int
    per_slot: int
    """For one near partner: its number and what the contact remembers, with the copy kept during a search."""
    particles: int
    slots: int
    cells: int

    @property
    def total(self) -> int:
        """All of it."""
        return self.particles + self.slots + self.cells


def memory_of(plan: Plan, precision: Literal["f64", "f32", "mixed"]) -> Memory:
    """Count the bytes of every field that grows with particles, contacts or cells."""
    real = 8 if precision == "f64" else 4
    position = 4 if precision == "f32" else 8
    remembered = real * sum(plan.history.values())
    copies = 2 if plan.history else 1
    per_slot = copies * INTEGER + 2 * remembered
    per_particle = _fields(plan, real, position) + INTEGER * (SORTED + copies * ROW)
    return Memory(
        per_particle=per_particle,
        per_slot=per_slot,
        particles=per_particle * plan.particle_capacity,
        slots=per_slot * plan.chunk_capacity * plan.slots_per_chunk,
        cells=2 * INTEGER * plan.cell_capacity,
    )


def _fields(plan: Plan, real: int, position: int) -> int:
    """Bytes of one particle's own fields, and of the copies of those that travel with it when particles are sorted."""
    features = plan.features
    velocity, force, radius, mass, number, coordination = VECTOR * real, VECTOR * real, real, real, INTEGER, INTEGER
    travelling = VECTOR * position + velocity + radius + mass + number
    travelling += INTEGER * (not features.one_material)
    travelling += VECTOR * real * (features.rotation + features.rate_dependent)
    torque = VECTOR * real * features.rotation
    at_search = VECTOR * position
    return 2 * travelling + force + torque + at_search + coordination
