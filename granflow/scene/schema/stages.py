"""Schema of the block `stages`: the parts of a run."""

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from granflow.scene.schema import quantities as q
from granflow.scene.schema.faults import Fault, missing, redundant, whole
from granflow.scene.schema.fields import ListOf, Model, Name, Text


class StageCondition(Model):
    """A condition that ends a stage: a column of timeseries.csv is above or below a value.

    It is evaluated at each row of the time series: wall forces and flow rates are means since the previous row.

    >>> gf.StageCondition(quantity="wall_pressure.lid", above="100 kPa").above
    100000.0
    """

    quantity: Text = Field(
        description="column of timeseries.csv, such as wall_force_z.lid, deleted_mass or mass_flow.outlet"
    )
    above: q.AnyQuantity | None = Field(None, description="the stage ends if the quantity is above this value")
    below: q.AnyQuantity | None = Field(None, description="the stage ends if the quantity is below this value")
    hold: q.Time = Field(0.0, description="time during which all rows must satisfy the condition [s]")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless exactly one bound is given."""
        if (self.above is None) == (self.below is None):
            found = "has no bound" if self.above is None else "has above and below"
            yield whole((), f"{found}; give exactly one of above and below")


class Stage(Model):
    """A part of the run that ends after a duration, on a quantity, or when the particles are at rest.

    Walls and motions may be limited to stages.

    >>> gf.Stage(name="settle", kinetic_energy_below="1 nJ", max_duration="2 s").max_duration
    2.0
    """

    name: Name = Field(description="name of the stage")
    duration: q.PositiveTime | None = Field(None, description="duration [s]")
    kinetic_energy_below: q.Energy | None = Field(
        None,
        description="the stage ends at rest: the mean kinetic energy per particle is below this value [J], and the net "
        "force on the particles is below 20 % of their weight",
    )
    until: Annotated[tuple[StageCondition, ...], ListOf(one=True)] = Field(
        (), description="the stage ends if a quantity is above or below a value: one condition, or a list, any of which"
    )
    min_duration: q.Time = Field(
        0.0, description="with kinetic_energy_below or until: time before which no condition is satisfied [s]"
    )
    max_duration: q.PositiveTime | None = Field(
        None, description="with kinetic_energy_below or until: longest duration [s]"
    )

    @property
    def longest(self) -> float:
        """Longest duration [s]; 0 without one."""
        return self.duration or self.max_duration or 0.0

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the stage has either a duration, or a condition with a maximum duration."""
        condition = "kinetic_energy_below" if self.kinetic_energy_below is not None else "until" if self.until else ""
        if self.duration is None and not condition:
            yield whole((), "has no end: give duration, or kinetic_energy_below or until with max_duration")
        elif self.duration is not None and condition:
            yield redundant("duration", condition, keep="one, or replace duration by max_duration")
        elif condition and self.max_duration is None:
            yield missing(("max_duration",), f"a stage with {condition} requires its maximum duration")
        elif self.duration is not None and self.max_duration is not None:
            yield Fault(("max_duration",), "it requires kinetic_energy_below or until; remove max_duration")
        if self.min_duration and not condition:
            yield Fault(("min_duration",), "it requires kinetic_energy_below or until; remove min_duration")
        elif self.max_duration is not None and self.min_duration >= self.max_duration:
            yield Fault(("min_duration",), f"it must be shorter than max_duration, {self.max_duration:g} s")
