"""Impact velocities of the forecasts: falls from where particles start, instead of through the whole
domain.

The time step keeps the velocity of `max_impact_velocity`, which covers runs that lift particles. Forecasts
of overlaps use the smaller velocity of a fall to the lowest level, and where this is still too fast, that
on the paths over the walls. A particle falls from its insertion along a parabola onto the first wall. The
impact ends its velocity across the wall; that along the wall remains and grows without friction down to the
lowest edges, over which the particle falls further:

    v1^2 = v0^2 + 2 g h1                       impact after a fall by h1
    v2^2 = |v1 - (v1.n) n|^2 + 2 g h2          slide by the height h2 of a wall with the normal n

Bounces are neglected.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from math import sqrt

import numpy as np

from granflow.geometry.periodic_box import AXES
from granflow.geometry.region import RegionSampler
from granflow.load import Scene
from granflow.plan.plan import Plan
from granflow.plan.time_step import ImpactVelocity
from granflow.plan.walls import PlannedWall
from granflow.scene.blocks.particles import Group

# Velocities of the forecasts.

SLOW = 0.1
"""Given velocity over that of a fall below which a unit is probably wrong."""


def forecast_velocity(plan: Plan) -> ImpactVelocity:
    """Largest impact velocity if each particle starts at its insertion and falls to the lowest wall.

        v = max sqrt(max(v0, u)^2 + 2 |g| h) + u,      at most the planned velocity

    v0: initial speed, h: drop height of a group, u: largest speed of belts, at which particles may fall from
    them. That of the plan if the drop heights are not known, see `_drop_heights`.
    """
    planned = plan.impact_velocity
    heights = _drop_heights(plan)
    if not heights:
        return planned
    magnitude = float(np.linalg.norm(plan.scene.gravity))
    belt = _belt_speed(plan.walls)
    speeds = {name: max(group.initial_speed, belt) for name, group in plan.scene.particles.items()}
    fastest = max(heights, key=lambda name: speeds[name] ** 2 + 2.0 * magnitude * heights[name])
    value = sqrt(speeds[fastest] ** 2 + 2.0 * magnitude * heights[fastest])
    initial = f" with an initial speed of {speeds[fastest]:.3g} m/s" if speeds[fastest] else ""
    return _at_most(
        planned, value, plan, f"a fall of particles.{fastest} by {heights[fastest]:.3g} m{initial}"
    )


def path_velocity(plan: Plan) -> ImpactVelocity:
    """As `forecast_velocity`, but particles fall onto the first wall below, and slide over its edges onto the
    next.

    Walls that are present during the whole run stop a fall. The velocities are those of `FallingParticles`.
    """
    scene = plan.scene
    simple = forecast_velocity(plan)
    heights = _drop_heights(plan)
    if not heights or any(scene.particles[name].thermal is not None for name in heights):
        return simple
    gravity = np.array(scene.gravity, float)
    up = -gravity / np.linalg.norm(gravity)
    low = lowest_level(scene, plan.walls, up)
    assert low is not None
    walls = [wall for wall in plan.walls if wall.spec.is_permanent]
    falling = FallingParticles(
        facets=WallFacets(walls, np.array(scene.domain.min), np.array(scene.domain.max)),
        gravity=gravity,
        low=low,
        radius=plan.radius_min,
        belts=[_belt_speed([wall]) for wall in walls],
        bounds=_space(scene),
    )
    paths = {name: falling.fastest(*_start_points(scene.particles[name], up)) for name in heights}
    name = max(paths, key=lambda each: paths[each].value)
    return _at_most(simple, sqrt(paths[name].value), plan, _path_words(name, paths[name]))


def velocity_warnings(plan: Plan) -> Iterator[str]:
    """A sentence on a given `run.velocity_max` that is far below the velocity after the fall of inserted
    particles.

    Particles of a packing fall less, and damped ones more slowly: SLOW times the velocity is the limit, and
    damping excludes the warning.
    """
    scene = plan.scene
    given = scene.run.velocity_max
    if given is None or scene.damping or scene.domain.image_speed or not np.any(scene.gravity):
        return
    magnitude = float(np.linalg.norm(scene.gravity))
    heights = _heights(plan, -np.array(scene.gravity) / magnitude)
    heights = {name: each for name, each in heights.items() if region_of(scene.particles[name]) is not None}
    if not heights:
        return
    name = max(heights, key=lambda each: heights[each])
    fall = sqrt(2.0 * magnitude * heights[name])
    if given < SLOW * fall:
        yield (
            f"run.velocity_max ({scene.where('run', 'velocity_max')}) is {given:.3g} m/s, but "
            f"particles.{name} can fall {heights[name]:.3g} m and reach {fall:.3g} m/s: time step and "
            f"forecasts are those of slower impacts. Check the unit, or set it to {fall:.2g} m/s."
        )


def _at_most(limit: ImpactVelocity, value: float, plan: Plan, words: str) -> ImpactVelocity:
    """The smaller one of an impact velocity and of `value` [m/s], against the fastest belt, estimated from
    `words`."""
    belt = _belt_speed(plan.walls)
    if not 0.0 < value + belt < limit.value:
        return limit
    against = f" against the fastest wall ({belt:.3g} m/s)" if belt else ""
    return ImpactVelocity(value + belt, f"estimated from {words}{against}")


# Heights: from where particles start to the lowest level.

LEVEL = 1e-6
"""Largest deviation of the normal of a plane from the vertical for a floor: on a steeper one, particles slide
on."""


def _drop_heights(plan: Plan) -> dict[str, float]:
    """Height [m] of the highest particle of each group above the lowest level, by name; empty if it is not
    known.

    It is not known if `run.velocity_max` is given, without gravity, if walls or images move or belts go up,
    which lift or accelerate particles, or if the region of a group is not known.
    """
    scene = plan.scene
    if scene.run.velocity_max is not None or scene.domain.image_speed or not np.any(scene.gravity):
        return {}
    up = -np.array(scene.gravity) / np.linalg.norm(scene.gravity)
    if any(each.can_lift(up) for wall in plan.walls for each in wall.motions):
        return {}
    return _heights(plan, up)


def _heights(plan: Plan, up: np.ndarray) -> dict[str, float]:
    """As `_drop_heights`; empty if the region of a group or the lowest level is not known."""
    low = lowest_level(plan.scene, plan.walls, up)
    groups = {name: group for name, group in plan.scene.particles.items() if not group.fixed}
    tops = {name: highest_point(group, up) for name, group in groups.items()}
    if low is None or any(top is None for top in tops.values()):
        return {}
    return {name: max(top - low, 0.0) for name, top in tops.items() if top is not None}


def _belt_speed(walls: Iterable[PlannedWall]) -> float:
    """Largest surface speed [m/s] of walls whose motions are those of belts."""
    fastest = 0.0
    for wall in walls:
        fastest = max(fastest, sum(each.surface_speed for each in wall.motions))
    return fastest


def region_of(group: Group) -> RegionSampler | None:
    """The region in which particles of a group are inserted at random or on a lattice; None for given
    positions."""
    return group.insert.region_for(0.5 * group.outer_diameters[1], np.array(group.velocity, float))


def highest_point(group: Group, up: np.ndarray) -> float | None:
    """Largest height [m] along `up` (3,) at which particles of a group start; None if it is not known."""
    if group.insert.points:
        return float((np.array(group.insert.points) @ up).max())
    region = region_of(group)
    return None if region is None else region.highest(up)


def lowest_level(scene: Scene, walls: tuple[PlannedWall, ...], up: np.ndarray) -> float | None:
    """Smallest height [m] along `up` (3,) at which particles hit a wall or another particle; None if not
    known.

    The highest permanent plane across `up`, otherwise the lowest point of the walls, or the end of the domain
    if it is higher or there are no walls. Not known along a periodic axis, or without walls in a domain that
    expands.
    """
    domain = scene.domain
    if any(abs(up[AXES.index(axis)]) > LEVEL for axis in domain.periodic):
        return None
    corners = product(*zip(domain.min, domain.max, strict=True))
    end = min(float(np.array(corner) @ up) for corner in corners)
    floors: list[float] = []
    lowest: list[float] = []
    for wall in walls:
        plane = wall.surface.plane
        if plane is None:
            points = wall.surface.triangles(np.zeros(3), 0.0)[0]
            lowest.append(float((points @ up).min()))
            continue
        point, normal = plane
        if float(normal @ up) > 1.0 - LEVEL and wall.spec.is_permanent:
            floors.append(float(point @ up))
        else:
            lowest.append(end)
    if floors:
        return max(*floors, end)
    if domain.on_exit == "expand":
        return min(lowest, default=None)
    return max(min(lowest, default=end), end)


# Facets of walls at rest, and the first wall on the path of a falling particle.

PATH_SEGMENTS = 48
"""Straight segments of the parabola of a particle with a horizontal velocity."""
EDGE_TOLERANCE = 1e-9
"""Tolerance of the barycentric coordinates of a point in a triangle: no gap between triangles with a common
edge."""
EDGE_SAMPLES = 32
"""Largest number of points on the lowest edges of a wall."""


@dataclass(frozen=True)
class Hit:
    """Where a path ends at a wall: index of the wall, point (3,) [m], velocity (3,) [m/s], unit normal
    (3,)."""

    wall: int
    point: np.ndarray
    velocity: np.ndarray
    normal: np.ndarray

    @property
    def tangential_velocity(self) -> np.ndarray:
        """The velocity (3,) [m/s] along the wall."""
        return np.asarray(self.velocity - (self.velocity @ self.normal) * self.normal)


class WallFacets:
    """Triangles of walls at rest; planes are squares that are larger than the domain.

    walls:      with their numbers in the list
    low, high:  corners (3,) [m] of the domain
    """

    def __init__(self, walls: Sequence[PlannedWall], low: np.ndarray, high: np.ndarray) -> None:
        center = 0.5 * (low + high)
        extent = 4.0 * float(np.linalg.norm(high - low))
        self.walls = list(walls)
        self.points = [wall.surface.triangles(center, extent) for wall in walls]
        corners = [points[each] for points, each in self.points]
        self.corners = np.concatenate([np.empty((0, 3, 3)), *corners])
        self.wall = np.repeat(np.arange(len(corners)), [len(each) for each in corners])
        self.low = self.corners.min(axis=1).T.copy()
        self.high = self.corners.max(axis=1).T.copy()

    def near(self, path: np.ndarray, within: np.ndarray | None = None) -> np.ndarray:
        """Numbers (k,) of the triangles whose bounding box intersects that of points (n, 3) [m].

        `within`: numbers of the triangles to search, by default all.
        """
        index = np.arange(len(self.wall)) if within is None else within
        for axis in range(3):
            coordinate = path[:, axis]
            index = index[self.low[axis, index] <= coordinate.max()]
            index = index[self.high[axis, index] >= coordinate.min()]
        return index

    def first_on_segment(
        self, start: np.ndarray, end: np.ndarray, within: np.ndarray
    ) -> tuple[float, int] | None:
        """Share of the segment (3,) to (3,) [m] at which it meets the first triangle, and the triangle; or
        None.

        By Moeller and Trumbore (1997). `within`: numbers of the triangles to search.
        """
        index = self.near(np.array([start, end]), within)
        first = self.corners[index, 1] - self.corners[index, 0]
        second = self.corners[index, 2] - self.corners[index, 0]
        along = end - start
        offset = start - self.corners[index, 0]
        across = np.cross(along, second)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1.0 / np.sum(first * across, axis=1)
            u = scale * np.sum(offset * across, axis=1)
            turned = np.cross(offset, first)
            v = scale * (turned @ along)
            share = scale * np.sum(second * turned, axis=1)
            inside = (
                (u >= -EDGE_TOLERANCE)
                & (v >= -EDGE_TOLERANCE)
                & (u + v <= 1.0 + EDGE_TOLERANCE)
                & (share >= 0.0)
                & (share <= 1.0)
            )
        if not inside.any():
            return None
        best = int(np.flatnonzero(inside)[share[inside].argmin()])
        return float(share[best]), int(index[best])

    def first_hit(
        self, start: np.ndarray, velocity: np.ndarray, gravity: np.ndarray, fall: float
    ) -> Hit | None:
        """The first wall on a parabola from `start` (3,) [m] with `velocity` (3,) [m/s]; None if there is
        none.

        gravity:  (3,) [m/s2]
        fall:     height [m] below the start at which the path ends
        """
        strength = float(np.linalg.norm(gravity))
        down = float(velocity @ gravity) / strength
        duration = (-down + np.sqrt(down**2 + 2.0 * strength * fall)) / strength
        is_straight = np.linalg.norm(np.cross(velocity, gravity)) == 0.0 and down >= 0.0
        times = np.linspace(0.0, duration, 2 if is_straight else PATH_SEGMENTS + 1)[:, None]
        path = start + times * velocity + 0.5 * times**2 * gravity
        within = self.near(path)
        for number in range(len(path) - 1):
            found = self.first_on_segment(path[number], path[number + 1], within)
            if found is not None:
                point = path[number] + found[0] * (path[number + 1] - path[number])
                return self._hit(found[1], start, point, velocity, gravity)
        return None

    def is_free(self, start: np.ndarray, end: np.ndarray, without: int) -> bool:
        """Whether no wall except number `without` is between two points (3,) [m]."""
        within = self.near(np.array([start, end]))
        return self.first_on_segment(start, end, within[self.wall[within] != without]) is None

    def _hit(
        self, facet: int, start: np.ndarray, point: np.ndarray, velocity: np.ndarray, gravity: np.ndarray
    ) -> Hit:
        """The hit of a triangle; the velocity across gravity is constant, the energy gives that along
        gravity."""
        strength = float(np.linalg.norm(gravity))
        down = gravity / strength
        along = float(velocity @ down)
        fallen = np.sqrt(max(along**2 + 2.0 * strength * float((point - start) @ down), 0.0))
        origin, first, second = self.corners[facet]
        normal = np.cross(first - origin, second - origin)
        rising = along < 0.0 and float((point - start) @ down) < 0.0
        reached_down = -fallen if rising else fallen
        reached = velocity + (reached_down - along) * down
        return Hit(int(self.wall[facet]), point, reached, normal / np.linalg.norm(normal))

    def lowest(self, wall: int, up: np.ndarray) -> float:
        """Smallest height [m] of a wall along `up` (3,)."""
        return float((self.points[wall][0] @ up).min())

    def edges(self, wall: int, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (n, 3) [m] on the lowest edges of a wall, and horizontal unit vectors (n, 3) away from its
        center.

        Surfaces with openings also have vectors toward the center.
        Planes, which have no edges, have no points.
        """
        surface = self.walls[wall].surface
        if surface.plane is not None:
            return np.empty((0, 3)), np.empty((0, 3))
        points, corners = self.points[wall]
        height = points @ up
        is_low = height <= height.min() + 1e-6 * float(np.ptp(points, axis=0).max())
        pairs = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
        pairs = np.unique(np.sort(pairs[is_low[pairs].all(axis=1)], axis=1), axis=0)
        found = np.concatenate([points[is_low], points[pairs].mean(axis=1)])
        found = found[np.linspace(0, len(found) - 1, min(EDGE_SAMPLES, len(found))).astype(int)]
        outward = found - 0.5 * (points.min(axis=0) + points.max(axis=0))
        outward -= np.outer(outward @ up, up)
        length = np.linalg.norm(outward, axis=1)
        found = found[length > 0.0]
        outward = outward[length > 0.0] / length[length > 0.0][:, None]
        if surface.has_openings:
            return np.concatenate([found, found]), np.concatenate([outward, -outward])
        return found, outward


