"""Schema of groups of particles: how many, of which sizes, where."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, Tag, model_validator

from granflow.scene.fields import (
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
from granflow.scene.insertion_schema import Insertion
from granflow.scene.numbers import whole_error

_ROUNDING = 1e-12  # of the sum of shares
Diameter = Annotated[float, Number("length", noun="a diameter", above=0)]


class TruncatedSizes(Model):
    """A size distribution with cut-offs."""

    min: Diameter = Field(description="smallest diameter [m]")
    max: Diameter = Field(description="largest diameter [m]")

    def faults(self) -> Iterator[Fault]:
        """A range that is one."""
        if self.max <= self.min:
            yield Fault(("max",), f"it must be above min, {self.min:g} m")

    def _center_fault(self, key: str, value: float) -> Iterator[Fault]:
        if self.min < self.max and not self.min < value < self.max:
            yield Fault((key,), f"it must lie between min and max, {self.min:g} and {self.max:g} m")


class UniformSizes(TruncatedSizes):
    """Diameters spread evenly from `min` to `max`."""

    distribution: Literal["uniform"] = Field(description="kind of size distribution")


class NormalSizes(TruncatedSizes):
    """Normally distributed diameters, cut off at `min` and `max`."""

    distribution: Literal["normal"] = Field(description="kind of size distribution")
    mean: Diameter = Field(description="mean diameter before the cut [m]")
    deviation: UnscaledLength = Field(description="standard deviation before the cut [m]")

    def faults(self) -> Iterator[Fault]:
        """The mean inside the cut-offs."""
        yield from super().faults()
        yield from self._center_fault("mean", self.mean)


class LogNormalSizes(TruncatedSizes):
    """Log-normally distributed diameters, cut off at `min` and `max`."""

    distribution: Literal["log_normal"] = Field(description="kind of size distribution")
    median: Diameter = Field(description="median diameter before the cut [m]")
    sigma: Positive = Field(description="standard deviation of ln(diameter) before the cut")

    def faults(self) -> Iterator[Fault]:
        """The median inside the cut-offs."""
        yield from super().faults()
        yield from self._center_fault("median", self.median)


class SizeClass(Model):
    """One diameter and its share."""

    diameter: Diameter = Field(description="diameter [m]")
    fraction: Share = Field(description="share of this class; the shares are scaled to sum to 1")


def _scaled(classes: tuple[SizeClass, ...]) -> tuple[SizeClass, ...]:
    """The classes with shares that sum to 1; as they are if they do already, so that reading again changes nothing."""
    total = sum(each.fraction for each in classes)
    if total == 0:
        raise whole_error("has only fractions of 0; give at least one class a share")
    if abs(total - 1) <= _ROUNDING:
        return classes
    return tuple(SizeClass(diameter=each.diameter, fraction=each.fraction / total) for each in classes)


Classes = Annotated[tuple[SizeClass, ...], list_of(some="[{diameter: 4 mm, fraction: 1}]"), AfterValidator(_scaled)]


class ClassSizes(Model):
    """A list of diameters with their shares, by number or by mass. The shares sum to 1 once read."""

    distribution: Literal["classes"] = Field(description="kind of size distribution")
    by: Literal["number", "mass"] = Field(description="whether the fractions count particles or mass")
    classes: Classes = Field(description="the classes")


SizeSpec = float | tuple[float, ...] | UniformSizes | NormalSizes | LogNormalSizes | ClassSizes
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


def _many_tag(value: Any) -> str:
    """Tell a list of vectors from one vector."""
    nested = isinstance(value, list | tuple) and bool(value) and isinstance(value[0], list | tuple)
    return "<list>" if nested else "<one>"


_one_or_many = choose_by(_many_tag, "a vector is asked here, or a list of vectors")
VelocityOrMany = Annotated[
    Annotated[VelocityVector, Tag("<one>")] | Annotated[tuple[VelocityVector, ...], Tag("<list>")], _one_or_many
]
AngularVelocityOrMany = Annotated[
    Annotated[AngularVelocityVector, Tag("<one>")] | Annotated[tuple[AngularVelocityVector, ...], Tag("<list>")],
    _one_or_many,
]


class Group(Model):
    """Particles of one material, put in place in one way.

    Lists and files have their rows; other groups state a count or a mass, streams perhaps only an end.
    """

    material: Text = Field(description="name of the particles' material")
    count_given: ParticleCount | None = Field(
        None, alias="count", description="number of particles; of a list or a file: its rows, and need not be written"
    )
    mass: ParticleMass | None = Field(None, description="mass of all of them [kg], in place of count")
    diameter: Sizes = Field(
        None, description="diameter [m], or a size distribution; a list with a list of positions; none with a file"
    )
    velocity: VelocityOrMany = Field((0.0, 0.0, 0.0), description="velocity at the start [m/s]")
    angular_velocity: AngularVelocityOrMany = Field(
        (0.0, 0.0, 0.0), description="angular velocity at the start [rad/s]"
    )
    fixed: Flag = Field(False, description="they never move, whatever meets them: grains of a rough wall")
    insert: Insertion = Field(description="where they are: lattice, pack, rain, inlet, positions or file")

    @property
    def count(self) -> int:
        """Number of particles; raises ValueError where it rests on a mass or a file and was not settled yet."""
        if self.count_given is None:
            raise ValueError("The number of particles is not settled; see granflow.scene.resolve.")
        return self.count_given

    @property
    def sizes(self) -> SizeSpec:
        """Diameters [m] of a group that has them from the scene; raises ValueError if a file has them."""
        if self.diameter is None:
            raise ValueError("A file has the diameters.")
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
        """Amounts and sizes where they belong; lists only beside lists; nothing that would move fixed grains."""
        yield from self._amount_faults()
        yield from self._list_faults()
        if self.diameter is None and self.insert.kind != "file":
            yield Fault(("diameter",), "is missing: diameter [m], or a size distribution", whole=True)
        if self.diameter is not None and self.insert.kind == "file":
            yield Fault(("diameter",), "the file has the sizes; leave it out")
        if self.fixed:
            yield from self._fixed_faults()

    def _amount_faults(self) -> Iterator[Fault]:
        insertion, count = self.insert, self.count_given
        rows = len(insertion.positions) if insertion.kind == "positions" else None
        if rows is not None and count != rows:
            yield Fault(("count",), f"insert.positions has {rows} rows; leave the count out")
        if self.mass is not None and insertion.kind in ("positions", "file"):
            yield Fault(
                ("mass",), f"it goes not with insert {{kind: {insertion.kind}}}, which has its rows; leave it out"
            )
        elif self.mass is not None and count is not None:
            yield Fault(("mass",), "count is given too: keep one of them")
        elif (
            self.mass is None and count is None and insertion.kind != "file" and getattr(insertion, "end", None) is None
        ):
            yield Fault(("count",), "is missing: number of particles; or give mass", whole=True)

    def _list_faults(self) -> Iterator[Fault]:
        """Lists as long as the list of positions, and only beside one."""
        rows = len(self.insert.positions) if self.insert.kind == "positions" else None
        for key, length in self._given_lists():
            if rows is None:
                yield Fault(key, "is a list, which goes only with insert {kind: positions}; give one value", whole=True)
            elif length != rows:
                reason = f"is a list of length {length} and insert.positions one of {rows}; give one to each position"
                yield Fault(key, reason, whole=True)

    def _fixed_faults(self) -> Iterator[Fault]:
        """Fixed grains are there from the start, and at rest."""
        if self.insert.kind in ("rain", "inlet"):
            yield Fault(("fixed",), "grains that come in move; place fixed ones by lattice, pack, list or file")
        for key in ("velocity", "angular_velocity"):
            if np.any(getattr(self, key)):
                yield Fault((key,), "fixed is true: those grains never move; leave it out")

    def _given_lists(self) -> Iterator[tuple[KeyPath, int]]:
        if isinstance(self.diameter, tuple):
            yield ("diameter",), len(self.diameter)
        for key in ("velocity", "angular_velocity"):
            value = getattr(self, key)
            if isinstance(value[0], tuple):
                yield (key,), len(value)
