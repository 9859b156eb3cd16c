"""Schema of the block `stages`: the parts of a run."""

from collections.abc import Iterator

from pydantic import Field

from granflow.scene.schema import quantities as q
from granflow.scene.schema.faults import Fault, missing, redundant, whole
from granflow.scene.schema.fields import Model, Name


class Stage(Model):
    """A part of the run that ends after a duration, or when the particles are at rest.

    Walls and motions may be limited to stages.

    >>> gf.Stage(name="settle", kinetic_energy_below="1 nJ", max_duration="2 s").max_duration
    2.0
    """

    name: Name = Field(description="name of the stage")
    duration: q.PositiveTime | None = Field(None, description="duration [s]")
    kinetic_energy_below: q.Energy | None = Field(
        None, description="the stage ends if the mean kinetic energy per particle is below this value [J]"
    )
    max_duration: q.PositiveTime | None = Field(None, description="with kinetic_energy_below: longest duration [s]")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the stage has either a duration, or an energy with a maximum duration."""
        if self.duration is None and self.kinetic_energy_below is None:
            yield whole((), "has no end: give duration, or kinetic_energy_below with max_duration")
        elif self.duration is not None and self.kinetic_energy_below is not None:
            yield redundant("duration", "kinetic_energy_below", keep="one, or replace duration by max_duration")
        elif self.kinetic_energy_below is not None and self.max_duration is None:
            yield missing(("max_duration",), "give the maximum duration of a stage with kinetic_energy_below")
        elif self.duration is not None and self.max_duration is not None:
            yield Fault(("max_duration",), "it requires kinetic_energy_below; remove max_duration")
