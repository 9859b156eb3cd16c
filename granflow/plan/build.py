"""Scene -> Plan: `plan_for` makes all decisions for a scene, and refuses scenes that cannot be simulated.

The decisions follow each other: walls and impact velocity, contact laws of the pairs, time step, skin, and
what depends on these. Each has its own module; this one contains their order, the choices of a few lines
(skin, chunk size), and the checks that need several decisions.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import ceil

import numpy as np

from granflow.contact.law import NormalLaw
from granflow.errors import SceneError, UnstableTimeStepError
from granflow.load import Scene, refuse_other_object
from granflow.particles.group import groups_of
from granflow.plan.features import features_of
from granflow.plan.forecast import forecasts_of, size_problems
from granflow.plan.joined_walls import joints_of
from granflow.plan.limits import (
    refuse_coarse,
    refuse_coarse_liquid,
    refuse_coarse_properties,
    refuse_cut_walls,
    refuse_fast_images,
    refuse_fast_motion,
    refuse_fast_rotation,
    refuse_fast_start,
    refuse_fast_walls,
    refuse_infinite_rotations,
    refuse_narrow_box,
    resolution_warning,
    share_of,
    slow_motion_warning,
)
from granflow.plan.pair_case import PairCase
from granflow.plan.pairs import (
    adhesion_velocity,
    build_laws,
    pair_cases_of,
    pair_materials,
    pair_table,
    with_resistance,
)
from granflow.plan.particle_equations import refuse_long_step
from granflow.plan.plan import Plan
from granflow.plan.size_classes import size_classes
from granflow.plan.stages import refuse_unresolved_drag
from granflow.plan.time_step import (
    AdaptiveTimeStep,
    TimeStep,
    UnstableStep,
    adaptive_time_step_for,
    choose_time_step,
    max_impact_velocity,
)
from granflow.plan.wall_control import controlled_motions_of, refuse_open_samples
from granflow.plan.walls import PlannedWall, meshes_of, planned_walls, wall_speeds
from granflow.scene.blocks.run import Numerics
from granflow.scene.blocks.walls.wall import WallNote


def plan_for(scene: Scene, on_gpu: bool = False) -> Plan:
    """Compute the plan of a scene; `on_gpu`: each particle is a chunk, because a thread processes one
    particle.

    Raises SceneError if a contact model is not valid for a pair, if the given time step is not stable, if
    velocities are too high for the time step, if the precision is too coarse for the domain, or if a periodic
    box is too narrow.

    >>> gf.plan_for(gf.load_scene("two.yaml")).step.value > 0
    True
    """
    refuse_other_object(scene)
    try:
        plan = _plan_without_forecasts(scene, on_gpu)
    except SceneError as error:  # errors of time step and velocities can result from a wrong unit of a length
        sizes = [*size_problems(scene)]
        if not sizes:
            raise
        raise SceneError([*sizes, *error.problems]) from None
    return replace(plan, forecasts=tuple(forecasts_of(plan)))


def _plan_without_forecasts(scene: Scene, on_gpu: bool) -> Plan:
    """The plan of a scene, without forecasts. Raises the errors of `plan_for`."""
    # What is there: walls, particles, and how fast they meet.
    materials = _used_materials(scene)
    walls = planned_walls(scene, {name: number for number, name in enumerate(materials)})
    refuse_infinite_rotations(scene, walls)
    refuse_open_samples(scene, walls)
    impact_velocity = max_impact_velocity(scene, walls)
    velocity = impact_velocity.value
    groups = tuple(groups_of(scene).values())
    particle_count = sum(group.sphere_count for group in scene.particles.values())
    radius_min = 0.5 * min(group.diameters[0] for group in scene.particles.values())
    radius_max = 0.5 * max(group.diameters[1] for group in scene.particles.values())

    # Contact laws of all pairs, from which the switches of the kernels follow.
    models = scene.active_models
    pairs = pair_materials(scene, models)
    laws = build_laws(scene, groups, models, pairs, velocity)
    law = laws.normal
    periodic_box = scene.domain.periodic_box()
    joints = joints_of(walls, radius_max, periodic_box.axes)
    mesh_walls = [walls[index].name for index in meshes_of(walls)]
    features, reasons = features_of(scene, models, laws, any(joints), mesh_walls)
    pair_constants = pair_table(scene, laws, pairs, materials)
    refuse_coarse(scene, radius_min)
    refuse_coarse_liquid(scene, features.liquid_transfer)
    refuse_coarse_properties(scene)

    # The time step of the stiffest possible contact, and what moves in one step.
    pair_cases = with_resistance(laws, pair_cases_of(scene, groups, pairs))
    adhesion = adhesion_velocity(laws, pair_cases)
    step = _time_step(scene, pair_cases, law, velocity + adhesion, 2.0 * radius_max)
    refuse_fast_motion(scene, walls, step.value)
    speeds = wall_speeds(scene, walls)
    speed = max(speeds.values(), default=0.0)
    skin = _skin(scene, radius_min, velocity, step.value)
    _refuse_geometry(scene, walls, radius_max, skin + laws.range)
    has_chunks = law.branch_free and not on_gpu

    plan = Plan(
        scene=scene,
        periodic_box=periodic_box,
        features=features,
        reasons=reasons,
        groups=groups,
        particle_capacity=particle_count,
        radius_min=radius_min,
        radius_max=radius_max,
        size_classes=size_classes(scene.particles),
        chunk_size=_chunk_size(scene.numerics, particle_count) if has_chunks else 1,
        skin=skin,
        materials=materials,
        laws=laws,
        pair_materials={both: pair for both, pair in pairs.items() if set(both) <= set(materials)},
        pair_constants=pair_constants,
        pair_cases=pair_cases,
        step=step,
        adaptive_time_step=_adaptive_time_step(scene, pair_cases, law, velocity, max(speed, adhesion)),
        impact_velocity=impact_velocity,
        walls=walls,
        wall_joints=joints,
        wall_speed=speed,
        controlled_motions=controlled_motions_of(scene, walls, law, pair_cases, velocity, step.value),
        wall_notes=_wall_notes(scene, walls, 2.0 * radius_min),
    )
    refuse_long_step(plan)
    _refuse_fast(plan, speeds)
    _refuse_collision_energies(plan)
    return plan


def _used_materials(scene: Scene) -> tuple[str, ...]:
    """Names of the materials of particles, then those of walls, each once."""
    parts = [*scene.particles.values(), *scene.walls.values()]
    return tuple(dict.fromkeys(part.material for part in parts))


def _wall_notes(scene: Scene, walls: Sequence[PlannedWall], smallest: float) -> tuple[WallNote, ...]:
    """Notes on all walls; `smallest`: diameter [m] of the smallest particle."""
    return tuple(
        note for wall in walls for note in wall.spec.notes(wall.name, wall.surface, scene.domain, smallest)
    )


# The time step.


def _time_step(
    scene: Scene, pair_cases: Sequence[PairCase], law: NormalLaw, velocity: float, diameter: float
) -> TimeStep:
    """Time step of the scene with its warnings. Raises UnstableTimeStepError if the given one is not stable.

    `velocity` [m/s]: maximum expected impact velocity; `diameter` [m]: of the largest particle.
    """
    given = None if isinstance(scene.run.time_step, str) else float(scene.run.time_step)
    fractions = (scene.numerics.time_step_fraction, scene.numerics.rayleigh_fraction)
    try:
        step = choose_time_step(given, pair_cases, law, velocity, *fractions)
    except UnstableStep as error:
        where = scene.locate("run", "time_step")
        raise UnstableTimeStepError(where, f"run.time_step {error.reason}", error.remedy) from None
    precision = scene.run.precision
    farthest = float(np.abs([scene.domain.min, scene.domain.max]).max())
    reach = farthest if precision == "f32" else diameter
    warnings = (
        *step.warnings,
        *resolution_warning(pair_cases, velocity, precision, reach),
        *slow_motion_warning(precision, farthest, step.value, velocity),
    )
    return replace(step, warnings=warnings)


def _adaptive_time_step(
    scene: Scene, pair_cases: Sequence[PairCase], law: NormalLaw, velocity: float, speed: float
) -> AdaptiveTimeStep | None:
    """Table of the adaptive time step; None for a fixed one.

    `velocity`: maximum impact velocity; `speed`: the larger one of walls and of cohesion [m/s].
    """
    if scene.run.time_step != "adaptive":
        return None
    fractions = (scene.numerics.time_step_fraction, scene.numerics.rayleigh_fraction)
    speed = max(speed, scene.image_speed)
    return adaptive_time_step_for(pair_cases, law, velocity, speed, *fractions)


# The skin of the neighbor lists, and the chunks of particles that threads process.

SKIN_STEPS = 60
"""Minimum number of steps in which a particle at the maximum velocity crosses half the skin."""
LARGEST_SKIN = 20.0
"""Maximum `numerics.skin` over the smallest radius: 2^3 * 11^3 neighbors."""
SKIN_SHARES = (0.05, 0.3)
"""Range of the automatic skin over the smallest radius."""


def _skin(scene: Scene, radius_min: float, velocity: float, step: float) -> float:
    """Skin [m]: given, or twice the distance of SKIN_STEPS steps at the maximum velocity, limited by
    SKIN_SHARES.

    `radius_min` [m], `velocity` [m/s], `step` [s]. A thicker skin means fewer rebuilds, but more candidate
    pairs. Raises SceneError if the given skin exceeds LARGEST_SKIN times the smallest radius.
    """
    if scene.numerics.skin == "auto":
        smallest, largest = SKIN_SHARES
        wanted = 2.0 * SKIN_STEPS * velocity * step
        return float(np.clip(wanted, smallest * radius_min, largest * radius_min))
    skin = float(scene.numerics.skin)
    if skin > LARGEST_SKIN * radius_min:
        raise SceneError(
            f"{scene.locate('numerics', 'skin')}: numerics.skin is {skin:.3g} m, more than {LARGEST_SKIN:g} "
            f"times the smallest radius {radius_min:.3g} m: a neighbor list would have thousands of entries. "
            "Set it to auto."
        )
    return skin


SMALL_SCENE_PARTICLES = 64
"""Number of particles up to which each is a separate chunk: the longer run time is less than the saved
compile time."""
CHUNKS_PER_WORKER = 4
"""Least number of chunks for each of several workers, so that those who are ready take chunks of the others.
All have the same number of equal chunks."""
CHUNK_BOUNDS = (512, 4096)
"""Particles per chunk of several workers: pairs across chunks are computed twice, in settled beds 22 % of all
pairs in chunks of 512, 14 to 17 % of 1024, 8 to 13 % of 2048, 5 to 11 % of 4096; and a worker waits until
others have completed their chunks."""
LARGEST_CHUNK_ALONE = 16_384
"""Particles per chunk of a single worker, which does not wait; more gain nothing."""


def with_workers(plan: Plan, workers: int) -> Plan:
    """The plan for a number of CPU threads, which determines the chunks unless the scene gives their size."""
    if plan.chunk_size == 1:
        return plan
    return replace(plan, chunk_size=_chunk_size(plan.scene.numerics, plan.particle_capacity, workers))


def _chunk_size(numerics: Numerics, particle_count: int, workers: int = 1) -> int:
    """Particles per chunk."""
    if numerics.chunk_size != "auto":
        return int(numerics.chunk_size)
    if particle_count <= SMALL_SCENE_PARTICLES:
        return 1
    smallest, largest = CHUNK_BOUNDS
    if workers == 1:
        return min(max(particle_count, smallest), LARGEST_CHUNK_ALONE)
    each = max(ceil(particle_count / (largest * workers)), CHUNKS_PER_WORKER)
    return max(ceil(particle_count / (each * workers)), smallest)


# Checks that need several decisions.


def _refuse_geometry(scene: Scene, walls: tuple[PlannedWall, ...], radius_max: float, reach: float) -> None:
    """Raise SceneError for a periodic box or walls that do not fit neighbor lists of this reach beyond
    contact [m]."""
    is_sheared = scene.domain.lees_edwards is not None
    refuse_narrow_box(scene, radius_max, 2.0 * reach if is_sheared else reach)
    refuse_cut_walls(scene, walls, radius_max + reach)


def _refuse_fast(plan: Plan, wall_speeds: Mapping[str, float]) -> None:
    """Raise SceneError for velocities [m/s] at which contacts can be missed from the start, and for a fast
    decay."""
    scene = plan.scene
    step = plan.longest_time_step
    refuse_unresolved_drag(scene, step)
    refuse_fast_start(scene, plan.time_step, plan.radius_min)
    refuse_fast_rotation(scene, plan.time_step)

    def share_of_radius(limit: float) -> tuple[float, str]:
        return limit, share_of(limit, plan.radius_min)

    def share_of_skin(limit: float) -> tuple[float, str]:
        return limit, f"{limit / plan.skin:.2g} of the skin {plan.skin:.3g} m"

    limit, share = min(share_of_radius(plan.wall_travel_limit), share_of_skin(plan.wall_displacement_limit))
    refuse_fast_walls(scene, wall_speeds, step, limit, share)
    limit, share = min(share_of_radius(plan.travel_limit), share_of_skin(plan.skin))
    refuse_fast_images(scene, step, limit, share)


def _refuse_collision_energies(plan: Plan) -> None:
    """Raise SceneError for collision energies of contacts without a history, whose begin is not known."""
    scene = plan.scene
    if plan.features.collision_energies and not plan.history:
        raise SceneError(
            f"{scene.locate('output', 'collision_energies')}: output.collision_energies needs a contact "
            f"model with a history, and contact.normal {scene.contact.name('normal')} without friction has "
            "none. Give a pair a friction above 0, set contact.normal to zhou, or remove the block."
        )


# The plan of one of several MPI ranks.

BALANCE = 1.2
"""Particles of a rank over the mean for which its arrays are allocated; they grow if one rank has more."""
GHOST_LAYERS = 1.5
"""Thickness of the layer of ghosts in diameters."""


def rank_plan(plan: Plan, ranks: int, workers: int = 1) -> Plan:
    """The plan of each of `ranks` ranks with `workers` threads: capacity for its share of the particles and
    for the ghosts of a cube of them.

    n + [(n^(1/3) + 2 layers)^3 - n]        n = 1.2 N / ranks
    """
    share = min(BALANCE * plan.particle_capacity / ranks, plan.particle_capacity)
    ghosts = (share ** (1 / 3) + 2.0 * GHOST_LAYERS) ** 3 - share if ranks > 1 else 0.0
    of_rank = with_workers(replace(plan, particle_capacity=ceil(share), has_ghosts=True), workers)
    needed = ceil(share + min(ghosts, plan.particle_capacity - share)) + of_rank.chunk_size
    return replace(of_rank, particle_capacity=needed)
