"""Schema of what is worked out from particles and contacts while a scene runs: fields on a grid."""

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from granflow.quantities import FIELD_QUANTITIES
from granflow.scene.fields import (
    Auto,
    Counts,
    Fault,
    Model,
    Names,
    Number,
    PositiveLength,
    PositiveTime,
    Text,
    listing,
)
from granflow.scene.places import Box
from granflow.scene.suggest import known_or_meant

MOST_CELLS = 2_000_000
"""Of a grid: a frame of that many takes about a gigabyte of memory."""

Width = Annotated[float | Auto, Number("length", above=0, words=("auto",))]
CutOff = Annotated[float, Number(noun="a cut-off", at_least=1, at_most=10)]


class CellGrid(Model):
    """A box cut into cells, by their edge or their number."""

    region: Box | None = Field(None, description="the box that is cut into cells; left out: the domain")
    cell: PositiveLength | None = Field(None, description="edge of a cell [m], fitted to the box; or give cells")
    cells: Counts | None = Field(None, description="number of cells along x, y and z; or give cell")

    def faults(self) -> Iterator[Fault]:
        """An edge or a number."""
        if (self.cell is None) == (self.cells is None):
            given = "has neither cell nor cells" if self.cell is None else "has both cell and cells"
            yield Fault((), f"{given}; give the edge of a cell, or how many along x, y and z", whole=True)

    def counts_in(self, domain: Box) -> tuple[int, int, int]:
        """Cells along x, y and z where the domain stands in for a region left out."""
        if self.cells is not None:
            return self.cells
        assert self.cell is not None
        box, edge = self.region or domain, self.cell
        x, y, z = (max(round((high - low) / edge), 1) for low, high in zip(box.min, box.max, strict=True))
        return x, y, z


class FieldGrid(CellGrid):
    """Fields on a grid, coarse-grained with a Gaussian, for ParaView."""

    width: Width = Field("auto", description="width (standard deviation) of the kernel [m]; auto: the largest radius")
    cut_off: CutOff = Field(3.0, description="distance along each axis at which the kernel ends, in widths")
    interval: PositiveTime | None = Field(None, description="time between frames [s]; left out: output.interval")
    stages: Names | None = Field(None, description="stages in which they are written; left out: all")
    quantities: Annotated[tuple[Text, ...], listing(some="[density, velocity]")] = Field(
        tuple(FIELD_QUANTITIES), description="fields that are written; left out: all"
    )

    def faults(self) -> Iterator[Fault]:
        """Fields that exist."""
        yield from super().faults()
        for index, name in enumerate(self.quantities):
            if name not in FIELD_QUANTITIES:
                remedy = known_or_meant(name, FIELD_QUANTITIES, "fields")
                yield Fault(("quantities", index), f"there is no such field. {remedy}")
