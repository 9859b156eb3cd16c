"""What the grains do to each triangle of the walls at one moment, for pictures of the walls."""

from collections.abc import Mapping

import numpy as np


def traction_and_pressure(
    contacts: Mapping[str, np.ndarray], wall: int, areas: np.ndarray, area: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Force over area (k, 3) and normal force over area (k,) [Pa] that grains exert on each triangle of a wall.

    `contacts`: as in a Snapshot; `wall`: index of the wall in the scene; `areas` (k,) [m2] of its triangles; `area`
    [m2] of all of it, None where it has no end. A mesh has what acts on each of its triangles; a shape that is drawn
    with triangles, and has none, the mean over all of it (not a number where it has no end).
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
