"""The record that every normal contact law fills in, one law per file."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from granflow.laws.material import PairMaterial


class PhaseDurations(Protocol):
    """Durations [s] of loading and of unloading in a binary collision."""

    def __call__(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> tuple[float, float]:
        """Loading and unloading duration at an approach velocity [m/s]."""


@dataclass(frozen=True)
class NormalLaw:
    """One normal contact law: what it needs, what it remembers, and its functions.

    The device functions take and return values only. `constants` is the vector of this law's pair constants
    in the order of `constant_names`, `history` the vector of what the contact remembers in the order of
    `history_names` (both at least one long; a law without history gets one unused number).

    force(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history)
        -> (normal_force, the viscous part of it, history)
    stored_energy(constants, radius_eff, mass_eff, time_step, overlap, history) -> recoverable energy [J]
    lost_energy(constants, radius_eff, mass_eff, time_step, overlap, history) -> energy this contact took for good
        that is a function of its history alone (plastic work) [J]
    lateral_stiffness(constants, radius_eff, overlap, history) -> Mindlin's no-slip stiffness [N/m]
    """

    name: str
    source: str
    constant_names: tuple[str, ...]
    history_names: tuple[str, ...]
    rate_dependent: bool
    lateral_grows: bool
    """True where the lateral stiffness goes with the square root of the overlap."""
    pair_constants: Callable[[PairMaterial], tuple[float, ...]]
    force: Any
    stored_energy: Any
    lost_energy: Any
    lateral_stiffness: Any
    reference_force: Callable[..., tuple[float, np.ndarray]]
    """Numpy twin of `force`, same arguments, written from the source and not from the kernel."""
    phase_durations: PhaseDurations
    unloading_stiffness: Callable[[PairMaterial, float, float, float], float]
    """Steepest tangent [N/m] met in a binary collision: (pair, radius_eff, mass_eff, velocity)."""

    prepare: Any = None
    """`force` in two parts, for loops over many contacts: (same arguments) -> history, with whatever branches."""
    prepared_force: Any = None
    """What is left of `force` after `prepare`: arithmetic that a compiler can do for several contacts at once.

    None in both where `force` itself is that.
    """

    @property
    def history_count(self) -> int:
        """How many numbers a contact of this law remembers."""
        return len(self.history_names)
