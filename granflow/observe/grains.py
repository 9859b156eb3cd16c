"""Some of the particles of a snapshot."""

from collections.abc import Mapping

import numpy as np


def free_grains(particles: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
    """All but fixed grains, which are walls."""
    return chosen(particles, particles["fixed"] == 0) if "fixed" in particles else particles


def chosen(arrays: Mapping[str, np.ndarray], which: np.ndarray) -> dict[str, np.ndarray]:
    """The entries of all arrays for which `which` (n,) is True."""
    return {name: values[which] for name, values in arrays.items()}
