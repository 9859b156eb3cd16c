"""Shape of a clump, a rigid body of spheres that may overlap: its volume, center of mass and moments of inertia."""

from dataclasses import dataclass
from functools import lru_cache
from itertools import permutations

import numpy as np

from granflow.geometry.quaternion import matrices, of_matrix
from granflow.geometry.sphere_union import union_integrals

DIAGONAL = 1e-9
"""Largest off-diagonal moment over the trace for which the axes of the given positions are principal axes."""


@dataclass(frozen=True, eq=False)
class ClumpShape:
    """A clump of k spheres of homogeneous density; overlapping regions count once.

    volume:          of the union of the spheres [m3]
    center:          center of mass (3,) [m] in the frame of the given positions
    moments:         principal moments of inertia (3,) for density 1 [m5]
    principal_axes:  quaternion (4,) of the rotation from the principal axes to the frame of the given positions
    offset:          centers of the spheres (k, 3) [m] relative to the center of mass, along the principal axes
    radius:          radii of the spheres (k,) [m]
    """

    volume: float
    center: np.ndarray
    moments: np.ndarray
    principal_axes: np.ndarray
    offset: np.ndarray
    radius: np.ndarray

    def __len__(self) -> int:
        return len(self.radius)

    @property
    def outer_radius(self) -> float:
        """Radius [m] of the smallest sphere around the center of mass that contains the clump."""
        return float(np.max(np.linalg.norm(self.offset, axis=1) + self.radius))

    @property
    def volume_share(self) -> np.ndarray:
        """Share (k,) of each sphere in the mass of the clump, by its volume without regard to overlaps; the sum is 1.

        Sums of masses over spheres are thereby those over clumps.
        """
        return np.asarray(self.radius**3 / np.sum(self.radius**3))

    def spheres(self, position: np.ndarray, orientation: np.ndarray) -> np.ndarray:
        """Centers (n, k, 3) [m] of the spheres of clumps with centers of mass (n, 3) [m] and orientations (n, 4).

        The orientations turn the frame of the given positions, as those of `ParticleData`.
        """
        arms = self.offset @ matrices(self.principal_axes[None])[0].T
        return np.asarray(position[:, None] + np.einsum("nij,kj->nki", matrices(orientation), arms))


@lru_cache(maxsize=64)
def clump_shape(position: tuple[tuple[float, float, float], ...], radius: tuple[float, ...]) -> ClumpShape:
    """The shape of spheres with centers [m] and radii [m].

    I = tr(J) - J with J the integral of x x about the center of mass
    """
    centers, radii = np.array(position), np.array(radius)
    scale, origin = float(radii.max()), centers.mean(axis=0)
    volume, first, second = union_integrals((centers - origin) / scale, radii / scale)
    center = first / volume
    second = second - volume * np.outer(center, center)
    moments, axes = _principal(np.trace(second) * np.eye(3) - second)
    center = origin + scale * center
    return ClumpShape(scale**3 * volume, center, scale**5 * moments, of_matrix(axes), (centers - center) @ axes, radii)


def _principal(tensor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Principal moments (3,) of a symmetric tensor (3, 3), and the rotation whose columns are the axes.

    Of all orders and signs of the axes, the rotation nearest to the identity.
    """
    if np.abs(tensor - np.diag(np.diag(tensor))).max() <= DIAGONAL * np.trace(tensor):
        return np.diag(tensor).copy(), np.eye(3)
    moments, vectors = np.linalg.eigh(tensor)
    found = [(_right_handed(vectors[:, order]), moments[list(order)]) for order in permutations(range(3))]
    axes, ordered = max(found, key=lambda each: float(np.trace(each[0])))
    return ordered, axes


def _right_handed(axes: np.ndarray) -> np.ndarray:
    """Columns (3, 3) with the signs of a rotation that is nearest to the identity."""
    diagonal = np.diag(axes)
    sign = np.where(diagonal < 0.0, -1.0, 1.0)
    if np.linalg.det(axes * sign) < 0.0:
        sign[int(np.argmin(np.abs(diagonal)))] *= -1.0
    return np.asarray(axes * sign)
