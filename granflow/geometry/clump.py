"""Body of a clump, a rigid body of spheres that may overlap: volume, center, moments; numpy only.

Regions in which spheres overlap count once: the moments are integrals over the union of the spheres, which
the last part of this file computes.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import permutations

import numpy as np

from granflow.geometry.sphere import sphere_volume

DIAGONAL = 1e-9
"""Largest off-diagonal moment over the trace for which the axes of the given positions are principal axes."""


@dataclass(frozen=True, eq=False)
class ClumpBody:
    """A clump of k spheres of homogeneous density; overlapping regions count once.

    volume:          of the union of the spheres [m3]
    center:          center of mass (3,) [m] in the frame of the given positions
    moments:         principal moments of inertia (3,) for density 1 [m5]
    principal_axes:  quaternion (4,) of the rotation from the principal axes to the frame of the given
                     positions
    offset:          centers of the spheres (k, 3) [m] relative to the center of mass, along the principal
                     axes
    radius:          radii of the spheres (k,) [m]
    exposed_share:   share (k,) of the surface of each sphere that lies in no other sphere
    """

    volume: float
    center: np.ndarray
    moments: np.ndarray
    principal_axes: np.ndarray
    offset: np.ndarray
    radius: np.ndarray
    exposed_share: np.ndarray

    def __len__(self) -> int:
        return len(self.radius)

    @property
    def outer_radius(self) -> float:
        """Radius [m] of the smallest sphere around the center of mass that contains the clump."""
        return float(np.max(np.linalg.norm(self.offset, axis=1) + self.radius))

    @property
    def volume_share(self) -> np.ndarray:
        """Share (k,) of each sphere in the mass of the clump, by its volume; overlaps do not count.

        The sum is 1.

        Sums of masses over spheres are thereby those over clumps.
        """
        return np.asarray(self.radius**3 / np.sum(self.radius**3))

    @property
    def sphere_volumes(self) -> np.ndarray:
        """Share (k,) of each sphere in the volume of the clump [m3]."""
        return self.volume * self.volume_share

    @property
    def volume_over_spheres(self) -> float:
        """Volume of the clump over the sum of the volumes of its spheres, below 1 if they overlap."""
        return self.volume / float(np.sum(sphere_volume(self.radius)))

    def sphere_arrays(self, density: np.ndarray, member: np.ndarray) -> dict[str, np.ndarray]:
        """Fields of n spheres: densities (n,) [kg/m3], indices (n,) in their clumps."""
        mass = density * self.volume
        return {
            "radius": self.radius[member],
            "clump_offset": self.offset[member],
            "mass": mass * self.volume_share[member],
            "clump_mass": mass,
            "clump_inertia": density[:, None] * self.moments,
            "exposed_share": self.exposed_share[member],
        }

    def spheres(self, position: np.ndarray, orientation: np.ndarray) -> np.ndarray:
        """Centers (n, k, 3) [m] of the spheres of clumps at (n, 3) [m] with orientations (n, 4).

        The orientations turn the frame of the given positions, as those of `ParticleData`.
        """
        arms = self.offset @ matrices(self.principal_axes[None])[0].T
        return np.asarray(position[:, None] + np.einsum("nij,kj->nki", matrices(orientation), arms))


@lru_cache(maxsize=64)
def clump_body(position: tuple[tuple[float, float, float], ...], radius: tuple[float, ...]) -> ClumpBody:
    """The body of spheres with centers [m] and radii [m].

    I = tr(J) - J with J the integral of x x about the center of mass
    """
    centers = np.array(position)
    radii = np.array(radius)
    scale = float(radii.max())
    origin = centers.mean(axis=0)
    volume, first, second, area = union_integrals((centers - origin) / scale, radii / scale)
    center = first / volume
    second = second - volume * np.outer(center, center)
    moments, axes = _principal(np.trace(second) * np.eye(3) - second)
    center = origin + scale * center
    return ClumpBody(
        volume=scale**3 * volume,
        center=center,
        moments=scale**5 * moments,
        principal_axes=of_matrix(axes),
        offset=(centers - center) @ axes,
        radius=radii,
        exposed_share=area * scale**2 / (4.0 * np.pi * radii**2),
    )


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


# Orientations: unit quaternions (w, x, y, z) and rotation matrices.


def random_orientations(count: int, random: np.random.Generator) -> np.ndarray:
    """Uniformly distributed unit quaternions (count, 4)."""
    quaternion = random.standard_normal((count, 4))
    return quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)


def matrices(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrices (n, 3, 3) of unit quaternions (n, 4)."""
    w, x, y, z = quaternion.T
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def product(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Quaternions (n, 4) of the rotation `second` followed by `first`, both (n, 4) or (4,)."""
    first, second = np.broadcast_arrays(np.atleast_2d(first), np.atleast_2d(second))
    a = first[:, :1]
    u = first[:, 1:]
    b = second[:, :1]
    v = second[:, 1:]
    scalar = a * b - np.sum(u * v, axis=1, keepdims=True)
    return np.concatenate([scalar, a * v + b * u + np.cross(u, v)], axis=1)


def about(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Quaternions (n, 4) of rotations about axes (n, 3) of any length, by angles (n,) [rad]."""
    unit = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    return np.concatenate([np.cos(0.5 * angle)[:, None], np.sin(0.5 * angle)[:, None] * unit], axis=1)


def of_matrix(rotation: np.ndarray) -> np.ndarray:
    """Quaternion (4,) of a rotation matrix (3, 3), with w >= 0.

    Its products are linear in the entries R of the matrix; the largest is divided by its square root.
    """
    products = np.empty((4, 4))
    trace = np.trace(rotation)
    skew = np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    products[0, 0] = 1.0 + trace
    products[0, 1:] = skew
    products[1:, 0] = skew
    products[1:, 1:] = rotation + rotation.T + (1.0 - trace) * np.eye(3)
    row = products[int(np.argmax(np.diag(products)))]
    return np.asarray(row / np.linalg.norm(row) * (1.0 if row[0] >= 0.0 else -1.0))


# Volume integrals over a union of spheres.
#
# By the divergence theorem, each integral is one over the parts of the spheres that no other sphere contains,
# with the outward normal n and s = x . n dA:
#
#     volume = 1/3 sum s,      integral of x = 1/4 sum x s,      integral of x x = 1/5 sum x x s
#
# On each circle of latitude these parts are arcs, whose ends are known exactly. Gauss quadrature adds up the
# arcs, and the latitudes between those at which arcs appear or vanish.

LATITUDES = 64
"""Number of circles of latitude between two at which arcs appear or vanish: relative error 1e-13 unless three
spheres overlap each other, then below 1e-5."""
ARC_POINTS = 8
"""Points of the quadrature on an arc of at most a quarter of a circle."""


def union_integrals(
    position: np.ndarray, radius: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Volume [m3], and integrals of x (3,) [m4] and of x x (3, 3) [m5] over the union of spheres; exposed
    areas (k,) [m2] of the spheres.

    `position` (k, 3) [m], near the origin for the accuracy of the integrals; `radius` (k,) [m].
    """
    total = np.zeros(13)
    area = np.zeros(len(radius))
    for index in range(len(radius)):
        caps = _caps(position, radius, index)
        if caps is not None:
            sums, area[index] = _exposed_integrals(position[index], float(radius[index]), *caps)
            total += sums
    return float(total[0]) / 3.0, total[1:4] / 4.0, total[4:].reshape(3, 3) / 5.0, area


def _caps(position: np.ndarray, radius: np.ndarray, index: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Caps of a sphere inside the other spheres: unit vectors e (c, 3), cosines (c,).

    Inside a cap, n . e > cosine.

    None if another sphere contains the whole sphere, or is equal to it and comes earlier.
    """
    branch = position - position[index]
    distance = np.linalg.norm(branch, axis=1)
    others = np.arange(len(radius)) != index
    contained = others & (distance + radius[index] <= radius) & ((distance > 0.0) | (radius > radius[index]))
    equal = others & (distance == 0.0) & (radius == radius[index]) & (np.arange(len(radius)) < index)
    if np.any(contained | equal):
        return None
    near = (
        others & (distance > 0.0) & (distance < radius[index] + radius) & (distance + radius > radius[index])
    )
    unit = branch[near] / distance[near, None]
    cosine = (distance[near] ** 2 + radius[index] ** 2 - radius[near] ** 2) / (
        2.0 * distance[near] * radius[index]
    )
    return unit, cosine


def _exposed_integrals(
    center: np.ndarray, radius: float, unit: np.ndarray, cosine: np.ndarray
) -> tuple[np.ndarray, float]:
    """Sums (13,) of s, x s and x x s over the part of a sphere outside the caps, and its area [m2]."""
    polar = np.arccos(np.clip(unit[:, 2], -1.0, 1.0))
    half_angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    ends = np.unique(np.concatenate([[-1.0, 1.0], np.cos(polar - half_angle), np.cos(polar + half_angle)]))
    node, weight = np.polynomial.legendre.leggauss(LATITUDES)
    turn = 0.5 * np.pi * (1.0 + node)  # heights as (1 - cos turn): the ends are square roots of the height
    width = np.diff(ends)[:, None]
    height = (ends[:-1, None] + 0.5 * width * (1.0 - np.cos(turn))).ravel()
    share = (0.25 * np.pi * width * weight * np.sin(turn)).ravel()
    angle, angle_share = _exposed_angles(height, unit, cosine)
    level = np.broadcast_to(height[:, None], angle.shape)
    across = np.sqrt(np.maximum(1.0 - level**2, 0.0))
    normal = np.stack([across * np.cos(angle), across * np.sin(angle), level], axis=-1).reshape(-1, 3)
    area = (radius**2 * share[:, None] * angle_share).ravel()
    point = center + radius * normal
    flux = area * np.einsum("ij,ij->i", point, normal)
    sums = np.concatenate([[flux.sum()], flux @ point, ((flux[:, None] * point).T @ point).ravel()])
    return sums, float(area.sum())


def _exposed_angles(
    height: np.ndarray, unit: np.ndarray, cosine: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Longitudes (m, p) outside the caps on circles of latitude z = `height` (m,), and weights.

    The sphere has radius 1.

    A cap covers cos(longitude - its own) > (cosine - z e_z) / (across e_across); weights are 0 inside caps.
    """
    across = np.sqrt(np.maximum(1.0 - height**2, 0.0))[:, None]
    along = np.hypot(unit[:, 0], unit[:, 1])
    own = np.arctan2(unit[:, 1], unit[:, 0])
    rest = cosine - height[:, None] * unit[:, 2]
    half = np.arccos(np.clip(rest / np.maximum(across * along, 1e-300), -1.0, 1.0))
    quarters = np.broadcast_to(0.5 * np.pi * np.arange(5), (len(height), 5))
    ends = np.sort(
        np.concatenate([quarters, (own - half) % (2 * np.pi), (own + half) % (2 * np.pi)], axis=1), axis=1
    )
    begin = ends[:, :-1]
    width = np.diff(ends, axis=1)
    middle = (begin + 0.5 * width)[:, :, None]
    covered = np.any((across * along)[:, None, :] * np.cos(middle - own) > rest[:, None, :], axis=2)
    node, weight = np.polynomial.legendre.leggauss(ARC_POINTS)
    angle = begin[:, :, None] + 0.5 * width[:, :, None] * (1.0 + node)
    share = 0.5 * (width * ~covered)[:, :, None] * weight
    return angle.reshape(len(height), -1), share.reshape(len(height), -1)
