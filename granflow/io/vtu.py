"""VTU files (VTK file formats, UnstructuredGrid), written and read by meshio.

`VtuMesh` is what a file contains. meshio is imported with the first file: its import takes 60 ms. Three
things are done around its calls, which meshio 5.3.5 does not do: special characters of names are escaped;
units and other numbers are added as field data; and a frame without cells gets a cell that meshio can read.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from granflow.io.files import FormatError, read_file, replacing

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
    numbers:     of the whole mesh by name, as Int32 or Float64; only written
    """

    points: np.ndarray
    cells: list[CellBlock]
    point_data: Mapping[str, np.ndarray] = field(default_factory=dict)
    cell_data: Mapping[str, list[np.ndarray]] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    numbers: Mapping[str, int | float] = field(default_factory=dict)

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

    arrays = (*mesh.point_data, *mesh.cell_data, *mesh.numbers)
    stated = {f"{name} [{mesh.units[name]}]": 1 for name in arrays if name in mesh.units}
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
        _add_field_data(temporary, {**stated, **mesh.numbers})


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
    return escape(text).encode("ascii", "xmlcharrefreplace").decode()


def _add_field_data(path: Path, numbers: Mapping[str, int | float]) -> None:
    """Insert numbers as field data. Units are in their names, `velocity [m/s]` with the number 1, because
    meshio reads no text.

    meshio writes no field data into VTU files. Readers accept them behind the piece, so that only the end is
    written.
    """
    if not numbers:
        return
    arrays = (
        f'<DataArray type="{"Float64" if isinstance(number, float) else "Int32"}" Name="{_attribute(name)}" '
        f'NumberOfTuples="1" format="ascii">{number}</DataArray>\n'
        for name, number in numbers.items()
    )
    with open(path, "r+b") as file:
        file.seek(-len(END), 2)
        assert file.read() == END, "another version of meshio ends VTU files differently"
        file.seek(-len(END), 2)
        file.write(f"<FieldData>\n{''.join(arrays)}</FieldData>\n".encode() + END)


# Reading

MAX_REASON_LENGTH = 200
"""Largest length of a message of meshio, in characters."""


def read_vtu(path: Path) -> VtuMesh:
    """Read the mesh in a file: points (n, 3), cells by type, and arrays, with those of one component as (n,).

    Raises FormatError for an invalid or unsupported file, OSError if the file cannot be read.
    """
    import meshio

    raw = read_file(path)
    if (count := len(re.findall(rb"<Piece[ >]", raw))) > 1:  # meshio keeps the cells of the last one only
        raise FormatError(f"has {count} pieces; save it as one piece")
    if re.search(rb"""NumberOfCells=["']\s*0\s*["']""", raw):  # meshio fails
        raise FormatError("has no cells; save it with a vertex for each point")
    try:
        return _mesh_of(meshio.vtu.read(path))
    except (FormatError, OSError):
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
