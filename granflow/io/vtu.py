"""VTU files (VTK file formats, UnstructuredGrid), written and read by meshio.

`VtuMesh` is what a file contains. meshio is imported with the first file: its import takes 60 ms. Four things
are done around its calls, which meshio 5.3.5 does not do: special characters of names are escaped; units are
added as field data; a frame without cells gets a cell that meshio can read; and before a file is read, its
XML is checked, because meshio expands entities and compressed data without limits, and drops cells and arrays
that it does not know.
"""

import base64
import lzma
import re
import warnings
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple
from xml.etree import ElementTree
from xml.parsers import expat
from xml.sax.saxutils import escape

import numpy as np

from granflow.io.files import FormatError, read_regular, replacing

if TYPE_CHECKING:
    import meshio


class CellBlock(NamedTuple):
    """Consecutive cells of one type: its name in meshio, and corners (k, corners), indices of points."""

    type: str
    data: np.ndarray


@dataclass(frozen=True, eq=False)
class VtuMesh:
    """Points with cells and arrays.

    points:      (n, 3) [m]
    cells:       blocks of cells
    point_data:  arrays (n,) or (n, components) by name
    cell_data:   by name, one array (k,) or (k, components) for each block
    units:       SI units of arrays by name; names without an array have no effect
    """

    points: np.ndarray
    cells: list[CellBlock]
    point_data: Mapping[str, np.ndarray] = field(default_factory=dict)
    cell_data: Mapping[str, list[np.ndarray]] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of_points(
        cls, points: np.ndarray, point_data: Mapping[str, np.ndarray], units: Mapping[str, str] | None = None
    ) -> "VtuMesh":
        """Return a mesh with one vertex cell per point (n, 3) [m]; without cells, ParaView shows glyphs only.

        `point_data`: name -> array (n,) or (n, k); `units`: as in the class.
        """
        vertices = np.arange(len(points), dtype=np.int64).reshape(-1, 1)
        return cls(points, [CellBlock("vertex", vertices)], point_data, {}, units or {})

    @classmethod
    def of_cells(
        cls,
        kind: str,
        points: np.ndarray,
        cells: np.ndarray,
        cell_data: Mapping[str, np.ndarray],
        units: Mapping[str, str] | None = None,
    ) -> "VtuMesh":
        """Return a mesh of cells of one kind, such as "line" (k, 2) or "triangle" (k, 3), with points (n, 3)
        [m].

        `cells`: indices of points, converted to int64; `cell_data`: name -> array (k,) or (k, components);
        `units`: as in the class.
        """
        per_block = {name: [values] for name, values in cell_data.items()}
        return cls(points, [CellBlock(kind, cells.astype(np.int64))], {}, per_block, units or {})


# Writing

Compression = Literal["none", "zlib"]
"""Compression of the arrays of a VTU file."""
EMPTY_CELL = "polygon"
"""Type of the cell without corners in frames without particles, contacts or walls: meshio needs a cell to
read."""
END = b"</UnstructuredGrid>\n</VTKFile>\n"
"""End of a file of meshio; field data are inserted before it."""


def write_vtu(path: Path, mesh: VtuMesh, compression: Compression = "zlib") -> None:
    """Write the mesh to a VTU file, atomically. Raises OSError."""
    import meshio

    stated = [
        f"{name} [{mesh.units[name]}]" for name in (*mesh.point_data, *mesh.cell_data) if name in mesh.units
    ]
    is_empty = not any(len(block.data) for block in mesh.cells)
    cells, cell_data = _empty_cell(mesh) if is_empty else (mesh.cells, mesh.cell_data)
    with replacing(path) as temporary:
        meshio.vtu.write(
            temporary,
            meshio.Mesh(
                mesh.points,
                [(block.type, _short(block.data)) for block in cells],
                {_attribute(name): values for name, values in mesh.point_data.items()},
                {_attribute(name): list(blocks) for name, blocks in cell_data.items()},
            ),
            # meshio cannot read compressed arrays without values
            compression=None if compression == "none" or is_empty else compression,
        )
        _add_field_data(temporary, stated)


def _empty_cell(mesh: VtuMesh) -> tuple[list[CellBlock], dict[str, list[np.ndarray]]]:
    """A cell without corners, and zeros as its data."""
    data = {
        name: [np.zeros((1, *blocks[0].shape[1:]), blocks[0].dtype)]
        for name, blocks in mesh.cell_data.items()
    }
    return [CellBlock(EMPTY_CELL, np.zeros((1, 0), np.int64))], data


def _short(corners: np.ndarray) -> np.ndarray:
    """Corners as int32 if also the offsets of the cells fit; meshio gives the offsets the type of the
    corners."""
    return corners.astype(np.int32 if corners.size < 2**31 else np.int64)


