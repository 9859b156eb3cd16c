"""Reads vertices and faces of a Wavefront OBJ file; negative indices count back from the last vertex."""

import numpy as np

from granflow.io.regular_files import FormatError

IGNORED = frozenset(("vn", "vt", "vp", "g", "o", "s", "usemtl", "mtllib", "l", "p", "cstype", "deg", "end", "parm"))
"""Keywords of lines that do not affect the surface."""


def read_obj(raw: bytes) -> tuple[np.ndarray, np.ndarray, int]:
    """Read vertices and faces; a face of four corners is split into two triangles.

    raw:      content of the file
    Returns:  points (n, 3) float64, triangles (t, 3) int64 as indices from 0, number of split quadrilaterals
    Raises:   FormatError with the line number for invalid lines, faces of more than four corners, and unknown vertices
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
        raise FormatError(f"cannot be read as OBJ: line {number} needs three coordinates, as in v 0 0 1") from None
    return [x, y, z]


def _corners(words: list[str], count: int, number: int) -> list[int]:
    """Indices from 0 of a face in line `number`, after `count` vertices. Raises FormatError.

    In the file, 1 is the first vertex, -1 the last one before the line.
    """
    if not 3 <= len(words) <= 4:
        raise FormatError(f"contains a face of {len(words)} corners in line {number}; export the surface as triangles")
    found = []
    for word in words:
        text = word.partition("/")[0]
        if not text.removeprefix("-").isdecimal() or len(text) > 12:
            raise FormatError(
                f"cannot be read as OBJ: line {number} has the corner {word[:20]!r}, not a number as in f 1 2 3"
            )
        index = int(text) - 1 if int(text) > 0 else count + int(text)
        if int(text) == 0 or not 0 <= index < 2**31:
            raise FormatError(f"refers to vertices that it does not contain in line {number}")
        found.append(index)
    return found
