"""Reads VTU files from untrusted sources: the length of each array must match the sizes that its piece declares.

Compressed blocks are decompressed up to the length that follows from NumberOfPoints and NumberOfCells, and the total
number of decoded bytes is limited. XML with a document type is rejected, because entities can expand without limit.

Format: VTK file formats, UnstructuredGrid; ASCII, binary (base64) and appended data, zlib or LZMA compression.
"""

import base64
import binascii
import lzma
import re
import warnings
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

import meshio
import numpy as np

from granflow.io.regular_files import read_regular

DTYPES = {
    **{f"Float{8 * size}": f"f{size}" for size in (4, 8)},
    **{f"Int{8 * size}": f"i{size}" for size in (1, 2, 4, 8)},
    **{f"UInt{8 * size}": f"u{size}" for size in (1, 2, 4, 8)},
}
"""numpy type by VTK type, without the byte order."""
CELLS = {
    1: ("vertex", 1), 3: ("line", 2), 5: ("triangle", 3), 9: ("quad", 4), 10: ("tetra", 4), 12: ("hexahedron", 8),
    13: ("wedge", 6), 14: ("pyramid", 5),
}  # fmt: skip
"""Supported cell types by VTK number: name and number of corners."""

MAX_CORNERS, MAX_COMPONENTS, MAX_PIECES, MAX_ARRAYS, MAX_DEPTH = 8, 64, 1000, 1000, 16
"""Limits of the format: corners of a cell, components of an array, pieces, arrays, nesting of elements."""
LARGEST_FILE = 2**30
"""Largest size of a file [bytes]."""


class VtuError(Exception):
    """An invalid VTU file; the message continues the sentence "FILE ..."."""


@dataclass
class _Source:
    """Encoding of the arrays of a file, the appended data, and the number of bytes that may still be decoded.

    order:       byte order, "<" or ">"
    header:      integer type of the lengths before each array
    decompress:  function (block, largest length) -> bytes, or None
    bytes_left:  number of bytes that may still be decoded
    appended:    appended data, raw or base64
    raw:         True if the appended data are raw
    arrays:      number of arrays read so far
    """

    order: str
    header: np.dtype
    decompress: Callable[[bytes, int], bytes] | None
    bytes_left: int
    appended: bytes = b""
    raw: bool = False
    arrays: int = field(default=0)


def read_vtu(path: Path, largest: int) -> meshio.Mesh:
    """Read the mesh in a file; several pieces are merged.

    largest:  maximum size [bytes] of all decoded arrays
    Returns:  points (n, 3), cells by type, and arrays of points and cells
    Raises:   VtuError for an invalid or unsupported file, OSError if the file cannot be read
    """
    text, appended = _split_appended_data(read_regular(path, LARGEST_FILE))
    try:
        return _mesh_of(_tree(text), appended, largest)
    except (KeyError, ValueError, TypeError, ArithmeticError, MemoryError, binascii.Error) as error:
        raise VtuError(f"cannot be read as VTU: {_sentence(error)}") from None


def _sentence(error: Exception) -> str:
    """Description of an exception of the standard library for a message."""
    missing = isinstance(error, KeyError)
    return f"{error} is missing or unknown" if missing else str(error) or type(error).__name__


def _split_appended_data(raw: bytes) -> tuple[bytes, bytes]:
    """The XML without the raw appended data, and these data. Raises VtuError if they are truncated."""
    start = re.search(rb'<AppendedData[^>]*encoding\s*=\s*["\']raw["\'][^>]*>\s*_', raw)
    if start is None:
        return raw, b""
    end = raw.rfind(b"</AppendedData>")
    if end < start.end():
        raise VtuError("is truncated: its appended data are incomplete")
    return raw[: start.end() - 1] + raw[end:], raw[start.end() : end]


