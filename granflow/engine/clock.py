"""Simulated time, step by step."""

import numpy as np


class Clock:
    """Counts steps and computes their times [s]. A new time step applies from the present time on.

    Times follow from step numbers and not from a running sum, so that they do not depend on the launches.
    """

    def __init__(self, time_step: float) -> None:
        """Start at time 0 with a time step [s]."""
        self.time_step = time_step
        self.step_count = 0
        self._since_step, self._since_time = 0, 0.0

    @property
    def time(self) -> float:
        """Simulated time [s] now."""
        return float(self.time_after(self.step_count))

    def time_after(self, step: int | np.ndarray) -> float | np.ndarray:
        """Simulated time [s] after step numbers, scalar or (k,); none may precede the last change of the time step."""
        return self._since_time + (step - self._since_step) * self.time_step

    def change(self, time_step: float) -> None:
        """Set the time step [s] of all further steps."""
        self._since_time, self._since_step = self.time, self.step_count
        self.time_step = time_step

    def state_dict(self) -> dict[str, float]:
        """The complete state of the clock, for a checkpoint."""
        return {
            "time_step": self.time_step, "step_count": self.step_count,
            "since_step": self._since_step, "since_time": self._since_time,
        }  # fmt: skip

    def load_state_dict(self, saved: dict[str, float]) -> None:
        """Restore a state that `state_dict` returned."""
        self.time_step, self.step_count = saved["time_step"], int(saved["step_count"])
        self._since_step, self._since_time = int(saved["since_step"]), saved["since_time"]
