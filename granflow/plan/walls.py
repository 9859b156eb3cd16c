"""Wall shapes and motions in numeric form; motions with stages get their times when the stages begin."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

from granflow.geometry import motion, plane, revolved
from granflow.geometry.catalog import Surface, area_of, reach_about
from granflow.geometry.shape import Shape, unit
from granflow.geometry.shared_edges import join_shared_edges
from granflow.load import Scene
from granflow.plan.meshes import meshes_of
from granflow.scene.schema import scene as scene_schema

StageTimes = Mapping[str, tuple[float, float]]
"""Start and end [s] of each stage that has begun; the end is infinite during the stage."""


@dataclass(frozen=True)
class PlannedWall:
    """One wall: name in the scene, shape at rest (triangle mesh or analytic surface), material number in the plan."""

    name: str
    shape: Surface
    material: int


def planned_walls(scene: Scene, material_numbers: Mapping[str, int]) -> tuple[PlannedWall, ...]:
    """Shapes of all walls in the order of the scene; shared edges of walls that move together are joined.

    `material_numbers`: number in the plan of each material by name. Force-controlled walls share no edge with others.

    Raises SceneError if a mesh file cannot be used.
    """
    walls, surfaces = scene.walls, dict[str, Surface](meshes_of(scene))
    primitives = {name: wall for name, wall in walls.items() if name not in surfaces}
    groups = [
        (wall.motion, wall.stages, wall.appears_at, wall.vanishes_at, name if is_force_controlled(wall) else "")
        for name, wall in primitives.items()
    ]
    joined = join_shared_edges([shape_of(wall) for wall in primitives.values()], groups)
    surfaces |= dict(zip(primitives, joined, strict=True))
    return tuple(PlannedWall(name, surfaces[name], material_numbers[wall.material]) for name, wall in walls.items())


def shape_of(wall: scene_schema.AnyWall) -> Shape:
    """Shape at rest of a wall of the scene that is not a mesh: half space, rectangle, cylinder, cone or disc.

    Lengths [m]; cylinders and cones have no end faces.
    """
    if isinstance(wall, scene_schema.Plane):
        return plane.half_space(wall.point, wall.normal)
    if isinstance(wall, scene_schema.Rectangle):
        return plane.rectangle(wall.corner, *wall.sides)
    if isinstance(wall, scene_schema.Cylinder):
        return revolved.cylinder(wall.from_, wall.to, wall.radius)
    if isinstance(wall, scene_schema.Cone):
        return revolved.cone(wall.from_, wall.to, wall.radius_from, wall.radius_to)
    assert isinstance(wall, scene_schema.Disc)
    return revolved.disc(wall.center, wall.normal, wall.radius, wall.hole_radius)


def wall_motions(scene: Scene, stage_times: StageTimes) -> tuple[tuple[motion.Motion, ...], ...]:
    """Motions of each wall in the order of the scene, given the times of the stages.

    The motions of a stage that has not begun start at infinity. Angles [rad], times [s].
    """
    return tuple(tuple(_motion(scene, each, stage_times) for each in wall.motion) for wall in scene.walls.values())


def is_force_controlled(wall: scene_schema.AnyWall) -> bool:
    """True if the forces of the particles move this wall."""
    return any(isinstance(each, scene_schema.ServoSpec | scene_schema.FreeWallSpec) for each in wall.motion)


def _motion(scene: Scene, given: Any, stage_times: StageTimes) -> motion.Motion:
    """One motion in numeric form: unit vectors, SI units, start and end [s]."""
    start, end = _span(given, stage_times)
    if isinstance(given, scene_schema.ServoSpec | scene_schema.FreeWallSpec):
        return motion.ForceControlled(start, end)
    if isinstance(given, scene_schema.TranslationSpec):
        return motion.Translation(given.velocity, start, end)
    if isinstance(given, scene_schema.RotationSpec):
        return motion.Rotation(given.point, _unit_vector(given.axis), given.angular_velocity, start, end)
    amplitude, omega = given.amplitude_and_angular_frequency(scene.gravity)
    return motion.Vibration(_unit_vector(given.direction), amplitude, omega, given.phase, start, end)


def _unit_vector(given: Any) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in unit(given))
    return x, y, z


def _span(given: Any, stage_times: StageTimes) -> tuple[float, float]:
    """Start and end [s] of a motion; (infinity, infinity) if its stages have not begun."""
    if given.stages is None:
        return given.start or 0.0, inf if given.end is None else given.end
    started = [stage_times[name] for name in given.stages if name in stage_times]
    if not started:
        return inf, inf
    return started[0][0], started[-1][1]


def wall_presence(scene: Scene, stage: str, time: float) -> tuple[bool, ...]:
    """Presence of each wall in the order of the scene, in a stage at `time` [s].

    A wall is present from `appears_at` up to, but not including, `vanishes_at` [s].
    """
    return tuple(
        (wall.stages is None or stage in wall.stages)
        and (wall.appears_at or 0.0) <= time
        and (wall.vanishes_at is None or time < wall.vanishes_at)
        for wall in scene.walls.values()
    )


def wall_change_times(scene: Scene) -> tuple[float, ...]:
    """Times [s] in the scene at which a wall appears or vanishes, in ascending order.

    Changes at the start and end of stages are not included.
    """
    times = {time for wall in scene.walls.values() for time in (wall.appears_at, wall.vanishes_at) if time}
    return tuple(sorted(times))


def measured_areas(scene: Scene) -> dict[str, float | None]:
    """Area [m2] of each wall with measured wall forces, by name; None for an unbounded wall."""
    meshes = meshes_of(scene)
    return {name: area_of(meshes.get(name) or shape_of(scene.walls[name])) for name in scene.measured_walls}


def wall_speeds(scene: Scene, walls: Sequence[PlannedWall]) -> dict[str, float]:
    """Largest speed [m/s] of the geometry of each wall within the domain, by name.

    Prescribed motions only; a surface of revolution that rotates about its own axis does not move as geometry.
    """
    always = {stage.name: (0.0, inf) for stage in scene.schedule}
    corners = np.array([scene.domain.min, scene.domain.max])
    speeds = {}
    for wall, motions in zip(walls, wall_motions(scene, always), strict=True):
        rotation = motion.single_rotation(motions)
        reach = 0.0
        if rotation is not None:
            max_distance = float(np.linalg.norm(np.abs(corners - rotation.point).max(axis=0)))
            reach = reach_about(wall.shape, np.array(rotation.point), np.array(rotation.axis), max_distance)
        speeds[wall.name] = motion.speed_bound(motions, reach)
    return speeds


def surface_speed(scene: Scene) -> float:
    """Largest surface speed [m/s] of all walls, including rotation in place and force-controlled motion.

    Points of a rotating wall are assumed to be at most half the diagonal of the domain from the axis.
    """
    always = {stage.name: (0.0, inf) for stage in scene.schedule}
    extent = float(np.linalg.norm(np.subtract(scene.domain.max, scene.domain.min)))
    fastest = 0.0
    for wall, motions in zip(scene.walls.values(), wall_motions(scene, always), strict=True):
        controlled_speed = sum(_force_controlled_speed(scene, each, extent) for each in wall.motion)
        fastest = max(fastest, motion.speed_bound(motions, extent / 2) + controlled_speed)
    return fastest


def _force_controlled_speed(scene: Scene, given: Any, distance: float) -> float:
    """Largest speed [m/s] of a force-controlled motion: `velocity_max` of a servo, free fall of a free wall."""
    if isinstance(given, scene_schema.ServoSpec):
        return given.velocity_max
    if isinstance(given, scene_schema.FreeWallSpec):
        acceleration = abs(float(np.dot(scene.gravity, _unit_vector(given.direction)))) + abs(given.force) / given.mass
        return float(np.sqrt(2.0 * acceleration * distance))
    return 0.0
