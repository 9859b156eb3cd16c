"""Damping of all motion for settling: its numbers by stage, and the limit of the drag."""

from dataclasses import dataclass

from granflow.errors import SceneError
from granflow.load import Scene
from granflow.scene.schema.damping import Damping

RESOLVED_DECAY = 0.2
"""Largest product of drag rate and time step g dt: the decay rate of the scheme is wrong by (g dt)^2 / 12 = 0.3 %."""


@dataclass(frozen=True)
class PlannedDamping:
    """Damping of all particles: Cundall ratio, drag rate [1/s], and the stages in which it acts (None: all)."""

    cundall: float
    drag: float
    stages: tuple[str, ...] | None

    def values(self, stage: str) -> tuple[float, float]:
        """Cundall ratio and drag rate [1/s] in a stage."""
        acts = self.stages is None or stage in self.stages
        return (self.cundall, self.drag) if acts else (0.0, 0.0)


def planned_damping(damping: Damping | None) -> PlannedDamping | None:
    """The damping of the scene; None without."""
    damping = damping
    return None if damping is None else PlannedDamping(damping.cundall or 0.0, damping.drag or 0.0, damping.stages)


def refuse_unresolved_drag(scene: Scene, time_step: float) -> None:
    """Raise SceneError if a time step [s] does not resolve the decay of the velocities."""
    drag = (scene.damping.drag if scene.damping is not None else None) or 0.0
    if drag * time_step > RESOLVED_DECAY:
        raise SceneError(
            f"{scene.locate('damping', 'drag')}: damping.drag is {drag:g} 1/s, but the time step of {time_step:.3g} s "
            f"does not resolve the decay; give at most {RESOLVED_DECAY / time_step:.2g} 1/s, or a smaller time step."
        )
