"""Periodic boundaries on the host (numpy): wrapping, images, Lees-Edwards shear, deformation."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

AXES = "xyz"
"""Names of the axes 0, 1 and 2."""


@dataclass(frozen=True)
class ImageMotion:
    """Lees-Edwards shear: flow and gradient axes (0 to 2), velocity of the image above [m/s], start time [s].

    The velocity is the shear rate times the width of the box along the gradient axis.
    """

    flow: int
    gradient: int
    speed: float
    start: float


class LinePiece(NamedTuple):
    """Pieces inside the box of some of n lines, of which they are the shares from `begin` to `until`.

    rows:           indices (k,) of the lines
    start, end:     (k, 3) [m]
    begin, until:   (k,), or a number for all
    """

    rows: np.ndarray
    start: np.ndarray
    end: np.ndarray
    begin: np.ndarray | float
    until: np.ndarray | float


@dataclass(frozen=True)
class PeriodicBox:
    """Periodic axes of a box, its lower corner (3,) [m] and its widths (3,) [m].

    `axes`: 0 to 2 for x to z. `offset` [m]: displacement of the image above in a Lees-Edwards box, along the
    flow axis; see `at`. (A. W. Lees, S. F. Edwards, J. Phys. C 5 (1972) 1921.) `width_velocity` (3,) [m/s]:
    rate of change of the widths of a deforming box.
    """

    axes: tuple[int, ...]
    low: np.ndarray
    width: np.ndarray
    image_motion: ImageMotion | None = None
    offset: float = 0.0
    width_velocity: np.ndarray | None = None

    def at(self, time: float) -> "PeriodicBox":
        """The periodic box at a time [s]."""
        if self.image_motion is None:
            return self
        return replace(self, offset=float(self.offsets(np.array([time]))[0]))

    def offsets(self, times: np.ndarray) -> np.ndarray:
        """Displacements (n,) [m] of the image above at times (n,) [s], in [-width/2, width/2].

        The displacement is periodic with the width of the box along the flow axis.
        """
        if self.image_motion is None:
            return np.zeros(len(times))
        width = self.width[self.image_motion.flow]
        moved = self.image_motion.speed * np.maximum(times - self.image_motion.start, 0.0)
        return np.asarray(moved - width * np.round(moved / width))

    def speeds(self, times: np.ndarray) -> np.ndarray:
        """Velocities (n,) [m/s] of the image above at times (n,) [s]; 0 up to the start of the shear."""
        motion = self.image_motion
        return np.zeros(len(times)) if motion is None else np.where(times > motion.start, motion.speed, 0.0)

    def strain(self, time: float) -> float:
        """Shear strain at a time [s]: shear rate times the time since the start of the shear.

        Negative for a negative shear rate, 0 without shear.
        """
        motion = self.image_motion
        if motion is None:
            return 0.0
        return motion.speed * max(time - motion.start, 0.0) / float(self.width[motion.gradient])

    def wrap(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 3) [m] wrapped into the box; Lees-Edwards faces also shift them by the offset.

        Each periodic coordinate is then in [low, low + width), except for rounding; the input is not
        modified.
        """
        return self._shifted(points, self._counts_from_low)[0]

    def _counts_from_low(self, axis: int, shifted: np.ndarray) -> np.ndarray:
        return np.asarray(np.floor((shifted - self.low[axis]) / self.width[axis]))

    def wrap_with_velocity(
        self, points: np.ndarray, velocity: np.ndarray, time: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Points (n, 3) [m] wrapped into the box, and their velocities (n, 3) [m/s] in it, at a time [s].

        A point that crosses a Lees-Edwards face upward gets the velocity v - speed along the flow axis, one
        that crosses a face of a deforming box upward v - width_velocity along its normal.
        """
        box = self.at(time)
        shifted, image_counts = box._shifted(points, box._counts_from_low)
        return shifted, box._velocity_of_images(points, shifted, image_counts, velocity, time)

    def nearest_images(self, points: np.ndarray, references: np.ndarray) -> np.ndarray:
        """Periodic images (n, 3) [m] of points nearest to the reference points (n, 3), row by row."""
        return self._nearest(points, references)[0]

    def pieces(self, start: np.ndarray, end: np.ndarray, near: np.ndarray) -> Iterator[LinePiece]:
        """Cut lines at the periodic faces, in the order of each line; without shear and deformation.

        A line goes from a point of the box to the image of another, `end`, nearest to a third, `near`; all
        (n, 3) [m]. It goes on at the opposite face, and its last piece ends at the point `end` itself. Of no
        lines there is one piece.
        """
        images = self.nearest_images(end, near)
        turns = np.round((images - end) / self.width)  # faces that the line still passes, up or down
        rows = np.arange(len(start))
        begin = np.zeros(len(start))
        here = start
        while True:
            left = images - here
            face = self.low + np.where(turns > 0, self.width, 0.0)
            share = np.full(turns.shape, np.inf)
            np.divide(face - here, left, out=share, where=(turns != 0) & (left != 0))
            axis = share.argmin(axis=1)
            line = np.arange(len(rows))
            goes_on = np.isfinite(share[line, axis])
            passed = np.where(goes_on, np.clip(share[line, axis], 0.0, 1.0), 1.0)
            there = np.where(goes_on[:, None], here + passed[:, None] * left, end)
            there[goes_on, axis[goes_on]] = face[goes_on, axis[goes_on]]
            until = begin + passed * (1.0 - begin)
            yield LinePiece(rows, here, there, begin, until)
            if not goes_on.any():
                return
            axis, sign = axis[goes_on], np.sign(turns[line, axis])[goes_on]
            rows, end, begin, turns = rows[goes_on], end[goes_on], until[goes_on], turns[goes_on]
            here, images = there[goes_on], images[goes_on]
            line = np.arange(len(rows))
            for points in (here, images):
                points[line, axis] -= sign * self.width[axis]
            turns[line, axis] -= sign

    def _nearest(self, points: np.ndarray, references: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self._shifted(
            points, lambda axis, shifted: np.round((shifted - references[:, axis]) / self.width[axis])
        )

    def nearest_images_with_velocity(
        self, points: np.ndarray, velocity: np.ndarray, references: np.ndarray, time: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Images of `nearest_images`, and their velocities (n, 3) [m/s] at a time [s], which include the
        motion of the images; `velocity` (n, 3): of the points."""
        box = self.at(time)
        images, image_counts = box._nearest(points, references)
        return images, box._velocity_of_images(points, images, image_counts, velocity, time)

    def _velocity_of_images(
        self,
        points: np.ndarray,
        images: np.ndarray,
        image_counts: np.ndarray,
        velocity: np.ndarray,
        time: float,
    ) -> np.ndarray:
        """Velocities (n, 3) [m/s] of the images of points; `image_counts` (n,): as of `_shifted`."""
        if self.width_velocity is not None:
            return np.asarray(velocity - np.round((points - images) / self.width) * self.width_velocity)
        if self.image_motion is None:
            return velocity
        shifted_velocity = np.array(velocity)
        shifted_velocity[:, self.image_motion.flow] -= image_counts * self.speeds(np.array([time]))[0]
        return shifted_velocity

    def with_images(self, position: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Centers (m, 3) and radii (m,) [m] of spheres, and of their images across periodic faces."""
        return self.images(position, radius)[:2]

    def images(self, position: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Centers (m, 3) and radii (m,) [m] as `with_images`, and the index (m,) of the sphere of each image.

        The given spheres come first. At an edge or corner, all images of a sphere are included. Without
        shear.
        """
        index = np.arange(len(radius))
        for axis in self.axes:
            height = position[:, axis] - self.low[axis]
            below = height < radius
            above = height > self.width[axis] - radius
            shift = self.width[axis] * np.eye(3)[axis]
            position = np.concatenate([position, position[below] + shift, position[above] - shift])
            radius = np.concatenate([radius, radius[below], radius[above]])
            index = np.concatenate([index, index[below], index[above]])
        return position, radius, index

    def _shifted(
        self, points: np.ndarray, image_counts_of: Callable[[int, np.ndarray], np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Points shifted by image counts along every axis, and the counts (n,) along the gradient axis.

        `image_counts_of`: (axis, coordinates (n,)) -> number of widths (n,) by which the points move down.
        The gradient axis comes first, because its shift changes the coordinate along the flow axis.
        """
        shifted = np.array(points)
        gradient_counts = np.zeros(len(points))
        for axis in sorted(
            self.axes, key=lambda axis: self.image_motion is None or axis != self.image_motion.gradient
        ):
            image_counts = image_counts_of(axis, shifted[:, axis])
            shifted[:, axis] -= image_counts * self.width[axis]
            if self.image_motion is not None and axis == self.image_motion.gradient:
                shifted[:, self.image_motion.flow] -= image_counts * self.offset
                gradient_counts = image_counts
        return shifted, gradient_counts
