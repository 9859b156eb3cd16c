"""Forecasts of servo walls that cannot reach the bed, and so their force, in the time of their motion."""

from collections.abc import Iterator, Sequence
from math import inf

import numpy as np

from granflow.geometry.catalog import area_of, distance_from, triangles
from granflow.load import Scene
from granflow.plan.forecast.pressures import solid_volume
from granflow.plan.plan import Plan
from granflow.plan.size_classes import outer_diameter_range
from granflow.plan.wall_control import ControlledMotion
from granflow.plan.walls import PlannedWall, StageTimes
from granflow.scene.schema.domain import Domain
from granflow.scene.schema.motions import Servo

LOOSEST = 0.45
"""Smallest solid fraction of a bed of clumps or of cohesive particles at rest."""

LOOSE = 0.55
"""Solid fraction of a random loose packing of spheres, without the last layer."""

SAMPLES_ALONG = 400
"""Points along the path of a servo at which its distance from other walls is computed."""

PARALLEL = 1e-6
"""Largest deviation of the direction of a servo from that of gravity, as the cosine of their angle."""

MARGIN = 1.2
"""Recommended over required velocity."""


def servo_warnings(scene: Scene, plan: Plan, times: StageTimes) -> Iterator[str]:
    """A sentence for the first servo of each wall, if its travel is shorter than its distance from the bed.

        v t < L - V / (phi A) - d,     v = min(v_max, gain F)

    v: velocity of a servo without contacts; t: time of its motion; L: distance along its direction to the next wall or
    the end of the domain; V: volume of all particles, which fill at most the height V / (phi A) above that wall with a
    loose solid fraction phi over the area A of the servo; d: largest diameter, of particles on the surface of the bed.
    A bed beyond the edges of the servo is lower: the distance is a lower bound. Servos across gravity can touch the
    side of a bed, and other motions before a servo move its wall: neither has a forecast.
    """
    for name in dict.fromkeys(motion.name for motion in plan.controlled_motions):
        motions = [each for each in plan.controlled_motions if each.name == name]
        given = [each for each in scene.walls[name].motion if isinstance(each, Servo)]
        area = area_of(plan.walls[motions[0].wall].shape)
        if area is None or len(given) < len(scene.walls[name].motion):
            continue
        first = min(motions, key=lambda each: _span(given[each.motion], times)[0])
        if not _is_along(plan.gravity, first):
            continue
        distance = _distance(scene, plan, first, area)
        duration = _span(given[first.motion], times)[1]
        velocity, limit = first.approach(first.force)
        if velocity * duration < distance:
            yield (
                f"walls.{name}.motion ({first.source}): the servo moves at most {velocity * duration:.3g} m "
                f"({velocity:.3g} m/s, {limit}, for {duration:.3g} s), but the bed is about {distance:.3g} m away: it "
                f"does not reach {first.force:.3g} N. {_remedy(first, distance, duration)}"
            )


def _distance(scene: Scene, plan: Plan, motion: ControlledMotion, area: float) -> float:
    """Distance [m] of a servo with an area [m2] from the bed."""
    is_loose = plan.laws.cohesion is not None or any(group.clump is not None for group in scene.particles.values())
    height = solid_volume(scene.particles) / ((LOOSEST if is_loose else LOOSE) * area)
    layer = max(outer_diameter_range(group)[1] for group in scene.particles.values())
    return _free_path(plan.domain, plan.walls, motion) - height - layer


def _is_along(gravity: Sequence[float], motion: ControlledMotion) -> bool:
    """Whether a servo moves along gravity, or there is none."""
    magnitude = float(np.linalg.norm(gravity))
    return abs(float(np.dot(gravity, motion.direction))) >= (1.0 - PARALLEL) * magnitude


def _remedy(motion: ControlledMotion, distance: float, duration: float) -> str:
    """Instruction with which the servo moves by `distance` [m] in `duration` [s], by what limits the velocity."""
    needed = MARGIN * distance / duration
    free = motion.gain * abs(motion.force)
    parts = [f"set velocity_max to {needed:.2g} m/s or more"] if needed > motion.velocity_max else []
    if needed > free:
        target = abs(motion.force) * needed / free
        parts.append(f"raise gain or the target (to {target:.2g} N at this gain)")
    time = f"give it {MARGIN * distance / min(free, motion.velocity_max):.2g} s"
    text = f"{' and '.join(parts)}, {time}, or start it closer to the bed"
    if free < motion.velocity_max:
        text += "; or approach by a translation, in a stage that ends at a force on the wall"
    return f"{text[0].upper()}{text[1:]}."


def _span(given: Servo, times: StageTimes) -> tuple[float, float]:
    """Start [s] of a servo, and the time [s] in which it is active."""
    end = max(end for _, end in times.values())
    if given.stages is not None:
        start = times[given.stages[0]][0]
        return start, times[given.stages[-1]][1] - start
    start = given.start or 0.0
    return start, max(min(given.end if given.end is not None else inf, end) - start, 0.0)


def _free_path(domain: Domain, walls: Sequence[PlannedWall], motion: ControlledMotion) -> float:
    """Distance [m] from the center of a servo wall along its direction to the next wall or the end of the domain."""
    direction = np.array(motion.direction)
    low, high = np.array(domain.min), np.array(domain.max)
    center = triangles(walls[motion.wall].shape, 0.5 * (low + high), 0.0)[0].mean(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        exits = np.where(direction > 0.0, (high - center) / direction, (low - center) / direction)
    length = float(np.min(exits[np.abs(direction) > 0.0], initial=np.inf))
    if not np.isfinite(length) or length <= 0.0:
        return 0.0
    steps = np.linspace(0.0, length, SAMPLES_ALONG)
    points, spacing = center + steps[:, None] * direction, length / (SAMPLES_ALONG - 1)
    for index, wall in enumerate(walls):
        if index != motion.wall:
            near = np.flatnonzero(np.abs(distance_from(wall.shape, points, spacing)) <= spacing)
            length = min(length, float(steps[near[0]])) if len(near) else length
    return length
