"""Orders of convergence, fitted where errors fall with the time step and are not yet at the floor of the precision."""

from dataclasses import dataclass

import numpy as np

ASYMPTOTIC = 0.05
"""The fit begins at the first error below this."""
FALLING = 0.9
"""It ends where neither the next error nor, by as much again, the one after is below this share of the last."""
FEWEST = 4
"""Points of a fit."""


@dataclass(frozen=True)
class Order:
    """Errors ~ steps^-order between two numbers of steps a collision."""

    order: float
    first: float
    last: float
    prefactor: float

    def at(self, steps: np.ndarray) -> np.ndarray:
        """The fitted error."""
        return self.prefactor * steps**-self.order

    @property
    def words(self) -> str:
        """For a table."""
        return f"{self.order:.2f} ({self.first:g} to {self.last:g})"


def fitted_order(steps: np.ndarray, error: np.ndarray) -> Order | None:
    """Straight line through the logarithms by least squares; None where fewer than FEWEST points fall."""
    below = np.flatnonzero(error < ASYMPTOTIC)
    if not len(below):
        return None
    first = last = int(below[0])
    while (ahead := _falls_on(error, last)) is not None:
        last = ahead
    if last + 1 - first < FEWEST:
        return None
    part = slice(first, last + 1)
    slope, intercept = np.polyfit(np.log(steps[part]), np.log(error[part]), 1)
    return Order(-float(slope), float(steps[first]), float(steps[last]), float(np.exp(intercept)))


def _falls_on(error: np.ndarray, last: int) -> int | None:
    """Index of the next error that is clearly smaller; one may stand out, where different collisions take turns."""
    for ahead in (1, 2):
        if last + ahead < len(error) and 0.0 < error[last + ahead] < FALLING**ahead * error[last]:
            return last + ahead
    return None
