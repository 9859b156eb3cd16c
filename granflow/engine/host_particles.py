"""Particles on the host, with their contact histories: for checkpoints, and for migration between MPI ranks."""

from dataclasses import dataclass, replace

import numpy as np

from granflow.engine.contact_histories import Histories, joined_histories
from granflow.engine.ranks import Arrays
from granflow.geometry.periodic_box import PeriodicBox

PRESENT = "present_position"
"""Name of the present positions while `position` contains earlier ones."""


@dataclass(frozen=True)
class HostParticles:
    """n particles.

    arrays:     saved fields (n, ...) by name
    histories:  of these particles
    """

    arrays: Arrays
    histories: Histories

    @property
    def count(self) -> int:
        """Number n of particles."""
        return len(self.arrays["id"])

    def of(self, rows: np.ndarray) -> "HostParticles":
        """The particles with these indices (k,), in this order."""
        return HostParticles({name: values[rows] for name, values in self.arrays.items()}, self.histories.of(rows))

    def by_id(self) -> "HostParticles":
        """The particles in the order of their ids, the contacts of each in the order of the partners."""
        ordered = self.of(np.argsort(self.arrays["id"]))
        return replace(ordered, histories=ordered.histories.by_partner())

    def at_rebuild(self, periodic_box: PeriodicBox) -> "HostParticles":
        """The particles at their positions at the last rebuild, in the box; `at_present` is the inverse."""
        arrays, position = self.arrays, periodic_box.wrap(self.arrays["position_at_rebuild"])
        if "clump_position" in arrays:
            arrays = arrays | {"clump_position": arrays["clump_position_at_rebuild"]}
        return replace(self, arrays=arrays | {"position": position, PRESENT: arrays["position"]})


def at_present(arrays: Arrays) -> Arrays:
    """Arrays of particles of `HostParticles.at_rebuild`, at their present positions."""
    return arrays | {"position": arrays[PRESENT]}


def joined_arrays(parts: list[Arrays]) -> Arrays:
    """Arrays (n, ...) of several parts, one part after the other; all parts have the same names.

    If one part only has rows, its arrays are not copied.
    """
    filled = [part for part in parts if any(map(len, part.values()))] or parts[:1]
    if len(filled) == 1:
        return filled[0]
    return {name: np.concatenate([part[name] for part in filled]) for name in parts[0]}


def joined_particles(parts: list[HostParticles]) -> HostParticles:
    """The particles of several parts, one part after the other."""
    histories = joined_histories([part.histories for part in parts])
    return HostParticles(joined_arrays([part.arrays for part in parts]), histories)
