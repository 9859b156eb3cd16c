"""Impact velocity of the forecasts: a fall from where particles start, instead of through the whole domain.

The time step keeps the velocity of `max_impact_velocity`, which covers runs that lift particles.
"""

from collections.abc import Iterable, Iterator
from itertools import product
from math import sqrt

import numpy as np

from granflow.geometry.catalog import triangles
from granflow.geometry.motion import SurfaceVelocity
from granflow.geometry.motion_speed import top_speed
from granflow.geometry.periodic_box import AXES
from granflow.load import Scene
from granflow.particles.regions import BoxSampler, CylinderSampler, SlabSampler
from granflow.plan.forecast.paths import FallingParticles, Path
from granflow.plan.forecast.regions import region_of
from granflow.plan.forecast.wall_facets import WallFacets
from granflow.plan.max_impact_velocity import ImpactVelocity, image_speed, initial_speeds
from granflow.plan.plan import Plan
from granflow.plan.size_classes import outer_diameter_range
from granflow.plan.walls import PlannedMotion, PlannedWall
from granflow.scene.schema.insertion import (
    InletInsertion,
    LatticeInsertion,
    PackInsertion,
    PositionsInsertion,
    RainInsertion,
)
from granflow.scene.schema.particles import Group
from granflow.scene.schema.walls import Plane

PARALLEL = 1e-6
"""Largest deviation of the normal of a plane from the vertical for a floor: on a steeper one, particles slide on."""

SLOW = 0.1
"""Given velocity over that of a fall below which a unit is probably wrong."""

SAMPLES = 64
"""Number of particles of a group whose paths are computed."""


def forecast_velocity(scene: Scene, plan: Plan) -> ImpactVelocity:
    """Largest impact velocity if each particle starts at its insertion and falls to the lowest wall.

        v = max sqrt(max(v0, u)^2 + 2 |g| h) + u,      at most the planned velocity

    v0: initial speed, h: drop height of a group, u: largest speed of belts, at which particles may fall from them. That
    of the plan if the drop heights are not known, see `_drop_heights`.
    """
    planned, heights = plan.impact_velocity, _drop_heights(scene, plan)
    if not heights:
        return planned
    magnitude, belt = float(np.linalg.norm(plan.gravity)), _belt_speed(plan.walls)
    speeds = {name: max(speed, belt) for name, speed in initial_speeds(scene.particles).items()}
    fastest = max(heights, key=lambda name: speeds[name] ** 2 + 2.0 * magnitude * heights[name])
    value = sqrt(speeds[fastest] ** 2 + 2.0 * magnitude * heights[fastest])
    initial = f" with an initial speed of {speeds[fastest]:.3g} m/s" if speeds[fastest] else ""
    return _at_most(planned, value, plan, f"a fall of particles.{fastest} by {heights[fastest]:.3g} m{initial}")


def path_velocity(scene: Scene, plan: Plan) -> ImpactVelocity:
    """As `forecast_velocity`, but particles fall onto the first wall below, and slide over its edges onto the next.

    Walls that are present during the whole run stop a fall. See `paths` for the velocities.
    """
    simple, heights = forecast_velocity(scene, plan), _drop_heights(scene, plan)
    if not heights or any(scene.particles[name].thermal is not None for name in heights):
        return simple
    gravity = np.array(plan.gravity, float)
    up = -gravity / np.linalg.norm(gravity)
    low = lowest_level(scene, plan.walls, up)
    assert low is not None
    walls = [wall for wall in plan.walls if wall.is_permanent]
    bounds = _bounds(scene)
    facets = WallFacets(walls, np.array(scene.domain.min), np.array(scene.domain.max))
    falling = FallingParticles(facets, gravity, low, plan.radius_min, [_belt_speed([wall]) for wall in walls], bounds)
    paths = {name: falling.fastest(*_starts(scene.particles[name], up)) for name in heights}
    name = max(paths, key=lambda each: paths[each].value)
    return _at_most(simple, sqrt(paths[name].value), plan, _path_words(name, paths[name]))


def velocity_warnings(scene: Scene, plan: Plan) -> Iterator[str]:
    """A sentence on a given `run.velocity_max` that is far below the velocity after the fall of inserted particles.

    Particles of a packing fall less, and damped ones more slowly: SLOW times the velocity is the limit, and damping
    excludes the warning.
    """
    given = scene.run.velocity_max
    if given is None or scene.damping or image_speed(scene.domain) or not np.any(plan.gravity):
        return
    magnitude = float(np.linalg.norm(plan.gravity))
    regions = (LatticeInsertion, PackInsertion, RainInsertion, InletInsertion)
    heights = _heights(scene, plan, -np.array(plan.gravity) / magnitude)
    heights = {name: each for name, each in heights.items() if isinstance(scene.particles[name].insert, regions)}
    if not heights:
        return
    name = max(heights, key=lambda each: heights[each])
    fall = sqrt(2.0 * magnitude * heights[name])
    if given < SLOW * fall:
        yield (
            f"run.velocity_max ({scene.where('run', 'velocity_max')}) is {given:.3g} m/s, but particles.{name} can "
            f"fall {heights[name]:.3g} m and reach {fall:.3g} m/s: time step and forecasts are those of slower "
            f"impacts. Check the unit, or set it to {fall:.2g} m/s."
        )


