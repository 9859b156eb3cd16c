"""Device arrays. Fields are allocated by quantity; a field that the plan does not need is None."""

from collections.abc import Callable
from typing import Any

import numpy as np
import taichi as ti

from granflow.engine.backend import Backend
from granflow.engine.clock import Clock
from granflow.engine.limits import NO_PARTICLE
from granflow.engine.mesh_fields import MeshFields
from granflow.geometry.catalog import surface_code
from granflow.geometry.motion import Motion
from granflow.geometry.shape import PARAMETER_COUNT, Shape
from granflow.plan.capacities import BOUNDS, history_capacity
from granflow.plan.chunk_sums import IMPULSE_SIZE, LOSSES
from granflow.plan.plan import Plan

CPU_STRIDE = 512
"""Minimum number of loop iterations per CPU thread in Taichi: loops over chunks are longer by this factor."""

CACHE_LINE = 16
"""Integers per cache line; contended counters occupy separate lines."""

WALL_BATCH = 256
"""Number of steps whose wall poses are uploaded together."""


class FieldBlock:
    """Fields that are allocated and freed together: one block for the state; each costs a look-up in kernels."""

    def __init__(self) -> None:
        self._builder = ti.FieldsBuilder()
        self._tree: Any = None
        self.fields: list[Any] = []

    def scalar(self, dtype: Any, *shape: int) -> Any:
        """A scalar field of one or two dimensions."""
        return self._placed(ti.field(dtype), shape)

    def vector(self, dtype: Any, *shape: int, count: int = 3) -> Any:
        """A field of vectors of `count` adjacent components."""
        return self._placed(ti.Vector.field(count, dtype), shape)

    def matrix(self, dtype: Any, *shape: int) -> Any:
        """A field of 3 x 3 matrices."""
        return self._placed(ti.Matrix.field(3, 3, dtype), shape)

    def together(self, count: int, *fields: Any) -> None:
        """Interleave fields of `count` entries entry by entry: kernels read these quantities of a particle together.

        None is ignored.
        """
        wanted = [field for field in fields if field is not None]
        self._builder.dense(ti.i, count).place(*wanted)
        self.fields += wanted

    def parts(self, count: int) -> Any:
        """`count` equal parts; each holds the complete part of several columns."""
        return self._builder.dense(ti.i, count)

    def column(self, parts: Any, dtype: Any, length: int) -> Any:
        """A field [part, entry] with adjacent entries of a part; its values are lost if the block is reallocated."""
        field = ti.field(dtype)
        parts.dense(ti.j, length).place(field)
        return field

    def finish(self) -> None:
        """Allocate the fields; no field can be added afterwards."""
        self._tree = self._builder.finalize()

    def free(self) -> None:
        """Free the memory; the fields cannot be used afterwards."""
        if self._tree is not None:
            self._tree.destroy()
            self._tree = None

    def _placed(self, field: Any, shape: tuple[int, ...]) -> Any:
        axes = ti.i if len(shape) == 1 else ti.ij
        self._builder.dense(axes, shape).place(field)
        self.fields.append(field)
        return field


