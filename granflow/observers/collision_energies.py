"""Writes `collision_energies.csv`: numbers of collisions by impact energy, per interval and since the start."""

from pathlib import Path
from typing import Any

import numpy as np

from granflow.io.collision_energies import COLUMNS, FILE
from granflow.io.row_file import RowFile
from granflow.observers.base import TOTALS
from granflow.observers.schedule import ScheduledObserver
from granflow.snapshot import Snapshot


class CollisionEnergies(ScheduledObserver):
    """Writes one row per interval, kind of contact ("particle" or "wall") and class of impact energy.

    The first class of each kind has no lower edge (0 J), the last one no upper edge (inf). `count` is the number of
    contacts that began in the interval, `count_total` that since the start of the run.

    interval:  [s], in simulated time
    edges:     (n + 1,) [J], of the classes
    """

    wants = frozenset({TOTALS})

    def __init__(self, directory: Path, interval: float, edges: np.ndarray) -> None:
        super().__init__(interval)
        self._bounds = list(zip([0.0, *edges.tolist()], [*edges.tolist(), np.inf], strict=True))
        self._rows = RowFile(Path(directory) / FILE)
        self._counted = {kind: np.zeros(len(edges) + 1, dtype=np.int64) for kind in ("particle", "wall")}

    def observe(self, snapshot: Snapshot) -> None:
        """Write the rows of the interval since the last snapshot; the first snapshot begins the first interval."""
        before = self._schedule.last_time
        if not self._schedule.mark_done(snapshot.time):
            return
        if self._rows.is_empty:
            self._rows.write(COLUMNS)
        for kind, counts in snapshot.collisions.items() if before is not None else ():
            new = counts - self._counted[kind]
            for (low, high), count, total in zip(self._bounds, new.tolist(), counts.tolist(), strict=True):
                self._rows.write([before, snapshot.time, kind, low, high, count, total])
            self._counted[kind] = counts

    def finish(self) -> None:
        """Close the file."""
        self._rows.close()

    def sync(self) -> None:
        """Flush all rows to the disk."""
        self._rows.sync()

    def state_dict(self) -> dict[str, Any]:
        """Return the time of the last rows, the counts there, and the size of the file."""
        return super().state_dict() | self._rows.state_dict() | {"counted": dict(self._counted)}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state of `state_dict`."""
        super().load_state_dict(saved)
        self._rows.load_state_dict(saved)
        self._counted = {kind: np.array(saved["counted"][kind]) for kind in self._counted}

    def truncate(self) -> None:
        """Remove the rows after the restored state."""
        self._rows.truncate()
