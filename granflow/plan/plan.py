"""The plan of a run: all decisions before any array is allocated, and the numbers that follow from them.

`Plan` is what `plan_for` returns and what the simulation is built from. Two of its records are defined
here: the forces that a program adds, and the forecasts that `granflow explain` and the checks before a run
show.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np

from granflow.contact.law import FlowCase, Source
from granflow.contact.material import PairMaterial
from granflow.contact.particle_equation import ParticleEquation
from granflow.contact.registry import ContactLaws
from granflow.geometry.mesh import Mesh, MeshGrid, grid_over
from granflow.geometry.periodic_box import PeriodicBox
from granflow.geometry.sphere import sphere_mass
from granflow.geometry.surface import AnalyticSurface, surface_kinds
from granflow.load import Scene
from granflow.particles.group import SceneGroup
from granflow.plan.capacities import (
    MIN_BATCH,
    MIN_CELLS,
    MIN_CHUNK_PARTICLES,
    MIN_CHUNKS,
    MIN_LIST_ENTRIES,
    MIN_PAIRS,
    MIN_PARTICLES,
    MIN_SIZE_CLASSES,
    MIN_WALLS,
    SHARE_AT_MESHES,
    SHARED_ROWS,
    Capacities,
    history_share,
    near_triangles,
    neighbors_per_particle,
    rounded_capacity,
)
from granflow.plan.features import Features, Reason
from granflow.plan.limits import coordinate_limit, narrowest_box
from granflow.plan.pair_case import PairCase
from granflow.plan.sum_units import (
    LOSS_HEAT_UNITS,
    SumUnits,
    flow_units,
    integral_unit,
    liquid_unit,
    sum_units,
)
from granflow.plan.time_step import (
    STEP_SHARE,
    AdaptiveTimeStep,
    ImpactVelocity,
    TimeStep,
)
from granflow.plan.wall_control import ControlledMotion
from granflow.plan.walls import PlannedWall, meshes_of
from granflow.scene.blocks.deformation import Deformation
from granflow.scene.blocks.run import Stage
from granflow.scene.blocks.walls.wall import WallNote
from granflow.scene.blocks.wear import WallWear

# Forces on particles that a program adds with device functions.

ParameterValue = float | tuple[float, float, float]
"""Value of a parameter of a force: a number or a vector."""


@dataclass(frozen=True)
class ExternalForce:
    """One force: its name, device function, and the number of components of each parameter, 1 or 3, by name.

    `values`: present values of the parameters, which may change while the simulation runs; the compiled
    kernels depend on all other attributes.
    """

    name: str
    function: Callable[..., Any]
    layout: tuple[tuple[str, int], ...]
    values: Mapping[str, ParameterValue] = field(compare=False)

    @property
    def numbers(self) -> list[float]:
        """All values one after the other."""
        found: list[float] = []
        for name, _ in self.layout:
            value = self.values[name]
            found += value if isinstance(value, tuple) else (value,)
        return found


def parameter_count(forces: Sequence[ExternalForce]) -> int:
    """Number of values of all parameters."""
    return sum(width for force in forces for _, width in force.layout)


# One forecast of a plan.

Cause = Literal["impact", "weight", "wall", "box", "cohesion"]
"""Causes of overlaps: an impact, the weight of the bed, a wall or a box that presses on the bed, an
attraction."""


@dataclass(frozen=True)
class Forecast:
    """One forecast for `granflow explain`: name, value and remark; `warning`: sentence for check and run, or
    None.

    cause, overlap:  of a forecast overlap: its cause, and the overlap over the smaller radius; None and 0 for
                     others
    force:           largest contact force [N] of a static pressure, for the pair with the largest overlap
    of_files:        the warning concerns written files only
    """

    name: str
    value: str
    remark: str
    warning: str | None = None
    cause: Cause | None = None
    overlap: float = 0.0
    force: float = 0.0
    of_files: bool = False


# The plan.

CELLS_PER_PARTICLE = 3
"""Maximum number of cells per particle; a sparser domain gets larger cells."""
BLOCK_CELLS = 8**3
"""Number of cells in a block, which is the smallest grid."""


@dataclass(frozen=True, eq=False)
class Plan:
    """All decisions for one scene, in SI units, and the numbers that follow from them.

    The fields are the decisions; `build.plan_for` computes them, and its functions document the reasons. The
    properties are numbers that follow from the fields: limits of displacements, capacities of the arrays,
    grids of mesh walls. A plan does not change: a wall that a program moves, a force that it adds, or a rank
    of several, gives another plan by `dataclasses.replace`.

    >>> gf.plan_for(gf.load_scene("two.yaml")).scene.title
    'Two steel spheres'
    """

    scene: Scene
    """The scene, whose numbers are not repeated here."""
    periodic_box: PeriodicBox

    # What is compiled.
    features: Features
    reasons: tuple[Reason, ...]

    # Particles.
    groups: tuple[SceneGroup, ...]
    particle_capacity: int
    radius_min: float
    """Smallest radius [m]."""
    radius_max: float
    """Largest radius [m]."""
    size_classes: tuple[float, ...]
    """Largest radius [m] of each size class, in ascending order."""
    chunk_size: int
    """Particles per unit of work of a thread."""
    skin: float
    """Distance [m] beyond contact up to which neighbor lists contain pairs."""

    # Materials and contacts.
    materials: tuple[str, ...]
    """Names of the materials in plan order, those of particles first."""
    laws: ContactLaws
    pair_materials: Mapping[tuple[str, str], PairMaterial]
    """Constants of each two materials that can come into contact, by their names in either order."""
    pair_constants: np.ndarray
    """(materials^2, constants): constants of the contact laws, in the order of `laws.constant_names`."""
    pair_cases: tuple[PairCase, ...]
    """The possible contacts."""

    # Time step.
    step: TimeStep
    adaptive_time_step: AdaptiveTimeStep | None
    """Time steps by impact velocity if the time step is adaptive."""
    impact_velocity: ImpactVelocity

    # Walls.
    walls: tuple[PlannedWall, ...]
    wall_joints: tuple[int, ...]
    """For each wall, whether it touches others or itself; see `joined_walls.joints_of`."""
    wall_speed: float
    """Largest speed [m/s] of the prescribed motions."""
    controlled_motions: tuple[ControlledMotion, ...]
    """Motions of walls that respond to the forces of the particles."""
    wall_notes: tuple[WallNote, ...]

    # What is known after the other decisions, or from a program.
    forecasts: tuple[Forecast, ...] = ()
    """Overlaps to expect, and probable mistakes that end a run or make it pointless."""
    external_forces: tuple[ExternalForce, ...] = ()
    """Forces that a program has added; none follow from the scene."""
    saved_sum_units: SumUnits | None = None
    """Units of the sums of the run that a checkpoint continues, in which it has saved them; None for a new
    run."""
    has_ghosts: bool = False
    """Whether neighbor lists contain ghosts: those of one of several MPI ranks, see `build.rank_plan`."""

    @cached_property
    def stages(self) -> tuple[Stage, ...]:
        """`scene.schedule`, made once: the time loop reads it at each launch."""
        return self.scene.schedule

    @property
    def time_step(self) -> float:
        """Time step dt [s]; an adaptive time step starts with it."""
        return self.step.value

    @property
    def longest_time_step(self) -> float:
        """Longest possible time step [s]: that of an adaptive time step when only walls move."""
        return self.time_step if self.adaptive_time_step is None else self.adaptive_time_step.longest

    @property
    def law_parameters(self) -> tuple[float, ...]:
        """Parameters of the contact laws, in the order of `laws.parameters`."""
        return tuple(value for own in self.laws.parameters.values() for value in own.values())

    @property
    def history(self) -> dict[str, int]:
        """Contact history: slot of the contact model -> number of components; slots without history are
        absent."""
        return {slot: law.history_count for slot, law in self.laws.by_slot.items() if law.history_count}

    def pair(self, first: str, second: str) -> PairMaterial:
        """Constants of two materials in any order. Raises KeyError if they cannot come into contact."""
        return self.pair_materials[first, second]

    @property
    def equal_spheres(self) -> tuple[float, float]:
        """Radius [m] and mass [kg] of all particles with the feature `one_size`, as of their arrays."""
        mass = sphere_mass(np.array([self.radius_max]), np.array([self.groups[0].density]))
        return self.radius_max, float(mass[0])

    @property
    def largest_weight(self) -> float:
        """Weight [N] of the heaviest sphere."""
        gravity = self.scene.largest_gravity
        return max(
            gravity * sphere_mass(0.5 * group.spec.diameters[1], group.density) for group in self.groups
        )

    @property
    def collision_edges(self) -> np.ndarray:
        """Edges (n + 1,) [J] of the n classes of collision energies, equally spaced on a logarithmic
        scale."""
        given = self.scene.output.collision_energies
        if given is None:
            return np.empty(0)
        edges = np.geomspace(given.min, given.max, given.classes + 1)
        return np.array([float(f"{edge:.12g}") for edge in edges])

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences to show before a run: changes to the scene, time step and precision, mesh walls,
        forecasts."""
        meshes = tuple(f"walls.{note.wall}: {note.sentence}." for note in self.wall_notes if note.warning)
        forecasts = tuple(each.warning for each in self.forecasts if each.warning is not None)
        return self.scene.remarks + self.step.warnings + meshes + forecasts

    # Walls, periodic images, and the domain.

    @property
    def has_poses(self) -> bool:
        """True if walls, periodic images or gravity change from step to step."""
        features = self.features
        return features.moving_walls or features.lees_edwards or features.changing_gravity

    @property
    def measured_areas(self) -> dict[str, float | None]:
        """Area [m2] of each wall with measured forces, by name; None for an infinite area."""
        return {wall.name: wall.area for wall in self.walls if wall.name in self.scene.measured_walls}

    @cached_property
    def meshes(self) -> dict[int, Mesh]:
        """The mesh walls by wall index."""
        return meshes_of(self.walls)

    @cached_property
    def surface_kinds(self) -> tuple[type[AnalyticSurface], ...]:
        """The kinds of analytic surfaces of the walls; kernels select one by its index."""
        return surface_kinds([wall.surface for wall in self.walls])

    @cached_property
    def mesh_grids(self) -> dict[int, MeshGrid]:
        """The cell grid of each mesh wall by wall index, with the triangles that a particle can reach."""
        reach = self.radius_max + self.reach_max + self.wall_displacement_limit + self.laws.range
        return {index: grid_over(mesh.adjacency.vertex, reach) for index, mesh in self.meshes.items()}

    def first_triangle(self, index: int) -> int:
        """Index of the first triangle of a mesh wall, numbered over all meshes."""
        return sum(mesh.triangle_count for before, mesh in self.meshes.items() if before < index)

    @cached_property
    def domain_low(self) -> np.ndarray:
        """Smallest coordinates of the domain (3,) [m]."""
        return np.array(self.scene.domain.min)

    @cached_property
    def domain_high(self) -> np.ndarray:
        """Largest coordinates of the domain (3,) [m]."""
        return np.array(self.scene.domain.max)

    # Wear of walls.

    @property
    def wear_laws(self) -> tuple[type[WallWear], ...]:
        """The kinds of wear of the walls, each once; kernels select one by its index."""
        return tuple(dict.fromkeys(type(wall.spec.wear) for wall in self.walls if wall.spec.wear is not None))

    @cached_property
    def wear_rows(self) -> dict[int, tuple[int, int]]:
        """First row of the sums of wear, and number of rows, of each worn wall by wall index: one for each
        triangle of a mesh, one for another wall."""
        found = {}
        first = 0
        for index, wall in enumerate(self.walls):
            if wall.spec.wear is not None:
                count = self.meshes[index].triangle_count if index in self.meshes else 1
                found[index] = first, count
                first += count
        return found

    @cached_property
    def wear_areas(self) -> dict[str, np.ndarray | None]:
        """Areas [m2] of the rows of each worn wall by name; None for an infinite area."""
        found: dict[str, np.ndarray | None] = {}
        for index in self.wear_rows:
            wall = self.walls[index]
            area = wall.area
            whole = None if area is None else np.array([area])
            found[wall.name] = self.meshes[index].areas if index in self.meshes else whole
        return found

    @property
    def attached_walls(self) -> list[int]:
        """Number of the wall with which the particles of each group move; -1 for none."""
        numbers = {wall.name: number for number, wall in enumerate(self.walls)}
        return [numbers.get(group.spec.attached_to or "", -1) for group in self.groups]

    @property
    def largest_volume_per_work(self) -> float:
        """Largest k / H [1/Pa] of all walls and materials of particles; 0 without wear."""
        worn = [wall.spec.wear for wall in self.walls if wall.spec.wear is not None]
        materials = dict.fromkeys(group.material for group in self.scene.particles.values())
        return max((wear.volume_per_work(each) for wear in worn for each in materials), default=0.0)

    # Limits of displacements and coordinates.

    @property
    def travel_limit(self) -> float:
        """Maximum displacement [m] of a particle in one step."""
        return STEP_SHARE * self.radius_min

    @property
    def wall_travel_limit(self) -> float:
        """Maximum displacement [m] of a wall in one step: that of particles, divided between two kinds of
        motion."""
        return self.travel_limit / self._kinds_of_wall_motion

    @property
    def wall_displacement_limit(self) -> float:
        """Limit of the wall displacement [m] between rebuilds: half the skin, divided between two kinds of
        motion."""
        return 0.5 * self.skin / self._kinds_of_wall_motion

    @property
    def _kinds_of_wall_motion(self) -> int:
        """2 if walls have both prescribed and force-controlled motions, which may add, otherwise 1."""
        return 2 if self.controlled_motions and self.wall_speed > 0.0 else 1

    @cached_property
    def reach_max(self) -> float:
        """Largest displacement [m] of a particle between rebuilds: that of fast particles, at least half the
        skin.

        Half the skin in a periodic box, for whose images the skin is checked. Above half the skin, at most
        half the thickness of an outlet, which a particle must not cross between two rebuilds, and half the
        radius at mesh walls, whose cells would contain too many triangles.
        """
        if self.periodic_box.axes:
            return 0.5 * self.skin
        radius = (0.5 if self.features.mesh_walls else 1.0) * self.radius_min
        outlets = [0.5 * outlet.thickness for outlet in self.scene.outlets.values()]
        return max(0.5 * self.skin, min([radius, *outlets]))

    @property
    def narrowest_box(self) -> float:
        """Smallest width [m] of a periodic box, see `narrowest_box`."""
        return narrowest_box(self.radius_max, self.skin + self.laws.range)

    def gain_of(self, deformation: Deformation) -> float:
        """Strain rate over the deviation from the target pressure [1/(Pa s)].

            g = T / (rho d^2)

        By default, with the shortest loading or unloading time T, and the largest density rho and diameter d.
        The stiffness K of a packing is some 10 rho d^2 / T^2, and a control without delay is stable up to
        about K g dt = 1.
        """
        if deformation.gain is not None:
            return deformation.gain
        densities = [self.scene.materials[each.spec.material].density for each in self.groups]
        return self.step.shortest_phase / (max(densities) * (2.0 * self.radius_max) ** 2)

    @property
    def virial_unit(self) -> float:
        """Unit [J] of the sum of force times distance of the contacts of a deforming box.

        A contact has at most 2^43 of them.
        """
        return 8.0 * self.sum_units.torque

    @property
    def coordinate_limit(self) -> float:
        """Coordinate [m] above which the resolution of positions is too coarse for the smallest particle."""
        return coordinate_limit(self.scene.run.precision, self.radius_min)

    # Capacities of the device arrays at the start, and the units of sums.

    @cached_property
    def capacities(self) -> Capacities:
        """Lengths of the device arrays at the start."""
        chunk_count = self.chunk_capacity
        each_is_a_chunk = self.chunk_size == 1
        segments = 1 if each_is_a_chunk else chunk_count
        list_entries = segments * self.list_capacity_per_segment
        in_chunk = min(self.chunk_size, self.particle_capacity)
        class_cells = self.class_cell_capacity
        measured = len(self.scene.measured_walls)
        worn = sum(count for _, count in self.wear_rows.values())
        return Capacities(
            particles=rounded_capacity(self.particle_capacity, MIN_PARTICLES),
            segments=segments,
            chunks=rounded_capacity(chunk_count, MIN_CHUNKS),
            list_entries=rounded_capacity(list_entries, MIN_LIST_ENTRIES),
            cells=rounded_capacity(self.cell_capacity, MIN_CELLS),
            class_cells=rounded_capacity(class_cells, MIN_CELLS) if class_cells else 0,
            size_classes=rounded_capacity(len(self.size_classes), MIN_SIZE_CLASSES),
            walls=rounded_capacity(len(self.walls), MIN_WALLS),
            measured_walls=rounded_capacity(measured, MIN_WALLS) if measured else 0,
            pairs=rounded_capacity(len(self.pair_constants), MIN_PAIRS),
            batch=MIN_BATCH,
            chunk_particles=rounded_capacity(in_chunk, MIN_CHUNK_PARTICLES),
            wall_rows=SHARED_ROWS if each_is_a_chunk else rounded_capacity(chunk_count, MIN_CHUNKS),
            energy_classes=len(self.collision_edges) + 1 if self.features.collision_energies else 0,
            wear_rows=rounded_capacity(worn, MIN_WALLS) if worn else 0,
            history_share=history_share(self.particle_capacity, segments, list_entries),
        )

    @property
    def chunk_capacity(self) -> int:
        """Number of chunks for all particles, at least 1."""
        return max(-(-self.particle_capacity // self.chunk_size), 1)

    @property
    def list_capacity_per_segment(self) -> int:
        """Initial number of neighbor-list entries per segment; lists that are too short grow during the run.

        If each particle is a chunk, both particles list a pair, and all lists are one segment.
        """
        reach = self.skin + self.laws.range
        neighbors = neighbors_per_particle(self.particle_capacity, reach / self.radius_min)
        at_meshes = max(
            (near_triangles(mesh.typical_edge, reach) for mesh in self.meshes.values()), default=0.0
        )
        if self.chunk_size == 1:
            return int((2.0 * neighbors + SHARE_AT_MESHES * at_meshes) * self.particle_capacity) + 16
        neighbors += SHARE_AT_MESHES * at_meshes
        return int(neighbors * min(self.chunk_size, self.particle_capacity)) + 16

    @property
    def cell_capacity(self) -> int:
        """Maximum number of cells of the cell grid: CELLS_PER_PARTICLE per particle, at least MIN_CELLS."""
        return max(CELLS_PER_PARTICLE * self.particle_capacity, MIN_CELLS)

    @property
    def class_cell_capacity(self) -> int:
        """Maximum number of cells in the grids of all size classes; 0 for a single class without shear or
        ghosts."""
        classes = len(self.size_classes)
        if classes == 1 and not self.features.lees_edwards and not self.has_ghosts:
            return 0
        return 2 * self.cell_capacity + classes * BLOCK_CELLS

    @cached_property
    def sum_units(self) -> SumUnits:
        """Units of the sums over contacts; they do not change when a run continues with another overlap
        limit."""
        if self.saved_sum_units is not None:
            return self.saved_sum_units
        return sum_units(
            self.pair_cases,
            self.laws.normal,
            velocity=self.impact_velocity.value,
            max_overlap=self.scene.numerics.intended_overlap,
            radius=self.radius_max,
            time_step=self.longest_time_step,
            size=2.0 * float(np.abs([self.domain_low, self.domain_high]).max()),
            weight=self.largest_weight,
            volume_per_work=self.largest_volume_per_work,
        )

    @cached_property
    def initial_values(self) -> dict[str, tuple[float, ...]]:
        """Initial value of each group, by the property that a particle equation integrates."""
        return {
            each.name: tuple(getattr(group.spec, each.name) for group in self.groups)
            for each in self.scene.equations
        }

    @cached_property
    def initial_sources(self) -> dict[str, tuple[float, ...]]:
        """Sources of flows in the particles of each group, by name."""
        return {
            each.name: tuple(getattr(group.spec, each.name) or 0.0 for group in self.groups)
            for each in self.sources.values()
        }

    @cached_property
    def value_ranges(self) -> dict[str, tuple[float, float]]:
        """Smallest and largest value of these properties, of groups, stages and walls that have one."""
        found = {}
        for name, values in self.initial_values.items():
            of_walls = (each for each in self.wall_values.get(name, ()) if each is not None)
            given = (*values, *self.scene.values_set(name), *of_walls)
            found[name] = min(given), max(given)
        return found

    @cached_property
    def wall_values(self) -> dict[str, tuple[float | None, ...]]:
        """Value of each wall, None if not given, by the keys that contact models read."""
        return {
            key: tuple(getattr(wall.spec, key) for wall in self.walls) for key in self.laws.wall_properties
        }

    @cached_property
    def held_values(self) -> dict[str, tuple[float | None, ...]]:
        """For each property that a particle equation changes, the value of each group that is attached to a
        wall with one, which it keeps; None for other groups. Without properties that no wall holds."""
        found = {
            equation.name: tuple(
                self.wall_values[equation.name][wall] if wall >= 0 else None for wall in self.attached_walls
            )
            for equation in self.scene.equations
            if equation.name in self.wall_values
        }
        return {name: values for name, values in found.items() if any(each is not None for each in values)}

    @cached_property
    def wall_value_ranges(self) -> dict[str, tuple[float, float]]:
        """Smallest and largest of them; 0 if none is given."""
        given = {key: [each or 0.0 for each in values] or [0.0] for key, values in self.wall_values.items()}
        return {key: (min(values), max(values)) for key, values in given.items()}

    def material_constants(self, equation: ParticleEquation, material: str) -> dict[str, float]:
        """Values of the keys of a material that a particle equation requires; 0 for one of walls only."""
        given = self.scene.materials[material]
        return {key: getattr(given, key) or 0.0 for key in equation.material_keys}

    def law_constants(self, slot: str, material: str) -> dict[str, float]:
        """Values of the keys of a material that the contact model of a slot declares; 0 if not given."""
        given = self.scene.materials[material]
        model = self.scene.active_models[slot]
        return {key: getattr(given, key) or 0.0 for key in model.material_properties.model_fields}

    @cached_property
    def flow_units(self) -> dict[str, float]:
        """Units of the sums that contact models declare, see `sum_units.flow_units`."""
        overlap = self.scene.numerics.intended_overlap * self.radius_max
        materials = {group.material for group in self.scene.particles.values()}
        cases = [
            FlowCase(pair, self.radius_max, overlap, self.value_ranges, self.wall_value_ranges)
            for (first, _), pair in self.pair_materials.items()
            if first in materials
        ]
        sources = {flow: self._largest_source(source.name) for flow, source in self.sources.items()}
        return flow_units(self.laws, cases, sources)

    @cached_property
    def sources(self) -> dict[str, Source]:
        """Sources of the scene by flow."""
        given = self.laws.sources.items()
        return {flow: source for flow, source in given if source.name in self.features.sources}

    def _largest_source(self, name: str) -> float:
        """Largest magnitude of a source in a particle."""
        given = (*self.initial_sources[name], *self.scene.values_set(name))
        return max(map(abs, given), default=0.0)

    @cached_property
    def wall_flows(self) -> tuple[str, ...]:
        """Flows that are summed for each wall, for the surroundings and for sources; empty without any."""
        given = any(each is not None for values in self.wall_values.values() for each in values)
        given = given or self.laws.of_surroundings is not None or bool(self.sources)
        return tuple(self.laws.flows_from_walls) if given else ()

    @cached_property
    def wall_flow_units(self) -> dict[str, float]:
        """Units of their integrals over time, see `sum_units.integral_unit`."""
        return {
            name: integral_unit(self.flow_units[name], self.longest_time_step) for name in self.wall_flows
        }

    @property
    def loss_heat_unit(self) -> float:
        """Unit [J] of the heat that a particle receives from losses in one step."""
        return self.sum_units.energy * LOSS_HEAT_UNITS

    @cached_property
    def liquid_unit(self) -> float:
        """Unit [m3] of liquid volumes, a power of two, see `sum_units.liquid_unit`."""
        return liquid_unit(self.groups)
