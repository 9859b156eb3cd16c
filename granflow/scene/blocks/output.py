"""Schema of the blocks `output` and `expect`: what a run writes, and what its results must be.

`Output` has the keys of the block in the order of a scene file; the parts that they contain precede it in the
same order. `blocks.metrics` has the kinds of metrics. `unit_of` gives the unit of an expected number.
"""

from collections.abc import Iterator
from contextlib import suppress
from typing import Annotated, Any, Literal, Union

from pydantic import Field, GetCoreSchemaHandler, ValidationInfo
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from granflow.fields import FIELD_QUANTITIES, quantity_of
from granflow.geometry.vectors import are_perpendicular
from granflow.scene.blocks.grids import GridSpec
from granflow.scene.blocks.metrics import METRICS, AnyMetric
from granflow.schema import quantities as q
from granflow.schema.faults import Fault, missing, redundant, whole
from granflow.schema.messages import suggestion_or_list
from granflow.schema.model import (
    Flag,
    FlagOrNames,
    GroupNames,
    ListOf,
    Model,
    Name,
    StageNames,
    Text,
    choose_by_key,
    optional,
    pair_list,
)
from granflow.schema.quantities import Number
from granflow.units import DIMENSIONS

# Keys `collision_energies` and `flow_meters`

MOST_CLASSES = 200
"""Largest number of classes of collision energies."""


class CollisionEnergies(Model):
    """Classes of impact energies, equally spaced on a logarithmic scale, in which collisions are counted.

    The impact energy is m v^2 / 2 with the effective mass of the pair and the normal approach velocity.

    >>> gf.CollisionEnergies(min="1 nJ", max="1 mJ", classes=60).classes
    60
    """

    min: q.Energy = Field(
        description="lower edge of the first class [J]; smaller energies are counted in an additional class",
        examples=["1 nJ"],
    )
    max: q.Energy = Field(
        description="upper edge of the last class [J]; larger energies are counted in an additional class",
        examples=["1 mJ"],
    )
    classes: q.Count = Field(30, description="number of classes between min and max, at most 200")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless min is below max, and for too many classes."""
        if self.min >= self.max:
            yield Fault(("max",), f"it must be above min, {self.min:g} J")
        if self.classes > MOST_CLASSES:
            yield Fault(("classes",), f"at most {MOST_CLASSES} are possible")


FLOW_BLOCKS = 10
"""Number of parts of the window of a steady flow whose scatter gives the standard error of the mass flow."""


class FlowMeter(Model):
    """A flow meter: the mass through a plane, a disc or a rectangle, including particles deleted there.

    Net values: backward crossings count negative. Particles are tracked between the rows of timeseries.csv.
    Of an area that extends beyond periodic faces, the images in the box count, too.

    >>> gf.FlowMeter(point=[0, 0, 0], normal=[0, 0, -1], radius="2 cm").radius
    0.02
    """

    point: q.Point = Field(
        description="a point on the plane [m]: the center of the disc, or a corner of the rectangle"
    )
    normal: q.Direction = Field(description="direction of positive flow; its length does not matter")
    radius: q.PositiveLength | None = optional("radius of the disc [m]", "the whole plane")
    sides: q.Sides | None = Field(
        None,
        description=(
            "the two edge vectors of the rectangle [m], perpendicular to each other and to the normal"
        ),
        examples=[[["40 mm", 0, 0], [0, "20 mm", 0]]],
    )
    group_by: Literal["material", "group"] | None = Field(
        None, description="additional separate counts for each material or group"
    )
    passages: Flag = Field(
        False, description="write each passage of a particle to passages_NAME.csv, NAME of the flow meter"
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


# Key `residence_time`


class ResidenceTime(Model):
    """The distribution of the times that particles need from an inlet, or a flow meter, to a flow meter.

    Each particle counts once: from its insertion, or its first passage of `from`, to its first passage of
    `to`, both in forward direction. `granflow report` draws the distributions E(t) and F(t).

    >>> gf.ResidenceTime(from_="feed", to="outlet", entered_between=["1 s", "1.1 s"]).to
    'outlet'
    """

    from_: Name | None = Field(
        None,
        alias="from",
        description=(
            "flow meter, or group of particles whose insertion begins the time; without it, the insertion of "
            "any group"
        ),
        examples=["feed"],
    )
    to: Name = Field(description="flow meter that ends the time", examples=["outlet"])
    groups: GroupNames | None = optional("groups that count, such as a tracer", "all", examples=[["tracer"]])
    entered_between: Annotated[tuple[q.Time, q.Time], pair_list("[first, last] time")] | None = optional(
        "only particles that enter in this time count: a pulse [s]",
        "the whole run",
        examples=[["1 s", "1.1 s"]],
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault for an interval of no length, and for equal ends."""
        between = self.entered_between
        if between is not None and between[0] >= between[1]:
            yield Fault(("entered_between",), "the first time must be the smaller one")
        if self.from_ == self.to:
            yield Fault(("to",), "it is the flow meter of from; name another one")


