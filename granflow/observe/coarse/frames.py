"""Fields as frames for ParaView: `fields_NAME_0000.vtu`, ..., and their mean over time."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from granflow.observe.checkpoint import CheckpointError
from granflow.observe.coarse.grid import Grid
from granflow.observe.coarse.kernel import Kernel
from granflow.observe.coarse.sums import OF_CONTACTS, Sums, fields_of, sums_of
from granflow.observe.frames import write_vtu
from granflow.observe.observer import CONTACTS, PARTICLES
from granflow.observe.vtu import Frames
from granflow.quantities import FIELD_QUANTITIES
from granflow.snapshot import Snapshot


class FieldFrames(Frames):
    """`fields_NAME_NNNN.vtu`: hexahedra with the fields `quantities`; at the end `fields_NAME_mean.vtu`.

    Only in `stages`, or in all if there are none named. The mean is that of all frames, each with the same weight.
    """

    def __init__(
        self,
        directory: Path,
        name: str,
        interval: float,
        grid: Grid,
        kernel: Kernel,
        quantities: Sequence[str] = tuple(FIELD_QUANTITIES),
        stages: Sequence[str] = (),
    ) -> None:
        self.stem = f"fields_{name}"
        super().__init__(directory, interval)
        with_contacts = not set(OF_CONTACTS).isdisjoint(quantities)
        self.wants = frozenset({PARTICLES, CONTACTS} if with_contacts else {PARTICLES})
        self.grid, self.kernel = grid, kernel
        self._quantities, self._stages = tuple(quantities), tuple(stages)
        self._total: Sums | None = None
        self._count = 0

    def observe(self, snapshot: Snapshot) -> None:
        """Write one frame if it is one of the stages."""
        if self._stages and snapshot.stage not in self._stages:
            self._schedule.take(snapshot.time)
        else:
            super().observe(snapshot)

    def mesh(self, snapshot: Snapshot) -> meshio.Mesh:
        """Make the mesh of one frame, which counts for the mean."""
        contacts = snapshot.contacts if CONTACTS in self.wants else None
        sums = sums_of(snapshot.particles, contacts, self.grid, self.kernel)
        self._total = sums if self._total is None else self._total + sums
        self._count += 1
        return self._mesh_of(sums)

    def finish(self) -> None:
        """Write the mean."""
        if self._total is not None:
            path = self.series.directory / f"{self.stem}_mean.vtu"
            write_vtu(path, self._mesh_of(self._total / self._count))

    def keep(self) -> dict[str, Any]:
        """The frames written so far, and what they add up to."""
        total = {} if self._total is None else dict(self._total.arrays)
        return super().keep() | {"total": total, "count": self._count}

    def put_back(self, kept: dict[str, Any]) -> None:
        """Go on after those frames."""
        super().put_back(kept)
        if any(len(sums) != self.grid.cell_count for sums in kept["total"].values()):
            raise CheckpointError(f"The checkpoint holds {self.stem} on a grid of other cells; remove it.")
        self._total = Sums(dict(kept["total"])) if kept["total"] else None
        self._count = kept["count"]

    def _mesh_of(self, sums: Sums) -> meshio.Mesh:
        fields = fields_of(sums)
        arrays: dict[str, np.ndarray] = {
            FIELD_QUANTITIES[name].vtu_name: FIELD_QUANTITIES[name].for_file(fields[name]) for name in self._quantities
        }
        return self.grid.mesh(arrays)
