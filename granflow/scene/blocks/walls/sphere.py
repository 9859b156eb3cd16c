"""Spherical wall: a thin shell, with particles inside, outside, or both."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from granflow.device_functions import ti
from granflow.geometry.surface import AnalyticSurface, Surface, Vector
from granflow.geometry.vectors import distance_from_axis
from granflow.scene.blocks.walls.wall import Wall
from granflow.schema import quantities as q

FACETS_AROUND = 48
"""Facets around the axis of the visualization; half as many from pole to pole."""


class Sphere(Wall):
    """A thin spherical shell with particles inside, outside, or both.

    >>> gf.Sphere(material="steel", center=[0, 0, 0], radius="5 cm").radius
    0.05
    """

    shape: Literal["sphere"] = Field("sphere", description="shape of the wall")
    center: q.Point = Field(description="center [m]")
    radius: q.PositiveLength = Field(description="radius [m]")

    def surface(self, folder: Path) -> Surface:
        """See `Wall`."""
        return sphere(self.center, self.radius)

    def dimensions(self) -> Iterator[tuple[str, float]]:
        """Radius."""
        yield "radius", self.radius


def sphere(center: object, radius: float) -> "SphericalShell":
    """Thin two-sided spherical shell.

    center:  (3,) [m]
    radius:  [m]
    Raises:  ValueError if the radius is not above 0 or a number is not finite
    """
    if not radius > 0.0:
        raise ValueError("The radius of a sphere must be above zero.")
    return SphericalShell(np.asarray(center), radius)


@dataclass(frozen=True, eq=False)
class SphericalShell(AnalyticSurface):
    """Center and radius."""

    kind: ClassVar[str] = "sphere"
    is_curved: ClassVar[bool] = True

    center: Vector
    radius: float

    @staticmethod
    @ti.func
    def contact(point, numbers):
        """Distance [m] from the shell, and the unit vector toward the point.

        d = | |x - c| - R |,    n = +- (x - c) / |x - c|, outward for a point outside
        """
        outward = SphericalShell.face_normal(point, numbers)
        height = (point - numbers.center).norm() - numbers.radius
        return ti.abs(height), ti.select(height < 0.0, -1.0, 1.0) * outward

    @staticmethod
    @ti.func
    def face_normal(point, numbers):
        """Unit vector from the center to the point; at the center a fixed one."""
        offset = point - numbers.center
        length = offset.norm()
        zero = length * 0.0
        is_center = length == 0.0
        direction = ti.select(is_center, ti.Vector([zero, zero, zero + 1.0]), offset)
        return direction / ti.select(is_center, zero + 1.0, length)

    @staticmethod
    @ti.func
    def distance(point, numbers):
        """Distance from the shell [m]."""
        return ti.abs((point - numbers.center).norm() - numbers.radius)

    def contacts(
        self, points: np.ndarray, triangles: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Measure along the radius."""
        offset = points - self.center
        length = np.linalg.norm(offset, axis=1)
        offset[length == 0.0] = [0.0, 0.0, 1.0]
        outward = offset / np.where(length == 0.0, 1.0, length)[:, None]
        height = length - self.radius
        return np.abs(height), np.where(height < 0.0, -1.0, 1.0)[:, None] * outward

    @property
    def area(self) -> float:
        """Area [m2] of one side."""
        return 4.0 * np.pi * self.radius**2

    def sides(self, points: np.ndarray) -> np.ndarray:
        """See `Surface`."""
        return np.where(np.linalg.norm(points - self.center, axis=1) < self.radius, 1, -1)

    def farthest_from(self, point: Vector, axis: Vector) -> float:
        """Distance [m] of the farthest point from the axis."""
        return float(distance_from_axis(self.center, point, axis)[0]) + self.radius

    def turns_in_place(self, point: Vector, axis: Vector) -> bool:
        """Whether the axis passes through the center."""
        return bool(distance_from_axis(self.center, point, axis)[0] <= 1e-9 * self.radius)

    def triangles(self, center: Vector, extent: float) -> tuple[np.ndarray, np.ndarray]:
        """Points and triangles of facets between circles of latitude about z."""
        count = FACETS_AROUND
        rings = count // 2
        polar = np.pi * np.arange(1, rings) / rings
        azimuth = 2.0 * np.pi * np.arange(count) / count
        around = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(count)], axis=1)
        between = np.sin(polar)[:, None, None] * around + np.cos(polar)[:, None, None] * np.eye(3)[2]
        poles = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
        index = np.arange((rings - 1) * count).reshape(rings - 1, count)
        after = np.roll(index, -1, axis=1)
        south = index.size + 1
        faces = [
            np.stack([np.full(count, south - 1), index[0], after[0]], axis=-1),
            np.stack([index[:-1], index[1:], after[1:]], axis=-1).reshape(-1, 3),
            np.stack([index[:-1], after[1:], after[:-1]], axis=-1).reshape(-1, 3),
            np.stack([np.full(count, south), after[-1], index[-1]], axis=-1),
        ]
        points = np.concatenate([between.reshape(-1, 3), poles])
        return self.center + self.radius * points, np.concatenate(faces)

    def enclosing_points(self) -> np.ndarray:
        """Corners of the enclosing cube."""
        return np.array([self.center - self.radius, self.center + self.radius])
