"""The observers that write CSV files: `timeseries.csv` and `collision_energies.csv`.

`TimeSeries` writes one row of numbers per due time: totals of the snapshot, and the readings of the meters
and metrics, which it updates. `CollisionEnergies` writes the numbers of collisions by impact energy.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from granflow.fields import (
    FLOW_METER_QUANTITIES,
    METRIC_QUANTITIES,
    RESIDENCE_QUANTITIES,
    TOTAL_QUANTITIES,
    WALL_FORCE_QUANTITIES,
    Quantity,
    quantity_of,
)
from granflow.io.tables import COLLISION_COLUMNS, COLLISION_FILE, RowFile
from granflow.observers.meters import FlowCount, FlowCounter, StageRows, WallForceMeter
from granflow.observers.metrics import MetricMeter
from granflow.observers.observer import ScheduledObserver
from granflow.observers.passages import PassageTable, ResidenceTimes
from granflow.snapshot import PARTICLES, TOTALS, Snapshot

# `timeseries.csv`

READINGS: Mapping[str, Mapping[str, Quantity]] = {
    "flow_meters": FLOW_METER_QUANTITIES,
    "wall_forces": WALL_FORCE_QUANTITIES,
    "metrics": METRIC_QUANTITIES,
}
"""Quantities that the meters of each kind read, by name, in the order of the columns."""
NO_ROWS = {"size": 0, "unwritten": ""}
"""State of the rows without a file."""
SHORTEST_ROW = 0.5
"""Smallest time between two rows, as a fraction of their interval."""
Meter = FlowCounter | WallForceMeter | MetricMeter
"""Measures each snapshot of the time series."""


@dataclass(frozen=True)
class Row:
    """One row of a time series: its time and that of the row before it [s], and its numbers by name as in
    `expect`."""

    time: float
    time_before: float
    numbers: Mapping[str, float]


class TimeSeries(ScheduledObserver):
    """Writes the totals of the snapshots and the readings of flow meters, wall forces and metrics; flushes
    each row.

    The first snapshot determines the columns: time [s], stage, its totals in the order of `granflow.fields`,
    then for each flow meter the mass and number passed and the mass flow rate since the previous row, then
    for each measured wall the mean force since the previous row, then the metrics. The header contains the
    units. Without a directory no file is written, but meters, wall forces and metrics are updated.

    Each row covers at least SHORTEST_ROW of the interval: a snapshot that follows the last row earlier, at
    the end of a run, replaces it, and its means are those since the row before. They would otherwise be those
    of one or a few steps.

    `passages`: tables of flow meters by name. `residence`: residence times between flow meters. `interval`,
    `start` [s]: of the rows, in simulated time.
    """

    def __init__(
        self,
        directory: Path | None,
        interval: float,
        flow_meters: Mapping[str, FlowCounter] | None = None,
        start: float = 0.0,
        wall_forces: Mapping[str, WallForceMeter] | None = None,
        metrics: Mapping[str, MetricMeter] | None = None,
        passages: Mapping[str, PassageTable] | None = None,
        residence: ResidenceTimes | None = None,
    ) -> None:
        super().__init__(interval, start)
        self._stage_rows = StageRows()
        self._passages = dict(passages or {})
        self._residence = residence
        given: tuple[Mapping[str, Meter] | None, ...] = (flow_meters, wall_forces, metrics)
        self.meters = {kind: dict(meters or {}) for kind, meters in zip(READINGS, given, strict=True)}
        self.wants = frozenset({TOTALS, PARTICLES} if flow_meters else {TOTALS})
        self.wants = self.wants.union(*(metric.wants for metric in (metrics or {}).values()))
        self.path = None if directory is None else Path(directory) / "timeseries.csv"
        self._rows = None if self.path is None else RowFile(self.path)
        self._last: tuple[float, float, Mapping[str, float]] | None = None
        self._names: list[str] = []
        self._time_before: float | None = None
        self._stage = ""

    def observe(self, snapshot: Snapshot) -> None:
        """Write one row; a second snapshot of the same time has no effect.

        Raises OSError if the row cannot be written; its remaining bytes are written before the next row.
        """
        before = self._schedule.last_time
        if not self._schedule.mark_done(snapshot.time):
            return
        replaces_last = self._replaces_last(before, snapshot)
        if not replaces_last:
            self._time_before = before
        self._stage = snapshot.stage
        for meters in self.meters.values():
            for meter in meters.values():
                meter.update(snapshot, replaces_last)
        known = {name: number for name, number in snapshot.totals.items() if name in TOTAL_QUANTITIES}
        self._stage_rows.update(snapshot.stage, known, replaces_last)
        self._record_passages(snapshot, replaces_last)
        time_before = snapshot.time if self._time_before is None else self._time_before
        self._last = snapshot.time, time_before, snapshot.totals
        if self._rows is None:
            return
        readings = self._readings()
        if self._rows.is_empty:
            first = [name for name in TOTAL_QUANTITIES if name in snapshot.totals]
            self._names = first + [name for name in snapshot.totals if name not in TOTAL_QUANTITIES]
            self._rows.write(["time [s]", "stage", *map(_column_label, self._names), *readings])
        totals = [snapshot.totals.get(name, "") for name in self._names]
        self._rows.write([snapshot.time, snapshot.stage, *totals, *readings.values()], replaces_last)

    def _record_passages(self, snapshot: Snapshot, replaces_last: bool) -> None:
        """Write the passages of the flow meters, and the particles that have left, since the last sample."""
        meters = {
            name: each for name, each in self.meters["flow_meters"].items() if isinstance(each, FlowCounter)
        }
        for name, table in self._passages.items():
            table.record(meters[name].passages)
        if self._residence is not None:
            self._residence.record(snapshot, meters, replaces_last)

    @property
    def _files(self) -> dict[str, RowFile]:
        """All files of this observer, by the name of their state."""
        residence = None if self._residence is None else self._residence.rows
        files = {"timeseries": self._rows, "residence_time": residence}
        files |= {f"passages.{name}": table.rows for name, table in self._passages.items()}
        return {name: rows for name, rows in files.items() if rows is not None}

    def _replaces_last(self, last: float | None, snapshot: Snapshot) -> bool:
        """Whether the row of a snapshot replaces the last one, at `last` [s]: it is short, and of the same
        stage."""
        if last is None or self._time_before is None or snapshot.stage != self._stage:
            return False
        return snapshot.time - last < SHORTEST_ROW * self._schedule.interval

    @property
    def last_row(self) -> Row | None:
        """The last row of this process, from the present readings of the meters; without a request it costs
        nothing."""
        if self._last is None:
            return None
        time, time_before, totals = self._last
        readings = {f"{quantity.name}.{name}": value for quantity, name, value in self._read_meters()}
        return Row(time, time_before, {**totals, **readings})

    def finish(self) -> None:
        """Close the files."""
        for rows in self._files.values():
            rows.close()

    def results_by_kind(self) -> dict[str, dict[str, dict[str, float]]]:
        """Return the final numbers of flow meters, measured walls, metrics, stages and residence times: kind
        -> name -> quantity -> value.

        The parts of a flow meter follow it, as `outlet.glass`.
        """
        results = {kind: {name: meter.result() for name, meter in self._named(kind)} for kind in self.meters}
        results["stages"] = self._stage_rows.by_stage()
        if self._residence is not None:
            results["residence_time"] = {self._residence.to: self._residence.result()}
        return results

    def remarks(self) -> list[str]:
        """Return sentences on metrics and flow meters, such as the reason why a last value is NaN."""
        return [
            f"output.{kind}.{name}: {sentence}."
            for kind, meters in self.meters.items()
            for name, meter in meters.items()
            if isinstance(meter, FlowCounter | MetricMeter)
            for sentence in (meter.total if isinstance(meter, FlowCounter) else meter).remarks()
        ]

    def _named(self, kind: str) -> Iterator[tuple[str, FlowCount | WallForceMeter | MetricMeter]]:
        """Yield the meters of a kind by name; for flow meters the counts, of which parts have names of their
        own."""
        for name, meter in self.meters[kind].items():
            if isinstance(meter, FlowCounter):
                yield from (
                    (f"{name}.{part}".rstrip("."), count) for part, count in meter.flow_counts().items()
                )
            else:
                yield name, meter

    def _readings(self) -> dict[str, float]:
        """Return the readings of all meters by column name, with units, in the order of the columns."""
        return {quantity.label_of(name): value for quantity, name, value in self._read_meters()}

    def _read_meters(self) -> Iterator[tuple[Quantity, str, float]]:
        """Yield quantity, name of the meter and value of all readings, in the order of the columns."""
        for kind, known in READINGS.items():
            for name, meter in self._named(kind):
                yield from ((known[quantity], name, value) for quantity, value in meter.readings().items())
        if self._residence is not None:
            for quantity, value in self._residence.readings().items():
                yield RESIDENCE_QUANTITIES[quantity], self._residence.to, value

    def sync(self) -> None:
        """Flush all rows to the disk."""
        for rows in self._files.values():
            rows.sync()

    def state_dict(self) -> dict[str, Any]:
        """Return the sizes of the files [bytes] and their last rows, the columns, and the state of the
        meters."""
        meters = {
            kind: {name: each.state_dict() for name, each in named.items()}
            for kind, named in self.meters.items()
        }
        return {
            **super().state_dict(),
            "columns": self._names,
            "time_before": self._time_before,
            "stage": self._stage,
            "stage_rows": self._stage_rows.state_dict(),
            "files": {name: rows.state_dict() for name, rows in self._files.items()},
            "residence": self._residence.state_dict() if self._residence is not None else {},
            **meters,
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state; later rows have the same columns. The meters must have the same names as those
        saved."""
        super().load_state_dict(saved)
        self._names = saved["columns"]
        self._time_before = saved["time_before"]
        self._stage = saved["stage"]
        self._stage_rows.load_state_dict(saved["stage_rows"])
        for name, rows in self._files.items():
            rows.load_state_dict(saved["files"].get(name, NO_ROWS))
        if self._residence is not None and saved["residence"]:
            self._residence.load_state_dict(saved["residence"])
        for kind, meters in self.meters.items():
            for name, meter in meters.items():
                meter.load_state_dict(saved[kind][name])

    @property
    def rows_intact(self) -> bool:
        """Whether the files still contain all rows of the restored state."""
        return all(rows.is_intact for rows in self._files.values())

    def truncate(self) -> None:
        """Remove the rows after the restored state; if earlier rows are missing, continue with the remaining
        ones."""
        for rows in self._files.values():
            rows.truncate()


