"""Checks whether a run can continue from a checkpoint with a given scene.

The scenes are compared key by key, after resolution and in SI units: a value with another unit or a default
written out is no difference. `ALLOWED_CHANGES` lists the keys that may change.
"""

import hashlib
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from granflow.errors import GranflowError
from granflow.io.checkpoint import Checkpoint, CheckpointError, engine_digest
from granflow.io.log import version_of
from granflow.load import Scene, copied_scene, scene_of
from granflow.plan.arrays import particle_arrays, saved_arrays
from granflow.plan.plan import ExternalForce, Plan
from granflow.plan.stages import StageTimes
from granflow.plan.sum_units import SumUnits
from granflow.plan.wall_changes import changed_walls, vanishing, wall_named, with_wall
from granflow.plan.walls import PlannedWall, wall_motions
from granflow.runs.observer_list import ObserverList
from granflow.scene.blocks.motions import MOTIONS, TimedMotion, placement_of, poses_at
from granflow.scene.blocks.scene import SceneInput


class Difference(NamedTuple):
    """A key whose value differs; None if the key is missing.

    `key`: path with dots, such as walls.floor.material. `str()` is the beginning of a sentence.
    """

    key: str
    before: Any
    now: Any

    @property
    def is_allowed(self) -> bool:
        """Whether a run can be resumed with this change."""
        return any(re.fullmatch(pattern, self.key) for pattern in ALLOWED_CHANGES)

    def __str__(self) -> str:
        shown = ["not given" if value is None else shown_value(value) for value in (self.before, self.now)]
        return f"{self.key} was {shown[0]} and is {shown[1]}"


@dataclass(frozen=True)
class Change:
    """Differences between the scene of a checkpoint and the scene that continues the run."""

    differences: tuple[Difference, ...]
    affects_forces: bool
    """Whether pairs differ, or walls at the present time, so that forces must be recomputed before the next
    step. Walls that differ later only leave the next steps bit-identical."""

    @property
    def affects_walls(self) -> bool:
        """Whether walls differ, also at later times only."""
        return any(each.key.startswith("walls.") for each in self.differences)

    @property
    def keeps_course(self) -> bool:
        """Whether all events and conditions are those of the run so far: only limits and texts differ."""
        return all(
            re.match(r"(title|description|expect|numerics|output\.checkpoint)\b", each.key)
            for each in self.differences
        )

    def moves_stage_end(self, index: int) -> bool:
        """Return whether the end of the stage with this index has changed."""
        return any(each.key.startswith((f"stages.{index}.", "run.duration")) for each in self.differences)


SIZE_ROUNDING = 1e-5
"""Relative tolerance of diameters: rounding in single precision."""


def accepted_change(checkpoint: Checkpoint, plan: Plan, allow_changes: bool) -> Change:
    """Check the checkpoint and return the differences of its scene from that of the plan.

    `allow_changes`: accept differences in keys that must normally not change when a run continues.

    Raises GranflowError with all differences that are not permitted, unless `allow_changes`; and always if
    the numbers of the plan differ, if a wall would jump by more than MAX_JUMP of the smallest radius, or if
    the present stage would have ended before. Raises CheckpointError if the state does not match its scene or
    the plan.
    """
    saved = checkpoint.saved
    other_engine = engine_difference(checkpoint)
    if other_engine and not allow_changes:
        raise GranflowError(
            f"{other_engine} Resume with that version, or continue despite the difference with "
            "--allow-changes."
        )
    # Both scenes are read from text, so that only differences of the text count.
    before, now = (
        scene_of(text, str(checkpoint.path))
        for text in (checkpoint.scene, copied_scene(plan.scene).to_yaml())
    )
    stages_over = [stage.name for stage in before.schedule].index(saved["stage_progress"]["stage"])
    refused = forbidden(before, now, stages_over)
    if refused and not allow_changes:
        named = " ".join(
            f"{checkpoint.path}: {each}, which cannot change when a run continues." for each in refused
        )
        raise GranflowError(
            f"{named} Run the scene from the start, or continue despite the change with --allow-changes."
        )
    _refuse_other_names(checkpoint, before, now)
    _refuse_other_particles(checkpoint, before, plan)
    _refuse_other_numbers(checkpoint, plan)
    _refuse_jumps(before, plan, saved, checkpoint.time)
    if before.run.precision != now.run.precision:
        _change_remainders(saved["engine"]["particles"], plan)
    found = differences(before, now)
    change = Change(found, _affects_forces(found, before, plan, saved, checkpoint.time))
    _refuse_past_end(checkpoint, now, change)
    return change


