"""Due times at a regular interval."""

import math

# A moment this small a part of the interval before a due time counts as the due time: the simulated clock is
# rounded, and a frame one step later would show the same thing twice.
EARLY_FRACTION = 1e-3


class Schedule:
    """Due at `start + k * interval` [s], k = 0, 1, 2, ..., each worked out afresh: no rounding adds up.

    Raises ValueError unless the interval is positive and finite.
    """

    def __init__(self, interval: float, start: float = 0.0) -> None:
        if not (interval > 0 and math.isfinite(interval)):
            raise ValueError(f"interval is {interval} s, but must be positive and finite.")
        self.interval = interval
        self.start = start
        self._count = 0
        self._last_time: float | None = None

    def next_time(self) -> float:
        """Time [s] of the next due moment."""
        return self.start + self._count * self.interval

    @property
    def last_time(self) -> float | None:
        """The moment [s] taken last: all that a schedule remembers."""
        return self._last_time

    def resume_after(self, last_time: float | None) -> None:
        """Count on after a moment [s] of an earlier run, whatever the interval was there."""
        if last_time is not None:
            self.mark_done(last_time)

    def mark_done(self, time: float) -> bool:
        """Mark all moments up to `time` [s] as done; False if this very time was taken before."""
        if time == self._last_time:
            return False
        self._last_time = time
        passed = math.floor((time - self.start) / self.interval + EARLY_FRACTION) + 1
        self._count = max(self._count, passed)
        return True
