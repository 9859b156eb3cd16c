"""Particles of a rank on the host, with their contact histories."""

from dataclasses import dataclass

import numpy as np

from granflow.engine.ranks import Arrays
from granflow.parallel.communicator import joined
from granflow.parallel.histories import Histories, joined_histories


@dataclass(frozen=True)
class Owned:
    """n particles that a rank owns, or sends to another one.

    arrays:     saved fields (n, ...) by name
    histories:  of these particles
    """

    arrays: Arrays
    histories: Histories

    def of(self, rows: np.ndarray) -> "Owned":
        """The particles with these indices (k,), in this order."""
        return Owned({name: values[rows] for name, values in self.arrays.items()}, self.histories.of(rows))


def joined_owned(parts: list[Owned]) -> Owned:
    """The particles of several parts, one part after the other."""
    return Owned(joined([part.arrays for part in parts]), joined_histories([part.histories for part in parts]))
