"""Accounting on the host: inserted and deleted particles with their energies."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from granflow.engine.clump_arrays import ROTATION_SHARE, of_clumps
from granflow.engine.exact_sums import exact_sum
from granflow.engine.frozen_masks import mobility_mask
from granflow.engine.ranks import ALONE, Gathering

EXIT_FACES = ("x_min", "y_min", "z_min", "x_max", "y_max", "z_max")
"""Names of the faces of the domain at the smallest and the largest coordinates."""


@dataclass
class Accounting:
    """Counts and energies since the start, and BY_ID: material, group and insertion time of every particle by its id.

    inserted_count:          number of inserted particles
    deleted_count:           number of deleted particles
    deleted_mass:            [kg]
    inserted_energy:         mechanical energy [J] of inserted particles, and of contacts of walls that appeared
    removed_energy:          mechanical energy [J] of deleted particles
    removed_kinetic_energy:  translational and rotational part of it [J]
    material, group:         lists of integer arrays (k,), numbers of the scene, concatenated at first use
    insertion_time:          likewise, float64 [s]
    """

    inserted_count: int = 0
    deleted_count: int = 0
    deleted_mass: float = 0.0
    inserted_energy: float = 0.0
    removed_energy: float = 0.0
    removed_kinetic_energy: float = 0.0
    energy_put_in: float = 0.0
    """Largest energy input [J] at all observations so far; see `energy_input`."""
    outlets: dict[str, list[float]] = field(default_factory=dict)
    """Count and mass [kg] of the particles deleted by each outlet."""
    exits: dict[str, int] = field(default_factory=lambda: dict.fromkeys(EXIT_FACES, 0))
    """Number of particles that left the domain outside all outlets, by the face of the domain."""
    queued_count: int | None = None
    """Particles queued for insertion; None without insertion."""
    material: list[np.ndarray] = field(default_factory=list)
    group: list[np.ndarray] = field(default_factory=list)
    insertion_time: list[np.ndarray] = field(default_factory=list)

    def insert(self, material: np.ndarray, group: np.ndarray, time: float, energy: float) -> None:
        """Record particles inserted at `time` [s]: materials and groups (k,) of the scene, mechanical energy [J]."""
        self.inserted_count += len(group)
        self.inserted_energy += energy
        self.material.append(material)
        self.group.append(group)
        self.insertion_time.append(np.full(len(group), time))

    def delete(self, arrays: Mapping[str, np.ndarray], outlet_index: np.ndarray, gravity: np.ndarray) -> None:
        """Record deleted particles.

        arrays:        as for `mechanical_energy`
        outlet_index:  (n,) index of the outlet that deletes each particle, -1 for none
        gravity:       (3,) [m/s2]
        """
        kinetic, rotational, potential = mechanical_energy(arrays, gravity)
        self.deleted_count += len(arrays["mass"])
        self.deleted_mass += exact_sum(arrays["mass"])
        self.removed_energy += kinetic + rotational + potential
        self.removed_kinetic_energy += kinetic + rotational
        for index, sums in enumerate(self.outlets.values()):
            by_outlet = outlet_index == index
            sums[0] += float(by_outlet.sum())
            sums[1] += exact_sum(arrays["mass"][by_outlet])

    def count_exits(self, faces: np.ndarray) -> None:
        """Count particles that left the domain outside all outlets; `faces` (k,): indices in EXIT_FACES."""
        for index, name in enumerate(EXIT_FACES):
            self.exits[name] += int((faces == index).sum())

    def count_removed(self, mass: np.ndarray) -> None:
        """Count particles with these masses (k,) [kg] that are removed from Python.

        The change of `Engine.stored_energy` contains their energy.
        """
        self.deleted_count += len(mass)
        self.deleted_mass += exact_sum(mass)

    def set_group(self, ids: np.ndarray, group: np.ndarray) -> None:
        """Set the group numbers (n,) of particles with ids (n,)."""
        groups = self.by_id("group", np.arange(self.inserted_count)).copy()
        groups[ids] = group
        self.group[:] = [groups]

    def by_id(self, name: str, ids: np.ndarray) -> np.ndarray:
        """One of BY_ID (n,) for particle ids (n,)."""
        parts = getattr(self, name)
        if len(parts) > 1:
            parts[:] = [np.concatenate(parts)]
        return parts[0][ids] if parts else np.zeros(len(ids), BY_ID[name])

    def state_dict(self) -> dict[str, Any]:
        """Numbers, BY_NAME, and BY_ID (inserted_count,), for checkpoints."""
        ids = np.arange(self.inserted_count)
        by_id = {name: self.by_id(name, ids) for name in BY_ID}
        return {name: getattr(self, name) for name in (*SAVED_NUMBERS, *BY_NAME)} | by_id

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore a state of `state_dict`."""
        for name in (*SAVED_NUMBERS, *BY_NAME):
            setattr(self, name, saved[name])
        for name in BY_ID:
            setattr(self, name, [saved[name]])


