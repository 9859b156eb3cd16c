"""Writes `timeseries.csv`: one row of numbers per due time."""

import os
from collections.abc import Mapping
from io import FileIO
from pathlib import Path
from typing import Any

from granflow.fields import (
    FLOW_METER_QUANTITIES,
    METRIC_QUANTITIES,
    OUTLET_QUANTITIES,
    TOTAL_QUANTITIES,
    WALL_FORCE_QUANTITIES,
    WALL_QUANTITIES,
)
from granflow.io.tables import csv_line
from granflow.observers.base import PARTICLES, TOTALS
from granflow.observers.flow_meters import FlowCount, FlowMeter
from granflow.observers.metrics.meter import MetricMeter
from granflow.observers.schedule import Schedule
from granflow.observers.wall_forces import WallForceMeter
from granflow.snapshot import Snapshot


class TimeSeries:
    """Writes the totals of the snapshots and the readings of flow meters, wall forces and metrics; flushes each row.

    The first snapshot determines the columns: time [s], stage, its totals in the order of `granflow.fields`, then
    for each flow meter the mass and number passed and the mass flow rate since the previous row, then for each measured
    wall the mean force since the previous row, then the metrics. The header contains the units. Without a directory no
    file is written, but meters, wall forces and metrics are updated.

    `interval`, `start` [s]: of the rows, in simulated time. Raises ValueError for an interval that is not positive.
    """

    def __init__(
        self,
        directory: Path | None,
        interval: float,
        flow_meters: Mapping[str, FlowMeter] | None = None,
        start: float = 0.0,
        wall_forces: Mapping[str, WallForceMeter] | None = None,
        metrics: Mapping[str, MetricMeter] | None = None,
    ) -> None:
        self.flow_meters, self.wall_forces, self.metrics = (
            dict(flow_meters or {}),
            dict(wall_forces or {}),
            dict(metrics or {}),
        )
        self.wants = frozenset({TOTALS, PARTICLES} if self.flow_meters else {TOTALS})
        self.wants = self.wants.union(*(metric.wants for metric in self.metrics.values()))
        self.path = None if directory is None else Path(directory) / "timeseries.csv"
        self._schedule = Schedule(interval, start)
        self._names: list[str] = []
        self._file: FileIO | None = None
        self._size = 0
        self._unwritten = b""

    def next_time(self) -> float:
        """Return the time of the next row [s]."""
        return self._schedule.next_time()

    def observe(self, snapshot: Snapshot) -> None:
        """Write one row; a second snapshot of the same time has no effect.

        Raises OSError if the row cannot be written; its remaining bytes are written before the next row.
        """
        if not self._schedule.mark_done(snapshot.time):
            return
        for meter in self.flow_meters.values():
            meter.update(snapshot)
        for wall_force in self.wall_forces.values():
            wall_force.update(snapshot)
        for metric in self.metrics.values():
            metric.update(snapshot)
        if self.path is None:
            return
        if not self._size and not self._unwritten:
            self._write_header(snapshot)
        totals = [snapshot.totals.get(name, "") for name in self._names]
        self._write_row([snapshot.time, snapshot.stage, *totals, *self._readings()])

    def finish(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def results(self) -> dict[str, dict[str, float]]:
        """Return the final numbers of each flow meter by name, and of its parts, as `outlet.glass`."""
        return {name: flow_count.result() for name, flow_count in self._flow_counts().items()}

    def _flow_counts(self) -> dict[str, FlowCount]:
        """Return the counts of the flow meters by name, and of their parts."""
        flow_meters = self.flow_meters.items()
        return {
            f"{name}.{part}".rstrip("."): flow_count
            for name, each in flow_meters
            for part, flow_count in each.flow_counts().items()
        }

    def results_by_kind(self) -> dict[str, dict[str, dict[str, float]]]:
        """Return the final numbers of flow meters, measured walls and metrics: kind -> name -> quantity -> value."""
        wall_forces = {name: wall_force.result() for name, wall_force in self.wall_forces.items()}
        metrics = {name: metric.result() for name, metric in self.metrics.items()}
        return {"flow_meters": self.results(), "wall_forces": wall_forces, "metrics": metrics}

    def state_dict(self) -> dict[str, Any]:
        """Flush all rows to the disk; return the file size [bytes], the columns and the state of the meters."""
        if self._file is not None:
            os.fsync(self._file.fileno())
        return {
            "last_time": self._schedule.last_time,
            "columns": self._names,
            "size": self._size,
            "unwritten": self._unwritten.decode(),
            "flow_meters": {name: meter.state_dict() for name, meter in self.flow_meters.items()},
            "wall_forces": {name: wall_force.state_dict() for name, wall_force in self.wall_forces.items()},
            "metrics": {name: metric.state_dict() for name, metric in self.metrics.items()},
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state; later rows have the same columns. The meters must have the same names as those saved."""
        self._schedule.resume_after(saved["last_time"])
        self._names, self._size, self._unwritten = saved["columns"], saved["size"], saved["unwritten"].encode()
        for name, meter in self.flow_meters.items():
            meter.load_state_dict(saved["flow_meters"][name])
        for name, wall_force in self.wall_forces.items():
            wall_force.load_state_dict(saved["wall_forces"][name])
        for name, metric in self.metrics.items():
            metric.load_state_dict(saved["metrics"][name])

    @property
    def rows_intact(self) -> bool:
        """Whether the file still contains all rows of the restored state."""
        return self.path is None or _size_of(self.path) >= self._size

    def truncate(self) -> None:
        """Remove the rows after the restored state; if earlier rows are missing, continue with the remaining ones."""
        if self.path is not None and self._size:
            self._size = min(self._size, _size_of(self.path))
            if self._size:
                os.truncate(self.path, self._size)

    def _open(self, path: Path) -> FileIO:
        path.parent.mkdir(parents=True, exist_ok=True)
        return FileIO(path, "a" if self._size else "w")

    def _write_header(self, snapshot: Snapshot) -> None:
        known = [name for name in TOTAL_QUANTITIES if name in snapshot.totals]
        self._names = known + [name for name in snapshot.totals if name not in TOTAL_QUANTITIES]
        self._write_row(["time [s]", "stage", *map(_column_label, self._names), *self._meter_labels()])

    def _write_row(self, row: list[Any]) -> None:
        """Write one row and flush it; bytes that could not be written are kept for the next call. Raises OSError."""
        self._unwritten += csv_line(row).encode()
        assert self.path is not None
        self._file = self._file or self._open(self.path)
        while self._unwritten:
            written = self._file.write(self._unwritten)
            self._size, self._unwritten = self._size + written, self._unwritten[written:]

    def _readings(self) -> list[float]:
        """Return the readings of all meters in the order of the columns."""
        flows = [number for flow_count in self._flow_counts().values() for number in flow_count.readings()]
        wall_forces = [number for wall_force in self.wall_forces.values() for number in wall_force.readings().values()]
        return (
            flows + wall_forces + [number for metric in self.metrics.values() for number in metric.readings().values()]
        )

    def _meter_labels(self) -> list[str]:
        """Return the column names of all meters, with units, in the order of `_readings`."""
        quantities = FLOW_METER_QUANTITIES.values()
        flows = [quantity.label_of(name) for name in self._flow_counts() for quantity in quantities]
        wall_forces = [
            WALL_FORCE_QUANTITIES[each].label_of(name)
            for name, wall_force in self.wall_forces.items()
            for each in wall_force.readings()
        ]
        known, metrics = METRIC_QUANTITIES, self.metrics.items()
        return (
            flows + wall_forces + [known[each].label_of(name) for name, metric in metrics for each in metric.readings()]
        )


def _size_of(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def _column_label(name: str) -> str:
    """Return the column name of a total with its unit, also for totals of one outlet or wall, such as `NAME.PART`."""
    quantity, _, part = name.partition(".")
    of_parts = {**OUTLET_QUANTITIES, **WALL_QUANTITIES}
    if quantity in of_parts:
        return of_parts[quantity].label_of(part)
    return TOTAL_QUANTITIES[name].label if name in TOTAL_QUANTITIES else name