def _numbers_of(plan: Plan) -> dict[str, float]:
    """Numbers of a plan [SI] that must not change when a run continues: positions and contact history depend
    on them."""
    return {"time_step": plan.time_step, "skin": plan.skin, "velocity_max": plan.impact_velocity.value}


FEATURE_SWITCHES = (
    "rotation",
    "rate_dependent",
    "viscous_cohesion",
    "one_material",
    "energy_budget",
    "wall_forces",
    "damping",
    "fixed_particles",
    "attached_particles",
    "wall_groups",
    "deforming_box",
    "changing_gravity",
)
"""Features that determine which arrays exist."""


def plan_fingerprint(plan: Plan) -> dict[str, Any]:
    """Return the numbers and features of a plan that checkpoints contain, by name.

    Those of `_numbers_of`, the contact models, FEATURE_SWITCHES, and `mesh_digest`. A run continues only if
    all are equal.
    """
    laws = {slot: name for slot, name in plan.laws.names.items() if slot not in ("normal", "tangential")}
    switches = {name: getattr(plan.features, name) for name in FEATURE_SWITCHES}
    numbers = _numbers_of(plan) | {"mesh_digest": mesh_digest(plan)}
    return numbers | {"friction": plan.laws.has_tangential} | laws | switches


def mesh_digest(plan: Plan) -> str:
    """Return the SHA-256 of the triangles of all mesh walls, their order included; empty without mesh walls.

    The digest covers points and corners at rest, after scaling, rotation and translation.
    """
    digest = hashlib.sha256(str(len(plan.walls)).encode())
    for index, mesh in plan.meshes.items():
        digest.update(
            f"{index} {mesh.corners.shape}".encode() + mesh.corners.tobytes() + mesh.points.tobytes()
        )
    return digest.hexdigest() if plan.meshes else ""


def engine_difference(checkpoint: Checkpoint) -> str:
    """Sentences on an engine other than that of the run so far; empty for the same sources."""
    if checkpoint.engine == engine_digest():
        return ""
    return (
        f"{checkpoint.path} was written by granflow {checkpoint.version} with the engine "
        f"{checkpoint.engine:.12}, and this is granflow {version_of('granflow')} with the engine "
        f"{engine_digest()}: their results can differ."
    )


def _refuse_other_names(checkpoint: Checkpoint, before: Scene, now: Scene) -> None:
    """Raise GranflowError for other walls, groups, outlets or past stages, to which the state refers."""
    past = len(checkpoint.saved["stage_progress"]["stage_times"])
    for key in ("walls", "particles", "outlets", "materials", "stages"):
        first, second = (
            [stage.name for stage in scene.schedule[:past]] if key == "stages" else list(getattr(scene, key))
            for scene in (before, now)
        )
        if second[: len(first)] != first or (key != "materials" and len(second) > len(first)):
            raise GranflowError(
                f"{checkpoint.path}: the {key} were {', '.join(first) or 'none'} and are "
                f"{', '.join(second) or 'none'}; their names and order must stay when a run continues."
            )


