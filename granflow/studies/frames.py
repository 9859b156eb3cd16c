"""Frames of a run as arrays: particles, walls and contacts at each output time, read from VTU files.

`frames_of` lists the frames of a run by the PVD files, which give the times; files that no longer exist are
skipped. `read_particles`, `read_walls` and `read_force_chains` read the parts of one frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from granflow import Scene
from granflow.errors import GranflowError
from granflow.io.frames import file_at, is_empty, listed_frames, read_mesh, require_directory
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


@dataclass(frozen=True)
class FrameWalls:
    """Walls of one frame: `points` (m, 3) [m]; per kind of polygon corners (k, 3 or 4) and wall numbers (k,).

    Corners are indices of points; wall numbers are those of the scene.
    """

    points: np.ndarray
    polygons: tuple[np.ndarray, ...]
    walls: tuple[np.ndarray, ...]

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
        return FrameWalls(self.points, tuple(cells for cells, _ in chosen), tuple(wall for _, wall in chosen))

    def same_as(self, other: "FrameWalls | None") -> bool:
        """Whether both contain the same walls in the same pose."""
        if (
            other is None
            or self.points.shape != other.points.shape
            or len(self.polygons) != len(other.polygons)
        ):
            return False
        mine = (self.points, *self.polygons)
        theirs = (other.points, *other.polygons)
        return all(np.array_equal(a, b) for a, b in zip(mine, theirs, strict=True))

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
    return FrameWalls(
        mesh.points, tuple(cells for cells, _ in blocks), tuple(np.asarray(wall) for _, wall in blocks)
    )


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
