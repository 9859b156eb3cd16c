"""Walls of a scene in numeric form: surfaces at rest, motions, and largest speeds.

`planned_walls` makes the surfaces and joins the edges that surfaces of revolution share. Motions are those of
the scene with unit vectors and without optional values. A motion or a wall that is limited to stages gets its
times when the stages begin.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from granflow.errors import SceneError
from granflow.geometry.mesh import Mesh
from granflow.geometry.surface import Surface, assign_shared_edges
from granflow.io.files import FormatError
from granflow.load import Scene
from granflow.plan.stages import StageTimes, always
from granflow.scene.blocks.motions import TimedMotion, single_rotation, speed_bound
from granflow.scene.blocks.walls.wall import Wall


@dataclass(frozen=True)
class PlannedWall:
    """One wall: name in the scene, its record there (`spec`), surface at rest, material number in the plan,
    and numeric motions.
    """

    name: str
    spec: Wall
    surface: Surface
    material: int
    motions: tuple[TimedMotion, ...]


def planned_walls(scene: Scene, material_numbers: Mapping[str, int]) -> tuple[PlannedWall, ...]:
    """Surfaces of all walls in the order of the scene; walls that move together have owners of shared edges.

    `material_numbers`: number in the plan of each material by name. Force-controlled walls share no edge with
    others.

    Raises SceneError if a mesh file cannot be used.
    """
    walls = scene.walls
    moves_like = [
        (
            wall.motion,
            wall.stages,
            wall.appears_at,
            wall.vanishes_at,
            name if wall.is_force_controlled else "",
        )
        for name, wall in walls.items()
    ]
    surfaces = assign_shared_edges(_surfaces(scene), moves_like)
    return tuple(
        PlannedWall(
            name=name,
            spec=wall,
            surface=surface,
            material=material_numbers[wall.material],
            motions=tuple(each.numeric(scene.gravity) for each in wall.motion),
        )
        for (name, wall), surface in zip(walls.items(), surfaces, strict=True)
    )


def _surfaces(scene: Scene) -> list[Surface]:
    """The surfaces of all walls at rest.

    Raises SceneError with the problems of all files: unreadable or invalid ones, and sizes that indicate a
    wrong unit of length.
    """
    smallest = min((group.diameters[0] for group in scene.particles.values()), default=0.0)
    found = []
    problems = []
    for name, wall in scene.walls.items():
        try:
            surface = wall.surface(scene.folder)
            wall.refuse_size(surface, scene.domain, smallest)
            found.append(surface)
        except FormatError as error:
            key, file_name = next(wall.files())
            location = scene.locate("walls", name, key)
            problems.append(f"{location}: walls.{name}.{key} is {file_name}, which {error}.")
    if problems:
        raise SceneError(problems)
    return found


def wall_motions(
    motions: Iterable[Sequence[TimedMotion]], stage_times: StageTimes
) -> tuple[tuple[TimedMotion, ...], ...]:
    """Motions of each wall with their times [s], given the times of the stages that have begun."""
    return tuple(tuple(each.at(stage_times) for each in of_wall) for of_wall in motions)


def wall_change_times(walls: Sequence[PlannedWall]) -> tuple[float, ...]:
    """Times [s] given in the scene at which a wall appears or vanishes, in ascending order.

    Changes at the start and end of stages are not included.
    """
    times = {time for wall in walls for time in (wall.spec.start_time, wall.spec.end_time)}
    return tuple(sorted(times - {0.0, inf}))


def meshes_of(walls: Sequence[PlannedWall]) -> dict[int, Mesh]:
    """The walls whose surface is a mesh: the surfaces by the number of the wall."""
    return {index: wall.surface for index, wall in enumerate(walls) if isinstance(wall.surface, Mesh)}


# Largest speeds of walls, before the run.


def wall_speeds(scene: Scene, walls: Sequence[PlannedWall]) -> dict[str, float]:
    """Largest speed [m/s] of the geometry of each wall within the domain, by name.

    Prescribed motions only; a surface of revolution that rotates about its own axis does not move as
    geometry.
    """
    corners = np.array([scene.domain.min, scene.domain.max])
    speeds = {}
    times = always(scene.schedule)
    for wall in walls:
        motions = [each.at(times) for each in wall.motions]
        rotation = single_rotation(motions)
        reach = 0.0
        if rotation is not None:
            point, axis = rotation.point_and_axis
            max_distance = float(np.linalg.norm(np.abs(corners - point).max(axis=0)))
            reach = min(wall.surface.reach_about(point, axis), max_distance)
        speeds[wall.name] = speed_bound(motions, reach)
    return speeds


def surface_speed(scene: Scene) -> float:
    """Largest surface speed [m/s] of all walls, including rotation in place, belts and force-controlled
    motion.

    Points of a rotating wall are assumed to be at most half the diagonal of the domain from the axis.
    """
    extent = scene.domain.diagonal
    fastest = 0.0
    for wall in scene.walls.values():
        motions = [each.numeric(scene.gravity) for each in wall.motion]
        controlled_speed = max(
            sum(
                each.controlled_speed(scene.gravity, extent)
                for each in motions
                if each.is_in_stage(stage.name)
            )
            for stage in scene.schedule
        )
        belt = sum(each.surface_speed for each in motions)
        fastest = max(fastest, speed_bound(motions, extent / 2) + belt + controlled_speed)
    return fastest
