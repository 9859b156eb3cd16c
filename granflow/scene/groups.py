"""Schema of groups of particles: how many, of which sizes, where."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, Tag, model_validator

from granflow.scene.fields import (
    Count,
    Fault,
    Flag,
    KeyPath,
    Model,
    Number,
    Point,
    Positive,
    PositiveLength,
    Rate,
    SpinVector,
    Text,
    Time,
    VelocityVector,
    choice,
    chosen,
    listing,
    not_required,
)
from granflow.scene.numbers import whole

_ROUNDING = 1e-12  # of the sum of shares
Diameter = Annotated[float, Number("length", noun="a diameter", above=0)]
Jitter = Annotated[float, Number(noun="a jitter", at_least=0, at_most=1)]
Share = Annotated[float, Number(noun="a fraction", at_least=0)]


class Cut(Model):
    """A size distribution with cut-offs."""

    min: Diameter = Field(description="smallest diameter [m]")
    max: Diameter = Field(description="largest diameter [m]")

    def faults(self) -> Iterator[Fault]:
        """A range that is one."""
        if self.max <= self.min:
            yield Fault(("max",), f"it must be above min, {self.min:g} m")

    def _centre_fault(self, key: str, value: float) -> Iterator[Fault]:
        if self.min < self.max and not self.min < value < self.max:
            yield Fault((key,), f"it must lie between min and max, {self.min:g} and {self.max:g} m")


class UniformSizes(Cut):
    """Diameters spread evenly from `min` to `max`."""

    distribution: Literal["uniform"] = Field(description="kind of size distribution")


class NormalSizes(Cut):
    """Normally distributed diameters, cut off at `min` and `max`."""

    distribution: Literal["normal"] = Field(description="kind of size distribution")
    mean: Diameter = Field(description="mean diameter before the cut [m]")
    deviation: PositiveLength = Field(description="standard deviation before the cut [m]")

    def faults(self) -> Iterator[Fault]:
        """The mean inside the cut-offs."""
        yield from super().faults()
        yield from self._centre_fault("mean", self.mean)


class LogNormalSizes(Cut):
    """Log-normally distributed diameters, cut off at `min` and `max`."""

    distribution: Literal["log_normal"] = Field(description="kind of size distribution")
    median: Diameter = Field(description="median diameter before the cut [m]")
    sigma: Positive = Field(description="standard deviation of ln(diameter) before the cut")

    def faults(self) -> Iterator[Fault]:
        """The median inside the cut-offs."""
        yield from super().faults()
        yield from self._centre_fault("median", self.median)


class SizeClass(Model):
    """One diameter and its share."""

    diameter: Diameter = Field(description="diameter [m]")
    fraction: Share = Field(description="share of this class; the shares are scaled to sum to 1")


def _scaled(classes: tuple[SizeClass, ...]) -> tuple[SizeClass, ...]:
    """The classes with shares that sum to 1; as they are if they do already, so that reading again changes nothing."""
    total = sum(each.fraction for each in classes)
    if total == 0:
        raise whole("has only fractions of 0; give at least one class a share")
    if abs(total - 1) <= _ROUNDING:
        return classes
    return tuple(SizeClass(diameter=each.diameter, fraction=each.fraction / total) for each in classes)


Classes = Annotated[tuple[SizeClass, ...], listing(some="[{diameter: 4 mm, fraction: 1}]"), AfterValidator(_scaled)]


class ClassSizes(Model):
    """A list of diameters with their shares, by number or by mass. The shares sum to 1 once read."""

    distribution: Literal["classes"] = Field(description="kind of size distribution")
    by: Literal["number", "mass"] = Field(description="whether the fractions count particles or mass")
    classes: Classes = Field(description="the classes")


SizeDistribution = UniformSizes | NormalSizes | LogNormalSizes | ClassSizes
Sizes = Annotated[
    Annotated[Diameter, Tag("<number>")]
    | Annotated[tuple[Diameter, ...], Tag("<list>")]
    | Annotated[UniformSizes, Tag("<uniform>")]
    | Annotated[NormalSizes, Tag("<normal>")]
    | Annotated[LogNormalSizes, Tag("<log_normal>")]
    | Annotated[ClassSizes, Tag("<classes>")],
    choice("distribution", number="number", listed="list"),
]


class Box(Model):
    """A box along the axes."""

    min: Point = Field(description="corner with the smallest coordinates [m]")
    max: Point = Field(description="corner with the largest coordinates [m]")

    def faults(self) -> Iterator[Fault]:
        """A box with room in it."""
        for i, (low, high) in enumerate(zip(self.min, self.max, strict=True)):
            if high <= low:
                yield Fault(("max", i), f"it must be above min, {low:g} m")


class Tube(Model):
    """A round volume about an axis."""

    from_: Point = Field(alias="from", description="one end of the axis [m]")
    to: Point = Field(description="the other end of the axis [m]")
    radius: PositiveLength = Field(description="radius [m]")

    def faults(self) -> Iterator[Fault]:
        """An axis with a length."""
        if self.from_ == self.to:
            yield Fault(("to",), "it is the same point as from: the axis must have a length above 0")


class BoxRegion(Model):
    """Room for particles: a box. Whole particles stay inside."""

    box: Box = Field(description="a box along the axes, {min: [..], max: [..]}")


class CylinderRegion(Model):
    """Room for particles: a cylinder. Whole particles stay inside."""

    cylinder: Tube = Field(description="a cylinder, {from: [..], to: [..], radius: ..}")


def _region_tag(value: Any) -> str | None:
    for tag, model in (("box", BoxRegion), ("cylinder", CylinderRegion)):
        if isinstance(value, model) or (isinstance(value, dict) and tag in value):
            return f"<{tag}>"
    return None


Region = Annotated[
    Annotated[BoxRegion, Tag("<box>")] | Annotated[CylinderRegion, Tag("<cylinder>")],
    chosen(_region_tag, "it must be {box: {min: [..], max: [..]}} or {cylinder: {from: [..], to: [..], radius: ..}}"),
]


class Lattice(Model):
    """Particles on a regular lattice in a region."""

    kind: Literal["lattice"] = Field(description="way of placing the particles")
    region: Region = Field(description="the room to fill: a box or a cylinder")
    jitter: Jitter = Field(0.0, description="random shift, as a fraction of the free gap")


class Pack(Model):
    """Particles at random in a region, none overlapping."""

    kind: Literal["pack"] = Field(description="way of placing the particles")
    region: Region = Field(description="the room to fill: a box or a cylinder")


class Rain(Model):
    """Particles that appear at random in a region at a rate, until the count is reached."""

    kind: Literal["rain"] = Field(description="way of placing the particles")
    region: Region = Field(description="where they appear: a box or a cylinder")
    rate: Rate = Field(description="particles per second [1/s]")
    start: Time = Field(0.0, description="time of the first particle [s]")


class Listed(Model):
    """Particles at given positions."""

    kind: Literal["list"] = Field(description="way of placing the particles")
    positions: Annotated[tuple[Point, ...], listing(some="[[0, 0, 0]]")] = Field(description="centres [m]")


Place = Annotated[
    Annotated[Lattice, Tag("<lattice>")]
    | Annotated[Pack, Tag("<pack>")]
    | Annotated[Rain, Tag("<rain>")]
    | Annotated[Listed, Tag("<list>")],
    choice("kind"),
]


def _many_tag(value: Any) -> str:
    """Tell a list of vectors from one vector."""
    nested = isinstance(value, list | tuple) and bool(value) and isinstance(value[0], list | tuple)
    return "<list>" if nested else "<one>"


_one_or_many = chosen(_many_tag, "a vector is asked here, or a list of vectors")
VelocityOrMany = Annotated[
    Annotated[VelocityVector, Tag("<one>")] | Annotated[tuple[VelocityVector, ...], Tag("<list>")], _one_or_many
]
SpinOrMany = Annotated[
    Annotated[SpinVector, Tag("<one>")] | Annotated[tuple[SpinVector, ...], Tag("<list>")], _one_or_many
]


class Group(Model):
    """Particles of one material, put in place in one way. A list placement needs no count: it has its rows."""

    model_config = ConfigDict(json_schema_extra=not_required("count"))

    material: Text = Field(description="name of the particles' material")
    count: Count = Field(description="number of particles; with a list of positions: its length")
    diameter: Sizes = Field(description="diameter [m], or a size distribution; a list with a list of positions")
    velocity: VelocityOrMany = Field((0.0, 0.0, 0.0), description="velocity at the start [m/s]")
    spin: SpinOrMany = Field((0.0, 0.0, 0.0), description="angular velocity at the start [rad/s]")
    fixed: Flag = Field(False, description="they never move, whatever meets them: grains of a rough wall")
    place: Place = Field(description="where they are: lattice, pack, rain or list")

    @model_validator(mode="before")
    @classmethod
    def _count_rows(cls, given: Any) -> Any:
        """Fill in the count from a list of positions."""
        if not isinstance(given, dict) or "count" in given:
            return given
        place = given.get("place")
        positions = place.get("positions") if isinstance(place, dict) else getattr(place, "positions", None)
        return given | {"count": max(1, len(positions))} if isinstance(positions, list | tuple) else given

    def faults(self) -> Iterator[Fault]:
        """Lists as long as the list of positions, and only beside one; nothing that would move fixed grains."""
        if self.fixed:
            yield from self._faults_of_fixed()
        rows = len(self.place.positions) if self.place.kind == "list" else None
        if rows is not None and self.count != rows:
            yield Fault(("count",), f"place.positions has {rows} rows; leave the count out")
        for key, length in self._lists():
            if rows is None:
                yield Fault(key, "is a list, which goes only with place {kind: list}; give one value", whole=True)
            elif length != rows:
                reason = f"is a list of length {length} and place.positions one of {rows}; give one to each position"
                yield Fault(key, reason, whole=True)

    def _faults_of_fixed(self) -> Iterator[Fault]:
        """Fixed grains are there from the start, and at rest."""
        if self.place.kind == "rain":
            yield Fault(("fixed",), "grains that rain move; place fixed ones by lattice, pack or list")
        for key in ("velocity", "spin"):
            if np.any(getattr(self, key)):
                yield Fault((key,), "fixed is true: those grains never move; leave it out")

    def _lists(self) -> Iterator[tuple[KeyPath, int]]:
        if isinstance(self.diameter, tuple):
            yield ("diameter",), len(self.diameter)
        for key in ("velocity", "spin"):
            value = getattr(self, key)
            if isinstance(value[0], tuple):
                yield (key,), len(value)
