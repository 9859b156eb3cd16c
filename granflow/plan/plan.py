"""Scene -> Plan: all decisions before any array is allocated."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from granflow.contact.law import NormalLaw
from granflow.contact.laws import ContactLaws
from granflow.errors import SceneError
from granflow.geometry.mesh.grid import MeshGrid, grid_over
from granflow.geometry.mesh.mesh import Mesh
from granflow.geometry.periodic_box import PeriodicBox
from granflow.plan.adaptive_time_step import AdaptiveTimeStep, adaptive_time_step_for
from granflow.plan.capacities import EXTRA_PER_PARTICLE, SHARE_AT_MESHES, near_triangles, neighbors_per_particle
from granflow.plan.domain import refuse_cut_walls, refuse_infinite_rotations, refuse_narrow_box
from granflow.plan.features import Features, Reason, features_of, reasons_for
from granflow.plan.max_impact_velocity import image_speed, initial_rotation_rates, initial_speeds, max_impact_velocity
from granflow.plan.meshes import MeshNote, notes_on
from granflow.plan.motion_period import refuse_fast_motion
from granflow.plan.outlets import PlannedOutlet, planned_outlets
from granflow.plan.pair_cases import active_models, build_laws, pair_cases_of, pair_table
from granflow.plan.resolution import coordinate_limit, refuse_coarse
from granflow.plan.size_classes import diameter_range, size_classes
from granflow.plan.time_step import TimeStep, choose_time_step, resolution_warning
from granflow.plan.travel import (
    STEP_SHARE,
    refuse_fast_images,
    refuse_fast_rotation,
    refuse_fast_start,
    refuse_fast_walls,
)
from granflow.plan.wall_control import ControlledMotion, controlled_motions_of
from granflow.plan.walls import PlannedWall, planned_walls, wall_speeds
from granflow.scene.schema.scene import Scene

SMALL_SCENE_PARTICLES = 64
"""Number of particles up to which each is a separate chunk: the longer run time is less than the saved compile time."""

CHUNK_COUNT = 32
"""Number of chunks to distribute over the threads, if their size is within CHUNK_BOUNDS."""

CHUNK_BOUNDS = (512, 2048)
"""Particles per chunk: smaller chunks have more pairs across chunks, computed twice; larger ones exceed the cache."""

CELLS_PER_PARTICLE = 3
"""Maximum number of cells per particle; a sparser domain gets larger cells."""

MIN_CELLS = 8192
"""Smallest capacity of the cell grid."""


BLOCK_CELLS = 8**3
"""Number of cells in a block, which is the smallest grid."""

SKIN_STEPS = 60
"""Minimum number of steps in which a particle at the maximum velocity crosses half the skin."""

LARGEST_SKIN = 20.0
"""Maximum `numerics.skin` over the smallest radius: 2^3 * 11^3 neighbors."""

SKIN_SHARES = (0.05, 0.3)
"""Range of the automatic skin over the smallest radius."""


@dataclass(frozen=True, eq=False)
class Plan:
    """All decisions for one scene, in SI units; the functions that compute them document the reasons.

    Lengths [m]: `radius_min`, `radius_max`, `skin`. Velocities [m/s]: `velocity_max`, the maximum expected impact
    velocity, and `wall_speed`, of prescribed motions. `chunk_size`: particles per unit of work of a thread.
    """

    scene: Scene
    features: Features
    reasons: tuple[Reason, ...]
    laws: ContactLaws
    materials: tuple[str, ...]
    """Names of the materials in plan order, those of particles first."""
    pair_constants: np.ndarray
    """(materials^2, constants): constants of the contact laws, in the order of `laws.constant_names`."""
    particle_capacity: int
    radius_min: float
    radius_max: float
    chunk_size: int
    skin: float
    step: TimeStep
    velocity_max: float
    walls: tuple[PlannedWall, ...]
    wall_speed: float
    controlled_motions: tuple[ControlledMotion, ...]
    """Motions of walls that respond to the forces of the particles."""
    adaptive_time_step: AdaptiveTimeStep | None
    """Time steps by impact velocity if the time step is adaptive."""

    @property
    def time_step(self) -> float:
        """Time step dt [s]; an adaptive time step starts with it."""
        return self.step.value

    @property
    def longest_time_step(self) -> float:
        """Longest possible time step [s]: that of an adaptive time step when only walls move."""
        return self.time_step if self.adaptive_time_step is None else self.adaptive_time_step.longest

    @property
    def material_count(self) -> int:
        """Number of materials of particles and walls."""
        return len(self.materials)

    @property
    def law(self) -> NormalLaw:
        """The normal contact law."""
        return self.laws.normal

    @property
    def has_walls(self) -> bool:
        """True if the scene has walls."""
        return self.features.walls

    @property
    def history(self) -> dict[str, int]:
        """Contact history: slot of the contact model -> number of components; slots without history are absent."""
        return {slot: law.history_count for slot, law in self.laws.by_slot.items() if law.history_count}

    @property
    def chunk_capacity(self) -> int:
        """Number of chunks for all particles, at least 1."""
        return max(-(-self.particle_capacity // self.chunk_size), 1)

    @property
    def list_capacity_per_chunk(self) -> int:
        """Initial number of neighbor-list entries per chunk; lists that are too short grow during the run."""
        neighbors = neighbors_per_particle(self.particle_capacity, self.skin / self.radius_min)
        at_meshes = max((near_triangles(mesh.typical_edge, self.skin) for mesh in self.meshes.values()), default=0.0)
        if self.chunk_size == 1:
            return int(2.0 * neighbors + at_meshes) + EXTRA_PER_PARTICLE
        neighbors += SHARE_AT_MESHES * at_meshes
        return int(neighbors * min(self.chunk_size, self.particle_capacity)) + 16

    @property
    def cell_capacity(self) -> int:
        """Maximum number of cells of the cell grid: CELLS_PER_PARTICLE per particle, at least MIN_CELLS."""
        return max(CELLS_PER_PARTICLE * self.particle_capacity, MIN_CELLS)

    @cached_property
    def size_classes(self) -> tuple[float, ...]:
        """Largest radius [m] of each size class, in ascending order."""
        return size_classes(self.scene)

    @property
    def class_cell_capacity(self) -> int:
        """Maximum number of cells in the grids of all size classes; 0 for a single class in a box without shear."""
        classes, needed = len(self.size_classes), self.features.lees_edwards or len(self.size_classes) > 1
        return 2 * self.cell_capacity + classes * BLOCK_CELLS if needed else 0

    @property
    def has_poses(self) -> bool:
        """True if walls or periodic images change their position from step to step."""
        return self.features.moving_walls or self.features.lees_edwards

    @property
    def image_speed(self) -> float:
        """Speed [m/s] of the images across a sheared boundary; 0 without shear."""
        return 0.0 if self.periodic_box.image_motion is None else abs(self.periodic_box.image_motion.speed)

    @property
    def wall_displacement_limit(self) -> float:
        """Limit of the wall displacement [m] between rebuilds: half the skin, divided between two kinds of motion."""
        return (0.25 if self.controlled_motions and self.wall_speed > 0.0 else 0.5) * self.skin

    @property
    def travel_limit(self) -> float:
        """Maximum displacement [m] of a particle in one step."""
        return STEP_SHARE * self.radius_min

    @property
    def wall_travel_limit(self) -> float:
        """Maximum displacement [m] of a wall in one step: that of particles, divided between two kinds of motion."""
        return (0.5 if self.controlled_motions and self.wall_speed > 0.0 else 1.0) * self.travel_limit

    @property
    def coordinate_limit(self) -> float:
        """Coordinate [m] above which the resolution of positions is too coarse for the smallest particle."""
        return coordinate_limit(self.scene.run.precision, self.radius_min)

    @property
    def gravity(self) -> tuple[float, float, float]:
        """Gravity [m/s2]."""
        return self.scene.gravity

    @property
    def max_overlap(self) -> float:
        """Overlap over radius above which the run aborts."""
        return self.scene.numerics.max_overlap

    @cached_property
    def meshes(self) -> dict[int, Mesh]:
        """The mesh walls by wall index."""
        return {index: wall.shape for index, wall in enumerate(self.walls) if isinstance(wall.shape, Mesh)}

    @cached_property
    def mesh_grids(self) -> dict[int, MeshGrid]:
        """The cell grid of each mesh wall by wall index, with the triangles within the largest radius plus skin."""
        reach = self.radius_max + self.skin
        return {index: grid_over(mesh.adjacency.vertex, reach) for index, mesh in self.meshes.items()}

    def first_triangle(self, index: int) -> int:
        """Index of the first triangle of a mesh wall, numbered over all meshes."""
        return sum(mesh.triangle_count for before, mesh in self.meshes.items() if before < index)

    @cached_property
    def mesh_notes(self) -> tuple[MeshNote, ...]:
        """Notes for the user on the mesh walls."""
        named = {self.walls[index].name: mesh for index, mesh in self.meshes.items()}
        return tuple(n for name, mesh in named.items() for n in notes_on(self.scene, name, mesh, 2.0 * self.radius_min))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences to show before a run: changes to the scene, time step and precision, mesh walls."""
        meshes = tuple(f"walls.{n.wall}: {n.sentence}." for n in self.mesh_notes if n.warning)
        return self.scene.remarks + self.step.warnings + meshes

    @cached_property
    def periodic_box(self) -> PeriodicBox:
        """Periodic faces of the domain."""
        return self.scene.domain.periodic_box()

    @cached_property
    def outlets(self) -> tuple[PlannedOutlet, ...]:
        """The outlets in numeric form."""
        return planned_outlets(self.scene)

    @cached_property
    def domain_low(self) -> np.ndarray:
        """Smallest coordinates of the domain (3,) [m]."""
        return np.array(self.scene.domain.min)

    @cached_property
    def domain_high(self) -> np.ndarray:
        """Largest coordinates of the domain (3,) [m]."""
        return np.array(self.scene.domain.max)


