"""Subsets of the particles of a snapshot."""

from collections.abc import Mapping

import numpy as np


def mobile_particles(particles: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
    """Return the arrays without fixed particles, which count as walls; the same arrays if the scene has none."""
    return selected(particles, particles["fixed"] == 0) if "fixed" in particles else particles


def wall_contacts(particles: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the number of contacts of each particle with walls (n,); zeros in a scene without walls."""
    return particles.get("wall_contact_count", np.zeros(len(particles["position"]), np.int32))


def selected(arrays: Mapping[str, np.ndarray], mask: np.ndarray) -> dict[str, np.ndarray]:
    """Return the entries of all arrays (n, ...) for which `mask` (n,) is True."""
    return {name: values[mask] for name, values in arrays.items()}
