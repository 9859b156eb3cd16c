"""Observers that call a Python function at a regular interval."""

from collections.abc import Callable, Iterable
from typing import Any

from granflow.observers.base import PARTICLES, TOTALS, WALLS
from granflow.observers.schedule import Schedule
from granflow.snapshot import Snapshot


class PeriodicObserver:
    """Calls a function with a snapshot at a regular interval; see `on_interval`."""

    def __init__(self, schedule: Schedule, function: Callable[[Snapshot], None], wants: frozenset[str]) -> None:
        self.wants = wants
        self._schedule = schedule
        self._function = function

    def next_time(self) -> float:
        """Return the next due time [s]."""
        return self._schedule.next_time()

    def observe(self, snapshot: Snapshot) -> None:
        """Call the function with the snapshot; a second snapshot of the same time has no effect."""
        if self._schedule.mark_done(snapshot.time):
            self._function(snapshot)

    def state_dict(self) -> dict[str, Any]:
        """Return the time of the last call [s]."""
        return {"last_time": self._schedule.last_time}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue after the saved time."""
        self._schedule.resume_after(saved["last_time"])

    def truncate(self) -> None:
        """Do nothing: this observer has no files."""

    def finish(self) -> None:
        """Do nothing: no file is open."""


def on_interval(
    interval: float,
    function: Callable[[Snapshot], None],
    wants: Iterable[str] = (PARTICLES, WALLS, TOTALS),
    start: float = 0.0,
) -> PeriodicObserver:
    """Return an observer that calls `function(snapshot)` every `interval` [s] from `start` [s], and at the end.

    `wants`: parts of the snapshot that the function reads; "contacts" must be added explicitly, because their output
    costs time. The arrays of the snapshot are read-only.

    Raises ValueError for an interval that is not positive and finite.
    """
    return PeriodicObserver(Schedule(interval, start), function, frozenset(wants))
