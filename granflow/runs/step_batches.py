"""Batches of steps: between batches, signals are handled and checkpoints are written."""

import time as clock

from granflow.engine.engine import Engine

CHUNK_SECONDS = 0.2
"""Wall-clock time of one batch [s]."""


class StepBatches:
    """Takes steps in batches of about CHUNK_SECONDS: their length follows the measured rate, and at most doubles."""

    def __init__(self) -> None:
        self._steps = 1

    def advance(self, engine: Engine, most: int) -> None:
        """Take one batch of at most `most` steps."""
        began, before = clock.perf_counter(), engine.step_count
        engine.advance(min(self._steps, most))
        step_rate = (engine.step_count - before) / max(clock.perf_counter() - began, 1e-9)
        self._steps = max(min(int(step_rate * CHUNK_SECONDS), 2 * self._steps), 1)
