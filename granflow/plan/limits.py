"""Largest distance per step of particles and walls, so that no center crosses a wall without a detected
contact."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isinf, sqrt
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from granflow.contact.law import NormalLaw
from granflow.errors import SceneError
from granflow.geometry.catalog import area_of, distance_from, reach_about
from granflow.geometry.motion import Motion, TableRotation, TableTranslation, single_rotation
from granflow.geometry.periodic_box import AXES, PeriodicBox
from granflow.geometry.shape import unit
from granflow.load import Scene
from granflow.particles.group import largest_speed
from granflow.plan.time_step import STEP_SHARE, PairCase
from granflow.plan.walls import PlannedWall, always, surface_speed
from granflow.scene.blocks.domain import Domain
from granflow.scene.blocks.particles import FileInsertion, Group
from granflow.scene.blocks.quantities import Vector3
from granflow.scene.blocks.walls import FreeWall, Rotation, Servo, Vibration

# Checks of the domain: size of periodic boxes, and walls that cross periodic boundaries.

SAMPLES = 101
"""Points along each side of a face at which walls are compared with those at the opposite face."""
DISTANCE_TOLERANCE = 1e-3
"""Tolerance for the difference of wall distances between opposite faces, relative to the reach."""


def refuse_narrow_box(scene: Scene, radius_max: float, skin: float) -> None:
    """Raise SceneError if a particle can be a candidate partner of two images of another.

    The width along each periodic axis must be at least 4 radius_max + 2 skin. `radius_max`, `skin` [m]; under
    Lees-Edwards shear, give twice the skin.
    """
    periodic_box = scene.domain.periodic_box()
    needed = 4.0 * radius_max + 2.0 * skin
    remark = "" if periodic_box.image_motion is None else ", which is double under shear"
    for axis in periodic_box.axes:
        if periodic_box.width[axis] < needed:
            raise SceneError(
                f"{scene.locate('domain', 'periodic')}: domain.periodic has {AXES[axis]}, along which the "
                f"domain is {periodic_box.width[axis]:.4g} m wide, but a particle could be in contact with "
                f"two images of another one. Make it at least {needed:.4g} m wide, which is two of the "
                f"largest diameters and twice the skin{remark}."
            )


def refuse_cut_walls(scene: Scene, walls: Sequence[PlannedWall], reach: float) -> None:
    """Raise SceneError for a wall within `reach` [m] of a periodic boundary that does not continue across it.

    The distance from the wall is compared at SAMPLES x SAMPLES points of opposite faces, with the wall at
    rest. `reach`: largest radius plus skin.
    """
    periodic_box = scene.domain.periodic_box()
    for axis in periodic_box.axes:
        face = _face(periodic_box, axis)
        for wall in walls:
            opposite = face + periodic_box.width[axis] * np.eye(3)[axis]
            distance_low, distance_high = (
                distance_from(wall.shape, points, reach) for points in (face, opposite)
            )
            is_near = np.minimum(np.abs(distance_low), np.abs(distance_high)) < reach
            if np.any(is_near & ~(np.abs(distance_low - distance_high) <= DISTANCE_TOLERANCE * reach)):
                raise SceneError(
                    f"{scene.locate('walls', wall.name)}: walls.{wall.name} differs between the two ends of "
                    f"the periodic axis {AXES[axis]}. Extend it straight from end to end, or keep a distance "
                    f"of {reach:.4g} m from both."
                )


def refuse_infinite_rotations(scene: Scene, walls: Sequence[PlannedWall]) -> None:
    """Raise SceneError for an unbounded rotating wall in an expanding domain: its velocity has no upper
    bound."""
    if scene.domain.on_exit != "expand":
        return
    times = always(scene.schedule)
    for wall in walls:
        rotation = single_rotation([each.at(times) for each in wall.motions])
        if rotation and isinf(
            reach_about(wall.shape, np.array(rotation.point), np.array(rotation.axis), inf)
        ):
            raise SceneError(
                f"{scene.locate('walls', wall.name, 'motion')}: walls.{wall.name} is unbounded and rotates, "
                "which is not supported in a domain that expands. Use a bounded shape (shape: rectangle), or "
                "set domain.on_exit to delete or error."
            )


def _face(periodic_box: PeriodicBox, axis: int) -> np.ndarray:
    """Uniformly spaced points (SAMPLES^2, 3) [m] on the low face along an axis (0, 1 or 2)."""
    shares = np.linspace(0.0, 1.0, SAMPLES)
    coordinates = [np.zeros(1) if each == axis else shares for each in range(3)]
    return (
        periodic_box.low
        + np.stack(np.meshgrid(*coordinates, indexing="ij"), axis=-1).reshape(-1, 3) * periodic_box.width
    )


# Maximum impact velocity of the plan: given in the scene, or estimated from free fall and prescribed
# motions.

DEFAULT_SPEED = 1.0
"""Impact velocity [m/s] of a scene without motion and gravity: contacts still require a time step."""


@dataclass(frozen=True)
class ImpactVelocity:
    """Maximum expected impact velocity [m/s] and its origin."""

    value: float
    source: str


def max_impact_velocity(scene: Scene) -> ImpactVelocity:
    """Read it from the scene, or estimate it from free fall through the domain, initial velocities and moving
    walls.

        v = max(v_fall, v_initial) + max(v_wall, v_image)

    If particles start faster than they fall and faster than walls and images move, two of them approach at
    2 v_initial. Without any motion and gravity, DEFAULT_SPEED. The result is finite and above 0.
    """
    if scene.run.velocity_max is not None:
        return ImpactVelocity(
            scene.run.velocity_max, f"run.velocity_max ({scene.where('run', 'velocity_max')})"
        )
    fall = free_fall(scene)
    initial = initial_speed(scene)
    surface = max(surface_speed(scene), image_speed(scene.domain))
    if not max(fall, initial, surface) > 0.0:
        return ImpactVelocity(DEFAULT_SPEED, "assumed: no initial motion and no gravity")
    speed = fall
    source = f"free fall through the domain ({fall:.3g} m/s)"
    opposing_name = (
        "the fastest wall" if not image_speed(scene.domain) else "the image across the sheared boundary"
    )
    opposing = surface
    opposing_source = f"{opposing_name} ({surface:.3g} m/s)"
    if initial > fall:
        speed = initial
        source = f"the fastest particle at the start ({initial:.3g} m/s)"
        if initial > surface:
            opposing = initial
            opposing_source = "another one of the same speed"
    parts = ([source] if speed > 0.0 else []) + ([opposing_source] if opposing > 0.0 else [])
    return ImpactVelocity(speed + opposing, f"estimated from {' against '.join(parts)}")


def free_fall(scene: Scene) -> float:
    """Velocity [m/s] after free fall from one corner of the domain to the opposite one.

    v = sqrt(2 (|gx| Lx + |gy| Ly + |gz| Lz))
    """
    size = np.subtract(scene.domain.max, scene.domain.min)
    return float(np.sqrt(2.0 * np.abs(scene.gravity) @ size))


def image_speed(domain: Domain) -> float:
    """Velocity [m/s] of the images across a sheared boundary: shear rate times box width.

    0 without Lees-Edwards shear.
    """
    image_motion = domain.periodic_box().image_motion
    return 0.0 if image_motion is None else abs(image_motion.speed)


def initial_speed(scene: Scene) -> float:
    """Largest initial speed [m/s] of all particles, 0 without groups."""
    return max(initial_speeds(scene.particles).values(), default=0.0)


def initial_speeds(particles: Mapping[str, Group]) -> dict[str, float]:
    """Largest initial speed [m/s] of each group, by name, from the scene or from the file with its particles.

    Random velocities count with `particles.thermal.largest_speed`.
    """
    return {
        name: max(_largest_norm(group.velocity) + _random_speed(group), _in_file(group, "speed_max"))
        for name, group in particles.items()
    }


def initial_rotation_rates(particles: Mapping[str, Group]) -> dict[str, float]:
    """Largest initial angular velocity [rad/s] of each group, by name, from the scene or from its particle
    file."""
    return {
        name: max(_largest_norm(group.angular_velocity), _in_file(group, "angular_velocity_max"))
        for name, group in particles.items()
    }


def _random_speed(group: Group) -> float:
    """Largest expected random velocity [m/s] of a group; 0 without."""
    return 0.0 if group.thermal is None else largest_speed(group.thermal, group.count)


def _in_file(group: Group, name: str) -> float:
    """The quantity `name` of the summary of the particle file of a group, in SI units; 0 without a file."""
    found = group.insert.found if isinstance(group.insert, FileInsertion) else None
    return getattr(found, name, 0.0)


def _largest_norm(vectors: ArrayLike) -> float:
    """Largest norm of one vector (3,) or of many, (n, 3)."""
    return float(np.linalg.norm(np.atleast_2d(vectors), axis=1).max())


# Wall motions: the time step must resolve their period, or the rows of their table.

STEPS_PER_PERIOD = 10
"""Minimum number of time steps per period. With fewer, the wall velocities do not represent the motion
(aliasing)."""


def refuse_fast_motion(scene: Scene, walls: Sequence[PlannedWall], time_step: float) -> None:
    """Raise SceneError for each vibration or rotation whose period is shorter than ten time steps [s].

    Rows of a table must be at least one time step apart. One SceneError names all such motions, each with the
    largest permitted time step. `walls`: those of the scene in numeric form.
    """
    problems = []
    planned = {wall.name: wall.motions for wall in walls}
    for name, wall in scene.walls.items():
        for index, motion in enumerate(wall.motion):
            shortest = _shortest_row(planned[name][index].given)
            if time_step > shortest * (1.0 + 1e-9):
                problems.append(
                    f"{scene.locate('walls', name, 'motion', index)}: walls.{name}.motion.{index} has rows "
                    f"that are {shortest:.3g} s apart, less than the time step of {time_step:.3g} s. Give "
                    f"fewer rows, or set run.time_step to {shortest:.2g} s or less."
                )
            period = _period(motion, scene.gravity) if isinstance(motion, Vibration | Rotation) else math.inf
            if STEPS_PER_PERIOD * time_step > period * (1.0 + 1e-9):
                key = f"walls.{name}.motion.{index}"
                problems.append(
                    f"{scene.locate('walls', name, 'motion')}: {key} has a period of {period:.3g} s, shorter "
                    f"than {STEPS_PER_PERIOD} time steps of {time_step:.3g} s. Slow the motion down, or set "
                    f"run.time_step to {period / STEPS_PER_PERIOD:.2g} s or less."
                )
    if problems:
        raise SceneError(problems)


def _shortest_row(motion: Motion) -> float:
    """Shortest time [s] between two rows of a table; infinite for other motions."""
    return motion.table.shortest_step if isinstance(motion, TableTranslation | TableRotation) else math.inf


def _period(motion: Vibration | Rotation, gravity: Vector3) -> float:
    """Period 2 pi / w [s] of a vibration or rotation; infinite without motion (w = 0 or amplitude 0)."""
    if isinstance(motion, Rotation):
        rate = max(abs(motion.angular_velocity), abs(motion.initial_angular_velocity or 0.0))
    else:
        amplitude, rate = motion.amplitude_and_angular_frequency(gravity)
        rate = rate if amplitude else 0.0
    return 2.0 * math.pi / rate if rate else math.inf


# Checks that the precision resolves positions at the largest distance from the origin.

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
    better = (
        "Use --precision mixed, or move"
        if precision == "f32" and _mixed_resolves(farthest, radius_min)
        else "Move"
    )
    key = ("run", "precision") if scene.is_given("run", "precision") else ("domain",)
    raise SceneError(
        f"{scene.locate(*key)}: run.precision is {precision}, but it resolves positions only to "
        f"{spacing_at(precision, farthest):.3g} m at {farthest:.3g} m from the origin, at the end of the "
        f"domain. The required resolution is {COARSEST:g} of the smallest radius {radius_min:.3g} m. "
        f"{better} the scene closer to the origin."
    )


def _mixed_resolves(farthest: float, radius_min: float) -> bool:
    return farthest <= coordinate_limit("mixed", radius_min)


STEP_MARGIN = 0.9
"""Time step that a message suggests, relative to the limit."""


def refuse_fast_start(scene: Scene, speeds: Mapping[str, float], step: float, radius_min: float) -> None:
    """Raise SceneError if particles of a group have an initial displacement per step above the limit.

    `speeds`: largest initial speed [m/s] of each group; `step` [s].
    """
    limit = STEP_SHARE * radius_min
    for name, speed in speeds.items():
        if speed * step > limit:
            given = scene.is_given("particles", name, "velocity")
            place = scene.locate("particles", name, *(["velocity"] if given else []))
            statement = f"{place}: particles.{name} starts with {speed:.3g} m/s"
            raise SceneError(
                f"{statement}{_per_step(scene, speed, step, limit, share_of(limit, radius_min))}"
            )


def refuse_fast_rotation(scene: Scene, rates: Mapping[str, float], step: float) -> None:
    """Raise SceneError if the surface of a particle moves by more than the same share of its radius in a step
    [s].

    `rates`: largest initial angular velocity [rad/s] of each group.
    """
    for name, rate in rates.items():
        if rate * step > STEP_SHARE:
            given = scene.is_given("particles", name, "angular_velocity")
            place = scene.locate("particles", name, *(["angular_velocity"] if given else []))
            raise SceneError(
                f"{place}: particles.{name} starts with {rate:.3g} rad/s, which is {rate * step:.3g} rad per "
                f"step of {step:.3g} s, above the limit of {STEP_SHARE:g} rad. Use at most "
                f"{STEP_MARGIN * STEP_SHARE / step:.2g} rad/s, or lower run.time_step."
            )


def refuse_fast_walls(
    scene: Scene, speeds: Mapping[str, float], step: float, limit: float, share: str
) -> None:
    """Raise SceneError if a prescribed motion moves a wall by more than `limit` [m] in a step [s].

    `share`: the limit relative to the length from which it follows.
    """
    for name, speed in speeds.items():
        if speed * step > limit:
            statement = (
                f"{scene.locate('walls', name, 'motion')}: walls.{name} moves at up to {speed:.3g} m/s"
            )
            raise SceneError(f"{statement}{_per_step(scene, speed, step, limit, share)}")


def refuse_fast_images(scene: Scene, speed: float, step: float, limit: float, share: str) -> None:
    """Raise SceneError if the images of a sheared box move by more than `limit` [m] in a step [s].

    `share`: the limit relative to the length from which it follows.
    """
    if speed * step > limit:
        statement = (
            f"{scene.locate('domain', 'lees_edwards')}: domain.lees_edwards moves the images at {speed:.3g} "
            "m/s"
        )
        raise SceneError(f"{statement}{_per_step(scene, speed, step, limit, share)}")


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


# Force-controlled walls: servo walls with a target force, and free walls with a mass.

GAIN_SHARE = 0.2
"""Share of the force error that a servo corrects in one step, if all particles within reach are in
contact."""
MAX_GAIN = 2.0
"""This share at which the overshoot of a servo grows from step to step."""


@dataclass(frozen=True)
class WallContacts:
    """Contacts of a layer of particles on a wall.

    count:       of contacts
    stiffness:   [N/m] of one contact at the maximum impact velocity
    resistance:  C + K dt / 2 [N s/m] of one contact, with the largest tangent stiffness K and viscosity C
                 that it can have, see `NormalLaw.present_response`
    """

    count: float
    stiffness: float
    resistance: float


@dataclass(frozen=True)
class ControlledMotion:
    """One force-controlled motion: index of the wall, index of the motion of this wall, and its parameters.

    `force` [N] along the unit vector `direction`: target force of a servo on the particles; applied force and
    weight of a free wall.
    """

    wall: int
    motion: int
    name: str
    kind: Literal["servo", "free"]
    direction: tuple[float, float, float]
    force: float
    gain: float
    """Servo: velocity per force error [m/(s N)]."""
    lag: float
    """Servo: time [steps] in which its velocity follows the force error."""
    velocity_max: float
    """Servo: maximum velocity [m/s]."""
    mass: float
    """Free wall: mass [kg]."""
    damping: float
    """Free wall: damping [kg/s]."""
    source: str
    """Line of the motion in the scene file."""

    def approach(self, error: float) -> tuple[float, str]:
        """Velocity [m/s] of a servo at a force error [N] of either sign, and the limit that determines it in
        words."""
        velocity = self.gain * abs(error)
        if velocity < self.velocity_max:
            force = "force" if error == self.force else "force error"
            return velocity, f"gain times {force}, less than velocity_max {self.velocity_max:.3g} m/s"
        return self.velocity_max, "velocity_max"

    @property
    def key(self) -> str:
        """Key in messages and checkpoints."""
        return f"walls.{self.name}.motion.{self.motion}"


def controlled_motions_of(
    scene: Scene,
    walls: Sequence[PlannedWall],
    law: NormalLaw,
    pair_cases: Sequence[PairCase],
    velocity: float,
    step: float,
) -> tuple[ControlledMotion, ...]:
    """All force-controlled motions in order of the walls.

    `velocity` [m/s]: maximum expected impact velocity, at which `law` gives the stiffness of `pair_cases`;
    `step` [s].

    Raises SceneError for a motion that is unstable with the step.
    """
    controlled_motions = []
    for index, wall in enumerate(walls):
        for number, given in enumerate(scene.walls[wall.name].motion):
            if isinstance(given, Servo | FreeWall):
                layer = _layer(scene, wall, given, law, pair_cases, velocity, step)
                build = _servo if isinstance(given, Servo) else _free
                controlled_motions.append(build(scene, index, wall, number, given, layer, step))
    return tuple(controlled_motions)


def _servo(
    scene: Scene, index: int, wall: PlannedWall, number: int, given: Any, layer: WallContacts, step: float
) -> ControlledMotion:
    """A servo approaches v = gain (F - f), limited to velocity_max, within `lag` steps.

    Contacts of stiffness K change their force by K dt v = gain K dt (F - f) in a step: for gain K dt < 2 the
    force error decreases in every step. The servo is a dashpot of 1/gain: it dissipates energy of the
    particles.

    With v' = v + (gain (F - f) - v) / (1 + lag), the characteristic equation on contacts of stiffness K and
    viscosity C

        z^2 - (1 + p - gain K dt / (1 + lag)) z + p = 0,     p = (lag - gain C) / (1 + lag)

    has both roots inside the unit circle for lag >= gain (C + K dt / 2), because then 0 <= p < 1 and 2 + 2 p
    exceeds gain K dt / (1 + lag). Without lag the wall would overshoot at every step on contacts with gain C
    > 1: the force that it reacts to contains that of its own velocity.
    """
    max_gain = MAX_GAIN / (layer.stiffness * step)
    default_gain = GAIN_SHARE / (layer.count * layer.stiffness * step)
    if given.gain is not None and given.gain > max_gain:
        location = scene.locate("walls", wall.name, "motion", number, "gain")
        raise SceneError(
            f"{location}: walls.{wall.name}.motion.gain is {given.gain:.3g} m/(s N), but from {max_gain:.3g} "
            f"on the wall overshoots at every step of {step:.3g} s. Without the key it is {default_gain:.2g}."
        )
    force = given.force
    if force is None:
        force = given.pressure * (area_of(wall.shape) or 0.0)
    gain = given.gain if given.gain is not None else default_gain
    return ControlledMotion(
        index,
        number,
        wall.name,
        "servo",
        _unit(given),
        force,
        gain,
        gain * layer.count * layer.resistance,
        given.velocity_max,
        mass=1.0,
        damping=0.0,
        source=scene.where("walls", wall.name, "motion", number),
    )


def _free(
    scene: Scene, index: int, wall: PlannedWall, number: int, given: Any, layer: WallContacts, step: float
) -> ControlledMotion:
    """A free wall of mass M on contacts of stiffness K and viscosity C is stable for M > (C + K dt / 2) dt /
    2.

    The least mass is twice as large, and at least K dt^2 [kg], with the contacts of a layer of particles.
    Raises SceneError for a smaller mass.
    """
    min_mass = layer.count * step * max(layer.resistance, layer.stiffness * step)
    if given.mass < min_mass:
        location = scene.locate("walls", wall.name, "motion", number, "mass")
        raise SceneError(
            f"{location}: walls.{wall.name}.motion.mass is {given.mass:.3g} kg, but with contacts of all "
            f"particles within reach the wall oscillates too fast for a step of {step:.3g} s: set it to "
            f"{min_mass:.2g} kg or more, or lower run.time_step."
        )
    direction = _unit(given)
    force = given.force + given.mass * float(np.dot(scene.gravity, direction))
    return ControlledMotion(
        index,
        number,
        wall.name,
        "free",
        direction,
        force,
        gain=0.0,
        lag=0.0,
        velocity_max=0.0,
        mass=given.mass,
        damping=given.damping,
        source=scene.where("walls", wall.name, "motion", number),
    )


def _layer(
    scene: Scene,
    wall: PlannedWall,
    given: Any,
    law: NormalLaw,
    pair_cases: Sequence[PairCase],
    velocity: float,
    step: float,
) -> WallContacts:
    """The contacts of a layer of particles on the wall.

    A layer of spheres of radius r in closest packing has one sphere per area 2 sqrt(3) r^2 of the wall.
    """
    single = max(
        law.loading_stiffness(case.pair, case.radius_eff, case.mass_eff, velocity) for case in pair_cases
    )
    responses = [law.present_response(*case.dashpot_arguments, velocity, step) for case in pair_cases]
    resistance = max(viscosity + 0.5 * step * stiffness for stiffness, viscosity in responses)
    radius = min(pair_case.radius for pair_case in pair_cases)
    area = area_of(wall.shape) or section(scene.domain, _unit(given))
    particle_count = sum(group.sphere_count for group in scene.particles.values())
    return WallContacts(
        max(min(particle_count, area / (2.0 * sqrt(3.0) * radius**2)), 1.0), single, resistance
    )


def section(domain: Domain, direction: Sequence[float] | np.ndarray) -> float:
    """Projected area [m2] of the domain along a direction (3,), unit vector."""
    size = np.subtract(domain.max, domain.min)
    return float(np.abs(direction) @ [size[1] * size[2], size[2] * size[0], size[0] * size[1]])


def _unit(given: Any) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in unit(given.direction))
    return x, y, z


def describe(controlled: ControlledMotion) -> Iterator[tuple[str, str]]:
    """Names and values of the parameters of a force-controlled motion, for `granflow explain`."""
    if controlled.kind == "servo":
        yield "target force", f"{controlled.force:.4g} N"
        yield "gain", f"{controlled.gain:.3g} m/(s N)"
        yield "lag", f"{controlled.lag:.3g} steps"
        yield "maximum velocity", f"{controlled.velocity_max:.3g} m/s"
    else:
        yield "mass", f"{controlled.mass:.4g} kg"
        yield "force and weight", f"{controlled.force:.4g} N"
        yield "damping", f"{controlled.damping:.3g} kg/s"