def _refuse_other_particles(checkpoint: Checkpoint, before: Scene, plan: Plan) -> None:
    """Raise GranflowError for sizes, materials and counts of the scene that particles present contradict."""
    engine = checkpoint.saved["engine"]
    particles = engine["particles"]
    radius = particles["radius"]
    low, high = plan.radius_min * (1.0 - SIZE_ROUNDING), plan.radius_max * (1.0 + SIZE_ROUNDING)
    if len(radius) and not (low <= radius.min() and radius.max() <= high):
        raise GranflowError(
            f"{checkpoint.path} has particles of {2.0 * radius.min():.6g} to {2.0 * radius.max():.6g} m, but "
            f"those of the scene are of {2.0 * plan.radius_min:.6g} to {2.0 * plan.radius_max:.6g} m; their "
            "diameters must include those of the checkpoint."
        )
    if "material" in particles:
        index = np.array(
            [plan.materials.index(each) if each in plan.materials else 0 for each in before.materials]
        )
        if np.any(particles["material"] != index[engine["accounting"]["material"][particles["id"]]]):
            raise GranflowError(
                f"{checkpoint.path}: the materials of the particle groups must stay when a run continues."
            )
    for group in plan.groups:
        due = checkpoint.saved["insertion"].get(group.name, {}).get("due_count", 0)
        if due > group.spec.count:
            raise GranflowError(
                f"particles.{group.name}.count is {group.spec.count}, but at {checkpoint.path} {due} were "
                "already inserted or due: give at least this count, or a run.duration after the checkpoint."
            )


def refuse_other_keys(checkpoint: Checkpoint, key: str, fresh: Any) -> None:
    """Raise CheckpointError if a part of the state does not fit the scene.

    key:    path in the state, such as observers/Fields 0
    fresh:  this part at the start of a run; what is empty there grows during a run
    """
    saved: Any = checkpoint.saved
    for name in key.split("/"):
        saved = saved[name]
    _compare(checkpoint, key, saved, fresh)


def _compare(checkpoint: Checkpoint, key: str, saved: Any, fresh: Any) -> None:
    is_same = True
    if isinstance(fresh, dict) and fresh:
        is_same = isinstance(saved, dict) and set(saved) == set(fresh)
        for name, each in fresh.items() if is_same else ():
            _compare(checkpoint, f"{key}/{name}", saved[name], each)
    elif isinstance(fresh, np.ndarray) and fresh.size:
        is_same = saved.shape == fresh.shape
    if not is_same:
        raise CheckpointError(
            f"{checkpoint.path}: {key} does not fit the scene; restore this part of the scene, or run it "
            "from the start."
        )


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
    """Raise GranflowError if `scene` changes the duration of the present stage to one already exceeded."""
    stage_times = checkpoint.saved["stage_progress"]["stage_times"]
    index, (name, (began, _)) = len(stage_times) - 1, list(stage_times.items())[-1]
    keys = ("run.duration", f"stages.{index}.duration", f"stages.{index}.max_duration")
    lasted = checkpoint.time - began
    step = checkpoint.saved["engine"]["clock"]["time_step"]
    for each in change.differences:
        if each.key in keys and each.now is not None and each.now < lasted - step:
            raise GranflowError(
                f"{each.key} is {each.now:.6g} s, but at {checkpoint.path} stage {name} has already lasted "
                f"{lasted:.6g} s: give at least this duration."
            )


def _refuse_other_numbers(checkpoint: Checkpoint, plan: Plan) -> None:
    """Raise GranflowError for the first number or feature of the plan that is not as in the checkpoint."""
    for name, before in checkpoint.saved["plan"].items():
        now = plan_fingerprint(plan)[name]
        if now != before and name == "mesh_digest":
            raise GranflowError(
                f"{checkpoint.path}: the triangles of the mesh walls differ from those of the run, but must "
                "not change when a run continues; restore the mesh files."
            )
        if now != before:
            remedy = "; give the old value with --set" if name in _numbers_of(plan) else ""
            raise GranflowError(
                f"{checkpoint.path}: {name} was {before!r} and would be {now!r} with this scene, but must "
                f"not change when a run continues{remedy}."
            )


MAX_JUMP = 1e-3
"""Largest displacement of a wall by a change of its motion, over the smallest radius."""