def _tree(text: bytes) -> ElementTree.Element:
    """XML elements. Raises VtuError for a document type, before any entity expands, and for deep nesting."""
    builder, depth = ElementTree.TreeBuilder(), 0
    parser = expat.ParserCreate()

    def refuse(*_: object) -> None:
        raise VtuError("declares a document type or entities, which VTU files must not contain")

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_DEPTH:
            raise VtuError(f"has more than {MAX_DEPTH} nested elements")
        builder.start(name, attributes)

    def end(name: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(name)

    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler, parser.buffer_text = builder.data, True
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise VtuError(f"cannot be read as VTU: it is not XML: {error}") from None
    return builder.close()


def _mesh_of(root: ElementTree.Element, raw: bytes, largest: int) -> meshio.Mesh:
    """Mesh of the elements; `raw`: appended data, `largest`: bytes that may be decoded. Raises VtuError."""
    if root.tag != "VTKFile" or root.attrib.get("type") != "UnstructuredGrid":
        raise VtuError("is not a VTU file: it contains no UnstructuredGrid")
    source = _source(root, raw, largest)
    pieces = root.findall("./UnstructuredGrid/Piece")
    if not 1 <= len(pieces) <= MAX_PIECES:
        raise VtuError(f"has {len(pieces)} pieces; the number must be from 1 to {MAX_PIECES}")
    meshes = [_piece(piece, source) for piece in pieces]
    return meshes[0] if len(meshes) == 1 else _merged(meshes)


def _source(root: ElementTree.Element, raw: bytes, largest: int) -> _Source:
    """Encoding of the file from the attributes of its root. Raises KeyError for an unknown one."""
    order = {"LittleEndian": "<", "BigEndian": ">"}[root.attrib.get("byte_order", "LittleEndian")]
    header = np.dtype(order + {"UInt32": "u4", "UInt64": "u8"}[root.attrib.get("header_type", "UInt32")])
    known = {"vtkZLibDataCompressor": _unzip, "vtkLZMADataCompressor": _unlzma}
    compressor = root.attrib.get("compressor")
    source = _Source(order, header, known[compressor] if compressor else None, largest)
    element = root.find("AppendedData")
    if element is not None:
        text = (element.text or "").strip()
        source.raw = element.attrib.get("encoding") == "raw"
        source.appended = raw if source.raw else text.removeprefix("_").encode()
    return source


def _unzip(block: bytes, most: int) -> bytes:
    """Decompress a zlib block to at most `most` bytes. Raises VtuError for damaged data."""
    try:
        return zlib.decompressobj().decompress(block, most)
    except zlib.error as error:
        raise VtuError(f"has a damaged compressed block: {error}") from None


def _unlzma(block: bytes, most: int) -> bytes:
    """Decompress an LZMA block to at most `most` bytes. Raises VtuError for damaged data."""
    try:
        return lzma.LZMADecompressor(memlimit=2**28).decompress(block, most)
    except lzma.LZMAError as error:
        raise VtuError(f"has a damaged compressed block: {error}") from None


def _piece(piece: ElementTree.Element, source: _Source) -> meshio.Mesh:
    """Mesh of one piece. Raises VtuError if its arrays contradict each other."""
    point_count, cell_count = (int(piece.attrib[name]) for name in ("NumberOfPoints", "NumberOfCells"))
    if point_count < 0 or cell_count < 0:
        raise VtuError("declares a negative number of points or cells")
    points_element = piece.find("./Points/DataArray")
    points = np.zeros((0, 3)) if points_element is None else _array(points_element, source, point_count, 3)
    if points.shape != (point_count, 3):
        raise VtuError(f"declares {point_count} points, but has {points.shape[0]} of {points.shape[1:]} coordinates")
    blocks = _blocks(piece, source, cell_count)
    point_data = dict(_data(piece.find("PointData"), source, point_count))
    cell_data = {
        name: np.split(values, np.cumsum([len(corners) for _, corners in blocks])[:-1])
        for name, values in _data(piece.find("CellData"), source, cell_count)
        if blocks
    }
    for _, corners in blocks:
        if corners.size and not 0 <= corners.min() <= corners.max() < point_count:
            raise VtuError("refers to points that it does not contain")
    return meshio.Mesh(points, blocks, point_data=point_data, cell_data=cell_data)


def _blocks(piece: ElementTree.Element, source: _Source, count: int) -> list[tuple[str, np.ndarray]]:
    """Consecutive cells of one type in the order of the file: name and corners (cells, corners) int64.

    Raises VtuError for unsupported cell types and inconsistent offsets.
    """
    found = {each.attrib.get("Name"): each for each in piece.findall("./Cells/DataArray")}
    if not count or not found:
        return []
    kinds = _array(found["types"], source, count, 1).ravel()
    ends = _array(found["offsets"], source, count, 1).ravel().astype(np.int64)
    unknown = set(np.unique(kinds).tolist()) - set(CELLS)
    if unknown:
        raise VtuError(f"contains cells of the VTK type {min(unknown)}; export the surface as triangles")
    sizes = np.zeros(max(CELLS) + 1, np.int64)
    sizes[list(CELLS)] = [corners for _, corners in CELLS.values()]
    if not np.array_equal(ends, np.cumsum(sizes[kinds])):
        raise VtuError("has cell offsets that do not match the cell types")
    corners = _array(found["connectivity"], source, int(ends[-1]), 1).ravel().astype(np.int64)
    starts = np.flatnonzero(np.diff(kinds, prepend=-1))
    firsts, lasts = starts, [*starts[1:], count]
    begins = ends - sizes[kinds]
    return [
        (CELLS[int(kinds[a])][0], corners[begins[a] : ends[b - 1]].reshape(b - a, -1))
        for a, b in zip(firsts, lasts, strict=True)
    ]


def _data(element: ElementTree.Element | None, source: _Source, count: int) -> Iterator[tuple[str, np.ndarray]]:
    """Arrays of points or cells by name, (count,) or (count, components); arrays with one component are flat."""
    for each in [] if element is None else element.findall("DataArray"):
        components = int(each.attrib.get("NumberOfComponents") or 1)
        values = _array(each, source, count, components)
        yield each.attrib["Name"], values if each.attrib.get("NumberOfComponents") else values.ravel()


def _array(element: ElementTree.Element, source: _Source, count: int, components: int) -> np.ndarray:
    """Array (count, components) in native byte order.

    Raises VtuError if the length differs, or if the limits on arrays, components or bytes are exceeded.
    """
    dtype = np.dtype(source.order + DTYPES[element.attrib["type"]])
    size = count * components * dtype.itemsize
    source.arrays += 1
    source.bytes_left -= size
    if source.arrays > MAX_ARRAYS or not 1 <= components <= MAX_COMPONENTS:
        raise VtuError("has too many arrays, or an array with too many components")
    if source.bytes_left < 0:
        raise VtuError(f"declares arrays larger than the limit of {(source.bytes_left + size) / 2**20:.0f} MiB")
    form = element.attrib.get("format", "ascii")
    if form == "ascii":
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # numpy stops at the first invalid number; the length is then wrong
            raw = np.fromstring(element.text or "", dtype, sep=" ").tobytes()
    else:
        raw = _bytes(element, source, size, form)
    if len(raw) != size:
        more = "more" if len(raw) > size else "fewer"
        raise VtuError(f"has an array of {more} than the {size} bytes that follow from its numbers of points and cells")
    values = np.frombuffer(raw, dtype).reshape(count, components)
    return values.astype(dtype.newbyteorder("="))


def _bytes(element: ElementTree.Element, source: _Source, size: int, form: str) -> bytes:
    """The array as bytes, at most `size` + 1 of them; `form` is binary or appended."""
    if form == "appended":
        data, raw = source.appended[int(element.attrib["offset"]) :], source.raw
    else:
        data, raw = "".join((element.text or "").split()).encode(), False
    width = source.header.itemsize
    if source.decompress is None:
        return _plain(data, raw, width, size, source.header)
    count = int(_decoded(data, raw, 0, width).view(source.header)[0])
    if count > len(data):
        raise VtuError("declares more compressed blocks than it contains bytes")
    lengths = _decoded(data, raw, 0, width * (3 + count)).view(source.header)[3:].astype(np.int64)
    header_size = width * (3 + count)
    if raw:
        body = data[header_size:]
    else:
        body = base64.b64decode(
            _complete_groups(data[_encoded(header_size) : _encoded(header_size) + _encoded(int(lengths.sum()))])
        )
    return b"".join(_decompressed(body, lengths, source.decompress, size))


def _decompressed(
    body: bytes, lengths: np.ndarray, decompress: Callable[[bytes, int], bytes], size: int
) -> Iterator[bytes]:
    """Decompressed blocks, at most `size` + 1 bytes in total; `lengths`: compressed length of each block."""
    left, begin = size + 1, 0
    for length in lengths.tolist():
        if length < 0 or begin + length > len(body):
            raise VtuError("is truncated in a compressed block")
        piece = decompress(body[begin : begin + length], left) if left else b""
        left, begin = left - len(piece), begin + length
        yield piece


def _plain(data: bytes, raw: bool, width: int, size: int, header: np.dtype) -> bytes:
    """Bytes of an array without compression, after a length of `width` bytes; raises VtuError if it is not `size`."""
    declared = int(_decoded(data, raw, 0, width).view(header)[0])
    if declared != size:
        raise VtuError(f"has an array of {declared} bytes, but {size} follow from its numbers of points and cells")
    if raw:
        return data[width : width + size]
    if data[: _encoded(width)].endswith(b"=") and len(data) > _encoded(width):
        return base64.b64decode(_complete_groups(data[_encoded(width) : _encoded(width) + _encoded(size)]))[:size]
    return base64.b64decode(_complete_groups(data[: _encoded(width + size)]))[width : width + size]


def _decoded(data: bytes, raw: bool, begin: int, size: int) -> np.ndarray:
    """`size` bytes from `begin` on, uint8; base64 data are decoded from their start. Raises VtuError if truncated."""
    found = data[begin : begin + size] if raw else base64.b64decode(_complete_groups(data[: _encoded(size)]))[:size]
    if len(found) != size:
        raise VtuError("is truncated in the header of an array")
    return np.frombuffer(found, np.uint8)


def _complete_groups(text: bytes) -> bytes:
    """Base64 text without an incomplete group of four characters at its end."""
    return text[: len(text) // 4 * 4]


def _encoded(size: int) -> int:
    """Number of base64 characters that encode `size` bytes."""
    return 4 * -(-size // 3)


def _merged(meshes: list[meshio.Mesh]) -> meshio.Mesh:
    """One mesh of several pieces, with the arrays that all pieces have."""
    before = np.cumsum([0, *(len(mesh.points) for mesh in meshes)])
    cells = [(b.type, b.data + shift) for mesh, shift in zip(meshes, before, strict=False) for b in mesh.cells]
    names = set(meshes[0].point_data).intersection(*(mesh.point_data for mesh in meshes))
    point_data = {name: np.concatenate([mesh.point_data[name] for mesh in meshes]) for name in sorted(names)}
    shared = set(meshes[0].cell_data).intersection(*(mesh.cell_data for mesh in meshes))
    cell_data = {name: [part for mesh in meshes for part in mesh.cell_data[name]] for name in sorted(shared)}
    return meshio.Mesh(
        np.concatenate([mesh.points for mesh in meshes]), cells, point_data=point_data, cell_data=cell_data
    )
