"""Frames of a run as arrays, and the camera that shows them.

`frames_of` lists the frames of a run by the PVD files, which give the times; files that no longer exist are
skipped. `read_particles`, `read_walls` and `read_force_chains` read the parts of one frame from VTU files.

A `View` is a direction of view with its frame right, up, and toward the viewer. `bounding_points` gives the
points that must be visible over the whole run, so that all pictures of a run have the same camera;
`camera_for` places the camera that just shows them.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from granflow import Scene
from granflow.errors import GranflowError
from granflow.io.frames import file_at, is_empty, listed_frames, read_mesh, require_directory
from granflow.scene.blocks.walls.box import FACES
from granflow.units import UnitError, to_si

# The frames of a run, and selections of them


@dataclass(frozen=True)
class Frame:
    """One output time of a run: number in the file names, time [s], and files.

    `walls`, `contacts`: None if the run did not write them at this time.
    """

    number: int
    time: float
    particles: Path
    walls: Path | None = None
    contacts: Path | None = None


def frames_of(directory: Path) -> list[Frame]:
    """Particle frames of a run in order, each with its walls and contacts at the same time.

    Raises GranflowError if the directory does not exist or contains no frames, or if a PVD file cannot be
    read.
    """
    require_directory(directory)
    series = listed_frames(directory, "particles")
    if not series:
        why = "it is not the directory of a run"
        if any((directory / name).exists() for name in ("run.log", "scene_as_run.yaml")):
            why = "the scene writes none (output.particles), or the run ended before the first one"
        raise GranflowError(f"{directory} contains no particle frames (particles.pvd is missing): {why}.")
    walls = listed_frames(directory, "walls")
    contacts = listed_frames(directory, "contacts")
    return [
        Frame(int(path.stem.rpartition("_")[2]), time, path, file_at(walls, time), file_at(contacts, time))
        for time, path in series
    ]


def selected_frames(frames: Sequence[Frame], text: str) -> list[Frame]:
    """Frames selected by last, first, all, a number as in the file names, a time such as 0.4s, or several of
    these.

    Raises GranflowError for other text, and for a number or a time without a frame.
    """
    if text == "all":
        return list(frames)
    return [_one(frames, word.strip()) for word in text.split(",")]


def _one(frames: Sequence[Frame], word: str) -> Frame:
    """Frame for one word of a selection. Raises GranflowError."""
    if word in ("last", "first"):
        return frames[-1 if word == "last" else 0]
    if word.isdecimal():
        found = [frame for frame in frames if str(frame.number) == (word.lstrip("0") or "0")]
        if not found:
            numbers = f"{frames[0].number} to {frames[-1].number}"
            raise GranflowError(
                f"--frame {word}: the run has no such frame; the frames are {numbers}. A time has a unit, "
                f"{word}s."
            )
        return found[0]
    try:
        time = to_si(word, "time")
    except UnitError as error:
        raise GranflowError(
            f"--frame {word}: {error}; or give last, first, all, or the number of a frame."
        ) from None
    return nearest_frame(frames, time, word)


def nearest_frame(frames: Sequence[Frame], time: float, word: str) -> Frame:
    """Frame nearest to a time [s], given as `word`.

    Raises GranflowError for a time before the first frame or after the last by more than half the mean
    interval.
    """
    first, last = frames[0].time, frames[-1].time
    margin = 0.5 * (last - first) / max(len(frames) - 1, 1)
    if not first - margin <= time <= last + margin:
        raise GranflowError(
            f"--frame {word}: the frames are from {first:g} s to {last:g} s; give a time between them."
        )
    return min(frames, key=lambda frame: abs(frame.time - time))


def sampled(frames: Sequence[Frame], count: int) -> list[Frame]:
    """At most `count` evenly spaced frames, including the first and the last one."""
    return [frames[k] for k in np.unique(np.linspace(0, len(frames) - 1, count).astype(int))]


def filled_frames(frames: Sequence[Frame]) -> Sequence[Frame]:
    """Frames with particles; all frames if none has."""
    return [frame for frame in frames if not is_empty(frame.particles)] or frames


# The parts of a frame


@dataclass(frozen=True)
class FrameParticles:
    """Particles of one frame: `position` (n, 3) [m], `radius` (n,) [m], and all arrays of the file by
    name."""

    position: np.ndarray
    radius: np.ndarray
    arrays: dict[str, np.ndarray]

    def selected(self, is_selected: np.ndarray) -> "FrameParticles":
        """The particles with True in `is_selected` (n,)."""
        arrays = {name: values[is_selected] for name, values in self.arrays.items()}
        return FrameParticles(self.position[is_selected], self.radius[is_selected], arrays)


def read_particles(frame: Frame) -> FrameParticles:
    """Particles of a frame; positions are float64. Raises GranflowError if the file cannot be read."""
    mesh = read_mesh(frame.particles)
    arrays = {name: np.asarray(values) for name, values in mesh.point_data.items()}
    radius = arrays.get("radius", np.zeros(len(mesh.points)))
    return FrameParticles(mesh.points.astype(np.float64), radius, arrays)


COLORS_OF_WALLS = "color"
"""Array of the colors (k, 3) of polygons, 0 to 255, which pictures add to those of the file."""


@dataclass(frozen=True)
class FrameWalls:
    """Walls of one frame: `points` (m, 3) [m]; per kind of polygon corners (k, 3 or 4) and wall numbers (k,).

    Corners are indices of points; wall numbers are those of the scene. `arrays`: per array of the file and
    kind of polygon, its values (k,) or (k, 3), NaN for walls without it.
    """

    points: np.ndarray
    polygons: tuple[np.ndarray, ...]
    walls: tuple[np.ndarray, ...]
    arrays: Mapping[str, tuple[np.ndarray, ...]] = field(default_factory=dict)

    @property
    def numbers(self) -> list[int]:
        """Numbers of all walls, in ascending order."""
        return sorted({int(number) for each in self.walls for number in np.unique(each)})

    def selected(self, walls: Sequence[int]) -> "FrameWalls":
        """The walls with the given numbers, with all points."""
        parts = [
            (cells, wall, np.isin(wall, walls)) for cells, wall in zip(self.polygons, self.walls, strict=True)
        ]
        chosen = [
            (cells[is_chosen], wall[is_chosen]) for cells, wall, is_chosen in parts if np.any(is_chosen)
        ]
        arrays = {
            name: tuple(
                each[is_chosen]
                for each, (*_, is_chosen) in zip(values, parts, strict=True)
                if np.any(is_chosen)
            )
            for name, values in self.arrays.items()
        }
        return FrameWalls(
            self.points, tuple(cells for cells, _ in chosen), tuple(wall for _, wall in chosen), arrays
        )

    def same_as(self, other: "FrameWalls | None") -> bool:
        """Whether both contain the same walls in the same pose and with the same colors."""
        if (
            other is None
            or self.points.shape != other.points.shape
            or len(self.polygons) != len(other.polygons)
        ):
            return False
        mine = (self.points, *self.polygons, *self.arrays.get(COLORS_OF_WALLS, ()))
        theirs = (other.points, *other.polygons, *other.arrays.get(COLORS_OF_WALLS, ()))
        return len(mine) == len(theirs) and all(map(np.array_equal, mine, theirs))

    def points_of(self, walls: Sequence[int]) -> np.ndarray:
        """Corners (m, 3) [m] of the walls with the given numbers."""
        corners = [cells[np.isin(wall, walls)] for cells, wall in zip(self.polygons, self.walls, strict=True)]
        return self.points[
            np.unique(np.concatenate([np.zeros(0, np.int64), *(cells.ravel() for cells in corners)]))
        ]


def read_walls(frame: Frame) -> FrameWalls | None:
    """Walls of a frame; None if it has no wall file. Raises GranflowError if the file cannot be read."""
    if frame.walls is None:
        return None
    mesh = read_mesh(frame.walls)
    numbers = mesh.cell_data.get("wall", [np.zeros(len(block.data), np.int32) for block in mesh.cells])
    blocks = [(block.data, wall) for block, wall in zip(mesh.cells, numbers, strict=True) if len(block.data)]
    arrays = {
        name: tuple(np.asarray(values, float) for values in blocks_of_array if len(values))
        for name, blocks_of_array in mesh.cell_data.items()
        if name != "wall"
    }
    walls = tuple(np.asarray(wall) for _, wall in blocks)
    return FrameWalls(mesh.points, tuple(cells for cells, _ in blocks), walls, arrays)


def planes_of(walls: FrameWalls, scene: Scene | None) -> list[int]:
    """Numbers of the shown walls that are unbounded planes."""
    kinds = [getattr(wall, "shape", "") for wall in scene.walls.values()] if scene is not None else []
    return [number for number in walls.numbers if number < len(kinds) and kinds[number] == "plane"]


@dataclass(frozen=True)
class ForceChains:
    """Contacts of one frame: `ends` (k, 2, 3) [m] and `normal_force` (k,) [N]."""

    ends: np.ndarray
    normal_force: np.ndarray


def read_force_chains(frame: Frame) -> ForceChains | None:
    """Contacts of a frame; None if it has no contact file.

    Raises GranflowError if the file cannot be read.
    """
    if frame.contacts is None:
        return None
    mesh = read_mesh(frame.contacts)
    lines = [block.data for block in mesh.cells if block.type == "line"]
    ends = mesh.points[np.concatenate([np.zeros((0, 2), np.int64), *lines])]
    forces = mesh.cell_data.get("normal_force", [])
    return ForceChains(ends, np.concatenate([np.zeros(0), *forces])[: len(ends)])


# View directions

VIEWS = ("iso", "front", "side", "top")
"""Names of views."""
ISO = (0.6, -1.0, 0.45)
"""Direction toward the viewer of the view `iso`, in the axes right, into and up."""


@dataclass(frozen=True)
class View:
    """View of a picture: perpendicular unit vectors `toward` the viewer and `up` (3,), perspective or
    parallel.

    The vectors `right`, `up` and `toward` form a right-handed frame.
    """

    toward: np.ndarray
    up: np.ndarray
    perspective: bool

    @property
    def right(self) -> np.ndarray:
        """Unit vector (3,) to the right in the picture."""
        return np.cross(self.up, self.toward)

    def projected(self, points: np.ndarray) -> np.ndarray:
        """Coordinates (n, 3) [m] of points to the right, up and toward the viewer."""
        return points @ np.stack([self.right, self.up, self.toward], axis=1)


def view_of(text: str, gravity: np.ndarray | None = None) -> View:
    """View by name: iso, front, side, top, or the direction to the viewer as three numbers "1,-2,0.8".

    Up is the axis opposite to `gravity` (z without gravity); front, side and top are parallel projections,
    the others perspective. Raises GranflowError for another text.
    """
    up = upward(gravity)
    right = np.array([0.0, 1.0, 0.0]) if up[0] else np.array([1.0, 0.0, 0.0])
    into = np.cross(up, right)
    flat = {"front": (-into, up), "side": (right, up), "top": (up, into)}
    if text in flat:
        toward, top = flat[text]
        return View(toward, top, perspective=False)
    if text == "iso":
        toward = ISO[0] * right + ISO[1] * into + ISO[2] * up
    else:
        toward = _direction(text)
    return _upright(toward, up, into)


def upward(gravity: np.ndarray | None) -> np.ndarray:
    """Unit vector (3,) along the axis that is most nearly opposite to gravity."""
    up = np.zeros(3)
    if gravity is None or not np.any(gravity):
        up[2] = 1.0
    else:
        axis = int(np.argmax(np.abs(gravity)))
        up[axis] = -np.sign(gravity[axis])
    return up


def _direction(text: str) -> np.ndarray:
    """Direction (3,) from text with three numbers. Raises GranflowError for other text."""
    try:
        numbers = np.array([float(word) for word in text.split(",")])
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) != 3 or not np.all(np.isfinite(numbers)) or not np.any(numbers):
        raise GranflowError(
            f"--view {text}: give {', '.join(VIEWS)}, or the direction to the viewer, such as "
            "--view=1,-2,0.8."
        )
    return numbers / np.abs(numbers).max()  # the squares of numbers such as 1e300 and 1e-300 are out of range


def _upright(toward: np.ndarray, up: np.ndarray, into: np.ndarray) -> View:
    """Perspective view from `toward` with `up` vertical in the picture.

    For a view along `up`, `into` is vertical.
    """
    toward = toward / np.linalg.norm(toward)
    axis = up if abs(toward @ up) < np.cos(np.radians(1.0)) else into
    upright = axis - (axis @ toward) * toward
    return View(toward, upright / np.linalg.norm(upright), perspective=True)


# Camera

OPENING = np.radians(24.0)
"""Vertical field of view of a perspective picture; small, so that near and far particles have similar
sizes."""
MARGIN = 1.05
"""Relative margin around the shown points."""
CENTERINGS = 6
"""Iterations that center a perspective picture; each reduces the error to a tenth."""


@dataclass(frozen=True)
class Camera:
    """Camera: `eye` and `focus` (3,) [m]; `half_height` [m] of the picture for parallel projection.

    The vertical field of view of a perspective picture is OPENING.
    """

    view: View
    eye: np.ndarray
    focus: np.ndarray
    half_height: float

    @property
    def shown_height(self) -> float:
        """Height [m] of the shown part of the plane through the focus."""
        if not self.view.perspective:
            return 2.0 * self.half_height
        return 2.0 * float(np.linalg.norm(self.eye - self.focus) * np.tan(0.5 * OPENING))


def camera_for(view: View, points: np.ndarray, aspect: float, zoom: float = 1.0) -> Camera:
    """Camera that just shows the points (n, 3) [m] in a picture with this ratio of width to height.

    `zoom`: magnification; above 1, outer points are outside the picture.
    """
    seen = view.projected(points)
    low, high = seen.min(axis=0), seen.max(axis=0)
    middle = 0.5 * (low + high)
    size = np.maximum(high - low, 1e-12)
    half_height = 0.5 * MARGIN * max(size[1], size[0] / aspect) / zoom
    tangent = np.tan(0.5 * OPENING) * np.array([aspect, 1.0]) / MARGIN
    distance = half_height / tangent[1] + size[2]
    for _ in range(CENTERINGS if view.perspective else 0):
        distance = _camera_distance(seen - middle, tangent) / zoom
        middle[:2] += _off_center(seen - middle, distance)
    focus = middle @ np.stack([view.right, view.up, view.toward])
    return Camera(view, focus + distance * view.toward, focus, half_height)


def _camera_distance(seen: np.ndarray, tangent: np.ndarray) -> float:
    """Smallest distance [m] of the eye from the origin at which all points are in the field of view.

    `seen` (n, 3) [m]: points in the frame of the view; `tangent` (2,): of half the field of view.
    """
    return float(np.max(seen[:, 2:] + np.abs(seen[:, :2]) / tangent))


def _off_center(seen: np.ndarray, distance: float) -> np.ndarray:
    """Offset (2,) [m] of the middle of the shown points from the center of the picture, in the plane of the
    focus."""
    depth = np.maximum(distance - seen[:, 2:], 1e-3 * distance)
    shown = seen[:, :2] / depth
    return 0.5 * (shown.min(axis=0) + shown.max(axis=0)) * distance


def aspect_of(view: View, points: np.ndarray) -> float:
    """Ratio of width to height of points (n, 3) [m] in a view."""
    width, height, _ = np.ptp(view.projected(points), axis=0)
    return float(width / height) if width > 0.0 and height > 0.0 else 1.0


# Points that must be visible: the outermost points of particles and walls, or the domain

SAMPLED_FRAMES = 12
"""Number of frames of the whole run that determine the camera, so that all pictures of a run have the same
camera."""
EMPTY_BOX = np.array([[-0.5] * 3, [0.5] * 3])
"""Box (2, 3) [m] shown if there are neither particles nor a scene."""


def bounding_points(
    fit: str, scene: Scene | None, frames: Sequence[Frame], domain: np.ndarray | None, particles: np.ndarray
) -> np.ndarray:
    """Points (n, 3) [m] that the camera must show: the domain, or the outermost points of particles and
    walls.

    `fit`: "all", "particles" or "domain"; `domain` (2, 3) [m], or None; `particles` (k, 3) [m]: see
    `particle_points`. At most SAMPLED_FRAMES frames are read. Never empty.
    """
    if fit == "domain" and domain is not None:
        return corners_of(domain)
    points = particles
    if fit != "particles":
        walls = [each for each in map(read_walls, sampled(frames, SAMPLED_FRAMES)) if each is not None]
        points = np.concatenate([points, *(wall_points(each, scene, points, domain) for each in walls)])
    if len(points):
        return points
    return corners_of(domain if domain is not None else EMPTY_BOX)


def domain_of(scene: Scene | None) -> np.ndarray | None:
    """Domain (2, 3) [m] of the simulation; None if it expands or if the scene is unknown."""
    if scene is None or scene.domain.on_exit == "expand":
        return None
    return np.array([scene.domain.min, scene.domain.max])


def particle_points(frames: Sequence[Frame]) -> np.ndarray:
    """Outermost points (n, 3) [m] of the particles of at most SAMPLED_FRAMES frames.

    The array is empty without particles.
    """
    return np.concatenate(
        [outermost_points(read_particles(frame)) for frame in sampled(frames, SAMPLED_FRAMES)]
    )


def outermost_points(particles: FrameParticles) -> np.ndarray:
    """Points (n, 3) [m] on the surface of the bed: the farthest point in each of a set of directions."""
    if not len(particles.radius):
        return np.zeros((0, 3))
    directions = np.array([ray for ray in np.ndindex(3, 3, 3) if ray != (1, 1, 1)]) - 1.0
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    farthest = np.argmax(particles.position @ directions.T + particles.radius[:, None], axis=0)
    return particles.position[farthest] + particles.radius[farthest, None] * directions


def wall_points(
    walls: FrameWalls, scene: Scene | None, particles: np.ndarray, domain: np.ndarray | None
) -> np.ndarray:
    """Corners (n, 3) [m] of the walls, clipped to the domain; unbounded planes are clipped to the particles.

    `particles` (k, 3) [m]: outermost points of the particles; `domain` (2, 3) [m], or None.
    """
    planes = planes_of(walls, scene)
    corners = [walls.points_of([number for number in walls.numbers if number not in planes])]
    for number in planes:
        plane = walls.points_of([number])
        box = _up_to_box(plane_box(plane, particles), number, planes, walls, scene)
        corners.append(np.clip(plane, *box))
    points = np.concatenate(corners)
    return points if domain is None else np.clip(points, *domain)


PLANE_MARGIN = 0.5
"""Largest distance of a shown plane from the particles, relative to their largest extent."""
PLANE_OVERHANG = 0.05
"""Overhang of the shown part of a plane over the particles, relative to their largest extent."""
FLAT = 1e-6
"""Extent of a plane along its normal, relative to its size, up to which it is normal to an axis."""


def plane_box(plane: np.ndarray, particles: np.ndarray) -> np.ndarray:
    """Box (2, 3) [m] of the shown part of a plane: around the particles, wider along the normal of the plane.

    `plane` (m, 3) [m]: its corners in the frame; `particles` (k, 3) [m]: outermost points of the particles.
    All of the plane without particles.
    """
    if not len(particles) or not len(plane):
        return np.array([[-np.inf] * 3, [np.inf] * 3])
    low, high = particles.min(axis=0), particles.max(axis=0)
    extent = np.ptp(plane, axis=0)
    margin = np.where(extent > FLAT * extent.max(), PLANE_OVERHANG, PLANE_MARGIN) * np.max(high - low)
    return np.array([low - margin, high + margin])


def drawn_boxes(walls: FrameWalls, scene: Scene | None, particles: np.ndarray) -> dict[int, np.ndarray]:
    """Boxes (2, 3) [m] to which the drawings of the unbounded planes are clipped, by number.

    They are those of `plane_box`, unbounded along the normal; a face of a box extends to its other faces.
    """
    found = {}
    planes = planes_of(walls, scene)
    for number in planes:
        plane = walls.points_of([number])
        low, high = plane_box(plane, particles)
        extent = np.ptp(plane, axis=0)
        is_normal = extent <= FLAT * extent.max()
        box = np.array([np.where(is_normal, -np.inf, low), np.where(is_normal, np.inf, high)])
        found[number] = _up_to_box(box, number, planes, walls, scene)
    return found


def _up_to_box(
    box: np.ndarray, number: int, planes: Collection[int], walls: FrameWalls, scene: Scene | None
) -> np.ndarray:
    """A box (2, 3) [m] around the plane `number`; if the plane is a face of a box, up to those other faces of
    that box which are normal to an axis. `planes`: of `planes_of`."""
    found = box.copy()
    names = list(scene.walls) if scene is not None else []
    own, _, own_face = names[number].rpartition(".")
    for other in planes:
        name, _, face = names[other].rpartition(".")
        if own and name == own and {face, own_face} <= set(FACES):
            axis, is_high = divmod(FACES.index(face), 2)
            points = walls.points_of([other])
            if np.isfinite(found[is_high, axis]) and np.ptp(points[:, axis]) <= FLAT * np.ptp(points):
                found[is_high, axis] = points[0, axis]
    return found


def corners_of(box: np.ndarray) -> np.ndarray:
    """Corners (8, 3) of a box (2, 3)."""
    return np.array([[box[i][0], box[j][1], box[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