def _refuse_jumps(before: Scene, plan: Plan, saved: Mapping[str, Any], time: float) -> None:
    """Raise GranflowError if a motion that the scene changes displaces a wall at `time` [s].

    `before`: scene of the checkpoint; `saved`: its state, with the start and end [s] of the stages, and the
    walls that follow Python instead of the scene. The displacement is that of the corners of the domain.
    """
    stage_times: StageTimes = saved["stage_progress"]["stage_times"]
    corners = np.array(list(product(*zip(plan.domain_low, plan.domain_high, strict=True))))
    motions = _motions_of(before, plan, stage_times)
    for wall, first, second in zip(plan.walls, *motions, strict=False):
        moved = np.linalg.norm(
            _positions(first, time, corners) - _positions(second, time, corners), axis=1
        ).max()
        if wall.name not in saved["changes"]["walls"] and moved > MAX_JUMP * plan.radius_min:
            key = f"walls.{wall.name}.motion"
            count = len(before.walls[wall.name].motion)
            raise GranflowError(
                f"{key} would displace the wall by {moved:.3g} m at {time:.6g} s. Terminate the old motion "
                "at this time and add another one from then on: "
                f"--set {key}.{max(count - 1, 0)}.end={time:.6g}s "
                f"--set '{key}.{count}={{kind: .., start: {time:.6g} s}}'."
            )


LATER = re.compile(r"walls\.\w+(\.\w+)?\.(stages|appears_at|vanishes_at|motion)\b")
"""Keys of walls that can differ at later times only."""


def _affects_forces(
    found: Sequence[Difference], before: Scene, plan: Plan, saved: Mapping[str, Any], time: float
) -> bool:
    """Whether differences change the forces at `time` [s]: those of pairs, and walls that are present or move
    otherwise at this time, or were elsewhere when the neighbor lists were filled."""
    keys = [each.key for each in found if each.key.startswith(("walls.", "pairs."))]
    if not all(LATER.match(key) for key in keys) or saved["changes"]["walls"]:
        return bool(keys)
    progress, state = saved["stage_progress"], saved["engine"]
    middle = time + 0.5 * plan.time_step
    present = [wall.spec.is_present(progress["stage"], middle) for wall in plan.walls]
    if list(map(bool, state["walls_present"])) != present:
        return True
    earlier = [each.numeric(before.usual_gravity) for wall in before.walls.values() for each in wall.motion]
    if any(each.force_controlled for each in earlier) and any(".motion" in key for key in keys):
        return True
    moments = np.array([time])
    if (clock := state["clock_at_rebuild"]) is not None:
        steps = clock["step_count"] - clock["since_step"]
        moments = np.append(moments, clock["since_time"] + steps * clock["time_step"])
    return not all(
        np.array_equal(old, new)
        for motions in zip(*_motions_of(before, plan, progress["stage_times"]), strict=True)
        for old, new in zip(*(astuple(poses_at(each, moments)) for each in motions), strict=True)
    )


def _motions_of(
    before: Scene, plan: Plan, stage_times: StageTimes
) -> tuple[Sequence[Sequence[TimedMotion]], Sequence[Sequence[TimedMotion]]]:
    """Motions of each wall with their times: of the scene of the checkpoint, and of the plan."""
    earlier = [[each.numeric(before.usual_gravity) for each in wall.motion] for wall in before.walls.values()]
    return wall_motions(earlier, stage_times), wall_motions(
        [each.motions for each in plan.walls], stage_times
    )


def _positions(motions: Sequence[TimedMotion], time: float, points: np.ndarray) -> np.ndarray:
    """Return the positions (n, 3) [m] at `time` [s] of points (n, 3) [m] at rest that move with a wall."""
    pose_at_time = poses_at(motions, np.array([time]))
    return (
        (points - pose_at_time.pivot) @ pose_at_time.rotation[0].T
        + pose_at_time.pivot
        + pose_at_time.offset[0]
    )


# Comparison of two scenes, key by key.

