"""Device arrays. `plan.arrays` lists most of them; a field that the plan does not need is None."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np

from granflow.engine.backend import Backend
from granflow.engine.codes import NO_PARTICLE, NOT_HALTED, PHASE_FORCES, PHASE_INTEGRATION
from granflow.engine.fields import (
    FieldBlock,
    Fields,
    build_clear,
    build_copy,
    read_field,
    write_field,
    write_padded,
)
from granflow.engine.mesh import DeviceMesh
from granflow.errors import GranflowError
from granflow.fields import PARTICLE_QUANTITIES
from granflow.geometry.periodic_box import PeriodicBox
from granflow.geometry.surface import AnalyticSurface
from granflow.kernel_language import ti
from granflow.plan.arrays import (
    cell_arrays,
    deformation_arrays,
    neighbor_arrays,
    parameters_of,
    particle_arrays,
    structure_of,
    sum_arrays,
    wall_dynamics_arrays,
)
from granflow.plan.capacities import POSE_COUNT, WORKERS, Capacities, rounded_capacity
from granflow.plan.cost import is_worth_optimizing
from granflow.plan.plan import Plan, parameter_count
from granflow.scene.blocks.motions import TimedMotion, rotations_of

CPU_STRIDE = 512
"""Minimum number of loop iterations per CPU thread in Taichi: loops over chunks are longer by this factor."""
Built = TypeVar("Built")


def wants_optimization(plan: Plan, backend: Backend) -> bool:
    """Whether the kernel language optimizes the kernels, before LLVM does: for long runs, and on a GPU, whose
    driver may contract other products with sums."""
    return not backend.on_cpu or is_worth_optimizing(plan)


class State:
    """All device data of one plan.

    structure:      what the kernels depend on, see `plan.arrays.structure_of`
    optimized:      kernels are optimized by the kernel language, see `wants_optimization`
    capacities:     lengths of the arrays; those of the plan unless the neighbor lists have grown
    parameters:     numbers of the plan
    count:          number of particles
    clock:          simulated time
    wall_motions:   present motions of each wall
    particles:      particle fields
    neighbors:      neighbor lists and contact histories
    batch:          columns of the batched contacts; None on a GPU and with one particle per chunk
    wall_dynamics:  force-controlled walls; None without
    deformation:    periodic box whose widths change; None with constant widths
    mesh:           mesh walls, see `engine.mesh.DeviceMesh`; None without
    ranks:          combines the data of MPI ranks
    """

    def __init__(self, plan: Plan, backend: Backend) -> None:
        self.structure = structure_of(plan)
        self.optimized = wants_optimization(plan, backend)
        self.plan = plan
        self.backend = backend
        self._built: dict[Any, Any] = {}
        self.capacities = plan.capacities
        self._allocate()
        self._begin()

    def reset(self, plan: Plan) -> None:
        """Begin again with another plan of equal structure, which the caller ensures; the kernels remain."""
        self.plan = plan
        self.capacities = replace(self.capacities, segments=plan.capacities.segments)
        if not self._block.clear():
            self.built(build_clear)()
        self._begin()

    def _begin(self) -> None:
        """Write all constant data into arrays of zeros."""
        plan = self.plan
        self.clock = Clock(plan.time_step)
        self.count = 0
        self.ranks: Gathering = OneProcess()
        self.wall_motions: tuple[tuple[TimedMotion, ...], ...] = tuple(() for _ in plan.walls)
        self.gravity_course = plan.scene.gravity_course({})
        self.parameters.write(plan, self.capacities)
        self.cell_sort.fill(plan)
        self.walls.fill(plan)
        if self.mesh is not None:
            self.mesh.fill(plan)
        if self.deformation is not None:
            self.deformation.fill(plan)
        self.control.fill(plan)

    @property
    def fields(self) -> list[Any]:
        """All fields, without the columns of the batch."""
        return self._block.fields

    def _allocate(self) -> None:
        plan = self.plan
        capacities = self.capacities
        backend = self.backend
        block = FieldBlock(self.backend)
        self._block = block
        self.parameters = Parameters(block, plan, capacities, backend)
        self.particles = Particles(block, plan, backend)
        self.neighbors = NeighborList(block, plan, capacities, backend)
        batched = backend.on_cpu and plan.chunk_size > 1
        self.batch: Any = PairBatch(block, plan, capacities, backend) if batched else None
        self.cell_sort = CellSort(block, plan, backend)
        self.walls = Walls(block, plan, backend)
        self.wall_dynamics: Any = (
            WallDynamicsFields(block, plan, backend) if plan.controlled_motions else None
        )
        self.deformation: Any = (
            DeformationFields(block, plan, backend) if plan.features.deforming_box else None
        )
        self.mesh: Any = DeviceMesh(block, plan, backend) if plan.features.mesh_walls else None
        self.control = Control(block, plan, backend)
        block.finish()

    @property
    def periodic_box(self) -> PeriodicBox:
        """The periodic box at the present time."""
        box = self.plan.periodic_box.at(self.clock.time)
        if self.deformation is None:
            return box
        fields = self.deformation
        return replace(box, width=fields.width.to_numpy(), width_velocity=fields.width_velocity.to_numpy())

    @property
    def stride(self) -> int:
        """Loop iterations per chunk, of which the first processes the chunk; see CPU_STRIDE."""
        return CPU_STRIDE if self.backend.on_cpu else 1

    @property
    def chunk_count(self) -> int:
        """Number of chunks that contain particles, at least 1.

        The first chunk has the forces on walls of all ranks.
        """
        return max(-(-self.count // self.plan.chunk_size), 1)

    @property
    def wall_row_count(self) -> int:
        """Rows in which the present particles sum the forces on walls."""
        return self.chunk_count if self.plan.chunk_size > 1 else self.capacities.wall_rows

    def parameter(self, name: str, component: int | None = None) -> Any:
        """Device function (): a parameter of the plan, or one component of a vector, see `Parameters`."""
        return self.parameters.reader(name, component)

    def built(self, build: Callable[..., Built], *options: Any) -> Built:
        """Return `build(state, *options)`, built at first use, and again after a reallocation of fields.

        For kernels and tables that a run may not need; they refer to the fields that exist when they are
        built.
        """
        key = (build, *options)
        if key not in self._built:
            self._built[key] = build(self, *options)
        found: Built = self._built[key]
        return found

    def grow_neighbor_list(self, capacities: Capacities, build: Callable[[], None]) -> None:
        """Reallocate all fields with larger neighbor lists, build all kernels again, restore the values.

        capacities:  new lengths of the arrays
        build:       builds the kernels; it may launch them on empty ranges, because the restored values
                     overwrite their output
        """
        saved = [read_field(field) for field in self._block.fields]
        self.free()
        self._allocate_grown(capacities, build)
        for field, values in zip(self._block.fields, saved, strict=True):
            write_field(field, values)
        self.parameters.write(self.plan, capacities)

    def grow_on_device(self, capacities: Capacities, build: Callable[[], None]) -> None:
        """As `grow_neighbor_list`, but one kernel copies all fields, and the host holds no copy.

        The old and the new fields are in memory at the same time.
        """
        self._free_built()
        old = self._block
        self._allocate_grown(capacities, build)
        build_copy(old.fields, self._block.fields)()
        old.free()
        self.parameters.write(self.plan, capacities)

    def _allocate_grown(self, capacities: Capacities, build: Callable[[], None]) -> None:
        self.capacities = capacities
        self._allocate()
        self.parameters.write(self.plan, capacities)  # the kernels divide by the chunk size
        build()

    def free(self) -> None:
        """Free all device memory."""
        self._free_built()
        self._block.free()

    def _free_built(self) -> None:
        for each in self._built.values():
            if isinstance(getattr(each, "block", None), FieldBlock):
                each.block.free()
        self._built.clear()


class FreedState:
    """What remains of the state of an engine that has been freed."""

    def __init__(self, state: State) -> None:
        self.plan = state.plan
        self.backend = state.backend
        self.capacities = state.capacities
        self.clock = state.clock
        self.count = state.count
        self.wall_motions = state.wall_motions
        self.gravity_course = state.gravity_course

    def __getattr__(self, name: str) -> Any:
        raise GranflowError("This simulation has been freed. Read its results before, or create another one.")


# Simulated time, step by step.


class Clock:
    """Counts steps and computes their times [s]. A new time step applies from the present time on;
    `time_step_of_forces` is that for which the present forces and flows have been computed.

    Times follow from step numbers and not from a running sum, so that they do not depend on the launches.
    """

    def __init__(self, time_step: float) -> None:
        """Start at time 0 with a time step [s]."""
        self.time_step = time_step
        self.time_step_of_forces = time_step
        self.step_count = 0
        self._since_step = 0
        self._since_time = 0.0

    @property
    def time(self) -> float:
        """Simulated time [s] now."""
        return float(self.time_after(self.step_count))

    def time_after(self, step: int | np.ndarray) -> float | np.ndarray:
        """Simulated time [s] after step numbers, scalar or (k,).

        None of them may precede the last change of the time step.
        """
        return self._since_time + (step - self._since_step) * self.time_step

    def change(self, time_step: float) -> None:
        """Set the time step [s] of all further steps."""
        self._since_time = self.time
        self._since_step = self.step_count
        self.time_step = time_step

    def state_dict(self) -> dict[str, float]:
        """The complete state of the clock, for a checkpoint."""
        return {
            "time_step": self.time_step,
            "time_step_of_forces": self.time_step_of_forces,
            "step_count": self.step_count,
            "since_step": self._since_step,
            "since_time": self._since_time,
        }

    def load_state_dict(self, saved: dict[str, float]) -> None:
        """Restore a state that `state_dict` returned."""
        self.time_step = saved["time_step"]
        self.time_step_of_forces = saved["time_step_of_forces"]
        self.step_count = int(saved["step_count"])
        self._since_step = int(saved["since_step"])
        self._since_time = saved["since_time"]


# Particles, their cells and neighbor lists.


class Particles(Fields):
    """Fields of `PARTICLE_QUANTITIES`, in cell order.

    Velocities are half a step behind the positions (leapfrog).
    """

    def __init__(self, block: FieldBlock, plan: Plan, backend: Backend) -> None:
        super().__init__(block.arrays(particle_arrays(plan), backend))
        self._some_fixed = plan.features.fixed_particles

    def sorted_fields(self) -> list[Any]:
        """Fields that are permuted with the particles at a neighbor-list rebuild."""
        fields = [
            getattr(self, spec.name) for spec in PARTICLE_QUANTITIES.values() if spec.dtype and spec.sorted
        ]
        return [field for field in fields if field is not None]

    @ti.func
    def mobility(self, i):
        """1, or 0 for a fixed particle, whose velocity no force changes."""
        share = ti.cast(1.0, self.mass.dtype)
        if ti.static(self._some_fixed):
            share = ti.cast(1 - self.fixed[i], self.mass.dtype)
        return share


def mobility_mask(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """1.0 for mobile and 0.0 for fixed particles, float64 (n,).

    arrays:  particle fields: mass (n,), and `fixed` (n,) only if some are fixed
    """
    fixed = arrays.get("fixed", np.zeros(len(arrays["mass"]), np.int32))
    return 1.0 - np.asarray(fixed, float)


class NeighborList(Fields):
    """Neighbor lists (Verlet lists), one per particle.

    Each chunk of several particles has a segment of its own.

    If each particle is a chunk, as on a GPU, the lists are in one segment without gaps, in any order.

    list_begin, list_end:  range of the entries of each particle
    list_walls_end:        end of its wall entries, which are first
    partner:               index of a particle, -1 - wall, or -1 - wall count - triangle
    history:               history of each entry by slot of the contact models
    in_contact:            state of each entry, see `engine.history`; only with a history
    saved:                 copy of the entries with a history while the particles are sorted

    A pair within a chunk is in one list, a pair across two chunks in both.
    """

    def __init__(self, block: FieldBlock, plan: Plan, capacities: Capacities, backend: Backend) -> None:
        fields = block.arrays(neighbor_arrays(plan, capacities), backend)
        self.history = {name: fields.pop(f"history.{name}") for name in plan.history}
        self.saved = {name: fields.pop(f"saved.{name}") for name in plan.history}
        super().__init__(fields)


class CellSort(Fields):
    """Work arrays of the neighbor search: cells and the new order.

    If sizes differ widely, each size class has its own grid.

    cell_start:   first particle of each cell in `order`
    order:        previous index of each particle of the new order
    grid_low:     low corner [m] of each grid
    cell_side:    cell sides [m] of each grid
    cells:        number of cells along each axis of each grid
    class_order:  particles by class and cell, from `class_start` of a cell
    first_cell:   first cell of each class
    radius:       largest radius [m] of each class
    low, high, reach:  corners [m] of bounding boxes, and the largest reach [m] of a particle in each of them;
                       with `subpart_`, of the parts of these parts for the threads of a GPU
    reach_largest:     largest reach [m] of all particles
    cell_count:        cells of each grid, and of all size classes
    present:           number of particles that are not deleted
    owned_count:       number of particles of this MPI rank
    ghost_first:       index of the first ghost, the begin of a chunk
    """

    def __init__(self, block: FieldBlock, plan: Plan, backend: Backend) -> None:
        super().__init__(block.arrays(cell_arrays(plan), backend))

    def fill(self, plan: Plan) -> None:
        """Write the radii of the size classes."""
        radii = np.zeros(self.radius.shape[0], ti.lang.util.to_numpy_type(self.radius.dtype))
        radii[: len(plan.size_classes)] = plan.size_classes
        self.radius.from_numpy(radii)


# Device fields of walls.

NOT_MEASURED = -1
"""Impulse row of walls whose forces are not measured."""


NOT_WORN = -1
"""Law of walls without wear."""


class Walls:
    """Shapes at rest, materials, and poses for the next POSE_COUNT steps.

    kind:              index in `Plan.surface_kinds`; that after the last one for a mesh
    parameters:        numbers of the surface, in the order of `AnalyticSurface.widths`
    present:           1 for walls that are present
    pivot:             [m], point of the rotation at rest
    center, rotation:  [m], 3 x 3: pose after each step; None if no wall moves
    velocity:          [m/s] of the center at the middle of each step, and of one more
    angular_velocity:  [rad/s] likewise
    surface_velocity:  [m/s] of the surface along itself likewise, before the projection on a contact plane;
                       None without belts
    impulse_row:       row in `Control.impulses`, or NOT_MEASURED
    torque_point:      [m], to which measured torques refer after each step, or one if no wall moves; without
                       the displacement by forces
    has_axis:          1 for walls whose torques refer to the axis of a rotation; None without walls that
                       forces move
    wear_law:          index in `Plan.wear_laws`, or NOT_WORN
    wear_row:          row in `Control.wear`; of a mesh that of triangle 0 of all meshes, which can be below 0
    wear_coefficient:  worn volume over work [1/Pa] by material of the particle
    holds:             1 for groups of particles that touch the wall, 0 for those that pass; None if all touch
    values:            keys that contact models read, and 1 or 0 for whether a wall gives them: two fields by
                       key
    """

    def __init__(self, block: FieldBlock, plan: Plan, backend: Backend) -> None:
        count = plan.capacities.walls
        self.kind = block.scalar(ti.i32, count)
        most = max((surface.count() for surface in plan.surface_kinds), default=1)
        self.parameters = block.vector(backend.position_real, count, count=most)
        self.material = block.scalar(ti.i32, count)
        self.present = block.scalar(ti.i32, count)
        self.pivot = block.vector(backend.position_real, count)
        self.joints = block.scalar(ti.i32, count) if plan.features.joined_walls else None
        moving = plan.features.moving_walls
        self.center = block.vector(backend.position_real, POSE_COUNT, count) if moving else None
        self.rotation = block.matrix(backend.position_real, POSE_COUNT, count) if moving else None
        self.velocity = block.vector(backend.real, POSE_COUNT + 1, count) if moving else None
        measured = plan.features.wall_forces
        self.impulse_row = block.scalar(ti.i32, count) if measured else None
        steps = POSE_COUNT if moving else 1
        self.torque_point: Any = block.vector(backend.position_real, steps, count) if measured else None
        moved_by_forces = measured and plan.features.force_controlled_walls
        self.has_axis: Any = block.scalar(ti.i32, count) if moved_by_forces else None
        self.angular_velocity = block.vector(backend.real, POSE_COUNT + 1, count) if moving else None
        worn = plan.features.wear
        self.wear_law: Any = block.scalar(ti.i32, count) if worn else None
        self.wear_row: Any = block.scalar(ti.i32, count) if worn else None
        self.wear_coefficient: Any = block.scalar(ti.f64, count, len(plan.materials)) if worn else None
        is_selective = plan.features.wall_groups
        self.holds: Any = block.scalar(ti.i32, count, len(plan.groups)) if is_selective else None
        has_belt = plan.features.surface_velocity
        self.surface_velocity = block.vector(backend.real, POSE_COUNT + 1, count) if has_belt else None
        self.values = {
            key: (block.scalar(ti.f64, count), block.scalar(ti.f64, count))
            for key in plan.laws.wall_properties
        }

    def fill(self, plan: Plan) -> None:
        """Write the constant arrays."""
        for index, wall in enumerate(plan.walls):
            self.material[index] = wall.material
            self.kind[index] = len(plan.surface_kinds)
            if isinstance(wall.surface, AnalyticSurface):
                self.kind[index] = plan.surface_kinds.index(type(wall.surface))
                numbers = wall.surface.numbers.tolist()
                self.parameters[index] = numbers + [0.0] * (self.parameters.n - len(numbers))
            if self.impulse_row is not None:
                measured = plan.scene.measured_walls
                self.impulse_row[index] = measured.index(wall.name) if wall.name in measured else NOT_MEASURED
            if self.has_axis is not None:
                turns = wall.spec.torque_point is None and bool(rotations_of(wall.motions))
                self.has_axis[index] = int(turns)
            for number, group in enumerate(plan.groups if self.holds is not None else ()):
                self.holds[index, number] = int(wall.spec.holds(group.name))
            for key, (values, given) in self.values.items():
                value = plan.wall_values[key][index]
                values[index] = value or 0.0
                given[index] = float(value is not None)
        self._fill_wear(plan)
        self.fill_joints(plan)

    def _fill_wear(self, plan: Plan) -> None:
        """Write laws, rows and coefficients of wear; 0 for materials that are no material of particles."""
        if self.wear_law is None:
            return
        used = [group.material for group in plan.scene.particles.values()]
        for index, wall in enumerate(plan.walls):
            wear = wall.spec.wear
            self.wear_law[index] = NOT_WORN if wear is None else plan.wear_laws.index(type(wear))
            if wear is None:
                continue
            first, _ = plan.wear_rows[index]
            self.wear_row[index] = first - (plan.first_triangle(index) if index in plan.meshes else 0)
            for number, material in enumerate(plan.materials):
                is_used = material in used
                self.wear_coefficient[index, number] = wear.volume_per_work(material) if is_used else 0.0

    def fill_joints(self, plan: Plan) -> None:
        """Write which walls touch; it changes if a program changes the motion of a wall."""
        if self.joints is not None:
            for index, joints in enumerate(plan.wall_joints):
                self.joints[index] = joints


class WallDynamicsFields(Fields):
    """Force-controlled walls, an entry per motion, in float64 for every precision.

    offset:             displacement along the direction of the motion [m]
    offset_at_rebuild:  `offset` at the last neighbor-list rebuild [m]
    velocity:           [m/s], half a step behind
    active:             1 if the motion is active in the step that ends at a pose
    was_active:         1 if it was active in the previous step
    wall_force:         force of the particles along the direction, summed by each chunk, in units of
                        `plan.sum_units`
    work_on_particles:  work on the particles [J]
    work:               work of all other forces on a free wall [J]
    """

    def __init__(self, block: FieldBlock, plan: Plan, backend: Backend) -> None:
        super().__init__(block.arrays(wall_dynamics_arrays(plan), backend))


class DeformationFields(Fields):
    """Periodic box whose widths change, an entry per axis, in float64 for every precision.

    width:             [m]
    width_velocity:    rate of change of the width [m/s], half a step behind
    width_at_rebuild:  `width` at the last neighbor-list rebuild [m]
    stretch:           ratio of both
    kick:              change of the width velocity in the present step over the width [1/s]
    target:            pressure that the width follows [Pa]
    rate:              strain rate, or with a target its largest magnitude [1/s]
    gain:              strain rate over the deviation from the target [1/(Pa s)]; 0 without a target
    virial:            sum of force times distance of the contacts along the axis, summed by each chunk, in
                       units of `plan.virial_unit`
    face_force:        force of the contacts across the upper face on the particles below it, likewise, in
                       units of `plan.sum_units`
    work:              work of the moving images on the particles [J]
    """

    def __init__(self, block: FieldBlock, plan: Plan, backend: Backend) -> None:
        super().__init__(block.arrays(deformation_arrays(plan), backend))

    def fill(self, plan: Plan) -> None:
        """Write the widths at the start."""
        for name in ("width", "width_at_rebuild"):
            getattr(self, name).from_numpy(np.array(plan.periodic_box.width, float))
        self.stretch.fill(1.0)


# Columns in which each CPU thread collects the contacts that it evaluates together.

BATCH = 128
"""Number of contacts at which a batch is complete; no further neighbor list is added."""
LANES = 16
"""Batches are padded to a multiple of this number, so that the compiled loop has no scalar remainder."""
STAGGER = 24
"""Offset between columns: columns a multiple of 4096 bytes apart evict each other from the cache."""


class PairBatch:
    """Columns with an entry per contact of the present batch, and a part of each column per CPU thread.

    longest_list:  largest number of candidate pairs of one particle for which a batch suffices
    sums:          contact force and torque on each particle of the chunk of a worker; None in f64

    The names are those of the variables in `engine.pair`; `evaluate` overwrites inputs with results.
    """

    def __init__(self, block: FieldBlock, plan: Plan, capacities: Capacities, backend: Backend) -> None:
        features = plan.features
        real = backend.real
        page = 4096 // 8
        self.capacity = -(-capacities.batch // page) * page + STAGGER
        self.longest_list = self.capacity - BATCH - LANES
        worker_parts = block.parts(rounded_capacity(backend.worker_count, WORKERS))

        def columns(number: int, dtype: Any = real) -> list[Any]:
            return [block.column(worker_parts, dtype, self.capacity) for _ in range(number)]

        self.list_index, self.owner, self.partner = columns(3, ti.i32)
        spheres = columns(0 if features.one_size else 4)
        self.radius, self.radius_partner, self.mass, self.mass_partner = spheres or [None] * 4
        self.branch = columns(3)
        self.velocity_rel_half = columns(3)
        self.velocity_rel = columns(3 * features.synchronized)
        self.angular_velocity = columns(3 * features.rotation)
        self.angular_velocity_partner = columns(3 * features.rotation)
        self.angular_velocity_now = columns(3 * features.viscous_cohesion)
        self.angular_velocity_partner_now = columns(3 * features.viscous_cohesion)
        self.history = {slot: columns(size) for slot, size in plan.history.items()}
        self.constants = columns(0 if features.one_material else plan.pair_constants.shape[1])
        self.losses = columns(3 * features.energy_budget)
        self.viscous_power = columns(features.energy_budget and features.viscous_cohesion)
        size = 6 if features.rotation else 3
        workers = rounded_capacity(backend.worker_count, WORKERS)
        self.sums = None
        if real != ti.f64:  # otherwise the fields of forces and torques hold the sums
            self.sums = block.vector(ti.f64, workers, plan.capacities.chunk_particles, count=size)


# Numbers of the plan on the device; see `plan/arrays.py`.


class Parameters:
    """One field per type with the parameters one after the other; device functions read them by name."""

    def __init__(self, block: FieldBlock, plan: Plan, capacities: Capacities, backend: Backend) -> None:
        self._places: dict[str, tuple[str, int, int]] = {}
        lengths: dict[str, int] = {}
        for parameter in parameters_of(plan, capacities):
            first = lengths.get(parameter.dtype, 0)
            lengths[parameter.dtype] = first + len(parameter.values)
            self._places[parameter.name] = parameter.dtype, first, lengths[parameter.dtype]
        self._fields = {
            dtype: block.scalar(backend.types[dtype], length) for dtype, length in lengths.items()
        }

    def write(self, plan: Plan, capacities: Capacities) -> None:
        """Write all parameters of a plan with equal features and capacities."""
        values = {
            dtype: np.zeros(field.shape[0], ti.lang.util.to_numpy_type(field.dtype))
            for dtype, field in self._fields.items()
        }
        for parameter in parameters_of(plan, capacities):
            dtype, first, end = self._places[parameter.name]
            values[dtype][first:end] = parameter.values
        for dtype, field in self._fields.items():
            field.from_numpy(values[dtype])

    def reader(self, name: str, component: int | None = None) -> Any:
        """Device function (): the value of a parameter, a number or a vector, or one component of a vector.

        Loops read a parameter once, before they begin: the compiler cannot know that no store changes it.
        """
        dtype, first, end = self._places[name]
        if component is not None:
            first, end = first + component, first + component + 1
        field = self._fields[dtype]
        size = end - first

        @ti.func
        def number():
            return field[first]

        @ti.func
        def vector():
            return ti.Vector([field[first + k] for k in ti.static(range(size))])

        return number if size == 1 else vector


# Device flags, counters and constants that kernels and host share.

CACHE_LINE = 16
"""Integers per cache line; contended counters occupy separate lines."""


class Control(Fields):
    """Flags, counters and constants shared by kernels and host.

    rebuild_requested:          set by the integration if a particle or wall has moved too far
    rebuild_due:                copy of it at the end of the phase; all further phases of the launch do
                                nothing
    steps_done, running:        completed steps of a launch; 1 while it continues
    worker_count:               workers that have not left the launch
    started_count:              of them, those at the first barrier of the launch
    halted_at:                  on a GPU, number of the launch whose integration, or forces, halted the
                                following ones
    patience:                   number of polls after which a worker leaves, and that of the first barrier of
                                a launch
    next_chunk:                 number of chunks that workers have taken in this phase
    arrived, released:          counters of the barrier, see `engine.threads`
    list_length_needed:         largest number of entries of a segment, plus TOO_LONG if a list exceeds the
                                batch
    abort, abort_particle:      abort code and smallest id above the limit
    overlap_limit:              overlap over the smaller radius above which a step is the last of its launch
    pair_constants:             row per pair of materials
    law_parameters:             one row, the parameters of the contact laws
    losses:                     terms LOSSES of each chunk, see `engine.sums`
    impulses:                   time integrals of the wall forces of each chunk, see `engine.sums`
    wall_flows:                 time integrals of the flows of walls, and in the last places of the
                                surroundings and of sources, see `engine.flows`
    wall_flows_ahead:           part of them that belongs to the next step
    wear:                       worn volume and works of each worn face, see `engine.wear`
    collisions, collision_edges:  numbers of collisions by kind and energy class, and edges of the classes [J]
    losses_ahead:               part of the terms `sum_units.terms_ahead` of each chunk that belongs to the
                                next step, see `engine.contact`
    boundary_work:              work at periodic boundaries of each chunk, see `engine.sums`
    external_work:              work of external forces of each chunk, see `engine.sums`
    force_parameters:           parameters of all external forces
    force_clock:                since_time, time_step, steps since since_time of the next force evaluation,
                                and the time by which velocities lag behind positions there [s]
    damping:                    Cundall ratio and drag rate [1/s] of the present stage
    image_offset, image_speed:  of a sheared box, for POSE_COUNT steps [m], [m/s]
    gravity:                    [m/s2] before and after POSE_COUNT steps; None if it does not change
    gravity_work:               work of changing gravity of each chunk, see `engine.gravity`
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
        self.halted_at: Any = None if backend.on_cpu else block.scalar(ti.i32, 2)
        self.abort = block.scalar(ti.i32, 1)
        self.abort_particle = block.scalar(ti.i32, 1)
        self.overlap_limit = block.scalar(backend.real, 1)
        self.pair_constants = block.vector(
            backend.real, plan.capacities.pairs, count=plan.pair_constants.shape[1]
        )
        self.law_parameters = block.vector(backend.real, 1, count=max(len(plan.law_parameters), 1))
        super().__init__(block.arrays(sum_arrays(plan), backend))
        edges = max(plan.capacities.energy_classes - 1, 1)
        self.collision_edges: Any = block.scalar(ti.f64, edges) if plan.features.collision_energies else None
        external = plan.features.external_forces
        parameters = parameter_count(plan.external_forces)
        self.force_parameters: Any = block.scalar(ti.f64, max(parameters, 1)) if external else None
        damped = plan.scene.damping is not None
        self.force_clock: Any = block.scalar(ti.f64, 4) if external or damped else None
        self.damping: Any = block.scalar(ti.f64, 2) if damped else None
        sheared = plan.features.lees_edwards
        position_real = backend.position_real
        self.image_offset: Any = block.scalar(position_real, POSE_COUNT) if sheared else None
        self.image_speed: Any = block.scalar(backend.real, POSE_COUNT) if sheared else None
        changing = plan.features.changing_gravity
        self.gravity: Any = block.vector(ti.f64, POSE_COUNT + 1) if changing else None

    def fill(self, plan: Plan) -> None:
        """Write the constant arrays."""
        write_padded(self.pair_constants, plan.pair_constants)
        if plan.law_parameters:
            write_padded(self.law_parameters, np.array([plan.law_parameters]))
        if self.collision_edges is not None:
            write_padded(self.collision_edges, plan.collision_edges)
        self.clear_abort()
        self.overlap_limit[0] = plan.scene.numerics.intended_overlap
        if self.halted_at is not None:
            write_padded(self.halted_at, np.full(2, NOT_HALTED, np.int32))

    def clear_abort(self) -> None:
        """Forget an abort, before the first one or where the host goes on."""
        self.abort[0], self.abort_particle[0] = 0, NO_PARTICLE


