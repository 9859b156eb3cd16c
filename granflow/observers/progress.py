"""Progress of a run: a live bar on a terminal, lines at intervals elsewhere."""

import math
import sys
import time as clock
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TextIO

from granflow.observers.observer import ScheduledObserver
from granflow.snapshot import Snapshot

if TYPE_CHECKING:
    from rich.progress import TaskID

UPDATE_COUNT = 500
"""Updates per run: at fixed simulated times, independent of the wall clock, so that the display does not
affect a run."""


class ProgressDisplay(ScheduledObserver):
    """Shows simulated time, stage, steps per second, particle-steps per second and time left.

    `stages`: (name, maximum duration [s]) in order. A stage that ends early reduces the total. `stream`:
    standard error by default. If it is not a terminal, a line is printed at the start of each stage, every
    ten seconds of wall clock, and at the end.
    """

    def __init__(self, stages: Sequence[tuple[str, float]], stream: TextIO | None = None) -> None:
        stream = stream or sys.stderr
        self._stage_plan = StagePlan(stages)
        super().__init__(self._stage_plan.end / UPDATE_COUNT)
        self._rates = StepRates()
        self._display: _Bar | _Lines = _Bar(stream) if stream.isatty() else _Lines(stream)

    def observe(self, snapshot: Snapshot) -> None:
        """Update the display with time, step, stage and the total `particle_count` of a snapshot."""
        self._schedule.mark_done(snapshot.time)
        self._stage_plan.enter(snapshot.stage, snapshot.time)
        self._rates.add(clock.monotonic(), snapshot.step, snapshot.totals.get("particle_count", 0.0))
        self._display.show(snapshot, self._stage_plan.end, self._rates)

    def state_dict(self) -> dict[str, Any]:
        """Return the time of the last update, the stage and its start [s]; updates affect the steps."""
        return super().state_dict() | {"stage": self._stage_plan.stage, "began": self._stage_plan.began}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue after the saved time; changed durations of stages change the end."""
        super().load_state_dict(saved)
        self._stage_plan.enter(saved["stage"], saved["began"])

    def finish(self) -> None:
        """Close the display and restore the terminal."""
        self._display.close()


class StagePlan:
    """Latest end of a run [s], from the actual start times of its stages.

    `stages`: (name, maximum duration [s]) in order; at least one. `began` [s]: start of the present stage.
    """

    def __init__(self, stages: Sequence[tuple[str, float]]) -> None:
        self._stages = list(stages)
        self.stage = self._stages[0][0]
        self.began = 0.0

    @property
    def end(self) -> float:
        """Latest end [s]: the start of the present stage, and the durations from it on."""
        names = [name for name, _ in self._stages]
        return self.began + sum(duration for _, duration in self._stages[names.index(self.stage) :])

    def enter(self, stage: str, time: float) -> None:
        """Record the stage at `time` [s]; the first record of a stage is its start."""
        if stage != self.stage and stage in [name for name, _ in self._stages]:
            self.stage, self.began = stage, time


RATE_SAMPLES = 25
"""Number of updates over which rates are averaged: large enough for a steady value, small enough to follow
insertion."""


class StepRates:
    """Steps and particle-steps per second of wall clock over the latest updates."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, int, float]] = deque(maxlen=RATE_SAMPLES)

    def add(self, seconds: float, step: int, particle_count: float) -> None:
        """Record an update: wall clock `seconds` [s], steps since the start, particles present."""
        self._samples.append((seconds, step, particle_count))

    def steps_per_second(self) -> float:
        """Return the steps per second, 0 while unknown."""
        if len(self._samples) < 2:
            return 0.0
        first_seconds, first_step, _ = self._samples[0]
        last_seconds, last_step, _ = self._samples[-1]
        elapsed = last_seconds - first_seconds
        return (last_step - first_step) / elapsed if elapsed > 0 else 0.0

    def particle_steps_per_second(self) -> float:
        """Return the particle-steps per second for the current number of particles, 0 while unknown."""
        return self.steps_per_second() * self._samples[-1][2] if self._samples else 0.0


class _Bar:
    """A live bar."""

    def __init__(self, stream: TextIO) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (
            TextColumn("{task.fields[stage]}"),
            BarColumn(),
            TextColumn("{task.fields[reached]}"),
            TextColumn("{task.fields[rates]}"),
            TimeRemainingColumn(),
        )
        self._progress = Progress(*columns, console=Console(file=stream))
        self._task: TaskID | None = None

    def show(self, snapshot: Snapshot, end: float, rates: StepRates) -> None:
        if self._task is None:
            self._progress.start()
            self._task = self._progress.add_task("run", total=end, stage=snapshot.stage, rates="", reached="")
        self._progress.update(
            self._task,
            completed=snapshot.time,
            total=end,
            stage=snapshot.stage,
            reached=_time_text(snapshot.time, end),
            rates=_rates_text(rates),
        )

    def close(self) -> None:
        self._progress.stop()


SECONDS_BETWEEN_LINES = 10.0
"""Wall clock [s] between two lines."""


class _Lines:
    """Lines at intervals."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._stage = ""
        self._printed_at = -SECONDS_BETWEEN_LINES
        self._pending: str | None = None

    def show(self, snapshot: Snapshot, end: float, rates: StepRates) -> None:
        reached = _time_text(snapshot.time, end)
        self._pending = f"{snapshot.stage}: {reached}, step {snapshot.step}, {_rates_text(rates)}"
        now = clock.monotonic()
        if snapshot.stage != self._stage or now - self._printed_at >= SECONDS_BETWEEN_LINES:
            self._stage = snapshot.stage
            self._printed_at = now
            self._print()

    def close(self) -> None:
        self._print()

    def _print(self) -> None:
        if self._pending is not None:
            self._stream.write(self._pending + "\n")
            self._stream.flush()
            self._pending = None


def _time_text(time: float, end: float) -> str:
    """Return the time with a fixed number of decimals that resolves a thousandth of the end."""
    decimals = max(0, 3 - math.floor(math.log10(end)))
    return f"{time:.{decimals}f} of {end:.4g} s"


def _rates_text(rates: StepRates) -> str:
    """Return the step rates as text; millions of particle-steps per second with two decimals."""
    steps = rates.steps_per_second()
    particle_steps = rates.particle_steps_per_second()
    return f"{steps:.0f} steps/s, {particle_steps / 1e6:.2f} M particle-steps/s"
