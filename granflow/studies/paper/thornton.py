"""Restitution of Thornton's elastic, perfectly plastic sphere in closed form, for comparison in Fig. 3."""

import math

import numpy as np


def thornton_restitution(velocity: np.ndarray, yield_velocity: float) -> np.ndarray:
    """Restitution at approach velocities [m/s], with r = yield velocity / velocity; 1 up to the yield velocity.

        e^2 = (6 sqrt(3) / 5) (1 - r^2 / 6) sqrt(r / (r + 2 sqrt(6/5 - r^2 / 5)))     (Thornton 1997)

    Source: C. Thornton, J. Appl. Mech. 64, 383 (1997), doi 10.1115/1.2787319.
    """
    r = np.minimum(yield_velocity / np.asarray(velocity, dtype=float), 1.0)
    flattening = np.sqrt(r / (r + 2.0 * np.sqrt(6.0 / 5.0 - r**2 / 5.0)))
    return np.sqrt(6.0 * math.sqrt(3.0) / 5.0 * (1.0 - r**2 / 6.0) * flattening)
