"""Reads VTU files from untrusted sources (VTK file formats, UnstructuredGrid).

The length of each array must match the sizes that its piece declares (`vtu_arrays`). XML with a document type is
rejected, because entities can expand without limit.
"""

import binascii
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from granflow.io.regular_files import FormatError, read_regular
from granflow.io.vtu_arrays import ArraySource
from granflow.io.vtu_mesh import CELL_TYPES, POLYGON, CellBlock, VtuMesh

CELLS = {number: (name, corners) for name, (number, corners) in CELL_TYPES.items()}
"""Name and number of corners by VTK number."""

MAX_PIECES, MAX_DEPTH = 1000, 16
"""Largest number of pieces, and of nested elements."""
LARGEST_FILE = 2**30
"""Largest size of a file [bytes]."""


def read_vtu(path: Path, largest: int) -> VtuMesh:
    """Read the mesh in a file; several pieces are merged.

    largest:  maximum size [bytes] of all decoded arrays
    Returns:  points (n, 3), cells by type, and arrays of points and cells
    Raises:   FormatError for an invalid or unsupported file, OSError if the file cannot be read
    """
    text, appended = _split_appended_data(read_regular(path, LARGEST_FILE))
    try:
        return _mesh_of(xml_of(text), appended, largest)
    except (KeyError, ValueError, TypeError, ArithmeticError, MemoryError, binascii.Error) as error:
        raise FormatError(f"cannot be read as VTU: {_sentence(error)}") from None


def _sentence(error: Exception) -> str:
    """Description of an exception of the standard library for a message."""
    missing = isinstance(error, KeyError)
    return f"{error} is missing or unknown" if missing else str(error) or type(error).__name__


def _split_appended_data(raw: bytes) -> tuple[bytes, bytes]:
    """The XML without the raw appended data, and these data. Raises FormatError if they are truncated."""
    start = re.search(rb'<AppendedData[^>]*encoding\s*=\s*["\']raw["\'][^>]*>\s*_', raw)
    if start is None:
        return raw, b""
    end = raw.rfind(b"</AppendedData>")
    if end < start.end():
        raise FormatError("is truncated: its appended data are incomplete")
    return raw[: start.end() - 1] + raw[end:], raw[start.end() : end]


def xml_of(text: bytes) -> ElementTree.Element:
    """XML elements. Raises FormatError for a document type, before any entity expands, and for deep nesting."""
    builder, depth = ElementTree.TreeBuilder(), 0
    parser = expat.ParserCreate()

    def refuse(*_: object) -> None:
        raise FormatError("declares a document type or entities, which VTU files must not contain")

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
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler, parser.buffer_text = builder.data, True
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise FormatError(f"cannot be read as VTU: it is not XML: {error}") from None
    return builder.close()


def _mesh_of(root: ElementTree.Element, raw: bytes, largest: int) -> VtuMesh:
    """Mesh of the elements; `raw`: appended data, `largest`: bytes that may be decoded. Raises FormatError."""
    if root.tag != "VTKFile" or root.attrib.get("type") != "UnstructuredGrid":
        raise FormatError("is not a VTU file: it contains no UnstructuredGrid")
    source = ArraySource.of(root, raw, largest)
    pieces = root.findall("./UnstructuredGrid/Piece")
    if not 1 <= len(pieces) <= MAX_PIECES:
        raise FormatError(f"has {len(pieces)} pieces; the number must be from 1 to {MAX_PIECES}")
    meshes = [_piece(piece, source) for piece in pieces]
    return meshes[0] if len(meshes) == 1 else _merged(meshes)


