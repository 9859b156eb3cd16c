"""Reads the triangles of a mesh file: STL (binary and text), OBJ, PLY, VTK, VTU. meshio reads text STL, PLY and VTK."""

import io
import warnings
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np

from granflow.geometry.mesh.obj_file import ObjError, read_obj
from granflow.io.regular_files import read_regular
from granflow.io.vtu_arrays import VtuError
from granflow.io.vtu_reader import read_vtu

LARGEST_FILE = 256 * 2**20
"""Maximum size of a mesh file in bytes; reading a file of this size takes seconds."""

MAX_TRIANGLES = 1_000_000
"""Maximum number of triangles of a mesh."""

FORMATS = ("stl", "obj", "ply", "vtk", "vtu")
"""Supported formats by the suffix of the file name."""

STL_HEADER, STL_RECORD = 84, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
"""Bytes before the first triangle of a binary STL file, and layout of a triangle (50 bytes, little-endian)."""

MAX_REASON_LENGTH = 200
"""Maximum length of a message of meshio, in characters."""

IGNORED_CELLS = ("vertex", "line")
"""Cells without a surface; ignored."""


class MeshFileError(Exception):
    """A file that contains no valid triangles for a wall; the message continues the sentence "FILE ..."."""


@dataclass(frozen=True)
class RawTriangles:
    """Triangles as read from a file, in the unit of the file.

    points:      (n, 3) float64 coordinates
    corners:     (t, 3) as indices of the points, from 0
    quad_count:  number of quadrilaterals that were split into two triangles each
    """

    points: np.ndarray
    corners: np.ndarray
    quad_count: int = 0


def read_triangles(path: Path) -> RawTriangles:
    """Read the triangles in a file, in the unit of the file. The suffix of the name determines the format.

    path:     STL, OBJ, PLY, VTK or VTU file of at most LARGEST_FILE bytes
    Returns:  1 to MAX_TRIANGLES triangles with finite coordinates; they may be degenerate or duplicate
    Raises:   MeshFileError if the file is missing, damaged, too large or of another format, or contains cells other
              than triangles, quadrilaterals, lines and vertices
    """
    raw = _read_bytes(path)
    kind = path.suffix.lower().lstrip(".")
    if kind not in FORMATS:
        raise MeshFileError(f"has an unsupported format; the supported formats are {', '.join(FORMATS)}")
    return _validated(_read_format(path, kind, raw))


def _read_format(path: Path, kind: str, raw: bytes) -> RawTriangles:
    """Triangles of a file of the format `kind`, one of FORMATS. Raises MeshFileError."""
    try:
        if kind == "obj":
            return RawTriangles(*read_obj(raw))
        if kind == "vtu":
            return _raw_triangles(read_vtu(path, LARGEST_FILE))
    except (ObjError, VtuError) as error:
        raise MeshFileError(str(error)) from None
    if kind == "stl" and not _is_text_stl(raw):
        return _binary_stl(raw)
    return _raw_triangles(_by_meshio(path, kind))


def _read_bytes(path: Path) -> bytes:
    """All bytes of the file. Raises MeshFileError if it is missing, empty, too large or not a regular file."""
    try:
        raw = read_regular(path, LARGEST_FILE)
    except FileNotFoundError:
        raise MeshFileError("does not exist") from None
    except OSError as error:
        raise MeshFileError(f"cannot be read: {error.strerror or error}") from None
    if not raw:
        raise MeshFileError("is empty")
    return raw


def _is_text_stl(raw: bytes) -> bool:
    """Whether an STL file is text. Binary files may begin with "solid" as well, but have the declared length."""
    if not raw.lstrip()[:5].lower() == b"solid" or b"\0" in raw[:STL_HEADER]:
        return False
    return len(raw) != STL_HEADER + STL_RECORD.itemsize * _stl_count(raw)


def _stl_count(raw: bytes) -> int:
    """Number of triangles that the header of a binary STL file declares; -1 if the header is truncated."""
    return int(np.frombuffer(raw, "<u4", 1, STL_HEADER - 4)[0]) if len(raw) >= STL_HEADER else -1


