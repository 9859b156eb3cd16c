"""Periodic faces of the domain, for numpy: what goes out through one comes in through the one opposite."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from granflow.scene.schema import Domain

AXES = "xyz"


@dataclass(frozen=True)
class Shear:
    """Axes of velocity and gradient, velocity of an image over what it is one of [m/s], time when it begins [s]."""

    along: int
    across: int
    speed: float
    start: float


@dataclass(frozen=True)
class Border:
    """Which axes of a box are periodic, its low corner (3,) [m] and its widths (3,) [m].

    `offset` [m]: how far the images above have moved, where the box is sheared; see `at`.
    """

    axes: tuple[int, ...]
    low: np.ndarray
    width: np.ndarray
    shear: Shear | None = None
    offset: float = 0.0

    @classmethod
    def of(cls, domain: Domain) -> "Border":
        """The border of a scene's domain at its start."""
        low, width, given = np.array(domain.min), np.subtract(domain.max, domain.min), domain.shear
        shear = None
        if given is not None:
            along, across = AXES.index(given.velocity_along), AXES.index(given.gradient_along)
            shear = Shear(along, across, given.rate * float(width[across]), given.start)
        return cls(tuple(AXES.index(axis) for axis in domain.periodic), low, width, shear)

    def at(self, time: float) -> "Border":
        """The border at a time [s]."""
        return self if self.shear is None else replace(self, offset=float(self.offsets(np.array([time]))[0]))

    def offsets(self, times: np.ndarray) -> np.ndarray:
        """How far the images above have moved at times (n,) [s], less whole widths of the box (n,) [m]."""
        if self.shear is None:
            return np.zeros(len(times))
        width = self.width[self.shear.along]
        moved = self.shear.speed * np.maximum(times - self.shear.start, 0.0)
        return np.asarray(moved - width * np.round(moved / width))

    def speeds(self, times: np.ndarray) -> np.ndarray:
        """Velocity of the images above at times (n,) [s], (n,) [m/s]."""
        return np.zeros(len(times)) if self.shear is None else np.where(times > self.shear.start, self.shear.speed, 0.0)

    def strain(self, time: float) -> float:
        """Shear strain since the start."""
        return 0.0 if self.shear is None else self.shear.speed * max(time - self.shear.start, 0.0) / self._height

    @property
    def _height(self) -> float:
        assert self.shear is not None
        return float(self.width[self.shear.across])

    def wrapped(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 3) [m] moved by whole widths of the box into it, and by the offset through sheared faces."""
        return self._moved(points, lambda axis, found: np.floor((found - self.low[axis]) / self.width[axis]))[0]

    def brought_in(self, points: np.ndarray, velocity: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Points (n, 3) [m] in the box, and the velocities (n, 3) [m/s] that they have there at a time [s]."""
        found, turns = self.at(time)._moved(
            points, lambda axis, found: np.floor((found - self.low[axis]) / self.width[axis])
        )
        if self.shear is None:
            return found, velocity
        slower = np.array(velocity)
        slower[:, self.shear.along] -= turns * self.speeds(np.array([time]))[0]
        return found, slower

    def beside(self, points: np.ndarray, others: np.ndarray) -> np.ndarray:
        """Images of points (n, 3) [m] that are nearest to the others (n, 3)."""
        return self._moved(points, lambda axis, found: np.round((found - others[:, axis]) / self.width[axis]))[0]

    def _moved(
        self, points: np.ndarray, turns_of: Callable[[int, np.ndarray], np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Points moved by whole turns along every axis, the sheared one first, and the turns along that."""
        found, across = np.array(points), np.zeros(len(points))
        for axis in sorted(self.axes, key=lambda axis: self.shear is None or axis != self.shear.across):
            turns = turns_of(axis, found[:, axis])
            found[:, axis] -= turns * self.width[axis]
            if self.shear is not None and axis == self.shear.across:
                found[:, self.shear.along] -= turns * self.offset
                across = turns
        return found, across

    def with_images(self, position: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Spheres, centres (n, 3) and radii (n,) [m], and the images of those that reach out of the box."""
        for axis in self.axes:
            place = position[:, axis] - self.low[axis]
            below, above = place < radius, place > self.width[axis] - radius
            shift = self.width[axis] * np.eye(3)[axis]
            position = np.concatenate([position, position[below] + shift, position[above] - shift])
            radius = np.concatenate([radius, radius[below], radius[above]])
        return position, radius
