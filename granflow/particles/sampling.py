"""Sampling of particles: diameters from size distributions, and centers in insertion regions.

Numbers of particles, not masses, follow a size distribution, except for classes with fractions by mass.
Centers are sampled so that the spheres lie entirely in a box, a cylinder or a slab.
"""

import math
from collections.abc import Callable
from statistics import NormalDist

import numpy as np

from granflow.scene.blocks.particles import (
    ClassSizes,
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
