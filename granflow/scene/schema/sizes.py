"""Schema of the key `diameter` of particle groups: one diameter, one per particle, or a distribution."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from granflow.scene.schema import quantities as q
from granflow.scene.schema.faults import Fault
from granflow.scene.schema.fields import ListOf, Model, choose_by_key
from granflow.scene.schema.numbers import whole_error

_ROUNDING = 1e-12  # tolerance of the sum of fractions


class TruncatedSizes(Model):
    """A size distribution that is truncated to an interval: diameters outside [`min`, `max`] do not occur [m]."""

    min: q.Diameter = Field(description="smallest diameter [m]")
    max: q.Diameter = Field(description="largest diameter [m]")

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


class LogNormalSizes(TruncatedSizes):
    """Log-normally distributed diameters [m], truncated to [`min`, `max`]: values outside do not occur.

    >>> gf.LogNormalSizes(median="4 mm", sigma=0.2, min="2 mm", max="8 mm").sigma
    0.2
    """

    distribution: Literal["log_normal"] = Field("log_normal", description="kind of size distribution")
    median: q.Diameter = Field(description="median diameter before truncation [m]")
    sigma: q.Positive = Field(description="standard deviation of ln(diameter) before truncation")

    def faults(self) -> Iterator[Fault]:
        yield from super().faults()
        yield from self._center_fault("median", self.median)


class SizeClass(Model):
    """One diameter and its fraction of all particles.

    >>> gf.SizeClass(diameter="4 mm", fraction=0.5)
    SizeClass(diameter=0.004, fraction=0.5)
    """

    diameter: q.Diameter = Field(description="diameter [m]")
    fraction: q.Share = Field(description="fraction of this class; the fractions are normalized to the sum 1")


def _scaled(classes: tuple[SizeClass, ...]) -> tuple[SizeClass, ...]:
    """The classes with fractions normalized to the sum 1; unchanged if normalized, so that reading is idempotent.

    Raises PydanticCustomError if all fractions are 0.
    """
    total = sum(each.fraction for each in classes)
    if total == 0:
        raise whole_error("has only fractions of 0; give at least one class a fraction above 0")
    if abs(total - 1) <= _ROUNDING:
        return classes
    return tuple(SizeClass(diameter=each.diameter, fraction=each.fraction / total) for each in classes)


Classes = Annotated[tuple[SizeClass, ...], ListOf(some="[{diameter: 4 mm, fraction: 1}]"), AfterValidator(_scaled)]
"""List of diameters with fractions, which are normalized to the sum 1."""


class ClassSizes(Model):
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


SizeSpec = float | tuple[float, ...] | UniformSizes | NormalSizes | LogNormalSizes | ClassSizes
"""Diameters after reading: one, one per particle, or a distribution [m]."""

Sizes = Annotated[
    q.Diameter | tuple[q.Diameter, ...] | UniformSizes | NormalSizes | LogNormalSizes | ClassSizes | None,
    choose_by_key("distribution"),
]
"""Diameters as in a scene; None if a file defines them."""
