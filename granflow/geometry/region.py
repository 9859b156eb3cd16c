"""Insertion regions: a box, a cylinder, and a slab on a rectangle, in which spheres lie entirely inside."""

import math
from typing import Protocol

import numpy as np

from granflow.geometry.vectors import frame_along

SLACK = 1e-9
"""Relative tolerance for exact fits, such as ten spheres of 1 mm across 10 mm."""


class RegionSampler(Protocol):
    """An insertion region; arguments are points (n, 3) [m] and radii (n,) [m].

    `volume` [m3]; `radius_max` [m]: radius of the largest sphere that fits.
    """

    volume: float
    radius_max: float

    def sample(self, radius: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """Uniformly distributed centers (n, 3) [m] with each sphere entirely inside.

        `radius` (n,) [m]: each at most `radius_max`. Spheres may overlap each other.
        """

    def reaches(self, points: np.ndarray, reach: np.ndarray) -> np.ndarray:
        """Whether spheres of radius `reach` (n,) [m] around the points may intersect the region; no false
        negatives."""

    def highest(self, up: np.ndarray) -> float:
        """Largest height [m] of the region along the unit vector `up` (3,)."""

    def face(self, direction: np.ndarray) -> tuple[np.ndarray, float, float, float]:
        """Normal (3,), depth [m] behind it, area [m2] and width [m] of a face of the region.

        Of a box with edges along the coordinate axes, the face that `direction` (3,) crosses most steeply.
        """


class FilledRegion(RegionSampler, Protocol):
    """A region that lattices and packings fill."""

    def confine(self, points: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """The nearest centers (n, 3) [m] with the spheres of radii (n,) [m] entirely inside."""

    def sites(self, spacing: float, margin: float, jitter: float) -> tuple[np.ndarray, np.ndarray]:
        """Centers (n, 3) [m] of a lattice with cells not smaller than `spacing`, and displacement vectors (3,
        3) [m].

        Spheres of radius `margin` remain inside after a displacement by any sum of the vectors (rows) times
        numbers in [-1, 1]. Order: in layers from the bottom of the region.
        """

    def section(self, down: np.ndarray) -> float:
        """Area [m2] of the region in the projection along the unit vector `down` (3,)."""


class BoxSampler:
    """A box with edges along the coordinate axes from `low` to `high` (3,) [m]."""

    def __init__(self, low: np.ndarray, high: np.ndarray) -> None:
        self.low = np.asarray(low, dtype=np.float64)
        self.high = np.asarray(high, dtype=np.float64)
        self.volume = float(np.prod(self.high - self.low))
        self.radius_max = float((self.high - self.low).min()) / 2

    def sample(self, radius: np.ndarray, random: np.random.Generator) -> np.ndarray:
        margin = radius[:, None]
        return self.low + margin + random.random((len(radius), 3)) * (self.high - self.low - 2 * margin)

    def confine(self, points: np.ndarray, radius: np.ndarray) -> np.ndarray:
        return np.clip(points, self.low + radius[:, None], self.high - radius[:, None])

    def sites(self, spacing: float, margin: float, jitter: float) -> tuple[np.ndarray, np.ndarray]:
        """As in `FilledRegion`; the cells are stretched to fill the box."""
        size = self.high - self.low
        cells = np.floor(size / spacing * (1 + SLACK)).astype(int)
        cell = size / np.maximum(cells, 1)
        z, y, x = np.meshgrid(*(np.arange(n) + 0.5 for n in cells[::-1]), indexing="ij")
        centers = self.low + np.stack([x, y, z], axis=-1).reshape(-1, 3) * cell
        return centers, np.diag(jitter * np.maximum(cell / 2 - margin, 0.0))

    def reaches(self, points: np.ndarray, reach: np.ndarray) -> np.ndarray:
        margin = reach[:, None]
        return np.all((points > self.low - margin) & (points < self.high + margin), axis=1)

    def highest(self, up: np.ndarray) -> float:
        return float(np.maximum(self.low * up, self.high * up).sum())

    def face(self, direction: np.ndarray) -> tuple[np.ndarray, float, float, float]:
        axis = int(np.argmax(np.abs(direction)))
        return _side_of_box(self.high - self.low, axis, np.eye(3)[axis])

    def section(self, down: np.ndarray) -> float:
        x, y, z = self.high - self.low
        return float(np.abs(down) @ [y * z, z * x, x * y])


class CylinderSampler:
    """A solid cylinder of `radius` [m] between the two ends (3,) [m] of its axis.

    `frame` (3, 3): rows are the local axes; the last is the axis of the cylinder.
    """

    def __init__(self, start: np.ndarray, end: np.ndarray, radius: float) -> None:
        self.start = np.asarray(start, dtype=np.float64)
        along = np.asarray(end, dtype=np.float64) - self.start
        self.length = float(np.linalg.norm(along))
        self.radius = radius
        self.volume = float(np.pi * radius**2 * self.length)
        self.radius_max = min(radius, self.length / 2)
        self.frame = frame_along(along / self.length)

    def to_local(self, points: np.ndarray) -> np.ndarray:
        """Local coordinates (n, 3) [m]: two perpendicular to the axis, the third along it."""
        return (points - self.start) @ self.frame.T

    def from_local(self, local: np.ndarray) -> np.ndarray:
        """Points (n, 3) [m] from local coordinates (n, 3) [m]: the inverse of `to_local`."""
        return self.start + local @ self.frame

    def sample(self, radius: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """As in `RegionSampler`; the distance from the axis is (R - r) sqrt(u), with u uniform in [0, 1]."""
        share, turn, height = random.random((3, len(radius)))
        r = (self.radius - radius) * np.sqrt(share)
        angle = 2 * np.pi * turn
        z = radius + height * (self.length - 2 * radius)
        return self.from_local(np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1))

    def confine(self, points: np.ndarray, radius: np.ndarray) -> np.ndarray:
        local = self.to_local(points)
        r = np.linalg.norm(local[:, :2], axis=1)
        clearance = self.radius - radius
        outside = r > clearance
        local[outside, :2] *= (clearance[outside] / r[outside])[:, None]
        local[:, 2] = np.clip(local[:, 2], radius, self.length - radius)
        return self.from_local(local)

    def sites(self, spacing: float, margin: float, jitter: float) -> tuple[np.ndarray, np.ndarray]:
        """As in `FilledRegion`; layers from the start of the axis are square lattices, stretched to fill the
        length."""
        axes = int(2 * self.radius / spacing * (1 + SLACK))
        layers = int(self.length / spacing * (1 + SLACK))
        height = self.length / max(layers, 1)
        shift = jitter * np.maximum(np.array([spacing, spacing, height]) / 2 - margin, 0.0)
        step = (np.arange(axes) - (axes - 1) / 2) * spacing
        z, y, x = np.meshgrid((np.arange(layers) + 0.5) * height, step, step, indexing="ij")
        farthest = np.hypot(np.abs(x) + shift[0], np.abs(y) + shift[1])
        fits = farthest + margin <= self.radius * (1 + SLACK)
        return self.from_local(np.stack([x, y, z], axis=-1)[fits]), shift[:, None] * self.frame

    def reaches(self, points: np.ndarray, reach: np.ndarray) -> np.ndarray:
        local = self.to_local(points)
        is_within_radius = np.linalg.norm(local[:, :2], axis=1) < self.radius + reach
        return is_within_radius & (local[:, 2] > -reach) & (local[:, 2] < self.length + reach)

    def highest(self, up: np.ndarray) -> float:
        along = float(self.frame[2] @ up)
        base = float(self.start @ up) + max(along * self.length, 0.0)
        return base + self.radius * math.sqrt(max(1.0 - along**2, 0.0))

    def face(self, direction: np.ndarray) -> tuple[np.ndarray, float, float, float]:
        return self.frame[2], self.length, math.pi * self.radius**2, 2.0 * self.radius

    def section(self, down: np.ndarray) -> float:
        along = abs(float(self.frame[2] @ down))
        across = float(np.sqrt(1.0 - min(along, 1.0) ** 2))
        return along * math.pi * self.radius**2 + across * 2.0 * self.radius * self.length


class SlabSampler:
    """A box on a rectangle of any orientation: `depth` [m] along the cross product of the two sides.

    `corner` (3,) [m]; `first`, `second` (3,) [m]: perpendicular edge vectors.
    """

    def __init__(self, corner: np.ndarray, first: np.ndarray, second: np.ndarray, depth: float) -> None:
        lengths = np.array([np.linalg.norm(first), np.linalg.norm(second)])
        axes = first / lengths[0], second / lengths[1]
        self.corner = corner
        self.frame = np.array([*axes, np.cross(*axes)])
        self.box = BoxSampler(np.zeros(3), np.array([*lengths, depth]))
        self.volume = self.box.volume
        self.radius_max = self.box.radius_max

    def sample(self, radius: np.ndarray, random: np.random.Generator) -> np.ndarray:
        return np.asarray(self.corner + self.box.sample(radius, random) @ self.frame)

    def reaches(self, points: np.ndarray, reach: np.ndarray) -> np.ndarray:
        return self.box.reaches((points - self.corner) @ self.frame.T, reach)

    def highest(self, up: np.ndarray) -> float:
        local = self.frame @ up
        return float(self.corner @ up + np.maximum(self.box.high * local, 0.0).sum())

    def face(self, direction: np.ndarray) -> tuple[np.ndarray, float, float, float]:
        return _side_of_box(self.box.high, 2, self.frame[2])


def _side_of_box(size: np.ndarray, axis: int, normal: np.ndarray) -> tuple[np.ndarray, float, float, float]:
    """Normal (3,), depth [m], area [m2] and width [m] of the side of a box of a size (3,) [m] across an
    axis."""
    sides = np.delete(size, axis)
    return normal, float(size[axis]), float(np.prod(sides)), float(np.hypot(*sides))
