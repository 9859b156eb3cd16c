"""Interface of a normal contact model: the record `NormalLaw`. Each model is one file."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from granflow.contact.material import PairMaterial


@dataclass(frozen=True)
class ModelRequest:
    """Request of a scene for a normal contact model.

    settings:         those of `contact.normal`, numbers in SI units
    pairs:            effective constants of all pairs of materials that can be in contact
    velocity_max:     largest expected impact velocity [m/s]
    unloading_angle:  theta of a model that bounds its unloading tangent by theta^2 M/dt^2
    """

    settings: Mapping[str, Any]
    pairs: tuple[PairMaterial, ...]
    velocity_max: float
    unloading_angle: float


@dataclass(frozen=True)
class ContactState:
    """Arguments of `force` for one contact and step, in SI units.

    constants:     (c,) float64, in the order of `constant_names`
    radius_eff:    effective radius [m]
    mass_eff:      effective mass [kg]
    time_step:     [s]
    overlap:       [m], above 0 in a contact
    overlap_rate:  [m/s], positive during approach
    history:       (h,) float64, in the order of `history_names`
    """

    constants: np.ndarray
    radius_eff: float
    mass_eff: float
    time_step: float
    overlap: float
    overlap_rate: float
    history: np.ndarray


ReferenceForce = Callable[[ContactState], tuple[float, np.ndarray]]
"""Reference implementation of `force` in numpy; returns the normal force [N] and the history (h,)."""


class PhaseDurations(Protocol):
    """Loading and unloading durations [s] of a binary collision.

    pair:        effective constants of the materials
    radius_eff:  effective radius [m]
    mass_eff:    effective mass [kg]
    velocity:    approach velocity [m/s], above 0
    """

    def __call__(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> tuple[float, float]:
        """Loading and unloading durations [s] at an approach velocity [m/s]."""


class CollisionNumber(Protocol):
    """Scalar property of a binary collision; arguments as for PhaseDurations."""

    def __call__(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Value at an approach velocity [m/s]."""


class LeastRestitution(Protocol):
    """Smallest restitution that a binary collision can reach at a given time step [s].

    The other arguments are those of PhaseDurations.
    """

    def __call__(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float, time_step: float
    ) -> float:
        """Restitution at an approach velocity [m/s]."""


def requested_restitution(pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
    """Restitution given for the pair; default for models that reproduce it exactly.

    Raises ValueError if the pair has none.
    """
    return pair.restitution_at(velocity)


@dataclass(frozen=True)
class NormalLaw:
    """A normal contact model: pair constants, history fields, device functions and closed forms.

    The device functions take and return values only. `constants` is the vector of pair constants in the order of
    `constant_names`, `history` the vector of history fields in the order of `history_names` (both have at least one
    component; a model without history gets one unused number). The first history field is positive from the first
    step of a contact on.

    force(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history)
        -> (normal_force [N], its viscous part [N], history)
    stored_energy(constants, radius_eff, mass_eff, time_step, overlap, history) -> recoverable energy [J]
    lost_energy(constants, radius_eff, mass_eff, time_step, overlap, history) -> dissipated energy [J] that is a
        function of the history alone (plastic work)
    tangential_stiffness(constants, radius_eff, overlap, history) -> Mindlin's no-slip stiffness [N/m]
    attraction(constants, radius_eff, overlap, history) -> attractive part of `force` [N] that does not press the
        surfaces together; the friction limit is mu (normal_force + attraction). None: no attraction
    """

    name: str
    source: str
    limits: str
    """Limitations of the model, in one sentence."""
    constant_names: tuple[str, ...]
    history_names: tuple[str, ...]
    rate_dependent: bool
    tangential_stiffness_grows: bool
    """True if the tangential stiffness is proportional to the square root of the overlap."""
    pair_constants: Callable[[PairMaterial], tuple[float, ...]]
    """Constants (c,) of one pair of materials; raises ValueError for a pair that the model does not support."""
    force: Any
    stored_energy: Any
    lost_energy: Any
    tangential_stiffness: Any
    reference: ReferenceForce
    """Reference implementation of `force` in numpy, written from the publication and not from the kernel."""
    phase_durations: PhaseDurations
    unloading_stiffness: CollisionNumber
    """Largest tangent stiffness [N/m] in a binary collision."""
    stable_stiffness: CollisionNumber
    """Tangent stiffness [N/m] at the maximum overlap of a confined particle; it bounds the time step."""
    loading_tangent: CollisionNumber | None = None
    """Normal tangent stiffness [N/m] at the maximum overlap; 4 G/E times it is the tangential stiffness.
    None: `stable_stiffness`."""
    damping: CollisionNumber | None = None
    """Ratio of viscous force to overlap rate at the maximum overlap of a collision [N s/m]; None: no viscous force."""
    unloading_angle: float = 0.0
    """theta of a model that bounds its unloading tangent by theta^2 M/dt^2; 0: no such bound."""
    unresolved_unloading: float = 0.0
    """If the ratio of unloading to loading duration is below this value, the time step need not resolve unloading:
    the model bounds its own tangent."""
    restitution: CollisionNumber = requested_restitution
    """Restitution of a binary collision at a time step that resolves it."""
    least_restitution: LeastRestitution | None = None
    """Smallest restitution, for a model that bounds its unloading tangent by the time step."""
    attraction: Any = None
    prepare: Any = None
    """(same arguments as `force`) -> history: rare operations with branches, such as the initialization of a contact.

    Evaluated before `force`, so that `force` remains branch-free arithmetic that the compiler can vectorize over
    contacts.
    """

    branch_free: bool = False
    """True if `force` has no branch, so that contacts can be evaluated in SIMD batches. Other models use full
    neighbor lists."""

    def loading_stiffness(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Normal tangent stiffness [N/m] at the maximum overlap that determines the tangential stiffness.

        Arguments as for PhaseDurations.
        """
        tangent = self.loading_tangent or self.stable_stiffness
        return tangent(pair, radius_eff, mass_eff, velocity)

    def viscosity(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Ratio of viscous force to overlap rate at the maximum overlap of a collision [N s/m].

        Arguments as for PhaseDurations.
        """
        return 0.0 if self.damping is None else self.damping(pair, radius_eff, mass_eff, velocity)

    @property
    def attracts(self) -> bool:
        """Whether the force can be attractive."""
        return self.attraction is not None

    @property
    def history_count(self) -> int:
        """Number of history fields per contact; 0 for a model without history."""
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
        """Normal force [N] and history (h,) from the reference implementation.

        Arguments as in ContactState.
        """
        return self.reference(ContactState(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history))
