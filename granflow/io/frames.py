"""Frames of a run: series of VTU files, and the PVD files that list them with their times.

A run writes the series `particles`, `contacts`, `walls` and one for each coarse-grained field, each with a
`FrameSeries`: `STEM_0000.vtu`, `STEM_0001.vtu`, ... and `STEM.pvd`, which ParaView opens. With
`output.frames_per_rank`, each MPI rank writes its particles into a VTU file (a piece), and a PVTU file lists
the pieces of the frame. The studies and `granflow.read_run` read all of them.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from io import FileIO
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from granflow.errors import GranflowError
from granflow.io.files import (
    BackgroundWriter,
    FormatError,
    named_errors,
    replacing,
    sync_all,
    write_text,
)
from granflow.io.vtu import Compression, VtuMesh, read_vtu, write_vtu

# Writing a series

HEAD = b'<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n  <Collection>\n'
"""Beginning of a PVD file."""
TAIL = b"  </Collection>\n</VTKFile>\n"
"""Closing tags of a PVD file; each new frame is written in their place."""
WritePieces = Callable[[Path, str], Sequence["Piece"]]
"""Lets all MPI ranks write the pieces of a frame, given the directory and the name without suffix."""


class FrameSeries:
    """Writes `STEM_0000.vtu`, `STEM_0001.vtu`, ... and after each frame `STEM.pvd` with the times [s].

    Numbers have at least four digits. The first frame deletes frames of an earlier run in the directory: the
    PVD file lists exactly the files on disk.

    directory:    of the files
    stem:         start of their names
    writer:       writes them; at once by default
    compression:  of the arrays

    `frames`: (time [s], file name) of each frame.
    """

    def __init__(
        self,
        directory: Path,
        stem: str,
        writer: BackgroundWriter | None = None,
        compression: Compression = "zlib",
    ) -> None:
        self.directory = Path(directory)
        # Here, so that no frame creates a deleted directory again.
        self.directory.mkdir(parents=True, exist_ok=True)
        self.stem = stem
        self.compression = compression
        self._writer = writer or BackgroundWriter()
        self.frames: list[tuple[float, str]] = []
        self.frame_count = 0
        self._listing_size = 0
        self._unsynced: list[Path] = []

    @property
    def listing(self) -> Path:
        """Path of the PVD file."""
        return self.directory / f"{self.stem}.pvd"

    def write(self, mesh: VtuMesh, time: float) -> None:
        """Write the mesh, whose arrays must not change, as the next frame, at `time` [s].

        If the disk is full, this or a later call raises OSError; the PVD file then lists the earlier frames.
        """
        self._writer.submit(partial(self._write, mesh, time))

    def write_pieces(self, write: WritePieces, time: float) -> None:
        """Let MPI ranks write the next frame, at `time` [s], as one file each and a PVTU file that lists
        them.

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
        """Remove the frames of an earlier run before the first frame; return the name of the next, without
        suffix."""
        if not self.frame_count:
            self.truncate()
        return f"{self.stem}_{self.frame_count:04d}"

    def _end(self, path: Path, time: float) -> None:
        """List the frame that has been written."""
        self._list((float(time), path.name))
        self.frame_count += 1
        self._unsynced.append(path)

    def _list(self, frame: tuple[float, str]) -> None:
        """Add a frame to the PVD file in place, or rewrite the file if it has changed since the last
        write."""
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
        """Return the names of the listed frames whose files no longer exist, in the order of time. Raises
        OSError."""
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
    """Return the line of the PVD file for one frame, UTF-8; the time [s] is written with all digits of its
    value."""
    return f'    <DataSet timestep="{time!r}" part="0" file="{escape(name)}"/>\n'.encode()


