"""Simulated time, step by step."""

import numpy as np


class Clock:
    """Counts steps and gives their times [s]; a new time step holds from the present moment on.

    Times come from step numbers, not from a running sum, so that they do not depend on how steps are launched.
    """

    def __init__(self, time_step: float) -> None:
        self.time_step = time_step
        self.step_count = 0
        self._since_step, self._since_time = 0, 0.0

    @property
    def time(self) -> float:
        """Simulated time [s] now."""
        return float(self.time_after(self.step_count))

    def time_after(self, step: int | np.ndarray) -> float | np.ndarray:
        """Simulated time [s] after these step numbers, none before the present time step began to hold."""
        return self._since_time + (step - self._since_step) * self.time_step

    def change(self, time_step: float) -> None:
        """Have the steps from now on take so long [s]."""
        self._since_time, self._since_step = self.time, self.step_count
        self.time_step = time_step

    def state_dict(self) -> dict[str, float]:
        """Everything it knows, for a checkpoint."""
        return {
            "time_step": self.time_step, "step_count": self.step_count,
            "since_step": self._since_step, "since_time": self._since_time,
        }  # fmt: skip

    def load_state_dict(self, saved: dict[str, float]) -> None:
        """Go on as one whose `state_dict` gave this."""
        self.time_step, self.step_count = saved["time_step"], int(saved["step_count"])
        self._since_step, self._since_time = int(saved["since_step"]), saved["since_time"]
