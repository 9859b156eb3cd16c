"""Unit quaternions (w, x, y, z) of rotations, the orientations of clumps, as arrays (n, 4). numpy only."""

import numpy as np


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
    """Quaternions (n, 4) of rotations about axes (n, 3), whose length does not matter, by angles (n,)
    [rad]."""
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


def random_orientations(count: int, random: np.random.Generator) -> np.ndarray:
    """Uniformly distributed unit quaternions (count, 4)."""
    quaternion = random.standard_normal((count, 4))
    return quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
