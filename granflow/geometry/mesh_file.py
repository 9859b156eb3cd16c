"""Reads the triangles of a mesh file: STL, OBJ, PLY, VTK, VTU. meshio reads text STL, PLY, VTK and VTU.

trimesh is not used: it accepts truncated STL and PLY files and vertices with two coordinates, splits polygons
and drops invalid faces silently, gives no line numbers, and its import takes longer than that of meshio.
"""

import io
import warnings
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from granflow.io.files import FormatError, read_file
from granflow.io.vtu import VtuMesh, read_vtu, reason_of
from granflow.visible_text import numbered

if TYPE_CHECKING:
    from meshio import Mesh

MAX_TRIANGLES = 1_000_000
"""Maximum number of triangles of a mesh."""
FORMATS = ("stl", "obj", "ply", "vtk", "vtu")
"""Supported formats by the suffix of the file name."""
STL_HEADER, STL_RECORD = (
    84,
    np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]),
)
"""Bytes before the first triangle of a binary STL file, and layout of a triangle (50 bytes,
little-endian)."""
STL_COMMENTS = (b"#", b";", b"//", b"!")
"""Begins of comments, which some programs write before and after the solid of a text STL file."""
IGNORED_CELLS = ("vertex", "line")
"""Cells without a surface; ignored."""


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

    path:     STL, OBJ, PLY, VTK or VTU file
    Returns:  1 to MAX_TRIANGLES triangles with finite coordinates; they may be degenerate or duplicate
    Raises:   FormatError if the file is missing, damaged, too large or of another format, or contains cells
              other than triangles, quadrilaterals, lines and vertices
    """
    try:
        raw = read_file(path)
    except FileNotFoundError:
        raise FormatError("is missing: there is no such file") from None
    except OSError as error:
        raise FormatError(f"cannot be read: {error.strerror or error}") from None
    kind = path.suffix.lower().lstrip(".")
    if not raw:
        raise FormatError("is empty")
    if kind not in FORMATS:
        raise FormatError(f"has an unsupported format; the supported formats are {', '.join(FORMATS)}")
    if kind == "stl" and len(plain := _without_comments(raw)) < len(raw) and _is_text_stl(plain):
        with TemporaryDirectory() as folder:
            copy = Path(folder, "plain.stl")
            copy.write_bytes(plain)
            return read_triangles(copy)
    if kind == "obj":
        found = RawTriangles(*read_obj(raw))
    elif kind == "stl" and not _is_text_stl(raw):
        found = _binary_stl(raw)
    else:
        if kind == "stl" and not raw.rstrip().rpartition(b"\n")[2].strip().lower().startswith(b"endsolid"):
            raise FormatError("does not end with endsolid: it is truncated")
        if kind == "ply" and b"end_header" not in raw:  # meshio reads on without end
            raise FormatError("has no end_header: it is truncated, or not a PLY file")
        mesh = read_vtu(path) if kind == "vtu" else _by_meshio(path, kind)
        found = _raw_triangles(mesh)
        if kind == "ply":
            _check_ply(raw, sum(len(block.data) for block in mesh.cells))
    _check(found)
    return found


def _without_comments(raw: bytes) -> bytes:
    """The bytes of a text STL file without empty lines, which meshio does not read, and without the comments
    before its first line and after its last one."""
    lines = [line for line in raw.splitlines(keepends=True) if line.strip()]
    kept = [k for k, line in enumerate(lines) if not line.lstrip().startswith(STL_COMMENTS)]
    return b"".join(lines[kept[0] : kept[-1] + 1]) if kept else raw


def _is_text_stl(raw: bytes) -> bool:
    """Whether an STL file is text.

    Binary files may begin with "solid" as well, but have the declared length.
    """
    if not raw.lstrip()[:5].lower() == b"solid" or b"\0" in raw[:STL_HEADER]:
        return False
    return len(raw) != STL_HEADER + STL_RECORD.itemsize * _stl_count(raw)


def _stl_count(raw: bytes) -> int:
    """Number of triangles that the header of a binary STL file declares; -1 if the header is truncated."""
    return int(np.frombuffer(raw, "<u4", 1, STL_HEADER - 4)[0]) if len(raw) >= STL_HEADER else -1


def _binary_stl(raw: bytes) -> RawTriangles:
    """Triangles of a binary STL file, three points each.

    Raises FormatError if it has more or fewer than declared.
    """
    count = _stl_count(raw)
    capacity = (len(raw) - STL_HEADER) // STL_RECORD.itemsize
    if count < 0:
        raise FormatError(f"is truncated: it has {len(raw)} bytes, fewer than the header of an STL file")
    if count > capacity:
        raise FormatError(
            f"declares {count} triangles, but its size allows {capacity}: it is truncated or damaged"
        )
    if count < capacity:
        raise FormatError(
            f"declares {count} triangles, but its size is that of {capacity}: the others would be missing; "
            "export it again"
        )
    records = np.frombuffer(raw, STL_RECORD, min(count, MAX_TRIANGLES + 1), STL_HEADER)
    points = records["corners"].reshape(-1, 3).astype(np.float64)
    return RawTriangles(points, np.arange(len(points)).reshape(-1, 3))


def _check_ply(raw: bytes, face_count: int) -> None:
    """Raise FormatError if a PLY file has fewer faces than its header declares, which meshio ignores."""
    lines = [line.split() for line in raw.partition(b"end_header")[0].splitlines()]
    declared = next((int(line[2]) for line in lines if line[:2] == [b"element", b"face"]), 0)
    if declared != face_count:
        raise FormatError(f"declares {declared} faces, but contains {face_count}: it is truncated or damaged")


def _by_meshio(path: Path, kind: str) -> "Mesh":
    """Read a file with meshio; every exception of meshio becomes a FormatError."""
    import meshio

    read: Callable[[Path], Mesh] = getattr(meshio, kind).read
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return read(path)
    except (Exception, SystemExit) as error:
        raise FormatError(f"cannot be read as {kind.upper()}: {reason_of(error)}") from None


def _raw_triangles(mesh: "Mesh | VtuMesh") -> RawTriangles:
    """Triangles and split quadrilaterals of a mesh; 2-D points get z = 0.

    Raises FormatError for other cells.
    """
    points = np.asarray(mesh.points, dtype=np.float64)
    if points.ndim == 2 and points.shape[1] == 2:
        points = np.pad(points, ((0, 0), (0, 1)))
    others = {block.type: len(block.data) for block in mesh.cells}
    for known in ("triangle", "quad", *IGNORED_CELLS):
        others.pop(known, None)
    if any(others.values()):
        named = ", ".join(f"{count} {name}" for name, count in others.items())
        raise FormatError(f"contains {named}, but a wall consists of triangles; export the surface only")
    triangles, quads = (
        np.concatenate(
            [np.empty((0, count), np.int64), *(b.data.astype(np.int64) for b in mesh.cells if b.type == kind)]
        )
        for kind, count in (("triangle", 3), ("quad", 4))
    )
    return RawTriangles(
        points, np.concatenate([triangles, quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]), len(quads)
    )


def _check(found: RawTriangles) -> None:
    """Raise FormatError for no or too many triangles, invalid indices, or coordinates that are not finite."""
    points = found.points
    corners = found.corners
    if not len(corners):
        raise FormatError("contains no triangles")
    if len(corners) > MAX_TRIANGLES:
        raise FormatError(f"contains more than {MAX_TRIANGLES} triangles, the maximum for a mesh")
    if points.ndim != 2 or points.shape[1] != 3 or not 0 <= corners.min() <= corners.max() < len(points):
        raise FormatError("refers to vertices that it does not contain: it is damaged")
    not_finite = ~np.isfinite(points[corners]).all(axis=(1, 2))
    if not_finite.any():
        triangles = numbered(int(not_finite.sum()), "triangle")
        raise FormatError(f"has {triangles} with coordinates that are not finite")


# Reads vertices and faces of a Wavefront OBJ file; negative indices count back from the last vertex.

IGNORED = frozenset(
    ("vn", "vt", "vp", "g", "o", "s", "usemtl", "mtllib", "l", "p", "cstype", "deg", "end", "parm")
)
"""Keywords of lines that do not affect the surface."""


def read_obj(raw: bytes) -> tuple[np.ndarray, np.ndarray, int]:
    """Read vertices and faces; a face of four corners is split into two triangles.

    raw:      content of the file
    Returns:  points (n, 3) float64, triangles (t, 3) int64 as indices from 0, number of split quadrilaterals
    Raises:   FormatError with the line number for invalid lines, faces of more than four corners, and unknown
              vertices
    """
    points: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    quads = 0
    text = raw.decode("utf-8", errors="replace").replace("\\\n", " ")
    for number, line in enumerate(text.split("\n"), 1):
        words = line.partition("#")[0].split()
        if not words or words[0] in IGNORED:
            continue
        if words[0] == "v":
            points.append(_coordinates(words, number))
        elif words[0] == "f":
            a, b, c, *rest = _corners(words[1:], len(points), number)
            triangles.append((a, b, c))
            triangles += [(a, c, d) for d in rest]
            quads += len(rest)
        elif number == 1 or not words[0].isascii():
            raise FormatError(f"cannot be read as OBJ: line {number} begins with {words[0][:20]!r}")
    return np.array(points, np.float64).reshape(-1, 3), np.array(triangles, np.int64).reshape(-1, 3), quads


def _coordinates(words: list[str], number: int) -> list[float]:
    """The three coordinates of a vertex in line `number`; further numbers are ignored. Raises FormatError."""
    try:
        x, y, z = (float(word) for word in words[1:4])
    except ValueError:
        raise FormatError(
            f"cannot be read as OBJ: line {number} needs three coordinates, as in v 0 0 1"
        ) from None
    return [x, y, z]


def _corners(words: list[str], count: int, number: int) -> list[int]:
    """Indices from 0 of a face in line `number`, after `count` vertices. Raises FormatError.

    In the file, 1 is the first vertex, -1 the last one before the line.
    """
    if not 3 <= len(words) <= 4:
        raise FormatError(
            f"contains a face of {len(words)} corners in line {number}; export the surface as triangles"
        )
    found = []
    for word in words:
        text = word.partition("/")[0]
        if not text.removeprefix("-").isdecimal() or len(text) > 12:
            raise FormatError(
                f"cannot be read as OBJ: line {number} has the corner {word[:20]!r}, not a number as in f 1 "
                "2 3"
            )
        index = int(text) - 1 if int(text) > 0 else count + int(text)
        if int(text) == 0 or not 0 <= index < 2**31:
            raise FormatError(f"refers to vertices that it does not contain in line {number}")
        found.append(index)
    return found
