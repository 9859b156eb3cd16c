"""Device arrays. `plan.device_arrays` lists most of them; a field that the plan does not need is None."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from granflow.engine.backend import Backend
from granflow.engine.clock import Clock
from granflow.engine.control import Control
from granflow.engine.field_block import FieldBlock, Fields
from granflow.engine.field_kernels import build_clear, build_copy, read_field, write_field
from granflow.engine.mesh_fields import fill_mesh
from granflow.engine.pair_batch import PairBatch
from granflow.engine.parameters import Parameters
from granflow.engine.ranks import Gathering, OneProcess
from granflow.engine.wall_fields import WallDynamicsFields, Walls
from granflow.errors import GranflowError
from granflow.fields import PARTICLE_QUANTITIES
from granflow.geometry.motion import Motion
from granflow.kernel_language import ti
from granflow.plan.capacities import Capacities
from granflow.plan.device_arrays import cell_arrays, mesh_arrays, neighbor_arrays, particle_arrays
from granflow.plan.plan import Plan
from granflow.plan.structure import structure_of

CPU_STRIDE = 512
"""Minimum number of loop iterations per CPU thread in Taichi: loops over chunks are longer by this factor."""

Built = TypeVar("Built")


class Particles(Fields):
    """Fields of `PARTICLE_QUANTITIES`, in cell order; velocities are half a step behind the positions (leapfrog)."""

    def __init__(self, block: FieldBlock, plan: Plan, backend: Backend) -> None:
        super().__init__(block.arrays(particle_arrays(plan), backend))

    def sorted_fields(self) -> list[Any]:
        """Fields that are permuted with the particles at a neighbor-list rebuild."""
        fields = [getattr(self, spec.name) for spec in PARTICLE_QUANTITIES.values() if spec.dtype and spec.sorted]
        return [field for field in fields if field is not None]


class CellSort(Fields):
    """Work arrays of the neighbor search: cells and the new order; one grid per size class if sizes differ widely.

    cell_start:   first particle of each cell in `order`
    order:        previous index of each particle of the new order
    grid_low:     low corner [m] of each grid
    cell_side:    cell sides [m] of each grid
    cells:        number of cells along each axis of each grid
    class_order:  particles by class and cell, from `class_start` of a cell
    first_cell:   first cell of each class
    radius:       largest radius [m] of each class
    low, high, reach:  corners [m] of bounding boxes, and the largest reach [m] of a particle in each of them; with
                       `subpart_`, of the parts of these parts for the threads of a GPU
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


class NeighborList(Fields):
    """Neighbor lists (Verlet lists), one per particle; each chunk of several particles has a separate segment.

    If each particle is a chunk, as on a GPU, the lists are in one segment without gaps, in any order.

    list_begin, list_end:  range of the entries of each particle
    list_walls_end:        end of its wall entries, which are first
    partner:               index of a particle, -1 - wall, or -1 - wall count - triangle
    history:               history of each entry by slot of the contact models
    in_contact:            state of each entry, see `contact_history_entry`; only with a history
    saved:                 copy of the entries with a history while the particles are sorted

    A pair within a chunk is in one list, a pair across two chunks in both.
    """

    def __init__(self, block: FieldBlock, plan: Plan, capacities: Capacities, backend: Backend) -> None:
        fields = block.arrays(neighbor_arrays(plan, capacities), backend)
        self.history = {name: fields.pop(f"history.{name}") for name in plan.history}
        self.saved = {name: fields.pop(f"saved.{name}") for name in plan.history}
        super().__init__(fields)


