"""Walls of a scene in numeric form: shapes at rest, motions, presence, and largest speeds.

`planned_walls` reads the meshes and joins the edges that surfaces of revolution share. Motions are those of
the scene with unit vectors and without optional values. A motion or a wall that is limited to stages gets its
times when the stages begin.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import inf
from pathlib import Path
from typing import NamedTuple

import numpy as np

from granflow.errors import SceneError
from granflow.geometry import plane, revolved
from granflow.geometry.catalog import Surface, reach_about
from granflow.geometry.mesh import Mesh, mesh_of
from granflow.geometry.mesh_file import read_triangles
from granflow.geometry.motion import rotation_matrices
from granflow.geometry.revolved import join_shared_edges
from granflow.geometry.shape import Shape, unit
from granflow.io.files import FormatError, resolved
from granflow.load import Scene
from granflow.plan.stages import StageTimes, always
from granflow.scene.blocks.domain import Domain
from granflow.scene.blocks.motions import TimedMotion, single_rotation, speed_bound
from granflow.scene.blocks.walls import AnyWall, Cone, Cylinder, Disc, MeshWall, Plane, Rectangle, Wall
from granflow.schema.quantities import Vector3


@dataclass(frozen=True)
class PlannedWall:
    """One wall: name in the scene, shape at rest (triangle mesh or analytic surface), material number in the
    plan.

    `stages`: those in which it is present, None for all. It is present from `appears_at` up to `vanishes_at`
    [s].
    """

    name: str
    shape: Surface
    material: int
    motions: tuple[TimedMotion, ...]
    stages: tuple[str, ...] | None
    appears_at: float
    vanishes_at: float

    def is_present(self, stage: str, time: float) -> bool:
        """Whether the wall is present in a stage at `time` [s]."""
        return (self.stages is None or stage in self.stages) and self.appears_at <= time < self.vanishes_at

    @property
    def is_permanent(self) -> bool:
        """Whether the wall is present during the whole run."""
        return self.stages is None and self.appears_at <= 0.0 and self.vanishes_at == inf


def planned_walls(scene: Scene, material_numbers: Mapping[str, int]) -> tuple[PlannedWall, ...]:
    """Shapes of all walls in the order of the scene; shared edges of walls that move together are joined.

    `material_numbers`: number in the plan of each material by name. Force-controlled walls share no edge with
    others.

    Raises SceneError if a mesh file cannot be used.
    """
    walls = scene.walls
    surfaces = dict[str, Surface](meshes_of(scene))
    others = {name: wall for name, wall in walls.items() if name not in surfaces}
    moves_like = [
        (
            wall.motion,
            wall.stages,
            wall.appears_at,
            wall.vanishes_at,
            name if is_force_controlled(wall) else "",
        )
        for name, wall in others.items()
    ]
    joined = join_shared_edges([shape_of(wall) for wall in others.values()], moves_like)
    surfaces |= dict(zip(others, joined, strict=True))
    return tuple(
        PlannedWall(
            name=name,
            shape=surfaces[name],
            material=material_numbers[wall.material],
            motions=tuple(each.numeric(scene.gravity) for each in wall.motion),
            stages=wall.stages,
            appears_at=wall.appears_at or 0.0,
            vanishes_at=inf if wall.vanishes_at is None else wall.vanishes_at,
        )
        for name, wall in walls.items()
    )


def shape_of(wall: AnyWall) -> Shape:
    """Shape at rest of a wall of the scene that is not a mesh: half space, rectangle, cylinder, cone or disc.

    Lengths [m]; cylinders and cones have no end faces.
    """
    if isinstance(wall, Plane):
        return plane.half_space(wall.point, wall.normal)
    if isinstance(wall, Rectangle):
        return plane.rectangle(wall.corner, *wall.sides)
    if isinstance(wall, Cylinder):
        return revolved.cylinder(wall.from_, wall.to, wall.radius)
    if isinstance(wall, Cone):
        return revolved.cone(wall.from_, wall.to, wall.radius_from, wall.radius_to)
    assert isinstance(wall, Disc)
    return revolved.disc(wall.center, wall.normal, wall.radius, wall.hole_radius)


def is_force_controlled(wall: AnyWall) -> bool:
    """True if the forces of the particles move this wall."""
    return any(each.force_controlled for each in wall.motion)


def has_belt(wall: AnyWall) -> bool:
    """True if the wall has a surface velocity."""
    return any(each.is_belt for each in wall.motion)


def wall_motions(
    motions: Iterable[Sequence[TimedMotion]], stage_times: StageTimes
) -> tuple[tuple[TimedMotion, ...], ...]:
    """Motions of each wall with their times [s], given the times of the stages that have begun."""
    return tuple(tuple(each.at(stage_times) for each in of_wall) for of_wall in motions)


def wall_change_times(walls: Sequence[PlannedWall]) -> tuple[float, ...]:
    """Times [s] given in the scene at which a wall appears or vanishes, in ascending order.

    Changes at the start and end of stages are not included.
    """
    times = {time for wall in walls for time in (wall.appears_at, wall.vanishes_at)}
    return tuple(sorted(times - {0.0, inf}))


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
            reach = reach_about(wall.shape, point, axis, max_distance)
        speeds[wall.name] = speed_bound(motions, reach)
    return speeds


def surface_speed(scene: Scene) -> float:
    """Largest surface speed [m/s] of all walls, including rotation in place, belts and force-controlled
    motion.

    Points of a rotating wall are assumed to be at most half the diagonal of the domain from the axis.
    """
    extent = _domain_size(scene.domain)
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


# Mesh walls: reads and places their files, and reports probable mistakes.

REFUSED_SIZE_RATIO, WARNED_SIZE_RATIO = 100.0, 5.0
"""Ratios of mesh size to domain size above which a mesh is refused, or causes a warning: wrong unit of
length."""
FAR_TOO_SMALL = 1e-3
"""Ratio of mesh size to the smallest diameter below which a mesh is refused: wrong unit of length."""
MILLIMETERS = 1000.0
"""Millimeters per meter, the most frequent mistake in units of mesh files."""
FILES_CACHED = 16
"""Number of meshes in the cache: a run builds several plans."""


def meshes_of(scene: Scene) -> dict[str, Mesh]:
    """The mesh walls at rest by name, scaled, rotated and translated as the scene specifies.

    Files are read once per modification time (cache). Raises SceneError with the problems of all meshes:
    unreadable or invalid files, and sizes that indicate a wrong unit of length.
    """
    found = {}
    problems = []
    for name, wall in scene.walls.items():
        if isinstance(wall, MeshWall):
            try:
                mesh = _mesh(scene, wall)
                _refuse_size(scene, wall, mesh)
                found[name] = mesh
            except (FormatError, ValueError) as error:
                location = scene.locate("walls", name, "file")
                problems.append(f"{location}: walls.{name}.file is {wall.file}, which {error}.")
    if problems:
        raise SceneError(problems)
    return found


def mesh_path(scene: Scene, wall: MeshWall) -> Path:
    """Path of a mesh file, with symbolic links resolved.

    Raises FormatError if the path cannot be followed, such as a circular link.
    """
    try:
        return resolved(scene.folder / wall.file)
    except OSError as error:
        raise FormatError(f"cannot be read: {error.strerror}") from None


def _mesh(scene: Scene, wall: MeshWall) -> Mesh:
    """The mesh of a wall at rest, in m. Raises FormatError or ValueError."""
    path = mesh_path(scene, wall)
    try:
        modified = path.stat()
    except OSError:
        return mesh_of(read_triangles(path))
    rotations = tuple((rotation.axis, rotation.angle) for rotation in wall.rotate)
    return _mesh_once(path, (modified.st_mtime_ns, modified.st_size), wall.scale, rotations, wall.translate)


@lru_cache(FILES_CACHED)
def _mesh_once(
    path: Path,
    modified: tuple[int, int],
    scale: float,
    rotations: tuple[tuple[Vector3, float], ...],
    offset: Vector3,
) -> Mesh:
    """The mesh of a file with this modification time and size; scaled, rotated and translated."""
    rotation_matrix = np.eye(3)
    for axis, angle in rotations:
        rotation_matrix = rotation_matrices(unit(axis), np.array([angle]))[0] @ rotation_matrix
    return mesh_of(read_triangles(path)).placed(scale, rotation_matrix, np.array(offset))


def _refuse_size(scene: Scene, wall: MeshWall, mesh: Mesh) -> None:
    """Raise FormatError for a mesh that is much larger than the domain or much smaller than the smallest
    particle."""
    size = _size(mesh)
    smallest = min(group.diameters[0] for group in scene.particles.values())
    if size < FAR_TOO_SMALL * smallest:
        raise FormatError(
            f"is {size:.3g} m large, {size / smallest:.3g} times the smallest particle ({smallest:.3g} m): "
            f"increase scale, which is {wall.scale:g} now"
        )
    share = size / _domain_size(scene.domain)
    if share > REFUSED_SIZE_RATIO:
        raise FormatError(f"is {size:.3g} m large, {share:.3g} times the domain: {_remedy(wall)}")


def _remedy(wall: Wall) -> str:
    scale = wall.scale / MILLIMETERS if isinstance(wall, MeshWall) else 1.0
    return f"if the file is in millimeters, set scale: {scale:g}"


def _size(mesh: Mesh) -> float:
    """Diagonal [m] of the bounding box of a mesh."""
    return float(np.linalg.norm(mesh.size))


def _domain_size(domain: Domain) -> float:
    """Diagonal [m] of the domain."""
    return float(np.linalg.norm(np.subtract(domain.max, domain.min)))


class MeshNote(NamedTuple):
    """One sentence about a mesh wall; check and explain show all notes, a run only those with `warning`."""

    wall: str
    sentence: str
    warning: bool


def notes_on(scene: Scene, name: str, mesh: Mesh, smallest: float) -> Iterator[MeshNote]:
    """Notes for the user on a mesh wall: size, repaired triangles, open edges, and a probable mistake.

    `name`: of the wall; `smallest`: diameter [m] of the smallest particle.
    """
    x, y, z = mesh.size
    yield MeshNote(name, f"{mesh.triangle_count} triangles, {x:.4g} x {y:.4g} x {z:.4g} m", False)
    for count, text, warning in (
        (mesh.quad_count, "quadrilateral{} split into triangles", False),
        (mesh.divided_count, "triangle{} split at vertices of others on their edges", False),
        (
            mesh.adjacency.open_count,
            "open edge{}: not watertight, which is valid for a hopper or a plate",
            False,
        ),
        (
            mesh.adjacency.nonmanifold_count,
            "edge{} shared by more than two triangles, as at a T-junction of plates",
            False,
        ),
        (mesh.degenerate_count, "triangle{} of zero area removed", True),
        (mesh.duplicate_count, "duplicate triangle{} removed", True),
    ):
        if count:
            yield MeshNote(name, f"{count} {text.format('s' if count > 1 else '')}", warning)
    suspicion = _suspicion(scene, name, mesh, smallest)
    if suspicion:
        yield MeshNote(name, suspicion, True)


def _suspicion(scene: Scene, name: str, mesh: Mesh, smallest: float) -> str | None:
    """A sentence on a probable mistake, or None."""
    low = mesh.points.min(axis=0)
    high = mesh.points.max(axis=0)
    size = _size(mesh)
    share = size / _domain_size(scene.domain)
    if share > WARNED_SIZE_RATIO:
        return f"{size:.3g} m large, {share:.3g} times the domain: {_remedy(scene.walls[name])}"
    if np.any(low > scene.domain.max) or np.any(high < scene.domain.min):
        return "wholly outside the domain; see scale and translate"
    if size < smallest:
        return f"{size:.3g} m large, less than the smallest particle; see scale"
    return None
