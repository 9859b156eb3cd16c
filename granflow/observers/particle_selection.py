"""Subsets of the particles of a snapshot."""

from collections.abc import Mapping

import numpy as np


def mobile_particles(particles: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
    """Return the arrays without fixed particles, which count as walls; the same arrays if the scene has none."""
    return selected(particles, particles["fixed"] == 0) if "fixed" in particles else particles


def selected(arrays: Mapping[str, np.ndarray], mask: np.ndarray) -> dict[str, np.ndarray]:
    """Return the entries of all arrays (n, ...) for which `mask` (n,) is True."""
    return {name: values[mask] for name, values in arrays.items()}
