"""What the domain asks of its size, and of the walls in it."""

from collections.abc import Sequence
from math import inf, isinf

import numpy as np

from granflow.errors import SceneError
from granflow.plan.walls import PlannedWall, wall_motions
from granflow.scene import Scene
from granflow.scene.border import AXES, Border
from granflow.walls.catalogue import distance_from, reach_about
from granflow.walls.motion import single_rotation

SAMPLES = 101
"""Points along each side of a face at which walls are compared with those at the opposite face."""

SAME = 1e-3
"""Share of the reach by which the distance of a wall may differ from face to face."""


def refuse_narrow(scene: Scene, radius_max: float, skin: float) -> None:
    """Raise SceneError where a particle could be near two images of another."""
    border, needed = Border.of(scene.domain), 4.0 * radius_max + 2.0 * skin
    more = "" if border.shear is None else ", which is double under shear"
    for axis in border.axes:
        if border.width[axis] < needed:
            raise SceneError(
                f"{scene.place('domain', 'periodic')}: domain.periodic has {AXES[axis]}, along which the domain is "
                f"{border.width[axis]:.4g} m wide, but a particle could touch two images of another there. Make it at "
                f"least {needed:.4g} m wide, two of the largest diameters and twice the skin{more}."
            )


def refuse_walls(scene: Scene, walls: Sequence[PlannedWall], reach: float) -> None:
    """Raise SceneError for a wall that particles within `reach` [m] of it would meet on one side of a border only."""
    border = Border.of(scene.domain)
    for axis in border.axes:
        face = _face(border, axis)
        for wall in walls:
            opposite = face + border.width[axis] * np.eye(3)[axis]
            here, there = (distance_from(wall.shape, points, reach) for points in (face, opposite))
            near = np.minimum(np.abs(here), np.abs(there)) < reach
            if np.any(near & ~(np.abs(here - there) <= SAME * reach)):
                raise SceneError(
                    f"{scene.place('walls', wall.name)}: walls.{wall.name} stands otherwise at one end of the "
                    f"periodic axis {AXES[axis]} than at the other. Let it run straight through from end to end, or "
                    f"keep {reach:.4g} m clear of both."
                )


def refuse_endless_turns(scene: Scene, walls: Sequence[PlannedWall]) -> None:
    """Raise SceneError for an endless wall that turns in a domain that grows: far out it moves as fast as it likes."""
    if scene.domain.leaving != "grow":
        return
    always = {stage.name: (0.0, inf) for stage in scene.schedule}
    for wall, motions in zip(walls, wall_motions(scene, always), strict=True):
        turning = single_rotation(motions)
        if turning and isinf(reach_about(wall.shape, np.array(turning.point), np.array(turning.axis), inf)):
            raise SceneError(
                f"{scene.place('walls', wall.name, 'motion')}: walls.{wall.name} is endless and turns, which cannot be "
                "followed in a domain that grows. Give it an end (shape: rectangle), or let domain.leaving be delete "
                "or error."
            )


def _face(border: Border, axis: int) -> np.ndarray:
    """Points (n, 3) [m] of the low face along an axis, evenly spread."""
    shares = np.linspace(0.0, 1.0, SAMPLES)
    along = [np.zeros(1) if each == axis else shares for each in range(3)]
    return border.low + np.stack(np.meshgrid(*along, indexing="ij"), axis=-1).reshape(-1, 3) * border.width
