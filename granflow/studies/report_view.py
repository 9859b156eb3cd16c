"""The interactive 3D view of the report page: particles and walls of chosen frames, as compressed arrays.

`interactive_view` returns a header in JSON and the arrays as text, which the script of the page inflates and
draws. Positions and radii are integers: multiples of a fraction of the smallest radius, 16 bits each. Values
that are displayed as colors have 8 bits.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from granflow import Run, Scene
from granflow.fields import WALL_ARRAY_QUANTITIES, WEAR_ARRAYS
from granflow.io.frames import listed_frames
from granflow.studies.figures import COLORS
from granflow.studies.frames import (
    Frame,
    FrameParticles,
    FrameWalls,
    bounding_points,
    domain_of,
    drawn_boxes,
    filled_frames,
    frames_of,
    outermost_points,
    read_particles,
    read_walls,
    sampled,
    upward,
    view_of,
)
from granflow.studies.interactive_plots import deflated
from granflow.studies.render import CATEGORIES, SIGNED, Scale, prefixed, scale_for, values_of
from granflow.visible_text import readable


class View(NamedTuple):
    """Content of the view: `header` in the format of the script of the page, compressed arrays, and a
    sentence."""

    header: Mapping[str, Any]
    data: str
    statement: str


MOST_PARTICLES = 100_000
"""Maximum number of particles in a frame of the view; of more, every second, third, ... is shown."""
PARTICLE_FRAMES = 240_000
"""Number of particles in all frames together above which fewer frames are in the view: about 3 MB."""
FEWEST_FRAMES = 3
MOST_FRAMES = 40
"""Smallest and largest number of frames in the view."""


def interactive_view(record: Run) -> View | None:
    """The 3D view of a run; None if it has no frames with particles.

    Raises GranflowError if a file cannot be read.
    """
    if not listed_frames(record.directory, "particles"):
        return None
    filled = filled_frames(frames_of(record.directory))
    largest = max(filled, key=lambda frame: frame.particles.stat().st_size)
    count = len(read_particles(largest).radius)
    if not count:
        return None
    stride = -(-count // MOST_PARTICLES)
    frame_count = min(max(PARTICLE_FRAMES * stride // count, FEWEST_FRAMES), MOST_FRAMES)
    frames = sampled(filled, frame_count)
    particles = [_every(stride, read_particles(frame)) for frame in frames]
    arrays = PackedArrays()
    scene = None if record.scene_problem else record.scene
    header = _particle_header(frames, particles, scene, arrays)
    outermost = np.concatenate([*map(outermost_points, particles), np.array(header["extent"])])
    points = bounding_points("all", scene, frames, domain_of(scene), outermost)
    header["extent"] = [points.min(axis=0).tolist(), points.max(axis=0).tolist()]
    walls = [read_walls(frame) for frame in frames]
    worn = list(_wear_scales(walls))
    header["wallQuantities"] = [_quantity_header(scale) for scale in worn]
    has_all_walls = _add_walls(header["frames"], walls, particles, scene, worn, arrays)
    return View(header, arrays.text(), _statement(len(frames), len(filled), count, stride, has_all_walls))


def _every(stride: int, particles: FrameParticles) -> FrameParticles:
    """The particles with ids that are multiples of `stride`."""
    ids = particles.arrays.get("id", np.arange(len(particles.radius)))
    return particles if stride == 1 else particles.selected(ids % stride == 0)


def _statement(shown: int, frame_count: int, count: int, stride: int, has_all_walls: bool) -> str:
    """Sentence on what is in the view."""
    text = f"{shown} of {frame_count} frames" if shown < frame_count else f"All {shown} frames"
    if stride > 1:
        text += f"; of up to {readable(count)} particles, those whose id is a multiple of {stride}"
    return text + (
        "." if has_all_walls else f"; without walls, which have more than {MOST_WALL_POINTS} points."
    )


# Arrays

ALIGNMENT = 4
"""Arrays begin at multiples of this number of bytes, as typed arrays of JavaScript require."""


class PackedArrays:
    """Arrays one after the other, each content once."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._references: dict[tuple[str, bytes], dict[str, Any]] = {}
        self._size = 0

    def add(self, array: np.ndarray) -> dict[str, Any]:
        """Append an array of unsigned integers; return its type in JavaScript, offset in bytes and length."""
        content = (array.dtype.name, np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes())
        if content not in self._references:
            self._references[content] = {
                "type": f"{array.dtype.name.capitalize()}Array",
                "offset": self._size,
                "length": array.size,
            }
            padded = content[1] + b"\0" * (-len(content[1]) % ALIGNMENT)
            self._parts.append(padded)
            self._size += len(padded)
        return self._references[content]

    def text(self) -> str:
        """All arrays as compressed text."""
        return deflated(b"".join(self._parts))


