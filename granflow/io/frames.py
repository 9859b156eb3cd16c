"""A series of VTU files and the PVD file that lists them with their times."""

import re
from collections.abc import Callable, Sequence
from functools import partial
from io import FileIO
from pathlib import Path
from xml.sax.saxutils import quoteattr

from granflow.io.atomic_files import named_errors, replacing, sync_all
from granflow.io.background_writer import BackgroundWriter
from granflow.io.pvtu import SUFFIX, Piece, write_pvtu
from granflow.io.vtu import Compression, VtuMesh, write_vtu

HEAD = b'<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n  <Collection>\n'
TAIL = b"  </Collection>\n</VTKFile>\n"
"""Closing tags of a PVD file; each new frame is written in their place."""

WritePieces = Callable[[Path, str], Sequence[Piece]]
"""Lets all MPI ranks write the pieces of a frame, given the directory and the name without suffix."""


class FrameSeries:
    """Writes `STEM_0000.vtu`, `STEM_0001.vtu`, ... and after each frame `STEM.pvd` with the times [s].

    `writer` writes them, at once by default; `compression`: of the arrays. Numbers have at least four digits. The first
    frame deletes frames of an earlier run in the directory: the PVD file lists exactly the files on disk. `frames`:
    (time [s], file name) of each frame.
    """

    def __init__(
        self,
        directory: Path,
        stem: str,
        writer: BackgroundWriter | None = None,
        compression: Compression = "zlib",
    ) -> None:
        self.directory = Path(directory)
        self.directory.mkdir(parents=True, exist_ok=True)  # here, so that no frame creates a deleted directory again
        self.stem, self.compression = stem, compression
        self._writer = writer or BackgroundWriter()
        self.frames: list[tuple[float, str]] = []
        self.frame_count = 0
        self._listing_size = 0
        self._unsynced: list[Path] = []

    def write(self, mesh: VtuMesh, time: float) -> None:
        """Write the mesh, whose arrays must not change, as the next frame, at `time` [s].

        If the disk is full, this or a later call raises OSError; the PVD file then
        lists the earlier frames.
        """
        self._writer.submit(partial(self._write, mesh, time))

    def write_pieces(self, write: WritePieces, time: float) -> None:
        """Let MPI ranks write the next frame, at `time` [s], as one file each and a PVTU file that lists them.

        Waits for the frames before it. Raises OSError; the PVD file then lists the earlier frames.
        """
        self._writer.wait()
        self._writer.guard()
        frame = self._begin()
        pieces = write(self.directory, frame)
        path = self.directory / f"{frame}{SUFFIX}"
        write_pvtu(path, pieces)
        self._end(path, time)
        self._unsynced += [self.directory / piece.name for piece in pieces]

    def _write(self, mesh: VtuMesh, time: float) -> None:
        """Write a frame and list it. Raises OSError."""
        path = self.directory / f"{self._begin()}.vtu"
        write_vtu(path, mesh, self.compression)
        self._end(path, time)

    def _begin(self) -> str:
        """Remove the frames of an earlier run before the first frame; return the name of the next, without suffix."""
        if not self.frame_count:
            self.truncate()
        return f"{self.stem}_{self.frame_count:04d}"

    def _end(self, path: Path, time: float) -> None:
        """List the frame that has been written."""
        self._list((float(time), path.name))
        self.frame_count += 1
        self._unsynced.append(path)

    @property
    def listing(self) -> Path:
        """Path of the PVD file."""
        return self.directory / f"{self.stem}.pvd"

    def _list(self, frame: tuple[float, str]) -> None:
        """Add a frame to the PVD file in place, or rewrite the file if it has changed since the last write."""
        entry = _entry(*frame)
        size = self.listing.lstat().st_size if self.listing.is_file() and not self.listing.is_symlink() else 0
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

    def wait(self) -> None:
        """Wait until all frames are written. Raises OSError."""
        self._writer.wait()

    def sync(self) -> None:
        """Wait for all frames and flush them to the disk; skip files that no longer exist. Raises OSError."""
        self.wait()
        sync_all(self._unsynced)
        self._unsynced = []

    def missing(self) -> list[str]:
        """Return the names of the listed frames whose files no longer exist, in the order of time. Raises OSError."""
        self.wait()
        there = {path.name for path in self.directory.iterdir()} if self.frames else set()
        return [name for _, name in self.frames if name not in there]

    def truncate(self) -> None:
        """Restore the files of the listed frames: list those that exist, then delete all others.

        Raises OSError if a file cannot be deleted.
        """
        own_pattern = re.compile(re.escape(self.stem) + r"_\d{4,}(\.\d{4,}\.vtu|\.p?vtu)")
        there = {path.name for path in self.directory.iterdir() if own_pattern.fullmatch(path.name)}
        self.frames = [frame for frame in self.frames if frame[1] in there]
        if self.frame_count:
            self._write_listing(self.frames)
        else:
            self.listing.unlink(missing_ok=True)
        listed = {name for _, name in self.frames}
        for name in there - listed:
            if f"{name.partition('.')[0]}{SUFFIX}" not in listed:  # pieces of a listed frame remain
                (self.directory / name).unlink()


def _entry(time: float, name: str) -> bytes:
    """Return the line of the PVD file for one frame, UTF-8; the time [s] is written with all digits of its value."""
    return f'    <DataSet timestep="{time!r}" part="0" file={quoteattr(name)}/>\n'.encode()


def _insert_before_tail(path: Path, size: int, entry: bytes) -> None:
    """Overwrite the closing tags of a PVD file of `size` bytes with `entry` and the closing tags, in one write.

    The work per frame does not depend on the number of frames, and the file is complete before and after the write.
    If the disk is full, the previous closing tags are restored.
    """
    start = size - len(TAIL)
    with named_errors(path), FileIO(path, "r+") as file:
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
