"""Due times at a regular interval."""

import math
import weakref
from typing import Any

from granflow.errors import GranflowError

# A time that precedes a due time by less than this fraction of the interval counts as due: the simulated clock is
# rounded, and a frame one step later would duplicate the state.
EARLY_FRACTION = 1e-3


class Schedule:
    """Due times `start + k * interval` [s], k = 0, 1, 2, ..., without accumulation of rounding errors.

    Raises GranflowError unless the interval is positive and finite.
    """

    def __init__(self, interval: float, start: float = 0.0) -> None:
        if not (interval > 0 and math.isfinite(interval)):
            raise GranflowError(f"interval is {interval} s, but must be positive and finite.")
        self.interval = interval
        self.start = start
        self._count = 0
        self._last_time: float | None = None

    def next_time(self) -> float:
        """Return the next due time [s]: the first one after the last time marked as done."""
        return self.start + self._count * self.interval

    @property
    def last_time(self) -> float | None:
        """The last time marked as done [s]: the only state of a schedule."""
        return self._last_time

    def reset(self) -> None:
        """Begin again."""
        self._count, self._last_time = 0, None

    def resume_after(self, last_time: float | None) -> None:
        """Continue after a time [s] of an earlier run, which may have used another interval."""
        if last_time is not None:
            self.mark_done(last_time)

    def mark_done(self, time: float) -> bool:
        """Mark all due times up to `time` [s] as done; return False if this time was the last one marked.

        A due time within EARLY_FRACTION of the interval after `time` counts as done too.
        """
        if time == self._last_time:
            return False
        self._last_time = time
        passed = math.floor((time - self.start) / self.interval + EARLY_FRACTION) + 1
        self._count = max(self._count, passed)
        return True


class ScheduledObserver:
    """Base class of observers with a schedule: due times from `start` [s], every `interval` [s]; no files."""

    wants: frozenset[str] = frozenset()

    def __init__(self, interval: float, start: float = 0.0) -> None:
        self._schedule = Schedule(interval, start)
        self._run: weakref.ref[object] | None = None

    @property
    def interval(self) -> float:
        """Interval [s]; fixed: another observer has another one."""
        return self._schedule.interval

    @interval.setter
    def interval(self, value: object) -> None:
        raise AttributeError(
            f"interval of {getattr(self, 'name', type(self).__name__)} cannot be set: remove the observer from "
            "simulation.observers and append another one, granflow.on_interval(interval, function)."
        )

    def begin(self, run: object) -> bool:
        """Belong to a run from its start on; False if another run, which has not ended, already has this observer."""
        other = None if self._run is None else self._run()
        if other is not None and other is not run:
            return False
        if other is None:
            self._schedule.reset()
        self._run = weakref.ref(run)
        return True

    def end(self) -> None:
        """Belong to no run any more."""
        self._run = None

    def next_time(self) -> float:
        """Return the time of the next snapshot [s]."""
        return self._schedule.next_time()

    def skip_to(self, time: float) -> None:
        """Skip the due times up to `time` [s]."""
        self._schedule.mark_done(time)

    def finish(self) -> None:
        """Do nothing: no file is open."""

    def state_dict(self) -> dict[str, Any]:
        """Return the last time [s]."""
        return {"last_time": self._schedule.last_time}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue after the saved time."""
        self._schedule.resume_after(saved["last_time"])

    def truncate(self) -> None:
        """Do nothing: this observer has no files."""
