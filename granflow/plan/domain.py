"""Checks of the domain: size of periodic boxes, and walls that cross periodic boundaries."""

from collections.abc import Sequence
from math import inf, isinf

import numpy as np

from granflow.errors import SceneError
from granflow.geometry.catalog import distance_from, reach_about
from granflow.geometry.motion import single_rotation
from granflow.geometry.periodic_box import AXES, PeriodicBox
from granflow.load import Scene
from granflow.plan.walls import PlannedWall, always

SAMPLES = 101
"""Points along each side of a face at which walls are compared with those at the opposite face."""

DISTANCE_TOLERANCE = 1e-3
"""Tolerance for the difference of wall distances between opposite faces, relative to the reach."""


def refuse_narrow_box(scene: Scene, radius_max: float, skin: float) -> None:
    """Raise SceneError if a particle can be a candidate partner of two images of another.

    The width along each periodic axis must be at least 4 radius_max + 2 skin. `radius_max`, `skin` [m]; under
    Lees-Edwards shear, give twice the skin.
    """
    periodic_box, needed = scene.domain.periodic_box(), 4.0 * radius_max + 2.0 * skin
    remark = "" if periodic_box.image_motion is None else ", which is double under shear"
    for axis in periodic_box.axes:
        if periodic_box.width[axis] < needed:
            raise SceneError(
                f"{scene.locate('domain', 'periodic')}: domain.periodic has {AXES[axis]}, along which the domain is "
                f"{periodic_box.width[axis]:.4g} m wide, but a particle could be in contact with two images of another "
                f"one. Make it at least {needed:.4g} m wide, which is two of the largest diameters and twice the "
                f"skin{remark}."
            )


def refuse_cut_walls(scene: Scene, walls: Sequence[PlannedWall], reach: float) -> None:
    """Raise SceneError for a wall within `reach` [m] of a periodic boundary that does not continue across it.

    The distance from the wall is compared at SAMPLES x SAMPLES points of opposite faces, with the wall at rest.
    `reach`: largest radius plus skin.
    """
    periodic_box = scene.domain.periodic_box()
    for axis in periodic_box.axes:
        face = _face(periodic_box, axis)
        for wall in walls:
            opposite = face + periodic_box.width[axis] * np.eye(3)[axis]
            distance_low, distance_high = (distance_from(wall.shape, points, reach) for points in (face, opposite))
            is_near = np.minimum(np.abs(distance_low), np.abs(distance_high)) < reach
            if np.any(is_near & ~(np.abs(distance_low - distance_high) <= DISTANCE_TOLERANCE * reach)):
                raise SceneError(
                    f"{scene.locate('walls', wall.name)}: walls.{wall.name} differs between the two ends of the "
                    f"periodic axis {AXES[axis]}. Extend it straight from end to end, or keep a distance of "
                    f"{reach:.4g} m from both."
                )


def refuse_infinite_rotations(scene: Scene, walls: Sequence[PlannedWall]) -> None:
    """Raise SceneError for an unbounded rotating wall in an expanding domain: its velocity has no upper bound."""
    if scene.domain.on_exit != "expand":
        return
    times = always(scene.schedule)
    for wall in walls:
        rotation = single_rotation([each.at(times) for each in wall.motions])
        if rotation and isinf(reach_about(wall.shape, np.array(rotation.point), np.array(rotation.axis), inf)):
            raise SceneError(
                f"{scene.locate('walls', wall.name, 'motion')}: walls.{wall.name} is unbounded and rotates, which "
                "is not supported in a domain that expands. Use a bounded shape (shape: rectangle), or set "
                "domain.on_exit to delete or error."
            )


def _face(periodic_box: PeriodicBox, axis: int) -> np.ndarray:
    """Uniformly spaced points (SAMPLES^2, 3) [m] on the low face along an axis (0, 1 or 2)."""
    shares = np.linspace(0.0, 1.0, SAMPLES)
    coordinates = [np.zeros(1) if each == axis else shares for each in range(3)]
    return (
        periodic_box.low
        + np.stack(np.meshgrid(*coordinates, indexing="ij"), axis=-1).reshape(-1, 3) * periodic_box.width
    )
