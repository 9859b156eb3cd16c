"""Impact velocities on the paths of particles that fall onto walls and slide over their edges.

A particle falls from its insertion along a parabola onto the first wall. The impact ends its velocity across the wall;
that along the wall remains and grows without friction down to the lowest edges, over which the particle falls further:

    v1^2 = v0^2 + 2 g h1                       impact after a fall by h1
    v2^2 = |v1 - (v1.n) n|^2 + 2 g h2          slide by the height h2 of a wall with the normal n

Bounces are neglected.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from granflow.plan.forecast.wall_facets import Hit, WallFacets

STEEP = 0.2
"""Cosine of the slope of walls on which particles do not slide: they fall further beside the wall."""

ROUNDS = 4
"""Falls of a path per wall."""

EPSILON = 1e-6
"""Relative tolerance of heights: a fall ends behind a floor at the lowest level."""

MORE = 1.01
"""Ratio of squared velocities from which a further visit of a wall is followed."""


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
        self.facets, self.gravity, self.low, self.radius, self.belts = facets, gravity, low, radius, belts
        self.bounds = bounds
        self.strength = float(np.linalg.norm(gravity))
        self.up = -gravity / self.strength

    def fastest(self, points: np.ndarray, velocities: np.ndarray) -> Path:
        """The fastest impact of particles that start at points (n, 3) [m] with velocities (n, 3) [m/s]."""
        starts = [_Start(*both, ()) for both in zip(points, velocities, strict=True)]
        best, visited = Path(0.0), np.full(len(self.facets.walls), -1.0)
        for _ in range(ROUNDS * len(visited) + 1):
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
        """Largest squared velocity [m2/s2] that can follow from a start; 0 outside the domain and at its bottom."""
        height = self._height(start)
        if height <= 0.0 or np.any(start.point < self.bounds[0]) or np.any(start.point > self.bounds[1]):
            return 0.0
        own = float(start.velocity @ start.velocity)
        return max(own, max(self.belts, default=0.0) ** 2) + 2.0 * self.strength * height

    def _fall(self, start: _Start, visited: np.ndarray) -> tuple[Path, list[_Start]]:
        """The fastest impact of one fall and the slide after it, and the starts of further falls."""
        height = self._height(start)
        hit = self.facets.first_hit(start.point, start.velocity, self.gravity, (1.0 + EPSILON) * height)
        if hit is None:
            value = float(start.velocity @ start.velocity) + 2.0 * self.strength * height
            return Path(value, start.walls, falls=True), []
        walls = (*start.walls, self.facets.walls[hit.wall].name)
        slide, further = self._after(hit, walls, visited)
        return Path(max(float(hit.velocity @ hit.velocity), slide), walls), further

    def _after(self, hit: Hit, walls: tuple[str, ...], visited: np.ndarray) -> tuple[float, list[_Start]]:
        """Squared velocity [m2/s2] at the end of a slide, and the starts of further falls; updates `visited`."""
        tangential = hit.tangential_velocity
        is_below = float(hit.velocity @ self.up) > 0.0
        if abs(float(hit.normal @ self.up)) < STEEP or is_below:
            back = -np.sign(float(hit.velocity @ hit.normal)) * hit.normal
            return 0.0, [_Start(hit.point + 1e-3 * self.radius * back, tangential, walls[:-1])]
        end = max(self.facets.lowest(hit.wall, self.up), self.low)
        slid = max(float(hit.point @ self.up) - end, 0.0)
        value = float(tangential @ tangential) + 2.0 * self.strength * slid
        value = max(value, self.belts[hit.wall] ** 2)
        if value <= MORE * visited[hit.wall]:
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
