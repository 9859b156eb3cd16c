"""Structure of a bed: center of mass, number of contacts per particle, their orientation and sliding."""

from collections.abc import Collection, Mapping

import numpy as np

MIN_CONTACTS = 2
"""Smallest number of contacts, with particles and walls, of a particle that carries a load."""


def coordination(with_particles: np.ndarray, with_walls: np.ndarray) -> dict[str, float]:
    """Return the mean number of contacts per particle, with and without rattlers, and the share of rattlers.

        Zm = (sum Z_i) / (N - N0 - N1)       over the particles with at least two contacts

    `with_particles`, `with_walls` (n,): number of contacts of each particle. Rattlers carry no load: N0 have no contact
    and N1 have one, of either kind. Z and Zm count contacts with particles only, so that they do not depend on the size
    of the container. NaN without particles, Zm also without particles that carry a load. (C. Thornton, Geotechnique 50
    (2000) 43, for a periodic box.)
    """
    count, carries = len(with_particles), with_particles + with_walls >= MIN_CONTACTS
    return {
        "coordination_number": _mean(with_particles),
        "mechanical_coordination_number": _mean(with_particles[carries]),
        "wall_coordination_number": _mean(with_walls),
        "rattler_share": 1.0 - carries.sum() / count if count else float("nan"),
    }


def center_of_mass(position: np.ndarray, mass: np.ndarray) -> dict[str, float]:
    """Return the center of mass [m] of particles at `position` (n, 3) [m] with `mass` (n,) [kg]; NaN without any."""
    total = float(mass.sum())
    center = mass.astype(float) @ position.astype(float) / total if total else np.full(3, np.nan)
    return {f"center_of_mass_{axis}": float(center[k]) for k, axis in enumerate("xyz")}


def sliding_share(contacts: Mapping[str, np.ndarray], walls: Collection[int] | None) -> dict[str, float]:
    """Return the share of contacts whose friction force is at the Coulomb limit; NaN without contacts.

    `contacts`: arrays `wall` and `sliding` (n,); `walls`: numbers of the walls in the scene, or None for the contacts
    between particles.
    """
    selected = contacts["wall"] < 0 if walls is None else np.isin(contacts["wall"], list(walls))
    return {"sliding_share": _mean(contacts["sliding"][selected])}


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else float("nan")


def fabric_tensor(contacts: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the mean of n n over the contacts between particles, n their direction: (3, 3), symmetric, with trace 1.

    `contacts`: arrays `wall` (n,) (negative between particles), `position_i` and `position_j` (n, 3) [m]. NaN without
    contacts. (M. Satake, in: Deformation and Failure of Granular Materials, 1982, 63.)
    """
    between = contacts["wall"] < 0
    branch = contacts["position_j"][between] - contacts["position_i"][between]
    normal = branch / np.linalg.norm(branch, axis=1)[:, None]
    if not len(normal):
        return np.full((3, 3), np.nan)
    return np.einsum("na,nb->ab", normal, normal) / len(normal)


def anisotropy(fabric: np.ndarray) -> float:
    """Return the anisotropy of a fabric tensor (3, 3), from 0 (isotropic) to 1 (all contacts parallel).

    a = sqrt(3/2 D:D),      D = F - 1/3
    """
    deviator = fabric - np.eye(3) / 3.0
    return float(np.sqrt(1.5 * (deviator**2).sum()))
