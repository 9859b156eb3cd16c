"""What is counted on the host: who came, who left, and the energy they brought or took."""

from dataclasses import dataclass, field

import numpy as np

from granflow.device.drive import driven_work
from granflow.device.fixed import free_shares
from granflow.device.state import LOSSES, State

SMALLEST_SHARE = 1e-9
"""The ledger's error is taken over no less than this share of the potential energies it adds up."""


@dataclass
class Books:
    """Counts since the start, and facts about every particle by its id."""

    inserted_count: int = 0
    deleted_count: int = 0
    deleted_mass: float = 0.0
    brought_energy: float = 0.0
    removed_energy: float = 0.0
    removed_kinetic_energy: float = 0.0
    outlets: dict[str, list[float]] = field(default_factory=dict)
    """Count and mass [kg] of what every outlet took."""
    waiting_count: int | None = None
    """Particles that wait for room to come in; None where none come in."""
    material: list[np.ndarray] = field(default_factory=list)
    group: list[np.ndarray] = field(default_factory=list)

    def by_id(self, name: str, ids: np.ndarray) -> np.ndarray:
        """`material` or `group` numbers of the scene for particle ids."""
        parts = getattr(self, name)
        if len(parts) > 1:
            parts[:] = [np.concatenate(parts)]
        return parts[0][ids] if parts else np.zeros(len(ids), np.int32)


def mechanical_energy(arrays: dict[str, np.ndarray], gravity: np.ndarray) -> tuple[float, float, float]:
    """Kinetic, rotational and gravitational energy [J] of particles; fixed ones have none.

    `arrays`: mass (n,), radius (n,), position (n, 3), velocity (n, 3) and, if they turn, spin (n, 3).
    """
    mass = arrays["mass"].astype(float) * free_shares(arrays)
    kinetic = 0.5 * float(mass @ np.sum(arrays["velocity"].astype(float) ** 2, axis=1))
    rotational = 0.0
    if "spin" in arrays:
        inertia = 0.4 * mass * arrays["radius"].astype(float) ** 2
        rotational = 0.5 * float(inertia @ np.sum(arrays["spin"].astype(float) ** 2, axis=1))
    return kinetic, rotational, -float(mass @ (arrays["position"] @ gravity))


def ledger_totals(
    state: State, books: Books, energies: tuple[float, float, float], measured: dict[str, float]
) -> dict[str, float]:
    """The energy ledger [J], and its error over the energy that passed through it.

    Whatever gravity, initial motion, arriving particles and walls put in must be found again as kinetic, elastic,
    dissipated or taken away.
    """
    assert state.control.losses is not None
    losses = dict(zip(LOSSES, state.control.losses.to_numpy().sum(axis=0).tolist(), strict=True))
    losses["plastic"] += measured["plastic_dissipation"]
    losses["wall_work"] += driven_work(state)
    border = state.control.border_work
    border_work = {} if border is None else {"border_work": float(border.to_numpy().sum())}
    dissipated = sum(losses[name] for name in ("plastic", "friction", "rolling", "damping"))
    held = sum(energies) + measured["elastic_energy"]
    removed = books.removed_energy - books.brought_energy
    missing = held + dissipated + removed - losses["wall_work"] - sum(border_work.values())
    passed = energies[0] + energies[1] + measured["elastic_energy"] + dissipated + books.removed_kinetic_energy
    rounding = SMALLEST_SHARE * (abs(energies[2]) + abs(removed))
    scale = max(passed, rounding)
    return {
        "gravitational_energy": energies[2],
        "elastic_energy": measured["elastic_energy"],
        "plastic_dissipation": losses["plastic"],
        "friction_dissipation": losses["friction"],
        "rolling_dissipation": losses["rolling"],
        "damping_dissipation": losses["damping"],
        "wall_work": losses["wall_work"],
        **border_work,
        "removed_energy": removed,
        "energy_error": missing / scale if scale > 0.0 else 0.0,
    }
