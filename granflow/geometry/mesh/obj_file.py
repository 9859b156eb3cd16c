"""Reads vertices and faces of a Wavefront OBJ file; negative indices count back from the last vertex."""

import numpy as np

IGNORED = frozenset(("vn", "vt", "vp", "g", "o", "s", "usemtl", "mtllib", "l", "p", "cstype", "deg", "end", "parm"))
"""Keywords of lines that do not affect the surface."""
LONGEST_FACE = 4
"""Maximum number of corners of a face."""


class ObjError(Exception):
    """An invalid line; the message continues the sentence "FILE ..."."""


def read_obj(raw: bytes) -> tuple[np.ndarray, np.ndarray, int]:
    """Read vertices and faces; a face of four corners is split into two triangles.

    raw:      content of the file
    Returns:  points (n, 3) float64, triangles (t, 3) int64 as indices from 0, number of split quadrilaterals
    Raises:   ObjError with the line number for invalid lines, faces of more than LONGEST_FACE corners, and unknown
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
            points.append(_numbers(words, number))
        elif words[0] == "f":
            a, b, c, *rest = _corners(words[1:], len(points), number)
            triangles.append((a, b, c))
            triangles += [(a, c, d) for d in rest]
            quads += len(rest)
        elif number == 1 or not words[0].isascii():
            raise ObjError(f"cannot be read as OBJ: line {number} begins with {words[0][:20]!r}")
    return (
        np.array(points, np.float64).reshape(-1, 3),
        np.array(triangles, np.int64).reshape(-1, 3),
        quads,
    )


def _numbers(words: list[str], number: int) -> list[float]:
    """The three coordinates of a vertex line; further numbers are ignored. Raises ObjError."""
    try:
        x, y, z = (float(word) for word in words[1:4])
    except ValueError:
        raise ObjError(f"cannot be read as OBJ: line {number} needs three coordinates, as in v 0 0 1") from None
    return [x, y, z]


def _corners(words: list[str], count: int, number: int) -> list[int]:
    """Indices from 0 of a face: in the file, 1 is the first vertex, -1 the last vertex before the line.

    count:   number of vertices before the line
    number:  line number, for messages
    Raises:  ObjError
    """
    if not 3 <= len(words) <= LONGEST_FACE:
        raise ObjError(f"contains a face of {len(words)} corners in line {number}; export the surface as triangles")
    found = []
    for word in words:
        text = word.partition("/")[0]
        if not text.removeprefix("-").isdecimal() or len(text) > 12:
            raise ObjError(
                f"cannot be read as OBJ: line {number} has the corner {word[:20]!r}, not a number as in f 1 2 3"
            )
        index = int(text)
        index = index - 1 if index > 0 else count + index if index < 0 else -1
        if not 0 <= index < 2**31 or int(text) < -count:
            raise ObjError(f"refers to vertices that it does not contain in line {number}")
        found.append(index)
    return found
