"""How the data of all MPI ranks form the totals and arrays of a run; a process that is alone has all of them."""

from typing import Protocol

import numpy as np

Arrays = dict[str, np.ndarray]
"""Arrays by name, of the particles of one rank or of all."""

NO_CHANGES = "Changes from Python do not work on MPI ranks: run without a communicator."
"""Message of a change of particles, walls or forces during a run on ranks."""


class Gathering(Protocol):
    """Combines what each rank has. All ranks call each function."""

    def total(self, words: np.ndarray) -> np.ndarray:
        """Numbers (n, ...), summed over the first axis of all ranks if there are several; integers exactly."""

    def largest(self, value: float) -> float:
        """Largest value of all ranks."""

    def gathered(self, arrays: Arrays) -> Arrays:
        """Arrays (n, ...) of all ranks, one rank after the other; complete on the root only."""


class OneProcess:
    """A run without MPI."""

    def total(self, words: np.ndarray) -> np.ndarray:
        """The integers."""
        return words

    def largest(self, value: float) -> float:
        """The value."""
        return value

    def gathered(self, arrays: Arrays) -> Arrays:
        """The arrays."""
        return arrays


ALONE = OneProcess()
"""Without MPI, or for arrays that are those of all ranks already."""