def _column_label(name: str) -> str:
    """Return the column name of a total with its unit, also for totals of one outlet or wall."""
    quantity = quantity_of(name)
    part = name.partition(".")[2]
    if quantity is None:
        return name
    return quantity.label_of(part) if part else quantity.label


# `collision_energies.csv`


class CollisionEnergies(ScheduledObserver):
    """Writes one row per interval, kind of contact ("particle" or "wall") and class of impact energy.

    The first class of each kind has no lower edge (0 J), the last one no upper edge (inf). `count` is the
    number of contacts that began in the interval, `count_total` that since the start of the run.

    interval:  [s], in simulated time
    edges:     (n + 1,) [J], of the classes
    """

    wants = frozenset({TOTALS})

    def __init__(self, directory: Path, interval: float, edges: np.ndarray) -> None:
        super().__init__(interval)
        self._bounds = list(zip([0.0, *edges.tolist()], [*edges.tolist(), np.inf], strict=True))
        self._rows = RowFile(Path(directory) / COLLISION_FILE)
        self._counted = {kind: np.zeros(len(edges) + 1, dtype=np.int64) for kind in ("particle", "wall")}

    def observe(self, snapshot: Snapshot) -> None:
        """Write the rows of the interval since the last snapshot; the first snapshot begins the first
        interval."""
        before = self._schedule.last_time
        if not self._schedule.mark_done(snapshot.time):
            return
        if self._rows.is_empty:
            self._rows.write(COLLISION_COLUMNS)
        if before is None:
            return
        for kind, counts in snapshot.collisions.items():
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
