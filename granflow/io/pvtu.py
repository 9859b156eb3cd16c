"""PVTU files: a frame in several VTU files, one for each MPI rank (VTK file formats, PUnstructuredGrid)."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers.expat import ExpatError
from xml.sax.saxutils import quoteattr

import numpy as np

from granflow.io.atomic_files import write_text
from granflow.io.regular_files import FormatError, read_regular
from granflow.io.vtu import MAX_PIECES, VtuMesh, read_vtu, xml_of

SUFFIX = ".pvtu"

PIECE = re.compile(r"[\w-]+\.\d{4,}\.vtu")
"""Names of the files of a frame, such as particles_0003.0001.vtu; they are in the directory of the PVTU file."""

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
        *("<PPoints>", rows[0], "</PPoints>", "<PPointData>", *rows[1:], "</PPointData>"),
        *(f"<Piece Source={quoteattr(piece.name)}/>" for piece in filled),
        *("</PUnstructuredGrid>", "</VTKFile>", ""),
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
            raise FormatError(f"needs {piece.name}, which cannot be read: {error.strerror or error}") from None
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
