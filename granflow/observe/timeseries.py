"""`timeseries.csv`: one row of numbers per due time."""

import csv
import os
from collections.abc import Mapping
from io import FileIO, StringIO
from pathlib import Path
from typing import Any

from granflow.observe.indices.meter import IndexMeter
from granflow.observe.loads import LoadMeter
from granflow.observe.meters import FlowMeter, Tally
from granflow.observe.observer import PARTICLES, TOTALS
from granflow.observe.schedule import Schedule
from granflow.quantities import (
    INDEX_QUANTITIES,
    LOAD_QUANTITIES,
    METER_QUANTITIES,
    OUTLET_QUANTITIES,
    TOTAL_QUANTITIES,
    WALL_QUANTITIES,
)
from granflow.snapshot import Snapshot


class TimeSeries:
    """Writes the totals of the snapshots and the readings of flow meters and loads, and flushes every row.

    The columns are fixed by the first snapshot: time [s], stage, the totals it has in the order of the
    glossary, then per meter the mass and number passed and the mass flow since the row before, then per
    measured wall the mean load since the row before, then the numbers of every index. Units stand in the
    header. Without a directory nothing is written, and meters, loads and indices are read all the same.
    """

    def __init__(
        self,
        directory: Path | None,
        interval: float,
        meters: Mapping[str, FlowMeter] | None = None,
        start: float = 0.0,
        loads: Mapping[str, LoadMeter] | None = None,
        indices: Mapping[str, IndexMeter] | None = None,
    ) -> None:
        self.meters, self.loads, self.indices = dict(meters or {}), dict(loads or {}), dict(indices or {})
        self.wants = frozenset({TOTALS, PARTICLES} if self.meters else {TOTALS})
        self.wants = self.wants.union(*(index.wants for index in self.indices.values()))
        self.path = None if directory is None else Path(directory) / "timeseries.csv"
        self._schedule = Schedule(interval, start)
        self._names: list[str] = []
        self._file: FileIO | None = None
        self._size = 0
        self._unwritten = b""

    def next_time(self) -> float:
        """Time [s] of the next row."""
        return self._schedule.next_time()

    def observe(self, snapshot: Snapshot) -> None:
        """Write one row; the same moment shown twice gives one."""
        if not self._schedule.take(snapshot.time):
            return
        for meter in self.meters.values():
            meter.look(snapshot)
        for load in self.loads.values():
            load.look(snapshot)
        for index in self.indices.values():
            index.look(snapshot)
        if self.path is None:
            return
        if not self._size and not self._unwritten:
            self._head(snapshot)
        totals = [snapshot.totals.get(name, "") for name in self._names]
        self._write_row([snapshot.time, snapshot.stage, *totals, *self._readings()])

    def finish(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def results(self) -> dict[str, dict[str, float]]:
        """Numbers of every meter at the end, by the meter's name, and of its parts, as `outlet.glass`."""
        return {name: tally.result() for name, tally in self._tallies().items()}

    def _tallies(self) -> dict[str, Tally]:
        """What the meters count, by their names and those of the parts."""
        meters = self.meters.items()
        return {f"{name}.{part}".rstrip("."): tally for name, each in meters for part, tally in each.tallies().items()}

    def all_results(self) -> dict[str, dict[str, dict[str, float]]]:
        """Numbers at the end of every meter, measured wall and index, by its name."""
        loads = {name: load.result() for name, load in self.loads.items()}
        indices = {name: index.result() for name, index in self.indices.items()}
        return {"meters": self.results(), "loads": loads, "indices": indices}

    def keep(self) -> dict[str, Any]:
        """The size of the file, all rows of which are brought to the disk first, and what the meters counted."""
        if self._file is not None:
            os.fsync(self._file.fileno())
        return {
            "last_time": self._schedule.last_time,
            "columns": self._names,
            "size": self._size,
            "unwritten": self._unwritten.decode(),
            "meters": {name: meter.keep() for name, meter in self.meters.items()},
            "loads": {name: load.keep() for name, load in self.loads.items()},
            "indices": {name: index.keep() for name, index in self.indices.items()},
        }

    def put_back(self, kept: dict[str, Any]) -> None:
        """Go on with the same columns behind those rows."""
        self._schedule.go_on_after(kept["last_time"])
        self._names, self._size, self._unwritten = kept["columns"], kept["size"], kept["unwritten"].encode()
        for name, meter in self.meters.items():
            meter.put_back(kept["meters"][name])
        for name, load in self.loads.items():
            load.put_back(kept["loads"][name])
        for name, index in self.indices.items():
            index.put_back(kept["indices"][name])

    @property
    def rows_are_there(self) -> bool:
        """Whether the file still holds all rows that were written when the state was kept."""
        return self.path is None or _size_of(self.path) >= self._size

    def cut_back(self) -> None:
        """Remove the rows that came after; where rows before are gone, go on with those that are left."""
        if self.path is not None and self._size:
            self._size = min(self._size, _size_of(self.path))
            if self._size:
                os.truncate(self.path, self._size)

    def _open(self, path: Path) -> FileIO:
        path.parent.mkdir(parents=True, exist_ok=True)
        return FileIO(path, "a" if self._size else "w")

    def _head(self, snapshot: Snapshot) -> None:
        known = [name for name in TOTAL_QUANTITIES if name in snapshot.totals]
        self._names = known + [name for name in snapshot.totals if name not in TOTAL_QUANTITIES]
        self._write_row(["time [s]", "stage", *map(_label, self._names), *self._meter_labels()])

    def _write_row(self, row: list[Any]) -> None:
        line = StringIO()
        csv.writer(line, lineterminator="\n").writerow(row)
        self._unwritten += line.getvalue().encode()
        assert self.path is not None
        self._file = self._file or self._open(self.path)
        while self._unwritten:
            written = self._file.write(self._unwritten)
            self._size, self._unwritten = self._size + written, self._unwritten[written:]

    def _readings(self) -> list[float]:
        flows = [number for tally in self._tallies().values() for number in tally.readings()]
        loads = [number for load in self.loads.values() for number in load.readings().values()]
        return flows + loads + [number for index in self.indices.values() for number in index.readings().values()]

    def _meter_labels(self) -> list[str]:
        quantities = METER_QUANTITIES.values()
        flows = [quantity.label_of(name) for name in self._tallies() for quantity in quantities]
        loads = [LOAD_QUANTITIES[each].label_of(name) for name, load in self.loads.items() for each in load.readings()]
        known, indices = INDEX_QUANTITIES, self.indices.items()
        return flows + loads + [known[each].label_of(name) for name, index in indices for each in index.readings()]


def _size_of(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def _label(name: str) -> str:
    quantity, _, part = name.partition(".")
    of_parts = {**OUTLET_QUANTITIES, **WALL_QUANTITIES}
    if quantity in of_parts:
        return of_parts[quantity].label_of(part)
    return TOTAL_QUANTITIES[name].label if name in TOTAL_QUANTITIES else name
