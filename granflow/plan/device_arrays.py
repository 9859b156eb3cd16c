"""Device arrays of a plan: allocation, checkpoints, their validation and the memory estimate use these lists.

Each function returns the arrays of one group of the state, in the order of allocation.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from math import prod
from typing import Literal

from granflow.fields import PARTICLE_QUANTITIES, DeviceType
from granflow.plan.capacities import (
    BOUNDS,
    MIN_TRIANGLES,
    SCAN_BLOCK,
    SUBPARTS,
    WALL_BATCH,
    Capacities,
    rounded_capacity,
)
from granflow.plan.chunk_sums import IMPULSE_SIZE, LOSSES
from granflow.plan.plan import Plan

Precision = Literal["f64", "f32", "mixed"]


@dataclass(frozen=True)
class DeviceArray:
    """One device array.

    shape:         lengths along one or two axes
    width:         components of each entry; None: an entry is a number, not a vector
    wanted:        False for an array that the plan does not need
    saved:         part of checkpoints
    per_particle:  the first axis is that of the particles
    block:         consecutive arrays with the same block are interleaved entry by entry
    by_chunk:      the first axis is that of the chunks, or of rows that they share; checkpoints contain the sum over it
    """

    name: str
    dtype: DeviceType
    shape: tuple[int, ...]
    width: int | None = None
    wanted: bool = True
    saved: bool = False
    per_particle: bool = False
    block: str = ""
    by_chunk: bool = False

    @property
    def full_shape(self) -> tuple[int, ...]:
        """Shape of the array, with the components as the last axis."""
        return self.shape if self.width is None else (*self.shape, self.width)

    def size(self, precision: Precision) -> int:
        """Allocated memory [bytes]."""
        is_long = {"position": precision != "f32", "real": precision == "f64", "f64": True, "i32": False, "i64": True}
        return (8 if is_long[self.dtype] else 4) * (self.width or 1) * prod(self.shape) * self.wanted


def saved_arrays(arrays: Iterable[DeviceArray]) -> dict[str, DeviceArray]:
    """The arrays that checkpoints of the plan contain, by name."""
    return {array.name: array for array in arrays if array.wanted and array.saved}


def particle_arrays(plan: Plan) -> list[DeviceArray]:
    """Properties of the particles, see `granflow.fields`."""
    return [
        DeviceArray(
            field.name,
            field.dtype,
            (plan.capacities.particles,),
            None if field.kind == "scalar" else field.width,
            wanted=field.condition(plan.features),
            saved=field.saved,
            per_particle=True,
            block=field.block,
        )
        for field in PARTICLE_QUANTITIES.values()
        if field.dtype is not None
    ]


def neighbor_arrays(plan: Plan, capacities: Capacities) -> list[DeviceArray]:
    """Ranges and entries of the neighbor lists; names of contact histories begin with `history.` and `saved.`."""
    count, entries, saved_entries = (capacities.particles,), (capacities.list_entries,), (capacities.saved_entries,)
    has_history = bool(plan.history)
    return [
        *(DeviceArray(name, "i32", count, per_particle=True) for name in ("list_begin", "list_walls_end", "list_end")),
        DeviceArray("partner", "i32", entries),
        *(DeviceArray(f"history.{name}", "real", entries, width) for name, width in plan.history.items()),
        *(DeviceArray(f"saved.{name}", "real", saved_entries, width) for name, width in plan.history.items()),
        DeviceArray("in_contact", "i32", entries, wanted=has_history),
        *(
            DeviceArray(name, "i32", count, wanted=has_history, per_particle=True)
            for name in ("list_begin_before", "list_end_before")
        ),
        DeviceArray("partner_saved", "i32", saved_entries, wanted=has_history),
    ]


def cell_arrays(plan: Plan) -> list[DeviceArray]:
    """Cells and new order of the particles; see `CellSort`."""
    count, classes = (plan.capacities.particles,), (plan.capacities.size_classes,)
    cells, class_cells = plan.capacities.cells, plan.capacities.class_cells
    largest, by_class = max(cells, class_cells), bool(class_cells)
    subparts, one_particle_chunks = (BOUNDS * SUBPARTS,), plan.chunk_size == 1
    return [
        DeviceArray("order", "i32", count, per_particle=True),
        DeviceArray("cell_start", "i32", (cells + 2,)),
        DeviceArray("block_sum", "i32", (largest // SCAN_BLOCK + 2,)),
        DeviceArray("grid_low", "position", classes, 3),
        DeviceArray("cell_side", "position", classes, 3),
        DeviceArray("cells", "i32", classes, 3),
        DeviceArray("class_order", "i32", count, wanted=by_class, per_particle=True),
        DeviceArray("class_start", "i32", (class_cells + 2,), wanted=by_class),
        DeviceArray("first_cell", "i32", classes, wanted=by_class),
        DeviceArray("radius", "position", classes),
        DeviceArray("low", "position", (BOUNDS,), 3),
        DeviceArray("high", "position", (BOUNDS,), 3),
        DeviceArray("reach", "position", (BOUNDS,)),
        DeviceArray("subpart_low", "position", subparts, 3, wanted=one_particle_chunks),
        DeviceArray("subpart_high", "position", subparts, 3, wanted=one_particle_chunks),
        DeviceArray("subpart_reach", "position", subparts, wanted=one_particle_chunks),
        DeviceArray("reach_largest", "position", (1,)),
        DeviceArray("cell_count", "i32", (classes[0] + 1,)),
        DeviceArray("present", "i32", (1,)),
        DeviceArray("owned_count", "i32", (1,), wanted=plan.has_ghosts),
        DeviceArray("ghost_first", "i32", (1,), wanted=plan.has_ghosts),
    ]


def wall_dynamics_arrays(plan: Plan) -> list[DeviceArray]:
    """Force-controlled walls; see `WallDynamicsFields`."""
    count = len(plan.controlled_motions)
    names = ("offset", "offset_at_rebuild", "velocity", "work_on_particles", "work")
    return [
        *(DeviceArray(name, "f64", (count,), saved=True) for name in names),
        DeviceArray("was_active", "i32", (count,), saved=True),
        DeviceArray("active", "i32", (WALL_BATCH, count)),
        DeviceArray("wall_force", "i64", (plan.capacities.wall_rows, count), saved=True, by_chunk=True),
    ]


def sum_arrays(plan: Plan) -> list[DeviceArray]:
    """Sums of each chunk, for the energy budget, wall forces and collisions.

    Terms of the energy budget, wall forces, work at periodic boundaries and of external forces, numbers of collisions.
    Each term has two components, see `engine.exact_sums`.
    """
    chunks, measured = plan.capacities.chunks, plan.capacities.measured_walls
    wall_rows = plan.capacities.wall_rows
    energy_budget = plan.features.energy_budget
    classes = 2 * plan.capacities.energy_classes
    has_external_work = energy_budget and plan.features.external_forces
    has_image_work = energy_budget and plan.features.periodic != "none"
    has_wall_work = energy_budget and plan.features.moving_walls
    return [
        DeviceArray(name, "i64", shape, 2 * terms, wanted=wanted, saved=True, by_chunk=True)
        for name, shape, terms, wanted in (
            ("losses", (chunks,), len(LOSSES), energy_budget),
            ("impulses", (wall_rows, measured), IMPULSE_SIZE, measured > 0),
            ("wall_work_ahead", (chunks,), 1, has_wall_work),
            ("boundary_work", (chunks,), 1, has_image_work),
            ("external_work", (chunks,), 1, has_external_work),
            ("collisions", (wall_rows, classes), 1, classes > 0),
        )
    ]


def mesh_arrays(plan: Plan) -> list[DeviceArray]:
    """Triangles, edges (three per triangle), points and cell grids of all meshes; see `engine.mesh_fields`."""
    adjacencies, grids = [mesh.adjacency for mesh in plan.meshes.values()], plan.mesh_grids.values()
    triangles, points, vertex_edges, competitors, cells, cell_triangles = (
        (rounded_capacity(sum(lengths), MIN_TRIANGLES),)
        for lengths in (
            [len(each.normal) for each in adjacencies],
            [len(each.owner) for each in adjacencies],
            [len(each.vertex_edge) for each in adjacencies],
            [len(each.competitor) for each in adjacencies],
            [len(grid.start) - 1 for grid in grids],
            [len(grid.triangle) for grid in grids],
        )
    )
    walls, edges = (plan.capacities.walls,), (3 * triangles[0],)
    return [
        DeviceArray("wall", "i32", triangles),
        DeviceArray("normal", "position", triangles, 3),
        *(DeviceArray(name, "position", edges, 3) for name in ("vertex", "edge_direction", "inward", "inward_other")),
        DeviceArray("length", "position", edges),
        *(DeviceArray(name, "i32", edges) for name in ("point", "base", "owns_tie", "role")),
        DeviceArray("owner", "i32", points),
        DeviceArray("longest", "position", points),
        DeviceArray("vertex_edge_start", "i32", (points[0] + 1,)),
        DeviceArray("vertex_edge", "position", vertex_edges, 3),
        DeviceArray("competitor_start", "i32", (2 * triangles[0] + 1,)),
        DeviceArray("competitor", "i32", competitors),
        DeviceArray("low", "position", walls, 3),
        DeviceArray("side", "position", walls),
        DeviceArray("shape", "i32", walls, 3),
        DeviceArray("first_cell", "i32", walls),
        DeviceArray("cell_start", "i32", (cells[0] + 1,)),
        DeviceArray("cell_triangles", "i32", cell_triangles),
    ]
