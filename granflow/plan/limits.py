"""Limits that a scene must respect so that no contact is missed; each check raises SceneError beyond one of
them.

A periodic box must be wider than the neighbor lists reach, positions must be resolved at the end of the
domain, the time step must resolve the motions of walls, and nothing may cross a large part of a radius in
one step.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from granflow.contact import theory
from granflow.errors import SceneError
from granflow.geometry.periodic_box import AXES, PeriodicBox
from granflow.load import Scene
from granflow.plan.pair_case import PairCase
from granflow.plan.stages import always, nominal_times, spread_times
from granflow.plan.time_step import STEP_SHARE
from granflow.plan.walls import PlannedWall
from granflow.scene.blocks.motions import poses_at, rotations_of
from granflow.visible_text import alternatives

# The domain: width of periodic boxes, walls that cross periodic boundaries, and domains that expand.

SAMPLES = 101
"""Points along each side of a face at which walls are compared with those at the opposite face."""
DISTANCE_TOLERANCE = 1e-3
"""Tolerance for the difference of wall distances between opposite faces, relative to the reach."""


def narrowest_box(radius_max: float, skin: float) -> float:
    """Smallest width [m] along a periodic axis, for lengths in m.

    With less, a particle can be a candidate partner of two images of another.
    """
    return 4.0 * radius_max + 2.0 * skin


def refuse_narrow_box(scene: Scene, radius_max: float, skin: float) -> None:
    """Raise SceneError if the width along a periodic axis is below that of `narrowest_box`.

    Under Lees-Edwards shear, give twice the skin.
    """
    periodic_box = scene.domain.periodic_box()
    needed = narrowest_box(radius_max, skin)
    remark = "" if periodic_box.image_motion is None else ", which is double under shear"
    for axis in periodic_box.axes:
        if periodic_box.width[axis] < needed:
            raise SceneError(
                f"{scene.locate('domain', 'periodic')}: domain.periodic has {AXES[axis]}, along which the "
                f"domain is {periodic_box.width[axis]:.4g} m wide, but a particle could be in contact with "
                f"two images of another one. Make it at least {needed:.4g} m wide, which is two of the "
                f"largest diameters and twice the skin{remark}."
            )


MOST_PROBES = 50
"""Largest number of displacements of a wall at which it is compared."""
TURNS, TURN_SAMPLES = 40, 33
"""Number of poses of a wall that rotates, and of points along each side of the faces then."""


def refuse_cut_walls(scene: Scene, walls: Sequence[PlannedWall], reach: float) -> None:
    """Raise SceneError for a wall within `reach` [m] of a periodic boundary that does not continue across it.

    The distance from the wall is compared at SAMPLES x SAMPLES points of opposite faces, with the wall at
    rest, and with the wall displaced by each half of the width of the box along its translations; at fewer
    points in poses of a wall that rotates. `reach`: largest radius plus skin.
    """
    periodic_box = scene.domain.periodic_box()
    for axis in periodic_box.axes:
        face = _face(periodic_box, axis)
        along = periodic_box.width[axis] * np.eye(3)[axis]
        for wall in walls:
            if _is_cut(wall, face, along, reach):
                raise SceneError(
                    f"{scene.locate('walls', wall.name)}: walls.{wall.name} differs between the two ends of "
                    f"the periodic axis {AXES[axis]}: walls have no periodic images. Continue it by "
                    f"{reach:.4g} m beyond both ends with the shape of its image, or keep this distance from "
                    "both."
                )
            if any(_is_cut(wall, face - each, along, reach) for each in _slides(scene, wall, axis)):
                raise SceneError(
                    f"{scene.locate('walls', wall.name, 'motion')}: walls.{wall.name} ends, and moves along "
                    f"the periodic axis {AXES[axis]}: it would leave one end of the box without a wall. Use "
                    "a plane, which is infinite (shape: plane), or extend the wall beyond the box by its way."
                )
            turned = _turned_faces(scene, wall, axis, reach)
            if any(_is_cut(wall, *each, reach) for each in turned):
                raise SceneError(
                    f"{scene.locate('walls', wall.name, 'motion')}: walls.{wall.name} rotates through the "
                    f"ends of the periodic axis {AXES[axis]}, where it has no periodic image. Keep it "
                    f"{reach:.4g} m from both ends as it turns, or make the domain not periodic along "
                    f"{AXES[axis]}."
                )


def _is_cut(wall: PlannedWall, face: np.ndarray, along: np.ndarray, reach: float) -> bool:
    """Whether the wall at rest differs between points (n, 3) [m] and those at a distance `along` (3,) [m]."""
    distance_low = wall.surface.distances(face, reach)
    distance_high = wall.surface.distances(face + along, reach)
    is_near = np.minimum(np.abs(distance_low), np.abs(distance_high)) < reach
    return bool(np.any(is_near & ~(np.abs(distance_low - distance_high) <= DISTANCE_TOLERANCE * reach)))


def _slides(scene: Scene, wall: PlannedWall, axis: int) -> Iterator[np.ndarray]:
    """Displacements (3,) [m] of a bounded wall by each of its translations along a periodic axis, at each
    half of the width of the box; none of a wall that also rotates."""
    if not wall.spec.is_bounded or rotations_of(wall.motions):
        return
    half = 0.5 * float(scene.domain.periodic_box().width[axis])
    times = np.linspace(0.0, scene.longest_duration, SAMPLES)
    for motion in wall.motions:
        displacement, _ = motion.at(nominal_times(scene.schedule)).displacement_and_rate(times)
        farthest = displacement[np.argmax(np.abs(displacement[:, axis]))]
        way = abs(float(farthest[axis]))
        for k in range(1, min(int(way / half), MOST_PROBES) + 1):
            yield farthest * (k * half / way)
        if way > 0.0:
            yield farthest


def _turned_faces(
    scene: Scene, wall: PlannedWall, axis: int, reach: float
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Points (n, 3) [m] of the low face along a periodic axis, and the vector (3,) [m] to the opposite face,
    in the frame of a wall that rotates, at TURNS times of the run; those at which the wall is near a face."""
    motions = [each.at(nominal_times(scene.schedule)) for each in wall.motions]
    if not rotations_of(motions):
        return
    periodic_box = scene.domain.periodic_box()
    face = _face(periodic_box, axis, TURN_SAMPLES)
    along = periodic_box.width[axis] * np.eye(3)[axis]
    poses = poses_at(motions, spread_times(TURNS, scene.longest_duration))
    ends = None
    if wall.spec.is_bounded:
        points = wall.surface.enclosing_points()
        ends = np.array(list(product(*zip(points.min(axis=0), points.max(axis=0), strict=True))))
    low = periodic_box.low[axis]
    high = low + periodic_box.width[axis]
    for rotation, offset in zip(poses.rotation, poses.offset, strict=True):
        if ends is not None:
            moved = ((ends - poses.pivot) @ rotation.T + poses.pivot + offset)[:, axis]
            if low + reach < moved.min() and moved.max() < high - reach:
                continue
        yield (face - poses.pivot - offset) @ rotation + poses.pivot, along @ rotation


