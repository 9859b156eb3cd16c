"""Search cells over the particles that are there.

Cells lie in blocks of 8 x 8 x 8, so that a chunk of consecutive particles is a compact lump and few pairs cross
chunks.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti

BLOCK_SIDE = 8
BLOCK_CELLS = BLOCK_SIDE**3


@dataclass(frozen=True)
class Grid:
    """Cells along each axis, their sides (3,) [m] and the low corner (3,) [m] of all of them."""

    low: np.ndarray
    side: np.ndarray
    cells: tuple[int, int, int]

    @property
    def blocks(self) -> tuple[int, ...]:
        """Blocks along each axis."""
        return tuple(-(-cells // BLOCK_SIDE) for cells in self.cells)

    @property
    def cell_count(self) -> int:
        """Cells in all blocks."""
        return int(np.prod(self.blocks, dtype=np.int64)) * BLOCK_CELLS

    @classmethod
    def over(
        cls, low: np.ndarray, high: np.ndarray, side: float, cell_limit: int, periodic: Sequence[int] = ()
    ) -> "Grid":
        """Smallest grid of cells at least `side` wide over a box, made coarser until it has few enough cells.

        Along periodic axes cells are as wide as fill the box exactly, elsewhere as wide as asked, in whole blocks.
        """
        across = np.isin(np.arange(3), periodic)
        while True:
            blocks = np.maximum(np.ceil((high - low) / (side * BLOCK_SIDE) + 1e-9), 1.0)
            cells = np.where(across, np.maximum(np.floor((high - low) / side), 1.0), BLOCK_SIDE * blocks)
            sides = np.where(across, (high - low) / cells, side)
            blocks = np.ceil(cells / BLOCK_SIDE)
            if np.prod(blocks) * BLOCK_CELLS <= cell_limit or np.all(blocks == 1.0):
                return cls(low, sides, (int(cells[0]), int(cells[1]), int(cells[2])))
            side *= 1.25


def build_cell_number() -> Any:
    """Device function: cell coordinates, and cells along each axis, to the number of the cell in block order."""

    @ti.func
    def cell_number(x, y, z, cells):
        blocks_x, blocks_y = (cells[0] + BLOCK_SIDE - 1) // BLOCK_SIDE, (cells[1] + BLOCK_SIDE - 1) // BLOCK_SIDE
        block = ((z // BLOCK_SIDE) * blocks_y + y // BLOCK_SIDE) * blocks_x + x // BLOCK_SIDE
        inside = ((z % BLOCK_SIDE) * BLOCK_SIDE + y % BLOCK_SIDE) * BLOCK_SIDE + x % BLOCK_SIDE
        return block * BLOCK_CELLS + inside

    return cell_number
