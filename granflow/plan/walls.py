"""Walls of a scene in numeric form: surfaces at rest, motions, and largest speeds.

`planned_walls` makes the surfaces and joins the edges that surfaces of revolution share. Motions are those of
the scene with unit vectors and without optional values. A motion or a wall that is limited to stages gets its
times when the stages begin.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import inf

import numpy as np

from granflow.errors import SceneError
from granflow.geometry.mesh import Mesh
from granflow.geometry.surface import Surface, assign_shared_edges
from granflow.geometry.vectors import distance_from_axis
from granflow.io.files import FormatError
from granflow.load import Scene
from granflow.plan.stages import StageTimes, always
from granflow.scene.blocks.domain import Domain
from granflow.scene.blocks.motions import TimedMotion, placement_of
from granflow.scene.blocks.walls.wall import Wall


@dataclass(frozen=True)
class PlannedWall:
    """One wall: name in the scene, its record there (`spec`), surface at rest, area [m2], material number in
    the plan, and numeric motions.

    `area`: None if it is infinite; that of a plane between periodic boundaries is the section of the domain.
    """

    name: str
    spec: Wall
    surface: Surface
    area: float | None
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
            area=surface.area if wall.is_bounded else wall.periodic_area(scene.domain),
            material=material_numbers[wall.material],
            motions=tuple(each.numeric(scene.usual_gravity) for each in wall.motion),
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

NO_POINTS: np.ndarray = np.zeros((0, 3))
CORNERS: np.ndarray = np.array(list(product((-1.0, 1.0), repeat=3)))
"""Corners of a cube with the half width 1."""


def wall_speeds(scene: Scene, walls: Sequence[PlannedWall]) -> dict[str, float]:
    """Largest speed [m/s] of the geometry of each wall within the domain, by name.

    Prescribed motions only; a surface of revolution that rotates about its own axis does not move as
    geometry.
    """
    times = always(scene.schedule)
    return {
        wall.name: geometry_speed(
            wall.surface, [each.at(times) for each in wall.motions], scene.domain, scene.longest_duration
        )
        for wall in walls
    }


def geometry_speed(
    surface: Surface, motions: Sequence[TimedMotion], domain: Domain, duration: float
) -> float:
    """Largest speed [m/s] of a surface within the domain by a chain of prescribed motions in `duration` [s].

    A rotation that maps the surface onto itself does not count, see `Surface.reach_about`.
    """
    return _chain_speed(surface, motions, domain, duration, surface.reach_about)


def _chain_speed(
    surface: Surface,
    motions: Sequence[TimedMotion],
    domain: Domain,
    duration: float,
    reach_about: Callable[[np.ndarray, np.ndarray], float],
    attached: np.ndarray = NO_POINTS,
) -> float:
    """Sum of the largest speeds [m/s] of all motions of a chain.

    The last motion that is a rotation has the reach of the surface about its axis (`reach_about`), or of the
    `attached` points (n, 3) [m] that move with it. For an earlier one, the motions after it move both in a
    ball about a point of its axis, which each of them enlarges. Motions after a placement refer to space; the
    surface at rest is then inversely placed.
    """
    speeds = []
    travel = 0.0  # of translations in the frame of the present motion
    ball: tuple[np.ndarray, float] | None = None
    placement = placement_of(motions)
    for index, motion in reversed(list(enumerate(motions))):
        if not motion.rotates:
            speeds.append(motion.top_speed(0.0))
            travel += motion.travel(duration)
            continue
        in_space, axis_in_space = motion.point_and_axis
        point, axis = in_space, axis_in_space
        if placement is not None:
            turned = np.array(placement.rotation).T
            point = turned @ (in_space - np.array(placement.translation))
            axis = turned @ axis_in_space
        center, radius = ball or (point, _radius_about(surface, attached, point))
        radius += travel + float(np.linalg.norm(point - center))
        reach = radius
        if ball is None and travel == 0.0:
            farthest = distance_from_axis(attached, point, axis).max(initial=0.0)
            reach = max(reach_about(point, axis), float(farthest))
        carriers = motions[:index]
        if math.isinf(reach) or not (
            domain.on_exit == "expand" or any(each.rotates or each.force_controlled for each in carriers)
        ):
            carried = sum(each.travel(duration) for each in carriers)
            reach = min(reach, _reach_of(domain, in_space, axis_in_space) + carried)
        speeds.append(motion.top_speed(reach))
        ball = point, radius
        travel = 0.0
    return sum(reversed(speeds))


def _radius_about(surface: Surface, attached: np.ndarray, point: np.ndarray) -> float:
    """Largest distance [m] of a surface and points (n, 3) [m] from a point; infinite for an unbounded
    surface."""
    if surface.area is None:
        return math.inf
    points = np.concatenate([surface.enclosing_points(), attached])
    return float(np.linalg.norm(points - point, axis=1).max())


def _attached_points(scene: Scene, wall: str) -> np.ndarray:
    """Points (n, 3) [m], of which the bounding box contains the particles that are attached to a wall.

    Of particles from a file it is the domain.
    """
    found = [NO_POINTS]
    for group in scene.particles.values():
        if group.attached_to == wall:
            place = group.insert.place
            if place is not None:
                found.append(np.array(list(product(*place.extent()))))
                continue
            radius = 0.5 * group.diameters[1]
            given = np.array(group.insert.points).reshape(-1, 3)
            found += [given + side for side in radius * CORNERS] if len(given) else [scene.domain.corners]
    return np.concatenate(found)


def _reach_of(domain: Domain, point: np.ndarray, axis: np.ndarray) -> float:
    """Largest distance [m] of the domain from an axis: that of a corner, because the distance is convex."""
    return float(distance_from_axis(domain.corners, point, axis).max())


def surface_speed(scene: Scene, walls: Sequence[PlannedWall]) -> float:
    """Largest surface speed [m/s] of all walls, including rotation in place, belts and force-controlled
    motion.

    Points of a rotating wall, and of the particles that are attached to it, count up to the largest distance
    from the axis, or that of the domain if this is smaller: contacts are within it.
    """
    extent = scene.domain.diagonal
    times = always(scene.schedule)
    fastest = 0.0
    for wall in walls:
        controlled_speed = max(
            sum(
                each.controlled_speed(scene.gravity_along, extent)
                for each in wall.motions
                if each.is_in_stage(stage.name)
            )
            for stage in scene.schedule
        )
        belt = sum(each.surface_speed for each in wall.motions)
        prescribed = _chain_speed(
            wall.surface,
            [each.at(times) for each in wall.motions],
            scene.domain,
            scene.longest_duration,
            wall.surface.farthest_from,
            _attached_points(scene, wall.name),
        )
        fastest = max(fastest, prescribed + belt + controlled_speed)
    return fastest
