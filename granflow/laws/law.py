"""The record that every normal contact law fills in, one law per file."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from granflow.laws.material import PairMaterial


@dataclass(frozen=True)
class ModelRequest:
    """What a scene asks of its normal law: settings as in `contact.normal`, its pairs, and what bounds the law."""

    settings: Mapping[str, Any]
    pairs: tuple[PairMaterial, ...]
    velocity_max: float
    unloading_angle: float


@dataclass(frozen=True)
class ContactState:
    """One contact at one step, SI: what `force` gets, for its numpy twin. `overlap_rate` > 0 approaching."""

    constants: np.ndarray
    radius_eff: float
    mass_eff: float
    time_step: float
    overlap: float
    overlap_rate: float
    history: np.ndarray


ReferenceForce = Callable[[ContactState], tuple[float, np.ndarray]]
"""Numpy twin of `force`: normal force [N] and history."""


class PhaseDurations(Protocol):
    """Durations [s] of loading and of unloading in a binary collision."""

    def __call__(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> tuple[float, float]:
        """Loading and unloading duration at an approach velocity [m/s]."""


class CollisionNumber(Protocol):
    """One number that a binary collision has."""

    def __call__(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """The number at an approach velocity [m/s]."""


class LeastRestitution(Protocol):
    """Smallest restitution that a time step [s] lets a binary collision reach."""

    def __call__(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float, time_step: float
    ) -> float:
        """The restitution at an approach velocity [m/s]."""


def requested_restitution(pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
    """Restitution that the pair asks for, where the law promises to reach it."""
    return pair.restitution_at(velocity)


@dataclass(frozen=True)
class NormalLaw:
    """One normal contact law: what it needs, what it remembers, and its functions.

    The device functions take and return values only. `constants` is the vector of this law's pair constants
    in the order of `constant_names`, `history` the vector of what the contact remembers in the order of
    `history_names` (both at least one long; a law without history gets one unused number). The first number of a
    history is above 0 from the first step of a contact on.

    force(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history)
        -> (normal_force, the viscous part of it, history)
    stored_energy(constants, radius_eff, mass_eff, time_step, overlap, history) -> recoverable energy [J]
    lost_energy(constants, radius_eff, mass_eff, time_step, overlap, history) -> energy this contact took for good
        that is a function of its history alone (plastic work) [J]
    lateral_stiffness(constants, radius_eff, overlap, history) -> Mindlin's no-slip stiffness [N/m]
    attraction(constants, radius_eff, overlap, history) -> pulling part of `force` [N] that does not press the surfaces
        together, so that friction is capped with normal_force + attraction; None where there is none
    """

    name: str
    source: str
    limits: str
    """What goes wrong with this law, in a sentence."""
    constant_names: tuple[str, ...]
    history_names: tuple[str, ...]
    rate_dependent: bool
    tangential_stiffness_grows: bool
    """True where the lateral stiffness goes with the square root of the overlap."""
    pair_constants: Callable[[PairMaterial], tuple[float, ...]]
    force: Any
    stored_energy: Any
    lost_energy: Any
    tangential_stiffness: Any
    reference: ReferenceForce
    """Numpy twin of `force`, written from the source and not from the kernel."""
    phase_durations: PhaseDurations
    unloading_stiffness: CollisionNumber
    """Steepest tangent [N/m] met in a binary collision."""
    stable_stiffness: CollisionNumber
    """Tangent [N/m] that a grain held between others can feel at the largest overlap; it bounds the time step."""
    loading_tangent: CollisionNumber | None = None
    """Tangent [N/m] that 4 G/E of is the lateral stiffness at the largest overlap; None: `stable_stiffness`."""
    damping: CollisionNumber | None = None
    """Viscous force over the rate of overlap, at the largest overlap of a collision [N s/m]; None: there is none."""
    unloading_angle: float = 0.0
    """theta of a law that bounds its unloading tangent by theta^2 M/dt^2; 0 where there is no such bound."""
    unresolved_unloading: float = 0.0
    """Unloading faster than this share of loading needs no resolving steps: the law bounds its tangent itself."""
    restitution: CollisionNumber = requested_restitution
    """Restitution that the law promises in a binary collision, at a time step that resolves it."""
    least_restitution: LeastRestitution | None = None
    """For a law that bounds its unloading by the time step."""
    attraction: Any = None
    prepare: Any = None
    """(same arguments as `force`) -> history: the rare work that has branches, such as a contact that opens.

    Done before `force`, which can then be arithmetic that a compiler does for several contacts at once.
    """

    branch_free: bool = False
    """True where `force` has no branch, so that contacts can be worked out in batches; others list all partners."""

    def loading_stiffness(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Tangent [N/m] at the largest overlap that the lateral stiffness goes with."""
        tangent = self.loading_tangent or self.stable_stiffness
        return tangent(pair, radius_eff, mass_eff, velocity)

    def viscosity(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Viscous force over the rate of overlap, at the largest overlap of a collision [N s/m]."""
        return 0.0 if self.damping is None else self.damping(pair, radius_eff, mass_eff, velocity)

    @property
    def attracts(self) -> bool:
        """Whether the force can pull."""
        return self.attraction is not None

    @property
    def history_count(self) -> int:
        """How many numbers a contact of this law remembers."""
        return len(self.history_names)

    def reference_force(
        self,
        constants: np.ndarray,
        radius_eff: float,
        mass_eff: float,
        time_step: float,
        overlap: float,
        overlap_rate: float,
        history: np.ndarray,
    ) -> tuple[float, np.ndarray]:
        """Normal force [N] and history by the numpy twin, with the arguments of `force`."""
        return self.reference(ContactState(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history))