def refuse_infinite_rotations(scene: Scene, walls: Sequence[PlannedWall]) -> None:
    """Raise SceneError for an unbounded rotating wall in an expanding domain: its velocity has no upper
    bound."""
    if scene.domain.on_exit != "expand":
        return
    times = always(scene.schedule)
    for wall in walls:
        rotations = rotations_of([each.at(times) for each in wall.motions])
        if any(math.isinf(wall.surface.reach_about(*each.point_and_axis)) for each in rotations):
            raise SceneError(
                f"{scene.locate('walls', wall.name, 'motion')}: walls.{wall.name} is unbounded and rotates, "
                "which is not supported in a domain that expands. Use a bounded shape (shape: rectangle), or "
                "set domain.on_exit to delete or error."
            )


def _face(periodic_box: PeriodicBox, axis: int, samples: int = SAMPLES) -> np.ndarray:
    """Uniformly spaced points (samples^2, 3) [m] on the low face along an axis (0, 1 or 2)."""
    shares = np.linspace(0.0, 1.0, samples)
    coordinates = [np.zeros(1) if each == axis else shares for each in range(3)]
    points = np.stack(np.meshgrid(*coordinates, indexing="ij"), axis=-1).reshape(-1, 3)
    return periodic_box.low + points * periodic_box.width


