"""Schema of the block `output`: selection and intervals of the results."""

from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from granflow.geometry.shape import are_perpendicular
from granflow.scene.schema import quantities as q
from granflow.scene.schema.analysis import AnyMetric, FieldGrid
from granflow.scene.schema.faults import Fault, redundant
from granflow.scene.schema.fields import Flag, FlagOrNames, Model, Name

MOST_CLASSES = 200
"""Largest number of classes of collision energies."""


class FlowMeter(Model):
    """A flow meter: the mass through a plane, a disc or a rectangle, including particles deleted there.

    Net values: backward crossings count negative. Particles are tracked between the rows of timeseries.csv.

    >>> gf.FlowMeter(point=[0, 0, 0], normal=[0, 0, -1], radius="2 cm").radius
    0.02
    """

    point: q.Point = Field(description="a point on the plane [m]: the center of the disc, or a corner of the rectangle")
    normal: q.Direction = Field(description="direction of positive flow; its length does not matter")
    radius: q.PositiveLength | None = Field(None, description="radius of the disc [m]; default: the whole plane")
    sides: q.Sides | None = Field(
        None, description="the two edge vectors of the rectangle [m], perpendicular to each other and to the normal"
    )
    group_by: Literal["material", "group"] | None = Field(
        None, description="additional separate counts for each material or group"
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the area is a disc or a rectangle, with perpendicular sides and normal."""
        if self.sides is None:
            return
        if self.radius is not None:
            yield redundant("sides", "radius")
        if not all(any(side) for side in self.sides):
            yield Fault(("sides",), "a side must not be the zero vector")
        elif not are_perpendicular(*self.sides, self.normal):
            yield Fault(("sides",), "the two sides must be perpendicular to each other and to the normal")


class Checkpoints(Model):
    """Interval and number of checkpoints for `granflow resume`; a run always writes one at its end.

    A checkpoint is due at simulated or wall-clock times, whichever is first.

    >>> gf.Checkpoints(wall_clock="5 min").wall_clock
    300.0
    """

    wall_clock: q.PositiveTime = Field(600.0, description="wall-clock time between checkpoints [s]")
    interval: q.PositiveTime | None = Field(
        None, description="simulated time between additional checkpoints [s]; default: none"
    )
    keep: q.Count = Field(2, description="number of checkpoints that are kept, the newest ones")


class CollisionEnergies(Model):
    """Classes of impact energies, equally spaced on a logarithmic scale, in which collisions are counted.

    The impact energy is m v^2 / 2 with the effective mass of the pair and the normal approach velocity.

    >>> gf.CollisionEnergies(min="1 nJ", max="1 mJ", classes=60).classes
    60
    """

    min: q.Energy = Field(description="lower edge of the first class [J]; smaller energies have a class of their own")
    max: q.Energy = Field(description="upper edge of the last class [J]; larger energies have a class of their own")
    classes: q.Count = Field(30, description="number of classes between min and max, at most 200")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless min is below max, and for too many classes."""
        if self.min >= self.max:
            yield Fault(("max",), f"it must be above min, {self.min:g} J")
        if self.classes > MOST_CLASSES:
            yield Fault(("classes",), f"at most {MOST_CLASSES} are possible")


class Output(Model):
    """Selection and intervals of the output.

    Times are simulated times [s]; the energy budget and wall forces cost time in each step.

    >>> gf.Output(interval="5 ms", contacts=True).timeseries_interval
    0.005
    """

    interval: q.PositiveTime = Field(description="time between VTU frames [s]")
    timeseries_interval: q.PositiveTime = Field(
        default_factory=lambda given: given.get("interval"),  # None if the interval is invalid
        description="time between rows of timeseries.csv [s]; default: interval",
    )
    particles: Flag = Field(True, description="write particles_*.vtu")
    frames_per_rank: Flag = Field(
        False, description="on MPI ranks, write one particle file per rank and particles_*.pvtu, which lists them"
    )
    compression: Literal["zlib", "none"] = Field(
        "zlib", description="of VTU files: none is written 7 times as fast; the files are 1.8 times as large"
    )
    contacts: Flag = Field(False, description="write contacts_*.vtu")
    walls: Flag = Field(True, description="write walls_*.vtu")
    energy_budget: Flag = Field(False, description="compute the energy budget")
    wall_forces: FlagOrNames = Field(
        False,
        description="measure force, torque and pressure of the particles on all walls (true) or on those in a list",
    )
    collision_energies: CollisionEnergies | None = Field(
        None, description="count collisions by impact energy, for collision_energies.csv; default: no counts"
    )
    flow_meters: dict[Name, FlowMeter] = Field({}, description="flow meters by name")
    fields: dict[Name, FieldGrid] = Field({}, description="fields on grids by name, written as fields_NAME_*.vtu")
    metrics: dict[Name, AnyMetric] = Field({}, description="metrics of the bed by name, for timeseries.csv and expect")
    checkpoint: Checkpoints = Field(Checkpoints.model_construct(), description="interval and number of checkpoints")
