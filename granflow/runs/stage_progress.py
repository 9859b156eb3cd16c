"""Progress of a run through its stages."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any

from granflow.engine.engine import Engine
from granflow.plan.plan import Plan
from granflow.plan.scene_parts import PlannedStage
from granflow.plan.walls import wall_change_times, wall_motions
from granflow.runs.servo_forces import ServoForces
from granflow.runs.stage_conditions import StageConditions


@dataclass
class StageProgress:
    """Started and completed stages, and pending events of the current stage.

    stage:        name of the current stage
    changes:      future times [s] at which walls appear or vanish
    stage_times:  start and end [s] of the stages that have begun; the end is infinite during a stage
    next_check:   time [s] of the next check for rest; infinite without checks
    target:       time [s] to which the current steps lead, None between targets
    arrived:      whether insertion and wall changes at the target are done, so that only observers are pending
    servos:       force samples of the servos, checked at the end of the stage
    conditions:   conditions that end the stage
    """

    stage: str
    changes: tuple[float, ...]
    stage_times: dict[str, tuple[float, float]] = field(default_factory=dict)
    next_check: float = inf
    target: float | None = None
    arrived: bool = False
    servos: ServoForces = field(default_factory=ServoForces)
    conditions: StageConditions = field(default_factory=StageConditions)

    @classmethod
    def of(cls, plan: Plan) -> "StageProgress":
        """Return the progress before the first step."""
        return cls(plan.stages[0].name, wall_change_times(plan.walls))

    def begin(self, stage: str, time: float, check_interval: float) -> None:
        """Begin a stage at `time` [s], with a first check for rest after `check_interval` [s]."""
        self.stage, self.next_check = stage, time + check_interval
        self.stage_times[stage] = (time, inf)

    def end(self, time: float) -> None:
        """End the current stage at `time` [s]."""
        self.stage_times[self.stage] = (self.stage_times[self.stage][0], time)

    def has_ended(self, stage: str) -> bool:
        """Return whether the stage has ended."""
        return self.stage_times.get(stage, (0.0, inf))[1] < inf

    def set_target(self, time: float) -> None:
        """Set the target time [s] of the next steps."""
        self.target, self.arrived = time, False

    def remove_past_changes(self, engine: Engine) -> bool:
        """Remove wall changes that are due; return whether any were removed."""
        remaining = tuple(change for change in self.changes if not engine.reached(change))
        changed = len(remaining) < len(self.changes)
        self.changes = remaining
        return changed

    def set_walls(self, engine: Engine) -> None:
        """Copy presence and motions of the walls to the device.

        Presence is that of the middle of the next step, so that a change due at the present time is included.
        """
        walls, middle = engine.plan.walls, engine.time + 0.5 * engine.time_step
        presence = [wall.is_present(self.stage, middle) for wall in walls]
        engine.set_walls(presence, wall_motions([wall.motions for wall in walls], self.stage_times))

    def state_dict(self) -> dict[str, Any]:
        """Return the state for a checkpoint."""
        return {
            "stage": self.stage,
            "stage_times": {name: list(times) for name, times in self.stage_times.items()},
            "next_check": self.next_check,
            "target": self.target,
            "arrived": self.arrived,
            "changes": list(self.changes),
            "servos": self.servos.state_dict(),
            "conditions": self.conditions.state_dict(),
        }

    def load_state_dict(
        self, saved: dict[str, Any], stages: Sequence[PlannedStage], reopened: bool, same_course: bool
    ) -> None:
        """Restore the state.

        stages:      of the plan
        reopened:    the last stage continues even if it had ended
        same_course: False if events or conditions changed; the target is then determined again
        """
        self.stage, self.next_check, self.changes = saved["stage"], saved["next_check"], tuple(saved["changes"])
        self.servos.load_state_dict(saved["servos"])
        present = next(stage for stage in stages if stage.name == self.stage)
        self.conditions.load_state_dict(saved["conditions"], present, same_course)
        self.stage_times = {name: (start, end) for name, (start, end) in saved["stage_times"].items()}
        if reopened:
            self.stage_times[self.stage] = (self.stage_times[self.stage][0], inf)
        if same_course:
            self.target, self.arrived = saved["target"], saved["arrived"]