def _binary_stl(raw: bytes) -> RawTriangles:
    """Triangles of a binary STL file, three points each. Raises MeshFileError if the file is truncated."""
    count, capacity = _stl_count(raw), (len(raw) - STL_HEADER) // STL_RECORD.itemsize
    if count < 0:
        raise MeshFileError(f"is truncated: it has {len(raw)} bytes, fewer than the header of an STL file")
    if count > capacity:
        raise MeshFileError(f"declares {count} triangles, but its size allows {capacity}: it is truncated or damaged")
    records = np.frombuffer(raw, STL_RECORD, min(count, MAX_TRIANGLES + 1), STL_HEADER)
    points = records["corners"].reshape(-1, 3).astype(np.float64)
    return RawTriangles(points, np.arange(len(points)).reshape(-1, 3))


def _by_meshio(path: Path, kind: str) -> meshio.Mesh:
    """Read a file with meshio; every exception of meshio becomes a MeshFileError."""
    read: Callable[[Path], meshio.Mesh] = getattr(meshio, kind).read
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return read(path)
    except (Exception, SystemExit) as error:
        reason = " ".join(str(error).split()).partition(". ")[0].rstrip(".")[:MAX_REASON_LENGTH]
        reason = reason or "it is damaged or has another format"
        raise MeshFileError(f"cannot be read as {kind.upper()}: {reason}") from None


def _raw_triangles(mesh: meshio.Mesh) -> RawTriangles:
    """Triangles and split quadrilaterals of a mesh; 2-D points get z = 0. Raises MeshFileError for other cells."""
    points = np.asarray(mesh.points, dtype=np.float64)
    if points.ndim == 2 and points.shape[1] == 2:
        points = np.pad(points, ((0, 0), (0, 1)))
    triangles, quads = _cells(mesh, "triangle", 3), _cells(mesh, "quad", 4)
    others = {block.type: len(block.data) for block in mesh.cells}
    for known in ("triangle", "quad", *IGNORED_CELLS):
        others.pop(known, None)
    if any(others.values()):
        named = ", ".join(f"{count} {name}" for name, count in others.items())
        raise MeshFileError(f"contains {named}, but a wall consists of triangles; export the surface only")
    triangles_of_quads = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return RawTriangles(points, np.concatenate([triangles, triangles_of_quads]), len(quads))


def _cells(mesh: meshio.Mesh, kind: str, corner_count: int) -> np.ndarray:
    """Corners (c, corner_count) of all cells of one type of meshio, int64."""
    blocks = [np.asarray(block.data, dtype=np.int64) for block in mesh.cells if block.type == kind]
    return np.concatenate([np.empty((0, corner_count), dtype=np.int64), *blocks])


def _validated(triangles_read: RawTriangles) -> RawTriangles:
    """Check the number of triangles, the point indices and the coordinates; return the triangles unchanged.

    Raises MeshFileError for no or too many triangles, invalid indices, or coordinates that are not finite.
    """
    count = len(triangles_read.corners)
    if not count:
        raise MeshFileError("contains no triangles")
    if count > MAX_TRIANGLES:
        raise MeshFileError(f"contains more than {MAX_TRIANGLES} triangles, the maximum for a mesh")
    if (
        triangles_read.points.ndim != 2
        or triangles_read.points.shape[1] != 3
        or triangles_read.corners.max() >= len(triangles_read.points)
    ):
        raise MeshFileError("refers to vertices that it does not contain: it is damaged")
    if triangles_read.corners.min() < 0:
        raise MeshFileError("refers to vertices that it does not contain: it is damaged")
    not_finite = ~np.isfinite(triangles_read.points[triangles_read.corners]).all(axis=(1, 2))
    if not_finite.any():
        raise MeshFileError(f"has {int(not_finite.sum())} triangles with coordinates that are not finite")
    return triangles_read
