"""An observer that calls a Python function at a regular interval."""

from collections.abc import Callable, Iterable

from granflow.observers.base import PARTICLES, TOTALS, WALLS
from granflow.observers.schedule import ScheduledObserver
from granflow.snapshot import Snapshot


class on_interval(ScheduledObserver):
    """Calls `function(snapshot)` every `interval` [s] from `start` [s], and at the end.

    `wants`: parts of the snapshot that the function reads; "contacts" must be added explicitly, because their output
    costs time. The arrays of the snapshot are read-only. A second snapshot of the same time has no effect.

    Raises ValueError for an interval that is not positive and finite.
    """

    def __init__(
        self,
        interval: float,
        function: Callable[[Snapshot], None],
        wants: Iterable[str] = (PARTICLES, WALLS, TOTALS),
        start: float = 0.0,
    ) -> None:
        super().__init__(interval, start)
        self.wants, self._function = frozenset(wants), function

    def observe(self, snapshot: Snapshot) -> None:
        """Call the function with the snapshot."""
        if self._schedule.mark_done(snapshot.time):
            self._function(snapshot)