ALLOWED_CHANGES: dict[str, str] = {
    r"title|description|expect(\.|$).*": "title, description and expectations",
    r"output\.((timeseries_)?interval|particles|contacts|walls)": "selection and interval of output",
    r"output\.(frames_per_rank|compression)": "files of frames",
    r"output\.checkpoint\..*": "interval and number of checkpoints",
    r"run\.duration|stages\.\d+\.(duration|kinetic_energy_below|(min|max)_duration|until.*)": (
        "end of run or stage"
    ),
    r"walls\.\w+(\.\w+)?\.(stages|appears_at|vanishes_at)": "presence of a wall, such as opening a gate",
    r"walls\.\w+(\.\w+)?\.motion(\.|$).*": "motion of a wall from now on",
    r"pairs\.[\w-]+\.(friction|rolling_friction)": "friction, if it is above 0 before and after",
    r"numerics\.max_overlap": "overlap limit at which the run is aborted",
    r"run\.(time_step|velocity_max)|numerics\.(skin|chunk_size)": "only to the values used by the run so far",
}
"""Keys that may change when a run is resumed, with a description. Changes of all other keys are rejected."""


def differences(before: SceneInput, now: SceneInput) -> tuple[Difference, ...]:
    """All keys that differ, in the order of the scenes, with defaults included.

    Lists of numbers are compared as a whole, lists of mappings entry by entry.
    """
    first = dict(_leaves(before.model_dump(by_alias=True, exclude_none=True)))
    second = dict(_leaves(now.model_dump(by_alias=True, exclude_none=True)))
    keys = dict.fromkeys([*first, *second])
    return tuple(
        Difference(key, first.get(key), second.get(key)) for key in keys if first.get(key) != second.get(key)
    )


def forbidden(before: SceneInput, now: SceneInput, stages_over: int) -> tuple[Difference, ...]:
    """Differences that prevent a resume of a run whose first `stages_over` stages have ended.

    A difference is permitted if its key is in ALLOWED_CHANGES and not in an ended stage, or adds a stage.
    """
    return tuple(
        each for each in differences(before, now) if not _allowed(each, len(before.stages), stages_over)
    )


def _allowed(difference: Difference, stages_before: int, stages_over: int) -> bool:
    """Whether a run can be resumed with a difference.

    `stages_before`: number of stages in the earlier scene; `stages_over`: number of those that have ended.
    """
    stage = re.match(r"stages\.(\d+)\.", difference.key)
    if stage and int(stage[1]) >= stages_before:
        return True
    return difference.is_allowed and not (stage and int(stage[1]) < stages_over)


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Path and value of each entry that is neither a mapping nor a list of mappings."""
    if isinstance(value, dict) and value:
        for key, each in value.items():
            yield from _leaves(each, f"{path}.{key}".lstrip("."))
    elif isinstance(value, list | tuple) and any(isinstance(each, dict) for each in value):
        for index, each in enumerate(value):
            yield from _leaves(each, f"{path}.{index}")
    else:
        yield path, value


def shown_value(value: Any) -> str:
    """A value of a scene as text; lists as in a scene file."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(shown_value, value))}]"
    return str(value)


# Changes from Python that checkpoints contain: capacity, walls, parameters of forces, removed observers,
# functions.
#
# Functions cannot be stored: a program that resumes the run must register functions of the same names.


def saved_changes(plan: Plan, original: Plan, observers: ObserverList) -> dict[str, Any]:
    """Return the changes for a checkpoint: plain numbers, texts, lists and mappings.

    `plan`: present plan; `original`: plan of the scene.
    """
    return {
        "particle_capacity": plan.particle_capacity,
        "sum_units": list(astuple(plan.sum_units)),
        "walls": {name: _saved_wall(wall) for name, wall in changed_walls(plan, original).items()},
        "external_forces": plan.features.external_forces,
        "forces": {
            force.name: {
                name: list(value) if isinstance(value, tuple) else value
                for name, value in force.values.items()
            }
            for force in plan.external_forces
        },
        "functions": observers.function_names,
        "removed_observers": observers.removed_names,
    }


