"""Coarse-grained fields for ParaView: `fields_NAME_0000.vtu`, ..., and their mean over time."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from granflow.fields import FIELD_QUANTITIES
from granflow.io.background_writer import BackgroundWriter
from granflow.io.checkpoint import CheckpointError
from granflow.io.vtu import Compression, VtuMesh, write_vtu
from granflow.observers.base import CONTACTS, PARTICLES
from granflow.observers.coarse_graining.accumulation import CONTACT_FIELDS, AccumulatedFields, accumulate, fields_from
from granflow.observers.coarse_graining.field_grid import CoarseGrid
from granflow.observers.coarse_graining.kernel import GaussianKernel
from granflow.observers.vtu import Frames
from granflow.snapshot import Snapshot


class FieldFrames(Frames):
    """`fields_NAME_NNNN.vtu`: hexahedra with the fields `quantities`; at the end `fields_NAME_mean.vtu`.

    `interval` [s] of simulated time between frames; `grid`, `kernel`: of the coarse graining; `quantities`: names in
    FIELD_QUANTITIES, which determine whether contacts are requested; `stages`: stages with frames, all if empty. The
    mean weights all frames equally.
    """

    def __init__(
        self,
        directory: Path,
        name: str,
        interval: float,
        grid: CoarseGrid,
        kernel: GaussianKernel,
        quantities: Sequence[str] = tuple(FIELD_QUANTITIES),
        stages: Sequence[str] = (),
        writer: BackgroundWriter | None = None,
        compression: Compression = "zlib",
    ) -> None:
        self.stem = f"fields_{name}"
        super().__init__(directory, interval, writer=writer, compression=compression)
        with_contacts = not set(CONTACT_FIELDS).isdisjoint(quantities)
        self.wants = frozenset({PARTICLES, CONTACTS} if with_contacts else {PARTICLES})
        self.grid, self.kernel = grid, kernel
        self._quantities, self._stages = tuple(quantities), tuple(stages)
        self._accumulated: AccumulatedFields | None = None
        self._count = 0

    def observe(self, snapshot: Snapshot) -> None:
        """Write one frame if the stage is one of `stages`; otherwise skip the due time."""
        if self._stages and snapshot.stage not in self._stages:
            self._schedule.mark_done(snapshot.time)
        else:
            super().observe(snapshot)

    def mesh(self, snapshot: Snapshot) -> VtuMesh:
        """Return the mesh of one frame and add it to the mean."""
        contacts = snapshot.contacts if CONTACTS in self.wants else None
        accumulated = accumulate(snapshot.particles, contacts, self.grid, self.kernel)
        self._accumulated = accumulated if self._accumulated is None else self._accumulated + accumulated
        self._count += 1
        return self._mesh_of(accumulated)

    def finish(self) -> None:
        """Write the mean over all frames."""
        if self._accumulated is not None:
            path = self.series.directory / f"{self.stem}_mean.vtu"
            write_vtu(path, self._mesh_of(self._accumulated / self._count), self.series.compression)

    def state_dict(self) -> dict[str, Any]:
        """Return the list of frames, the accumulated sums (cells, components) and the number of frames."""
        total = {} if self._accumulated is None else dict(self._accumulated.arrays)
        return super().state_dict() | {"total": total, "count": self._count}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state. Raises CheckpointError if the grid has another number of cells."""
        super().load_state_dict(saved)
        if any(len(accumulated) != self.grid.cell_count for accumulated in saved["total"].values()):
            raise CheckpointError(
                f"The checkpoint contains {self.stem} on a grid with another number of cells; remove it."
            )
        self._accumulated = AccumulatedFields(dict(saved["total"])) if saved["total"] else None
        self._count = saved["count"]

    def _mesh_of(self, accumulated: AccumulatedFields) -> VtuMesh:
        fields = fields_from(accumulated)
        arrays: dict[str, np.ndarray] = {
            name: FIELD_QUANTITIES[name].for_file(fields[name]) for name in self._quantities
        }
        return self.grid.mesh(arrays)
