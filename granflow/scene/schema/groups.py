"""Schema of particle groups: number, sizes, material, insertion."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, Tag, model_validator

from granflow.scene.schema.fields import (
    AngularVelocityVector,
    Fault,
    Flag,
    KeyPath,
    Model,
    Number,
    ParticleCount,
    ParticleMass,
    Positive,
    Share,
    Text,
    UnscaledLength,
    VelocityVector,
    choose_by,
    choose_by_key,
    list_of,
)
from granflow.scene.schema.insertion import Insertion
from granflow.scene.schema.numbers import whole_error

_ROUNDING = 1e-12  # tolerance of the sum of fractions
Diameter = Annotated[float, Number("length", noun="a diameter", above=0)]
"""Diameter [m] of a particle, independent of `scale`."""


class TruncatedSizes(Model):
    """A size distribution that is truncated to an interval: diameters outside [`min`, `max`] do not occur [m]."""

    min: Diameter = Field(description="smallest diameter [m]")
    max: Diameter = Field(description="largest diameter [m]")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the largest diameter exceeds the smallest."""
        if self.max <= self.min:
            yield Fault(("max",), f"it must be above min, {self.min:g} m")

    def _center_fault(self, key: str, value: float) -> Iterator[Fault]:
        """Yield a fault unless the mean or median [m] lies between the limits."""
        if self.min < self.max and not self.min < value < self.max:
            yield Fault((key,), f"it must lie between min and max, {self.min:g} and {self.max:g} m")


class UniformSizes(TruncatedSizes):
    """Uniformly distributed diameters from `min` to `max` [m]."""

    distribution: Literal["uniform"] = Field(description="kind of size distribution")


class NormalSizes(TruncatedSizes):
    """Normally distributed diameters [m], truncated to [`min`, `max`]: values outside do not occur."""

    distribution: Literal["normal"] = Field(description="kind of size distribution")
    mean: Diameter = Field(description="mean diameter before truncation [m]")
    deviation: UnscaledLength = Field(description="standard deviation before truncation [m]")

    def faults(self) -> Iterator[Fault]:
        """Yield the faults of the limits and of the mean."""
        yield from super().faults()
        yield from self._center_fault("mean", self.mean)


class LogNormalSizes(TruncatedSizes):
    """Log-normally distributed diameters [m], truncated to [`min`, `max`]: values outside do not occur."""

    distribution: Literal["log_normal"] = Field(description="kind of size distribution")
    median: Diameter = Field(description="median diameter before truncation [m]")
    sigma: Positive = Field(description="standard deviation of ln(diameter) before truncation")

    def faults(self) -> Iterator[Fault]:
        """Yield the faults of the limits and of the median."""
        yield from super().faults()
        yield from self._center_fault("median", self.median)


class SizeClass(Model):
    """One diameter and its fraction of all particles."""

    diameter: Diameter = Field(description="diameter [m]")
    fraction: Share = Field(description="fraction of this class; the fractions are normalized to the sum 1")


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


Classes = Annotated[tuple[SizeClass, ...], list_of(some="[{diameter: 4 mm, fraction: 1}]"), AfterValidator(_scaled)]
"""List of diameters with fractions, which are normalized to the sum 1."""


class ClassSizes(Model):
    """A list of diameters with their fractions by number or by mass. The reader normalizes the fractions.

    The number of particles of each class is exact to one particle.
    """

    distribution: Literal["classes"] = Field(description="kind of size distribution")
    by: Literal["number", "mass"] = Field(
        description="number: fractions of the particle count; mass: fractions of the mass"
    )
    classes: Classes = Field(description="list of {diameter, fraction}")


SizeSpec = float | tuple[float, ...] | UniformSizes | NormalSizes | LogNormalSizes | ClassSizes
"""Diameters after reading: one, one per particle, or a distribution [m]."""

Sizes = Annotated[
    Annotated[Diameter, Tag("<number>")]
    | Annotated[tuple[Diameter, ...], Tag("<list>")]
    | Annotated[UniformSizes, Tag("<uniform>")]
    | Annotated[NormalSizes, Tag("<normal>")]
    | Annotated[LogNormalSizes, Tag("<log_normal>")]
    | Annotated[ClassSizes, Tag("<classes>")]
    | Annotated[None, Tag("<none>")],
    choose_by_key("distribution", number_tag="number", list_tag="list", none_tag="none"),
]
"""Diameters as in a scene; None if a file defines them."""


def _many_tag(value: Any) -> str:
    """Distinguish a list of vectors from one vector."""
    nested = isinstance(value, list | tuple) and bool(value) and isinstance(value[0], list | tuple)
    return "<list>" if nested else "<one>"


_one_or_many = choose_by(_many_tag, "a vector is expected, or a list of vectors")
VelocityOrMany = Annotated[
    Annotated[VelocityVector, Tag("<one>")] | Annotated[tuple[VelocityVector, ...], Tag("<list>")], _one_or_many
]
"""One velocity (3,) [m/s] for all particles, or one for each."""

