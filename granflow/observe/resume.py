"""Whether a run may go on from a checkpoint with the scene at hand, and when its own checkpoints are due."""

import hashlib
import time as clock
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from granflow.errors import GranflowError
from granflow.observe.checkpoint import Checkpoint, remove_old_checkpoints, write_checkpoint
from granflow.observe.checkpoint_validation import check_engine, check_run
from granflow.observe.schedule import Schedule
from granflow.plan import Plan
from granflow.plan.walls import StageTimes, wall_motions
from granflow.scene import Scene
from granflow.scene.differences import Difference, differences, forbidden
from granflow.scene.reader import scene_of
from granflow.scene.schema import Checkpoints
from granflow.walls.motion import Motion, pose

PLAN_NUMBERS = ("time_step", "skin", "velocity_max", "chunk_size", "particle_capacity")
"""Numbers of a plan that must be those of the run so far: positions and what contacts remember rest on them."""

FEATURE_SWITCHES = (
    *("friction", "rolling", "rotation", "rate_dependent", "cohesion", "one_material", "energy_budget", "wall_forces"),
    "fixed_particles",
)
"""Features on which it depends which arrays there are."""

MAX_JUMP = 1e-3
"""Share of the smallest radius by which a wall may stand elsewhere once its motion has been changed."""


def plan_fingerprint(plan: Plan) -> dict[str, Any]:
    """The numbers and features of a plan that go into checkpoints."""
    numbers = {name: getattr(plan, name) for name in PLAN_NUMBERS} | {"mesh_digest": mesh_digest(plan)}
    return numbers | {name: getattr(plan.features, name) for name in FEATURE_SWITCHES}


def mesh_digest(plan: Plan) -> str:
    """Digest of what numbers the triangles of mesh walls and says where they are; empty without any."""
    digest = hashlib.sha256(str(len(plan.walls)).encode())
    for index, mesh in plan.meshes.items():
        digest.update(f"{index} {mesh.corners.shape}".encode() + mesh.corners.tobytes() + mesh.points.tobytes())
    return digest.hexdigest() if plan.meshes else ""


@dataclass(frozen=True)
class Change:
    """What is different in the scene with which a run goes on."""

    differences: tuple[Difference, ...]

    @property
    def affects_contacts(self) -> bool:
        """Whether forces must be worked out anew before the next step: walls or pairs are others."""
        return any(each.key.startswith(("walls.", "pairs.")) for each in self.differences)

    def moves_stage_end(self, index: int) -> bool:
        """Whether the end of that stage has been moved."""
        return any(each.key.startswith((f"stages.{index}.", "run.duration")) for each in self.differences)


def accepted_change(checkpoint: Checkpoint, plan: Plan, allow_changes: bool) -> Change:
    """How the plan's scene differs from the checkpoint's.

    Raises GranflowError, naming all that is not allowed to differ, unless `allow_changes`; and always where the plan's
    numbers are others, or a wall would jump.
    """
    saved = checkpoint.saved
    before, now = (scene_of(text, str(checkpoint.path)) for text in (checkpoint.scene, plan.scene.text()))
    check_run(checkpoint, before, plan_fingerprint(plan))
    stages_over = [stage.name for stage in before.schedule].index(saved["stage_progress"]["stage"])
    refused = forbidden(before, now, stages_over)
    if refused and not allow_changes:
        named = "\n".join(f"{checkpoint.path}: {each}, which cannot change while a run goes on." for each in refused)
        raise GranflowError(f"{named}\nRun the scene anew, or go on all the same with --allow-changes.")
    _refuse_other_numbers(checkpoint, plan)
    _refuse_jumps(before, plan, saved["stage_progress"]["stage_times"], checkpoint.time)
    check_engine(checkpoint, plan, before)
    return Change(differences(before, now))


def _refuse_other_numbers(checkpoint: Checkpoint, plan: Plan) -> None:
    for name, before in checkpoint.saved["plan"].items():
        now = plan_fingerprint(plan)[name]
        if now != before and name == "mesh_digest":
            raise GranflowError(
                f"{checkpoint.path}: the triangles of the mesh walls are others than those of the run so far, but they "
                "must stay the same while a run goes on; put the mesh files back as they were."
            )
        if now != before:
            remedy = "; give it with --set" if name in ("time_step", "velocity_max", "skin", "chunk_size") else ""
            raise GranflowError(
                f"{checkpoint.path}: {name} was {before!r} and would be {now!r} with this scene, but it must stay the "
                f"same while a run goes on{remedy}."
            )


def _refuse_jumps(before: Scene, plan: Plan, stage_times: StageTimes, time: float) -> None:
    """A wall whose motion has changed must be where it was."""
    corners = np.array(list(product(*zip(plan.domain_low, plan.domain_high, strict=True))))
    motions = [wall_motions(scene, stage_times) for scene in (before, plan.scene)]
    for wall, first, second in zip(plan.walls, *motions, strict=False):
        moved = np.linalg.norm(_positions(first, time, corners) - _positions(second, time, corners), axis=1).max()
        if moved > MAX_JUMP * plan.radius_min:
            raise GranflowError(
                f"walls.{wall.name}.motion would move the wall by {moved:.3g} m at once at {time:.6g} s. Let the "
                "motion so far end then (end:), and add another that starts then (start:)."
            )


def _positions(motions: Sequence[Motion], time: float, points: np.ndarray) -> np.ndarray:
    pose_at_time = pose(motions, np.array([time]))
    return (points - pose_at_time.pivot) @ pose_at_time.rotation[0].T + pose_at_time.pivot + pose_at_time.offset[0]


class CheckpointWriter:
    """Writes checkpoints of one run into its directory, says when the next is due, and keeps the last few.

    Wall clock is read from a clock that nobody sets: a jump of the computer's time changes nothing.
    """

    def __init__(self, directory: Path, settings: Checkpoints) -> None:
        self._directory, self._settings = directory, settings
        self._schedule = Schedule(settings.interval) if settings.interval else None
        self._written_at = clock.monotonic()
        self.last_time: float | None = None

    def start(self, time: float) -> None:
        """Begin to count at `time` [s]."""
        self._written_at = clock.monotonic()
        if self._schedule is not None:
            self._schedule.mark_done(time)

    def next_time(self) -> float:
        """Simulated time [s] at which the next one is due, whatever the wall clock says."""
        return inf if self._schedule is None else self._schedule.next_time()

    def due(self, time: float) -> bool:
        """Whether it is time for the next one, by the simulated `time` [s] or by the wall clock."""
        return time >= self.next_time() or clock.monotonic() - self._written_at >= self._settings.wall_clock

    def write(self, scene: Scene, time: float, step: int, saved: dict[str, Any]) -> None:
        """Write one and remove those that are too many; if that fails, the next is due as if it had not."""
        self.start(time)
        write_checkpoint(self._directory, scene.text(), time, step, saved)
        remove_old_checkpoints(self._directory, self._settings.keep)
        self.last_time = time
