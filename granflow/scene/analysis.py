"""Schema of what is worked out from particles and contacts while a scene runs: fields on a grid, indices."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field, Tag

from granflow.quantities import FIELD_QUANTITIES
from granflow.scene.fields import (
    Auto,
    Count,
    Counts,
    Fault,
    Model,
    Names,
    Number,
    Point,
    PositiveLength,
    PositiveTime,
    Text,
    UnscaledLength,
    choose_by_key,
    list_of,
)
from granflow.scene.insertion_schema import Box
from granflow.scene.suggest import suggestion_or_list

Width = Annotated[float | Auto, Number("length", above=0, words=("auto",))]
Cutoff = Annotated[float, Number(noun="a cut-off", at_least=1, at_most=10)]


class GridSpec(Model):
    """A box cut into cells, by their edge or their number."""

    region: Box | None = Field(None, description="the box that is cut into cells; left out: the domain")
    cell: PositiveLength | None = Field(None, description="edge of a cell [m], fitted to the box; or give cells")
    cells: Counts | None = Field(None, description="number of cells along x, y and z; or give cell")

    def faults(self) -> Iterator[Fault]:
        """An edge or a number."""
        if (self.cell is None) == (self.cells is None):
            given = "has neither cell nor cells" if self.cell is None else "has both cell and cells"
            yield Fault((), f"{given}; give the edge of a cell, or how many along x, y and z", whole=True)

    def cell_counts(self, domain: Box) -> tuple[int, int, int]:
        """Cells along x, y and z where the domain stands in for a region left out."""
        if self.cells is not None:
            return self.cells
        assert self.cell is not None
        box, edge = self.region or domain, self.cell
        x, y, z = (max(round((high - low) / edge), 1) for low, high in zip(box.min, box.max, strict=True))
        return x, y, z


class FieldGrid(GridSpec):
    """Fields on a grid, coarse-grained with a Gaussian, for ParaView."""

    width: Width = Field("auto", description="width (standard deviation) of the kernel [m]; auto: the largest radius")
    cutoff: Cutoff = Field(3.0, description="distance along each axis at which the kernel ends, in widths")
    interval: PositiveTime | None = Field(None, description="time between frames [s]; left out: output.interval")
    stages: Names | None = Field(None, description="stages in which they are written; left out: all")
    quantities: Annotated[tuple[Text, ...], list_of(some="[density, velocity]")] = Field(
        tuple(FIELD_QUANTITIES), description="fields that are written; left out: all"
    )

    def faults(self) -> Iterator[Fault]:
        """Fields that exist."""
        yield from super().faults()
        for index, name in enumerate(self.quantities):
            if name not in FIELD_QUANTITIES:
                remedy = suggestion_or_list(name, FIELD_QUANTITIES, "fields")
                yield Fault(("quantities", index), f"there is no such field. {remedy}")


class LaceyMetric(GridSpec):
    """Lacey's mixing index of the grains of some groups, materials or sizes among all."""

    kind: Literal["lacey"] = Field(description="kind of index")
    groups: Names | None = Field(None, description="groups whose grains are the one kind")
    materials: Names | None = Field(None, description="materials whose grains are the one kind")
    smaller_than: UnscaledLength | None = Field(None, description="diameter below which grains are the one kind [m]")
    at_least: Count = Field(10, description="grains that a cell must hold to count")

    def faults(self) -> Iterator[Fault]:
        """One way of telling the two kinds apart."""
        yield from super().faults()
        given = [key for key in ("groups", "materials", "smaller_than") if getattr(self, key) is not None]
        if len(given) != 1:
            found = f"has {' and '.join(given)}" if given else "does not say which grains are the one kind"
            yield Fault((), f"{found}; give exactly one of groups, materials and smaller_than", whole=True)


class ReposeMetric(Model):
    """Angle of repose of the heap of grains that have two contacts or more."""

    kind: Literal["repose"] = Field(description="kind of index")
    surface: Literal["cone", "plane"] = Field(
        description="cone: a heap about an upright axis; plane: one side of a wedge, a bed in a drum"
    )
    region: Box | None = Field(None, description="the box whose grains are looked at; left out: all")
    axis: Point | None = Field(None, description="with cone: a point on its axis [m]; left out: the mean of the grains")

    def faults(self) -> Iterator[Fault]:
        """An axis for a cone only."""
        if self.surface == "plane" and self.axis is not None:
            yield Fault(("axis",), "it goes only with surface: cone; leave it out")


class FabricMetric(Model):
    """Fabric tensor of the contacts between grains."""

    kind: Literal["fabric"] = Field(description="kind of index")
    region: Box | None = Field(None, description="the box whose contacts are looked at; left out: all")


class CoordinationMetric(Model):
    """Coordination number with and without rattlers."""

    kind: Literal["coordination"] = Field(description="kind of index")
    region: Box | None = Field(None, description="the box whose grains are looked at; left out: all")


class ContentMetric(Model):
    """What is in a box: grains whose center is inside, whole."""

    kind: Literal["content"] = Field(description="kind of index")
    region: Box = Field(description="the box whose grains are counted")


AnyMetric = Annotated[
    Annotated[LaceyMetric, Tag("<lacey>")]
    | Annotated[ReposeMetric, Tag("<repose>")]
    | Annotated[FabricMetric, Tag("<fabric>")]
    | Annotated[CoordinationMetric, Tag("<coordination>")]
    | Annotated[ContentMetric, Tag("<content>")],
    choose_by_key("kind"),
]

METRIC_QUANTITIES_BY_KIND = {
    "content": ("content_count", "content_mass", "content_volume"),
    "lacey": ("lacey_index",),
    "repose": ("angle_of_repose", "angle_of_repose_error"),
    "fabric": ("fabric_anisotropy", "fabric_xx", "fabric_yy", "fabric_zz"),
    "coordination": ("coordination_number", "mechanical_coordination_number", "rattler_share"),
}
"""Numbers that an index of each kind gives; for each there is also its mean, NAME_mean."""