def _piece(piece: ElementTree.Element, source: ArraySource) -> VtuMesh:
    """Mesh of one piece. Raises FormatError if its arrays contradict each other."""
    point_count, cell_count = (int(piece.attrib[name]) for name in ("NumberOfPoints", "NumberOfCells"))
    if point_count < 0 or cell_count < 0:
        raise FormatError("declares a negative number of points or cells")
    points_element = piece.find("./Points/DataArray")
    points = np.zeros((0, 3)) if points_element is None else source.array(points_element, point_count, 3)
    if points.shape != (point_count, 3):
        raise FormatError(f"declares {point_count} points, but has {points.shape[0]} of {points.shape[1:]} coordinates")
    blocks = _blocks(piece, source, cell_count)
    point_data = dict(_data(piece.find("PointData"), source, point_count))
    cell_data = {
        name: np.split(values, np.cumsum([len(corners) for _, corners in blocks])[:-1])
        for name, values in _data(piece.find("CellData"), source, cell_count)
        if blocks
    }
    for _, corners in blocks:
        if corners.size and not 0 <= corners.min() <= corners.max() < point_count:
            raise FormatError("refers to points that it does not contain")
    return VtuMesh(points, blocks, point_data=point_data, cell_data=cell_data)


def _blocks(piece: ElementTree.Element, source: ArraySource, count: int) -> list[CellBlock]:
    """Consecutive cells of one type in the order of the file, int64.

    Raises FormatError for unsupported cell types and inconsistent offsets.
    """
    found = {each.attrib.get("Name"): each for each in piece.findall("./Cells/DataArray")}
    if not count or not found:
        return []
    kinds = source.array(found["types"], count, 1).ravel()
    ends = source.array(found["offsets"], count, 1).ravel().astype(np.int64)
    if count == 1 and kinds[0] == POLYGON and not ends[0]:  # in frames without particles, contacts or walls
        return []
    unknown = set(np.unique(kinds).tolist()) - set(CELLS)
    if unknown:
        raise FormatError(f"contains cells of the VTK type {min(unknown)}; export the surface as triangles")
    sizes = np.zeros(max(CELLS) + 1, np.int64)
    sizes[list(CELLS)] = [corners for _, corners in CELLS.values()]
    if not np.array_equal(ends, np.cumsum(sizes[kinds])):
        raise FormatError("has cell offsets that do not match the cell types")
    corners = source.array(found["connectivity"], int(ends[-1]), 1).ravel().astype(np.int64)
    starts = np.flatnonzero(np.diff(kinds, prepend=-1))
    firsts, lasts = starts, [*starts[1:], count]
    begins = ends - sizes[kinds]
    return [
        CellBlock(CELLS[int(kinds[a])][0], corners[begins[a] : ends[b - 1]].reshape(b - a, -1))
        for a, b in zip(firsts, lasts, strict=True)
    ]


def _data(element: ElementTree.Element | None, source: ArraySource, count: int) -> Iterator[tuple[str, np.ndarray]]:
    """Arrays of points or cells by name, (count,) or (count, components); arrays with one component are flat."""
    for each in [] if element is None else element.findall("DataArray"):
        components = int(each.attrib.get("NumberOfComponents") or 1)
        values = source.array(each, count, components)
        yield each.attrib["Name"], values if each.attrib.get("NumberOfComponents") else values.ravel()


def _merged(meshes: list[VtuMesh]) -> VtuMesh:
    """One mesh of several pieces, with the arrays that all pieces have."""
    before = np.cumsum([0, *(len(mesh.points) for mesh in meshes)])
    cells = [CellBlock(b.type, b.data + shift) for mesh, shift in zip(meshes, before, strict=False) for b in mesh.cells]
    names = set(meshes[0].point_data).intersection(*(mesh.point_data for mesh in meshes))
    point_data = {name: np.concatenate([mesh.point_data[name] for mesh in meshes]) for name in sorted(names)}
    shared = set(meshes[0].cell_data).intersection(*(mesh.cell_data for mesh in meshes))
    cell_data = {name: [part for mesh in meshes for part in mesh.cell_data[name]] for name in sorted(shared)}
    return VtuMesh(np.concatenate([mesh.points for mesh in meshes]), cells, point_data=point_data, cell_data=cell_data)
