"""Contact network of a bed: number of contacts per particle, and their orientation."""

from collections.abc import Mapping

import numpy as np


def coordination(contacts_of_each: np.ndarray) -> dict[str, float]:
    """Return the mean number of contacts per particle, with and without rattlers, and the share of rattlers.

        Zm = (sum Z_i - N1) / (N - N0 - N1)

    `contacts_of_each` (n,): number of contacts Z_i of each particle. Rattlers carry no load: N0 have no contact and N1
    have one contact, which is not counted. NaN without particles, Zm also without particles that carry a load.
    (C. Thornton, Geotechnique 50 (2000) 43.)
    """
    count = len(contacts_of_each)
    none, one = (int((contacts_of_each == number).sum()) for number in (0, 1))
    carrying = count - none - one
    total = float(contacts_of_each.sum())
    return {
        "coordination_number": total / count if count else float("nan"),
        "mechanical_coordination_number": (total - one) / carrying if carrying else float("nan"),
        "rattler_share": (none + one) / count if count else float("nan"),
    }


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
