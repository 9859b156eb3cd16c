"""Rectangle: a thin, flat, two-sided plate.

Where rectangles touch each other or other walls, `engine.walls.JoinedWalls` finds the one that has a
contact.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import hypot
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from granflow.device_functions import ti
from granflow.geometry.surface import AnalyticSurface, Surface, Vector
from granflow.geometry.vectors import are_perpendicular, is_parallel, unit
from granflow.scene.blocks.primitives import Rectangular
from granflow.scene.blocks.walls.wall import Wall


class Rectangle(Rectangular, Wall):
    """A thin, flat, two-sided rectangle with the corner and the two edge vectors [m].

    >>> gf.Rectangle(material="steel", corner=[0, 0, 0], sides=[["5 cm", 0, 0], [0, "5 cm", 0]]).sides
    ((0.05, 0.0, 0.0), (0.0, 0.05, 0.0))
    """

    shape: Literal["rectangle"] = Field("rectangle", description="shape of the wall")

    def surface(self, folder: Path) -> Surface:
        """See `Wall`."""
        return rectangle(self.corner, *self.sides)

    def dimensions(self) -> Iterator[tuple[str, float]]:
        """The longer side."""
        yield "sides", max(hypot(*each) for each in self.sides)


def rectangle(corner: object, side1: Sequence[float], side2: Sequence[float]) -> "Plate":
    """Two-sided thin plate from a corner along two perpendicular edge vectors.

    corner:        (3,) [m]
    side1, side2:  (3,) [m] edge vectors
    Raises:        ValueError if the sides are not perpendicular (RIGHT_ANGLE_COSINE), or if a side has no
                   length

    The second direction is made exactly perpendicular to the first; the lengths remain those of the edge
    vectors.
    """
    if not are_perpendicular(side1, side2):
        raise ValueError("The sides of a rectangle must be perpendicular.")
    direction1 = unit(side1)
    direction2 = unit(side2)
    direction2 = unit(direction2 - float(direction1 @ direction2) * direction1)
    length1, length2 = (float(np.linalg.norm(np.asarray(side, dtype=float))) for side in (side1, side2))
    normal = np.cross(direction1, direction2)
    return Plate(np.asarray(corner), direction1, direction2, normal, length1, length2)


@dataclass(frozen=True, eq=False)
class Plate(AnalyticSurface):
    """A corner, three perpendicular unit vectors, of which two are along the sides, and their lengths."""

    kind: ClassVar[str] = "rectangle"

    corner: Vector
    direction1: Vector
    direction2: Vector
    normal: Vector
    length1: float
    length2: float

    @staticmethod
    @ti.func
    def contact(point, numbers):
        """Distance [m] from the rectangle and unit vector from its nearest point.

        At distance 0 the unit vector is the normal of the plane.
        """
        beyond = Plate.coordinates(point, numbers)
        distance = beyond.norm()
        on_surface = distance == 0.0
        divisor = ti.select(on_surface, 1.0, distance)
        component1 = beyond[0] / divisor
        component2 = beyond[1] / divisor
        component3 = ti.select(on_surface, 1.0, beyond[2] / divisor)
        normal = (
            component1 * numbers.direction1 + component2 * numbers.direction2 + component3 * numbers.normal
        )
        return distance, normal

    @staticmethod
    @ti.func
    def face_normal(point, numbers):
        """See `AnalyticSurface`."""
        return numbers.normal

    @staticmethod
    @ti.func
    def distance(point, numbers):
        """Distance from the rectangle [m], at least 0."""
        return Plate.coordinates(point, numbers).norm()

    @staticmethod
    @ti.func
    def coordinates(point, numbers):
        """Vector from the nearest point of the rectangle to the point, in the frame of the rectangle [m].

        Components: distance beyond the edges along both sides (0 above the face), and height above the face.
        """
        offset = point - numbers.corner
        along1 = offset.dot(numbers.direction1)
        along2 = offset.dot(numbers.direction2)
        height = offset.dot(numbers.normal)
        beyond1 = along1 - ti.min(ti.max(along1, 0.0), numbers.length1)
        beyond2 = along2 - ti.min(ti.max(along2, 0.0), numbers.length2)
        return ti.Vector([beyond1, beyond2, height])

    def contacts(
        self, points: np.ndarray, triangles: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The nearest point, then the vector from it."""
        frame = np.array([self.direction1, self.direction2])
        along = np.clip((points - self.corner) @ frame.T, 0.0, [self.length1, self.length2])
        from_surface = points - (self.corner + along @ frame)
        distance = np.linalg.norm(from_surface, axis=1)
        on_surface = distance == 0.0
        normal = from_surface / np.where(on_surface, 1.0, distance)[:, None]
        normal[on_surface] = np.cross(frame[0], frame[1])
        return distance, normal

    @property
    def area(self) -> float:
        """See `Surface`."""
        return self.length1 * self.length2

    def triangles(self, center: Vector, extent: float) -> tuple[np.ndarray, np.ndarray]:
        """Points (4, 3) [m] and triangles (2, 3)."""
        return quadrilateral(self.corner, self.direction1 * self.length1, self.direction2 * self.length2)

    def is_upright(self, point: Vector, normal: Vector, tolerance: float) -> bool:
        """Whether one side is along the normal."""
        return is_parallel(self.direction1, normal) or is_parallel(self.direction2, normal)


def quadrilateral(corner: Vector, side1: Vector, side2: Vector) -> tuple[np.ndarray, np.ndarray]:
    """Points (4, 3) [m] and triangles (2, 3) of the parallelogram with a corner and two sides."""
    points = np.array([corner, corner + side1, corner + side1 + side2, corner + side2])
    return points, np.array([[0, 1, 2], [0, 2, 3]])
