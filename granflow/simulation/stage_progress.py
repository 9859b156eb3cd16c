"""Where a run stands in its stages."""

from dataclasses import dataclass, field
from math import inf
from typing import Any

from granflow.device.engine import Engine
from granflow.plan.walls import StageTimes, wall_change_times, wall_motions, wall_presence
from granflow.scene import Scene

REST_CHECKS = 200
"""How often a stage that waits for rest looks at the kinetic energy, over its longest duration."""


@dataclass
class StageProgress:
    """Stages begun and ended, and what is due in the present one.

    stage: name of the present one.  stage_times: start and end [s] of those that have begun, the end infinite while
    one runs.  look [s]: when to look for rest next.  changes [s]: times still to come at which walls appear or vanish.
    target [s]: what the present steps lead to, None between two; arrived: whether only observers are still to be
    shown what stands there.
    """

    stage: str
    changes: tuple[float, ...]
    stage_times: dict[str, tuple[float, float]] = field(default_factory=dict)
    next_check: float = inf
    target: float | None = None
    arrived: bool = False

    @classmethod
    def of(cls, scene: Scene) -> "StageProgress":
        """Before the first step."""
        return cls(scene.schedule[0].name, wall_change_times(scene))

    def begin(self, stage: str, time: float, check_interval: float) -> None:
        """A stage begins."""
        self.stage, self.next_check = stage, time + check_interval
        self.stage_times[stage] = (time, inf)

    def end(self, time: float) -> None:
        """The present stage ends."""
        self.stage_times[self.stage] = (self.stage_times[self.stage][0], time)

    def has_ended(self, stage: str) -> bool:
        """Whether that stage is over."""
        return self.stage_times.get(stage, (0.0, inf))[1] < inf

    def set_target(self, time: float) -> None:
        """Begin steps that lead to a time [s]."""
        self.target, self.arrived = time, False

    def remove_past_changes(self, engine: Engine) -> bool:
        """Forget changes of walls whose time has come; returns whether there was one."""
        remaining = tuple(change for change in self.changes if not engine.reached(change))
        changed = len(remaining) < len(self.changes)
        self.changes = remaining
        return changed

    def set_walls(self, scene: Scene, engine: Engine) -> None:
        """Tell the device which walls are there now and how they move."""
        times: StageTimes = self.stage_times
        presence = wall_presence(scene, self.stage, engine.time + 0.5 * engine.time_step)
        engine.set_walls(presence, wall_motions(scene, times))

    def state_dict(self) -> dict[str, Any]:
        """All of it, for a checkpoint."""
        return {
            "stage": self.stage,
            "stage_times": {name: list(times) for name, times in self.stage_times.items()},
            "next_check": self.next_check,
            "target": self.target,
            "arrived": self.arrived,
            "changes": list(self.changes),
        }

    def load_state_dict(self, saved: dict[str, Any], reopened: bool, same_scene: bool) -> None:
        """Go on from what was kept; `reopened`: the last stage goes on even where it had ended.

        Where the scene changed, what was under way is settled anew.
        """
        self.stage, self.next_check, self.changes = saved["stage"], saved["next_check"], tuple(saved["changes"])
        self.stage_times = {name: (start, end) for name, (start, end) in saved["stage_times"].items()}
        if reopened:
            self.stage_times[self.stage] = (self.stage_times[self.stage][0], inf)
        if same_scene:
            self.target, self.arrived = saved["target"], saved["arrived"]
