"""`timeseries.csv`: one row of numbers per due time."""

import csv
from collections.abc import Mapping
from io import TextIOWrapper
from pathlib import Path
from typing import Any

from granflow.observe.meters import FlowMeter
from granflow.observe.observer import PARTICLES, TOTALS
from granflow.observe.schedule import Schedule
from granflow.quantities import METER_QUANTITIES, TOTAL_QUANTITIES
from granflow.snapshot import Snapshot


class TimeSeries:
    """Writes the totals of the snapshots and the readings of the flow meters, and flushes every row.

    The columns are fixed by the first snapshot: time [s], stage, the totals it has in the order of the
    glossary, then per meter the mass and number passed and the mass flow since the row before. Units stand
    in the header. Without a directory nothing is written and the meters are read all the same.
    """

    def __init__(
        self,
        directory: Path | None,
        interval: float,
        meters: Mapping[str, FlowMeter] | None = None,
        start: float = 0.0,
    ) -> None:
        self.meters = dict(meters or {})
        self.wants = frozenset({TOTALS, PARTICLES} if self.meters else {TOTALS})
        self.path = None if directory is None else Path(directory) / "timeseries.csv"
        self._schedule = Schedule(interval, start)
        self._names: list[str] = []
        self._file: TextIOWrapper | None = None

    def next_time(self) -> float:
        """Time [s] of the next row."""
        return self._schedule.next_time()

    def observe(self, snapshot: Snapshot) -> None:
        """Write one row; the same moment shown twice gives one."""
        if not self._schedule.take(snapshot.time):
            return
        for meter in self.meters.values():
            meter.look(snapshot)
        if self.path is None:
            return
        if self._file is None:
            self._open(self.path, snapshot)
        totals = [snapshot.totals.get(name, "") for name in self._names]
        self._write_row([snapshot.time, snapshot.stage, *totals, *self._readings()])

    def finish(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()

    def results(self) -> dict[str, dict[str, float]]:
        """Numbers of every meter at the end, by the meter's name."""
        return {name: meter.result() for name, meter in self.meters.items()}

    def _open(self, path: Path, snapshot: Snapshot) -> None:
        known = [name for name in TOTAL_QUANTITIES if name in snapshot.totals]
        self._names = known + [name for name in snapshot.totals if name not in TOTAL_QUANTITIES]
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = open(path, "w", newline="", encoding="utf-8")
        self._write_row(["time [s]", "stage", *map(_label, self._names), *self._meter_labels()])

    def _write_row(self, row: list[Any]) -> None:
        assert self._file is not None
        csv.writer(self._file, lineterminator="\n").writerow(row)
        self._file.flush()

    def _readings(self) -> list[float]:
        meters = self.meters.values()
        return [number for meter in meters for number in (meter.mass, meter.count, meter.mass_flow())]

    def _meter_labels(self) -> list[str]:
        quantities = METER_QUANTITIES.values()
        return [quantity.label_of(name) for name in self.meters for quantity in quantities]


def _label(name: str) -> str:
    return TOTAL_QUANTITIES[name].label if name in TOTAL_QUANTITIES else name
