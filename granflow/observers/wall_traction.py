"""Instantaneous traction and pressure on the triangles of walls, for VTU files."""

from collections.abc import Mapping

import numpy as np


def traction_and_pressure(
    contacts: Mapping[str, np.ndarray], wall: int, areas: np.ndarray, area: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return force over area (k, 3) and normal force over area (k,) [Pa] of the particles on each triangle of a wall.

    `contacts`: as in a Snapshot, with `wall`, `force`, `normal_force` and `triangle`; `wall`: index of the wall in the
    scene; `areas` (k,) [m2] of its triangles; `area` [m2] of the whole wall, None if infinite. For a mesh, the values
    are those of each triangle; for another shape, the mean over the whole wall (NaN if infinite). The traction is that
    of the particles on the wall; the pressure is positive in compression.
    """
    on_wall = contacts["wall"] == wall
    force, normal_force, triangle = (
        -contacts["force"][on_wall],
        contacts["normal_force"][on_wall],
        contacts["triangle"][on_wall],
    )
    if len(triangle) == 0 or triangle[0] < 0:
        total_area = np.nan if area is None else area
        mean, pressure = force.sum(axis=0) / total_area, normal_force.sum() / total_area
        return np.broadcast_to(mean, (len(areas), 3)).copy(), np.full(len(areas), pressure)
    traction = np.stack([np.bincount(triangle, component, len(areas)) for component in force.T], axis=1)
    return traction / areas[:, None], np.bincount(triangle, normal_force, len(areas)) / areas
