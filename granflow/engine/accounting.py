"""Accounting on the host: inserted and deleted particles with their energies, and the energy budget."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from granflow.engine.frozen_masks import mobility_mask
from granflow.engine.state import State
from granflow.engine.wall_dynamics import controlled_work
from granflow.plan.chunk_sums import LOSSES

LARGEST_ERROR = 5e-3
"""Magnitude of the energy error above which a run warns."""

ROUNDING = {"f64": 1e-9, "mixed": 1e-6, "f32": 1e-5}
"""Rounding error of the energy budget, relative to its potential energies, by precision.

It results from the masses; in f32 also from the positions.
"""


@dataclass
class Accounting:
    """Counts and energies since the start, and `material` and `group` of every particle by its id.

    inserted_count:          number of inserted particles
    deleted_count:           number of deleted particles
    deleted_mass:            [kg]
    inserted_energy:         mechanical energy [J] of inserted particles, and of contacts of walls that appeared
    removed_energy:          mechanical energy [J] of deleted particles
    removed_kinetic_energy:  translational and rotational part of it [J]
    material, group:         lists of integer arrays (k,), numbers of the scene, concatenated at first use
    """

    inserted_count: int = 0
    deleted_count: int = 0
    deleted_mass: float = 0.0
    inserted_energy: float = 0.0
    removed_energy: float = 0.0
    removed_kinetic_energy: float = 0.0
    energy_put_in: float = 0.0
    """Largest energy input [J] of all snapshots so far; see `energy_input`."""
    outlets: dict[str, list[float]] = field(default_factory=dict)
    """Count and mass [kg] of the particles deleted by each outlet."""
    queued_count: int | None = None
    """Particles queued for insertion; None without insertion."""
    material: list[np.ndarray] = field(default_factory=list)
    group: list[np.ndarray] = field(default_factory=list)

    def by_id(self, name: str, ids: np.ndarray) -> np.ndarray:
        """`material` or `group` numbers (n,) of the scene for particle ids (n,)."""
        parts = getattr(self, name)
        if len(parts) > 1:
            parts[:] = [np.concatenate(parts)]
        return parts[0][ids] if parts else np.zeros(len(ids), np.int32)


def mechanical_energy(arrays: dict[str, np.ndarray], gravity: np.ndarray) -> tuple[float, float, float]:
    """Kinetic, rotational and gravitational energy [J] of the particles; a fixed particle contributes none.

        m v^2 / 2,   (2/5) m R^2 w^2 / 2,   -m g . x        summed in float64

    arrays:   mass (n,) [kg], radius (n,) [m], position (n, 3) [m], velocity (n, 3) [m/s] and, if particles rotate,
              angular_velocity (n, 3) [rad/s]
    gravity:  (3,) [m/s2]
    """
    mass = arrays["mass"].astype(float) * mobility_mask(arrays)
    kinetic = 0.5 * float(mass @ np.sum(arrays["velocity"].astype(float) ** 2, axis=1))
    rotational = 0.0
    if "angular_velocity" in arrays:
        inertia = 0.4 * mass * arrays["radius"].astype(float) ** 2
        rotational = 0.5 * float(inertia @ np.sum(arrays["angular_velocity"].astype(float) ** 2, axis=1))
    return kinetic, rotational, -float(mass @ (arrays["position"] @ gravity))


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


def energy_budget_totals(
    state: State, accounting: Accounting, energies: tuple[float, float, float], measured: dict[str, float]
) -> dict[str, float]:
    """The energy budget [J], and its error: the residual over the largest energy input so far.

        residual = K + U + E_elastic + E_dissipated + E_deleted - E_inserted - W
        energy_error = residual / max(E_in over all snapshots so far, rounding / LARGEST_ERROR)

    energies:  kinetic, rotational and gravitational energy [J]
    measured:  totals of ContactStatistics
    Returns:   totals by the names of TOTAL_QUANTITIES

    The scale is the largest E_in, because the present E_in can be zero: a bouncing sphere at its highest point has
    returned all of it. If E_in is below the rounding error of the potential energies, the rounding error is the scale,
    so that rounding does not count as an energy error.
    """
    assert state.control.losses is not None
    losses = dict(zip(LOSSES, state.control.losses.to_numpy().sum(axis=0).tolist(), strict=True))
    losses["plastic"] += measured["plastic_dissipation"]
    losses["wall_work"] += controlled_work(state)
    boundary = state.control.boundary_work
    boundary_work = {} if boundary is None else {"boundary_work": float(boundary.to_numpy().sum())}
    dissipated = sum(losses[name] for name in ("plastic", "friction", "rolling", "damping"))
    present_energy = sum(energies) + measured["elastic_energy"]
    removed = accounting.removed_energy - accounting.inserted_energy
    works = (losses["wall_work"], *boundary_work.values())
    residual = present_energy + dissipated + removed - sum(works)
    accounting.energy_put_in = max(accounting.energy_put_in, energy_input(accounting, energies[2], works))
    rounding = ROUNDING[state.backend.precision] * (abs(energies[2]) + abs(removed))
    scale = max(accounting.energy_put_in, rounding / LARGEST_ERROR)
    return {
        "gravitational_energy": energies[2],
        "elastic_energy": measured["elastic_energy"],
        "plastic_dissipation": losses["plastic"],
        "friction_dissipation": losses["friction"],
        "rolling_dissipation": losses["rolling"],
        "damping_dissipation": losses["damping"],
        "wall_work": losses["wall_work"],
        **boundary_work,
        "removed_energy": removed,
        "energy_error": residual / scale if scale > 0.0 else 0.0,
    }