LARGEST_INTEGER = 65535
"""Largest integer of 16 bits."""


class Grid(NamedTuple):
    """Positions as integers: `low` (3,) [m] is 0, and `step` [m] is 1."""

    low: np.ndarray
    step: float

    def indices(self, points: np.ndarray) -> np.ndarray:
        """Integers (n, 3) of points (n, 3) [m]; points outside the grid are on its border."""
        rounded: np.ndarray = np.clip(np.round((points - self.low) / self.step), 0, LARGEST_INTEGER).astype(
            np.uint16
        )
        return rounded

    def header(self) -> dict[str, Any]:
        """Its numbers for JSON."""
        return {"low": self.low.tolist(), "step": self.step}


# Particles

PER_RADIUS = 64
"""Resolution of positions and radii: this fraction of the smallest radius, if 16 bits suffice."""


def _particle_header(
    frames: Sequence[Frame], particles: Sequence[FrameParticles], scene: Scene | None, arrays: PackedArrays
) -> dict[str, Any]:
    """Grid, radius, extent, quantities and frames of the particles; adds their arrays to `arrays`."""
    radii = np.concatenate([each.radius for each in particles])
    positions = np.concatenate([each.position for each in particles])
    extent = np.array([(positions - radii[:, None]).min(axis=0), (positions + radii[:, None]).max(axis=0)])
    fine = float(radii.min()) / PER_RADIUS
    grid = Grid(
        positions.min(axis=0), max(float(np.ptp(positions, axis=0).max()) / LARGEST_INTEGER, fine) or 1.0
    )
    radius_step = max(float(radii.max()) / LARGEST_INTEGER, fine) or 1.0
    scales = list(_scales(particles, scene))
    gravity = None if scene is None else np.array(scene.usual_gravity)
    entries = [
        {
            "time": f"{frame.time:.4g} s",
            "count": len(each.radius),
            "walls": [],
            "position": arrays.add(grid.indices(each.position)),
            "radius": arrays.add(np.round(each.radius / radius_step).astype(np.uint16)),
            "colors": [arrays.add(_levels(values_of(each.arrays, scale.color), scale)) for scale in scales],
        }
        for frame, each in zip(frames, particles, strict=True)
    ]
    return {
        "grid": grid.header(),
        "radiusStep": radius_step,
        "extent": extent.tolist(),
        "frames": entries,
        "up": upward(gravity).tolist(),
        "toward": view_of("iso", gravity).toward.tolist(),
        "quantities": [_quantity_header(scale) for scale in scales],
    }


MOST_COLORS = 4
"""Maximum number of quantities that can be displayed as colors."""
FIRST_COLORS = (
    *reversed(CATEGORIES),
    "velocity",
    "coordination_number",
    "diameter",
    "angular_velocity",
    "force",
)
"""Quantities in the order of the menu, before the others of the frames."""
NO_COLORS = ("id", "radius", "wall_contact_count", "kinetic_energy")
"""Arrays of a frame that the menu omits."""


def _scales(particles: Sequence[FrameParticles], scene: Scene | None) -> Iterable[Scale]:
    """Color scales of at most MOST_COLORS quantities that differ between particles, over all frames."""
    found = [name for name in particles[-1].arrays if name not in (*NO_COLORS, *FIRST_COLORS)]
    names = {"material": tuple(scene.materials), "group": tuple(scene.particles)} if scene is not None else {}
    chosen = 0
    for name in (*FIRST_COLORS, *found):
        if chosen == MOST_COLORS or not all(name in each.arrays for each in particles):
            continue
        values = [values_of(each.arrays, name) for each in particles]
        together = np.concatenate(values)
        finite = together[np.isfinite(together)]
        if name == "velocity" or (len(finite) and finite.min() < finite.max()):
            chosen += 1
            yield scale_for(name, values, particles[-1].arrays[name].ndim == 2, names)


LARGEST_COLOR = 255
"""Integer of the upper limit of a color scale."""


def _levels(values: np.ndarray, scale: Scale) -> np.ndarray:
    """Integers (n,) of 8 bits: number of a category, or position between the limits.

    A value that is nan is at the lower limit.
    """
    if scale.names is not None:
        levels = values % len(COLORS)
    else:
        low, high = scale.limits
        levels = np.round(
            LARGEST_COLOR * np.clip((np.nan_to_num(values, nan=low) - low) / (high - low), 0.0, 1.0)
        )
    return levels.astype(np.uint8)


