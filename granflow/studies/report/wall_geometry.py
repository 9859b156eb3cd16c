"""Triangles and visible edges of walls for the 3D view."""

from typing import NamedTuple

import numpy as np

from granflow.studies.render.frames import FrameWalls

EDGE_ANGLE = np.radians(25.0)
"""Angle between two facets of a wall above which their edge is drawn [rad]."""


class WallGeometry(NamedTuple):
    """Points (m, 3) [m], triangles (k, 3) and edges (e, 2) as indices of points."""

    points: np.ndarray
    triangles: np.ndarray
    edges: np.ndarray


def geometry_of(walls: FrameWalls) -> WallGeometry:
    """Triangles of all polygons, with equal points merged, and the edges at their borders and sharp bends.

    The walls have at least one polygon.
    """
    corners = np.concatenate([np.zeros(0, np.int64), *(each.ravel() for each in walls.polygons)])
    points, index = np.unique(walls.points[corners].astype(np.float32), axis=0, return_inverse=True)
    ends = np.cumsum([each.size for each in walls.polygons])
    parts = np.split(index.reshape(-1), ends[:-1])
    polygons = [_with_area(part.reshape(each.shape)) for part, each in zip(parts, walls.polygons, strict=True)]
    fans = [each[:, [0, k, k + 1]] for each in polygons for k in range(1, each.shape[1] - 1)]
    sides = [each[:, [k, (k + 1) % each.shape[1]]] for each in polygons for k in range(each.shape[1])]
    normals = [_normals(points, each) for each in polygons for _ in range(each.shape[1])]
    return WallGeometry(points, np.concatenate(fans), _sharp_edges(np.concatenate(sides), np.concatenate(normals)))


def _with_area(polygons: np.ndarray) -> np.ndarray:
    """The polygons (k, n) with at least three different corners; a disc without a hole has others at its center."""
    found: np.ndarray = polygons[np.array([len(set(each)) > 2 for each in polygons.tolist()], dtype=bool)]
    return found


def _normals(points: np.ndarray, polygons: np.ndarray) -> np.ndarray:
    """Unit normals (k, 3) of polygons (k, n); zero for a polygon without area."""
    corners = points[polygons].astype(np.float64)
    corners -= corners[:, :1]
    normal = np.cross(corners, np.roll(corners, -1, axis=1)).sum(axis=1)  # twice the area, also with equal corners
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(float).tiny)


def _sharp_edges(sides: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Edges (e, 2) of sides (s, 2) of polygons with their normals (s, 3): borders, and bends above EDGE_ANGLE.

    The winding of polygons is arbitrary, so that the sign of a normal does not matter.
    """
    sides = np.sort(sides, axis=1)
    order = np.lexsort((sides[:, 1], sides[:, 0]))
    sides, normals = sides[order], normals[order]
    repeats = np.all(sides[1:] == sides[:-1], axis=1)
    is_flat = repeats & (np.abs(np.sum(normals[1:] * normals[:-1], axis=1)) > np.cos(EDGE_ANGLE))
    hidden = np.append(is_flat, False) | np.append(False, is_flat)
    edges: np.ndarray = np.unique(sides[~hidden & (sides[:, 0] != sides[:, 1])], axis=0)
    return edges
