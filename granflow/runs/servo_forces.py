"""Warnings of servo walls that are off their target force when a stage ends."""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any

import numpy as np

from granflow.engine.engine import Engine
from granflow.engine.wall_dynamics import controlled_forces
from granflow.geometry.catalog import area_of
from granflow.geometry.motion import is_running
from granflow.plan.wall_control import ControlledMotion

SAMPLES_PER_STAGE = 100
"""Number of force samples over the maximum duration of a stage."""

KEPT = 20
"""Number of last samples in the mean: the last fifth of a stage without an earlier end."""

STANDARD_ERRORS = 3.0
"""Scatter of a mean that is tolerated, in its standard errors: 0.3 % of normally distributed means exceed it."""

FORCE_TOLERANCE = 0.05
"""Deviation over the target tolerated without scatter: Hertz overlaps are then 1 - 0.95^(2/3) = 3.4 % too small."""


@dataclass
class ServoForces:
    """Forces of the controlled motions in the current stage, for the check of the servos at its end.

    next_sample:  time [s] of the next sample; infinite without servos
    samples:      the last KEPT samples, each with the force [N] of every controlled motion on the particles
    """

    next_sample: float = inf
    samples: list[list[float]] = field(default_factory=list)

    def begin(self, engine: Engine, longest: float) -> None:
        """Begin a stage that lasts up to `longest` [s]."""
        has_servo = any(motion.kind == "servo" for motion in engine.plan.controlled_motions)
        self.samples, self.next_sample = [], engine.time + longest / SAMPLES_PER_STAGE if has_servo else inf

    def sample_if_due(self, engine: Engine, longest: float) -> None:
        """Add a sample if its time is reached."""
        if engine.reached(self.next_sample):
            self.next_sample += longest / SAMPLES_PER_STAGE
            self.samples = [*self.samples, controlled_forces(engine.state).tolist()][-KEPT:]

    def warn_at_end(self, engine: Engine, stage: str) -> None:
        """Log a warning for each servo that is active and off its target at the end of the stage."""
        if self.next_sample < inf:
            for sentence in off_target(engine, stage, self.samples):
                logging.getLogger("granflow").warning("%s", sentence)

    def state_dict(self) -> dict[str, Any]:
        """Return the state for a checkpoint."""
        return {"next_sample": self.next_sample, "samples": self.samples}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state of `state_dict`."""
        self.next_sample, self.samples = saved["next_sample"], [list(sample) for sample in saved["samples"]]


def off_target(engine: Engine, stage: str, samples: Sequence[Sequence[float]]) -> Iterator[str]:
    """A sentence for each servo that is active in the last step and off its target force F.

        |f - F| > tolerance  and  |<f> - F| > tolerance,     tolerance = max(0.05 |F|, 3 s / sqrt(n))

    f: force at the end, <f> and s: mean and standard deviation of the last n samples. The second condition ignores
    servos whose force fluctuates about the target, the first one those that reached it late in the stage.
    """
    present = engine.state.walls.present
    forces, middle = controlled_forces(engine.state), np.array([engine.time - 0.5 * engine.time_step])
    for index, motion in enumerate(engine.plan.controlled_motions):
        running = is_running(engine.state.wall_motions[motion.wall][motion.motion], middle)[0]
        if motion.kind != "servo" or not (running and present[motion.wall]):
            continue
        series = np.array([sample[index] for sample in samples] or [forces[index]])
        scatter = float(series.std(ddof=1)) / np.sqrt(len(series)) if len(series) > 1 else 0.0
        tolerance = max(FORCE_TOLERANCE * abs(motion.force), STANDARD_ERRORS * scatter)
        if min(abs(forces[index] - motion.force), abs(series.mean() - motion.force)) > tolerance:
            area = area_of(engine.plan.walls[motion.wall].shape)
            yield _sentence(motion, stage, engine.time, float(forces[index]), not series.any(), area)


def _sentence(
    motion: ControlledMotion, stage: str, time: float, force: float, is_untouched: bool, area: float | None
) -> str:
    """The warning; `force` [N]: at the end; `is_untouched`: no force in all samples; `area` [m2]: of the wall."""
    reached, target = f"{force:.3g} N", f"{motion.force:.3g} N"
    if area:
        reached, target = (
            f"{text} ({value / area:.3g} Pa)" for text, value in ((reached, force), (target, motion.force))
        )
    is_away = is_untouched and force == 0.0
    state = "does not touch the particles" if is_away else "is off its target"
    velocity, limit = motion.approach(motion.force - force)
    remedy = "more time or a larger velocity_max"
    if limit != "velocity_max":
        remedy = "more time, a larger gain or a higher target force" if is_away else "more time or a larger gain"
    return (
        f"walls.{motion.name}.motion ({motion.source}): at the end of stage {stage} ({time:.6g} s), the servo {state}: "
        f"{reached} instead of {target}. It moves at {velocity:.3g} m/s, {limit}. Give it {remedy}"
        + (", start it closer to the bed, or approach by a translation." if is_away else ".")
    )