def _attribute(text: str) -> str:
    """Text as the value of an XML attribute, ASCII: meshio writes names as they are, in the encoding of the
    system."""
    return escape(text, {'"': "&quot;"}).encode("ascii", "xmlcharrefreplace").decode()


def _add_field_data(path: Path, names: list[str]) -> None:
    """Insert field data that state units: an array `velocity [m/s]` with the number 1, because meshio reads
    no text.

    meshio writes no field data into VTU files. Readers accept them behind the piece, so that only the end is
    written.
    """
    if not names:
        return
    arrays = (
        f'<DataArray type="Int8" Name="{_attribute(name)}" NumberOfTuples="1" format="ascii">1</DataArray>\n'
        for name in names
    )
    with open(path, "r+b") as file:
        file.seek(-len(END), 2)
        assert file.read() == END, "another version of meshio ends VTU files differently"
        file.seek(-len(END), 2)
        file.write(f"<FieldData>\n{''.join(arrays)}</FieldData>\n".encode() + END)


# Reading

LARGEST_FILE = 2**30
"""Largest size of a file [bytes]."""
MAX_REASON_LENGTH = 200
"""Largest length of a message of meshio, in characters."""


def read_vtu(path: Path, largest: int) -> VtuMesh:
    """Read the mesh in a file; several pieces are merged.

    largest:  maximum size [bytes] of all decoded arrays
    Returns:  points (n, 3), cells by type, and arrays of points and cells, with those of one component as
              (n,)
    Raises:   FormatError for an invalid or unsupported file, OSError if the file cannot be read
    """
    try:
        size = _checked_size(read_regular(path, LARGEST_FILE), largest)
    except expat.ExpatError as error:
        raise FormatError(f"cannot be read as VTU: it is not XML: {error}") from None
    try:
        with warnings.catch_warnings():
            # numpy stops at the first invalid number; the length is then wrong.
            warnings.simplefilter("ignore")
            return _mesh_of(_read_guarded(path, size))
    except FormatError:
        raise
    except Exception as error:
        raise FormatError(f"cannot be read as VTU: {reason_of(error)}") from None


def reason_of(error: BaseException) -> str:
    """The first sentence of a message of meshio, without its period."""
    text = " ".join(str(error).split()).partition(". ")[0].rstrip(".")[:MAX_REASON_LENGTH]
    if isinstance(error, KeyError):
        text = f"{text} is missing or unknown"
    return text or "it is damaged or has another format"


def _mesh_of(found: "meshio.Mesh") -> VtuMesh:
    """Mesh in native byte order, without the cell of an empty frame. Raises FormatError for invalid
    indices."""
    if found.points.ndim != 2 or found.points.shape[1] != 3:
        raise FormatError(f"has points of {found.points.shape[-1]} coordinates, but 3 are necessary")
    kept = [number for number, block in enumerate(found.cells) if block.data.size]
    for number in kept:
        corners = found.cells[number].data
        if not 0 <= corners.min() <= corners.max() < len(found.points):
            raise FormatError("refers to points that it does not contain")
    return VtuMesh(
        _native(found.points),
        [CellBlock(found.cells[number].type, found.cells[number].data.astype(np.int64)) for number in kept],
        {name: _native(values) for name, values in found.point_data.items()},
        {
            name: [_native(blocks[number]) for number in kept]
            for name, blocks in found.cell_data.items()
            if kept
        },
    )


def _native(values: np.ndarray) -> np.ndarray:
    """Array in native byte order; (n,) in place of (n, 1)."""
    values = values.astype(values.dtype.newbyteorder("="))
    return values[:, 0] if values.shape[1:] == (1,) else values


# Checks of the XML before meshio reads it

COMPRESSORS = ("vtkZLibDataCompressor", "vtkLZMADataCompressor")
"""Compressors of VTK that meshio supports."""
TYPE = re.compile(r"(?:Float(?:32|64)|U?Int(?:8|16|32|64))")
"""Types of arrays that meshio supports; the number is that of bits."""
MAX_PIECES = 1000
"""Largest number of pieces of a file."""
MAX_ARRAYS = 1000
"""Largest number of arrays of a file."""
MAX_COMPONENTS = 64
"""Largest number of components of an array."""
MAX_DEPTH = 16
"""Largest number of nested elements."""
CORNER_BYTES = 8 * 64
"""Largest size of the corners of a cell [bytes]."""


