"""View direction, and a camera that shows all given points.

The frame of a view has the axes right, up, and toward the viewer.
"""

from dataclasses import dataclass

import numpy as np

from granflow.errors import GranflowError

VIEWS = ("iso", "front", "side", "top")
"""Names of views."""

ISO = (0.6, -1.0, 0.45)
"""Direction toward the viewer of the view `iso`, in the axes right, into and up."""

OPENING = np.radians(24.0)
"""Vertical field of view of a perspective picture; small, so that near and far particles have similar sizes."""

MARGIN = 1.05
"""Relative margin around the shown points."""

CENTERINGS = 6
"""Iterations that center a perspective picture; each reduces the error to a tenth."""


@dataclass(frozen=True)
class HalfSpace:
    """Points behind a plane through `point` (3,) [m] with the outward `normal` (3,)."""

    point: np.ndarray
    normal: np.ndarray

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Whether points (..., 3) [m] are in the half space, (...)."""
        return (points - self.point) @ self.normal <= 0.0


@dataclass(frozen=True)
class View:
    """View of a picture: perpendicular unit vectors `toward` the viewer and `up` (3,), perspective or parallel.

    The vectors `right`, `up` and `toward` form a right-handed frame.
    """

    toward: np.ndarray
    up: np.ndarray
    perspective: bool

    @property
    def right(self) -> np.ndarray:
        """Unit vector (3,) to the right in the picture."""
        return np.cross(self.up, self.toward)

    def projected(self, points: np.ndarray) -> np.ndarray:
        """Coordinates (n, 3) [m] of points to the right, up and toward the viewer."""
        return points @ np.stack([self.right, self.up, self.toward], axis=1)


@dataclass(frozen=True)
class Camera:
    """Camera: `eye` and `focus` (3,) [m]; `half_height` [m] of the picture for parallel projection.

    The vertical field of view of a perspective picture is OPENING.
    """

    view: View
    eye: np.ndarray
    focus: np.ndarray
    half_height: float

    @property
    def shown_height(self) -> float:
        """Height [m] of the shown part of the plane through the focus."""
        if not self.view.perspective:
            return 2.0 * self.half_height
        return 2.0 * float(np.linalg.norm(self.eye - self.focus) * np.tan(0.5 * OPENING))


def view_of(text: str, gravity: np.ndarray | None = None) -> View:
    """View by name: iso, front, side, top, or the direction to the viewer as three numbers "1,-2,0.8".

    Up is the axis opposite to `gravity` (z without gravity); front, side and top are parallel projections, the others
    perspective. Raises GranflowError for another text.
    """
    up = upward(gravity)
    right = np.array([0.0, 1.0, 0.0]) if up[0] else np.array([1.0, 0.0, 0.0])
    into = np.cross(up, right)
    flat = {"front": (-into, up), "side": (right, up), "top": (up, into)}
    if text in flat:
        toward, top = flat[text]
        return View(toward, top, perspective=False)
    if text == "iso":
        toward = ISO[0] * right + ISO[1] * into + ISO[2] * up
    else:
        toward = _direction(text)
    return _upright(toward, up, into)


def upward(gravity: np.ndarray | None) -> np.ndarray:
    """Unit vector (3,) along the axis that is most nearly opposite to gravity."""
    up = np.zeros(3)
    if gravity is None or not np.any(gravity):
        up[2] = 1.0
    else:
        axis = int(np.argmax(np.abs(gravity)))
        up[axis] = -np.sign(gravity[axis])
    return up


def _direction(text: str) -> np.ndarray:
    """Direction (3,) from text with three numbers. Raises GranflowError for other text."""
    try:
        numbers = np.array([float(word) for word in text.split(",")])
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) != 3 or not np.all(np.isfinite(numbers)) or not np.any(numbers):
        raise GranflowError(
            f"--view {text}: give {', '.join(VIEWS)}, or the direction to the viewer, such as --view=1,-2,0.8."
        )
    return numbers / np.abs(numbers).max()  # the squares of numbers such as 1e300 and 1e-300 are out of range


def _upright(toward: np.ndarray, up: np.ndarray, into: np.ndarray) -> View:
    """Perspective view from `toward` with `up` vertical in the picture; for a view along `up`, `into` is vertical."""
    toward = toward / np.linalg.norm(toward)
    axis = up if abs(toward @ up) < np.cos(np.radians(1.0)) else into
    upright = axis - (axis @ toward) * toward
    return View(toward, upright / np.linalg.norm(upright), perspective=True)


def aspect_of(view: View, points: np.ndarray) -> float:
    """Ratio of width to height of points (n, 3) [m] in a view."""
    width, height, _ = np.ptp(view.projected(points), axis=0)
    return float(width / height) if width > 0.0 and height > 0.0 else 1.0


def camera_for(view: View, points: np.ndarray, aspect: float, zoom: float = 1.0) -> Camera:
    """Camera that just shows the points (n, 3) [m] in a picture with this ratio of width to height.

    `zoom`: magnification; above 1, outer points are outside the picture.
    """
    seen = view.projected(points)
    low, high = seen.min(axis=0), seen.max(axis=0)
    middle, size = 0.5 * (low + high), np.maximum(high - low, 1e-12)
    half_height = 0.5 * MARGIN * max(size[1], size[0] / aspect) / zoom
    tangent = np.tan(0.5 * OPENING) * np.array([aspect, 1.0]) / MARGIN
    distance = half_height / tangent[1] + size[2]
    for _ in range(CENTERINGS if view.perspective else 0):
        distance = _camera_distance(seen - middle, tangent) / zoom
        middle[:2] += _off_center(seen - middle, distance)
    focus = middle @ np.stack([view.right, view.up, view.toward])
    return Camera(view, focus + distance * view.toward, focus, half_height)


def _camera_distance(seen: np.ndarray, tangent: np.ndarray) -> float:
    """Smallest distance [m] of the eye from the origin at which all points are in the field of view.

    `seen` (n, 3) [m]: points in the frame of the view; `tangent` (2,): of half the field of view.
    """
    return float(np.max(seen[:, 2:] + np.abs(seen[:, :2]) / tangent))


def _off_center(seen: np.ndarray, distance: float) -> np.ndarray:
    """Offset (2,) [m] of the middle of the shown points from the center of the picture, in the plane of the focus."""
    depth = np.maximum(distance - seen[:, 2:], 1e-3 * distance)
    shown = seen[:, :2] / depth
    return 0.5 * (shown.min(axis=0) + shown.max(axis=0)) * distance
