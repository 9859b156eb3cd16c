"""Mesh wall: triangles from a file, and what the user is told about them.

The triangles are a `geometry.mesh.Mesh`; on the device they are evaluated by `engine.mesh`.
"""

from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from granflow.geometry.mesh import Mesh, mesh_of
from granflow.geometry.mesh_file import read_triangles
from granflow.geometry.motion import rotation_matrices
from granflow.geometry.surface import Surface
from granflow.geometry.vectors import unit
from granflow.io.files import FormatError, resolved
from granflow.scene.blocks.domain import Domain
from granflow.scene.blocks.primitives import RotationStep
from granflow.scene.blocks.walls.wall import Wall, WallNote
from granflow.schema import quantities as q
from granflow.schema.model import FileName, ListOf
from granflow.schema.quantities import Number, Vector3

REFUSED_SIZE_RATIO, WARNED_SIZE_RATIO = 100.0, 5.0
"""Ratios of mesh size to domain size above which a mesh is refused, or causes a warning: wrong unit of
length."""
FAR_TOO_SMALL = 1e-3
"""Ratio of mesh size to the smallest diameter below which a mesh is refused: wrong unit of length."""
MILLIMETERS = 1000.0
"""Millimeters per meter, the most frequent mistake in units of mesh files."""
FILES_CACHED = 16
"""Number of meshes in the cache: a run builds several plans."""
MeshScale = Annotated[float, Number(above=0, scaling=1)]
"""Factor from the length unit of a mesh file to m, above 0; proportional to `scale`."""


class MeshWall(Wall):
    """Two-sided triangles from a file, transformed in this order: scale, rotate, translate.

    The orientation of the triangles has no effect; open edges are valid.

    >>> gf.MeshWall(material="steel", file="meshes/bowl.stl", scale=0.001).file
    'meshes/bowl.stl'
    """

    shape: Literal["mesh"] = Field("mesh", description="shape of the wall")
    file: FileName = Field(
        description="STL, OBJ, PLY, VTK or VTU file; path relative to the folder of the scene"
    )
    scale: MeshScale = Field(
        1.0,
        description="factor from the length unit of the file to m, such as 0.001 for mm",
        examples=[0.001],
    )
    rotate: Annotated[tuple[RotationStep, ...], ListOf(one=True)] = Field(
        (),
        description="rotation of the mesh about the origin: one rotation, or a list in order of application",
    )
    translate: q.Point = Field((0.0, 0.0, 0.0), description="displacement of the mesh [m]")

    def surface(self, folder: Path) -> Surface:
        """The mesh at rest, scaled, rotated and translated.

        Files are read once per modification time (cache).
        """
        path = self._path(folder)
        try:
            modified = path.stat()
        except OSError:
            return mesh_of(read_triangles(path))
        rotations = tuple((rotation.axis, rotation.angle) for rotation in self.rotate)
        changed = (modified.st_mtime_ns, modified.st_size)
        try:
            return _mesh(path, changed, self.scale, rotations, self.translate)
        except ValueError as error:
            raise FormatError(str(error)) from None

    def _path(self, folder: Path) -> Path:
        """Path of the file, with symbolic links resolved.

        Raises FormatError if the path cannot be followed, such as a circular link.
        """
        try:
            return resolved(folder / self.file)
        except OSError as error:
            raise FormatError(f"cannot be read: {error.strerror}") from None

    def files(self) -> Iterator[tuple[str, str]]:
        """See `Wall`."""
        yield "file", self.file
        yield from super().files()

    def with_files(self, copies: Mapping[str, str]) -> Wall:
        """See `Wall`."""
        return super().with_files(copies).model_copy(update={"file": copies[self.file]})

    def refuse_size(self, surface: Surface, domain: Domain, smallest: float) -> None:
        """Raise FormatError if the mesh is much larger than the domain or much smaller than the smallest
        particle."""
        size = _size(surface)
        if size < FAR_TOO_SMALL * smallest:
            raise FormatError(
                f"is {size:.3g} m large, {size / smallest:.3g} times the smallest particle "
                f"({smallest:.3g} m): increase scale, which is {self.scale:g} now"
            )
        share = size / domain.diagonal
        if share > REFUSED_SIZE_RATIO:
            raise FormatError(f"is {size:.3g} m large, {share:.3g} times the domain: {self._remedy(share)}")

    def _remedy(self, share: float) -> str:
        """What to do if its size is this share of the domain, also if scale is 1000 instead of 0.001."""
        scale = self.scale
        while share > WARNED_SIZE_RATIO:
            scale /= MILLIMETERS
            share /= MILLIMETERS
        return f"if the file is in millimeters, set scale: {scale:g}"

    def notes(self, name: str, surface: Surface, domain: Domain, smallest: float) -> Iterator[WallNote]:
        """Size, repaired triangles, open edges, and a probable mistake."""
        assert isinstance(surface, Mesh)
        x, y, z = surface.size
        yield WallNote(name, f"{surface.triangle_count} triangles, {x:.4g} x {y:.4g} x {z:.4g} m", False)
        for count, text, warning in (
            (surface.quad_count, "quadrilateral{} split into triangles", False),
            (surface.divided_count, "triangle{} split at vertices of others on their edges", False),
            (
                surface.adjacency.open_count,
                "open edge{}: not watertight, which is valid for a hopper or a plate",
                False,
            ),
            (
                surface.adjacency.nonmanifold_count,
                "edge{} shared by more than two triangles, as at a T-junction of plates",
                False,
            ),
            (surface.degenerate_count, "triangle{} of zero area removed", True),
            (surface.duplicate_count, "duplicate triangle{} removed", True),
        ):
            if count:
                yield WallNote(name, f"{count} {text.format('s' if count > 1 else '')}", warning)
        suspicion = self._suspicion(surface, domain, smallest)
        if suspicion:
            yield WallNote(name, suspicion, True)

    def _suspicion(self, mesh: Mesh, domain: Domain, smallest: float) -> str | None:
        """A sentence on a probable mistake, or None."""
        low = mesh.points.min(axis=0)
        high = mesh.points.max(axis=0)
        size = _size(mesh)
        share = size / domain.diagonal
        if share > WARNED_SIZE_RATIO:
            return f"{size:.3g} m large, {share:.3g} times the domain: {self._remedy(share)}"
        if np.any(low > domain.max) or np.any(high < domain.min):
            return "wholly outside the domain; see scale and translate"
        if size < smallest:
            return f"{size:.3g} m large, less than the smallest particle; see scale"
        return None


@lru_cache(FILES_CACHED)
def _mesh(
    path: Path,
    changed: tuple[int, int],
    scale: float,
    rotations: tuple[tuple[Vector3, float], ...],
    offset: Vector3,
) -> Mesh:
    """The mesh of a file with this modification time and size; scaled, rotated and translated."""
    rotation_matrix = np.eye(3)
    for axis, angle in rotations:
        rotation_matrix = rotation_matrices(unit(axis), np.array([angle]))[0] @ rotation_matrix
    return mesh_of(read_triangles(path)).placed(scale, rotation_matrix, np.array(offset))


def _size(mesh: Surface) -> float:
    """Diagonal [m] of the bounding box of a mesh."""
    assert isinstance(mesh, Mesh)
    return float(np.linalg.norm(mesh.size))