class Particles:
    """Particle fields, in cell order; velocities are half a step behind the positions (leapfrog).

    position:               [m], not wrapped between rebuilds
    velocity:               [m/s], half a step behind
    angular_velocity:       [rad/s], half a step behind; None without rotation
    velocity_synchronized:  [m/s], at the time of the positions; for rate-dependent models
    radius, mass:           [m], [kg]
    force, torque:          [N], [N m], at the time of the positions
    position_at_rebuild:    [m], at the last neighbor-list rebuild
    id:                     unique in a run
    material:               number of the plan
    fixed:                  1 for fixed particles
    coordination:           number of contacts, filled by ContactStatistics
    """

    def __init__(self, block: FieldBlock, plan: Plan, backend: Backend) -> None:
        count, real, features = max(plan.particle_capacity, 1), backend.real, plan.features
        self.capacity = count
        self.position = ti.Vector.field(3, backend.position_real)
        self.velocity = ti.Vector.field(3, real)
        self.radius, self.mass = ti.field(real), ti.field(real)
        self.angular_velocity: Any = ti.Vector.field(3, real) if features.rotation else None
        self.velocity_synchronized: Any = ti.Vector.field(3, real) if features.rate_dependent else None
        block.together(
            count,
            self.position,
            self.radius,
            self.mass,
            self.velocity,
            self.angular_velocity,
            self.velocity_synchronized,
        )
        self.force = ti.Vector.field(3, real)
        self.torque: Any = ti.Vector.field(3, real) if features.rotation else None
        block.together(count, self.force, self.torque)
        self.position_at_rebuild = block.vector(backend.position_real, count)
        self.id = block.scalar(ti.i32, count)
        self.material: Any = None if features.one_material else block.scalar(ti.i32, count)
        self.fixed: Any = block.scalar(ti.i32, count) if features.fixed_particles else None
        self.coordination = block.scalar(ti.i32, count)

    def sorted_fields(self) -> list[Any]:
        """Fields that are permuted with the particles at a neighbor-list rebuild.

        Force and torque are computed again after a rebuild.
        """
        fields = [self.position, self.velocity, self.radius, self.mass, self.id]
        optional = (self.material, self.fixed, self.angular_velocity, self.velocity_synchronized)
        return fields + [field for field in optional if field is not None]


