"""Impact velocity of the forecasts: a fall from where particles start, instead of through the whole domain.

The time step keeps the velocity of `max_impact_velocity`, which covers runs that lift particles.
"""

from itertools import product
from math import sqrt

import numpy as np

from granflow.geometry.catalog import triangles
from granflow.geometry.periodic_box import AXES
from granflow.load import Scene
from granflow.particles.regions import BoxSampler, CylinderSampler
from granflow.plan.forecast.regions import region_of
from granflow.plan.max_impact_velocity import ImpactVelocity, image_speed, initial_speeds
from granflow.plan.plan import Plan
from granflow.plan.walls import PlannedWall
from granflow.scene.schema.insertion import PositionsInsertion
from granflow.scene.schema.particles import Group
from granflow.scene.schema.walls import Plane

PARALLEL = 1e-6
"""Largest deviation of the normal of a plane from the vertical for a floor: on a steeper one, particles slide on."""


def forecast_velocity(scene: Scene, plan: Plan) -> ImpactVelocity:
    """Largest impact velocity if each particle starts at its insertion and falls to the lowest wall.

        v = max sqrt(v0^2 + 2 |g| h),      at most the planned velocity

    v0: initial speed, h: drop height of a group. That of the plan if `run.velocity_max` is given, without gravity, if
    walls or images move, which lift or accelerate particles, or if the height of a group is not known.
    """
    planned, gravity = plan.impact_velocity, np.array(plan.gravity, float)
    magnitude = float(np.linalg.norm(gravity))
    is_moving = bool(image_speed(scene.domain)) or any(wall.motions for wall in plan.walls)
    if scene.run.velocity_max is not None or not magnitude or is_moving:
        return planned
    up, speeds = -gravity / magnitude, initial_speeds(scene.particles)
    low = lowest_level(scene, plan.walls, up)
    groups = {name: group for name, group in scene.particles.items() if not group.fixed}
    tops = {name: highest_point(group, up) for name, group in groups.items()}
    if low is None or not tops or any(top is None for top in tops.values()):
        return planned
    heights = {name: max(top - low, 0.0) for name, top in tops.items() if top is not None}
    fastest = max(heights, key=lambda name: speeds[name] ** 2 + 2.0 * magnitude * heights[name])
    value = sqrt(speeds[fastest] ** 2 + 2.0 * magnitude * heights[fastest])
    if not 0.0 < value < planned.value:
        return planned
    initial = f" with an initial speed of {speeds[fastest]:.3g} m/s" if speeds[fastest] else ""
    return ImpactVelocity(value, f"estimated from a fall of particles.{fastest} by {heights[fastest]:.3g} m{initial}")


def highest_point(group: Group, up: np.ndarray) -> float | None:
    """Largest height [m] along `up` (3,) at which particles of a group start; None if it is not known."""
    if isinstance(group.insert, PositionsInsertion):
        return float((np.array(group.insert.positions) @ up).max())
    region = region_of(group)
    if isinstance(region, BoxSampler):
        return float(np.maximum(region.low * up, region.high * up).sum())
    if isinstance(region, CylinderSampler):
        along = float(region.frame[2] @ up)
        base = float(region.start @ up) + max(along * region.length, 0.0)
        return base + region.radius * sqrt(max(1.0 - along**2, 0.0))
    return None


def lowest_level(scene: Scene, walls: tuple[PlannedWall, ...], up: np.ndarray) -> float | None:
    """Smallest height [m] along `up` (3,) at which particles hit a wall or another particle; None if not known.

    The highest permanent plane across `up`, otherwise the lowest point of the walls, or the end of the domain if it is
    higher or there are no walls. Not known along a periodic axis, or without walls in a domain that expands.
    """
    domain = scene.domain
    if any(abs(up[AXES.index(axis)]) > PARALLEL for axis in domain.periodic):
        return None
    end = min(float(np.array(corner) @ up) for corner in product(*zip(domain.min, domain.max, strict=True)))
    floors: list[float] = []
    lowest: list[float] = []
    for wall in walls:
        given = scene.walls[wall.name]
        if isinstance(given, Plane):
            normal = np.array(given.normal) / np.linalg.norm(given.normal)
            is_floor = float(normal @ up) > 1.0 - PARALLEL and wall.is_permanent
            (floors if is_floor else lowest).append(float(np.array(given.point) @ up) if is_floor else end)
        else:
            points = triangles(wall.shape, np.zeros(3), 0.0)[0]
            lowest.append(float((points @ up).min()))
    if floors:
        return max(*floors, end)
    if domain.on_exit == "expand":
        return min(lowest, default=None)
    return max(min(lowest, default=end), end)
