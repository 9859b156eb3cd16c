"""Fills the device arrays of mesh walls, which `engine/mesh.py` reads.

The names are those of MeshAdjacency and MeshGrid; `wall` is the wall of each triangle, `first_cell` the first cell of
each wall. Triangles, points and cells are numbered consecutively over all meshes; edge k of triangle t is 3 t + k.
Lengths are in m, in the precision of positions.
"""

from typing import Any

import numpy as np

from granflow.engine.field_block import write_padded
from granflow.geometry.mesh.adjacency import MeshAdjacency
from granflow.plan.plan import Plan


def fill_mesh(fields: Any, plan: Plan) -> None:
    """Write all arrays; they do not change during a run."""
    meshes = plan.meshes
    arrays = _of_triangles([mesh.adjacency for mesh in meshes.values()]) | _of_grids(plan)
    arrays["wall"] = np.repeat(list(meshes), [mesh.triangle_count for mesh in meshes.values()])
    for name, values in arrays.items():
        write_padded(getattr(fields, name), values)


def _of_triangles(adjacency: list[MeshAdjacency]) -> dict[str, np.ndarray]:
    """Concatenated arrays of all meshes; indices are shifted by the number of preceding entries."""
    triangles = np.cumsum([0, *(len(each.normal) for each in adjacency)])
    points = np.cumsum([0, *(len(each.owner) for each in adjacency)])

    def joined(name: str, *width: int) -> np.ndarray:
        return np.concatenate([getattr(each, name).reshape(-1, *width) for each in adjacency])

    def shifted(name: str, before: np.ndarray) -> np.ndarray:
        return np.concatenate([getattr(each, name).reshape(-1) + n for each, n in zip(adjacency, before, strict=False)])

    vectors, numbers = (
        ("normal", "vertex", "edge_direction", "inward", "inward_other", "vertex_edge"),
        ("length", "base", "owns_tie", "role"),
    )
    found = {name: joined(name, 3) for name in vectors} | {name: joined(name) for name in (*numbers, "longest")}
    found["point"] = shifted("point", points)
    found |= {name: shifted(name, triangles) for name in ("owner", "competitor")}
    for name in ("vertex_edge_start", "competitor_start"):
        found[name] = _starts([getattr(each, name) for each in adjacency])
    return found


def _starts(starts: list[np.ndarray]) -> np.ndarray:
    """Row starts of concatenated tables; each given array has one entry more than rows."""
    counts = np.concatenate([np.diff(each) for each in starts])
    return np.concatenate([[0], np.cumsum(counts)])


def _of_grids(plan: Plan) -> dict[str, np.ndarray]:
    """Arrays of all grids; walls without a mesh have no cells."""
    wall_count = len(plan.walls)
    low, side, shape = np.zeros((wall_count, 3)), np.ones(wall_count), np.zeros((wall_count, 3), np.int64)
    first_cell, cells, triangles, cell_triangles = np.zeros(wall_count, np.int64), 0, 0, []
    for w, grid in plan.mesh_grids.items():
        low[w], side[w], shape[w], first_cell[w] = grid.low, grid.side, grid.shape, cells
        cell_triangles.append(grid.triangle + triangles)
        cells, triangles = cells + len(grid.start) - 1, triangles + plan.meshes[w].triangle_count
    start = _starts([grid.start for grid in plan.mesh_grids.values()])
    return {
        "low": low, "side": side, "shape": shape, "first_cell": first_cell, "cell_start": start,
        "cell_triangles": np.concatenate(cell_triangles),
    }  # fmt: skip
