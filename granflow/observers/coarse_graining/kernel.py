"""The coarse-graining kernel: a truncated and normalized Gaussian along each axis."""

from functools import cache
from math import erf, sqrt

import numpy as np

NODES = 2**14
"""Nodes in the table of the distribution function; linear interpolation has an error of 1e-8."""


class GaussianKernel:
    """The weight of a point at r [1/m3]: W(r) = g(x) g(y) g(z), which integrates to 1.

        g(s) = exp(-s^2 / 2 w^2) / (sqrt(2 pi) w erf(c / sqrt(2)))      |s| < c w, else 0

    `width`: w [m]; `cutoff`: c, in widths; `reach`: c w [m], half the edge of the cube outside which W is 0. Within the
    cutoff, W depends only on the distance, since the product of the three Gaussians does.
    """

    def __init__(self, width: float, cutoff: float) -> None:
        self.width, self.cutoff = width, cutoff
        self.reach = cutoff * width
        self._table = _distribution(cutoff)

    def cumulative(self, distance: np.ndarray) -> np.ndarray:
        """Return the integral of g from minus infinity to `distance` [m], an array of any shape; from 0 to 1.

        A cell gets the share cumulative(upper edge) - cumulative(lower edge) along each axis.
        """
        nodes, shares = self._table
        return np.interp(distance / self.width, nodes, shares)


@cache
def _distribution(cutoff: float) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes from -cutoff to cutoff, in widths, and the integral of the kernel up to each, from 0 to 1."""
    nodes = np.linspace(-cutoff, cutoff, NODES)
    full = erf(cutoff / sqrt(2.0))
    return nodes, np.array([0.5 + 0.5 * erf(node / sqrt(2.0)) / full for node in nodes])