AngularVelocityOrMany = Annotated[
    Annotated[AngularVelocityVector, Tag("<one>")] | Annotated[tuple[AngularVelocityVector, ...], Tag("<list>")],
    _one_or_many,
]
"""One angular velocity (3,) [rad/s] for all particles, or one for each."""


class Group(Model):
    """Particles of one material with one kind of insertion.

    Positions and files define the count by their rows; other groups give a count or a mass, and inserted groups may
    give an end time instead. Of several limits, the smallest number of particles applies.
    """

    material: Text = Field(description="name of the particles' material")
    count_given: ParticleCount | None = Field(
        None, alias="count", description="number of particles; with positions or file: default is the number of rows"
    )
    mass: ParticleMass | None = Field(None, description="total mass [kg], instead of count")
    diameter: Sizes = Field(
        None, description="diameter [m], or a size distribution; with positions, also a list; with file, not allowed"
    )
    velocity: VelocityOrMany = Field((0.0, 0.0, 0.0), description="initial velocity [m/s]")
    angular_velocity: AngularVelocityOrMany = Field((0.0, 0.0, 0.0), description="initial angular velocity [rad/s]")
    fixed: Flag = Field(False, description="true: the particles never move, such as those of a rough wall")
    insert: Insertion = Field(description="insertion, {kind: lattice, pack, rain, inlet, positions or file, ...}")

    @property
    def count(self) -> int:
        """Number of particles. Raises ValueError if it depends on a mass or a file and the scene is not resolved."""
        if self.count_given is None:
            raise ValueError("The number of particles is not resolved; see granflow.particles.resolve.")
        return self.count_given

    @property
    def sizes(self) -> SizeSpec:
        """Diameters [m] given in the scene: one, one per particle, or a distribution.

        Raises ValueError if a file defines them.
        """
        if self.diameter is None:
            raise ValueError("A file defines the diameters.")
        return self.diameter

    @model_validator(mode="before")
    @classmethod
    def _count_rows(cls, given: Any) -> Any:
        """Fill in the count from a list of positions."""
        if not isinstance(given, dict) or given.keys() & {"count", "count_given"}:
            return given
        insertion = given.get("insert")
        positions = insertion.get("positions") if isinstance(insertion, dict) else getattr(insertion, "positions", None)
        return given | {"count": max(1, len(positions))} if isinstance(positions, list | tuple) else given

    def faults(self) -> Iterator[Fault]:
        """Yield the faults of count, mass, diameter, lists and velocities, and of fixed particles."""
        yield from self._amount_faults()
        yield from self._list_faults()
        if self.diameter is None and self.insert.kind != "file":
            yield Fault(("diameter",), "is missing: diameter [m], or a size distribution", whole=True)
        if self.diameter is not None and self.insert.kind == "file":
            yield Fault(("diameter",), "the file defines the sizes; remove diameter")
        if self.fixed:
            yield from self._fixed_faults()

    def _amount_faults(self) -> Iterator[Fault]:
        """Yield a fault unless count, mass, end time and rows define the number of particles without contradiction."""
        insertion, count = self.insert, self.count_given
        rows = len(insertion.positions) if insertion.kind == "positions" else None
        if rows is not None and count != rows:
            yield Fault(("count",), f"insert.positions has {rows} rows; leave the count out")
        if self.mass is not None and insertion.kind in ("positions", "file"):
            yield Fault(("mass",), f"it cannot be combined with insert: {{kind: {insertion.kind}}}; remove it")
        elif self.mass is not None and count is not None:
            yield Fault(("mass",), "count is given too: keep one of them")
        elif (
            self.mass is None and count is None and insertion.kind != "file" and getattr(insertion, "end", None) is None
        ):
            yield Fault(("count",), "is missing: number of particles; or give mass", whole=True)

    def _list_faults(self) -> Iterator[Fault]:
        """Lists require insert: {kind: positions} and must have the length of its positions."""
        rows = len(self.insert.positions) if self.insert.kind == "positions" else None
        for key, length in self._given_lists():
            if rows is None:
                yield Fault(key, "is a list, which requires insert: {kind: positions}; give one value", whole=True)
            elif length != rows:
                reason = f"is a list of length {length}, but insert.positions has length {rows}; give one per position"
                yield Fault(key, reason, whole=True)

    def _fixed_faults(self) -> Iterator[Fault]:
        """Fixed particles must exist from the start and be at rest."""
        if self.insert.kind in ("rain", "inlet"):
            yield Fault(("fixed",), "rain and inlet require moving particles; use lattice, pack, positions or file")
        for key in ("velocity", "angular_velocity"):
            if np.any(getattr(self, key)):
                yield Fault((key,), f"fixed is true, so the particles do not move; remove {key}")

    def _given_lists(self) -> Iterator[tuple[KeyPath, int]]:
        """Yield the key path and the length of each value that is given as a list, one entry per particle."""
        if isinstance(self.diameter, tuple):
            yield ("diameter",), len(self.diameter)
        for key in ("velocity", "angular_velocity"):
            value = getattr(self, key)
            if isinstance(value[0], tuple):
                yield (key,), len(value)