# The precision: resolution of positions, of overlaps, and of liquid volumes.

COARSEST = 0.1
"""Largest spacing of positions over the smallest radius: above it contact forces are noise in any contact
model."""


def position_type(precision: str) -> type[np.floating]:
    """Type of the positions for a precision: float32 for f32, float64 for f64 and mixed."""
    return np.float32 if precision == "f32" else np.float64


def spacing_at(precision: str, coordinate: float) -> float:
    """Spacing [m] of the representable positions at a coordinate [m]."""
    return float(np.spacing(position_type(precision)(abs(coordinate))))


def coordinate_limit(precision: str, radius_min: float) -> float:
    """Coordinate [m] below which the spacing is at most COARSEST of the smallest radius [m].

    With m fraction bits (23 in float32, 52 in float64), the spacing between 2^k and 2^(k + 1) is 2^(k - m).
    """
    bits = np.finfo(position_type(precision)).nmant
    return float(2.0 ** (np.floor(np.log2(COARSEST * radius_min)) + bits + 1))


def refuse_coarse(scene: Scene, radius_min: float) -> None:
    """Raise SceneError if positions at the farthest face of the domain are too coarse for the smallest
    particle.

    `radius_min` [m]. The message suggests mixed precision if that resolves the positions.
    """
    precision = scene.run.precision
    farthest = float(np.abs([scene.domain.min, scene.domain.max]).max())
    if farthest <= coordinate_limit(precision, radius_min):
        return
    mixed_resolves = precision == "f32" and farthest <= coordinate_limit("mixed", radius_min)
    better = "Use --precision mixed, or move" if mixed_resolves else "Move"
    key = ("run", "precision") if scene.is_given("run", "precision") else ("domain",)
    raise SceneError(
        f"{scene.locate(*key)}: run.precision is {precision}, but it resolves positions only to "
        f"{spacing_at(precision, farthest):.3g} m at {farthest:.3g} m from the origin, at the end of the "
        f"domain. The required resolution is {COARSEST:g} of the smallest radius {radius_min:.3g} m. "
        f"{better} the scene closer to the origin."
    )


STEPS_OF_RESOLUTION = 1000
"""Minimum ratio of an overlap to the resolution of the precision, for a force error below 0.15 %."""


def resolution_warning(
    pair_cases: Sequence[PairCase], velocity: float, precision: str, reach: float
) -> tuple[str, ...]:
    """A warning if the overlaps of a collision at `velocity` [m/s] are close to the resolution of the
    precision.

    An overlap is a difference of lengths up to `reach` [m]: coordinates of the domain in f32, two radii in
    mixed. The overlap is that of a Hertz contact (Zhou 2011, Eq. 5). Empty in f64, and if the overlap exceeds
    STEPS_OF_RESOLUTION times the rounding error.
    """
    if precision == "f64":
        return ()
    resolved = float(np.finfo(np.float32).eps) * reach
    overlaps = []
    for pair_case in pair_cases:
        k = theory.hertz_stiffness(pair_case.pair.modulus_eff, pair_case.radius_eff)
        overlaps.append((float(theory.overlap_max(k, pair_case.mass_eff, velocity)), pair_case.name))
    smallest, name = min(overlaps)
    if smallest > STEPS_OF_RESOLUTION * resolved:
        return ()
    remedy = "mixed or f64" if precision == "f32" else "f64"
    return (
        f"{precision} resolves lengths to {resolved:.2g} m here, but the overlaps of {name} are only "
        f"{smallest:.2g} m at {velocity:.3g} m/s: forces are inaccurate. Use --precision {remedy}.",
    )


