"""Files of the particles of MPI ranks: each rank but the root writes one for each checkpoint.

The checkpoint of the root names them, with their checksums, and is written last: files that no checkpoint
names are ignored, and removed with the next checkpoints.
"""

import re
import secrets
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.parsers.expat import ExpatError
from xml.sax.saxutils import quoteattr

import numpy as np

from granflow.io.archive import damaged, read_file, recorded_checksum, split_arrays, write_file
from granflow.io.files import FormatError, read_regular, write_text
from granflow.io.vtu import MAX_PIECES, VtuMesh, read_vtu, xml_of

# PVTU files: a frame in several VTU files, one for each MPI rank (VTK file formats, PUnstructuredGrid).

SUFFIX = ".pvtu"
PIECE = re.compile(r"[\w-]+\.\d{4,}\.vtu")
"""Names of the files of a frame, such as particles_0003.0001.vtu; they are in the directory of the PVTU
file."""
LARGEST_LISTING = 2**20
"""Largest size of a PVTU file [bytes]."""
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
        described = {
            each: (
                f"{TYPE_NAMES[values.dtype.kind]}{8 * values.dtype.itemsize}",
                values.shape[1] if values.ndim > 1 else 1,
            )
            for each, values in arrays.items()
        }
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
        *(f"<Piece Source={quoteattr(piece.name)}/>" for piece in filled),
        "</PUnstructuredGrid>",
        "</VTKFile>",
        "",
    ]
    write_text(path, "\n".join(text))


def _attributes(name: str, kind: str, components: int) -> str:
    shown = f' NumberOfComponents="{components}"' if components > 1 else ""
    return f' type="{kind}" Name={quoteattr(name)}{shown}'


def pieces_in(path: Path) -> list[Path]:
    """Files of the pieces. Raises FormatError for an invalid file, OSError if it cannot be read."""
    try:
        root: ElementTree.Element = xml_of(read_regular(path, LARGEST_LISTING))
    except ExpatError as error:
        raise FormatError(f"is not XML: {error}") from None
    names = [str(piece.attrib.get("Source")) for piece in root.findall("./PUnstructuredGrid/Piece")]
    if root.attrib.get("type") != "PUnstructuredGrid" or not 1 <= len(names) <= MAX_PIECES:
        raise FormatError("is not a PVTU file with pieces")
    for name in names:
        if not PIECE.fullmatch(name):
            raise FormatError(f"has the unexpected piece {name[:80]}")
    return [path.parent / name for name in names]


def read_pvtu(path: Path, largest: int) -> VtuMesh:
    """Points of all pieces, ordered by id, with the arrays that all pieces have.

    largest:  maximum size [bytes] of all decoded arrays
    Raises:   FormatError for an invalid or missing piece, OSError if the file cannot be read
    """
    meshes = []
    for piece in pieces_in(path):
        try:
            meshes.append(read_vtu(piece, largest))
        except OSError as error:
            raise FormatError(
                f"needs {piece.name}, which cannot be read: {error.strerror or error}"
            ) from None
        except FormatError as error:
            raise FormatError(f"needs {piece.name}, which {error}") from None
        largest -= sum(values.nbytes for values in (meshes[-1].points, *meshes[-1].point_data.values()))
    names = [name for name in meshes[0].point_data if all(name in mesh.point_data for mesh in meshes)]
    points = np.concatenate([mesh.points for mesh in meshes])
    arrays = {name: np.concatenate([mesh.point_data[name] for mesh in meshes]) for name in names}
    if ID not in arrays:
        raise FormatError("has no ids")
    order = np.argsort(arrays[ID], kind="stable")
    return VtuMesh.of_points(points[order], {name: values[order] for name, values in arrays.items()})


PATTERN = "rank_*.npz"
"""Names of the files: rank_STEP_TOKEN_RANK.npz."""
NAME = re.compile(r"rank_(\d{12})_[0-9a-f]{8}_\d{4,}\.npz")
CHECKSUM = re.compile("[0-9a-f]{64}")
ENGINE = "engine/"
"""Start of the key paths of particles and contacts in a checkpoint."""


