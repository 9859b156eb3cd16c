"""A series of VTU files and the PVD file that lists them with their times."""

import re
from contextlib import suppress
from io import FileIO
from pathlib import Path
from xml.sax.saxutils import quoteattr

import meshio
import numpy as np

from granflow.io.atomic_files import replacing, sync

HEAD = b'<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n  <Collection>\n'
TAIL = b"  </Collection>\n</VTKFile>\n"
"""Closing tags of a PVD file; each new frame is written in their place."""


class FrameSeries:
    """Writes `STEM_0000.vtu`, `STEM_0001.vtu`, ... and after each frame `STEM.pvd` with the times [s].

    Numbers have at least four digits. The first frame deletes frames of an earlier run in the directory: the PVD file
    lists exactly the files on disk. `frames`: (time [s], file name) of each frame.
    """

    def __init__(self, directory: Path, stem: str) -> None:
        self.directory = Path(directory)
        self.stem = stem
        self.frames: list[tuple[float, str]] = []
        self.frame_count = 0
        self._listing_size = 0
        self._unsynced: list[Path] = []

    def write(self, mesh: meshio.Mesh, time: float) -> Path:
        """Write the mesh as the next frame, at `time` [s]. Return its path.

        Creates the directory if necessary. Raises OSError if the disk is full; the PVD file then lists the earlier
        frames.
        """
        if not self.frame_count:
            self.directory.mkdir(parents=True, exist_ok=True)
            self.truncate()
        path = self.directory / f"{self.stem}_{self.frame_count:04d}.vtu"
        write_vtu(path, mesh)
        self._list((float(time), path.name))
        self.frame_count += 1
        self._unsynced.append(path)
        return path

    @property
    def listing(self) -> Path:
        """Path of the PVD file."""
        return self.directory / f"{self.stem}.pvd"

    def _list(self, frame: tuple[float, str]) -> None:
        """Add a frame to the PVD file in place, or rewrite the file if it has changed since the last write."""
        entry = _entry(*frame)
        size = self.listing.stat().st_size if self.listing.exists() else 0
        if size and size == self._listing_size:
            _insert_before_tail(self.listing, size, entry)
            self._listing_size += len(entry)
        else:
            self._write_listing([*self.frames, frame])
        self.frames.append(frame)

    def _write_listing(self, frames: list[tuple[float, str]]) -> None:
        """Write the PVD file with these frames atomically."""
        listing = HEAD + b"".join(_entry(*frame) for frame in frames) + TAIL
        with replacing(self.listing) as temporary:
            temporary.write_bytes(listing)
        self._listing_size = len(listing)

    def sync(self) -> None:
        """Flush all frames to the disk; skip files that no longer exist."""
        for path in self._unsynced:
            with suppress(FileNotFoundError):
                sync(path)
        self._unsynced = []

    def truncate(self) -> None:
        """Restore the files of the listed frames: list those that exist, then delete all others.

        Raises OSError if a file cannot be deleted.
        """
        own_pattern = re.compile(re.escape(self.stem) + r"_\d{4,}\.vtu")
        there = {path.name for path in self.directory.iterdir() if own_pattern.fullmatch(path.name)}
        self.frames = [frame for frame in self.frames if frame[1] in there]
        if self.frame_count:
            self._write_listing(self.frames)
        else:
            self.listing.unlink(missing_ok=True)
        for name in there.difference(name for _, name in self.frames):
            (self.directory / name).unlink()


def write_vtu(path: Path, mesh: meshio.Mesh) -> None:
    """Write the mesh to a VTU file, binary and zlib-compressed, atomically.

    A mesh without cells gets one polygon without corners, with zero data: meshio cannot read files without cells.
    """
    mesh = mesh if any(len(block.data) for block in mesh.cells) else _with_empty_polygon(mesh)
    # For an empty compressed array, the header that meshio writes declares a block that does not exist.
    compression = "zlib" if len(mesh.points) else None
    with replacing(path) as temporary:
        meshio.write(temporary, mesh, file_format="vtu", binary=True, compression=compression)


def _with_empty_polygon(mesh: meshio.Mesh) -> meshio.Mesh:
    """A mesh without cells, with a polygon that has no corners; its data are 0."""
    data = {
        name: [np.zeros((1, *np.shape(parts[0])[1:]), np.asarray(parts[0]).dtype)]
        for name, parts in mesh.cell_data.items()
    }
    empty = [("polygon", np.zeros((1, 0), np.int64))]
    return meshio.Mesh(mesh.points, empty, point_data=mesh.point_data, cell_data=data)


def mesh_of_points(points: np.ndarray, point_data: dict[str, np.ndarray]) -> meshio.Mesh:
    """Return a mesh with one vertex cell per point (n, 3) [m]; without cells, ParaView shows glyphs only.

    `point_data`: name -> array (n,) or (n, k).
    """
    vertices = np.arange(len(points), dtype=np.int64).reshape(-1, 1)
    return meshio.Mesh(points, [("vertex", vertices)], point_data=point_data)


def mesh_of_cells(kind: str, points: np.ndarray, cells: np.ndarray, cell_data: dict[str, np.ndarray]) -> meshio.Mesh:
    """Return a mesh of cells of one kind, such as "line" (k, 2) or "triangle" (k, 3), with points (n, 3) [m].

    `cells`: indices of points, converted to int64; `cell_data`: name -> array (k,) or (k, components).
    """
    per_block = {name: [values] for name, values in cell_data.items()}
    return meshio.Mesh(points, [(kind, cells.astype(np.int64))], cell_data=per_block)


def _entry(time: float, name: str) -> bytes:
    """Return the line of the PVD file for one frame, UTF-8; the time [s] is written with all digits of its value."""
    return f'    <DataSet timestep="{time!r}" part="0" file={quoteattr(name)}/>\n'.encode()


def _insert_before_tail(path: Path, size: int, entry: bytes) -> None:
    """Overwrite the closing tags of a PVD file of `size` bytes with `entry` and the closing tags, in one write.

    The work per frame does not depend on the number of frames, and the file is complete before and after the write.
    If the disk is full, the previous closing tags are restored.
    """
    start = size - len(TAIL)
    with FileIO(path, "r+") as file:
        try:
            _write_at(file, start, entry + TAIL)
        except OSError:
            _write_at(file, start, TAIL)
            file.truncate(size)
            raise


def _write_at(file: FileIO, offset: int, data: bytes) -> None:
    """Write all of `data` at `offset`; one system call may write only part of it."""
    file.seek(offset)
    while data:
        data = data[file.write(data) :]
