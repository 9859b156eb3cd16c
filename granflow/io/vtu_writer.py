"""Writes VTU files: binary arrays, compressed by zlib.

meshio is used for other formats only: its import takes 60 ms of every start, and its writer three times as long per
frame, while it holds the interpreter lock.
"""

import zlib
from binascii import b2a_base64
from collections.abc import Callable, Iterator
from functools import lru_cache
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
    '<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian" '
    'header_type="UInt32"{compressor}>\n<UnstructuredGrid>\n'
)
COMPRESSOR = ' compressor="vtkZLibDataCompressor"'
TAIL = b"</Piece>\n</UnstructuredGrid>\n</VTKFile>\n"
TYPE_NAMES = {"f": "Float", "i": "Int", "u": "UInt"}
"""Beginning of the VTK type by the kind of the numpy type; the number of bits follows."""


def write_vtu(path: Path, mesh: VtuMesh) -> None:
    """Write the mesh to a VTU file, atomically. Raises OSError."""
    with replacing(path) as temporary:
        temporary.write_bytes(b"".join(_parts(mesh)))


def _parts(mesh: VtuMesh) -> Iterator[bytes]:
    """Parts of the file in order.

    A mesh without cells gets one polygon without corners, with zero data, and is not compressed: meshio reads neither
    files without cells nor compressed arrays without values.
    """
    cell_count = sum(len(block.data) for block in mesh.cells)
    cell_data = {name: np.concatenate(parts) for name, parts in mesh.cell_data.items()}
    cells, encoded = _cell_arrays(mesh.cells), _compressed
    if not cell_count:
        cells, encoded, cell_count = _empty_polygon(), _uncompressed, 1
        cell_data = {name: np.zeros((1, *values.shape[1:]), values.dtype) for name, values in cell_data.items()}
    yield HEAD.format(compressor=COMPRESSOR if encoded is _compressed else "").encode()
    yield _field_data(tuple((name, mesh.units[name]) for name in (*mesh.point_data, *cell_data) if name in mesh.units))
    yield f'<Piece NumberOfPoints="{len(mesh.points)}" NumberOfCells="{cell_count}">\n'.encode()
    sections = {"Points": {"Points": mesh.points}, "Cells": cells, "PointData": mesh.point_data, "CellData": cell_data}
    for name, arrays in sections.items():
        yield f"<{name}>\n".encode()
        for each, values in arrays.items():
            yield from _array(each, values, encoded)
        yield f"</{name}>\n".encode()
    yield TAIL


@lru_cache
def _field_data(units: tuple[tuple[str, str], ...]) -> bytes:
    """Field data that states units: an array `velocity [m/s]` with the number 1, because meshio reads no text."""
    if not units:
        return b""
    names = (quoteattr(f"{name} [{unit}]") for name, unit in units)
    arrays = (f'<DataArray type="Int8" Name={name} NumberOfTuples="1" format="ascii">1</DataArray>\n' for name in names)
    return f"<FieldData>\n{''.join(arrays)}</FieldData>\n".encode()


def _empty_polygon() -> dict[str, np.ndarray]:
    """Cell arrays of one polygon without corners."""
    return {
        "connectivity": np.zeros(0, np.int64),
        "offsets": np.zeros(1, np.int64),
        "types": np.full(1, POLYGON, np.uint8),
    }


def _cell_arrays(blocks: list[CellBlock]) -> dict[str, np.ndarray]:
    """Corners of all cells, end of each cell in them, and VTK types."""
    counts = [len(block.data) for block in blocks]
    sizes = np.repeat(np.array([CELL_TYPES[block.type][1] for block in blocks], np.int64), counts)
    return {
        "connectivity": np.concatenate([np.zeros(0, np.int64), *(block.data.ravel() for block in blocks)]),
        "offsets": np.cumsum(sizes),
        "types": np.repeat(np.array([CELL_TYPES[block.type][0] for block in blocks], np.uint8), counts),
    }


def _array(name: str, values: np.ndarray, encoded: Callable[[memoryview], bytes]) -> Iterator[bytes]:
    """A DataArray (n,) or (n, components) in base64."""
    little = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    components = f' NumberOfComponents="{values.shape[1]}"' if values.ndim > 1 else ""
    yield f'<DataArray type="{type_name(little.dtype)}" Name={quoteattr(name)}{components} format="binary">'.encode()
    yield encoded(little.reshape(-1).view(np.uint8).data)
    yield b"</DataArray>\n"


def type_name(dtype: np.dtype) -> str:
    """The VTK name of a type, such as Float32."""
    return f"{TYPE_NAMES[dtype.kind]}{8 * dtype.itemsize}"


def _compressed(data: memoryview) -> bytes:
    """Numbers and sizes of blocks, then the compressed blocks."""
    blocks = [zlib.compress(data[begin : begin + BLOCK_SIZE], LEVEL) for begin in range(0, len(data), BLOCK_SIZE)]
    last_size = len(data) - BLOCK_SIZE * (len(blocks) - 1) if blocks else 0
    sizes = [len(blocks), BLOCK_SIZE, last_size, *map(len, blocks)]
    return b2a_base64(np.array(sizes, "<u4").tobytes(), newline=False) + b2a_base64(b"".join(blocks), newline=False)


def _uncompressed(data: memoryview) -> bytes:
    """Number of bytes, then the bytes."""
    return b2a_base64(np.array([len(data)], "<u4").tobytes() + bytes(data), newline=False)
