"""An observer that calls a Python function at a regular interval."""

from collections.abc import Callable, Iterable

from granflow.errors import StopRun
from granflow.observers.base import CONTACTS, PARTICLES, TOTALS, WALLS
from granflow.observers.schedule import ScheduledObserver
from granflow.scene.schema.units import seconds_of
from granflow.snapshot import Snapshot


class on_interval(ScheduledObserver):
    """Calls `function(snapshot)` every `interval` from `start`, and at the end of the run.

    `interval`, `start`: simulated time, a number [s] or text with a unit ("1 ms"). `wants`: parts of the snapshot that
    the function reads; "contacts" must be added explicitly, because their output costs time. The arrays of the snapshot
    are read-only; the function may change the simulation itself (`simulation.particles`, `simulation.walls`), and
    raises `granflow.StopRun` to end the run. A second snapshot of the same time has no effect.

        simulation.observers.append(granflow.on_interval("1 ms", lambda snapshot: print(snapshot.time)))

    `name`: of the function, in messages and checkpoints. Raises ValueError for an interval that is not positive and
    finite, a unit that is not one of time, an unknown part, or an object that is not a function.
    """

    def __init__(
        self,
        interval: float | str,
        function: Callable[[Snapshot], object],
        wants: Iterable[str] = (PARTICLES, WALLS, TOTALS),
        start: float | str = 0.0,
    ) -> None:
        super().__init__(seconds_of("interval", interval), seconds_of("start", start))
        self.wants, self._function = frozenset(wants), function
        if not callable(function):
            raise ValueError(f"function is {function!r}, but must be a function of a snapshot.")
        if unknown := self.wants - {PARTICLES, CONTACTS, WALLS, TOTALS}:
            raise ValueError(f"wants contains {min(unknown)!r}, but has parts of particles, contacts, walls, totals.")
        self.name = getattr(function, "__name__", type(function).__name__)

    def observe(self, snapshot: Snapshot) -> None:
        """Call the function with the snapshot; if it fails, the snapshot counts as not observed."""
        if snapshot.time == self._schedule.last_time:
            return
        try:
            self._function(snapshot)
        except StopRun:
            self._schedule.mark_done(snapshot.time)
            raise
        self._schedule.mark_done(snapshot.time)
