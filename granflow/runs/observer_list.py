"""The observers of a run: one snapshot for all that are due, their readings, and their state."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from math import inf

from granflow.observers.base import Checkpointable, Observer
from granflow.observers.timeseries import TimeSeries
from granflow.runs.timings import Readings
from granflow.snapshot import Snapshot

TakeSnapshot = Callable[[frozenset[str]], Snapshot]
"""Function from the requested quantities to a snapshot of the present state."""


class ObserverList:
    """The observers of a run, in the order in which they receive snapshots."""

    def __init__(self, observers: Sequence[Observer]) -> None:
        self._observers = tuple(observers)
        self._series = [observer for observer in observers if isinstance(observer, TimeSeries)][:1]

    def next_time(self) -> float:
        """Return the simulated time [s] of the next due observer; infinite without."""
        return min((observer.next_time() for observer in self._observers), default=inf)

    def notify_due(self, is_reached: Callable[[float], bool], take: TakeSnapshot) -> None:
        """Pass one snapshot to the observers that are due; `is_reached`: whether a time [s] is reached."""
        if due := [observer for observer in self._observers if is_reached(observer.next_time())]:
            self._pass_snapshot(due, take, frozenset(), only_finite=False)

    def notify_all(
        self, take: TakeSnapshot, quantities: frozenset[str] = frozenset(), only_finite: bool = False
    ) -> Snapshot:
        """Pass a snapshot to all observers and return it.

        quantities:   quantities in addition to those that the observers request
        only_finite:  pass it only if all its numbers are finite
        """
        return self._pass_snapshot(self._observers, take, quantities, only_finite)

    @staticmethod
    def _pass_snapshot(
        observers: Sequence[Observer], take: TakeSnapshot, quantities: frozenset[str], only_finite: bool
    ) -> Snapshot:
        snapshot = take(quantities.union(*(observer.wants for observer in observers)))
        for observer in observers if not only_finite or snapshot.is_finite else ():
            observer.observe(snapshot)
        return snapshot

    def readings(self) -> Mapping[str, Readings]:
        """Return the numbers of the flow meters, wall forces and metrics."""
        return self._series[0].results_by_kind() if self._series else {}

    @property
    def rows_intact(self) -> bool:
        """Whether the time series still has all rows of the resumed run."""
        return all(series.rows_intact for series in self._series)

    def checkpointed(self) -> dict[str, Checkpointable]:
        """Return the observers whose state is part of checkpoints, by unique names."""
        found: dict[str, Checkpointable] = {}
        for observer in self._observers:
            if isinstance(observer, Checkpointable):
                kind = type(observer).__name__
                found[f"{kind} {sum(name.startswith(kind) for name in found)}"] = observer
        return found

    @contextmanager
    def finishing(self) -> Iterator[None]:
        """Close the files of all observers at the end of the block."""
        try:
            yield
        finally:
            for observer in self._observers:
                observer.finish()
