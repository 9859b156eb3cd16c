"""Grid of cells in a box of a scene: keys that fields and metrics share."""

import math
from collections.abc import Iterator

from pydantic import Field

from granflow.geometry.coarse_grid import CoarseGrid
from granflow.geometry.periodic_box import AXES
from granflow.scene.blocks.domain import Domain
from granflow.scene.blocks.primitives import Box
from granflow.schema import quantities as q
from granflow.schema.faults import Fault, whole
from granflow.schema.model import Model, optional

MOST_CELLS = 2_000_000
"""Largest number of cells of a grid: one frame of this size takes about 1 GB of memory."""


class GridSpec(Model):
    """A box divided into cells, given by their edge length or their number.

    Along periodic axes of the domain, the box must cover the whole domain.
    """

    region: Box | None = optional("box that is divided into cells", "the domain")
    cell: q.PositiveLength | None = Field(
        None,
        description="edge length of a cell [m], adjusted to fit the box; or give cells",
        examples=["5 mm"],
    )
    cells: q.Counts | None = Field(
        None, description="number of cells along x, y and z; or give cell", examples=[[4, 4, 8]]
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless exactly one of edge length and number of cells is given."""
        if (self.cell is None) == (self.cells is None):
            given = "has neither cell nor cells" if self.cell is None else "has both cell and cells"
            yield whole((), f"{given}; give the edge length of a cell, or the number along x, y and z")

    def cell_counts(self, domain: Box) -> tuple[int, int, int]:
        """Number of cells along x, y and z, each at least 1; without a region the grid covers `domain`.

        A given edge length [m] is adjusted such that a whole number of cells fits into the box.
        """
        if self.cells is not None:
            return self.cells
        assert self.cell is not None
        box = self.region or domain
        edge = self.cell
        x, y, z = (max(round((high - low) / edge), 1) for low, high in zip(box.min, box.max, strict=True))
        return x, y, z

    def grid_in(self, domain: Domain) -> CoarseGrid:
        """The cells; axes that are periodic in the domain are periodic in the grid."""
        box = self.region or domain
        x, y, z = (axis in domain.periodic for axis in AXES)
        return CoarseGrid(box.min, box.max, self.cell_counts(domain), (x, y, z))

    def too_many_cells(self, domain: Domain) -> Iterator[Fault]:
        """A fault for more than MOST_CELLS cells; none if the number of cells is not defined."""
        if (self.cell is None) == (self.cells is None):
            return
        count = math.prod(self.cell_counts(domain))
        if count > MOST_CELLS:
            reason = f"this gives {count:_} cells, and the limit is {MOST_CELLS:_}".replace("_", " ")
            yield Fault(("cell" if self.cells is None else "cells",), reason)
