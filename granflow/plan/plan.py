"""Scene -> Plan: all decisions before any array is allocated."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from granflow.contact.cohesion.cohesion import COHESIONS
from granflow.contact.material import (
    PairMaterial,
    Solid,
    VelocityRestitution,
    limit_velocity,
    modulus_eff,
    shear_modulus_eff,
    yield_strength,
)
from granflow.contact.model import ModelRequest, NormalLaw
from granflow.errors import SceneError
from granflow.geometry.mesh.grid import MeshGrid, grid_over
from granflow.geometry.mesh.mesh import Mesh
from granflow.geometry.periodic_box import PeriodicBox
from granflow.load import Scene
from granflow.plan.adaptive_time_step import AdaptiveTimeStep, adaptive_time_step_for
from granflow.plan.capacities import EXTRA_PER_PARTICLE, SHARE_AT_MESHES, near_triangles, neighbors_per_particle
from granflow.plan.domain import refuse_cut_walls, refuse_infinite_rotations, refuse_narrow_box
from granflow.plan.features import Features, Reason, cohesion_of, features_of, reasons_for
from granflow.plan.max_impact_velocity import image_speed, initial_rotation_rates, initial_speeds, max_impact_velocity
from granflow.plan.meshes import MeshNote, notes_on
from granflow.plan.motion_period import refuse_fast_motion
from granflow.plan.outlets import PlannedOutlet, planned_outlets
from granflow.plan.resolution import coordinate_limit, refuse_coarse
from granflow.plan.size_classes import diameter_range, size_classes
from granflow.plan.time_step import PairCase, TimeStep, choose_time_step, resolution_warning
from granflow.plan.travel import (
    STEP_SHARE,
    refuse_fast_images,
    refuse_fast_rotation,
    refuse_fast_start,
    refuse_fast_walls,
)
from granflow.plan.wall_control import ControlledMotion, controlled_motions_of
from granflow.plan.walls import PlannedWall, planned_walls, wall_speeds
from granflow.scene.schema.scene import Group, RestitutionFit

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
    law: NormalLaw
    materials: tuple[str, ...]
    """Names of the materials in plan order, those of particles first."""
    pair_constants: np.ndarray
    """(materials^2, constants): constants of the contact model, friction, rolling friction."""
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
    def friction_index(self) -> int:
        """Index of the friction coefficient in the pair constants."""
        return len(self.law.constant_names)

    @property
    def rolling_index(self) -> int:
        """Index of the rolling friction coefficient in the pair constants."""
        return self.friction_index + 1

    @property
    def has_walls(self) -> bool:
        """True if the scene has walls."""
        return self.features.walls

    @property
    def history(self) -> dict[str, int]:
        """Contact history: name of the field -> number of components.

        "normal": fields of the contact model; "tangential": tangential displacement [m]; "rolling": rolling
        displacement or torque. Fields without components are absent; an empty dictionary means that no history is
        stored.
        """
        sizes = {"normal": self.law.history_count, "tangential": 3 * self.features.friction}
        saved_models = ("epsd", "cdt") if self.features.energy_budget else ("epsd",)
        sizes["rolling"] = 3 * (self.features.rolling in saved_models)
        return {name: size for name, size in sizes.items() if size}

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
    law = build_law(scene, velocity)
    features = features_of(scene, law.rate_dependent)
    table = _pair_table(scene, law, materials)
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
        law=law,
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


def build_law(scene: Scene, velocity: float) -> NormalLaw:
    """The normal contact model of the scene, extended by its cohesion model if any pair has cohesion.

    `velocity` [m/s]: maximum expected impact velocity, for which the model may compute its constants.
    """
    normal = scene.contact.normal
    pairs = tuple(pair_material(scene, *key.split("-")) for key in scene.pairs)
    law = normal.kind.build(ModelRequest(normal.settings(), pairs, velocity, scene.numerics.unloading_angle))
    cohesion = cohesion_of(scene)
    return law if cohesion == "none" else COHESIONS[cohesion](law)


def solid(scene: Scene, material: str) -> Solid:
    """Constants of one material of the scene.

    Young's modulus and yield strength [Pa], density [kg/m3], Poisson ratio. Raises KeyError for an unknown material.
    """
    given = scene.materials[material]
    return Solid(given.young_modulus, given.poisson_ratio, given.density, given.yield_strength)


def pair_material(scene: Scene, first: str, second: str) -> PairMaterial:
    """Mixed constants of two materials, symmetric under their exchange.

    The restitution is a number, a fit e(v) (Zhou 2011, Eq. 12) with its limit velocity (Eq. 11 unless given), or None.
    Raises KeyError if the scene has no such pair.
    """
    pair, a, b = scene.pair(first, second), solid(scene, first), solid(scene, second)
    given = pair.restitution
    restitution: float | VelocityRestitution | None
    if isinstance(given, RestitutionFit):
        restitution = VelocityRestitution(given.sigma, given.psi, given.limit_velocity or limit_velocity(a, b))
    else:
        restitution = given
    rolling = pair.rolling_friction or 0.0
    cohesion = pair.cohesion_energy_density or 0.0
    return PairMaterial(
        modulus_eff(a, b), shear_modulus_eff(a, b), restitution, pair.friction, rolling, yield_strength(a, b), cohesion
    )


def _used_materials(scene: Scene) -> Iterator[str]:
    yield from (group.material for group in scene.particles.values())
    yield from (wall.material for wall in scene.walls.values())


def _pair_table(scene: Scene, law: NormalLaw, materials: tuple[str, ...]) -> np.ndarray:
    """Constants of each pair of materials (materials^2, constants + 2); NaN for pairs without contacts.

    Row i * materials + j. The last two columns are friction and rolling friction. Raises SceneError if the contact
    model cannot reach the restitution of a pair.
    """
    count = len(materials)
    table = np.full((count * count, len(law.constant_names) + 2), np.nan)
    for i, first in enumerate(materials):
        for j, second in enumerate(materials):
            if scene.pair_key(first, second) in scene.pairs:
                pair = pair_material(scene, first, second)
                table[i * count + j] = (
                    *_law_constants(scene, law, first, second),
                    pair.friction,
                    pair.rolling_friction,
                )
    return table


def _law_constants(scene: Scene, law: NormalLaw, first: str, second: str) -> tuple[float, ...]:
    """Constants of the contact model for a pair. Raises SceneError if it cannot reach the restitution."""
    try:
        return law.pair_constants(pair_material(scene, first, second))
    except ValueError as error:
        key = scene.pair_key(first, second)
        location = scene.locate("pairs", key, "restitution")
        raise SceneError(f"{location}: pairs.{key}.restitution cannot be obtained: {error}.") from None


def pair_cases_of(scene: Scene) -> list[PairCase]:
    """The possible contacts between two groups and between a group and a wall, each for the smallest particles.

    A group of one particle does not collide with itself: that contact limits the time step, but has no `pair_key`. If
    no contact is possible, the contact of the first group with itself limits the time step. Fixed particles collide
    neither with each other nor with walls; for other particles they are walls with the radius of the largest of them.
    """
    pair_cases = []
    groups = list(scene.particles.items())
    walls = dict.fromkeys(wall.material for wall in scene.walls.values())
    for n, (name, group) in enumerate(groups):
        for other_name, other in groups[n:]:
            if not (group.fixed and other.fixed) and scene.pair_key(group.material, other.material) in scene.pairs:
                pair = pair_material(scene, group.material, other.material)
                mobile, partner = (other, group) if group.fixed else (group, other)
                occurs = name != other_name or group.count > 1
                key = scene.pair_key(group.material, other.material) if occurs else None
                pair_cases.append(
                    replace(_pair_case(scene, f"{name}-{other_name}", pair, mobile, partner), pair_key=key)
                )
        for wall in walls if not group.fixed else ():
            pair, key = pair_material(scene, group.material, wall), scene.pair_key(group.material, wall)
            pair_cases.append(replace(_pair_case(scene, f"{name}-{wall} wall", pair, group, None), pair_key=key))
    if not pair_cases:
        name, group = groups[0]
        material_solid = solid(scene, group.material)
        elastic_pair = PairMaterial(
            modulus_eff(material_solid, material_solid), shear_modulus_eff(material_solid, material_solid), 1.0, 0.0
        )
        pair_cases.append(_pair_case(scene, f"{name}-{name}", elastic_pair, group, group))
    contacts = max(sum(group.count for _, group in groups) + len(scene.walls) - 1, 1)
    return [replace(pair_case, contact_count=contacts) for pair_case in pair_cases]


def _pair_case(scene: Scene, name: str, pair: PairMaterial, group: Group, other: Group | None) -> PairCase:
    """Contact of the smallest particle of a group with the smallest of another, the largest fixed, or a wall (None)."""
    radius, material_solid = 0.5 * diameter_range(group)[0], solid(scene, group.material)
    mass = _sphere_mass(radius, material_solid.density)
    if other is None:
        return PairCase(name, pair, radius, mass, radius, material_solid)
    if other.fixed:
        other_radius = 0.5 * diameter_range(other)[1]
        return PairCase(name, pair, radius * other_radius / (radius + other_radius), mass, radius, material_solid)
    other_radius = 0.5 * diameter_range(other)[0]
    other_mass = _sphere_mass(other_radius, solid(scene, other.material).density)
    radius_eff = radius * other_radius / (radius + other_radius)
    return PairCase(name, pair, radius_eff, mass * other_mass / (mass + other_mass), radius, material_solid)


def _sphere_mass(radius: float, density: float) -> float:
    """Mass 4/3 pi R^3 rho [kg] of a sphere with radius [m] and density [kg/m3]."""
    return 4.0 / 3.0 * np.pi * radius**3 * density


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
