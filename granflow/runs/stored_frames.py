"""Frames of a run in its directory: lazy sequences of arrays, read from the VTU files at each access."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Generic, TypeVar, overload

import numpy as np

from granflow.fields import CONTACT_QUANTITIES
from granflow.io.frame_reader import frame_near, is_empty, listed_frames, read_mesh
from granflow.io.vtu import VtuMesh

T = TypeVar("T")


class Frames(Sequence[T], Generic[T]):
    """Frames of one kind, in order of time; `times`: (frames,) [s]. A frame is read at each access.

    An index is an int or a slice; `at` finds a frame by its time. Raises GranflowError for a file that cannot be read.

    >>> import granflow as gf
    >>> frames = gf.read_run("out/two").frames
    >>> len(frames), frames.times.round(3)[-1].item()
    (101, 0.02)
    >>> frames[-1].particles["velocity"].shape
    (2, 3)
    """

    def __init__(self, files: Sequence[tuple[float, Path]], read: Callable[[float, Path], T]) -> None:
        self._files, self._read = tuple(files), read

    @property
    def times(self) -> np.ndarray:
        """Simulated times of the frames (frames,) [s]."""
        return np.array([time for time, _ in self._files])

    @property
    def paths(self) -> tuple[Path, ...]:
        """VTU files of the frames."""
        return tuple(path for _, path in self._files)

    def __len__(self) -> int:
        return len(self._files)

    @overload
    def __getitem__(self, index: int) -> T: ...
    @overload
    def __getitem__(self, index: slice) -> "Frames[T]": ...
    def __getitem__(self, index: int | slice) -> "T | Frames[T]":
        if isinstance(index, slice):
            return Frames(self._files[index], self._read)
        return self._read(*self._files[index])

    def __iter__(self) -> Iterator[T]:
        return (self._read(*file) for file in self._files)

    def at(self, time: float) -> T | None:
        """The frame nearest to `time` [s], at most half of the interval between frames away; None if there is none.

        Frames are written at the first step after a multiple of the output interval, such as 0.5000033 s.
        """
        found = frame_near(self._files, time)
        return self._read(*found) if found else None

    def __repr__(self) -> str:
        """Number of frames and range of times."""
        span = f" from {self._files[0][0]:.4g} to {self._files[-1][0]:.4g} s" if self._files else ""
        return f"<Frames: {len(self)}{span}>"


def filled_frames(directory: Path, stem: str) -> list[tuple[float, Path]]:
    """Time [s] and file of each frame of a series, without frames that contain nothing."""
    return [(time, path) for time, path in listed_frames(directory, stem) if not is_empty(path)]


def particle_arrays(mesh: VtuMesh) -> dict[str, np.ndarray]:
    """Arrays of the particles by name (n,) or (n, k), in SI units, with `position` (n, 3) [m] in float64."""
    arrays = {name: np.asarray(values) for name, values in mesh.point_data.items()}
    return arrays | {"position": mesh.points.astype(np.float64)}


def contact_arrays(mesh: VtuMesh) -> dict[str, np.ndarray]:
    """Arrays of the contacts by name (c,) or (c, 3): CONTACT_QUANTITIES and history fields, in SI units."""
    lines = np.concatenate([np.zeros((0, 2), np.int64), *(b.data for b in mesh.cells if b.type == "line")])
    empty: dict[str, np.ndarray] = {
        "wall": np.zeros(0, np.int32), "force": np.zeros((0, 3)), "sliding": np.zeros(0, np.uint8)
    }  # fmt: skip
    found = {name: np.concatenate(parts) for name, parts in mesh.cell_data.items() if parts}
    arrays = empty | found | {"position_i": mesh.points[lines[:, 0]], "position_j": mesh.points[lines[:, 1]]}
    return {name: arrays[name] for name in (*CONTACT_QUANTITIES, *arrays) if name in arrays}


def cell_arrays(mesh: VtuMesh) -> dict[str, np.ndarray]:
    """Fields on a grid by name (cells,) or (cells, k), in SI units, with the `position` of the cells (cells, 3) [m]."""
    corners = [mesh.points[block.data].mean(axis=1) for block in mesh.cells]
    arrays = {name: np.concatenate(parts) for name, parts in mesh.cell_data.items()}
    return arrays | {"position": np.concatenate([np.zeros((0, 3)), *corners])}


def array_frames(
    directory: Path, stem: str, arrays_of: Callable[[VtuMesh], dict[str, np.ndarray]]
) -> Frames[Mapping[str, np.ndarray]]:
    """Frames `STEM_NNNN.vtu` of a run; each is a mapping from names to arrays. Empty without such files."""
    return Frames(listed_frames(directory, stem), lambda time, path: arrays_of(read_mesh(path)))