def plan_for(scene: Scene, on_gpu: bool = False) -> Plan:
    """Compute the plan of a scene.

    `on_gpu`: each particle is a chunk, because a thread processes one particle.

    Raises SceneError if a contact model is not valid for a pair, if the given time step is not stable, if velocities
    are too high for the time step, if the precision is too coarse for the domain, or if a periodic box is too narrow.
    """
    materials = tuple(dict.fromkeys(_used_materials(scene)))
    numbers = {name: number for number, name in enumerate(materials)}
    walls = planned_walls(scene, numbers)
    velocity = max_impact_velocity(scene).value
    laws = build_laws(scene, velocity)
    law = laws.normal
    features = features_of(scene, active_models(scene), law.rate_dependent)
    table = pair_table(scene, laws, materials)
    radii = [0.5 * d for group in scene.particles.values() for d in diameter_range(group)]
    radius_min, radius_max = min(radii), max(radii)
    refuse_coarse(scene, radius_min)
    step = _time_step(scene, law, velocity, 2.0 * radius_max)
    refuse_fast_motion(scene, step.value)
    speeds = wall_speeds(scene, walls)
    speed = max(speeds.values(), default=0.0)
    skin = _skin(scene, radius_min, velocity, step.value)
    refuse_narrow_box(scene, radius_max, 2.0 * skin if features.lees_edwards else skin)
    refuse_cut_walls(scene, walls, radius_max + skin)
    refuse_infinite_rotations(scene, walls)
    particle_count = sum(group.count for group in scene.particles.values())
    plan = Plan(
        scene=scene,
        features=features,
        reasons=reasons_for(scene, features),
        laws=laws,
        materials=materials,
        pair_constants=table,
        particle_capacity=particle_count,
        radius_min=radius_min,
        radius_max=radius_max,
        chunk_size=_chunk_size(scene, particle_count) if law.branch_free and not on_gpu else 1,
        skin=skin,
        step=step,
        velocity_max=velocity,
        walls=walls,
        wall_speed=speed,
        controlled_motions=controlled_motions_of(scene, walls, law, pair_cases_of(scene), velocity, step.value),
        adaptive_time_step=_adaptive_time_step(scene, law, velocity, max(speed, image_speed(scene)))
        if features.adaptive_step
        else None,
    )
    _refuse_fast(plan, speeds)
    return plan


