"""Forecasts of servo walls that cannot reach the bed, and so their force, in the time of their motion."""

from collections.abc import Iterator, Sequence
from math import inf

import numpy as np

from granflow.geometry.catalog import area_of, distance_from, triangles
from granflow.load import Scene
from granflow.plan.forecast.pressures import solid_volume
from granflow.plan.plan import Plan
from granflow.plan.wall_control import ControlledMotion
from granflow.plan.walls import PlannedWall, StageTimes
from granflow.scene.schema.domain import Domain
from granflow.scene.schema.motions import Servo

LOOSEST = 0.45
"""Smallest solid fraction of a bed of spheres at rest; random loose packings have 0.55."""

SAMPLES_ALONG = 400
"""Points along the path of a servo at which its distance from other walls is computed."""

MARGIN = 1.2
"""Recommended over required velocity."""


def servo_warnings(scene: Scene, plan: Plan, times: StageTimes) -> Iterator[str]:
    """A sentence for each servo whose travel is shorter than its distance from the bed.

        v t < L - V / (phi A),     v = min(v_max, gain F)

    v: velocity of a servo without contacts; t: time of its motion; L: distance along its direction to the next wall or
    the end of the domain; V: volume of all particles, which fill at most the height V / (phi A) above that wall with
    the loosest solid fraction phi over the area A of the servo. A bed beside the servo is lower: the distance is a
    lower bound.
    """
    for motion in plan.controlled_motions:
        area = area_of(plan.walls[motion.wall].shape)
        given = scene.walls[motion.name].motion[motion.motion]
        if not isinstance(given, Servo) or area is None:
            continue
        duration = _duration(given, times)
        distance = _free_path(plan.domain, plan.walls, motion) - solid_volume(scene.particles) / (LOOSEST * area)
        free_velocity = motion.gain * abs(motion.force)
        travel = min(motion.velocity_max, free_velocity) * duration
        if travel < distance:
            needed = MARGIN * distance / duration
            speed = f"{min(motion.velocity_max, free_velocity):.3g} m/s"
            if free_velocity < motion.velocity_max:
                speed += f", gain times force, less than velocity_max {motion.velocity_max:.3g} m/s,"
            faster = f"Set velocity_max to {needed:.2g} m/s or more, give" if free_velocity > needed else "Give"
            yield (
                f"walls.{motion.name}.motion ({motion.source}): the servo moves at most {travel:.3g} m "
                f"({speed} for {duration:.3g} s), but the bed is at least {distance:.3g} m away: "
                f"it never reaches {motion.force:.3g} N. {faster} it more time, or start it closer to the bed."
            )


def _duration(given: Servo, times: StageTimes) -> float:
    """Time [s] in which a servo is active."""
    end = max(end for _, end in times.values())
    if given.stages is not None:
        return times[given.stages[-1]][1] - times[given.stages[0]][0]
    return max(min(given.end if given.end is not None else inf, end) - (given.start or 0.0), 0.0)


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
