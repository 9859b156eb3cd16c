"""Orders of convergence, fitted where errors decrease with the time step and exceed the round-off floor.

    error = C steps^-p

p: order of convergence; the leapfrog scheme has p = 2 for smooth forces.
"""

from dataclasses import dataclass

import numpy as np

ASYMPTOTIC = 0.05
"""The fit begins at the first error below this value."""
DECREASE = 0.9
"""Required ratio of successive errors.

The fit ends where neither the next error over the last is below it, nor the second next below its square.
"""
MIN_POINTS = 4
"""Minimum number of points of a fit."""


@dataclass(frozen=True)
class Order:
    """error = prefactor * steps^-order from `first` to `last` steps per collision: a fitted order of convergence."""

    order: float
    first: float
    last: float
    prefactor: float

    def at(self, steps: np.ndarray) -> np.ndarray:
        """Fitted error (n,) at numbers of steps per collision (n,)."""
        return self.prefactor * steps**-self.order

    @property
    def text(self) -> str:
        """Text for tables."""
        return f"{self.order:.2f} ({self.first:g} to {self.last:g})"


def fitted_order(steps: np.ndarray, error: np.ndarray) -> Order | None:
    """Least-squares line through the logarithms of `error` (n,) over `steps` (n,), in ascending order of steps.

    The fit begins at the first error below ASYMPTOTIC and ends where the errors stop decreasing. None if fewer than
    MIN_POINTS points decrease. Errors of nan are not below any bound.
    """
    below = np.flatnonzero(error < ASYMPTOTIC)
    if not len(below):
        return None
    first = last = int(below[0])
    while (ahead := _next_decreasing(error, last)) is not None:
        last = ahead
    if last + 1 - first < MIN_POINTS:
        return None
    part = slice(first, last + 1)
    slope, intercept = np.polyfit(np.log(steps[part]), np.log(error[part]), 1)
    return Order(-float(slope), float(steps[first]), float(steps[last]), float(np.exp(intercept)))


def _next_decreasing(error: np.ndarray, last: int) -> int | None:
    """Index of the next clearly smaller error after `last`; None if the errors no longer decrease.

    One outlier is permitted: the largest error may change from one kind of collision to another.
    """
    for ahead in (1, 2):
        if last + ahead < len(error) and 0.0 < error[last + ahead] < DECREASE**ahead * error[last]:
            return last + ahead
    return None
