"""Mesh walls of a scene: their files found and read, placed, and looked at for what is probably not meant."""

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from granflow.errors import SceneError
from granflow.plan.size_classes import diameter_range
from granflow.regular_files import resolved
from granflow.scene import Scene
from granflow.scene.fields import Vector3
from granflow.scene.schema import MeshWall, Wall
from granflow.walls.mesh import Mesh, mesh_of
from granflow.walls.mesh_file import MeshFileError, read_triangles
from granflow.walls.motion import rotation_matrices
from granflow.walls.shape import unit

REFUSED_SIZE_RATIO, WARNED_SIZE_RATIO = 100.0, 5.0
"""Size of a mesh over that of the domain from which on it is refused, or warned of: the wrong unit of length."""

FAR_TOO_SMALL = 1e-3
"""Size of a mesh over the diameter of the smallest particle below which it is refused: the wrong unit of length."""

MILLIMETERS = 1000.0

FILES_CACHED = 16
"""Meshes that are kept once read: a plan is made several times for a run."""


class MeshNote(NamedTuple):
    """One sentence about a mesh wall; a `warning` is shown before a run, the others by check and explain."""

    wall: str
    sentence: str
    warning: bool


def meshes_of(scene: Scene) -> dict[str, Mesh]:
    """The mesh walls by name, as they stand at rest. Raises SceneError with all that is wrong with any of them."""
    found, problems = {}, []
    for name, wall in scene.walls.items():
        if isinstance(wall, MeshWall):
            try:
                mesh = _mesh(scene, wall)
                _refuse_size(scene, wall, mesh)
                found[name] = mesh
            except (MeshFileError, ValueError) as error:
                location = scene.locate("walls", name, "file")
                problems.append(f"{location}: walls.{name}.file is {wall.file}, which {error}.")
    if problems:
        raise SceneError(problems)
    return found


def mesh_path(scene: Scene, wall: MeshWall) -> Path:
    """The file of a mesh. Raises MeshFileError where it lies outside the scene's folder, be it by a symbolic link."""
    try:
        folder = resolved(scene.folder)
        path = resolved(folder / wall.file)
    except OSError as error:
        raise MeshFileError(f"cannot be read: {error.strerror}") from None
    if not path.is_relative_to(folder):
        raise MeshFileError("leads out of the scene's folder by a symbolic link; put the file itself there")
    return path


def _mesh(scene: Scene, wall: MeshWall) -> Mesh:
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
    """The mesh of a file that was last changed then, scaled, turned and shifted."""
    rotation_matrix = np.eye(3)
    for axis, angle in rotations:
        rotation_matrix = rotation_matrices(unit(axis), np.array([angle]))[0] @ rotation_matrix
    return mesh_of(read_triangles(path)).placed(scale, rotation_matrix, np.array(offset))


def _refuse_size(scene: Scene, wall: MeshWall, mesh: Mesh) -> None:
    share = _size(mesh) / _domain_size(scene)
    smallest = min(diameter_range(group)[0] for group in scene.particles.values())
    if _size(mesh) < FAR_TOO_SMALL * smallest:
        share = _size(mesh) / smallest
        what = f"is {_size(mesh):.3g} m large, {share:.3g} times the smallest particle ({smallest:.3g} m)"
        raise MeshFileError(f"{what}: increase scale, which is {wall.scale:g} now")
    if share > REFUSED_SIZE_RATIO:
        raise MeshFileError(f"is {_size(mesh):.3g} m large, {share:.3g} times the domain: {_remedy(wall)}")


def _remedy(wall: Wall) -> str:
    scale = wall.scale / MILLIMETERS if isinstance(wall, MeshWall) else 1.0
    return f"if the file is in millimeters, set scale: {scale:g}"


def _size(mesh: Mesh) -> float:
    return float(np.linalg.norm(mesh.size))


def _domain_size(scene: Scene) -> float:
    return float(np.linalg.norm(np.subtract(scene.domain.max, scene.domain.min)))


def notes_on(scene: Scene, name: str, mesh: Mesh, smallest: float) -> Iterator[MeshNote]:
    """What a user should know of a mesh wall; `smallest`: diameter [m] of the smallest particle."""
    x, y, z = mesh.size
    yield MeshNote(name, f"{mesh.triangle_count} triangles, {x:.4g} x {y:.4g} x {z:.4g} m", False)
    for count, what, warning in (
        (mesh.quad_count, "four-sided face{} cut in two", False),
        (mesh.divided_count, "triangle{} divided where corners of others lie on their edges", False),
        (mesh.adjacency.open_count, "open edge{}: not watertight, which a hopper or a plate need not be", False),
        (mesh.adjacency.fold_count, "edge{} of more than two triangles, as where a plate stands on another", False),
        (mesh.degenerate_count, "triangle{} without area left out", True),
        (mesh.duplicate_count, "triangle{} left out of those that are there twice", True),
    ):
        if count:
            yield MeshNote(name, f"{count} {what.format('s' if count > 1 else '')}", warning)
    suspicion = _suspicion(scene, name, mesh, smallest)
    if suspicion:
        yield MeshNote(name, suspicion, True)


def _suspicion(scene: Scene, name: str, mesh: Mesh, smallest: float) -> str | None:
    """What is probably not meant."""
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    size, share = _size(mesh), _size(mesh) / _domain_size(scene)
    if share > WARNED_SIZE_RATIO:
        return f"{size:.3g} m large, {share:.3g} times the domain: {_remedy(scene.walls[name])}"
    if np.any(low > scene.domain.max) or np.any(high < scene.domain.min):
        return "wholly outside the domain; see scale and translate"
    if size < smallest:
        return f"{size:.3g} m large, less than the smallest particle; see scale"
    return None
