"""Periodic faces of the domain, for numpy: what goes out through one comes in through the one opposite."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from granflow.scene.schema import Domain

AXES = "xyz"


@dataclass(frozen=True)
class Border:
    """Which axes of a box are periodic, its low corner (3,) [m] and its widths (3,) [m]."""

    axes: tuple[int, ...]
    low: np.ndarray
    width: np.ndarray

    @classmethod
    def of(cls, domain: Domain) -> "Border":
        """The border of a scene's domain."""
        low, high = np.array(domain.min), np.array(domain.max)
        return cls(tuple(AXES.index(axis) for axis in domain.periodic), low, high - low)

    def wrapped(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 3) [m] moved by whole widths of the box into it."""
        found = np.array(points)
        for axis in self.axes:
            turns = np.floor((found[:, axis] - self.low[axis]) / self.width[axis])
            found[:, axis] -= turns * self.width[axis]
        return found

    def beside(self, points: np.ndarray, others: np.ndarray) -> np.ndarray:
        """Images of points (n, 3) [m] that are nearest to the others (n, 3)."""
        found = np.array(points)
        for axis in self.axes:
            turns = np.round((found[:, axis] - others[:, axis]) / self.width[axis])
            found[:, axis] -= turns * self.width[axis]
        return found

    def with_images(self, position: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Spheres, centres (n, 3) and radii (n,) [m], and the images of those that reach out of the box."""
        for axis in self.axes:
            place = position[:, axis] - self.low[axis]
            below, above = place < radius, place > self.width[axis] - radius
            shift = self.width[axis] * np.eye(3)[axis]
            position = np.concatenate([position, position[below] + shift, position[above] - shift])
            radius = np.concatenate([radius, radius[below], radius[above]])
        return position, radius


def named(axes: Sequence[int]) -> str:
    """Axes as a scene names them, such as "x, y"."""
    return ", ".join(AXES[axis] for axis in axes)
