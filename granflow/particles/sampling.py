"""Sampling of particles: diameters from size distributions, and centers in insertion regions.

Numbers of particles, not masses, follow a size distribution, except for classes with fractions by mass.
Centers are sampled so that the spheres lie entirely in a box, a cylinder or a slab.
"""

import math
from collections.abc import Callable
from statistics import NormalDist
from typing import Protocol

import numpy as np

from granflow.geometry.shape import frame_along
from granflow.scene.blocks.particles import (
    BoxRegion,
    ClassSizes,
    CylinderRegion,
    LogNormalSizes,
    NormalSizes,
    SizeSpec,
    UniformSizes,
)


def draw_diameters(sizes: SizeSpec, count: int, random: np.random.Generator) -> np.ndarray:
    """Exactly `count` diameters (count,) [m] in random order; a list keeps its order.

    Normal and log-normal distributions are truncated: values beyond the limits are excluded, not clamped. A
    single diameter is repeated. Classes have the exact number of `class_counts`. float64.
    """
    if isinstance(sizes, ClassSizes):
        diameter = np.array([each.diameter for each in sizes.classes])
        return random.permutation(np.repeat(diameter, class_counts(sizes, count)))
    if isinstance(sizes, UniformSizes):
        return random.uniform(sizes.min, sizes.max, count)
    if isinstance(sizes, NormalSizes):
        return truncated_normal(NormalDist(sizes.mean, sizes.deviation), sizes.min, sizes.max, count, random)
    if isinstance(sizes, LogNormalSizes):
        logarithm = NormalDist(math.log(sizes.median), sizes.sigma)
        low, high = math.log(sizes.min), math.log(sizes.max)
        drawn = np.exp(truncated_normal(logarithm, low, high, count, random))
        return np.clip(drawn, sizes.min, sizes.max)  # exp(log(max)) may round to beyond max
    return np.broadcast_to(np.asarray(sizes, dtype=np.float64), (count,)).copy()


def truncated_normal(
    normal: NormalDist, low: float, high: float, count: int, random: np.random.Generator
) -> np.ndarray:
    """Values (count,) of a normal distribution truncated to [low, high].

        x = F^-1(u),      u uniform in [F(low), F(high)]

    F: distribution function of `normal`. One uniform number per value, so that no value is rejected.
    """
    share = random.uniform(normal.cdf(low), normal.cdf(high), count)
    inside = np.clip(
        share, np.finfo(float).tiny, 1 - np.finfo(float).epsneg
    )  # inv_cdf is undefined at 0 and 1
    drawn = np.fromiter(map(normal.inv_cdf, inside.tolist()), dtype=np.float64, count=count)
    return np.clip(drawn, low, high)


def class_counts(sizes: ClassSizes, count: int) -> np.ndarray:
    """Number of particles (k,) of each class: integers with the sum `count`, by the largest-remainder
    method."""
    exact = count * number_shares(sizes)
    whole = np.floor(exact).astype(np.int64)
    largest_remainders = np.argsort(whole - exact, kind="stable")
    whole[largest_remainders[: count - whole.sum()]] += 1
    return whole


def number_shares(sizes: ClassSizes) -> np.ndarray:
    """Number fractions (k,) of the classes, with the sum 1.

    Mass fractions w of classes with diameter d are converted by n ~ w / d^3.
    """
    share = np.array([each.fraction for each in sizes.classes])
    if sizes.by == "mass":
        share = share / np.array([each.diameter for each in sizes.classes]) ** 3
    return np.asarray(share / share.sum())


def ordered_diameters(sizes: SizeSpec, count: int, random: np.random.Generator) -> np.ndarray:
    """Diameters (count,) [m] in the order of insertion; classes alternate, so that their fractions are
    constant.

    Particle j of the n particles of a class is at the fraction (j + 1/2) / n of the sequence.
    """
    if not isinstance(sizes, ClassSizes):
        return draw_diameters(sizes, count, random)
    counts = class_counts(sizes, count)
    rank = np.concatenate([(np.arange(n) + 0.5) / n for n in counts if n])
    diameter = np.repeat([each.diameter for each in sizes.classes], counts)
    return diameter[np.argsort(rank, kind="stable")]


MAX_COUNTED = 10_000_000
"""Largest count that is derived from a mass by summation; larger counts follow from the mean of a sample."""
SAMPLE = 10_000
"""Number of diameters in a sample from which the mean cube is estimated."""