def changed_plan(plan: Plan, checkpoint: Checkpoint) -> Plan:
    """Return the plan of the scene with the capacity, units of sums, walls and features of the checkpoint.

    Raises GranflowError for walls that are too fast.
    """
    saved = checkpoint.saved["changes"]
    plan = replace(
        plan,
        # A scene with more particles than that of the checkpoint is refused later, with the keys that differ.
        particle_capacity=max(saved["particle_capacity"], plan.particle_capacity),
        features=replace(plan.features, external_forces=saved["external_forces"]),
        saved_sum_units=SumUnits(*saved["sum_units"]),
    )
    for name, wall in saved["walls"].items():
        if name in [each.name for each in plan.walls]:  # other walls are refused later
            plan = with_wall(plan, _restored_wall(wall, wall_named(plan, name)))
    return plan


def refuse_other_functions(
    checkpoint: Checkpoint, forces: Sequence[ExternalForce], functions: Collection[str], allow_changes: bool
) -> None:
    """Check that the forces and the functions of observers of a checkpoint are registered again.

    `forces`, `functions`: forces, and names of the functions of observers, of the program that resumes the
    run. `allow_changes`: continue without some of them. Raises GranflowError.
    """
    changes = checkpoint.saved["changes"]
    registered = [force.name for force in forces]
    added = [name for name in registered if name not in changes["forces"]]
    if added:
        raise GranflowError(
            f"{checkpoint.path}: the run has no force {', '.join(added)}; add it after the start of the "
            "resumed simulation with simulation.forces.append."
        )
    for what, saved, present in (
        ("forces", list(changes["forces"]), registered),
        ("observers", changes["functions"], functions),
    ):
        missing = [name for name in saved if name not in present]
        if missing and not allow_changes:
            raise GranflowError(
                f"{checkpoint.path}: the run has {what} from Python that this program does not register: "
                f"{', '.join(missing)}. Give them to Simulation with {what}=[...], or continue without them "
                "with allow_changes (--allow-changes)."
            )


def saved_parameters(checkpoint: Checkpoint, force: ExternalForce) -> dict[str, Any]:
    """Return the values of the parameters of a force in a checkpoint.

    Raises CheckpointError for other parameters.
    """
    saved = checkpoint.saved["changes"]["forces"][force.name]
    if set(saved) != set(force.values):
        raise CheckpointError(
            f"{checkpoint.path}: the force {force.name} had the parameters {', '.join(saved) or 'none'} and "
            f"has {', '.join(force.values) or 'none'}; give it the same ones."
        )
    return {name: _tuples(value) for name, value in saved.items()}


def _tuples(values: Any) -> Any:
    """The values with tuples instead of lists."""
    return tuple(_tuples(value) for value in values) if isinstance(values, list) else values


def _saved_wall(wall: PlannedWall) -> dict[str, Any]:
    """End of a changed wall [s], and its motions if a program has changed them, otherwise None."""
    is_placed = placement_of(wall.motions) is not None
    saved = [_saved_motion(each) for each in wall.motions] if is_placed else None
    return {"vanishes_at": wall.spec.end_time, "motions": saved}


def _saved_motion(motion: TimedMotion) -> dict[str, Any]:
    """Name of the class of a motion, and its numbers."""
    return {"kind": type(motion).__name__} | {
        name: _lists(getattr(motion, name)) for name in motion.saved_numbers
    }


def _lists(values: Any) -> Any:
    """The values with lists instead of tuples."""
    if isinstance(values, dict):
        return {name: _lists(value) for name, value in values.items()}
    return [_lists(value) for value in values] if isinstance(values, tuple) else values


def _restored_wall(saved: Mapping[str, Any], wall: PlannedWall) -> PlannedWall:
    """The wall of the scene with the saved changes."""
    wall = vanishing(wall, saved["vanishes_at"])
    if saved["motions"] is None:
        return wall
    return replace(wall, motions=tuple(_restored(each) for each in saved["motions"]))


def _restored(saved: Mapping[str, Any]) -> TimedMotion:
    """One motion."""
    kind = MOTIONS[saved["kind"]]
    return kind.model_construct(**{name: _tuples(saved[name]) for name in kind.saved_numbers})