def _checked_size(raw: bytes, largest: int) -> int:
    """Size of all arrays by the numbers that the XML of a file declares [bytes], with a margin for corners of
    cells.

    Raises FormatError for XML that meshio would expand without limit or misread.
    """
    root = xml_of(_split_appended_data(raw)[0])
    if root.tag != "VTKFile" or root.attrib.get("type") != "UnstructuredGrid":
        raise FormatError("is not a VTU file: it contains no UnstructuredGrid")
    if root.attrib.get("compressor") not in (None, *COMPRESSORS):
        raise FormatError(
            f"is compressed with {root.attrib['compressor'][:80]}; save it with zlib, or without compression"
        )
    pieces = root.findall("./UnstructuredGrid/Piece")
    if not 1 <= len(pieces) <= MAX_PIECES:
        raise FormatError(f"has {len(pieces)} pieces; the number must be from 1 to {MAX_PIECES}")
    if sum(1 for _ in root.iter("DataArray")) > MAX_ARRAYS:
        raise FormatError(f"has more than {MAX_ARRAYS} arrays")
    size = 0
    cell_count = 0
    for piece in pieces:
        points = _count(piece, "NumberOfPoints")
        cells = _count(piece, "NumberOfCells")
        rows = {"Points": points, "PointData": points, "Cells": cells, "CellData": cells}
        size += sum(rows[part.tag] * _row_size(each) for part in piece if part.tag in rows for each in part)
        cell_count += cells
    size += sum(
        _count(each, "NumberOfTuples", 1) * _row_size(each) for each in root.findall(".//FieldData/DataArray")
    )
    if size > largest:
        raise FormatError(f"declares arrays larger than the limit of {largest / 2**20:.0f} MiB")
    return size + CORNER_BYTES * cell_count


def _count(element: ElementTree.Element, name: str, default: int | None = None) -> int:
    """Number in an attribute. Raises FormatError unless it is an integer from 0."""
    text = element.attrib.get(name, "missing" if default is None else str(default))
    if not re.fullmatch(r"\s*\d{1,18}\s*", text):
        raise FormatError(f"declares an invalid number of points, cells or values: {name} is {text[:40]}")
    return int(text)


def _row_size(array: ElementTree.Element) -> int:
    """Size of the components of one point or cell [bytes]. Raises FormatError for unsupported ones."""
    kind = array.attrib.get("type", "missing")
    if not TYPE.fullmatch(kind):
        raise FormatError(f"has an array of the type {kind[:40]}; supported are Float and Int types")
    components = _count(array, "NumberOfComponents", 1) if array.attrib.get("NumberOfComponents") else 1
    if not 1 <= components <= MAX_COMPONENTS:
        raise FormatError(
            f"has an array of {components} components; the number must be from 1 to {MAX_COMPONENTS}"
        )
    return components * int(kind.strip("FloatUIn")) // 8


def _split_appended_data(raw: bytes) -> tuple[bytes, bytes]:
    """The XML without raw appended data, and these data. Raises FormatError if they are truncated."""
    start = re.search(rb'<AppendedData[^>]*encoding\s*=\s*["\']raw["\'][^>]*>\s*_', raw)
    if start is None:
        return raw, b""
    end = raw.rfind(b"</AppendedData>")
    if end < start.end():
        raise FormatError("is truncated: its appended data are incomplete")
    return raw[: start.end() - 1] + raw[end:], raw[start.end() : end]