def count_for_volume(sizes: SizeSpec, cubes: float, random: Callable[[], np.random.Generator]) -> int:
    """Number of diameters from `draw_diameters` whose sum of cubes is nearest to `cubes` [m3]; at least 1.

    `random` returns a new generator with the seed of the later draw at each call, so that the sum is that of
    the later particles. Above MAX_COUNTED particles, and for one size, the count follows from the mean cube.
    """
    if isinstance(sizes, ClassSizes):
        return max(round(min(cubes / mean_cube(sizes), 1e18)), 1)
    sample = draw_diameters(sizes, SAMPLE, random())
    guess = min(cubes / float(np.mean(sample**3)), 1e18)
    if guess > MAX_COUNTED or isinstance(sizes, float):
        return max(round(guess), 1)
    total = np.cumsum(draw_diameters(sizes, int(1.5 * guess) + SAMPLE, random()) ** 3)
    return int(np.abs(total - cubes).argmin()) + 1


def mean_cube(sizes: ClassSizes) -> float:
    """Mean cube of the diameter of size classes, weighted by number [m3]."""
    share = number_shares(sizes)
    return float(share @ np.array([each.diameter for each in sizes.classes]) ** 3)


SLACK = 1e-9
"""Relative tolerance for exact fits, such as ten spheres of 1 mm across 10 mm."""


