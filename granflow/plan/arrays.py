"""What a plan needs on the device: its arrays, the numbers that kernels read, and the structure of both.

Allocation, checkpoints, their validation and the memory estimate use the same lists of arrays: each
function returns the arrays of one group of the state, in the order of allocation. Numbers are parameters in
an array instead of literals in the code, so that plans of equal structure share their machine code.
"""

from collections.abc import Hashable, Iterable, Iterator
from dataclasses import astuple, dataclass, replace
from math import prod

import numpy as np

from granflow.fields import PARTICLE_QUANTITIES, DeviceType
from granflow.plan.capacities import (
    BOUNDS,
    MIN_TRIANGLES,
    POSE_COUNT,
    SCAN_BLOCK,
    SUBPARTS,
    Capacities,
    rounded_capacity,
)
from granflow.plan.plan import Plan
from granflow.plan.sum_units import (
    CARRY_BITS,
    IMPULSE_SIZE,
    LOSSES,
    UNIT_ENERGY,
    UNIT_TORQUE,
    UNIT_WALL_FORCE,
    WEAR_SIZE,
    terms_ahead,
)
from granflow.plan.wall_control import ControlledMotion
from granflow.scene.blocks.run import Precision


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
    histories = plan.history.items()
    has_history = bool(plan.history)
    return [
        DeviceArray("list_begin", "i32", count, per_particle=True),
        DeviceArray("list_walls_end", "i32", count, per_particle=True),
        DeviceArray("list_end", "i32", count, per_particle=True),
        DeviceArray("partner", "i32", entries),
        *(DeviceArray(f"history.{name}", "real", entries, width) for name, width in histories),
        *(DeviceArray(f"saved.{name}", "real", saved_entries, width) for name, width in histories),
        DeviceArray("in_contact", "i32", entries, wanted=has_history),
        DeviceArray("list_begin_before", "i32", count, wanted=has_history, per_particle=True),
        DeviceArray("list_end_before", "i32", count, wanted=has_history, per_particle=True),
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
    return [
        DeviceArray("offset", "f64", (count,), saved=True),
        DeviceArray("offset_at_rebuild", "f64", (count,), saved=True),
        DeviceArray("velocity", "f64", (count,), saved=True),
        DeviceArray("work_on_particles", "f64", (count,), saved=True),
        DeviceArray("work", "f64", (count,), saved=True),
        DeviceArray("was_active", "i32", (count,), saved=True),
        DeviceArray("active", "i32", (POSE_COUNT, count)),
        DeviceArray("wall_force", "i64", (plan.capacities.wall_rows, count), saved=True, by_chunk=True),
    ]


def deformation_arrays(plan: Plan) -> list[DeviceArray]:
    """Periodic box whose widths change; see `DeformationFields`."""
    rows = plan.capacities.wall_rows
    return [
        *(DeviceArray(name, "f64", (3,), saved=True) for name in SAVED_OF_BOX),
        *(DeviceArray(name, "f64", (3,)) for name in ("kick", "target", "rate", "gain")),
        DeviceArray("virial", "i64", (rows, 3), saved=True, by_chunk=True),
        DeviceArray("face_force", "i64", (rows, 3), saved=True, by_chunk=True),
    ]


SAVED_OF_BOX = ("width", "width_at_rebuild", "width_velocity", "stretch", "work")
"""Fields of a deforming box that checkpoints contain, and the sums over the contacts."""
FURTHER_GIVERS = 2
"""Places behind those of the walls in sums of flows: the surroundings, and the sources in the particles."""


def giver_count(plan: Plan) -> int:
    """Places in sums of flows: the walls, FURTHER_GIVERS, and if viscous losses become heat, the walls again
    with those of the next step, which are no present rate of a wall."""
    walls = plan.capacities.walls
    return walls + FURTHER_GIVERS + (walls if plan.features.loss_heat_ahead else 0)


def sum_arrays(plan: Plan) -> list[DeviceArray]:
    """Sums of each chunk, for the energy budget, wall forces and collisions, and the wear of walls.

    Terms of the energy budget, wall forces, work at periodic boundaries, of external forces and of changing
    gravity, numbers of collisions. Each term has two components, see `engine.sums`.
    """
    chunks = plan.capacities.chunks
    measured = plan.capacities.measured_walls
    wall_rows = plan.capacities.wall_rows
    energy_budget = plan.features.energy_budget
    classes = 2 * plan.capacities.energy_classes
    wall_flows = len(plan.wall_flows)
    worn = plan.capacities.wear_rows
    givers = (wall_rows, giver_count(plan))
    has_external_work = energy_budget and plan.features.external_forces
    has_gravity_work = energy_budget and plan.features.changing_gravity
    has_image_work = energy_budget and plan.features.periodic != "none"
    ahead = terms_ahead(plan.features)

    def sums(name: str, shape: tuple[int, ...], terms: int, wanted: bool) -> DeviceArray:
        return DeviceArray(name, "i64", shape, 2 * terms, wanted=wanted, saved=True, by_chunk=True)

    return [
        sums("losses", (chunks,), len(LOSSES), energy_budget),
        sums("impulses", (wall_rows, measured), IMPULSE_SIZE, measured > 0),
        sums("losses_ahead", (chunks,), len(ahead), energy_budget and len(ahead) > 0),
        sums("boundary_work", (chunks,), 1, has_image_work),
        sums("external_work", (chunks,), 1, has_external_work),
        sums("gravity_work", (chunks,), 1, has_gravity_work),
        sums("collisions", (wall_rows, classes), 1, classes > 0),
        sums("wear", (1, worn), WEAR_SIZE, worn > 0),
        sums("wall_flows", givers, wall_flows, wall_flows > 0),
        sums("wall_flows_ahead", givers, wall_flows, wall_flows > 0),
    ]


def mesh_arrays(plan: Plan) -> list[DeviceArray]:
    """Triangles, edges (three per triangle), points and cell grids of all meshes."""
    adjacencies = [mesh.adjacency for mesh in plan.meshes.values()]
    grids = plan.mesh_grids.values()

    def capacity(lengths: Iterable[int]) -> tuple[int]:
        return (rounded_capacity(sum(lengths), MIN_TRIANGLES),)

    triangles = capacity(len(each.normal) for each in adjacencies)
    points = capacity(len(each.owner) for each in adjacencies)
    vertex_edges = capacity(len(each.vertex_edge) for each in adjacencies)
    competitors = capacity(len(each.competitor) for each in adjacencies)
    cells = capacity(len(grid.start) - 1 for grid in grids)
    cell_triangles = capacity(len(grid.triangle) for grid in grids)
    walls = (plan.capacities.walls,)
    edges = (3 * triangles[0],)
    return [
        DeviceArray("wall", "i32", triangles),
        DeviceArray("normal", "position", triangles, 3),
        DeviceArray("vertex", "position", edges, 3),
        DeviceArray("edge_direction", "position", edges, 3),
        DeviceArray("inward", "position", edges, 3),
        DeviceArray("inward_other", "position", edges, 3),
        DeviceArray("length", "position", edges),
        DeviceArray("point", "i32", edges),
        DeviceArray("base", "i32", edges),
        DeviceArray("owns_tie", "i32", edges),
        DeviceArray("role", "i32", edges),
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


# Parameters: numbers of a plan that kernels read at run time.


@dataclass(frozen=True)
class Parameter:
    """A number or a vector, rounded to `dtype` when it is written to the device."""

    name: str
    dtype: DeviceType
    values: tuple[float, ...]


def parameters_of(plan: Plan, capacities: Capacities) -> Iterator[Parameter]:
    """All parameters of a plan and of its arrays; equal features give the same names and lengths. Units as in
    the plan.

    The squared limit of displacements in a step has the precision of velocities, although it is compared with
    positions.
    """
    yield _scalar("chunk_size", "i32", plan.chunk_size)
    yield _scalar("wall_count", "i32", len(plan.walls))
    yield _scalar("material_count", "i32", len(plan.materials))
    yield _scalar("class_count", "i32", len(plan.size_classes))
    yield _scalar("list_capacity", "i32", capacities.list_entries_per_segment)
    yield _scalar("saved_capacity", "i32", capacities.saved_entries_per_segment)
    yield _scalar("cell_capacity", "i32", plan.cell_capacity)
    yield _scalar("travel_limit_squared", "real", plan.travel_limit**2)
    yield _scalar("longest_time_step", "real", plan.longest_time_step)
    if plan.features.one_size:
        yield _vector("equal_spheres", "real", plan.equal_spheres)
    yield _scalar("wall_displacement_limit", "real", plan.wall_displacement_limit)
    yield _scalar("wall_travel_limit", "real", plan.wall_travel_limit)
    yield _scalar("reach_max", "position", plan.reach_max)
    yield _scalar("force_range", "position", plan.laws.range)
    yield _scalar("coordinate_limit", "position", plan.coordinate_limit)
    yield from _of_sums(plan)
    yield from _of_flows(plan)
    if plan.features.wear:
        high_words = 2.0**-CARRY_BITS / np.array([plan.sum_units.wear_volume, plan.sum_units.energy])
        yield _vector("per_unit.wear", "f64", high_words)
    if plan.features.liquid_transfer:
        yield _scalar("liquid_unit", "f64", plan.liquid_unit)
    yield _vector("gravity", "f64", plan.scene.gravity_at_start)
    yield _vector("box_width", "position", plan.periodic_box.width)
    if plan.features.deforming_box:
        yield _scalar("narrowest_box", "f64", plan.narrowest_box)
        yield _scalar("per_unit.virial", "f64", 1.0 / plan.virial_unit)
    yield _vector("domain_low", "position", plan.domain_low)
    yield _vector("domain_high", "position", plan.domain_high)
    for index, outlet in enumerate(plan.scene.outlets.values()):
        for name, value in outlet.numbers().items():
            yield _vector(f"outlet.{index}.{name}", "position", np.atleast_1d(value))
    for index, motion in enumerate(plan.controlled_motions):
        yield from _of_motion(f"motion.{index}", motion)


def _scalar(name: str, dtype: DeviceType, value: float) -> Parameter:
    return Parameter(name, dtype, (value,))


def _vector(name: str, dtype: DeviceType, values: np.ndarray | tuple[float, ...]) -> Parameter:
    return Parameter(name, dtype, tuple(float(value) for value in values))


def _of_sums(plan: Plan) -> Iterator[Parameter]:
    """Two vectors: `per_unit` converts quantities to numbers of units, `shift` rounds forces and torques.

    per_unit:  reciprocal units in the order of `sum_units.UNIT_FORCE` and so on; for energies, the reciprocal
               unit of the high word, 2^CARRY_BITS units, see `engine.sums.energy_words`
    shift:     3/2 unit / eps of forces and torques, see `engine.sums.build_to_grid`
    """
    units = np.array(astuple(plan.sum_units)[: UNIT_WALL_FORCE + 1])
    eps = np.finfo(np.float64 if plan.scene.run.precision == "f64" else np.float32).eps
    per_unit = 1.0 / units
    per_unit[UNIT_ENERGY] /= 2.0**CARRY_BITS
    yield _vector("per_unit", "real", per_unit)
    yield _vector("shift", "real", 1.5 * units[: UNIT_TORQUE + 1] / eps)


def _of_flows(plan: Plan) -> Iterator[Parameter]:
    """Reciprocal unit and `shift` of each flow, reciprocal unit of its integral at walls; constants of the
    materials of particle equations."""
    for name, unit in plan.flow_units.items():
        yield _scalar(f"per_unit.{name}", "f64", 1.0 / unit)
        yield _scalar(f"shift.{name}", "f64", 1.5 * unit * 2.0**52)
    if plan.laws.of_surroundings is not None:
        slot, law = plan.laws.of_surroundings
        by_material = [plan.law_constants(slot, material) for material in plan.materials]
        for key in by_material[0]:
            yield _vector(f"{slot}.{key}", "f64", tuple(each[key] for each in by_material))
        for key, value in law.parameters.items():
            yield _scalar(f"{slot}.{key}", "f64", value)
    if plan.features.loss_heat:
        yield _scalar("loss_heat_unit", "f64", plan.loss_heat_unit)
    for name, unit in plan.wall_flow_units.items():
        yield _scalar(f"per_unit.wall.{name}", "f64", 1.0 / unit)
    for equation in plan.scene.equations:
        constants = [plan.material_constants(equation, material) for material in plan.materials]
        for key in equation.material_keys:
            yield _vector(f"{equation.name}.{key}", "f64", tuple(each[key] for each in constants))


def _of_motion(prefix: str, motion: ControlledMotion) -> Iterator[Parameter]:
    """Wall, direction and numbers of a force-controlled motion."""
    yield _scalar(f"{prefix}.wall", "i32", motion.wall)
    yield _vector(f"{prefix}.direction", "f64", motion.direction)
    for name, value in motion.numbers.items():
        yield _scalar(f"{prefix}.{name}", "real", value)
    for pair, strains in enumerate(motion.section.strains if motion.section else ()):
        for r, strain in strains.items():
            yield _scalar(f"{prefix}.strain.{pair}.{r}", "f64", strain)


# Structure: what the machine code of a plan depends on. Plans of equal structure differ in parameters only.


def structure_of(plan: Plan) -> Hashable:
    """Features, contact laws, kinds of walls, outlets and motions, arrays, and their lengths but the neighbor
    lists'.

    Contact laws count without their numbers, see `contact.law.Law.structure`; external forces with their
    functions and names of parameters.
    """
    return (
        plan.scene.run.precision,
        plan.features,
        plan.laws.structure,
        plan.scene.equations,
        plan.wall_flows,
        (plan.wear_laws, len(plan.materials)) if plan.wear_laws else (),
        len(plan.groups) if plan.features.wall_groups else 0,
        plan.external_forces,
        plan.periodic_box.axes,
        _shear_axes(plan),
        plan.scene.domain.on_exit == "expand",
        plan.chunk_size == 1,
        plan.has_ghosts,
        plan.surface_kinds,
        bool(plan.meshes),
        tuple(outlet.kind for outlet in plan.scene.outlets.values()),
        tuple(
            (motion.spec.kind, motion.section and tuple(tuple(each) for each in motion.section.strains))
            for motion in plan.controlled_motions
        ),
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
