"""Minimum bytes and operations of each phase, counted from the allocated fields. No other module counts them.

    bytes of integration (motion) = N (fields read + fields written by the integration)
    bytes of forces               = N (fields of a particle once, force and torque twice)
                                    + S (partner index, contact flag) + C (history read and written)
    bytes of a rebuild (search)   = N (sorted fields 4 times, position twice, 8 integers)
                                    + S (partner index and contact flag, read and written)
                                    + C (history and partner read twice, written twice)

N: particles; S: neighbor-list entries; C: entries in contact. The fields of a partner count once for each
particle, not for each pair: particles are sorted in space, so that partners are in the first-level cache.
These are lower bounds; a phase with more traffic reaches a lower fraction of its bound.

Operations are counted in the source: a sum or a product is one operation; roots and quotients are counted
separately.
"""

from dataclasses import dataclass
from math import pi
from typing import Any

from benchmark.roofline import FORCES_READ, FORCES_WRITTEN, INTEGRATION_READ, INTEGRATION_WRITTEN

INTEGER = 4
ROW_INTEGERS, SORT_INTEGERS = 3, 8


@dataclass(frozen=True)
class Operations:
    """Number of sums and products, square roots, and quotients."""

    simple: float = 0.0
    roots: float = 0.0
    quotients: float = 0.0

    def __add__(self, other: "Operations") -> "Operations":
        return Operations(
            self.simple + other.simple, self.roots + other.roots, self.quotients + other.quotients
        )  # fmt: skip

    def times(self, number: float) -> "Operations":
        """These operations, repeated `number` times."""
        return Operations(number * self.simple, number * self.roots, number * self.quotients)

    def seconds(self, limits: dict[str, float]) -> float:
        """Time [s] on the measured machine: two simple operations take the time of one product and sum."""
        pairs = 0.5 * self.simple * limits["product_sum_seconds"]
        return pairs + self.roots * limits["root_seconds"] + self.quotients * limits["quotient_seconds"]


MOTION = Operations(35, 0, 2)
"""Kick 3 + 3, synchronized velocity 6, drift 6, inertia and angular velocity 3 + 6, displacement 3 + 5; dt/m,
dt/I."""
DISTANCE = Operations(10)
"""Difference 3, its square 5, the sum of the radii and its square 2."""
GEOMETRY = Operations(47, 1, 3)
"""Normal 4, relative velocity 3, its rates 6 + 8, sliding 6, mean normal 8, effective radius, mass, lever
arms 12."""
FRICTION = Operations(87, 2, 1)
"""Slip 21, stiffness 3, rotation of history 11 + 3, spring and Coulomb limit 16, torques 15, sums on both
sides 18."""
NORMAL = {
    "hertz": Operations(8, 2, 0),
    "zhou": Operations(14, 4, 1),
    "linear": Operations(5, 0, 0),
}
"""zhou: unloading branch; the loading branch has 4 operations and one root."""
BINNING = Operations(12)
"""Cell of one particle, computed twice, and the comparisons of the sort."""
TESTS_PER_PAIR = 27.0 / (4.0 / 3.0 * pi)
"""Distance tests per pair found: volume of 27 cells over that of the search sphere; each pair is tested
once."""


@dataclass(frozen=True)
class BytesMoved:
    """Particles, neighbor-list entries, and sizes of fields by name [bytes per entry]."""

    particles: int
    list_entries: int
    touching: int
    fields: dict[str, int]
    traveling: int
    history: int
    law: str
    friction: bool

    def size(self, names: tuple[str, ...]) -> int:
        """Bytes of these fields per particle; fields that are not allocated have none."""
        return sum(self.fields.get(name, 0) for name in names)


def load_of(state: Any, list_entries: int, touching: int) -> BytesMoved:
    """Sizes of the fields of a state."""
    names = {*INTEGRATION_READ, *INTEGRATION_WRITTEN, *FORCES_READ, *FORCES_WRITTEN}
    particle_fields = {name: getattr(state.particles, name, None) for name in names}
    plan = state.plan
    return BytesMoved(
        particles=state.count,
        list_entries=list_entries,
        touching=touching,
        fields={name: entry_size(field) for name, field in particle_fields.items() if field is not None},
        traveling=sum(map(entry_size, state.particles.sorted_fields())),
        history=sum(map(entry_size, state.neighbors.history.values())),
        law=plan.laws.normal.name,
        friction=plan.laws.has_tangential,
    )


def entry_size(field: Any) -> int:
    """Size of one entry of a Taichi field [bytes]."""
    return int(getattr(field, "n", 1) * getattr(field, "m", 1) * (8 if "64" in str(field.dtype) else 4))


def bytes_of(load: BytesMoved) -> dict[str, float]:
    """Minimum bytes of one execution of each phase."""
    n = load.particles
    row = ROW_INTEGERS * INTEGER
    return {
        "motion": n * (load.size(INTEGRATION_READ) + load.size(INTEGRATION_WRITTEN)),
        "forces": n * (load.size(FORCES_READ) + 2 * load.size(FORCES_WRITTEN) + row)
        + load.list_entries * 2 * INTEGER
        + load.touching * 2 * load.history,
        "search": n * (4 * load.traveling + 2 * load.size(("position",)) + SORT_INTEGERS * INTEGER)
        + load.list_entries * 4 * INTEGER
        + load.touching * 4 * (INTEGER + load.history),
    }


def operations_of(load: BytesMoved) -> dict[str, Operations]:
    """Operations of one execution of each phase."""
    contact = GEOMETRY + NORMAL[load.law] + (FRICTION if load.friction else Operations())
    return {
        "motion": MOTION.times(load.particles),
        "forces": DISTANCE.times(load.list_entries) + contact.times(load.touching),
        "search": BINNING.times(load.particles) + DISTANCE.times(TESTS_PER_PAIR * load.list_entries),
    }