@dataclass(frozen=True)
class RankFile:
    """A file that a checkpoint names, the checksum that it must have, and its number of particles."""

    path: Path
    checksum: str
    count: int

    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays by key path. Raises DamagedCheckpoint, CheckpointError."""
        return read_file(self.path, self.checksum)[1]


@dataclass(frozen=True)
class RankFileWriter:
    """Writes the files of all ranks for one checkpoint; each rank has a copy.

    `step`: of the checkpoint; `token`: distinguishes the files of two checkpoints of the same step, so that
    no file that an earlier checkpoint names is replaced.
    """

    directory: Path
    step: int
    token: str

    @classmethod
    def of(cls, directory: Path, step: int) -> "RankFileWriter":
        """The writer for a checkpoint in a directory."""
        return cls(Path(directory).absolute(), step, secrets.token_hex(4))

    def write(self, rank: int, count: int, saved: Mapping[str, Any]) -> dict[str, Any]:
        """Write the file of a rank; return its entry in the checkpoint.

        `count`: number of particles; `saved`: "particles" and "contacts" as in `engine.checkpoint`. Raises
        OSError.
        """
        name = f"{self._step_prefix}{self.token}_{rank:04d}.npz"
        arrays = split_arrays(saved, ENGINE)[1]
        return {
            "file": name,
            "checksum": write_file(self.directory / name, {"rank": rank}, arrays),
            "count": count,
        }

    def remove_replaced(self) -> None:
        """Remove the files of an earlier checkpoint of the same step, which this one has replaced."""
        for path in self.directory.glob(f"{self._step_prefix}*.npz"):
            if NAME.fullmatch(path.name) and not path.name.startswith(self._step_prefix + self.token):
                path.unlink(missing_ok=True)

    @property
    def _step_prefix(self) -> str:
        return f"rank_{self.step:012d}_"


def listed_files(directory: Path, entries: Any) -> tuple[RankFile, ...]:
    """The files of the entries that `RankFileWriter.write` returned. Raises FormatError for other values."""
    if not isinstance(entries, list):
        raise FormatError("has no list of the files of ranks")
    found = []
    for entry in entries:
        values = entry if isinstance(entry, dict) else {}
        name = str(values.get("file"))
        checksum = str(values.get("checksum"))
        count = values.get("count")
        is_named = NAME.fullmatch(name) and CHECKSUM.fullmatch(checksum)
        if not (is_named and isinstance(count, int) and 0 <= count < 2**31):
            raise FormatError(f"has the unexpected file of a rank {str(entry)[:80]}")
        found.append(RankFile(directory / name, checksum, count))
    return tuple(found)


def refuse_missing(checkpoint: Path, files: Iterable[RankFile]) -> None:
    """Raise DamagedCheckpoint if a file that a checkpoint names is missing or ends with another checksum."""
    for file in files:
        try:
            if recorded_checksum(file.path) == file.checksum:
                continue
            reason = "is another one or truncated"
        except OSError as error:
            reason = f"cannot be read ({error.strerror or error})"
        raise damaged(checkpoint, f"needs the file {file.path.name} of a rank, which {reason}")


def with_rank_files(arrays: dict[str, np.ndarray], files: Sequence[RankFile]) -> dict[str, np.ndarray]:
    """The arrays of a checkpoint by key path, with those of the ranks behind those of the root.

    Raises DamagedCheckpoint if the files do not have the same arrays.
    """
    if not files:
        return arrays
    names = {name for name in arrays if name.startswith((f"{ENGINE}particles/", f"{ENGINE}contacts/"))}
    parts = []
    for file in files:
        parts.append(file.arrays())
        for name in names.symmetric_difference(parts[-1]):
            raise damaged(file.path, f"has other arrays than its checkpoint: {name[:80]}")
        for name in names:
            own, other = arrays[name], parts[-1][name]
            if own.dtype != other.dtype or own.shape[1:] != other.shape[1:]:
                raise damaged(file.path, f"has an array {other.shape} of {other.dtype} for {name[:80]}")
    return arrays | {name: np.concatenate([arrays[name], *(part[name] for part in parts)]) for name in names}


def remove_unused(directory: Path, steps: Iterable[int]) -> None:
    """Remove the files of all ranks except those of checkpoints of these steps."""
    kept = {*steps}
    for path in directory.glob(PATTERN):
        name = NAME.fullmatch(path.name)
        if name and int(name[1]) not in kept:
            path.unlink(missing_ok=True)
