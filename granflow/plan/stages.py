"""Times of the stages of a run, as far as they are known before it, and the check of its drag.

A stage ends after its longest duration, or earlier when a condition is met, so that its times are known
only during the run. Checks before a run use the times of `nominal_times`, or those of `always`, during
which every motion is possible.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import inf, sqrt

import numpy as np

from granflow.errors import SceneError
from granflow.load import Scene
from granflow.scene.blocks.run import Stage

StageTimes = Mapping[str, tuple[float, float]]
"""Start and end [s] of each stage that has begun; the end is infinite during the stage."""


def always(schedule: Sequence[Stage]) -> StageTimes:
    """Times of stages that never end: all motions of the scene are possible at any time."""
    return {stage.name: (0.0, inf) for stage in schedule}


def nominal_times(schedule: Sequence[Stage]) -> StageTimes:
    """Start and end [s] of each stage if all stages take their longest duration."""
    edges = np.concatenate([[0.0], np.cumsum([stage.longest for stage in schedule])]).tolist()
    return {stage.name: span for stage, span in zip(schedule, pairwise(edges), strict=True)}


GOLDEN = 0.5 * (sqrt(5.0) - 1.0)


def spread_times(count: int, end: float) -> np.ndarray:
    """Times (count,) [s] up to `end`, in ascending order, at which rotating walls are examined.

    They are multiples of the golden ratio modulo 1, so that no period of a rotation is missed.
    """
    return np.sort(np.modf(GOLDEN * np.arange(1, count + 1))[0]) * end


RESOLVED_DECAY = 0.2
"""Largest product of drag rate and time step g dt: the decay rate of the scheme is wrong by (g dt)^2 / 12 =
0.3 %."""


def refuse_unresolved_drag(scene: Scene, time_step: float) -> None:
    """Raise SceneError if a time step [s] does not resolve the decay of the velocities."""
    drag = scene.damping.drag if scene.damping else None
    if drag is not None and drag * time_step > RESOLVED_DECAY:
        raise SceneError(
            f"{scene.locate('damping', 'drag')}: damping.drag is {drag:g} 1/s, but the time step of "
            f"{time_step:.3g} s does not resolve the decay; give at most {RESOLVED_DECAY / time_step:.2g} "
            "1/s, or a smaller time step."
        )
