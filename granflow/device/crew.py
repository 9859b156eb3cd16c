"""How many CPU threads take part in a launch. Results do not depend on it, so it is found while running.

Threads wait for each other after every phase of a step. Where other work takes their cores away, one of them waits
for milliseconds, and fewer threads are faster: nobody can know that beforehand.
"""

FIRST_TRY, LAST_TRY = 8, 64
"""Launches from one trial of another size to the next; twice as many after each that was in vain, up to the last."""

GAIN = 1.05
"""How much faster a trial must be than the launch before it."""

LEAST_SECONDS = 0.002
"""Shorter launches say more about launching than about working."""

PATIENCE = 5
"""A long wait counts two, a launch without one takes one off; above this the crew is halved."""


class Crew:
    """Proposes a size for each launch and learns from how fast it was."""

    def __init__(self, most: int) -> None:
        self.size = most
        self._most = most
        self._rate = 0.0
        self._launches = 0
        self._next_try = FIRST_TRY
        self._trial = 0
        self._upwards = False
        self._annoyance = 0

    @property
    def next_size(self) -> int:
        """Threads for the coming launch."""
        return self._trial or self.size

    def record(self, work: int, seconds: float, waited: bool) -> None:
        """Tell how much the launch did, in any unit that stays the same, how long it took, and if it waited long."""
        trial, self._trial = self._trial, 0
        if trial:
            self._judge(trial, not waited and seconds >= LEAST_SECONDS and work > GAIN * self._rate * seconds)
            return
        self._annoyance = max(self._annoyance + (2 if waited else -1), 0)
        if self._annoyance > PATIENCE:
            self.size, self._annoyance = max(self.size // 2, 1), 0
            self._launches, self._next_try, self._upwards = 0, FIRST_TRY, False
        elif seconds >= LEAST_SECONDS:
            self._rate = work / seconds
        self._launches += 1
        if self._launches == self._next_try:
            self._launches, self._trial = 0, self._other_size()

    def _judge(self, trial: int, better: bool) -> None:
        if better:
            self.size = trial
        self._next_try = FIRST_TRY if better else min(2 * self._next_try, LAST_TRY)

    def _other_size(self) -> int:
        """Twice or half the size, in turn; 0 where there is neither."""
        self._upwards = not self._upwards
        other = min(2 * self.size, self._most) if self._upwards else self.size // 2
        return 0 if other == self.size else other
