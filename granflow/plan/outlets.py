"""Outlets in plain numbers, and how deep in one a point is, for numpy; the device knows only in or out."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from granflow.scene import Scene
from granflow.scene.outlets import BoxOutlet, DiscOutlet


@dataclass(frozen=True)
class PlannedOutlet:
    """One outlet: a box, or what lies within `radius` [m] of an axis beyond a plane.

    low, high (3,) [m]: corners of the box, or None.  point (3,) [m], normal (3,) of length 1: of the plane.
    """

    name: str
    low: np.ndarray | None
    high: np.ndarray | None
    point: np.ndarray
    normal: np.ndarray
    radius: float

    def depth(self, points: np.ndarray) -> np.ndarray:
        """How far inside the points (n, 3) are [m], below 0 outside."""
        if self.low is not None and self.high is not None:
            return np.asarray(np.minimum(points - self.low, self.high - points).min(axis=1))
        along = (points - self.point) @ self.normal
        across = np.linalg.norm(points - self.point - along[:, None] * self.normal, axis=1)
        return np.asarray(np.minimum(along, self.radius - across))


def planned_outlets(scene: Scene) -> tuple[PlannedOutlet, ...]:
    """All outlets of a scene."""
    outlets = []
    for name, outlet in scene.outlets.items():
        if isinstance(outlet, BoxOutlet):
            low, high = np.array(outlet.box.min), np.array(outlet.box.max)
            outlets.append(PlannedOutlet(name, low, high, low, np.zeros(3), inf))
        elif isinstance(outlet, DiscOutlet):
            disc = outlet.disc
            outlets.append(_behind_plane(name, disc.center, disc.normal, disc.radius))
        else:
            outlets.append(_behind_plane(name, outlet.half_space.point, outlet.half_space.normal, inf))
    return tuple(outlets)


def _behind_plane(name: str, point: Sequence[float], normal: Sequence[float], radius: float) -> PlannedOutlet:
    """The outlet behind a plane through `point` [m], within `radius` [m] of the axis along `normal`."""
    direction = np.array(normal)
    return PlannedOutlet(name, None, None, np.array(point), direction / np.linalg.norm(direction), radius)


def outlet_of(outlets: Sequence[PlannedOutlet], position: np.ndarray, in_domain: np.ndarray) -> np.ndarray:
    """Which outlet took each deleted particle (n,), -1 for none: the one it is deepest in.

    `position` (n, 3) [m]; what is still in the domain (n,) was taken by one, be it by rounding.
    """
    if not outlets:
        return np.full(len(position), -1)
    depth = np.stack([outlet.depth(position) for outlet in outlets])
    return np.where(in_domain | (depth.max(axis=0) >= 0.0), depth.argmax(axis=0), -1)
