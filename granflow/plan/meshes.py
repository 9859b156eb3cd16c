"""Mesh walls of a scene: reads and places their files, and reports probable mistakes."""

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from granflow.errors import SceneError
from granflow.geometry.mesh.file import read_triangles
from granflow.geometry.mesh.mesh import Mesh, mesh_of
from granflow.geometry.motion import rotation_matrices
from granflow.geometry.shape import unit
from granflow.io.regular_files import FormatError, resolved
from granflow.load import Scene
from granflow.plan.size_classes import diameter_range
from granflow.scene.schema.domain import Domain
from granflow.scene.schema.quantities import Vector3
from granflow.scene.schema.walls import MeshWall, Wall

REFUSED_SIZE_RATIO, WARNED_SIZE_RATIO = 100.0, 5.0
"""Ratios of mesh size to domain size above which a mesh is refused, or causes a warning: wrong unit of length."""

FAR_TOO_SMALL = 1e-3
"""Ratio of mesh size to the smallest diameter below which a mesh is refused: wrong unit of length."""

MILLIMETERS = 1000.0
"""Millimeters per meter, the most frequent mistake in units of mesh files."""


FILES_CACHED = 16
"""Number of meshes in the cache: a run builds several plans."""


class MeshNote(NamedTuple):
    """One sentence about a mesh wall; check and explain show all notes, a run only those with `warning`."""

    wall: str
    sentence: str
    warning: bool


def meshes_of(scene: Scene) -> dict[str, Mesh]:
    """The mesh walls at rest by name, scaled, rotated and translated as the scene specifies.

    Files are read once per modification time (cache). Raises SceneError with the problems of all meshes: unreadable or
    invalid files, and sizes that indicate a wrong unit of length.
    """
    found, problems = {}, []
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
    path: Path, modified: tuple[int, int], scale: float, rotations: tuple[tuple[Vector3, float], ...], offset: Vector3
) -> Mesh:
    """The mesh of a file with this modification time and size; scaled, rotated and translated."""
    rotation_matrix = np.eye(3)
    for axis, angle in rotations:
        rotation_matrix = rotation_matrices(unit(axis), np.array([angle]))[0] @ rotation_matrix
    return mesh_of(read_triangles(path)).placed(scale, rotation_matrix, np.array(offset))


def _refuse_size(scene: Scene, wall: MeshWall, mesh: Mesh) -> None:
    """Raise FormatError for a mesh that is much larger than the domain or much smaller than the smallest particle."""
    share = _size(mesh) / _domain_size(scene.domain)
    smallest = min(diameter_range(group)[0] for group in scene.particles.values())
    if _size(mesh) < FAR_TOO_SMALL * smallest:
        share = _size(mesh) / smallest
        statement = f"is {_size(mesh):.3g} m large, {share:.3g} times the smallest particle ({smallest:.3g} m)"
        raise FormatError(f"{statement}: increase scale, which is {wall.scale:g} now")
    if share > REFUSED_SIZE_RATIO:
        raise FormatError(f"is {_size(mesh):.3g} m large, {share:.3g} times the domain: {_remedy(wall)}")


def _remedy(wall: Wall) -> str:
    scale = wall.scale / MILLIMETERS if isinstance(wall, MeshWall) else 1.0
    return f"if the file is in millimeters, set scale: {scale:g}"


def _size(mesh: Mesh) -> float:
    """Diagonal [m] of the bounding box of a mesh."""
    return float(np.linalg.norm(mesh.size))


def _domain_size(domain: Domain) -> float:
    """Diagonal [m] of the domain."""
    return float(np.linalg.norm(np.subtract(domain.max, domain.min)))


def notes_on(scene: Scene, name: str, mesh: Mesh, smallest: float) -> Iterator[MeshNote]:
    """Notes for the user on a mesh wall: size, repaired triangles, open edges, and a probable mistake.

    `name`: of the wall; `smallest`: diameter [m] of the smallest particle.
    """
    x, y, z = mesh.size
    yield MeshNote(name, f"{mesh.triangle_count} triangles, {x:.4g} x {y:.4g} x {z:.4g} m", False)
    for count, text, warning in (
        (mesh.quad_count, "quadrilateral{} split into triangles", False),
        (mesh.divided_count, "triangle{} split at vertices of others on their edges", False),
        (mesh.adjacency.open_count, "open edge{}: not watertight, which is valid for a hopper or a plate", False),
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
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    size, share = _size(mesh), _size(mesh) / _domain_size(scene.domain)
    if share > WARNED_SIZE_RATIO:
        return f"{size:.3g} m large, {share:.3g} times the domain: {_remedy(scene.walls[name])}"
    if np.any(low > scene.domain.max) or np.any(high < scene.domain.min):
        return "wholly outside the domain; see scale and translate"
    if size < smallest:
        return f"{size:.3g} m large, less than the smallest particle; see scale"
    return None