def _refuse_fast(plan: Plan, wall_speeds: Mapping[str, float]) -> None:
    """Raise SceneError for velocities [m/s] at which contacts can be missed from the start."""
    refuse_fast_start(plan.scene, initial_speeds(plan.scene), plan.time_step, plan.radius_min)
    refuse_fast_rotation(plan.scene, initial_rotation_rates(plan.scene), plan.time_step)
    limit = min(plan.wall_travel_limit, plan.wall_displacement_limit)
    refuse_fast_walls(plan.scene, wall_speeds, plan.longest_time_step, limit)
    refuse_fast_images(plan.scene, plan.image_speed, plan.longest_time_step, min(plan.travel_limit, plan.skin))


def _used_materials(scene: Scene) -> Iterator[str]:
    yield from (group.material for group in scene.particles.values())
    yield from (wall.material for wall in scene.walls.values())


def _time_step(scene: Scene, law: NormalLaw, velocity: float, diameter: float) -> TimeStep:
    """Time step of the scene with its warnings. Raises SceneError if the given one is not stable.

    `velocity` [m/s]: maximum expected impact velocity; `diameter` [m]: of the largest particle.
    """
    given = None if isinstance(scene.run.time_step, str) else float(scene.run.time_step)
    numerics = scene.numerics
    pair_cases = pair_cases_of(scene)
    try:
        step = choose_time_step(
            given, pair_cases, law, velocity,
            numerics.time_step_fraction, numerics.rayleigh_fraction,
        )  # fmt: skip
    except ValueError as error:
        raise SceneError(f"{scene.locate('run', 'time_step')}: run.time_step {error}") from None
    precision = scene.run.precision
    farthest = float(np.abs([scene.domain.min, scene.domain.max]).max())
    reach = farthest if precision == "f32" else diameter
    return replace(step, warnings=step.warnings + resolution_warning(pair_cases, velocity, precision, reach))