SLOWEST_SHARE = 0.01
"""Largest speed below which particles do not move, over the impact velocity, without a warning."""


def slow_motion_warning(
    precision: str, farthest: float, time_step: float, velocity: float
) -> tuple[str, ...]:
    """A warning if positions in f32 at `farthest` [m] are too coarse for the motion in one step.

    A position x changes by v dt, rounded to multiples of its spacing: below half of it, that is at a speed

        v < spacing(x) / (2 dt),

    a particle does not move, and above it its mean speed is a multiple of spacing / dt. Empty if this speed
    is below SLOWEST_SHARE of the impact `velocity` [m/s].
    """
    spacing = spacing_at(precision, farthest)
    slowest = 0.5 * spacing / time_step
    if precision != "f32" or slowest <= SLOWEST_SHARE * velocity:
        return ()
    return (
        f"f32 resolves positions to {spacing:.2g} m at {farthest:.3g} m from the "
        f"origin: particles slower than {slowest:.2g} m/s do not move there in a time step of "
        f"{time_step:.2g} s. Use --precision mixed.",
    )


def refuse_coarse_liquid(scene: Scene, transfers_liquid: bool) -> None:
    """Raise SceneError if a model transfers liquid in another precision than f64."""
    if transfers_liquid and scene.run.precision != "f64":
        raise SceneError(
            f"{scene.locate('run', 'precision')}: run.precision is {scene.run.precision}, but "
            f"contact.cohesion: {scene.contact.name('cohesion')} conserves liquid in f64 only; write f64."
        )


def refuse_coarse_properties(scene: Scene) -> None:
    """Raise SceneError for particle equations in f32: a change per step is often below the rounding of the
    property, which would not change at all."""
    if scene.equations and scene.run.precision == "f32":
        names = alternatives([each.name for each in scene.equations])
        raise SceneError(
            f"{scene.locate('run', 'precision')}: run.precision is f32, but the change of {names} in one "
            "step can be below its rounding error; write mixed or f64."
        )


# Motions of walls: the time step must resolve their period, or the rows of their table.

STEPS_PER_PERIOD = 10
"""Minimum number of time steps per period. With fewer, the wall velocities do not represent the motion
(aliasing)."""


def refuse_fast_motion(scene: Scene, walls: Sequence[PlannedWall], time_step: float) -> None:
    """Raise SceneError for each periodic motion, of a wall or of gravity, with a period below ten time steps.

    `time_step` [s]. Rows of a table must be at least one time step apart. One SceneError names all such
    motions, each with the largest permitted time step. `walls`: those of the scene in numeric form.
    """
    problems = []
    of_walls = (
        (("walls", wall.name, "motion", index), motion)
        for wall in walls
        for index, motion in enumerate(wall.motions)
    )
    of_gravity = ((path, each.numeric((0.0, 0.0, 0.0))) for path, each in scene.gravity_motions())
    for path, motion in (*of_walls, *of_gravity):
        key = ".".join(map(str, path))
        shortest = motion.shortest_row
        if time_step > shortest * (1.0 + 1e-9):
            problems.append(
                f"{scene.locate(*path)}: {key} has rows that are {shortest:.3g} "
                f"s apart, less than the time step of {time_step:.3g} s. Give fewer rows, or set "
                f"run.time_step to {shortest:.2g} s or less."
            )
        period = motion.period
        if STEPS_PER_PERIOD * time_step > period * (1.0 + 1e-9):
            problems.append(
                f"{scene.locate(*path[:-1])}: {key} has a period of {period:.3g} s, shorter "
                f"than {STEPS_PER_PERIOD} time steps of {time_step:.3g} s. Slow the motion down, or set "
                f"run.time_step to {period / STEPS_PER_PERIOD:.2g} s or less."
            )
    if problems:
        raise SceneError(problems)


# Displacements in one step, of particles at the start, walls, and images of a sheared box.

STEP_MARGIN = 0.9
"""Time step that a message suggests, relative to the limit."""


