"""Unstructured meshes as in VTU files."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np


class CellBlock(NamedTuple):
    """Consecutive cells of one type: its name in CELL_TYPES, and corners (k, corners), indices of points."""

    type: str
    data: np.ndarray


CELL_TYPES = {
    "vertex": (1, 1), "line": (3, 2), "triangle": (5, 3), "quad": (9, 4), "tetra": (10, 4), "hexahedron": (12, 8),
    "wedge": (13, 6), "pyramid": (14, 5),
}  # fmt: skip
"""Supported cell types by name: VTK number and number of corners."""

POLYGON = 7
"""VTK number of a polygon, which frames without cells contain, because meshio cannot read files without cells."""


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
        """Return a mesh of cells of one kind, such as "line" (k, 2) or "triangle" (k, 3), with points (n, 3) [m].

        `cells`: indices of points, converted to int64; `cell_data`: name -> array (k,) or (k, components); `units`: as
        in the class.
        """
        per_block = {name: [values] for name, values in cell_data.items()}
        return cls(points, [CellBlock(kind, cells.astype(np.int64))], {}, per_block, units or {})
