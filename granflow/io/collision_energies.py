"""`collision_energies.csv`: its name, its columns, and its counts by interval and class."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from granflow.io.tables import Table

FILE = "collision_energies.csv"
"""Name of the file in the directory of a run."""

COLUMNS = (
    "time_start [s]", "time_end [s]", "contact", "energy_min [J]", "energy_max [J]", "count", "count_total",
)  # fmt: skip
"""Columns of the file."""


@dataclass(frozen=True)
class CollisionTable:
    """Numbers of collisions by kind of contact ("particle" or "wall"), in i intervals and c classes of impact energy.

    time:    ends of the intervals (i,) [s]
    edges:   of the classes (c, 2) [J]; the first one begins at 0, the last one ends at infinity
    counts:  (i, c) contacts that began in the interval, by kind
    totals:  (i, c) contacts that began since the start of the run, by kind
    """

    time: np.ndarray
    edges: np.ndarray
    counts: dict[str, np.ndarray]
    totals: dict[str, np.ndarray]

    @property
    def energy(self) -> np.ndarray:
        """Logarithmic centers (c,) [J] of the classes; nan for the first and the last one, which are open."""
        center = np.full(len(self.edges), np.nan)
        center[1:-1] = np.sqrt(self.edges[1:-1, 0] * self.edges[1:-1, 1])
        return center


def has_collisions(names: Sequence[str]) -> bool:
    """Whether these are the columns of `collision_energies.csv`."""
    return tuple(names) == COLUMNS


def collision_table(table: Table) -> CollisionTable | None:
    """The counts in a table with the columns COLUMNS, without an incomplete last interval; None if none is complete."""
    rows = table.complete()
    column = {name.partition(" [")[0]: rows.numbers(k) for k, name in enumerate(COLUMNS) if name != "contact"}
    end, kinds = column["time_end"], list(dict.fromkeys(rows.texts(COLUMNS.index("contact"))))
    size = int(np.sum(end == end[0])) if len(end) else 0
    if not size or size % len(kinds) or np.isfinite(column["energy_max"][size - 1]):
        return None
    shape = (len(end) // size, len(kinds), size // len(kinds))
    arrays = {name: values[: shape[0] * size].reshape(shape) for name, values in column.items()}
    return CollisionTable(
        arrays["time_end"][:, 0, 0],
        np.stack([arrays["energy_min"][0, 0], arrays["energy_max"][0, 0]], axis=1),
        {kind: arrays["count"][:, k] for k, kind in enumerate(kinds)},
        {kind: arrays["count_total"][:, k] for k, kind in enumerate(kinds)},
    )
