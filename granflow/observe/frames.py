"""A series of VTU files and the PVD file that lists them with their times."""

import re
from contextlib import suppress
from io import FileIO
from pathlib import Path
from xml.sax.saxutils import quoteattr

import meshio
import numpy as np

from granflow.observe.files import replacing, sync

HEAD = b'<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n  <Collection>\n'
TAIL = b"  </Collection>\n</VTKFile>\n"


class FrameSeries:
    """Writes `STEM_0000.vtu`, `STEM_0001.vtu`, ... and after each frame `STEM.pvd` with the times [s].

    Frames of an earlier run that still lie in the directory go when the first frame is written, so that the
    files on disk and those in the PVD file are the same.
    """

    def __init__(self, directory: Path, stem: str) -> None:
        self.directory = Path(directory)
        self.stem = stem
        self.frames: list[tuple[float, str]] = []
        self.frame_count = 0
        self._listing_size = 0
        self._unsynced: list[Path] = []

    def write(self, mesh: meshio.Mesh, time: float) -> Path:
        """Write the mesh as the next frame, at `time` [s]; return its path."""
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
        """The PVD file."""
        return self.directory / f"{self.stem}.pvd"

    def _list(self, frame: tuple[float, str]) -> None:
        """Add a frame to the PVD file in place; write all of it where it is not the file that was written last."""
        entry = _entry(*frame)
        size = self.listing.stat().st_size if self.listing.exists() else 0
        if size and size == self._listing_size:
            _insert_before_tail(self.listing, size, entry)
            self._listing_size += len(entry)
        else:
            self._write_listing([*self.frames, frame])
        self.frames.append(frame)

    def _write_listing(self, frames: list[tuple[float, str]]) -> None:
        listing = HEAD + b"".join(_entry(*frame) for frame in frames) + TAIL
        with replacing(self.listing) as temporary:
            temporary.write_bytes(listing)
        self._listing_size = len(listing)

    def sync(self) -> None:
        """Have all frames on the disk; those that somebody has taken away are left out."""
        for path in self._unsynced:
            with suppress(FileNotFoundError):
                sync(path)
        self._unsynced = []

    def truncate(self) -> None:
        """Make the files those of the frames written so far: list those that exist, then remove all others."""
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
    """Write the mesh to a VTU file, binary and zlib-compressed, whole or not at all."""
    # meshio's header for an empty compressed array announces a block that is not there; uncompressed is
    # valid.
    compression = "zlib" if len(mesh.points) else None
    with replacing(path) as temporary:
        meshio.write(temporary, mesh, file_format="vtu", binary=True, compression=compression)


def mesh_of_points(points: np.ndarray, point_data: dict[str, np.ndarray]) -> meshio.Mesh:
    """Mesh of one vertex cell per point (n, 3): without cells ParaView shows nothing but glyphs."""
    vertices = np.arange(len(points), dtype=np.int64).reshape(-1, 1)
    return meshio.Mesh(points, [("vertex", vertices)], point_data=point_data)


def mesh_of_cells(kind: str, points: np.ndarray, cells: np.ndarray, cell_data: dict[str, np.ndarray]) -> meshio.Mesh:
    """Mesh of cells of one kind, "line" (k, 2) or "triangle" (k, 3), over points (n, 3)."""
    per_block = {name: [values] for name, values in cell_data.items()}
    return meshio.Mesh(points, [(kind, cells.astype(np.int64))], cell_data=per_block)


def _entry(time: float, name: str) -> bytes:
    return f'    <DataSet timestep="{time!r}" part="0" file={quoteattr(name)}/>\n'.encode()


def _insert_before_tail(path: Path, size: int, entry: bytes) -> None:
    """Overwrite the closing tags of a PVD file of `size` bytes with `entry` and the closing tags, in one write.

    The work per frame does not depend on the number of frames, and the file is complete before and after the write.
    If the disk is full, the file gets its old closing tags back.
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
    """Write all of `data` from `offset`; the system may take part of it at a time."""
    file.seek(offset)
    while data:
        data = data[file.write(data) :]