def refuse_fast_start(scene: Scene, step: float, radius_min: float) -> None:
    """Raise SceneError if particles of a group have an initial displacement per step [s] above the limit."""
    limit = STEP_SHARE * radius_min
    for name, group in scene.particles.items():
        speed = group.initial_speed
        if speed * step > limit:
            given = scene.is_given("particles", name, "velocity")
            place = scene.locate("particles", name, *(["velocity"] if given else []))
            excess = _per_step(scene, speed, step, limit, share_of(limit, radius_min))
            raise SceneError(f"{place}: particles.{name} starts with {speed:.3g} m/s{excess}")


def refuse_fast_rotation(scene: Scene, step: float) -> None:
    """Raise SceneError if the surface of a particle moves by more than the same share of its radius in a step
    [s]."""
    for name, group in scene.particles.items():
        rate = group.initial_rotation_rate
        if rate * step > STEP_SHARE:
            given = scene.is_given("particles", name, "angular_velocity")
            place = scene.locate("particles", name, *(["angular_velocity"] if given else []))
            raise SceneError(
                f"{place}: particles.{name} starts with {rate:.3g} rad/s, which is {rate * step:.3g} rad per "
                f"step of {step:.3g} s, above the limit of {STEP_SHARE:g} rad. Use at most "
                f"{STEP_MARGIN * STEP_SHARE / step:.2g} rad/s, or lower run.time_step."
            )


FASTEST_EQUIPMENT = 30.0
"""Speed of a wall [m/s] above which a unit is probably wrong, although fast mills reach more."""


def refuse_fast_walls(
    scene: Scene, speeds: Mapping[str, float], step: float, limit: float, share: str
) -> None:
    """Raise SceneError if a prescribed motion moves a wall by more than `limit` [m] in a step [s].

    `share`: the limit relative to the length from which it follows.
    """
    for name, speed in speeds.items():
        if speed * step > limit:
            place = scene.locate("walls", name, "motion")
            excess = _per_step(scene, speed, step, limit, share)
            hint = " Motions without units are in m, rad and s." if speed > FASTEST_EQUIPMENT else ""
            raise SceneError(f"{place}: walls.{name} moves at up to {speed:.3g} m/s{excess}{hint}")


def refuse_fast_images(scene: Scene, step: float, limit: float, share: str) -> None:
    """Raise SceneError if the images of a periodic box move by more than `limit` [m] in a step [s].

    `share`: the limit relative to the length from which it follows.
    """
    speed = scene.image_speed
    if speed * step > limit:
        sheared = [("domain", "lees_edwards")] if scene.domain.lees_edwards is not None else []
        path = next(iter([*sheared, *(path for path, _ in scene.deformations())]))
        key = ".".join(map(str, path))
        excess = _per_step(scene, speed, step, limit, share)
        raise SceneError(f"{scene.locate(*path)}: {key} moves the images at {speed:.3g} m/s{excess}")


def _per_step(scene: Scene, speed: float, step: float, limit: float, share: str) -> str:
    """End of a sentence on a speed [m/s] too high for a step [s], with the remedy."""
    return (
        f", which is {speed * step:.3g} m per step of {step:.3g} s, above the limit of {limit:.3g} m "
        f"({share}): beyond it contacts can be missed. "
        f"{remedy(not isinstance(scene.run.time_step, str), speed, speed, limit)}"
    )


def share_of(limit: float, radius_min: float) -> str:
    """A limit [m] relative to the smallest radius [m]."""
    return f"{limit / radius_min:.2g} of the smallest radius {radius_min:.3g} m"


def remedy(step_is_given: bool, speed: float, planned_speed: float, limit: float) -> str:
    """Remedy for a displacement per step above the limit [m].

    If the scene gives the time step a shorter one, otherwise a higher planned velocity.
    """
    if step_is_given:
        return f"Lower run.time_step to {STEP_MARGIN * limit / speed:.2g} s, or lower the speed."
    return f"Set run.velocity_max to {planned_speed:.3g} m/s, or lower the speed."
