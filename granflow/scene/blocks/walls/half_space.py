"""Plane: the boundary of a half space, one-sided and infinite."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from granflow.device_functions import ti
from granflow.geometry.periodic_box import AXES
from granflow.geometry.surface import AnalyticSurface, Surface, Vector
from granflow.geometry.vectors import is_parallel, unit
from granflow.scene.blocks.domain import Domain
from granflow.scene.blocks.walls.rectangle import quadrilateral
from granflow.scene.blocks.walls.wall import Wall
from granflow.schema import quantities as q


class Plane(Wall):
    """An infinite plane; the half space behind it is solid, the particles are on the side of the normal.

    Its area is infinite: it has forces, but no pressure. In a domain that is periodic along two axes, a plane
    across the third has the area of the section of the domain.

    >>> gf.Plane(material="steel", point=[0, 0, 0], normal=[0, 0, 1])
    Plane(material='steel', point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0))
    """

    is_bounded: ClassVar[bool] = False

    shape: Literal["plane"] = Field("plane", description="shape of the wall")
    point: q.Point = Field(description="a point on the plane [m]")
    normal: q.Direction = Field(description="normal, toward the particles; its length does not matter")

    def surface(self, folder: Path) -> Surface:
        """See `Wall`."""
        return half_space(self.point, self.normal)

    def periodic_area(self, domain: Domain) -> float | None:
        """See `Wall`."""
        other = [k for k, axis in enumerate(AXES) if axis not in domain.periodic]
        if len(other) != 1 or not is_parallel(np.asarray(self.normal), np.eye(3)[other[0]]):
            return None
        width = np.subtract(domain.max, domain.min)
        return float(np.prod(np.delete(width, other[0])))


def half_space(point: object, normal: object) -> "HalfSpace":
    """Half space: solid behind the plane through `point`; particles are on the side of `normal`.

    point:   (3,) [m]
    normal:  (3,), any length above 0
    Raises:  ValueError if the normal has no direction or a number is not finite
    """
    return HalfSpace(np.asarray(point), unit(normal))


@dataclass(frozen=True, eq=False)
class HalfSpace(AnalyticSurface):
    """A point of the plane and its unit normal."""

    kind: ClassVar[str] = "half_space"

    point: Vector
    normal: Vector

    @staticmethod
    @ti.func
    def contact(x, numbers):
        """Signed distance from the plane and normal of the plane.

            d = (x - p) . n

        Returns:  d [m], negative behind the plane; n
        """
        return HalfSpace.distance(x, numbers), numbers.normal

    @staticmethod
    @ti.func
    def face_normal(x, numbers):
        """See `AnalyticSurface`."""
        return numbers.normal

    @staticmethod
    @ti.func
    def distance(x, numbers):
        """Signed distance from the plane [m]."""
        return (x - numbers.point).dot(numbers.normal)

    def contacts(
        self, points: np.ndarray, triangles: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Project the point, measure along the normal."""
        distance = (points - self.point) @ self.normal
        return distance, np.broadcast_to(self.normal, points.shape).copy()

    @property
    def plane(self) -> tuple[Vector, Vector]:
        """See `Surface`."""
        return self.point, self.normal

    @property
    def area(self) -> None:
        """None."""
        return None

    def farthest_from(self, point: Vector, axis: Vector) -> float:
        """Infinite."""
        return float("inf")

    def turns_in_place(self, point: Vector, axis: Vector) -> bool:
        """Whether the axis is along the normal."""
        return is_parallel(self.normal, axis)

    def triangles(self, center: Vector, extent: float) -> tuple[np.ndarray, np.ndarray]:
        """Square of half width `extent` [m] about the projection of `center` (3,) [m] on the plane."""
        foot = np.asarray(center) - ((np.asarray(center) - self.point) @ self.normal) * self.normal
        side1 = unit(np.cross(self.normal, np.eye(3)[np.argmin(np.abs(self.normal))]))
        side2 = np.cross(self.normal, side1)
        return quadrilateral(foot - extent * (side1 + side2), 2 * extent * side1, 2 * extent * side2)