class State:
    """All device data of one plan.

    structure:      what the kernels depend on, see `plan.structure`
    capacities:     lengths of the arrays; those of the plan unless the neighbor lists have grown
    parameters:     numbers of the plan
    count:          number of particles
    clock:          simulated time
    wall_motions:   present motions of each wall
    particles:      particle fields
    neighbors:      neighbor lists and contact histories
    batch:          columns of the batched contacts; None on a GPU and with one particle per chunk
    wall_dynamics:  force-controlled walls; None without
    mesh:           mesh walls, see `mesh_fields`; None without
    ranks:          combines the data of MPI ranks
    """

    def __init__(self, plan: Plan, backend: Backend) -> None:
        self.structure = structure_of(plan)
        self.plan, self.backend = plan, backend
        self._built: dict[Any, Any] = {}
        self.capacities = plan.capacities
        self._allocate()
        self._begin()

    def reset(self, plan: Plan) -> None:
        """Begin again with another plan of equal structure; the kernels are those that exist.

        Raises nothing for another structure, see `plan.structure`; the caller compares.
        """
        self.plan, self.capacities = plan, replace(self.capacities, segments=plan.capacities.segments)
        if not self._block.clear():
            self.built(build_clear)()
        self._begin()

    def _begin(self) -> None:
        """Write all constant data into arrays of zeros."""
        plan = self.plan
        self.clock = Clock(plan.time_step)
        self.count = 0
        self.ranks: Gathering = OneProcess()
        self.wall_motions: tuple[tuple[Motion, ...], ...] = tuple(() for _ in plan.walls)
        self.parameters.write(plan, self.capacities)
        self.cell_sort.fill(plan)
        self.walls.fill(plan)
        if self.mesh is not None:
            fill_mesh(self.mesh, plan)
        self.control.fill(plan)

    @property
    def fields(self) -> list[Any]:
        """All fields, without the columns of the batch."""
        return self._block.fields

    def _allocate(self) -> None:
        plan, capacities, backend, block = self.plan, self.capacities, self.backend, FieldBlock(self.backend)
        self._block = block
        self.parameters = Parameters(block, plan, capacities, backend)
        self.particles = Particles(block, plan, backend)
        self.neighbors = NeighborList(block, plan, capacities, backend)
        batched = backend.on_cpu and plan.chunk_size > 1
        self.batch: Any = PairBatch(block, plan, capacities, backend) if batched else None
        self.cell_sort = CellSort(block, plan, backend)
        self.walls = Walls(block, plan, backend)
        self.wall_dynamics: Any = WallDynamicsFields(block, plan, backend) if plan.controlled_motions else None
        self.mesh: Any = Fields(block.arrays(mesh_arrays(plan), backend)) if plan.features.mesh_walls else None
        self.control = Control(block, plan, backend)
        block.finish()

    @property
    def stride(self) -> int:
        """Loop iterations per chunk, of which the first processes the chunk; see CPU_STRIDE."""
        return CPU_STRIDE if self.backend.on_cpu else 1

    @property
    def chunk_count(self) -> int:
        """Number of chunks that contain particles, at least 1: the first chunk has the forces on walls of all ranks."""
        return max(-(-self.count // self.plan.chunk_size), 1)

    @property
    def wall_row_count(self) -> int:
        """Rows in which the present particles sum the forces on walls."""
        return self.chunk_count if self.plan.chunk_size > 1 else self.capacities.wall_rows

    def parameter(self, name: str, component: int | None = None) -> Any:
        """Device function (): a parameter of the plan, or one component of a vector, see `Parameters`."""
        return self.parameters.reader(name, component)

    def built(self, build: Callable[..., Built], *options: Any) -> Built:
        """Return `build(state, *options)`, built at first use, and again after the fields have been reallocated.

        For kernels and tables that a run may not need; they refer to the fields that exist when they are built.
        """
        key = (build, *options)
        if key not in self._built:
            self._built[key] = build(self, *options)
        found: Built = self._built[key]
        return found

    def grow_neighbor_list(self, capacities: Capacities, build: Callable[[], None]) -> None:
        """Reallocate all fields with larger neighbor lists, build all kernels again, restore the values.

        capacities:  new lengths of the arrays
        build:       builds the kernels; it may launch them on empty ranges, because the restored values overwrite their
                     output
        """
        saved = [read_field(field) for field in self._block.fields]
        self.free()
        self._allocate_grown(capacities, build)
        for field, values in zip(self._block.fields, saved, strict=True):
            write_field(field, values)
        self.parameters.write(self.plan, capacities)

    def grow_on_device(self, capacities: Capacities, build: Callable[[], None]) -> None:
        """As `grow_neighbor_list`, without a copy on the host: one kernel copies all fields, old and new in memory."""
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
        self.plan, self.backend, self.capacities = state.plan, state.backend, state.capacities
        self.clock, self.count, self.wall_motions = state.clock, state.count, state.wall_motions

    def __getattr__(self, name: str) -> Any:
        raise GranflowError("This simulation has been freed. Read its results before, or create another one.")