def xml_of(text: bytes) -> ElementTree.Element:
    """XML elements without their text.

    Raises FormatError for a document type, before any entity expands, and for deep nesting; ExpatError for
    other text.
    """
    builder = ElementTree.TreeBuilder()
    depth = 0
    parser = expat.ParserCreate()

    def refuse(*_: object) -> None:
        raise FormatError("declares a document type or entities, which files of VTK do not contain")

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_DEPTH:
            raise FormatError(f"has more than {MAX_DEPTH} nested elements")
        builder.start(name, attributes)

    def end(name: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(name)

    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.Parse(text, True)
    return builder.close()


# meshio with limits


def _read_guarded(path: Path, size: int) -> "meshio.Mesh":
    """Read a file with meshio, six of whose names are replaced meanwhile; one thread at a time.

    meshio 5.3.5 decompresses without limit, here at most `size` bytes. Where it would print a warning and
    drop data, FormatError is raised. It keeps the cells of the last piece only, fails for files without cells
    and for compressed arrays without values, and confuses raw appended arrays whose offsets in the file equal
    earlier ones in base64.
    """
    from meshio.vtu import _vtu

    class Reader(_vtu.VtuReader):
        def read_compressed_binary(self, data: str, dtype: np.dtype) -> np.ndarray:
            width = 8 if self.header_type == "UInt64" else 4
            has_blocks = any(base64.b64decode(data[:12])[:width])
            found: np.ndarray = (
                super().read_compressed_binary(data, dtype) if has_blocks else np.empty(0, dtype)
            )
            return found

    replacements = {
        "VtuReader": Reader,
        "zlib": _Limited(zlib, zlib.decompressobj, size),
        "lzma": _Limited(lzma, lambda: lzma.LZMADecompressor(memlimit=2**28), size),
        "warn": _refuse,
        "_parse_raw_binary": _with_raw_data_inline,
        "_organize_cells": _cells_of_pieces,
    }
    with _lock:
        originals = {name: getattr(_vtu, name) for name in replacements}
        try:
            vars(_vtu).update(replacements)
            return _vtu.read(path)
        finally:
            vars(_vtu).update(originals)


_lock = Lock()
"""Taken while names of meshio are replaced."""


class _Limited:
    """A compression module for meshio that decompresses at most `size` bytes. Raises FormatError for more."""

    def __init__(self, module: ModuleType, decompressor: Callable[[], Any], size: int) -> None:
        self._module = module
        self._decompressor = decompressor
        self._left = size

    def __getattr__(self, name: str) -> Any:
        """All else is as in the module: another thread may write a file at the same time."""
        return getattr(self._module, name)

    def decompress(self, block: bytes) -> bytes:
        """Return the decompressed block."""
        decompressor = self._decompressor()
        piece: bytes = decompressor.decompress(block, self._left + 1)
        self._left -= len(piece)
        if self._left < 0:
            raise FormatError("has compressed arrays longer than its numbers of points and cells allow")
        if not decompressor.eof:
            raise FormatError("has an incomplete compressed array")
        return piece


def _refuse(message: str) -> None:
    raise FormatError(f"cannot be read as VTU: {message.partition('. Skipping')[0].rstrip('.')}")


def _with_raw_data_inline(path: str) -> ElementTree.Element:
    """Elements of a file with raw appended data, with each of its arrays in its element as base64."""
    text, appended = _split_appended_data(Path(path).read_bytes())
    root = ElementTree.fromstring(text)
    order = ">" if root.get("byte_order") == "BigEndian" else "<"
    header = np.dtype(order + ("u8" if root.get("header_type") == "UInt64" else "u4"))
    for array in root.iter("DataArray"):
        if array.get("format") != "appended":
            continue
        data = memoryview(appended)[int(array.attrib["offset"]) :]
        count = int(np.frombuffer(data[: header.itemsize], header)[0])
        if root.get("compressor"):  # numbers and sizes of blocks, then the blocks, in separate base64
            sizes = np.frombuffer(data[: header.itemsize * min(3 + count, len(data))], header)
            body = data[sizes.nbytes :][: int(sizes[3:].sum())]
            array.text = (base64.b64encode(sizes.tobytes()) + base64.b64encode(body)).decode()
        else:
            array.text = base64.b64encode(data[: header.itemsize + count]).decode()
        array.set("format", "binary")
    for element in root.findall("AppendedData"):
        root.remove(element)
    return root


def _cells_of_pieces(
    first_points: np.ndarray, pieces: list[dict[str, np.ndarray]], cell_data: list[dict[str, np.ndarray]]
) -> tuple[list[Any], dict[str, list[np.ndarray]]]:
    """Cells of all pieces by type, and their arrays. Raises FormatError for unsupported types and invalid
    offsets.

    first_points:  index of the first point of each piece
    """
    from meshio import CellBlock as Block
    from meshio._vtk_common import vtk_cells_from_data

    if pieces and len(pieces) != len(first_points):
        raise FormatError("has pieces without cells; save it as one piece")
    blocks = []
    data = []
    for first_point, piece, arrays in zip(first_points, pieces, cell_data, strict=False):
        kinds = piece["types"].ravel()
        ends = piece["offsets"].ravel().astype(np.int64)
        if len(kinds):
            _check_cells(kinds, ends, piece["connectivity"].size)
            found, of_cells = vtk_cells_from_data(piece["connectivity"].ravel(), ends, kinds, arrays)
            blocks += [Block(block.type, block.data.astype(np.int64) + first_point) for block in found]
            data.append(of_cells)
    names = set(data[0]).intersection(*data) if data else set()
    return blocks, {name: [part for arrays in data for part in arrays[name]] for name in sorted(names)}


def _check_cells(kinds: np.ndarray, ends: np.ndarray, corner_count: int) -> None:
    """Raise FormatError for types that meshio does not read, and offsets that do not match the types.

    kinds, ends:   VTK types of the cells, and end of each in the list of corners
    corner_count:  length of this list
    """
    from meshio._vtk_common import num_nodes_per_cell, vtk_to_meshio_type

    sizes = np.diff(ends, prepend=0)
    for kind in np.unique(kinds).tolist():
        name = vtk_to_meshio_type.get(kind, "")
        if name != EMPTY_CELL and name not in num_nodes_per_cell:
            raise FormatError(f"contains cells of the VTK type {kind}; export the surface as triangles")
        if name in num_nodes_per_cell and (sizes[kinds == kind] != num_nodes_per_cell[name]).any():
            raise FormatError("has cell offsets that do not match the cell types")
    if (sizes < 0).any() or ends[-1] != corner_count:
        raise FormatError("has cell offsets that do not match the corners of the cells")
