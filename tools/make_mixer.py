"""Writes the stirrer of scenes/mixer.yaml: a shaft with two pairs of pitched blades, closed surfaces in one
file.

    python tools/make_mixer.py scenes/meshes/stirrer.stl

The axis is z; all lengths are in mm, as in CAD exports.
"""

import argparse
from pathlib import Path

import meshio
import numpy as np

SHAFT_RADIUS, SHAFT_BOTTOM, SHAFT_TOP, SHAFT_SIDES = 5.0, 1.5, 30.0, 12
BLADE_START, BLADE_TIP, BLADE_WIDTH, BLADE_THICKNESS = 3.0, 38.5, 14.0, 3.0
LEVELS = ((7.5, 0.0), (19.0, 90.0))
"""Height of the center of each pair of blades [mm], and direction of its first blade [degrees]."""

QUADS = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
"""Faces of a box with corners 0 to 3 at the bottom and 4 to 7 at the top, counterclockwise seen from
outside."""


def turn(axis: str, degrees: float) -> np.ndarray:
    """Rotation matrix (3, 3) about the x or the z axis, right-handed."""
    c = np.cos(np.radians(degrees))
    s = np.sin(np.radians(degrees))
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]] if axis == "x" else [[c, -s, 0], [s, c, 0], [0, 0, 1]])


def blade(height: float, direction: float, pitch: float) -> tuple[np.ndarray, np.ndarray]:
    """Corners (8, 3) and triangles (12, 3) of a flat blade with faces `pitch` degrees from the vertical."""
    x = np.array([BLADE_START, BLADE_TIP, BLADE_TIP, BLADE_START] * 2)
    y = np.array([-1, -1, 1, 1] * 2) * BLADE_THICKNESS / 2
    z = np.repeat([-1, 1], 4) * BLADE_WIDTH / 2
    corners = np.column_stack([x, y, z]) @ turn("x", pitch).T @ turn("z", direction).T
    faces = [[(a, b, c), (a, c, d)] for a, b, c, d in QUADS]
    return corners + [0, 0, height], np.array(faces).reshape(-1, 3)


def shaft() -> tuple[np.ndarray, np.ndarray]:
    """Corners and triangles of a prism about the axis, closed at both ends."""
    angle = 2 * np.pi * np.arange(SHAFT_SIDES) / SHAFT_SIDES
    ring = SHAFT_RADIUS * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(SHAFT_SIDES)])
    middle = np.zeros((1, 3))
    corners = np.vstack([part + [0, 0, z] for z in (SHAFT_BOTTOM, SHAFT_TOP) for part in (ring, middle)])
    faces = []
    for i in range(SHAFT_SIDES):
        j = (i + 1) % SHAFT_SIDES
        up = SHAFT_SIDES + 1
        faces += [
            (i, j, j + up),
            (i, j + up, i + up),
            (SHAFT_SIDES, j, i),
            (SHAFT_SIDES + up, i + up, j + up),
        ]
    return corners, np.array(faces)


def stirrer(pitch: float) -> meshio.Mesh:
    """Shaft and blades as one mesh."""
    parts = [shaft(), *(blade(height, start + half, pitch) for height, start in LEVELS for half in (0, 180))]
    starts = np.cumsum([0, *(len(corners) for corners, _ in parts)])
    triangles = [faces + start for (_, faces), start in zip(parts, starts, strict=False)]
    return meshio.Mesh(np.vstack([corners for corners, _ in parts]), [("triangle", np.vstack(triangles))])


def main() -> None:
    """Writes the mesh."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("file", type=Path, help="STL, OBJ, PLY or VTK file to write")
    parser.add_argument(
        "--pitch", type=float, default=45.0, help="pitch of the blades, in degrees from the vertical (45)"
    )
    arguments = parser.parse_args()
    arguments.file.parent.mkdir(parents=True, exist_ok=True)
    meshio.write(arguments.file, stirrer(arguments.pitch), binary=True)


if __name__ == "__main__":
    main()
