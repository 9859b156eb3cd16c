"""Arrays."""

from collections.abc import Hashable, Iterable, Iterator
from dataclasses import astuple, dataclass, replace
from math import prod
from typing import Literal

import numpy as np

from granflow.fields import PARTICLE_QUANTITIES, DeviceType
from granflow.geometry.catalog import surface_code
from granflow.plan.capacities import (
    BOUNDS,
    MIN_TRIANGLES,
    SCAN_BLOCK,
    SUBPARTS,
    WALL_BATCH,
    Capacities,
    rounded_capacity,
)
from granflow.plan.outlets import PlannedOutlet
from granflow.plan.plan import Plan
from granflow.plan.sum_units import CARRY_BITS, ENERGY, IMPULSE_SIZE, LOSSES, TORQUE
from granflow.plan.wall_control import ControlledMotion

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
    by_chunk:      the first axis is that of the chunks, or of rows that they share; checkpoints contain the
                   sum over it
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
        is_long = {
            "position": precision != "f32",
            "real": precision == "f64",
            "f64": True,
            "i32": False,
            "i64": True,
        }
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
    """Ranges and entries of the neighbor lists; names of contact histories begin with `history.` and
    `saved.`."""
    count = (capacities.particles,)
    entries = (capacities.list_entries,)
    saved_entries = (capacities.saved_entries,)
    has_history = bool(plan.history)
    return [
        *(
            DeviceArray(name, "i32", count, per_particle=True)
            for name in ("list_begin", "list_walls_end", "list_end")
        ),
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
    count = (plan.capacities.particles,)
    classes = (plan.capacities.size_classes,)
    cells = plan.capacities.cells
    class_cells = plan.capacities.class_cells
    largest = max(cells, class_cells)
    by_class = bool(class_cells)
    subparts = (BOUNDS * SUBPARTS,)
    one_particle_chunks = plan.chunk_size == 1
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

    Terms of the energy budget, wall forces, work at periodic boundaries and of external forces, numbers of
    collisions. Each term has two components, see `engine.exact_sums`.
    """
    chunks = plan.capacities.chunks
    measured = plan.capacities.measured_walls
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
    """Triangles, edges (three per triangle), points and cell grids of all meshes; see
    `engine.mesh_fields`."""
    adjacencies = [mesh.adjacency for mesh in plan.meshes.values()]
    grids = plan.mesh_grids.values()
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
    walls = (plan.capacities.walls,)
    edges = (3 * triangles[0],)
    return [
        DeviceArray("wall", "i32", triangles),
        DeviceArray("normal", "position", triangles, 3),
        *(
            DeviceArray(name, "position", edges, 3)
            for name in ("vertex", "edge_direction", "inward", "inward_other")
        ),
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


# Parameters.


@dataclass(frozen=True)
class Parameter:
    """A number or a vector, rounded to `dtype` when it is written to the device."""

    name: str
    dtype: DeviceType
    values: tuple[float, ...]


def parameters_of(plan: Plan, capacities: Capacities) -> Iterator[Parameter]:
    """All parameters of a plan and of its arrays; equal features give the same names and lengths. Units as in
    the plan.

    Squared limits have the precision of velocities, also those compared with positions.
    """
    yield from (_scalar(name, "i32", value) for name, value in _counts(plan, capacities).items())
    yield from (_scalar(name, "real", value) for name, value in _limits(plan).items())
    yield from (_scalar(name, "position", value) for name, value in _lengths(plan).items())
    yield from _of_sums(plan)
    if plan.features.liquid_transfer:
        yield _scalar("liquid_unit", "f64", plan.liquid_unit)
    yield _vector("gravity", "f64", plan.gravity)
    yield _vector("box_width", "position", plan.periodic_box.width)
    yield _vector("domain_low", "position", plan.domain_low)
    yield _vector("domain_high", "position", plan.domain_high)
    for index, outlet in enumerate(plan.outlets):
        yield from _of_outlet(f"outlet.{index}", outlet)
    for index, motion in enumerate(plan.controlled_motions):
        yield from _of_motion(f"motion.{index}", motion)


def _scalar(name: str, dtype: DeviceType, value: float) -> Parameter:
    return Parameter(name, dtype, (value,))


def _vector(name: str, dtype: DeviceType, values: np.ndarray | tuple[float, ...]) -> Parameter:
    return Parameter(name, dtype, tuple(float(value) for value in values))


def _counts(plan: Plan, capacities: Capacities) -> dict[str, int]:
    return {
        "chunk_size": plan.chunk_size,
        "wall_count": len(plan.walls),
        "material_count": plan.material_count,
        "class_count": len(plan.size_classes),
        "list_capacity": capacities.list_entries_per_segment,
        "saved_capacity": capacities.saved_entries_per_segment,
        "cell_capacity": plan.cell_capacity,
    }


def _limits(plan: Plan) -> dict[str, float]:
    """Limits [m], a squared limit [m2] of displacements, the relative overlap limit and the longest time step
    [s]."""
    return {
        "travel_limit_squared": plan.travel_limit**2,
        "max_overlap": plan.max_overlap,
        "longest_time_step": plan.longest_time_step,
        "wall_displacement_limit": plan.wall_displacement_limit,
        "wall_travel_limit": plan.wall_travel_limit,
    }


def _lengths(plan: Plan) -> dict[str, float]:
    """Lengths [m] of the neighbor search, and the largest coordinate."""
    return {
        "reach_max": plan.reach_max,
        "force_range": plan.laws.range,
        "coordinate_limit": plan.coordinate_limit,
    }


def _of_sums(plan: Plan) -> Iterator[Parameter]:
    """Reciprocal units in the order of `sum_units`, and the numbers that round forces and torques to their
    units.

    For energies, the reciprocal unit of the high word.

    A number is rounded to multiples of a unit by adding 3/2 unit / eps, see
    `engine.exact_sums.build_to_grid`.
    """
    units = np.array(astuple(plan.sum_units))
    eps = np.finfo(np.float64 if plan.precision == "f64" else np.float32).eps
    per_unit = 1.0 / units
    per_unit[ENERGY] /= 2.0**CARRY_BITS
    yield _vector("per_unit", "real", per_unit)
    yield _vector("shift", "real", 1.5 * units[: TORQUE + 1] / eps)


def _of_outlet(prefix: str, outlet: PlannedOutlet) -> Iterator[Parameter]:
    """Corners of a box; plane and, for a disc, radius of any other outlet."""
    if outlet.low is not None and outlet.high is not None:
        yield _vector(f"{prefix}.low", "position", outlet.low)
        yield _vector(f"{prefix}.high", "position", outlet.high)
        return
    yield _vector(f"{prefix}.point", "position", outlet.point)
    yield _vector(f"{prefix}.normal", "position", outlet.normal)
    if outlet.kind == "disc":
        yield _scalar(f"{prefix}.radius", "position", outlet.radius)


def _of_motion(prefix: str, motion: ControlledMotion) -> Iterator[Parameter]:
    """Wall, direction and constants of a force-controlled motion."""
    yield _scalar(f"{prefix}.wall", "i32", motion.wall)
    yield _vector(f"{prefix}.direction", "f64", motion.direction)
    for name in ("force", "gain", "lag", "velocity_max", "mass", "damping"):
        yield _scalar(f"{prefix}.{name}", "real", getattr(motion, name))


# Structure.


def structure_of(plan: Plan) -> Hashable:
    """Features, contact laws, kinds of walls, outlets and motions, arrays, and their lengths but the neighbor
    lists'.

    Contact laws count without their numbers, see `contact.law.Law.structure`; external forces with their
    functions and names of parameters.
    """
    return (
        plan.precision,
        plan.features,
        plan.laws.structure,
        plan.external_forces,
        plan.periodic_box.axes,
        _shear_axes(plan),
        plan.domain.on_exit == "expand",
        plan.chunk_size == 1,
        plan.has_ghosts,
        frozenset(surface_code(wall.shape) for wall in plan.walls),
        tuple(outlet.kind for outlet in plan.outlets),
        tuple(motion.kind for motion in plan.controlled_motions),
        tuple((array.name, array.dtype, array.width) for array in particle_arrays(plan) if array.wanted),
        _without_lists(plan.capacities),
        tuple(array.shape for array in mesh_arrays(plan)) if plan.meshes else (),
    )


def fits_lists(available: Capacities, needed: Capacities) -> bool:
    """True if arrays of equal structure hold the neighbor lists; lists that have grown hold more than
    needed."""
    lengths = [(each.list_entries, each.saved_entries, each.batch) for each in (available, needed)]
    return all(length >= least for length, least in zip(*lengths, strict=True))


def _without_lists(capacities: Capacities) -> Capacities:
    return replace(capacities, segments=1, list_entries=0, batch=0, history_share=0.0)


def _shear_axes(plan: Plan) -> tuple[int, ...]:
    motion = plan.periodic_box.image_motion
    return () if motion is None else (motion.flow, motion.gradient)
