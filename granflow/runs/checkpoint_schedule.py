"""Schedule of the checkpoints of a run."""

import time as clock
from collections.abc import Callable
from math import inf
from pathlib import Path
from typing import Any

from granflow.io.checkpoint import engine_digest, remove_old_checkpoints, write_checkpoint
from granflow.io.rank_files import RankFileWriter
from granflow.observers.schedule import Schedule
from granflow.scene.schema.output import Checkpoints

SavedBy = Callable[[RankFileWriter], dict[str, Any]]
"""Returns the state for a checkpoint, after the writer has written the files of the other MPI ranks."""


class CheckpointWriter:
    """Schedules and writes the checkpoints of one run, and keeps the newest few.

    `scene_text`: YAML of the resolved scene, part of each checkpoint. `settings`: `interval` [s] of simulated time, or
    None; `wall_clock` [s]; `keep`: number of files. The wall clock is monotonic: a change of the system time has no
    effect. `last_time` [s]: of the last checkpoint, None before it.
    """

    def __init__(self, directory: Path, settings: Checkpoints, scene_text: str) -> None:
        self.directory, self._settings, self._scene_text = directory, settings, scene_text
        self._schedule = Schedule(settings.interval) if settings.interval else None
        self._written_at = clock.monotonic()
        engine_digest()  # of the sources at the start of the run
        self.last_time: float | None = None

    def start(self, time: float) -> None:
        """Start the schedule at `time` [s]."""
        self._written_at = clock.monotonic()
        if self._schedule is not None:
            self._schedule.mark_done(time)

    def next_time(self) -> float:
        """Return the simulated time of the next scheduled checkpoint [s], regardless of the wall clock."""
        return inf if self._schedule is None else self._schedule.next_time()

    def due(self, time: float) -> bool:
        """Return whether a checkpoint is due, by the simulated `time` [s] or by the wall clock."""
        return time >= self.next_time() or clock.monotonic() - self._written_at >= self._settings.wall_clock

    def write(self, time: float, step: int, state: SavedBy) -> None:
        """Write a checkpoint and remove old ones; after an error the next one is due as after a success.

        `time` [s], `step`: of the state, as in `write_checkpoint`. Raises OSError if a file cannot be written.
        """
        self.start(time)
        writer = RankFileWriter.of(self.directory, step)
        write_checkpoint(self.directory, self._scene_text, time, step, state(writer))
        writer.remove_replaced()
        remove_old_checkpoints(self.directory, self._settings.keep)
        self.last_time = time
