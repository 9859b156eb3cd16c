"""The arrays on the device. Fields are allocated by quantity; what the plan does not need is None."""

from typing import Any

import numpy as np
import taichi as ti

from granflow.device.backend import Backend
from granflow.plan import Plan
from granflow.walls.catalogue import kind_code
from granflow.walls.motion import Motion
from granflow.walls.shape import PARAMETER_COUNT

WALL_BATCH = 64
"""Steps whose wall poses are uploaded at a time."""


class Block:
    """A group of fields that are allocated and freed together."""

    def __init__(self) -> None:
        self._builder = ti.FieldsBuilder()
        self._tree: Any = None

    def scalar(self, dtype: Any, *shape: int) -> Any:
        """A field of numbers."""
        return self._placed(ti.field(dtype), shape)

    def vector(self, dtype: Any, *shape: int, count: int = 3) -> Any:
        """A field of vectors, components side by side."""
        return self._placed(ti.Vector.field(count, dtype), shape)

    def matrix(self, dtype: Any, *shape: int) -> Any:
        """A field of 3 x 3 matrices."""
        return self._placed(ti.Matrix.field(3, 3, dtype), shape)

    def finish(self) -> None:
        """Allocate; no field can be added afterwards."""
        self._tree = self._builder.finalize()

    def free(self) -> None:
        """Give the memory back."""
        if self._tree is not None:
            self._tree.destroy()
            self._tree = None

    def _placed(self, field: Any, shape: tuple[int, ...]) -> Any:
        axes = ti.i if len(shape) == 1 else ti.ij
        self._builder.dense(axes, shape).place(field)
        return field


class Particles(Block):
    """One entry a sphere, in cell order; velocities are half a step behind the positions (leapfrog)."""

    def __init__(self, plan: Plan, backend: Backend) -> None:
        super().__init__()
        count, real, features = max(plan.particle_capacity, 1), backend.real, plan.features
        self.capacity = count
        self.position = self.vector(backend.position_real, count)
        self.position_at_search = self.vector(backend.position_real, count)
        self.velocity = self.vector(real, count)
        self.force = self.vector(real, count)
        self.radius = self.scalar(real, count)
        self.mass = self.scalar(real, count)
        self.id = self.scalar(ti.i32, count)
        self.material: Any = None if features.one_material else self.scalar(ti.i32, count)
        self.spin: Any = self.vector(real, count) if features.rotation else None
        self.torque: Any = self.vector(real, count) if features.rotation else None
        self.velocity_now: Any = self.vector(real, count) if features.rate_dependent else None
        self.coordination = self.scalar(ti.i32, count)
        self.finish()

    def sorted_fields(self) -> list[Any]:
        """Fields that travel with a particle when it gets another place."""
        fields = [self.position, self.velocity, self.radius, self.mass, self.id]
        optional = (self.material, self.spin, self.velocity_now)
        return fields + [field for field in optional if field is not None]


