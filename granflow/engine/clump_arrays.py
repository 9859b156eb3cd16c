"""Clumps on the host: arrays of new clumps, their energies, and their motion at the time of the positions.

All arrays have a row per sphere; `clump` is the id of the first sphere of its clump, -1 for a single sphere.
"""

from collections.abc import Mapping

import numpy as np

from granflow.geometry.quaternion import matrices

CLUMP_MOTION = (
    *("id", "clump", "clump_mass", "clump_inertia", "clump_offset", "clump_position", "clump_velocity"),
    *("clump_angular_momentum", "orientation"),
)
"""Fields that determine motion and energy of clumps; absent without clumps."""

ROTATION_SHARE = "clump_rotation_share"
"""Array of `of_clumps`: share of a sphere in twice the rotational energy of its clump [J]."""

Arrays = dict[str, np.ndarray]


def of_clumps(arrays: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
    """The arrays with position and velocity of the clump for its spheres, and ROTATION_SHARE; unchanged without clumps.

    The share of a sphere is its mass over that of the clump.
    """
    if "clump" not in arrays:
        return arrays
    in_clump = arrays["clump"][:, None] >= 0
    momentum, share = (
        arrays["clump_angular_momentum"].astype(float),
        arrays["mass"] / arrays["clump_mass"].astype(float),
    )
    moving = {name: np.where(in_clump, arrays[f"clump_{name}"], arrays[name]) for name in ("position", "velocity")}
    return {**arrays, **moving, ROTATION_SHARE: share * np.sum(momentum * angular_velocity(arrays), axis=1)}


def angular_velocity(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Angular velocities (n, 3) [rad/s] of the clumps, in the frame of the scene: w = R (R^T L / I); 0 without one."""
    rotation = matrices(arrays["orientation"].astype(float))
    along = np.einsum("nji,nj->ni", rotation, arrays["clump_angular_momentum"].astype(float))
    inertia = arrays["clump_inertia"].astype(float)
    along = np.divide(along, inertia, out=np.zeros_like(along), where=inertia > 0.0)
    return np.einsum("nij,nj->ni", rotation, along)


def angular_momentum(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Angular momenta (n, 3) [kg m2/s] of the clumps, in the frame of the scene: L = R I R^T w; 0 without one.

    arrays:  angular_velocity, orientation, clump_inertia
    """
    rotation = matrices(arrays["orientation"].astype(float))
    along = np.einsum("nji,nj->ni", rotation, arrays["angular_velocity"].astype(float))
    return np.einsum("nij,nj->ni", rotation, arrays["clump_inertia"].astype(float) * along)


def arms(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Centers (n, 3) [m] of the spheres relative to the centers of mass, in the frame of the scene."""
    rotation = matrices(arrays["orientation"].astype(float))
    return np.einsum("nij,nj->ni", rotation, arrays["clump_offset"].astype(float))


def synchronized_clumps(arrays: Mapping[str, np.ndarray], half: float, gravity: np.ndarray) -> Arrays:
    """Motion of clumps at the time of the positions, for their spheres; rows of single spheres are meaningless.

        v(t) = v(t - dt/2) + dt/2 (F / m + g),   L(t) = L(t - dt/2) + dt/2 M

    arrays:   CLUMP_MOTION, velocity, angular_velocity, force and torque, on the device half a step behind
    half:     dt/2 [s]
    gravity:  (3,) [m/s2]
    Returns:  velocity, angular_velocity, clump_velocity, clump_angular_momentum; no arrays without clumps
    """
    if "clump" not in arrays:
        return {}
    arm, force = arms(arrays), arrays["force"].astype(float)
    force, torque = _sums(arrays, force), _sums(arrays, arrays["torque"] + np.cross(arm, force))
    velocity = arrays["clump_velocity"] + half * (force / arrays["clump_mass"].astype(float)[:, None] + gravity)
    momentum = arrays["clump_angular_momentum"] + half * torque
    spin = angular_velocity({**arrays, "clump_angular_momentum": momentum})
    return {
        "velocity": velocity + np.cross(spin, arm),
        "angular_velocity": spin,
        "clump_velocity": velocity,
        "clump_angular_momentum": momentum,
    }


def _sums(arrays: Mapping[str, np.ndarray], vectors: np.ndarray) -> np.ndarray:
    """Sums (n, 3) of vectors (n, 3) over the spheres of the clump of each sphere, in the order of the ids."""
    order = np.lexsort((arrays["id"], arrays["clump"]))
    clump = arrays["clump"][order]
    first = np.flatnonzero(np.r_[True, clump[1:] != clump[:-1]]) if len(clump) else np.zeros(0, np.int64)
    lengths = np.diff(np.r_[first, len(clump)])
    found = np.empty_like(vectors)
    found[order] = np.repeat(np.add.reduceat(vectors[order], first, axis=0), lengths, axis=0) if len(clump) else 0.0
    return found
