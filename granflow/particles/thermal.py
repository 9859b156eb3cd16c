"""Random initial velocities with the Maxwell distribution."""

from math import log, sqrt

import numpy as np

from granflow.scene.schema.particles import ThermalMotion

EXCEEDED = 1e-3
"""Approximate probability that any particle of a group is faster than `largest_speed`."""


def thermal_velocities(thermal: ThermalMotion, radius: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Velocities (n, 3) [m/s] of particles of one density with radii (n,) [m]: normal components, scaled to the rms.

    u <- u - sum m u / sum m    (zero_momentum)        u <- u rms / sqrt(sum u^2 / n)
    """
    velocity = random.standard_normal((len(radius), 3))
    if thermal.zero_momentum:
        weight = radius**3
        velocity -= weight @ velocity / weight.sum()
    return velocity * (thermal.rms / np.sqrt((velocity**2).sum() / len(radius)))


def largest_speed(thermal: ThermalMotion, count: int) -> float:
    """Speed [m/s] that the random velocities of `count` particles hardly exceed: rms / sqrt(3) sqrt(2 ln(n / p))."""
    return min(thermal.rms / sqrt(3.0) * sqrt(2.0 * log(count / EXCEEDED)), thermal.rms * sqrt(count))
