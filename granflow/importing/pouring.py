"""How many particles a batch of fix pour has: the random insertion of LAMMPS, repeated with random numbers.

LAMMPS draws the height and the size of a particle, then positions at this height until it overlaps no other
one. All particles of a batch share the attempts: where the upper end of the region is full, one particle uses
all that are left, and the batch ends with fewer particles than the solid fraction of the script.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import pi

import numpy as np

SIMULATED_BATCHES = 4
"""Number of simulated batches whose mean is taken; those of LAMMPS have a standard deviation of 6 to 11 %."""
WIDEST = 16.0
"""Width over the largest diameter from which on a periodic square of this width is simulated instead."""
MOST_AT_ONCE = 256
"""Largest number of attempts that are evaluated together."""
MOST_FAILED = 20000
"""Number of attempts in succession after which a particle is taken as one without a place."""


@dataclass(frozen=True)
class Pouring:
    """The region of a fix pour and its particles; lengths in m.

    sides:        of a block; None for a cylinder
    radius:       of a cylinder
    height:       of the region
    draw_radius:  radius of a particle from a random generator
    largest:      largest radius
    requested:    particles of a batch by the solid fraction of the script
    attempts:     for each particle, on average
    """

    sides: tuple[float, float] | None
    radius: float
    height: float
    draw_radius: Callable[[np.random.Generator], float]
    largest: float
    requested: int
    attempts: int

    def batch(self) -> float:
        """Mean number of particles of a batch in the code, at most `requested`."""
        found = [self.simulated(np.random.default_rng(seed)) for seed in range(SIMULATED_BATCHES)]
        return float(np.mean(found))

    def simulated(self, rng: np.random.Generator) -> float:
        """Particles of one batch."""
        area = self.sides[0] * self.sides[1] if self.sides is not None else pi * self.radius**2
        width = 2.0 * WIDEST * self.largest
        share = min(1.0, width**2 / area)
        requested = max(1, round(share * self.requested))
        left = requested * self.attempts
        points, radii = np.empty((requested, 3)), np.empty(requested)
        for count in range(requested):
            height = self.height * (1.0 - rng.random() ** 2)
            radius = self.draw_radius(rng)
            reach = (radii[:count] + radius) ** 2 - (points[:count, 2] - height) ** 2
            near = reach > 0.0
            others, reach = points[:count][near, :2], reach[near]
            failed, tried = 0, 4
            while failed < min(left, MOST_FAILED):
                places = self._places(rng, min(tried, left - failed), width if share < 1.0 else 0.0)
                offset = places[:, None] - others
                if share < 1.0:
                    offset -= width * np.round(offset / width)
                free = np.flatnonzero(((offset**2).sum(axis=2) > reach).all(axis=1))
                if len(free):
                    failed += int(free[0]) + 1
                    points[count], radii[count] = (*places[free[0]], height), radius
                    break
                failed += len(places)
                tried = min(2 * tried, MOST_AT_ONCE)
            else:
                return count / share
            left -= failed
        return float(self.requested)

    def _places(self, rng: np.random.Generator, count: int, width: float) -> np.ndarray:
        """Random positions (count, 2) in the cross section, or in a square if it has a width."""
        if width:
            return width * rng.random((count, 2))
        if self.sides is not None:
            return np.array(self.sides) * rng.random((count, 2))
        angle, distance = 2.0 * pi * rng.random(count), self.radius * np.sqrt(rng.random(count))
        return distance[:, None] * np.column_stack((np.cos(angle), np.sin(angle)))