def _drop_heights(scene: Scene, plan: Plan) -> dict[str, float]:
    """Height [m] of the highest particle of each group above the lowest level, by name; empty if it is not known.

    It is not known if `run.velocity_max` is given, without gravity, if walls or images move or belts go up, which lift
    or accelerate particles, or if the region of a group is not known.
    """
    if scene.run.velocity_max is not None or image_speed(scene.domain) or not np.any(plan.gravity):
        return {}
    up = -np.array(plan.gravity) / np.linalg.norm(plan.gravity)
    if any(not _is_level_belt(each, up) for wall in plan.walls for each in wall.motions):
        return {}
    return _heights(scene, plan, up)


def _heights(scene: Scene, plan: Plan, up: np.ndarray) -> dict[str, float]:
    """As `_drop_heights`; empty if the region of a group or the lowest level is not known."""
    low = lowest_level(scene, plan.walls, up)
    groups = {name: group for name, group in scene.particles.items() if not group.fixed}
    tops = {name: highest_point(group, up) for name, group in groups.items()}
    if low is None or any(top is None for top in tops.values()):
        return {}
    return {name: max(top - low, 0.0) for name, top in tops.items() if top is not None}


def _is_level_belt(motion: PlannedMotion, up: np.ndarray) -> bool:
    """Whether a motion is the surface velocity of a belt that does not go up."""
    if not isinstance(motion.given, SurfaceVelocity):
        return False
    velocities = np.array([motion.given.velocity, motion.given.initial_velocity])
    return bool(np.all(velocities @ up <= PARALLEL * np.linalg.norm(velocities, axis=1)))


def _belt_speed(walls: Iterable[PlannedWall]) -> float:
    """Largest surface speed [m/s] of walls whose motions are those of belts."""
    speeds = (
        sum(top_speed(each.given) for each in wall.motions if isinstance(each.given, SurfaceVelocity)) for wall in walls
    )
    return max(speeds, default=0.0)


def _at_most(limit: ImpactVelocity, value: float, plan: Plan, words: str) -> ImpactVelocity:
    """The smaller one of an impact velocity and of `value` [m/s], against the fastest belt, estimated from `words`."""
    belt = _belt_speed(plan.walls)
    if not 0.0 < value + belt < limit.value:
        return limit
    against = f" against the fastest wall ({belt:.3g} m/s)" if belt else ""
    return ImpactVelocity(value + belt, f"estimated from {words}{against}")


def _path_words(name: str, path: Path) -> str:
    """Words for the fall of a group along a path."""
    *over, last = (f"walls.{each}" for each in dict.fromkeys(path.walls)) if path.walls else ("",)
    if path.falls:
        over, last = [*over, last], "the lowest level"
    end = f" to {last}" if last else ""
    return f"a fall of particles.{name}{' over ' if any(over) else ''}{', '.join(filter(None, over))}{end}"


def _bounds(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Corners (3,) [m] of the space in which particles exist: the domain, infinite along axes without an end."""
    low, high = np.array(scene.domain.min), np.array(scene.domain.max)
    margin = 1e-9 * (high - low)
    is_open = np.full(3, scene.domain.on_exit == "expand") | np.isin(list(AXES), list(scene.domain.periodic))
    return np.where(is_open, -np.inf, low - margin), np.where(is_open, np.inf, high + margin)


def _starts(group: Group, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) [m] at which particles of a group start, in regions at the greatest height, and velocities."""
    region = region_of(group)
    if region is None:
        assert isinstance(group.insert, PositionsInsertion)
        points = np.array(group.insert.positions, float)
        velocities = np.broadcast_to(np.asarray(group.velocity, float), points.shape)
        some = np.argsort(-(points @ up), kind="stable")[:SAMPLES]
        return points[some], velocities[some]
    radius = min(0.5 * outer_diameter_range(group)[0], region.radius_max)
    points = region.sample(np.full(SAMPLES, radius), np.random.default_rng(0))
    top = highest_point(group, up)
    assert top is not None
    points = points + np.outer(top - points @ up, up)
    return points, np.broadcast_to(np.asarray(group.velocity, float), points.shape)


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
    if isinstance(region, SlabSampler):
        local = region.frame @ up
        return float(region.corner @ up + np.maximum(region.box.high * local, 0.0).sum())
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
