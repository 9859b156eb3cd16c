"""Times of the stages if each lasts as long as it can, and presence of walls."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from granflow.plan.scene_parts import PlannedStage
from granflow.plan.walls import PlannedWall, StageTimes


def nominal_times(stages: Sequence[PlannedStage]) -> StageTimes:
    """Start and end [s] of each stage if all stages take their longest duration."""
    edges = np.concatenate([[0.0], np.cumsum([stage.longest for stage in stages])]).tolist()
    return {stage.name: span for stage, span in zip(stages, pairwise(edges), strict=True)}


def present_from(wall: PlannedWall, times: StageTimes) -> float:
    """Time [s] at which a wall appears; infinite if it never does."""
    started = [times[name][0] for name in wall.stages or times if name in times]
    return max(wall.appears_at, min(started, default=np.inf))


def is_present(wall: PlannedWall, time: float, times: StageTimes) -> bool:
    """Whether a wall is present at `time` [s]."""
    stage = next((name for name, (start, end) in times.items() if start <= time < end), None)
    return stage is not None and wall.is_present(stage, time)
