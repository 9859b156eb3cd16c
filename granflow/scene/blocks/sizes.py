"""Schema of the key `diameter` of a group: one diameter, one per particle, or a size distribution.

A distribution is one class: its keys, its checks, and how diameters are drawn. Uniform and normal
distributions are those of the numbers of particles; log-normal ones and classes of numbers or masses; sieve
curves and Rosin-Rammler distributions of masses. Distributions with limits are truncated: values beyond them
are excluded, not clamped.
"""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import NormalDist
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Field

from granflow.errors import FileError
from granflow.io.tables import UNIT, Table, read_table, unit_factor
from granflow.schema import quantities as q
from granflow.schema.faults import Fault, missing, whole_error
from granflow.schema.model import FileName, ListOf, Model, choose_by_key
from granflow.schema.quantities import LARGEST, SMALLEST

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
    def source(self) -> str | None:
        """Path of the file with the distribution, relative to the folder of the scene; None without one."""
        return None

    @property
    def is_read(self) -> bool:
        """Whether the content of the file is known; without a file, true."""
        return True

    def with_source(self, path: str) -> "SizeDistribution":
        """This distribution with another path of its file; a run saves a copy of the file."""
        raise NotImplementedError

    def read(self, path: Path) -> "SizeDistribution":
        """This distribution with the content of its file.

        Raises OSError if the file cannot be read, and FileError with its invalid rows.
        """
        raise NotImplementedError

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

    By mass, the numbers follow the log-normal distribution with the median multiplied by exp(-3 sigma^2)
    (Hatch & Choate 1929, J. Franklin Inst. 207, 369-387).

    >>> gf.LogNormalSizes(median="4 mm", sigma=0.2, min="2 mm", max="8 mm").sigma
    0.2
    """

    distribution: Literal["log_normal"] = Field("log_normal", description="kind of size distribution")
    median: q.Diameter = Field(description="median diameter before truncation [m]", examples=["2 mm"])
    sigma: q.Positive = Field(
        description="standard deviation of ln(diameter) before truncation", examples=[0.3]
    )
    by: Literal["number", "mass"] = Field(
        "number", description="number: the numbers of particles are log-normal; mass: their masses"
    )

    def faults(self) -> Iterator[Fault]:
        yield from super().faults()
        yield from self._center_fault("median", self.median)

    def draw(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Diameters (count,) [m]."""
        shift = 3.0 * self.sigma**2 if self.by == "mass" else 0.0
        logarithm = NormalDist(math.log(self.median) - shift, self.sigma)
        low, high = math.log(self.min), math.log(self.max)
        drawn = np.exp(truncated_normal(logarithm, low, high, count, random))
        return np.clip(drawn, self.min, self.max)  # exp(log(max)) may round to beyond max


BLOCK = 1024
"""Number of diameters among which each equal share of a distribution by mass occurs exactly once."""


def stratified(count: int, random: np.random.Generator) -> np.ndarray:
    """Uniform numbers (count,) in [0, 1): one in each of BLOCK equal intervals, in random order, then again.

    The large particles of a distribution by mass are few, so that independent numbers would scatter about its
    mass curve. The first numbers do not depend on the count.
    """
    blocks = [(random.permutation(BLOCK) + random.random(BLOCK)) / BLOCK for _ in range(0, count, BLOCK)]
    return np.concatenate(blocks)[:count] if blocks else np.zeros(0)


