"""A plain Python function as an observer."""

from collections.abc import Callable, Iterable
from typing import Any

from granflow.observe.observer import PARTICLES, TOTALS, WALLS
from granflow.observe.schedule import Schedule
from granflow.snapshot import Snapshot


class PeriodicObserver:
    """Shows a snapshot to a function at a regular interval; see `every`."""

    def __init__(self, schedule: Schedule, function: Callable[[Snapshot], None], wants: frozenset[str]) -> None:
        self.wants = wants
        self._schedule = schedule
        self._function = function

    def next_time(self) -> float:
        """Time [s] of the next due moment."""
        return self._schedule.next_time()

    def observe(self, snapshot: Snapshot) -> None:
        """Call the function."""
        if self._schedule.mark_done(snapshot.time):
            self._function(snapshot)

    def state_dict(self) -> dict[str, Any]:
        """When the function was called last."""
        return {"last_time": self._schedule.last_time}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Go on after that."""
        self._schedule.resume_after(saved["last_time"])

    def truncate(self) -> None:
        """It has no files."""

    def finish(self) -> None:
        """Nothing is open."""


def every(
    interval: float,
    function: Callable[[Snapshot], None],
    wants: Iterable[str] = (PARTICLES, WALLS, TOTALS),
    start: float = 0.0,
) -> PeriodicObserver:
    """Call `function(snapshot)` every `interval` [s] of simulated time from `start` [s] on, and at the end.

    `wants` names the parts that must be in the snapshot; add "contacts" to see contacts. Raises ValueError for an
    interval that is not positive.
    """
    return PeriodicObserver(Schedule(interval, start), function, frozenset(wants))