def _insert_before_tail(path: Path, size: int, entry: bytes) -> None:
    """Overwrite the closing tags of a PVD file of `size` bytes with `entry` and the closing tags, in one
    write.

    The work per frame does not depend on the number of frames, and the file is complete before and after the
    write. If the disk is full, the previous closing tags are restored.
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


# Pieces of a frame, one for each MPI rank (VTK file formats, PUnstructuredGrid)

SUFFIX = ".pvtu"
"""Suffix of the file that lists the pieces of a frame."""
TYPE_NAMES = {"f": "Float", "i": "Int", "u": "UInt"}
"""Beginning of the VTK type by the kind of the numpy type; the number of bits follows."""
ID = "id"
"""Array by which the points of all pieces are ordered."""


@dataclass(frozen=True)
class Piece:
    """A file of a frame: its name, number of points, and type and components of the arrays by name.

    The points are the array "Points".
    """

    name: str
    count: int
    arrays: Mapping[str, tuple[str, int]]

    @classmethod
    def of(cls, name: str, mesh: VtuMesh) -> "Piece":
        """The piece of a mesh with arrays of points only."""
        arrays = {"Points": mesh.points, **mesh.point_data}
        described = {}
        for each, values in arrays.items():
            kind = f"{TYPE_NAMES[values.dtype.kind]}{8 * values.dtype.itemsize}"
            described[each] = kind, values.shape[1] if values.ndim > 1 else 1
        return cls(name, len(mesh.points), described)


def piece_path(directory: Path, frame: str, rank: int) -> Path:
    """File of a rank for a frame such as particles_0003."""
    return directory / f"{frame}.{rank:04d}.vtu"


def write_pvtu(path: Path, pieces: Sequence[Piece]) -> None:
    """Write the file that lists the pieces, without empty ones, atomically. Raises OSError."""
    filled = [piece for piece in pieces if piece.count] or pieces[:1]
    rows = [f"<PDataArray{_attributes(name, *kind)}/>" for name, kind in filled[0].arrays.items()]
    text = [
        '<?xml version="1.0"?>',
        '<VTKFile type="PUnstructuredGrid" version="0.1" byte_order="LittleEndian">',
        '<PUnstructuredGrid GhostLevel="0">',
        "<PPoints>",
        rows[0],
        "</PPoints>",
        "<PPointData>",
        *rows[1:],
        "</PPointData>",
        *(f'<Piece Source="{escape(piece.name)}"/>' for piece in filled),
        "</PUnstructuredGrid>",
        "</VTKFile>",
        "",
    ]
    write_text(path, "\n".join(text))


def _attributes(name: str, kind: str, components: int) -> str:
    """XML attributes of an array."""
    shown = f' NumberOfComponents="{components}"' if components > 1 else ""
    return f' type="{kind}" Name="{escape(name)}"{shown}'


def pieces_in(path: Path) -> list[Path]:
    """Files of the pieces. Raises FormatError for an invalid file, OSError if it cannot be read."""
    try:
        root = ElementTree.parse(path)
    except ElementTree.ParseError as error:
        raise FormatError(f"is not XML: {error}") from None
    pieces = [path.parent / str(piece.get("Source")) for piece in root.iter("Piece")]
    if not pieces:
        raise FormatError("is not a PVTU file with pieces")
    return pieces


def read_pvtu(path: Path) -> VtuMesh:
    """Points of all pieces, ordered by id, with the arrays that all pieces have.

    Raises FormatError for an invalid or missing piece, OSError if the file cannot be read.
    """
    meshes = []
    for piece in pieces_in(path):
        try:
            meshes.append(read_vtu(piece))
        except OSError as error:
            raise FormatError(
                f"needs {piece.name}, which cannot be read: {error.strerror or error}"
            ) from None
        except FormatError as error:
            raise FormatError(f"needs {piece.name}, which {error}") from None
    names = [name for name in meshes[0].point_data if all(name in mesh.point_data for mesh in meshes)]
    points = np.concatenate([mesh.points for mesh in meshes])
    arrays = {name: np.concatenate([mesh.point_data[name] for mesh in meshes]) for name in names}
    if ID not in arrays:
        raise FormatError("has no ids")
    order = np.argsort(arrays[ID], kind="stable")
    return VtuMesh.of_points(points[order], {name: values[order] for name, values in arrays.items()})


# Reading the frames of a run

SAME_TIME = 1e-9
"""Relative tolerance of times for frames of particles, walls and contacts that belong together."""
EMPTY = b'NumberOfPoints="0"'
"""Text within the first HEADER_SIZE bytes of an empty VTU file."""
HEADER_SIZE = 1000


def require_directory(directory: Path) -> None:
    """Raise GranflowError if the directory of a run does not exist."""
    if not directory.is_dir():
        raise GranflowError(
            f"{directory}: there is no such directory; give the directory of a run, such as out/hopper."
        )


def listed_frames(directory: Path, stem: str) -> list[tuple[float, Path]]:
    """Times [s] and existing files of a PVD file; empty if it does not exist.

    Raises GranflowError if it is damaged.
    """
    listing = directory / f"{stem}.pvd"
    if not listing.exists():
        return []
    try:
        rows = ElementTree.parse(listing).iter("DataSet")
        found = [(float(row.attrib["timestep"]), directory / row.attrib["file"]) for row in rows]
    except KeyError as error:
        raise _damaged_listing(listing, f"it has an entry without {error}") from None
    except OSError as error:
        raise _damaged_listing(listing, str(error.strerror or error)) from None
    except (ElementTree.ParseError, ValueError) as error:
        raise _damaged_listing(listing, str(error)) from None
    return [(time, path) for time, path in found if path.exists()]


def _damaged_listing(listing: Path, reason: str) -> GranflowError:
    return GranflowError(f"{listing} cannot be read ({reason}); write it again with granflow run or resume.")


def frame_at(series: Sequence[tuple[float, Path]], time: float) -> tuple[float, Path] | None:
    """Time [s] and file of the frame nearest to a time [s]; None if no frame is at that time."""
    near = min(series, key=lambda each: abs(each[0] - time), default=None)
    return near if near and abs(near[0] - time) <= SAME_TIME * max(abs(time), 1.0) else None


def frame_near(series: Sequence[tuple[float, Path]], time: float) -> tuple[float, Path] | None:
    """Time [s] and file of the frame nearest to a time [s], at most half of the distance to its next frame
    away.

    The distance is that to the neighbor on the side of `time`, of the other side for the first and last
    frame; a single frame must be at that time. None if there is none.
    """
    near = min(range(len(series)), key=lambda index: abs(series[index][0] - time), default=None)
    if near is None or len(series) == 1:
        return frame_at(series, time)
    side = near + 1 if time > series[near][0] else near - 1
    other = side if 0 <= side < len(series) else 2 * near - side
    interval = abs(series[other][0] - series[near][0])
    return series[near] if abs(series[near][0] - time) <= 0.5 * interval * (1.0 + SAME_TIME) else None


def file_at(series: Sequence[tuple[float, Path]], time: float) -> Path | None:
    """File of the given time [s] in another series of the same run."""
    found = frame_at(series, time)
    return found[1] if found else None


def is_empty(path: Path) -> bool:
    """Whether a VTU file is empty, or all pieces of a PVTU file. Raises GranflowError if that is damaged."""
    if path.suffix != SUFFIX:
        with path.open("rb") as file:
            return EMPTY in file.read(HEADER_SIZE)
    try:
        pieces = pieces_in(path)
    except (FormatError, OSError) as error:
        raise _unreadable(path, error) from None
    return all(is_empty(piece) for piece in pieces if piece.exists())


def read_mesh(path: Path) -> VtuMesh:
    """Mesh of a VTU or PVTU file, empty for an empty file. Raises GranflowError if it cannot be read."""
    try:
        return read_pvtu(path) if path.suffix == SUFFIX else read_vtu(path)
    except (FormatError, OSError) as error:
        raise _unreadable(path, error) from None


def _unreadable(path: Path, error: Exception) -> GranflowError:
    return GranflowError(f"{path} cannot be read ({error}); remove this frame, or run again.")