class RosinRammlerSizes(TruncatedSizes):
    """Diameters [m] whose mass follows Rosin, Rammler & Sperling, truncated to [`min`, `max`].

        mass share finer than d = 1 - exp(-(d / size)^spread) before truncation

    Rosin & Rammler 1933, J. Inst. Fuel 7, 29-36.

    >>> gf.RosinRammlerSizes(size="2 mm", spread=3, min="0.5 mm", max="4 mm").spread
    3.0
    """

    distribution: Literal["rosin_rammler"] = Field("rosin_rammler", description="kind of size distribution")
    size: q.Diameter = Field(description="diameter below which 63.2 % of the mass is, before truncation [m]")
    spread: q.Positive = Field(description="exponent: larger for a narrower distribution", examples=[3])

    def draw(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Diameters (count,) [m]; the inverse of the share by number, from a table with TABLE entries.

        The share by number of sizes between d and d + dd is proportional to d^(n - 4) exp(-(d/size)^n) dd.
        """
        grid = np.geomspace(self.min, self.max, TABLE)
        relative = grid / self.size
        exponent = (self.spread - 3.0) * np.log(relative) - relative**self.spread
        density = np.exp(exponent - exponent.max())  # per ln(d)
        share = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
        drawn = np.interp(stratified(count, random) * share[-1], share, np.log(grid))
        return np.clip(np.exp(drawn), self.min, self.max)


TABLE = 20_000
"""Number of entries of the table of a distribution without a closed inverse."""


class Sieve(Model):
    """The opening of a sieve and the share of the mass that passes it.

    >>> gf.Sieve(opening="2 mm", passing=0.3)
    Sieve(opening=0.002, passing=0.3)
    """

    opening: q.Diameter = Field(description="opening [m]")
    passing: q.Share = Field(description="share of the mass that is finer, from 0 to 1")


class SieveSizes(SizeDistribution, Model):
    """A sieve curve: the cumulative mass that passes each sieve; linear in the diameter between two sieves.

    The smallest sieve passes nothing, the largest one everything. The curve is given in the scene, or in a
    CSV file with a row for each sieve.

    >>> curve = [{"opening": "1 mm", "passing": 0}, {"opening": "2 mm", "passing": 0.3},
    ...          {"opening": "4 mm", "passing": 1}]
    >>> gf.SieveSizes(sieves=curve).sieves[1].opening
    0.002
    """

    distribution: Literal["sieve"] = Field("sieve", description="kind of size distribution")
    file: FileName | None = Field(
        None,
        description=(
            "CSV file with the columns opening (or aperture, size) and passing (cumulative) or mass "
            "(retained on each sieve), such as opening [mm], passing [%]; path relative to the folder of the "
            "scene"
        ),
        examples=["sieve_analysis.csv"],
    )
    sieves: Annotated[tuple[Sieve, ...], ListOf(some="[{opening: 1 mm, passing: 0}, ...]")] | None = Field(
        None,
        description=(
            "list of {opening, passing}, from the smallest opening to the largest; instead of a file, or "
            "from it"
        ),
    )

    @property
    def curve(self) -> tuple[Sieve, ...]:
        """The sieves in ascending order. Raises ValueError if the file is not read yet."""
        if self.sieves is None:
            raise ValueError("The sieve curve is not read; see granflow.particles.resolve.")
        return self.sieves

    @property
    def source(self) -> str | None:
        """Path of the CSV file."""
        return self.file

    @property
    def is_read(self) -> bool:
        """Whether the sieves are known."""
        return self.sieves is not None

    def with_source(self, path: str) -> "SieveSizes":
        """See `SizeDistribution`."""
        return self.model_copy(update={"file": path})

    def read(self, path: Path) -> "SieveSizes":
        """See `SizeDistribution`."""
        return self.model_copy(update={"sieves": _sieves_in(path)})

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless openings and shares increase, from the share 0 to 1."""
        if self.sieves is not None:
            for index, key, reason in _curve_faults(self.sieves):
                yield Fault(("sieves", index, key), reason)
        elif self.file is None:
            yield missing(("sieves",), "list of {opening, passing}; or give file")

    def spans(self) -> list[tuple[float, float]]:
        """The ranges between sieves of which the lower one retains something."""
        ranges = [(a.opening, b.opening) for a, b in pairwise(self.curve) if b.passing > a.passing]
        joined = ranges[:1]
        for low, high in ranges[1:]:
            if low == joined[-1][1]:
                joined[-1] = (joined[-1][0], high)
            else:
                joined.append((low, high))
        return joined

    def draw(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Diameters (count,) [m].

        Between the sieves a and b with the mass share w, the number of particles is proportional to
        w (a^-2 - b^-2) / (2 (b - a)), and d^-2 is uniform.
        """
        opening = np.array([each.opening for each in self.curve])
        low, high = opening[:-1] ** -2.0, opening[1:] ** -2.0
        mass = np.diff([each.passing for each in self.curve])
        number = np.cumsum(mass * (low - high) / np.diff(opening))
        share = stratified(count, random) * number[-1]
        between = np.minimum(np.searchsorted(number, share, side="right"), len(mass) - 1)
        before = np.concatenate([[0.0], number])[between]
        within = (share - before) / (number[between] - before)
        drawn = (low[between] - within * (low - high)[between]) ** -0.5
        return np.clip(drawn, opening[between], opening[between + 1])


def _curve_faults(sieves: Sequence[Sieve]) -> Iterator[tuple[int, str, str]]:
    """Index, key and reason of each value that is not part of a sieve curve."""
    if sieves[0].passing != 0.0:
        reason = "the smallest sieve must pass 0; add a sieve with the smallest diameter of the particles"
        yield 0, "passing", reason
    for index, (before, now) in enumerate(pairwise(sieves), 1):
        if now.opening <= before.opening:
            reason = f"openings must increase, and the one before it is {before.opening:g} m"
            yield index, "opening", reason
        if now.passing < before.passing:
            reason = f"the next smaller sieve passes {100 * before.passing:g} %; shares must not decrease"
            yield index, "passing", reason
    if sieves[-1].passing != 1.0:
        reason = (
            "the largest sieve must pass 1 (100 %); add a sieve with the largest diameter of the particles"
        )
        yield len(sieves) - 1, "passing", reason


# Sieve curves in CSV files

MOST_SIEVES = 1000
"""Largest number of rows of a file: a run saves them in its scene."""
SIEVE_COLUMNS = {
    "opening": {"opening", "aperture", "size", "diameter", "sieve", "sievesize", "meshsize", "particlesize"},
    "passing": {"passing", "cumulativepassing", "finer", "undersize"},
    "mass": {"mass", "massfraction", "retained", "massretained"},
}
"""Names of each column in lowercase without punctuation. `mass` is what a sieve retains, in any unit."""


def _sieve_columns(names: Sequence[str]) -> dict[str, int]:
    """Index of each column of SIEVE_COLUMNS that a header has."""
    plain = [re.sub(r"[^a-z]", "", UNIT.sub("", name).lower()) for name in names]
    found = {
        key: [k for k, name in enumerate(plain) if name in words] for key, words in SIEVE_COLUMNS.items()
    }
    return {key: columns[0] for key, columns in found.items() if columns}


def _is_sieve_header(names: Sequence[str]) -> bool:
    """Whether a header has the columns of a sieve curve."""
    columns = _sieve_columns(names)
    return "opening" in columns and len(columns) > 1


def _sieves_in(path: Path) -> tuple[Sieve, ...]:
    """The sieves in a CSV file, whose rows may have any order; with both columns, `passing` applies.

    Raises OSError if the file cannot be read, and FileError for its header and its invalid rows.
    """
    table = _sieve_table(path)
    columns = _sieve_columns(table.names)
    given = "passing" if "passing" in columns else "mass"

    def problem(row: int, column: str, reason: str) -> str:
        """Error message for a cell."""
        line, cells = table.rows[row]
        index = columns[column]
        return f"{path}:{line}: {table.names[index]} is {cells[index]}, but {reason}."

    opening = table.numbers(columns["opening"])
    share = table.numbers(columns[given])
    factor = unit_factor(path, table, columns["opening"], "length")
    pan = "it must be a number above 0; for the pan, give the smallest diameter of the particles"
    problems = [problem(row, "opening", pan) for row in np.flatnonzero(~(opening > 0.0))]
    far = (opening > 0.0) & ~((opening * factor >= SMALLEST) & (opening * factor <= LARGEST))
    problems += [
        problem(row, "opening", "a diameter of this magnitude is out of range") for row in np.flatnonzero(far)
    ]
    problems += [
        problem(row, given, "it must be a number of at least 0")
        for row in np.flatnonzero(~((share >= 0.0) & (share <= LARGEST)))
    ]
    if problems:
        raise FileError(problems)

    order = np.argsort(opening, kind="stable")
    opening = opening[order] * factor
    share = share[order]
    if given == "passing":
        unit = unit_factor(path, table, columns["passing"], "number")
        share = share * unit
        if share.max() > 1.0:
            reason = f"it must be at most {1.0 / unit:g}"
            if unit == 1.0:
                reason += "; if the column is in percent, write passing [%] in the header"
            raise FileError(problem(order[share.argmax()], "passing", reason))
    elif share[-1] > 0.0:
        reason = "the largest sieve must retain 0; add a sieve with the largest diameter of the particles"
        raise FileError(problem(order[-1], "mass", reason))
    elif not share.any():
        raise FileError(problem(order[0], "mass", "at least one sieve must retain something"))
    else:
        share = np.concatenate([[0.0], np.cumsum(share[:-1])])
        share = share / share[-1]
    sieves = tuple(
        Sieve(opening=float(size), passing=float(finer)) for size, finer in zip(opening, share, strict=True)
    )
    for index, key, reason in _curve_faults(sieves):
        problems.append(problem(order[index], key if key == "opening" else given, reason))
    if problems:
        raise FileError(problems)
    return sieves


def _sieve_table(path: Path) -> Table:
    """The table in a file with the columns of a sieve curve, all rows with the length of the header.

    Raises OSError if the file cannot be read, and FileError for another header or number of rows.
    """
    table = read_table(path, _is_sieve_header)
    if table is None:
        raise FileError(f"{path}: the table has no rows; give a header such as opening [mm], passing [%].")
    if not _is_sieve_header(table.names):
        raise FileError(
            f"{path}:{table.heading_line}: the columns are {', '.join(table.names)}, but opening and one of "
            "passing (cumulative) and mass (retained on each sieve) are expected, with units such as opening "
            "[mm], passing [%]."
        )
    if not 2 <= len(table.rows) <= MOST_SIEVES:
        raise FileError(
            f"{path}: a sieve curve has 2 to {MOST_SIEVES} rows, and this table has {len(table.rows)}."
        )
    for line, cells in table.rows:
        if len(cells) != len(table.names):
            raise FileError(f"{path}:{line}: the row must have {len(table.names)} values, as the header.")
    return table


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
    q.Diameter
    | tuple[q.Diameter, ...]
    | UniformSizes
    | NormalSizes
    | LogNormalSizes
    | RosinRammlerSizes
    | SieveSizes
    | ClassSizes
    | None,
    choose_by_key("distribution"),
]
"""Diameters as in a scene; None if a file defines them."""