class Sorting(Block):
    """Scratch for the neighbour search: cells, the new order, and one copy of what travels."""

    def __init__(self, plan: Plan, particles: Particles, cell_capacity: int) -> None:
        super().__init__()
        count = particles.capacity
        self.cell_capacity = cell_capacity
        self.cell = self.scalar(ti.i32, count)
        self.order = self.scalar(ti.i32, count)
        self.rank = self.scalar(ti.i32, count)
        self.cell_start = self.scalar(ti.i32, cell_capacity + 2)
        self.cell_fill = self.scalar(ti.i32, cell_capacity + 2)
        self.block_sum = self.scalar(ti.i32, cell_capacity // SCAN_BLOCK + 2)
        self.low = self.vector(particles.position.dtype, 1)
        self.high = self.vector(particles.position.dtype, 1)
        self.copies = [self._like(field, count) for field in particles.sorted_fields()]
        self.finish()

    def _like(self, field: Any, count: int) -> Any:
        if isinstance(field, ti.MatrixField):
            return self.vector(field.dtype, count)
        return self.scalar(field.dtype, count)


SCAN_BLOCK = 1024
"""Cells summed by one task of the prefix sum."""


class Contacts(Block):
    """Rows of near partners, one row a particle, each chunk of particles in its own segment.

    `partner` holds the index of a particle, or -1 - wall. A pair within one chunk stands in one row, a pair
    across two chunks in both. `before` is a copy of rows and history taken when the particles are sorted anew.
    """

    def __init__(self, plan: Plan, backend: Backend, slots_per_chunk: int) -> None:
        super().__init__()
        count = max(plan.particle_capacity, 1)
        self.slots_per_chunk = slots_per_chunk
        self.capacity = plan.chunk_capacity * slots_per_chunk
        self.row_begin, self.row_end = self.scalar(ti.i32, count), self.scalar(ti.i32, count)
        self.partner = self.scalar(ti.i32, self.capacity)
        self.chunk_need = self.scalar(ti.i32, plan.chunk_capacity)
        self.history: dict[str, Any] = {}
        self.before: dict[str, Any] = {}
        for name, size in plan.history.items():
            self.history[name] = self._history_field(backend, size)
            self.before[name] = self._history_field(backend, size)
        if self.history:
            self.row_begin_before, self.row_end_before = self.scalar(ti.i32, count), self.scalar(ti.i32, count)
            self.partner_before = self.scalar(ti.i32, self.capacity)
        self.finish()

    def fields_before(self) -> dict[str, Any]:
        """What the last sort set aside, by name."""
        if not self.history:
            return {}
        rows = {"begin": self.row_begin_before, "end": self.row_end_before, "partner": self.partner_before}
        return rows | {f"history.{name}": field for name, field in self.before.items()}

    def _history_field(self, backend: Backend, size: int) -> Any:
        return self.vector(backend.real, self.capacity, count=size)


class Walls(Block):
    """Shapes at rest, what they are made of, and where they stand in the next WALL_BATCH steps."""

    def __init__(self, plan: Plan, backend: Backend) -> None:
        super().__init__()
        count = max(len(plan.walls), 1)
        self.kind = self.scalar(ti.i32, count)
        self.parameters = self.vector(backend.position_real, count, count=PARAMETER_COUNT)
        self.material = self.scalar(ti.i32, count)
        self.present = self.scalar(ti.i32, count)
        self.pivot = self.vector(backend.position_real, count)
        moving = plan.features.moving_walls
        self.center = self.vector(backend.position_real, WALL_BATCH, count) if moving else None
        self.rotation = self.matrix(backend.position_real, WALL_BATCH, count) if moving else None
        self.velocity = self.vector(backend.real, WALL_BATCH, count) if moving else None
        self.spin = self.vector(backend.real, WALL_BATCH, count) if moving else None
        self.finish()
        for index, wall in enumerate(plan.walls):
            self.kind[index] = kind_code(wall.shape.kind)
            self.parameters[index] = wall.shape.parameters.tolist()
            self.material[index] = wall.material


class Control(Block):
    """Small things that kernels and host tell each other."""

    def __init__(self, plan: Plan, backend: Backend) -> None:
        super().__init__()
        self.search_due = self.scalar(ti.i32, 1)
        self.search_wanted = self.scalar(ti.i32, 1)
        self.steps_done = self.scalar(ti.i32, 1)
        self.steps_left = self.scalar(ti.i32, 1)
        self.guard = self.scalar(ti.i32, 1)
        self.guard_particle = self.scalar(ti.i32, 1)
        self.pair_constants = self.vector(backend.real, len(plan.pair_constants), count=plan.pair_constants.shape[1])
        ledger = plan.features.ledger
        self.losses = self.vector(ti.f64, plan.chunk_capacity, count=len(LOSSES)) if ledger else None
        self.finish()
        self.pair_constants.from_numpy(plan.pair_constants.astype(np.float64))


LOSSES = ("plastic", "friction", "rolling", "damping", "wall_work")
"""What each chunk adds up in the energy ledger [J]."""


class State:
    """Everything on the device for one plan."""

    def __init__(self, plan: Plan, backend: Backend) -> None:
        self.plan, self.backend = plan, backend
        self.count = 0
        self.particles = Particles(plan, backend)
        self.contacts = Contacts(plan, backend, plan.slots_per_chunk)
        self.sorting = Sorting(plan, self.particles, plan.cell_capacity)
        self.walls = Walls(plan, backend)
        self.control = Control(plan, backend)
        self.wall_motions: tuple[tuple[Motion, ...], ...] = tuple(() for _ in plan.walls)

    @property
    def chunk_count(self) -> int:
        """Chunks that hold particles now."""
        return -(-self.count // self.plan.chunk_size)

    def grow_contacts(self, slots_per_chunk: int) -> None:
        """Replace the contact rows by longer ones, keeping what stands in `before`; kernels must be built anew."""
        old = self.contacts
        kept = {name: field.to_numpy() for name, field in old.fields_before().items()}
        old.free()
        self.contacts = Contacts(self.plan, self.backend, slots_per_chunk)
        for name, field in self.contacts.fields_before().items():
            values = np.zeros(field.to_numpy().shape, kept[name].dtype)
            values[: len(kept[name])] = kept[name]
            field.from_numpy(values)

    def free(self) -> None:
        """Give all memory back."""
        for block in (self.particles, self.contacts, self.sorting, self.walls, self.control):
            block.free()
