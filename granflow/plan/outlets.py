"""Outlets in numeric form: a box, a half space or a disc, in which particles are deleted.

The device tests at neighbor-list rebuilds whether a particle is inside an outlet. The host finds the outlet
that has deleted a particle by its depth in each of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Literal

import numpy as np

from granflow.scene.blocks.domain import BoxOutlet, DiscOutlet, Outlet


@dataclass(frozen=True)
class PlannedOutlet:
    """One outlet: a box, or the region behind a plane and within `radius` [m] of an axis.

    `low`, `high` (3,) [m]: corners of the box, or None. `point` (3,) [m], `normal` (3,), unit vector: of the
    plane; the region is on the side to which the normal points. `radius` [m]: infinite for a half space and a
    box.
    """

    name: str
    low: np.ndarray | None
    high: np.ndarray | None
    point: np.ndarray
    normal: np.ndarray
    radius: float

    @property
    def kind(self) -> Literal["box", "half_space", "disc"]:
        """Kind of the region."""
        if self.low is not None:
            return "box"
        return "disc" if self.radius < inf else "half_space"

    def depth(self, points: np.ndarray) -> np.ndarray:
        """Depth [m] (n,) of points (n, 3) [m] inside the outlet: distance from its surface, negative outside.

        Outside near an edge, the absolute value is a lower bound of the distance.
        """
        if self.low is not None and self.high is not None:
            return np.asarray(np.minimum(points - self.low, self.high - points).min(axis=1))
        along = (points - self.point) @ self.normal
        across = np.linalg.norm(points - self.point - along[:, None] * self.normal, axis=1)
        return np.asarray(np.minimum(along, self.radius - across))


def planned_outlets(outlets: Mapping[str, Outlet]) -> tuple[PlannedOutlet, ...]:
    """All outlets of a scene, in its order, with normals of unit length."""
    planned = []
    for name, outlet in outlets.items():
        if isinstance(outlet, BoxOutlet):
            low = np.array(outlet.box.min)
            high = np.array(outlet.box.max)
            planned.append(PlannedOutlet(name, low, high, low, np.zeros(3), inf))
        elif isinstance(outlet, DiscOutlet):
            disc = outlet.disc
            planned.append(_behind_plane(name, disc.center, disc.normal, disc.radius))
        else:
            planned.append(_behind_plane(name, outlet.half_space.point, outlet.half_space.normal, inf))
    return tuple(planned)


def _behind_plane(name: str, point: Sequence[float], normal: Sequence[float], radius: float) -> PlannedOutlet:
    """The outlet behind a plane through `point` [m], within `radius` [m] of the axis along `normal`."""
    direction = np.array(normal)
    return PlannedOutlet(name, None, None, np.array(point), direction / np.linalg.norm(direction), radius)


def outlet_of(outlets: Sequence[PlannedOutlet], position: np.ndarray, in_domain: np.ndarray) -> np.ndarray:
    """Index of the outlet that deleted each particle (n,), -1 for none: the outlet with the largest depth.

    `position` (n, 3) [m]; `in_domain` (n,) bool. A deleted particle inside the domain is always in an outlet,
    except for rounding. The order of the outlets decides between equal depths.
    """
    if not outlets:
        return np.full(len(position), -1)
    depth = np.stack([outlet.depth(position) for outlet in outlets])
    return np.where(in_domain | (depth.max(axis=0) >= 0.0), depth.argmax(axis=0), -1)
