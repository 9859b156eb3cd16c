"""Checks whether a run can continue from a checkpoint with a given scene."""

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from granflow.errors import GranflowError
from granflow.geometry.motion import Motion, pose
from granflow.io.checkpoint import Checkpoint, CheckpointError, engine_digest
from granflow.io.log import version_of
from granflow.load import Scene, copied_scene, scene_of
from granflow.plan.device_arrays import particle_arrays, saved_arrays
from granflow.plan.plan import Plan
from granflow.plan.walls import StageTimes, planned_motions, wall_motions
from granflow.runs.checkpoint_validation import check_engine, check_run
from granflow.scene.differences import Difference, differences, forbidden

PLAN_NUMBERS = ("time_step", "skin", "velocity_max")
"""Numbers of a plan that must not change when a run continues: positions and contact history depend on them."""

FEATURE_SWITCHES = (
    *(
        "friction",
        "rolling",
        "twisting",
        "rotation",
        "rate_dependent",
        "cohesion",
        "one_material",
        "energy_budget",
        "wall_forces",
        "damping",
    ),
    "fixed_particles",
)
"""Features that determine which arrays exist."""

MAX_JUMP = 1e-3
"""Largest displacement of a wall by a change of its motion, over the smallest radius."""


def plan_fingerprint(plan: Plan) -> dict[str, Any]:
    """Return the numbers and features of a plan that checkpoints contain, by name.

    PLAN_NUMBERS in SI units, FEATURE_SWITCHES, and `mesh_digest`. A run continues only if all are equal.
    """
    numbers = {name: getattr(plan, name) for name in PLAN_NUMBERS} | {"mesh_digest": mesh_digest(plan)}
    return numbers | {name: getattr(plan.features, name) for name in FEATURE_SWITCHES}


def mesh_digest(plan: Plan) -> str:
    """Return the SHA-256 of the triangles of all mesh walls, their order included; empty without mesh walls.

    The digest covers points and corners at rest, after scaling, rotation and translation.
    """
    digest = hashlib.sha256(str(len(plan.walls)).encode())
    for index, mesh in plan.meshes.items():
        digest.update(f"{index} {mesh.corners.shape}".encode() + mesh.corners.tobytes() + mesh.points.tobytes())
    return digest.hexdigest() if plan.meshes else ""


@dataclass(frozen=True)
class Change:
    """Differences between the scene of a checkpoint and the scene that continues the run."""

    differences: tuple[Difference, ...]

    @property
    def affects_contacts(self) -> bool:
        """Whether walls or pairs differ, so that forces must be recomputed before the next step."""
        return any(each.key.startswith(("walls.", "pairs.")) for each in self.differences)

    @property
    def keeps_course(self) -> bool:
        """Whether all events and conditions are those of the run so far: only limits and texts differ."""
        return all(
            re.match(r"(title|description|expect|numerics|output\.checkpoint)\b", each.key) for each in self.differences
        )

    def moves_stage_end(self, index: int) -> bool:
        """Return whether the end of the stage with this index has changed."""
        return any(each.key.startswith((f"stages.{index}.", "run.duration")) for each in self.differences)


def accepted_change(checkpoint: Checkpoint, scene: Scene, plan: Plan, allow_changes: bool) -> Change:
    """Check the checkpoint and return the differences between its scene and the present one, whose plan is `plan`.

    `allow_changes`: accept differences in keys that must normally not change when a run continues.

    Raises GranflowError with all differences that are not permitted, unless `allow_changes`; and always if the numbers
    of the plan differ, if a wall would jump by more than MAX_JUMP of the smallest radius, or if the present stage would
    have ended before. Raises CheckpointError if the state does not match its scene or the plan.
    """
    saved, other_engine = checkpoint.saved, engine_difference(checkpoint)
    if other_engine and not allow_changes:
        raise GranflowError(
            f"{other_engine} Resume with that version, or continue despite the difference with --allow-changes."
        )
    # Both scenes are read from text, so that only differences of the text count.
    before, now = (scene_of(text, str(checkpoint.path)) for text in (checkpoint.scene, copied_scene(scene).to_yaml()))
    try:
        check_run(checkpoint, before, plan_fingerprint(plan))
    except CheckpointError as error:
        raise _without_damage(error, other_engine) from None
    stages_over = [stage.name for stage in before.schedule].index(saved["stage_progress"]["stage"])
    refused = forbidden(before, now, stages_over)
    if refused and not allow_changes:
        named = " ".join(f"{checkpoint.path}: {each}, which cannot change when a run continues." for each in refused)
        raise GranflowError(
            f"{named} Run the scene from the start, or continue despite the change with --allow-changes."
        )
    _refuse_other_numbers(checkpoint, plan)
    _refuse_jumps(before, plan, saved, checkpoint.time)
    if before.run.precision != now.run.precision:
        _change_remainders(saved["engine"]["particles"], plan)
    try:
        check_engine(checkpoint, plan, before)
    except CheckpointError as error:
        raise _without_damage(error, other_engine) from None
    change = Change(differences(before, now))
    _refuse_past_end(checkpoint, now, change)
    return change


