"""Writes VTU files: binary arrays, compressed by zlib.

meshio is used for other formats only: its import takes 60 ms of every start, and its writer three times as long per
frame, while it holds the interpreter lock.
"""

import zlib
from binascii import b2a_base64
from collections.abc import Iterator, Mapping
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from granflow.io.atomic_files import replacing
from granflow.io.vtu_mesh import CELL_TYPES, POLYGON, CellBlock, VtuMesh

BLOCK_SIZE = 2**20
"""Bytes of an array that are compressed together."""

LEVEL = 1
"""Compression level of zlib: files are 3 % larger than with the default of 6, which takes three times as long."""

HEAD = (
    b'<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian" '
    b'header_type="UInt32" compressor="vtkZLibDataCompressor">\n<UnstructuredGrid>\n'
)
TAIL = b"</Piece>\n</UnstructuredGrid>\n</VTKFile>\n"
TYPE_NAMES = {"f": "Float", "i": "Int", "u": "UInt"}
"""Beginning of the VTK type by the kind of the numpy type; the number of bits follows."""


def write_vtu(path: Path, mesh: VtuMesh) -> None:
    """Write the mesh to a VTU file, atomically. Raises OSError."""
    with replacing(path) as temporary:
        temporary.write_bytes(b"".join(_parts(mesh)))


def _parts(mesh: VtuMesh) -> Iterator[bytes]:
    """Parts of the file in order; a mesh without cells gets one polygon without corners, with zero data."""
    cell_count = sum(len(block.data) for block in mesh.cells)
    cells = _cell_arrays(mesh.cells) if cell_count else _empty_polygon()
    cell_data = {name: np.concatenate(parts) for name, parts in mesh.cell_data.items()}
    if not cell_count:
        cell_count, cell_data = 1, {name: np.zeros((1, *v.shape[1:]), v.dtype) for name, v in cell_data.items()}
    yield HEAD
    yield f'<Piece NumberOfPoints="{len(mesh.points)}" NumberOfCells="{cell_count}">\n'.encode()
    yield from _section("Points", {"Points": mesh.points})
    yield from _section("Cells", cells)
    yield from _section("PointData", mesh.point_data)
    yield from _section("CellData", cell_data)
    yield TAIL


def _empty_polygon() -> dict[str, np.ndarray]:
    """Cell arrays of one polygon without corners."""
    return {
        "connectivity": np.zeros(0, np.int64),
        "offsets": np.zeros(1, np.int64),
        "types": np.full(1, POLYGON, np.uint8),
    }


def _section(name: str, arrays: Mapping[str, np.ndarray]) -> Iterator[bytes]:
    """An element with arrays."""
    yield f"<{name}>\n".encode()
    for each, values in arrays.items():
        yield from _array(each, values)
    yield f"</{name}>\n".encode()


def _cell_arrays(blocks: list[CellBlock]) -> dict[str, np.ndarray]:
    """Corners of all cells, end of each cell in them, and VTK types."""
    counts = [len(block.data) for block in blocks]
    sizes = np.repeat(np.array([CELL_TYPES[block.type][1] for block in blocks], np.int64), counts)
    return {
        "connectivity": np.concatenate([np.zeros(0, np.int64), *(block.data.ravel() for block in blocks)]),
        "offsets": np.cumsum(sizes),
        "types": np.repeat(np.array([CELL_TYPES[block.type][0] for block in blocks], np.uint8), counts),
    }


def _array(name: str, values: np.ndarray) -> Iterator[bytes]:
    """A DataArray (n,) or (n, components): the sizes of its blocks, then the compressed blocks, both in base64."""
    little = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    kind = f"{TYPE_NAMES[little.dtype.kind]}{8 * little.itemsize}"
    components = f' NumberOfComponents="{values.shape[1]}"' if values.ndim > 1 else ""
    yield f'<DataArray type="{kind}" Name={quoteattr(name)}{components} format="binary">'.encode()
    data = little.reshape(-1).view(np.uint8).data
    blocks = [zlib.compress(data[begin : begin + BLOCK_SIZE], LEVEL) for begin in range(0, len(data), BLOCK_SIZE)]
    last_size = len(data) - BLOCK_SIZE * (len(blocks) - 1) if blocks else 0
    sizes = [len(blocks), BLOCK_SIZE, last_size, *map(len, blocks)]
    yield b2a_base64(np.array(sizes, "<u4").tobytes(), newline=False)
    yield b2a_base64(b"".join(blocks), newline=False)
    yield b"</DataArray>\n"