# Key `fields`


Cutoff = Annotated[float, Number(noun="a cut-off", at_least=1, at_most=10)]
"""Cutoff of the kernel, in kernel widths: 1 to 10."""


class FieldGrid(GridSpec):
    """Coarse-grained fields on a grid (Gaussian kernel), written as VTU files.

    Fields of contacts (stress, pressure, fabric) require the contacts of each frame.
    Formulas: documentation, Coarse graining and metrics.

    >>> gf.FieldGrid(cell="5 mm", quantities=["density", "velocity"]).quantities
    ('density', 'velocity')
    """

    width: q.AutoLength = Field(
        "auto", description="kernel width (standard deviation) [m]; auto: the largest radius"
    )
    cutoff: Cutoff = Field(3.0, description="cutoff of the kernel along each axis, in kernel widths")
    interval: q.PositiveTime | None = optional("time between frames [s]", "output.interval")
    stages: StageNames | None = optional("stages in which the fields are written", "all")
    quantities: Annotated[tuple[Text, ...], ListOf(some="[density, velocity]")] | None = optional(
        "fields that are written", "all", examples=[["density", "velocity"]]
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault for each quantity that is not a known field."""
        yield from super().faults()
        for index, name in enumerate(self.quantities or ()):
            if name not in FIELD_QUANTITIES:
                remedy = suggestion_or_list(name, FIELD_QUANTITIES, "fields")
                yield Fault(("quantities", index), f"there is no such field. {remedy}")


# Key `checkpoint`, and the whole block


class Checkpoints(Model):
    """Interval and number of checkpoints for `granflow resume`; a run always writes one at its end.

    A checkpoint is due at simulated or wall-clock times, whichever is first.

    >>> gf.Checkpoints(wall_clock="5 min").wall_clock
    300.0
    """

    wall_clock: q.PositiveTime = Field(600.0, description="wall-clock time between checkpoints [s]")
    interval: q.PositiveTime | None = optional(
        "simulated time between additional checkpoints [s]", "none", examples=["0.5 s"]
    )
    keep: q.Count = Field(2, description="number of checkpoints that are kept, the newest ones")


class Output(Model):
    """Selection and intervals of the output.

    Times are simulated times [s]; the energy budget and wall forces cost time in each step.

    >>> gf.Output(interval="5 ms", contacts=True).timeseries_interval
    0.005
    """

    interval: q.PositiveTime = Field(description="time between VTU frames [s]")
    timeseries_interval: q.PositiveTime = optional(
        "time between rows of timeseries.csv [s]",
        "interval",
        default_factory=lambda given: given.get("interval"),  # None if the interval is not valid
    )
    particles: Flag = Field(True, description="write particles_*.vtu")
    frames_per_rank: Flag = Field(
        False,
        description="on MPI ranks, write one particle file per rank and particles_*.pvtu, which lists them",
    )
    compression: Literal["zlib", "none"] = Field(
        "zlib", description="of VTU files: none is written 7 times as fast; the files are 1.8 times as large"
    )
    contacts: Flag = Field(False, description="write contacts_*.vtu")
    walls: Flag = Field(True, description="write walls_*.vtu")
    energy_budget: Flag = Field(False, description="compute the energy budget")
    wall_forces: FlagOrNames = Field(
        False,
        description=(
            "measure force, torque and pressure of the particles on walls, and the power of the walls; true: "
            "all walls"
        ),
    )
    collision_energies: CollisionEnergies | None = optional(
        "count collisions by impact energy, for collision_energies.csv", "no counts"
    )
    flow_meters: dict[Name, FlowMeter] = Field({}, description="flow meters by name")
    residence_time: ResidenceTime | None = optional(
        "measure the distribution of residence times, for residence_time.csv",
        "none",
        examples=[{"from": "feed", "to": "outlet"}],
    )
    fields: dict[Name, FieldGrid] = Field(
        {},
        description="fields on grids by name, written as fields_NAME_*.vtu",
        examples=[{"bed": {"cell": "5 mm", "quantities": ["solid_fraction", "velocity"]}}],
    )
    metrics: dict[Name, AnyMetric] = Field(
        {}, description="metrics of the bed by name, for timeseries.csv and expect"
    )
    checkpoint: Checkpoints = Field(
        Checkpoints.model_construct(), description="interval and number of checkpoints"
    )


def use_metrics() -> None:
    """Set the key `metrics` to the kinds in METRICS; a schema that is built must be rebuilt afterwards."""
    any_metric: Any = Annotated[Union[tuple(METRICS)], choose_by_key("kind")]  # noqa: UP007
    field = Output.__pydantic_fields__["metrics"]
    annotation: Any = dict[Name, any_metric]
    given: Any = Field({}, description=field.description)
    Output.__pydantic_fields__["metrics"] = FieldInfo.from_annotated_attribute(annotation, given)


# Values of the quantities of a run


def unit_of(name: str) -> str:
    """The unit of a number of a run; "" if it is dimensionless or unknown.

    name:  name of a total or of a number of the run, or `QUANTITY.PART` as in `mass_flow.outlet` and
           `timings.forces`
    """
    quantity = quantity_of(name)
    return "" if quantity is None or quantity.unit == "1" else quantity.unit


class BoundOfQuantity(Number):
    """Reads a number with a unit of the key `quantity` before it; of any dimension if that is unknown."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Validation by `read_for`; serialization without change."""
        return core_schema.with_info_plain_validator_function(self.read_for)

    def read_for(self, value: Any, info: ValidationInfo) -> float | int | str:
        """Convert a value from the file to SI. Raises PydanticCustomError as `Number.read`."""
        quantity = quantity_of(str((info.data or {}).get("quantity", "")))
        fitting = [name for name, each in DIMENSIONS.items() if quantity and each.si_unit == quantity.unit]
        if quantity and quantity.unit == "1":
            fitting = ["number"]
        for name in fitting[:-1]:
            with suppress(PydanticCustomError):
                return Number(name).read(value)
        return Number(fitting[-1] if fitting else "any").read(value)


QuantityBound = Annotated[float, BoundOfQuantity("any")]


# Block `expect`


class Expectation(Model):
    """An expectation for the results of a run: one comparison of one quantity, in SI units.

    The names are those of the totals in timeseries.csv, and NAME.PART for flow meters, walls, metrics and
    groups.

    >>> gf.Expectation(quantity="mass_flow.outlet", equals="1.8 t/h", tolerance=0.05).equals
    0.5
    """

    quantity: Text = Field(
        description="quantity to compare, such as mass_flow.outlet", examples=["mass_flow.outlet"]
    )
    between: Annotated[tuple[QuantityBound, QuantityBound], pair_list("[smallest, largest]")] | None = Field(
        None, description="smallest and largest value"
    )
    below: QuantityBound | None = Field(None, description="upper limit of the quantity")
    above: QuantityBound | None = Field(None, description="lower limit of the quantity")
    equals: QuantityBound | None = Field(None, description="expected value, within the tolerance")
    tolerance: q.NotNegative | None = Field(None, description="with equals: largest relative difference")
    any_scale: Flag = Field(
        False, description="true: evaluate at every scale of the scene; false: only at scale 1"
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the expectation has exactly one comparison, with a tolerance for equals."""
        given = [key for key in ("between", "below", "above", "equals") if getattr(self, key) is not None]
        if len(given) != 1:
            found = f"has {' and '.join(given)}" if given else "has no comparison"
            yield whole((), f"{found}; give exactly one of between, below, above and equals")
            return
        if self.equals is not None and self.tolerance is None:
            yield missing(("tolerance",), "the largest relative difference from equals")
        if self.equals is None and self.tolerance is not None:
            yield Fault(("tolerance",), "it requires equals; remove tolerance")
        if self.between is not None and self.between[0] > self.between[1]:
            yield Fault(("between",), "the first value must be the smaller one")