class DeviceFlags(NamedTuple):
    """See `Control` and `CellSort`; on a CPU, the launches at which a phase halted are 0."""

    integration_halted_at: int
    forces_halted_at: int
    abort: int
    running: int
    list_length_needed: int
    present: int


def read_flags(state: State) -> DeviceFlags:
    """The present flags; on a GPU one kernel and one transfer for all of them."""
    control = state.control
    if control.halted_at is not None:
        return DeviceFlags(*(int(value) for value in state.built(_build_flags)()))
    return DeviceFlags(
        integration_halted_at=0,
        forces_halted_at=0,
        abort=int(control.abort[0]),
        running=int(control.running[0]),
        list_length_needed=int(control.list_length_needed[0]),
        present=int(state.cell_sort.present[0]),
    )


def _build_flags(state: State) -> Callable[[], Any]:
    """Kernel (): the flags as a vector, in the order of `DeviceFlags`.

    Reads:  halted_at, abort, running, list_length_needed, present
    """
    control = state.control
    sorting = state.cell_sort

    @ti.kernel
    def flags() -> ti.types.vector(6, ti.i32):
        return ti.Vector(
            [
                control.halted_at[PHASE_INTEGRATION],
                control.halted_at[PHASE_FORCES],
                control.abort[0],
                control.running[0],
                control.list_length_needed[0],
                sorting.present[0],
            ]
        )

    return flags


# How the data of all MPI ranks form the totals and arrays of a run; a process that is alone has all of
# them.

Arrays = dict[str, np.ndarray]
"""Arrays by name, of the particles of one rank or of all."""
NO_CHANGES = "Changes from Python do not work on MPI ranks: run without a communicator."
"""Message of a change of particles, walls or forces during a run on ranks."""


class Gathering(Protocol):
    """Combines what each rank has. All ranks call each function."""

    def total(self, words: np.ndarray) -> np.ndarray:
        """Numbers (n, ...), summed over the first axis of all ranks if there are several.

        Integers are summed exactly.
        """

    def largest(self, value: float) -> float:
        """Largest value of all ranks."""

    def gathered(self, arrays: Arrays) -> Arrays:
        """Arrays (n, ...) of all ranks, one rank after the other; complete on the root only."""


class OneProcess:
    """A run without MPI."""

    def total(self, words: np.ndarray) -> np.ndarray:
        """The integers."""
        return words

    def largest(self, value: float) -> float:
        """The value."""
        return value

    def gathered(self, arrays: Arrays) -> Arrays:
        """The arrays."""
        return arrays


ALONE = OneProcess()
"""Without MPI, or for arrays that are those of all ranks already."""