def _adaptive_time_step(scene: Scene, law: NormalLaw, velocity: float, speed: float) -> AdaptiveTimeStep:
    """Table of the adaptive time step; `velocity`: maximum impact velocity, `speed`: of walls and images [m/s]."""
    numerics = scene.numerics
    bounds = (numerics.time_step_fraction, numerics.rayleigh_fraction)
    return adaptive_time_step_for(pair_cases_of(scene), law, velocity, speed, *bounds)


def _chunk_size(scene: Scene, particle_count: int) -> int:
    """Particles per chunk, a power of two. It depends on the scene only, because sums are computed chunk by chunk."""
    if scene.numerics.chunk_size != "auto":
        return int(scene.numerics.chunk_size)
    if particle_count <= SMALL_SCENE_PARTICLES:
        return 1
    min_size, max_size = CHUNK_BOUNDS
    return int(np.clip(2 ** int(np.ceil(np.log2(particle_count / CHUNK_COUNT))), min_size, max_size))


def _given_skin(scene: Scene, skin: float, radius_min: float) -> float:
    """The skin [m] of the scene. Raises SceneError if it exceeds LARGEST_SKIN times the smallest radius [m]."""
    if skin > LARGEST_SKIN * radius_min:
        raise SceneError(
            f"{scene.locate('numerics', 'skin')}: numerics.skin is {skin:.3g} m, more than {LARGEST_SKIN:g} times the "
            f"smallest radius {radius_min:.3g} m: a neighbor list would have thousands of entries. Set it to auto."
        )
    return skin


def _skin(scene: Scene, radius_min: float, velocity: float, step: float) -> float:
    """Skin [m]: given, or twice the distance of SKIN_STEPS steps at the maximum velocity, limited by SKIN_SHARES.

    `radius_min` [m], `velocity` [m/s], `step` [s]. A thicker skin means fewer rebuilds, but more candidate pairs.
    """
    if scene.numerics.skin != "auto":
        return _given_skin(scene, float(scene.numerics.skin), radius_min)
    min_size, max_size = (neighbors * radius_min for neighbors in SKIN_SHARES)
    return float(np.clip(2.0 * SKIN_STEPS * velocity * step, min_size, max_size))
