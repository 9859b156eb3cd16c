"""Diameters drawn from the size distributions of the scene."""

import math
from statistics import NormalDist

import numpy as np

from granflow.scene.groups import ClassSizes, LogNormalSizes, NormalSizes, UniformSizes

SizeSpec = float | tuple[float, ...] | UniformSizes | NormalSizes | LogNormalSizes | ClassSizes


def draw_diameters(sizes: SizeSpec, count: int, random: np.random.Generator) -> np.ndarray:
    """Exactly `count` diameters (count,) [m] in random order; a list is taken as it stands.

    Cut-offs are those of the truncated distribution: what lies beyond is never drawn, nothing is moved onto them.
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


def truncated_normal(law: NormalDist, low: float, high: float, count: int, random: np.random.Generator) -> np.ndarray:
    """Values (count,) of a normal law given that they lie in [low, high], by the inverse of its distribution."""
    share = random.uniform(law.cdf(low), law.cdf(high), count)
    inside = np.clip(share, np.finfo(float).tiny, 1 - np.finfo(float).epsneg)  # inv_cdf is undefined at 0 and 1
    drawn = np.fromiter(map(law.inv_cdf, inside.tolist()), dtype=np.float64, count=count)
    return np.clip(drawn, low, high)


def class_counts(sizes: ClassSizes, count: int) -> np.ndarray:
    """How many particles (k,) of each class: whole numbers with the sum `count`, by the largest remainders.

    Shares by mass become shares by number through the volume: n_i ~ fraction_i / diameter_i^3.
    """
    share = np.array([each.fraction for each in sizes.classes])
    if sizes.by == "mass":
        share = share / np.array([each.diameter for each in sizes.classes]) ** 3
    exact = count * share / share.sum()
    whole = np.floor(exact).astype(np.int64)
    most_missed = np.argsort(whole - exact, kind="stable")
    whole[most_missed[: count - whole.sum()]] += 1
    return whole
