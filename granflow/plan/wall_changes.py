"""Walls that a program changes during a run: the plan with other walls.

A wall changes by vanishing, or by other motions, which begin at the pose that the wall has reached.
Checkpoints contain the changed walls.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from granflow.errors import GranflowError
from granflow.plan.joined_walls import joints_of
from granflow.plan.plan import Plan
from granflow.plan.walls import PlannedWall, geometry_speed
from granflow.scene.blocks.motions import TimedMotion, placement_at


def wall_named(plan: Plan, name: str) -> PlannedWall:
    """The wall with this name. Raises GranflowError."""
    found = {wall.name: wall for wall in plan.walls}
    if name not in found:
        raise GranflowError(
            f"walls: {name!r} is not a wall of the scene; its walls are {', '.join(found) or 'none'}."
        )
    return found[name]


def without_wall(plan: Plan, name: str, time: float) -> Plan:
    """The plan with a wall that vanishes at `time` [s].

    Raises GranflowError if particles move with it, or if it bounds the section of a servo.
    """
    attached = [group.name for group in plan.groups if group.spec.attached_to == name]
    if attached:
        raise GranflowError(
            f"walls[{name!r}] cannot be removed: the particles of {', '.join(attached)} move with it."
        )
    _refuse_in_section(plan, name, "removed")
    return with_wall(plan, vanishing(wall_named(plan, name), time))


def _refuse_in_section(plan: Plan, name: str, changed: str) -> None:
    """Raise GranflowError for a wall whose distance from another one enters the pressure of a servo."""
    for motion in plan.controlled_motions:
        if name in (getattr(motion.spec, "between", None) or ()):
            raise GranflowError(
                f"walls[{name!r}] cannot be {changed}: it bounds the section of walls.{motion.name}.motion."
            )


def vanishing(wall: PlannedWall, time: float) -> PlannedWall:
    """The wall with another time [s] at which it vanishes."""
    return replace(wall, spec=wall.spec.model_copy(update={"vanishes_at": time}))


def with_motions(
    plan: Plan, name: str, motions: Sequence[TimedMotion], time: float, present: Sequence[TimedMotion]
) -> Plan:
    """The plan with a wall that moves with `motions` from `time` [s], from the pose of its present motions
    there.

    Raises GranflowError for a wall that is force-controlled or bounds the section of a servo, or if the wall
    would be too fast for the time step.
    """
    wall = wall_named(plan, name)
    if any(controlled.name == name for controlled in plan.controlled_motions):
        raise GranflowError(f"walls[{name!r}] is force-controlled: its motion cannot be changed.")
    _refuse_in_section(plan, name, "given motions")
    return with_wall(plan, replace(wall, motions=(placement_at(present, time), *motions)))


def with_wall(plan: Plan, wall: PlannedWall) -> Plan:
    """The plan with another wall of the same name. Raises GranflowError if it is too fast for the time
    step."""
    speed = _speed(plan, wall)
    limit = min(plan.wall_travel_limit, plan.wall_displacement_limit)
    if speed * plan.longest_time_step > limit:
        raise GranflowError(
            f"walls[{wall.name!r}].motion moves the wall at up to {speed:.3g} m/s, but at most "
            f"{limit / plan.longest_time_step:.3g} m/s is possible with a time step of "
            f"{plan.longest_time_step:.3g} s."
        )
    if plan.adaptive_time_step is not None and speed > plan.wall_speed:
        raise GranflowError(
            f"walls[{wall.name!r}].motion moves the wall at up to {speed:.3g} m/s, but the adaptive time "
            f"step is for walls up to {plan.wall_speed:.3g} m/s: give the fastest motion in the scene."
        )
    walls = tuple(wall if each.name == wall.name else each for each in plan.walls)
    joints = joints_of(walls, plan.radius_max, plan.periodic_box.axes)
    has_belt = any(each.is_belt for each in wall.motions)
    features = replace(
        plan.features,
        joined_walls=plan.features.joined_walls or any(joints),
        moving_walls=plan.features.moving_walls or bool(wall.motions),
        surface_velocity=plan.features.surface_velocity or has_belt,
    )
    return replace(
        plan,
        walls=walls,
        wall_joints=joints,
        features=features,
        wall_speed=max(plan.wall_speed, speed),
    )


def _speed(plan: Plan, wall: PlannedWall) -> float:
    """Largest speed [m/s] of the geometry of the wall within the domain, by its prescribed motions without
    stages."""
    motions = [each for each in wall.motions if each.stages is None]
    return geometry_speed(wall.surface, motions, plan.scene.domain, plan.scene.longest_duration)


def changed_walls(plan: Plan, original: Plan) -> Mapping[str, PlannedWall]:
    """The walls that differ from those of the original plan, by name."""
    return {
        wall.name: wall for wall, before in zip(plan.walls, original.walls, strict=True) if wall is not before
    }
