"""Bytes and operations of each phase, counted from the fields there are: the only place where they are counted.

    bytes of motion = N (read + written of every field that motion touches)
    bytes of forces = N (fields of a particle once, force and torque twice) + S (number of the partner, whether it
                      touches) + C (history read and written)
    bytes of search = N (traveling fields 4 times, position twice, 8 integers)
                      + S (number of the partner and whether it touches, read and written)
                      + C (history and partner read twice, written twice)

N particles, S near pairs as they stand in the rows, C those that touch. A partner's fields count once for each
particle, not for each pair: particles are sorted in space, so that partners are in the first-level cache. This is
the least that must move; a phase that moves more shows a lower fraction of its bound.

Operations are those of the source: a sum or product is one, a root and a quotient are counted apart.
"""

from dataclasses import dataclass
from math import pi
from typing import Any

MOTION_READ = ("position", "velocity", "angular_velocity", "mass", "radius", "force", "torque", "position_at_rebuild")
MOTION_WRITTEN = ("position", "velocity", "velocity_synchronized", "angular_velocity")
FORCES_READ = ("position", "velocity", "velocity_synchronized", "angular_velocity", "radius", "mass", "material")
FORCES_WRITTEN = ("force", "torque")
INTEGER = 4
ROW_INTEGERS, SORT_INTEGERS = 3, 8


@dataclass(frozen=True)
class Operations:
    """Sums and products, square roots, quotients."""

    simple: float = 0.0
    roots: float = 0.0
    quotients: float = 0.0

    def __add__(self, other: "Operations") -> "Operations":
        return Operations(
            self.simple + other.simple, self.roots + other.roots, self.quotients + other.quotients
        )  # fmt: skip

    def times(self, number: float) -> "Operations":
        """As many operations, `number` times."""
        return Operations(number * self.simple, number * self.roots, number * self.quotients)

    def seconds(self, limits: dict[str, float]) -> float:
        """Time on the machine measured: two simple operations in the time of a product and a sum."""
        pairs = 0.5 * self.simple * limits["product_sum_seconds"]
        return pairs + self.roots * limits["root_seconds"] + self.quotients * limits["quotient_seconds"]


MOTION = Operations(35, 0, 2)
"""Kick 3 + 3, present velocity 6, drift 6, inertia and spin 3 + 6, distance traveled 3 + 5; dt/m and dt/I."""
DISTANCE = Operations(10)
"""Difference 3, its square 5, the sum of the radii and its square 2."""
GEOMETRY = Operations(47, 1, 3)
"""Normal 4, relative velocity 3, its rates 6 + 8, sliding 6, mean normal 8, effective radius, mass and arms 12."""
FRICTION = Operations(87, 2, 1)
"""Slip 21, stiffness 3, history turned 11 + 3, spring and Coulomb 16, moments 15, sums on both grains 18."""
NORMAL = {
    "hertz": Operations(8, 2, 0),
    "zhou": Operations(14, 4, 1),
    "linear": Operations(5, 0, 0),
}
"""zhou on its unloading branch; in loading it has 4 operations and one root."""
PLACING = Operations(12)
"""Cell of one particle, twice, and the sort's comparisons."""
TESTS_PER_SLOT = 27.0 / (4.0 / 3.0 * pi)
"""Distances tested for one pair found: 27 cells over the sphere of reach within them; each pair is tested once."""


@dataclass(frozen=True)
class BytesMoved:
    """What a state holds: particles, rows, and sizes of fields by name [bytes an entry]."""

    particles: int
    list_entries: int
    touching: int
    fields: dict[str, int]
    traveling: int
    history: int
    law: str
    friction: bool

    def size(self, names: tuple[str, ...]) -> int:
        """Bytes of these fields for one particle; those that the plan left out have none."""
        return sum(self.fields.get(name, 0) for name in names)


def load_of(state: Any, list_entries: int, touching: int) -> BytesMoved:
    """Read the sizes off the state."""
    names = {*MOTION_READ, *MOTION_WRITTEN, *FORCES_READ, *FORCES_WRITTEN}
    held = {name: getattr(state.particles, name, None) for name in names}
    plan = state.plan
    return BytesMoved(
        particles=state.count,
        list_entries=list_entries,
        touching=touching,
        fields={name: entry_size(field) for name, field in held.items() if field is not None},
        traveling=sum(map(entry_size, state.particles.sorted_fields())),
        history=sum(map(entry_size, state.neighbors.history.values())),
        law=plan.law.name,
        friction=plan.features.friction,
    )


def entry_size(field: Any) -> int:
    """Bytes of one entry of a Taichi field."""
    return int(getattr(field, "n", 1) * getattr(field, "m", 1) * (8 if "64" in str(field.dtype) else 4))


def bytes_of(load: BytesMoved) -> dict[str, float]:
    """Least bytes of each phase, once."""
    n, row = load.particles, ROW_INTEGERS * INTEGER
    return {
        "motion": n * (load.size(MOTION_READ) + load.size(MOTION_WRITTEN)),
        "forces": n * (load.size(FORCES_READ) + 2 * load.size(FORCES_WRITTEN) + row)
        + load.list_entries * 2 * INTEGER
        + load.touching * 2 * load.history,
        "search": n * (4 * load.traveling + 2 * load.size(("position",)) + SORT_INTEGERS * INTEGER)
        + load.list_entries * 4 * INTEGER
        + load.touching * 4 * (INTEGER + load.history),
    }


def operations_of(load: BytesMoved) -> dict[str, Operations]:
    """Operations of each phase, once."""
    contact = GEOMETRY + NORMAL[load.law] + (FRICTION if load.friction else Operations())
    return {
        "motion": MOTION.times(load.particles),
        "forces": DISTANCE.times(load.list_entries) + contact.times(load.touching),
        "search": PLACING.times(load.particles) + DISTANCE.times(TESTS_PER_SLOT * load.list_entries),
    }
