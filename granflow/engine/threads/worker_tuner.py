"""Chooses the number of CPU workers of a launch during the run; results do not depend on it.

Workers wait for each other after each phase of a step. If other processes use the cores, fewer workers can be faster.
Trials with twice or half the workers measure it; contention makes a trial with half the workers due at once.
"""

WINDOW = 0.02
"""Launch time [s] over which a rate is measured; also the length of a trial."""

UP_INTERVAL = 0.7
"""Launch time [s] between two trials with more workers."""

FIRST_DOWN_INTERVAL, LAST_DOWN_INTERVAL = 0.25, 8.0
"""Launch time [s] until a trial with fewer workers; doubled after each trial that was not faster."""

CONTENDED_DOWN_INTERVAL = 0.25
"""Launch time [s] between two trials with fewer workers that contention makes due."""

MEMORY = 0.7
"""Weight of the previous rates in the mean with which a trial is compared: a single interruption has little effect."""

MIN_SPEEDUP = 1.05
"""A trial is faster if its rate is at least this multiple of the previous rate."""

CONTENTION_LIMIT = 3
"""A launch with contention adds 2 to a score, one without subtracts 1. Above this limit half the workers are tried."""


class WorkerTuner:
    """Proposes the number of workers of each launch from the rate and the contention of previous launches.

    max_size:  largest number of workers, with which the first launch starts

    `size` is the number of workers outside trials.
    """

    def __init__(self, max_size: int) -> None:
        self.size = max_size
        self._max_size = max_size
        self._candidate = 0
        self._rate = 0.0
        self._contention = 0
        self._down_interval = FIRST_DOWN_INTERVAL
        self._since_up = self._since_down = 0.0
        self._since_contended_down = CONTENDED_DOWN_INTERVAL
        self._start_window()

    @property
    def next_size(self) -> int:
        """Number of workers for the next launch."""
        return self._candidate or self.size

    def record(self, work: float, seconds: float, contended: bool) -> None:
        """Record a launch.

        work:       amount of work in a constant unit, such as particle-steps
        seconds:    wall-clock time [s]
        contended:  True if a worker left the launch
        """
        self._work += work
        self._seconds += seconds
        self._since_up += seconds
        self._since_down += seconds
        self._since_contended_down += seconds
        if not self._candidate:
            self._contention = max(self._contention + (2 if contended else -1), 0)
        if self._seconds < WINDOW:
            return
        rate = self._work / self._seconds
        self._start_window()
        if self._candidate:
            self._evaluate(rate)
        else:
            self._rate = MEMORY * self._rate + (1.0 - MEMORY) * rate if self._rate else rate
            self._candidate = self._next_trial()

    def _start_window(self) -> None:
        self._work = self._seconds = 0.0

    def _evaluate(self, rate: float) -> None:
        """Adopt the number of workers of the trial if it is faster.

        `rate`: work per second during the trial. The interval between trials with fewer workers doubles after each of
        them that is not faster.
        """
        faster, down, self._candidate, candidate = (
            rate > MIN_SPEEDUP * self._rate,
            self._candidate < self.size,
            0,
            self._candidate,
        )
        self._contention = 0
        if faster:
            self.size, self._rate = candidate, rate
        if faster or not down:
            self._down_interval = FIRST_DOWN_INTERVAL if faster else self._down_interval
        else:
            self._down_interval = min(2 * self._down_interval, LAST_DOWN_INTERVAL)

    def _next_trial(self) -> int:
        """Number of workers of the next trial; 0 if no trial is due."""
        if self.size > 1 and self._down_is_due():
            self._since_down = self._since_contended_down = 0.0
            return self.size // 2
        if self.size < self._max_size and self._since_up >= UP_INTERVAL:
            self._since_up = 0.0
            return min(2 * self.size, self._max_size)
        return 0

    def _down_is_due(self) -> bool:
        """True if a trial with fewer workers is due, because of the interval or of contention."""
        contended = self._contention > CONTENTION_LIMIT and self._since_contended_down >= CONTENDED_DOWN_INTERVAL
        return contended or self._since_down >= self._down_interval
