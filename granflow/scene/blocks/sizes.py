"""Schema of the key `diameter` of a group: one diameter, one per particle, or a size distribution.

A distribution is one class: its keys, its checks, and how diameters are drawn. Numbers of particles, not
masses, follow a distribution, except for classes with fractions by mass. Normal and log-normal distributions
are truncated: values beyond the limits are excluded, not clamped.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from statistics import NormalDist
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Field

from granflow.schema import quantities as q
from granflow.schema.faults import Fault, whole_error
from granflow.schema.model import ListOf, Model, choose_by_key

MAX_COUNTED = 10_000_000
"""Largest count that is derived from a mass by summation; larger counts follow from the mean of a sample."""
SAMPLE = 10_000
"""Number of diameters in a sample from which the mean cube is estimated."""


class SizeDistribution:
    """Diameters of the particles of a group [m]. Base class of the distributions.

    has_classes:  whether there is a number of particles of each of some diameters
    """

    has_classes: ClassVar[bool] = False

    @property
    def is_single(self) -> bool:
        """Whether all particles have one diameter."""
        return False

    def spans(self) -> list[tuple[float, float]]:
        """Ranges of the diameters [m] in ascending order; one range for a continuous distribution."""
        raise NotImplementedError

    def draw(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Exactly `count` diameters (count,) [m] in random order; float64."""
        raise NotImplementedError

    def sample(self, count: int, random: np.random.Generator) -> np.ndarray:
        """At most `count` diameters [m] that represent the distribution."""
        return self.draw(count, random)

    def ordered(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Diameters (count,) [m] in the order of insertion."""
        return self.draw(count, random)

    def count_for_volume(self, cubes: float, random: Callable[[], np.random.Generator]) -> int:
        """Number of diameters from `draw` whose sum of cubes is nearest to `cubes` [m3]; at least 1.

        `random` returns a new generator with the seed of the later draw at each call, so that the sum is that
        of the later particles. Above MAX_COUNTED particles, and for one size, the count follows from the mean
        cube.
        """
        sample = self.draw(SAMPLE, random())
        guess = min(cubes / float(np.mean(sample**3)), 1e18)
        if guess > MAX_COUNTED or self.is_single:
            return max(round(guess), 1)
        total = np.cumsum(self.draw(int(1.5 * guess) + SAMPLE, random()) ** 3)
        return int(np.abs(total - cubes).argmin()) + 1


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


class TruncatedSizes(SizeDistribution, Model):
    """A size distribution that is truncated to an interval: diameters outside [`min`, `max`] do not occur
    [m]."""

    min: q.Diameter = Field(description="smallest diameter [m]", examples=["1 mm"])
    max: q.Diameter = Field(description="largest diameter [m]", examples=["8 mm"])

    def spans(self) -> list[tuple[float, float]]:
        """The interval."""
        return [(self.min, self.max)]

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the largest diameter exceeds the smallest."""
        if self.max <= self.min:
            yield Fault(("max",), f"it must be above min, {self.min:g} m")

    def _center_fault(self, key: str, value: float) -> Iterator[Fault]:
        """Yield a fault unless the mean or median [m] lies between the limits."""
        if self.min < self.max and not self.min < value < self.max:
            yield Fault((key,), f"it must lie between min and max, {self.min:g} and {self.max:g} m")


class UniformSizes(TruncatedSizes):
    """Uniformly distributed diameters from `min` to `max` [m].

    >>> gf.UniformSizes(min="3 mm", max="5 mm")
    UniformSizes(min=0.003, max=0.005)
    """

    distribution: Literal["uniform"] = Field("uniform", description="kind of size distribution")

    def draw(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Diameters (count,) [m]."""
        return random.uniform(self.min, self.max, count)


class NormalSizes(TruncatedSizes):
    """Normally distributed diameters [m], truncated to [`min`, `max`]: values outside do not occur.

    >>> gf.NormalSizes(mean="4 mm", deviation="0.5 mm", min="3 mm", max="5 mm").mean
    0.004
    """

    distribution: Literal["normal"] = Field("normal", description="kind of size distribution")
    mean: q.Diameter = Field(description="mean diameter before truncation [m]")
    deviation: q.UnscaledLength = Field(description="standard deviation before truncation [m]")

    def faults(self) -> Iterator[Fault]:
        yield from super().faults()
        yield from self._center_fault("mean", self.mean)

    def draw(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Diameters (count,) [m]."""
        return truncated_normal(NormalDist(self.mean, self.deviation), self.min, self.max, count, random)


class LogNormalSizes(TruncatedSizes):
    """Log-normally distributed diameters [m], truncated to [`min`, `max`]: values outside do not occur.

    >>> gf.LogNormalSizes(median="4 mm", sigma=0.2, min="2 mm", max="8 mm").sigma
    0.2
    """

    distribution: Literal["log_normal"] = Field("log_normal", description="kind of size distribution")
    median: q.Diameter = Field(description="median diameter before truncation [m]", examples=["2 mm"])
    sigma: q.Positive = Field(
        description="standard deviation of ln(diameter) before truncation", examples=[0.3]
    )

    def faults(self) -> Iterator[Fault]:
        yield from super().faults()
        yield from self._center_fault("median", self.median)

    def draw(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Diameters (count,) [m]."""
        logarithm = NormalDist(math.log(self.median), self.sigma)
        low, high = math.log(self.min), math.log(self.max)
        drawn = np.exp(truncated_normal(logarithm, low, high, count, random))
        return np.clip(drawn, self.min, self.max)  # exp(log(max)) may round to beyond max


class SizeClass(Model):
    """One diameter and its fraction of all particles.

    >>> gf.SizeClass(diameter="4 mm", fraction=0.5)
    SizeClass(diameter=0.004, fraction=0.5)
    """

    diameter: q.Diameter = Field(description="diameter [m]")
    fraction: q.Share = Field(description="fraction of this class; the fractions are normalized to the sum 1")


_ROUNDING = 1e-12  # tolerance of the sum of the fractions


def _scaled(classes: tuple[SizeClass, ...]) -> tuple[SizeClass, ...]:
    """The classes with fractions normalized to the sum 1; those that are normalized remain unchanged.

    Raises PydanticCustomError if all fractions are 0.
    """
    total = sum(each.fraction for each in classes)
    if total == 0:
        raise whole_error("has only fractions of 0; give at least one class a fraction above 0")
    if abs(total - 1) <= _ROUNDING:
        return classes
    return tuple(SizeClass(diameter=each.diameter, fraction=each.fraction / total) for each in classes)


Classes = Annotated[
    tuple[SizeClass, ...], ListOf(some="[{diameter: 4 mm, fraction: 1}]"), AfterValidator(_scaled)
]
"""List of diameters with fractions, which are normalized to the sum 1."""


class ClassSizes(SizeDistribution, Model):
    """A list of diameters with their fractions by number or by mass. The reader normalizes the fractions.

    The number of particles of each class is exact to one particle.

    >>> sizes = [gf.SizeClass(diameter=0.004, fraction=1), gf.SizeClass(diameter=0.006, fraction=3)]
    >>> gf.ClassSizes(by="mass", classes=sizes).classes[1].fraction
    0.75
    """

    distribution: Literal["classes"] = Field("classes", description="kind of size distribution")
    by: Literal["number", "mass"] = Field(
        description="number: fractions of the particle count; mass: fractions of the mass"
    )
    classes: Classes = Field(description="list of {diameter, fraction}")
    has_classes: ClassVar[bool] = True

    @property
    def diameters(self) -> np.ndarray:
        """Diameters (k,) [m] of the classes."""
        return np.array([each.diameter for each in self.classes])

    @property
    def number_shares(self) -> np.ndarray:
        """Number fractions (k,) of the classes, with the sum 1.

        Mass fractions w of classes with diameter d are converted by n ~ w / d^3.
        """
        share = np.array([each.fraction for each in self.classes])
        if self.by == "mass":
            share = share / self.diameters**3
        return np.asarray(share / share.sum())

    def counts(self, count: int) -> np.ndarray:
        """Number of particles (k,) of each class: integers with the sum `count`, by the largest-remainder
        method."""
        exact = count * self.number_shares
        whole = np.floor(exact).astype(np.int64)
        largest_remainders = np.argsort(whole - exact, kind="stable")
        whole[largest_remainders[: count - whole.sum()]] += 1
        return whole

    def spans(self) -> list[tuple[float, float]]:
        """The diameters of the classes that occur."""
        used = [each.diameter for each in self.classes if each.fraction > 0.0]
        return [(each, each) for each in sorted(used)]

    def draw(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Diameters (count,) [m], with the exact number of each class."""
        return random.permutation(np.repeat(self.diameters, self.counts(count)))

    def ordered(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Diameters (count,) [m] in the order of insertion: classes alternate, with constant fractions.

        Particle j of a class with the share s by number is at the place (j + 1/2) / s of the sequence, which
        does not depend on the count: a flow that lasts longer begins with the same particles.
        """
        shares = self.number_shares
        counts = np.ceil((count + len(shares)) * shares).astype(int)
        places = [(np.arange(n) + 0.5) / share for n, share in zip(counts, shares, strict=True)]
        return np.repeat(self.diameters, counts)[np.argsort(np.concatenate(places), kind="stable")][:count]

    def count_for_volume(self, cubes: float, random: Callable[[], np.random.Generator]) -> int:
        """See `SizeDistribution`; from the mean cube, weighted by number [m3]."""
        mean_cube = float(self.number_shares @ self.diameters**3)
        return max(round(min(cubes / mean_cube, 1e18)), 1)


@dataclass(frozen=True)
class GivenSizes(SizeDistribution):
    """Diameters [m] as numbers: one for all particles, or one for each."""

    diameters: float | tuple[float, ...]

    @property
    def is_single(self) -> bool:
        """Whether all particles have one diameter."""
        return isinstance(self.diameters, float)

    def spans(self) -> list[tuple[float, float]]:
        """The diameters."""
        given = self.diameters if isinstance(self.diameters, tuple) else (self.diameters,)
        return [(each, each) for each in sorted(set(given))]

    def draw(self, count: int, random: np.random.Generator) -> np.ndarray:
        """The diameters (count,) [m] as given."""
        return np.broadcast_to(np.asarray(self.diameters, dtype=np.float64), (count,)).copy()

    def sample(self, count: int, random: np.random.Generator) -> np.ndarray:
        """All diameters, or the one."""
        return self.draw(len(self.diameters) if isinstance(self.diameters, tuple) else count, random)


Sizes = Annotated[
    q.Diameter | tuple[q.Diameter, ...] | UniformSizes | NormalSizes | LogNormalSizes | ClassSizes | None,
    choose_by_key("distribution"),
]
"""Diameters as in a scene; None if a file defines them."""
