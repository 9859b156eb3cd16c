"""Lattices of touching particles for the stability limit of the time step: single particles, a chain, a dense block.

Particles at the boundary are anchors, too heavy to move; they confine the free particles as in the interior of a bed.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

CHAIN_LENGTH = 10
"""Number of free particles of the chain."""

HALF_CELLS = 6
"""Edge length of the dense block, in halves of its cubic cell."""


@dataclass(frozen=True)
class TestLattice:
    """Particle centers (n, 3) over the nearest-neighbor distance, and anchor flags (n,) bool."""

    centers: np.ndarray
    is_anchor: np.ndarray

    @property
    def max_contacts(self) -> int:
        """Largest number of simultaneous contacts per particle that `check` can assume."""
        return len(self.centers) - 1

    @property
    def has_free_pairs(self) -> bool:
        """Whether free particles touch each other; otherwise they touch anchors only."""
        return int(np.sum(~self.is_anchor)) > 1


def _confined_particle(directions: np.ndarray) -> TestLattice:
    """One free particle between anchors at unit distance in the given directions (n, 3)."""
    unit = directions / np.linalg.norm(directions, axis=1)[:, None]
    return TestLattice(np.concatenate([np.zeros((1, 3)), unit]), np.arange(len(unit) + 1) > 0)


def _chain() -> TestLattice:
    """Straight chain along z with an anchor at each end."""
    place = np.arange(CHAIN_LENGTH + 2)
    return TestLattice(place[:, None] * np.array([[0.0, 0.0, 1.0]]), (place == 0) | (place == CHAIN_LENGTH + 1))


def _block() -> TestLattice:
    """Face-centered cubic packing enclosed by anchors."""
    points = np.array([p for p in product(range(HALF_CELLS + 1), repeat=3) if sum(p) % 2 == 0])
    return TestLattice(points / np.sqrt(2.0), np.any((points == 0) | (points == HALF_CELLS), axis=1))


_AXES = np.concatenate([np.eye(3), -np.eye(3)])
"""Directions (6, 3) of a particle in a simple cubic packing to its neighbors."""

_DIAGONALS = np.array([p for p in product((-1.0, 0.0, 1.0), repeat=3) if sum(map(abs, p)) == 2.0])
"""Directions (12, 3) of a particle in a face-centered cubic packing to its neighbors."""


LATTICES: Mapping[str, TestLattice] = {
    "between 2": _confined_particle(_AXES[[2, 5]]),
    "between 6": _confined_particle(_AXES),
    "between 12": _confined_particle(_DIAGONALS),
    "chain of 10": _chain(),
    "densest packing": _block(),
}
"""Lattices by name: one particle between anchors, a straight chain, and a block with 12 contacts per particle."""