UNSIGNED_PALETTE = (
    "#440154",
    "#472d7b",
    "#3b528b",
    "#2c728e",
    "#21918c",
    "#28ae80",
    "#5ec962",
    "#addc30",
    "#fde725",
)
"""Colors of matplotlib's `viridis` at equal distances."""
SIGNED_PALETTE = (
    "#053061",
    "#327cb7",
    "#90c4dd",
    "#e1edf3",
    "#f7f7f7",
    "#fae7dc",
    "#f7b799",
    "#ca4842",
    "#67001f",
)
"""Colors of matplotlib's `RdBu_r` at nearly equal distances."""


def _quantity_header(scale: Scale) -> dict[str, Any]:
    """Title, colors and labels of a color scale."""
    title = scale.title.replace("\n", ", ") + (f" ({scale.unit})" if scale.unit else "")
    if scale.names is not None:
        names = [[name, scale.palette[number % len(COLORS)]] for number, name in scale.names.items()]
        return {"title": title, "palette": scale.palette, "names": names}
    palette = SIGNED_PALETTE if scale.map_name == SIGNED else UNSIGNED_PALETTE
    labels = [f"{limit / scale.factor:.3g}" for limit in scale.limits]
    return {"title": title, "palette": palette, "labels": labels}


# Walls

MOST_WALL_POINTS = 200_000
"""Maximum number of points of the walls in all frames; walls with more are in none."""


def _wear_scales(walls: Sequence[FrameWalls | None]) -> Iterable[Scale]:
    """Color scales of the wear of the walls, from 0 to the largest value of all frames, if it is above 0."""
    for name in WEAR_ARRAYS:
        values = [each.arrays[name] for each in walls if each is not None and name in each.arrays]
        largest = max(
            (float(np.nanmax(part, initial=0.0)) for of_frame in values for part in of_frame), default=0.0
        )
        if largest > 0.0:
            factor, unit = prefixed(WALL_ARRAY_QUANTITIES[name].unit, largest)
            yield Scale(name, name.replace("_", " "), unit, factor, (0.0, largest))


def _add_walls(
    entries: Sequence[dict[str, Any]],
    walls: Sequence[FrameWalls | None],
    particles: Sequence[FrameParticles],
    scene: Scene | None,
    worn: Sequence[Scale],
    arrays: PackedArrays,
) -> bool:
    """Add the walls of each frame to its entry; False if they have too many points for the page.

    `worn`: scales of their colors by wear.
    """
    if sum(len(each.points) for each in walls if each is not None) > MOST_WALL_POINTS:
        return False
    outermost = np.concatenate([outermost_points(each) for each in particles])
    for entry, each in zip(entries, walls, strict=True):
        entry["walls"] = [] if each is None else _wall_headers(each, scene, outermost, arrays, worn)
    return True


def _wall_headers(
    walls: FrameWalls,
    scene: Scene | None,
    outermost: np.ndarray,
    arrays: PackedArrays,
    worn: Sequence[Scale] = (),
) -> list[dict[str, Any]]:
    """Parts of the walls: each unbounded plane, and all others together, with the box (2, 3) [m] that is
    shown."""
    domain = domain_of(scene)
    whole = np.array([[-np.inf] * 3, [np.inf] * 3]) if domain is None else domain
    boxes = drawn_boxes(walls, scene, outermost)
    parts = [(walls.selected([number for number in walls.numbers if number not in boxes]), whole)]
    for number, (low, high) in boxes.items():
        parts.append(
            (walls.selected([number]), np.array([np.maximum(low, whole[0]), np.minimum(high, whole[1])]))
        )
    return [_wall_header(part, box, arrays, worn) for part, box in parts if part.polygons]