def engine_difference(checkpoint: Checkpoint) -> str:
    """Sentences on an engine other than that of the run so far; empty for the same sources."""
    if checkpoint.engine == engine_digest():
        return ""
    return (
        f"{checkpoint.path} was written by granflow {checkpoint.version} with the engine {checkpoint.engine:.12}, and "
        f"this is granflow {version_of('granflow')} with the engine {engine_digest()}: their results can differ."
    )


def _without_damage(error: CheckpointError, other_engine: str) -> CheckpointError:
    """The error of a check, or the difference of the engines if that is its likely cause."""
    if not other_engine:
        return error
    return CheckpointError(f"{other_engine} Its state does not fit this version: resume with that version.")


def _change_remainders(particles: dict[str, Any], plan: Plan) -> None:
    """Add remainders of velocities, which are zero, or remove them, as the precision of the plan needs."""
    wanted = saved_arrays(particle_arrays(plan))
    for name in ("velocity", "angular_velocity"):
        remainder = f"{name}_remainder"
        if remainder not in wanted:
            particles.pop(remainder, None)
        elif name in particles:
            particles[remainder] = np.zeros_like(particles[name])


def _refuse_past_end(checkpoint: Checkpoint, scene: Scene, change: Change) -> None:
    """Raise GranflowError if `scene` changes the duration of the present stage to one that it has already exceeded."""
    stage_times = checkpoint.saved["stage_progress"]["stage_times"]
    index, (name, (began, _)) = len(stage_times) - 1, list(stage_times.items())[-1]
    keys = ("run.duration", f"stages.{index}.duration", f"stages.{index}.max_duration")
    lasted, step = checkpoint.time - began, checkpoint.saved["engine"]["clock"]["time_step"]
    for each in change.differences:
        if each.key in keys and each.now is not None and each.now < lasted - step:
            raise GranflowError(
                f"{each.key} is {each.now:.6g} s, but at {checkpoint.path} stage {name} has already lasted "
                f"{lasted:.6g} s: give at least this duration."
            )


def _refuse_other_numbers(checkpoint: Checkpoint, plan: Plan) -> None:
    """Raise GranflowError for the first number or feature of the plan that differs from that of the checkpoint."""
    for name, before in checkpoint.saved["plan"].items():
        now = plan_fingerprint(plan)[name]
        if now != before and name == "mesh_digest":
            raise GranflowError(
                f"{checkpoint.path}: the triangles of the mesh walls differ from those of the run, but must not change "
                "when a run continues; restore the mesh files."
            )
        if now != before:
            remedy = "; give the old value with --set" if name in PLAN_NUMBERS else ""
            raise GranflowError(
                f"{checkpoint.path}: {name} was {before!r} and would be {now!r} with this scene, but must not change "
                f"when a run continues{remedy}."
            )


def _refuse_jumps(before: Scene, plan: Plan, saved: Mapping[str, Any], time: float) -> None:
    """Raise GranflowError if a motion that the scene changes displaces a wall at `time` [s].

    `before`: scene of the checkpoint; `saved`: its state, with the start and end [s] of the stages, and the walls that
    follow Python instead of the scene. The displacement is that of the corners of the domain.
    """
    stage_times: StageTimes = saved["stage_progress"]["stage_times"]
    corners = np.array(list(product(*zip(plan.domain_low, plan.domain_high, strict=True))))
    motions_before = [planned_motions(wall.motion, before.gravity) for wall in before.walls.values()]
    motions = [wall_motions(each, stage_times) for each in (motions_before, [wall.motions for wall in plan.walls])]
    for wall, first, second in zip(plan.walls, *motions, strict=False):
        moved = np.linalg.norm(_positions(first, time, corners) - _positions(second, time, corners), axis=1).max()
        if wall.name not in saved["changes"]["walls"] and moved > MAX_JUMP * plan.radius_min:
            raise GranflowError(
                f"walls.{wall.name}.motion would displace the wall by {moved:.3g} m at {time:.6g} s. Terminate "
                "the old motion at this time (end:) and add another motion from this time (start:)."
            )


def _positions(motions: Sequence[Motion], time: float, points: np.ndarray) -> np.ndarray:
    """Return the positions (n, 3) [m] at `time` [s] of points (n, 3) [m] at rest that move with a wall."""
    pose_at_time = pose(motions, np.array([time]))
    return (points - pose_at_time.pivot) @ pose_at_time.rotation[0].T + pose_at_time.pivot + pose_at_time.offset[0]