class RegionSampler(Protocol):
    """An insertion region; arguments are points (n, 3) [m] and radii (n,) [m].

    `volume` [m3]; `radius_max` [m]: radius of the largest sphere that fits.
    """

    volume: float
    radius_max: float

    def sample(self, radius: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """Uniformly distributed centers (n, 3) [m] with each sphere entirely inside.

        `radius` (n,) [m]: each at most `radius_max`. Spheres may overlap each other.
        """

    def reaches(self, points: np.ndarray, reach: np.ndarray) -> np.ndarray:
        """Whether spheres of radius `reach` (n,) [m] around the points may intersect the region; no false
        negatives."""


class BoxSampler:
    """A box with edges along the coordinate axes from `low` to `high` (3,) [m]."""

    def __init__(self, low: np.ndarray, high: np.ndarray) -> None:
        self.low = np.asarray(low, dtype=np.float64)
        self.high = np.asarray(high, dtype=np.float64)
        self.volume = float(np.prod(self.high - self.low))
        self.radius_max = float((self.high - self.low).min()) / 2

    def sample(self, radius: np.ndarray, random: np.random.Generator) -> np.ndarray:
        margin = radius[:, None]
        return self.low + margin + random.random((len(radius), 3)) * (self.high - self.low - 2 * margin)

    def confine(self, points: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """The nearest centers (n, 3) [m] with the spheres of radii (n,) [m] entirely inside."""
        return np.clip(points, self.low + radius[:, None], self.high - radius[:, None])

    def sites(self, spacing: float, margin: float, jitter: float) -> tuple[np.ndarray, np.ndarray]:
        """Centers (n, 3) [m] of a lattice with cells not smaller than `spacing`, and displacement vectors (3,
        3) [m].

        Spheres of radius `margin` remain inside after a displacement by any sum of the vectors (rows) times
        numbers in [-1, 1]. Order: in layers from the bottom of the box. The cells are stretched to fill the
        box.
        """
        size = self.high - self.low
        cells = np.floor(size / spacing * (1 + SLACK)).astype(int)
        cell = size / np.maximum(cells, 1)
        z, y, x = np.meshgrid(*(np.arange(n) + 0.5 for n in cells[::-1]), indexing="ij")
        centers = self.low + np.stack([x, y, z], axis=-1).reshape(-1, 3) * cell
        return centers, np.diag(jitter * np.maximum(cell / 2 - margin, 0.0))

    def reaches(self, points: np.ndarray, reach: np.ndarray) -> np.ndarray:
        margin = reach[:, None]
        return np.all((points > self.low - margin) & (points < self.high + margin), axis=1)


class CylinderSampler:
    """A solid cylinder of `radius` [m] between the two ends (3,) [m] of its axis.

    `frame` (3, 3): rows are the local axes; the last is the axis of the cylinder.
    """

    def __init__(self, start: np.ndarray, end: np.ndarray, radius: float) -> None:
        self.start = np.asarray(start, dtype=np.float64)
        along = np.asarray(end, dtype=np.float64) - self.start
        self.length = float(np.linalg.norm(along))
        self.radius = radius
        self.volume = float(np.pi * radius**2 * self.length)
        self.radius_max = min(radius, self.length / 2)
        self.frame = frame_along(along / self.length)

    def to_local(self, points: np.ndarray) -> np.ndarray:
        """Local coordinates (n, 3) [m]: two perpendicular to the axis, the third along it."""
        return (points - self.start) @ self.frame.T

    def from_local(self, local: np.ndarray) -> np.ndarray:
        """Points (n, 3) [m] from local coordinates (n, 3) [m]: the inverse of `to_local`."""
        return self.start + local @ self.frame

    def sample(self, radius: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """As in `RegionSampler`; the distance from the axis is (R - r) sqrt(u), with u uniform in [0, 1]."""
        share, turn, height = random.random((3, len(radius)))
        r = (self.radius - radius) * np.sqrt(share)
        angle = 2 * np.pi * turn
        z = radius + height * (self.length - 2 * radius)
        return self.from_local(np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1))

    def confine(self, points: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """As of `BoxSampler`."""
        local = self.to_local(points)
        r = np.linalg.norm(local[:, :2], axis=1)
        clearance = self.radius - radius
        outside = r > clearance
        local[outside, :2] *= (clearance[outside] / r[outside])[:, None]
        local[:, 2] = np.clip(local[:, 2], radius, self.length - radius)
        return self.from_local(local)

    def sites(self, spacing: float, margin: float, jitter: float) -> tuple[np.ndarray, np.ndarray]:
        """As of `BoxSampler`; layers from the start of the axis are square lattices, stretched to fill the
        length."""
        axes = int(2 * self.radius / spacing * (1 + SLACK))
        layers = int(self.length / spacing * (1 + SLACK))
        height = self.length / max(layers, 1)
        shift = jitter * np.maximum(np.array([spacing, spacing, height]) / 2 - margin, 0.0)
        step = (np.arange(axes) - (axes - 1) / 2) * spacing
        z, y, x = np.meshgrid((np.arange(layers) + 0.5) * height, step, step, indexing="ij")
        farthest = np.hypot(np.abs(x) + shift[0], np.abs(y) + shift[1])
        fits = farthest + margin <= self.radius * (1 + SLACK)
        return self.from_local(np.stack([x, y, z], axis=-1)[fits]), shift[:, None] * self.frame

    def reaches(self, points: np.ndarray, reach: np.ndarray) -> np.ndarray:
        local = self.to_local(points)
        is_within_radius = np.linalg.norm(local[:, :2], axis=1) < self.radius + reach
        return is_within_radius & (local[:, 2] > -reach) & (local[:, 2] < self.length + reach)


class SlabSampler:
    """A box on a rectangle of any orientation: `depth` [m] along the cross product of the two sides.

    `corner` (3,) [m]; `first`, `second` (3,) [m]: perpendicular edge vectors.
    """

    def __init__(self, corner: np.ndarray, first: np.ndarray, second: np.ndarray, depth: float) -> None:
        lengths = np.array([np.linalg.norm(first), np.linalg.norm(second)])
        axes = first / lengths[0], second / lengths[1]
        self.corner = corner
        self.frame = np.array([*axes, np.cross(*axes)])
        self.box = BoxSampler(np.zeros(3), np.array([*lengths, depth]))
        self.volume = self.box.volume
        self.radius_max = self.box.radius_max

    def sample(self, radius: np.ndarray, random: np.random.Generator) -> np.ndarray:
        return np.asarray(self.corner + self.box.sample(radius, random) @ self.frame)

    def reaches(self, points: np.ndarray, reach: np.ndarray) -> np.ndarray:
        return self.box.reaches((points - self.corner) @ self.frame.T, reach)


def sampler_of(region: BoxRegion | CylinderRegion) -> BoxSampler | CylinderSampler:
    """The sampler of a region in the scene, in SI units."""
    if isinstance(region, BoxRegion):
        return BoxSampler(np.array(region.box.min), np.array(region.box.max))
    tube = region.cylinder
    return CylinderSampler(np.array(tube.from_), np.array(tube.to), tube.radius)