BY_ID = {"material": np.int32, "group": np.int32, "insertion_time": np.float64}
"""Types of the arrays of Accounting that have an entry for every particle id."""

BY_NAME = ("outlets", "exits")
"""Attributes of Accounting that have an entry for each outlet and each face of the domain."""

SAVED_NUMBERS = {each.name: each.type for each in fields(Accounting) if each.type in (int, float)}
"""Type of each count, mass and energy of Accounting by name."""


def mechanical_energy(
    arrays: Mapping[str, np.ndarray], gravity: np.ndarray, ranks: Gathering = ALONE
) -> tuple[float, float, float]:
    """Kinetic, rotational and gravitational energy [J] of the particles; a fixed particle contributes none.

        m v^2 / 2,   (2/5) m R^2 w^2 / 2,   -m g . x        the same for any order of the particles

    Each sphere of a clump contributes its share of the energies of the clump, see `of_clumps`.

    arrays:   mass (n,) [kg], radius (n,) [m], position (n, 3) [m], velocity (n, 3) [m/s] and, if particles rotate,
              angular_velocity (n, 3) [rad/s]; with clumps CLUMP_MOTION
    gravity:  (3,) [m/s2]
    ranks:    adds up the energies of all ranks, each of which has arrays of its own particles
    """
    mass = arrays["mass"].astype(float) * mobility_mask(arrays)
    arrays = of_clumps(arrays)
    kinetic = 0.5 * exact_sum(mass * _squares(arrays["velocity"]), ranks)
    rotational = 0.0
    if "angular_velocity" in arrays:
        inertia = 0.4 * mass * arrays["radius"].astype(float) ** 2
        doubled = inertia * _squares(arrays["angular_velocity"])
        if ROTATION_SHARE in arrays:
            doubled = np.where(arrays["clump"] >= 0, arrays[ROTATION_SHARE], doubled)
        rotational = 0.5 * exact_sum(doubled, ranks)
    x, y, z = arrays["position"].astype(float).T
    return kinetic, rotational, -exact_sum(mass * (x * gravity[0] + y * gravity[1] + z * gravity[2]), ranks)


def _squares(vectors: np.ndarray) -> np.ndarray:
    """Squared length (n,) of each of the vectors (n, 3)."""
    x, y, z = vectors.astype(float).T
    squares: np.ndarray = x * x + y * y + z * z
    return squares


def energy_input(accounting: Accounting, potential: float, works: Iterable[float] = ()) -> float:
    """Energy input [J] by gravity, initial motion, insertion, walls and periodic images.

        E_in = max(E_inserted - U - U_deleted, 0) + sum of max(W, 0)

    potential:  U [J], potential energy of the present particles
    works:      W [J], work of the walls and of the images of a sheared box

    E_inserted is the mechanical energy of inserted particles, U_deleted the potential energy of deleted particles. The
    result does not depend on the origin of the potential.
    """
    energy_supplied = (
        accounting.inserted_energy - potential - (accounting.removed_energy - accounting.removed_kinetic_energy)
    )
    return max(energy_supplied, 0.0) + sum(max(work, 0.0) for work in works)