def _wall_header(
    walls: FrameWalls, box: np.ndarray, arrays: PackedArrays, worn: Sequence[Scale] = ()
) -> dict[str, Any]:
    """Triangles and edges of walls on their own grid, and the part of the shown box that cuts them (finite
    numbers); with scales of wear, the worn triangles with three points each, and their levels by scale."""
    found = geometry_of(walls)
    low, high = found.points.min(axis=0), found.points.max(axis=0)
    margin = 1e-3 * float(np.max(high - low))
    shown = np.array([np.maximum(box[0], low) - margin, np.minimum(box[1], high) + margin])
    grid = Grid(low.astype(np.float64), float(np.max(high - low)) / LARGEST_INTEGER or 1.0)
    header = {
        "grid": grid.header(),
        "box": shown.tolist(),
        "points": arrays.add(grid.indices(found.points)),
        "triangles": arrays.add(found.triangles.astype(np.uint32)),
        "edges": arrays.add(found.edges.astype(np.uint32)),
    }
    corners, values = _worn_triangles(walls, worn)
    if len(corners):
        header["worn"] = {
            "points": arrays.add(grid.indices(walls.points[corners.ravel()].astype(np.float32))),
            "levels": [
                arrays.add(np.repeat(_levels(each, scale), 3))
                for each, scale in zip(values, worn, strict=True)
            ],
        }
    return header


def _worn_triangles(walls: FrameWalls, worn: Sequence[Scale]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Corners (k, 3) of the triangles with a value of the first scale, and the values (k,) of each scale."""
    corners = np.zeros((0, 3), np.int64)
    values = [np.zeros(0) for _ in worn]
    for number, polygons in enumerate(walls.polygons):
        if worn and polygons.shape[1] == 3:
            has_value = np.isfinite(walls.arrays[worn[0].color][number])
            corners = np.concatenate([corners, polygons[has_value]])
            of_kind = [walls.arrays[scale.color][number][has_value] for scale in worn]
            values = [np.concatenate(both) for both in zip(values, of_kind, strict=True)]
    return corners, values


EDGE_ANGLE = np.radians(25.0)
"""Angle between two facets of a wall above which their edge is drawn [rad]."""


class WallGeometry(NamedTuple):
    """Points (m, 3) [m], triangles (k, 3) and edges (e, 2) as indices of points."""

    points: np.ndarray
    triangles: np.ndarray
    edges: np.ndarray


def geometry_of(walls: FrameWalls) -> WallGeometry:
    """Triangles of all polygons, with equal points merged, and the edges at their borders and sharp bends.

    The walls have at least one polygon.
    """
    corners = np.concatenate([np.zeros(0, np.int64), *(each.ravel() for each in walls.polygons)])
    points, index = np.unique(walls.points[corners].astype(np.float32), axis=0, return_inverse=True)
    ends = np.cumsum([each.size for each in walls.polygons])
    parts = np.split(index.reshape(-1), ends[:-1])
    polygons = [
        _with_area(part.reshape(each.shape)) for part, each in zip(parts, walls.polygons, strict=True)
    ]
    fans = [each[:, [0, k, k + 1]] for each in polygons for k in range(1, each.shape[1] - 1)]
    sides = [each[:, [k, (k + 1) % each.shape[1]]] for each in polygons for k in range(each.shape[1])]
    normals = [_normals(points, each) for each in polygons for _ in range(each.shape[1])]
    return WallGeometry(
        points, np.concatenate(fans), _sharp_edges(np.concatenate(sides), np.concatenate(normals))
    )


def _with_area(polygons: np.ndarray) -> np.ndarray:
    """The polygons (k, n) with at least three different corners.

    A disc without a hole has others at its center.
    """
    found: np.ndarray = polygons[np.array([len(set(each)) > 2 for each in polygons.tolist()], dtype=bool)]
    return found


def _normals(points: np.ndarray, polygons: np.ndarray) -> np.ndarray:
    """Unit normals (k, 3) of polygons (k, n); zero for a polygon without area."""
    corners = points[polygons].astype(np.float64)
    corners -= corners[:, :1]
    normal = np.cross(corners, np.roll(corners, -1, axis=1)).sum(
        axis=1
    )  # twice the area, also with equal corners
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(float).tiny)


def _sharp_edges(sides: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Edges (e, 2) of sides (s, 2) of polygons with their normals (s, 3): borders, and bends above
    EDGE_ANGLE.

    The winding of polygons is arbitrary, so that the sign of a normal does not matter.
    """
    sides = np.sort(sides, axis=1)
    order = np.lexsort((sides[:, 1], sides[:, 0]))
    sides = sides[order]
    normals = normals[order]
    repeats = np.all(sides[1:] == sides[:-1], axis=1)
    is_flat = repeats & (np.abs(np.sum(normals[1:] * normals[:-1], axis=1)) > np.cos(EDGE_ANGLE))
    hidden = np.append(is_flat, False) | np.append(False, is_flat)
    edges: np.ndarray = np.unique(sides[~hidden & (sides[:, 0] != sides[:, 1])], axis=0)
    return edges