# Paths over the walls.

STEEP = 0.2
"""Cosine of the slope of walls on which particles do not slide: they fall further beside the wall."""
FALLS_PER_WALL = 4
"""Falls of a path per wall."""
HEIGHT_TOLERANCE = 1e-6
"""Relative tolerance of heights: a fall ends behind a floor at the lowest level."""
REVISIT_RATIO = 1.01
"""Ratio of squared velocities from which a further visit of a wall is followed."""
SAMPLES = 64
"""Number of particles of a group whose paths are computed."""


@dataclass(frozen=True)
class Path:
    """The fastest impact on the paths of a group.

    value:  squared velocity [m2/s2]
    walls:  names of the walls on the path, in order
    falls:  whether the path ends in a fall that no wall stops, instead of at the last wall
    """

    value: float
    walls: tuple[str, ...] = ()
    falls: bool = False


def _path_words(name: str, path: Path) -> str:
    """Words for the fall of a group along a path."""
    places = [f"walls.{each}" for each in dict.fromkeys(path.walls)]
    if path.falls:
        places.append("the lowest level")
    *over, end = places or [""]
    text = f"a fall of particles.{name}"
    if over:
        text += f" over {', '.join(over)}"
    if end:
        text += f" to {end}"
    return text


def _start_points(group: Group, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) [m] at which particles of a group start, in regions at the greatest height, and
    velocities."""
    region = region_of(group)
    if region is None:
        points = np.array(group.insert.points, float)
        velocities = np.broadcast_to(np.asarray(group.velocity, float), points.shape)
        some = np.argsort(-(points @ up), kind="stable")[:SAMPLES]
        return points[some], velocities[some]
    radius = min(0.5 * group.outer_diameters[0], region.radius_max)
    points = region.sample(np.full(SAMPLES, radius), np.random.default_rng(0))
    top = highest_point(group, up)
    assert top is not None
    points = points + np.outer(top - points @ up, up)
    return points, np.broadcast_to(np.asarray(group.velocity, float), points.shape)


def _space(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Corners (3,) [m] of the space in which particles exist: the domain, infinite along axes without an
    end."""
    low = np.array(scene.domain.min)
    high = np.array(scene.domain.max)
    margin = 1e-9 * (high - low)
    is_open = np.full(3, scene.domain.on_exit == "expand") | np.isin(list(AXES), list(scene.domain.periodic))
    return np.where(is_open, -np.inf, low - margin), np.where(is_open, np.inf, high + margin)


