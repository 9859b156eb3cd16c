"""Writes example meshes of equipment as STL: a screw conveyor, a paddle mixer, a hopper; lengths in m.

    python tools/meshes.py screw screw.stl --radius 0.03 --length 0.2 --pitch 0.05
    python tools/meshes.py mixer mixer.stl --paddles 6 --tilt 45
    python tools/meshes.py hopper hopper.stl --outlet 0.01

Screw and mixer rotate about the x axis and start at x = 0; the axis of the hopper is z, its outlet is at the
origin.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import meshio
import numpy as np

Surface = tuple[np.ndarray, np.ndarray]
"""Points (n, 3) [m] and triangles (t, 3)."""


def patch(grid: np.ndarray, around: bool = False) -> Surface:
    """Triangles on a grid (m, n, 3) of points; with `around` the last column is connected to the first."""
    rows, columns = grid.shape[:2]
    row, column = np.meshgrid(
        np.arange(rows - 1), np.arange(columns if around else columns - 1), indexing="ij"
    )
    number = (row * columns + column).reshape(-1)
    following = (row * columns + (column + 1) % columns).reshape(-1)
    lower = np.stack([number, following, following + columns], axis=1)
    upper = np.stack([number, following + columns, number + columns], axis=1)
    return grid.reshape(-1, 3), np.concatenate([lower, upper])


def joined(surfaces: Sequence[Surface]) -> Surface:
    """Surfaces joined into one."""
    before = np.cumsum([0, *(len(points) for points, _ in surfaces)])
    triangles = [corners + shift for (_, corners), shift in zip(surfaces, before, strict=False)]
    return np.concatenate([points for points, _ in surfaces]), np.concatenate(triangles)


def revolved(profile: np.ndarray, facets: int) -> Surface:
    """Surface of revolution about the x axis of a line through points (m, 2) of (radius, height).

    The centers of the facets have the given radius. Triangles without area, at points on the axis, are
    omitted.
    """
    angle = 2.0 * np.pi * (np.arange(facets) + 0.5) / facets
    radius = profile[:, :1] / np.cos(np.pi / facets)
    height = profile[:, 1:]
    grid = np.stack(np.broadcast_arrays(height, radius * np.cos(angle), radius * np.sin(angle)), axis=-1)
    points, corners = patch(grid, around=True)
    sides = points[corners[:, 1:]] - points[corners[:, :1]]
    return points, corners[np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) > 0.0]


def shaft(radius: float, length: float, facets: int) -> Surface:
    """Closed cylinder along the x axis."""
    return revolved(np.array([[0.0, 0.0], [radius, 0.0], [radius, length], [0.0, length]]), facets)


def screw(options: argparse.Namespace) -> Surface:
    """Screw conveyor: a shaft with one helical flight of zero thickness between the two radii."""
    steps = max(round(options.length / options.pitch * options.facets), 1)
    x = np.linspace(0.0, options.length, steps + 1)
    angle = 2.0 * np.pi * x / options.pitch * (-1.0 if options.left else 1.0)
    radius = np.linspace(options.shaft, options.radius, options.rings + 1)[None, :]
    edge = [x[:, None], radius * np.cos(angle)[:, None], radius * np.sin(angle)[:, None]]
    return joined(
        [
            shaft(options.shaft, options.length, options.facets),
            patch(np.stack(np.broadcast_arrays(*edge), -1)),
        ]
    )


def paddle(options: argparse.Namespace, x: float, angle: float) -> Surface:
    """Flat box that extends radially from the axis of the shaft, rotated about its length by the tilt."""
    half = 0.5 * np.array([options.width, options.thickness])
    tilt = np.radians(options.tilt)
    across = np.array([[np.cos(tilt), np.sin(tilt)], [-np.sin(tilt), np.cos(tilt)]])
    section = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half @ across
    ends = [0.5 * options.shaft, options.radius]
    corner_grid = np.array([[[u, v, r] for u, v in section] for r in ends])
    radial = np.array([0.0, np.cos(angle), np.sin(angle)])
    azimuthal = np.array([0.0, -np.sin(angle), np.cos(angle)])
    grid = np.array([x, 0.0, 0.0]) + corner_grid @ np.array([[1.0, 0.0, 0.0], azimuthal, radial])
    points, sides = patch(grid, around=True)
    return points, np.concatenate([sides, [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]]])


def mixer(options: argparse.Namespace) -> Surface:
    """Paddle mixer: a shaft with equally spaced paddles, each rotated by 90 degrees relative to the previous
    one."""
    positions = options.length * (np.arange(options.paddles) + 0.5) / options.paddles
    paddles = [paddle(options, x, 0.5 * np.pi * n) for n, x in enumerate(positions)]
    return joined([shaft(options.shaft, options.length, options.facets), *paddles])


def hopper(options: argparse.Namespace) -> Surface:
    """Vertical hopper: a tube above a cone above an outlet tube, open at both ends."""
    slope = (options.radius - options.outlet) / np.tan(np.radians(options.half_angle))
    profile = [[options.outlet, -options.outlet], [options.outlet, 0.0], [options.radius, slope]]
    points, corners = revolved(np.array([*profile, [options.radius, slope + options.height]]), options.facets)
    return points[:, [1, 2, 0]], corners


KINDS = {
    screw: {"radius": 0.03, "shaft": 0.008, "length": 0.2, "pitch": 0.05, "facets": 32, "rings": 4},
    mixer: {
        "radius": 0.03, "shaft": 0.006, "length": 0.12, "width": 0.02, "thickness": 0.003, "tilt": 45.0, "paddles": 6,
        "facets": 24,
    },
    hopper: {"radius": 0.03, "outlet": 0.01, "half_angle": 30.0, "height": 0.04, "facets": 48},
}  # fmt: skip
"""Meshes with the defaults of their parameters: lengths in m, angles in degrees."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Writes one mesh."""
    options = parser().parse_args(arguments)
    points, corners = options.make(options)
    meshio.write(options.file, meshio.Mesh(points, [("triangle", corners)]), file_format="stl", binary=True)
    print(
        f"{options.file}: {len(corners)} triangles, "
        f"{' x '.join(f'{side:.4g}' for side in np.ptp(points, axis=0))} m."
    )
    return 0


def parser() -> argparse.ArgumentParser:
    """Parser of the command line: the kind of mesh, a file, and the parameters of the kind."""
    command_line = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    kinds = command_line.add_subparsers(required=True, metavar="KIND")
    for make, defaults in KINDS.items():
        subparser = kinds.add_parser(
            make.__name__, help=make.__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
        )
        subparser.set_defaults(make=make)
        subparser.add_argument("file", type=Path, help="file to write, such as mesh.stl")
        for name, value in defaults.items():
            subparser.add_argument(
                f"--{name.replace('_', '-')}", type=type(value), default=value, help=unit_of(name, value)
            )
    kinds.choices["screw"].add_argument("--left", action="store_true", help="a left-handed flight")
    return command_line


def unit_of(name: str, value: float) -> str:
    """Unit of a parameter."""
    if isinstance(value, int):
        return "count"
    return "degrees" if name in ("tilt", "half_angle") else "m"


if __name__ == "__main__":
    sys.exit(main())