class CellSort:
    """Work arrays of the neighbor search: cells and the new order; one grid per size class if sizes differ widely.

    cell_start:   first particle of each cell in `order`
    order:        previous index of each particle of the new order
    grid_low:     low corner [m] of each grid
    cell_side:    cell sides [m] of each grid
    cells:        number of cells along each axis of each grid
    class_order:  particles by class and cell, from `class_start` of a cell
    first_cell:   first cell of each class
    radius:       largest radius [m] of each class
    low, high:    corners [m] of the bounding boxes of `build_bounds`
    """

    def __init__(self, block: FieldBlock, plan: Plan, particles: Particles) -> None:
        count, cell_capacity = particles.capacity, plan.cell_capacity
        classes, class_cells = len(plan.size_classes), plan.class_cell_capacity
        self.cell_capacity = cell_capacity
        self.cell = block.scalar(ti.i32, count)
        self.order = block.scalar(ti.i32, count)
        self.cell_start = block.scalar(ti.i32, cell_capacity + 2)
        self.cell_fill = block.scalar(ti.i32, max(cell_capacity, class_cells) + 2)
        self.block_sum = block.scalar(ti.i32, max(cell_capacity, class_cells) // SCAN_BLOCK + 2)
        self.grid_low, self.cell_side = (block.vector(particles.position.dtype, classes) for _ in range(2))
        self.cells = block.vector(ti.i32, classes)
        self.class_order: Any = block.scalar(ti.i32, count) if class_cells else None
        self.class_start: Any = block.scalar(ti.i32, class_cells + 2) if class_cells else None
        self.first_cell: Any = block.scalar(ti.i32, classes) if class_cells else None
        self.radius: Any = block.scalar(particles.position.dtype, classes) if class_cells else None
        self.low = block.vector(particles.position.dtype, BOUNDS)
        self.high = block.vector(particles.position.dtype, BOUNDS)


SCAN_BLOCK = 1024
"""Number of cells summed by one task of the prefix sum."""


class NeighborList:
    """Neighbor lists (Verlet lists), one per particle; each chunk of particles has a separate segment.

    list_begin, list_end:  range of the entries of each particle
    list_walls_end:        end of its wall entries, which are first
    partner:               index of a particle, -1 - wall, or -1 - wall count - triangle
    history:               history of each entry by slot of the contact models
    in_contact:            state of each entry, see `contact_history`; only with a history
    saved:                 copy of the entries with a history while the particles are sorted

    A pair within a chunk is in one list, a pair across two chunks in both.
    """

    def __init__(self, block: FieldBlock, plan: Plan, backend: Backend, list_capacity_per_chunk: int) -> None:
        count = max(plan.particle_capacity, 1)
        self.list_capacity_per_chunk = list_capacity_per_chunk
        self.capacity = plan.chunk_capacity * list_capacity_per_chunk
        self.list_begin, self.list_walls_end, self.list_end = (block.scalar(ti.i32, count) for _ in range(3))
        self.partner = block.scalar(ti.i32, self.capacity)
        self.history: dict[str, Any] = {}
        self.saved: dict[str, Any] = {}
        for name, size in plan.history.items():
            self.history[name] = block.vector(backend.real, self.capacity, count=size)
        self.history_capacity_per_chunk = history_capacity(list_capacity_per_chunk)
        if self.history:
            history_entries = plan.chunk_capacity * self.history_capacity_per_chunk
            self.saved = {
                name: block.vector(backend.real, history_entries, count=size) for name, size in plan.history.items()
            }
            self.in_contact = block.scalar(ti.i32, self.capacity)
            self.list_begin_before, self.list_end_before = block.scalar(ti.i32, count), block.scalar(ti.i32, count)
            self.partner_saved = block.scalar(ti.i32, history_entries)


LANES = 16
"""Batches are padded to a multiple of this number, so that the compiled loop has no scalar remainder."""

STAGGER = 24
"""Offset between columns: columns a multiple of 4096 bytes apart evict each other from the cache."""


class PairBatch:
    """Columns with an entry per contact of the present batch, and a part of each column per CPU thread.

    The names are those of the variables in `pair_force.py`; `evaluate` overwrites inputs with results.
    """

    def __init__(self, block: FieldBlock, plan: Plan, backend: Backend, list_capacity_per_chunk: int) -> None:
        features, real = plan.features, backend.real
        page = 4096 // 8
        self.capacity = -(-(list_capacity_per_chunk + LANES) // page) * page + STAGGER
        worker_parts = block.parts(backend.worker_count)

        def columns(number: int, dtype: Any = real) -> list[Any]:
            return [block.column(worker_parts, dtype, self.capacity) for _ in range(number)]

        self.list_index, self.owner, self.partner = columns(3, ti.i32)
        self.radius, self.radius_partner, self.mass, self.mass_partner = columns(4)
        self.branch, self.velocity_rel_half = columns(3), columns(3)
        self.velocity_rel = columns(3 * features.rate_dependent)
        self.angular_velocity, self.angular_velocity_partner = (
            columns(3 * features.rotation),
            columns(3 * features.rotation),
        )
        self.history = {slot: columns(size) for slot, size in plan.history.items()}
        self.constants = columns(0 if features.one_material else plan.pair_constants.shape[1])
        self.losses = columns(3 * features.energy_budget)


NOT_MEASURED = -1
"""Impulse row of walls whose forces are not measured."""


class Walls:
    """Shapes at rest, materials, and poses for the next WALL_BATCH steps.

    kind:              code of the kind, see `catalog.surface_code`
    parameters:        of the shape, PARAMETER_COUNT numbers
    present:           1 for walls that are present
    pivot:             [m], point of the rotation at rest
    center, rotation:  [m], 3 x 3: pose after each step; None if no wall moves
    velocity:          [m/s] of the center at the middle of each step
    angular_velocity:  [rad/s] at the middle of each step
    impulse_row:       row in `Control.impulses`, or NOT_MEASURED
    """

    def __init__(self, block: FieldBlock, plan: Plan, backend: Backend) -> None:
        count = max(len(plan.walls), 1)
        self.kind = block.scalar(ti.i32, count)
        self.parameters = block.vector(backend.position_real, count, count=PARAMETER_COUNT)
        self.material = block.scalar(ti.i32, count)
        self.present = block.scalar(ti.i32, count)
        self.pivot = block.vector(backend.position_real, count)
        moving = plan.features.moving_walls
        self.center = block.vector(backend.position_real, WALL_BATCH, count) if moving else None
        self.rotation = block.matrix(backend.position_real, WALL_BATCH, count) if moving else None
        self.velocity = block.vector(backend.real, WALL_BATCH, count) if moving else None
        self.impulse_row = block.scalar(ti.i32, count) if plan.features.wall_forces else None
        self.angular_velocity = block.vector(backend.real, WALL_BATCH, count) if moving else None

    def fill(self, plan: Plan) -> None:
        """Write the constant arrays."""
        for index, wall in enumerate(plan.walls):
            self.kind[index] = surface_code(wall.shape)
            self.material[index] = wall.material
            if isinstance(wall.shape, Shape):
                self.parameters[index] = wall.shape.parameters.tolist()
            if self.impulse_row is not None:
                measured = plan.scene.measured_walls
                self.impulse_row[index] = measured.index(wall.name) if wall.name in measured else NOT_MEASURED


class WallDynamicsFields:
    """Force-controlled walls, an entry per motion, in float64 for every precision.

    offset:             displacement along the direction of the motion [m]
    offset_at_rebuild:  `offset` at the last neighbor-list rebuild [m]
    velocity:           [m/s], half a step behind
    active:             1 if the motion is active in the step that ends at a pose
    was_active:         1 if it was active in the previous step
    wall_force:         force of the particles [N] along the direction, summed by each chunk
    work_on_particles:  work on the particles [J]
    work:               work of all other forces on a free wall [J]
    """

    def __init__(self, block: FieldBlock, plan: Plan) -> None:
        count = len(plan.controlled_motions)
        self.offset, self.offset_at_rebuild, self.velocity = (block.scalar(ti.f64, count) for _ in range(3))
        self.work_on_particles, self.work = block.scalar(ti.f64, count), block.scalar(ti.f64, count)
        self.was_active, self.active = block.scalar(ti.i32, count), block.scalar(ti.i32, WALL_BATCH, count)
        self.wall_force = block.scalar(ti.f64, plan.chunk_capacity, count)


class Control:
    """Flags, counters and constants shared by kernels and host.

    rebuild_requested:          set by the integration if a particle or wall has moved too far
    rebuild_due:                copy of it at the end of the phase; all further phases of the launch do nothing
    steps_done, running:        completed steps of a launch; 1 while it continues
    worker_count:               workers that have not left the launch
    started_count:              of them, those at the first barrier of the launch
    patience:                   number of polls after which a worker leaves, and that of the first barrier of a launch
    next_chunk:                 number of chunks that workers have taken in this phase
    arrived, released:          counters of the barrier, see `barrier`
    list_length_needed:         largest number of entries of a chunk
    abort, abort_particle:      abort code and smallest id above the limit
    pair_constants:             row per pair of materials
    losses:                     terms LOSSES of each chunk [J]
    impulses:                   time integrals of the wall forces of each chunk
    boundary_work:              work at periodic boundaries of each chunk [J]
    image_offset, image_speed:  of a sheared box, for WALL_BATCH steps [m], [m/s]
    """

    def __init__(self, block: FieldBlock, plan: Plan, backend: Backend) -> None:
        self.rebuild_due = block.scalar(ti.i32, 1)
        self.rebuild_requested = block.scalar(ti.i32, 1)
        self.steps_done, self.running = (block.scalar(ti.i32, 1) for _ in range(2))
        self.worker_count, self.started_count = (block.scalar(ti.i32, 1) for _ in range(2))
        self.patience = block.scalar(ti.i32, 2)
        self.next_chunk, self.released = (block.scalar(ti.i32, 2 * CACHE_LINE) for _ in range(2))
        self.arrived = block.scalar(ti.i32, 3 * CACHE_LINE)
        self.list_length_needed = block.scalar(ti.i32, 1)
        self.abort = block.scalar(ti.i32, 1)
        self.abort_particle = block.scalar(ti.i32, 1)
        self.pair_constants = block.vector(backend.real, len(plan.pair_constants), count=plan.pair_constants.shape[1])
        energy_budget = plan.features.energy_budget
        self.losses = block.vector(ti.f64, plan.chunk_capacity, count=len(LOSSES)) if energy_budget else None
        measured = len(plan.scene.measured_walls)
        self.impulses = block.vector(ti.f64, plan.chunk_capacity, measured, count=IMPULSE_SIZE) if measured else None
        has_image_work = energy_budget and plan.features.periodic != "none"
        self.boundary_work = block.scalar(ti.f64, plan.chunk_capacity) if has_image_work else None
        sheared, position_real = plan.features.lees_edwards, backend.position_real
        self.image_offset: Any = block.scalar(position_real, WALL_BATCH) if sheared else None
        self.image_speed: Any = block.scalar(backend.real, WALL_BATCH) if sheared else None

    def fill(self, plan: Plan) -> None:
        """Write the constant arrays."""
        dtype = np.float64 if self.pair_constants.dtype == ti.f64 else np.float32
        self.pair_constants.from_numpy(plan.pair_constants.astype(dtype))
        self.abort_particle[0] = NO_PARTICLE


class State:
    """All device data of one plan.

    count:          number of particles
    clock:          simulated time
    wall_motions:   present motions of each wall
    particles:      particle fields
    neighbors:      neighbor lists and contact histories
    batch:          columns of the batched contacts; None on a GPU and with one particle per chunk
    wall_dynamics:  force-controlled walls; None without
    mesh:           mesh walls; None without
    """

    def __init__(self, plan: Plan, backend: Backend) -> None:
        self.plan, self.backend = plan, backend
        self.clock = Clock(plan.time_step)
        self.count = 0
        self.wall_motions: tuple[tuple[Motion, ...], ...] = tuple(() for _ in plan.walls)
        self._allocate(plan.list_capacity_per_chunk)
        self.walls.fill(plan)
        if self.mesh is not None:
            self.mesh.fill(plan)
        self.control.fill(plan)

    def _allocate(self, list_capacity_per_chunk: int) -> None:
        plan, backend, block = self.plan, self.backend, FieldBlock()
        self._block = block
        self.particles = Particles(block, plan, backend)
        self.neighbors = NeighborList(block, plan, backend, list_capacity_per_chunk)
        batched = backend.on_cpu and plan.chunk_size > 1
        self.batch: Any = PairBatch(block, plan, backend, list_capacity_per_chunk) if batched else None
        self.cell_sort = CellSort(block, plan, self.particles)
        self.walls = Walls(block, plan, backend)
        self.wall_dynamics: Any = WallDynamicsFields(block, plan) if plan.controlled_motions else None
        self.mesh: Any = MeshFields(block, plan, backend) if plan.features.mesh_walls else None
        self.control = Control(block, plan, backend)
        block.finish()

    @property
    def stride(self) -> int:
        """Loop iterations per chunk, of which the first processes the chunk; see CPU_STRIDE."""
        return CPU_STRIDE if self.backend.on_cpu else 1

    @property
    def chunk_count(self) -> int:
        """Number of chunks that contain particles."""
        return -(-self.count // self.plan.chunk_size)

    def grow_neighbor_list(self, list_capacity_per_chunk: int, build: Callable[[], None]) -> None:
        """Reallocate all fields with a larger list capacity per chunk, build all kernels again, restore the values.

        list_capacity_per_chunk:  new number of entries
        build:                    builds the kernels; it may launch them on empty ranges, because the restored values
                                  overwrite their output
        """
        saved = [field.to_numpy() for field in self._block.fields]
        self._block.free()
        self._allocate(list_capacity_per_chunk)
        build()
        for field, values in zip(self._block.fields, saved, strict=True):
            padded = np.zeros((field.shape[0], *values.shape[1:]), values.dtype)
            padded[: len(values)] = values
            field.from_numpy(padded)

    def free(self) -> None:
        """Free all device memory; the state cannot be used afterwards."""
        self._block.free()