@dataclass(frozen=True)
class _Start:
    """Where a fall starts: point (3,) [m], velocity (3,) [m/s], names of the walls before."""

    point: np.ndarray
    velocity: np.ndarray
    walls: tuple[str, ...]


class FallingParticles:
    """Paths over walls at rest.

    gravity:  (3,) [m/s2]
    low:      height [m] against gravity at which all paths end
    radius:   distance [m] of particle centers from an edge over which they fall
    belts:    surface speed [m/s] of each wall
    bounds:   corners (3,) [m] of the space outside of which particles do not exist
    """

    def __init__(
        self,
        facets: WallFacets,
        gravity: np.ndarray,
        low: float,
        radius: float,
        belts: Sequence[float],
        bounds: tuple[np.ndarray, np.ndarray],
    ) -> None:
        self.facets = facets
        self.gravity = gravity
        self.low = low
        self.radius = radius
        self.belts = belts
        self.bounds = bounds
        self.strength = float(np.linalg.norm(gravity))
        self.up = -gravity / self.strength

    def fastest(self, points: np.ndarray, velocities: np.ndarray) -> Path:
        """The fastest impact of particles that start at points (n, 3) [m] with velocities (n, 3) [m/s]."""
        starts = [_Start(*both, ()) for both in zip(points, velocities, strict=True)]
        best = Path(0.0)
        visited = np.full(len(self.facets.walls), -1.0)
        for _ in range(FALLS_PER_WALL * len(visited) + 1):
            following: list[_Start] = []
            for start in starts:
                if self._largest(start) > best.value:
                    found, further = self._fall(start, visited)
                    best = max(best, found, key=lambda path: path.value)
                    following += further
            starts = following
        return best

    def _height(self, start: _Start) -> float:
        """Height [m] of a start above the lowest level."""
        return float(start.point @ self.up) - self.low

    def _largest(self, start: _Start) -> float:
        """Largest squared velocity [m2/s2] that can follow from a start; 0 outside the domain and at its
        bottom."""
        height = self._height(start)
        if height <= 0.0 or np.any(start.point < self.bounds[0]) or np.any(start.point > self.bounds[1]):
            return 0.0
        own = float(start.velocity @ start.velocity)
        return max(own, max(self.belts, default=0.0) ** 2) + 2.0 * self.strength * height

    def _fall(self, start: _Start, visited: np.ndarray) -> tuple[Path, list[_Start]]:
        """The fastest impact of one fall and the slide after it, and the starts of further falls."""
        height = self._height(start)
        hit = self.facets.first_hit(
            start.point, start.velocity, self.gravity, (1.0 + HEIGHT_TOLERANCE) * height
        )
        if hit is None:
            value = float(start.velocity @ start.velocity) + 2.0 * self.strength * height
            return Path(value, start.walls, falls=True), []
        walls = (*start.walls, self.facets.walls[hit.wall].name)
        slide, further = self._after(hit, walls, visited)
        return Path(max(float(hit.velocity @ hit.velocity), slide), walls), further

    def _after(self, hit: Hit, walls: tuple[str, ...], visited: np.ndarray) -> tuple[float, list[_Start]]:
        """Squared velocity [m2/s2] at the end of a slide, and the starts of further falls; updates
        `visited`."""
        tangential = hit.tangential_velocity
        is_below = float(hit.velocity @ self.up) > 0.0
        if abs(float(hit.normal @ self.up)) < STEEP or is_below:
            back = -np.sign(float(hit.velocity @ hit.normal)) * hit.normal
            return 0.0, [_Start(hit.point + 1e-3 * self.radius * back, tangential, walls[:-1])]
        end = max(self.facets.lowest(hit.wall, self.up), self.low)
        slid = max(float(hit.point @ self.up) - end, 0.0)
        value = float(tangential @ tangential) + 2.0 * self.strength * slid
        value = max(value, self.belts[hit.wall] ** 2)
        if value <= REVISIT_RATIO * visited[hit.wall]:
            return value, []
        visited[hit.wall] = value
        return value, self._over_edges(hit.wall, value, walls)

    def _over_edges(self, wall: int, value: float, walls: tuple[str, ...]) -> list[_Start]:
        """Falls over the lowest edges of a wall, at rest and with the squared velocity `value` [m2/s2]."""
        starts = []
        for point, outward in zip(*self.facets.edges(wall, self.up), strict=True):
            inside = point + self.radius * (self.up - outward)
            outside = point + self.radius * (self.up + outward)
            if self.facets.is_free(inside, outside, without=wall):
                speeds = sorted({0.0, float(np.sqrt(value))})
                starts += [_Start(point + self.radius * outward, speed * outward, walls) for speed in speeds]
        return starts
