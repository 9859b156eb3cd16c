"""Linear spring and dashpot. The stiffness is a number, or follows from Eq. 19 of Zhou (2011)."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from granflow.contact import theory
from granflow.contact.device import build_step_mean, reference_step_mean
from granflow.contact.law import ContactModel, ContactState, HistoryField, ModelRequest
from granflow.contact.material import PairMaterial
from granflow.contact.normal.linear_spring import STIFFNESS, Spring, SpringLaw, quarter_period
from granflow.device_functions import ti

_step_mean = build_step_mean(0.0)


@dataclass(frozen=True)
class Linear(SpringLaw):
    """Linear spring of stiffness K [N/m] and dashpot."""

    name = "linear"
    has_dashpot = True
    source = "Cundall & Strack 1979; spring: Zhou 2011, Eq. 19; damping: Schwager & Poeschel 2007"
    limits = (
        "duration and restitution do not depend on velocity; with damping the force is discontinuous at "
        "first contact"
    )
    constant_names = ("modulus_eff", "shear_modulus_eff", "damping_ratio")

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "Linear":
        """The law that a scene requests."""
        return cls(Spring.from_scene(request))

    @property
    def rate_dependent(self) -> bool:
        """The contact has damping."""
        return True

    @property
    def parameters(self) -> Mapping[str, float]:
        """Those of the spring."""
        return self.spring.parameters

    @property
    def history(self) -> tuple[HistoryField, ...]:
        """The stiffness, unless it is a number."""
        return self.spring_history

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Values of `constant_names`; zeta follows from the restitution (`theory.damping_ratio_for`).

        Raises ValueError if the restitution is 0 or depends on velocity.
        """
        if not isinstance(pair.restitution, float):
            raise ValueError("the contact model linear requires one number as restitution coefficient")
        return pair.modulus_eff, pair.shear_modulus_eff, theory.damping_ratio_for(pair.restitution)

    @ti.func
    def force(self, constants, contact, history):
        """F = max(K d + 2 zeta sqrt(K M) d', 0); K is constant from first contact on.

        In the first step the dashpot acts for the time since first contact only.
        """
        stiffness = self.stiffness_of(constants, contact, history)
        elastic = stiffness * contact.overlap
        _overlap_at, share = _step_mean(contact.overlap, contact.overlap_rate, contact.time_step)
        damping = 2.0 * constants.damping_ratio * share * ti.sqrt(stiffness * contact.mass_eff)
        viscous = ti.max(damping * contact.overlap_rate, -elastic)
        return elastic + viscous, viscous, history

    @ti.func
    def damping(self, constants, contact, history):
        """2 zeta sqrt(K M) [N s/m]."""
        stiffness = self.stiffness_of(constants, contact, history)
        return 2.0 * constants.damping_ratio * ti.sqrt(stiffness * contact.mass_eff)

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Energy of the spring [J], K d^2 / 2."""
        return 0.5 * self.stiffness_of(constants, contact, history) * contact.overlap * contact.overlap

    def reference(self, contact: ContactState) -> tuple[float, Mapping[str, float]]:
        """Reference implementation of `force` in numpy."""
        stiffness, history = self.reference_stiffness(contact)
        rate = (
            reference_step_mean(0.0, contact.overlap, contact.overlap_rate, contact.time_step)
            * contact.overlap_rate
        )
        viscous = 2.0 * contact.constants.damping_ratio * np.sqrt(stiffness * contact.mass_eff) * rate
        return float(max(stiffness * contact.overlap + viscous, 0.0)), history

    def phase_durations(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> tuple[float, float]:
        """Two quarter periods of the undamped spring [s]."""
        quarter = quarter_period(self.loading_stiffness(pair, radius_eff, mass_eff, velocity), mass_eff)
        return quarter, quarter

    def unloading_stiffness(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> float:
        """Stiffness K [N/m]."""
        return self.loading_stiffness(pair, radius_eff, mass_eff, velocity)

    def viscosity(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Dashpot constant 2 zeta sqrt(K M) [N s/m]."""
        stiffness = self.loading_stiffness(pair, radius_eff, mass_eff, velocity)
        return 2.0 * self.pair_constants(pair)[2] * float(np.sqrt(stiffness * mass_eff))


MODEL = ContactModel(
    Linear, "Linear spring and dashpot.", options={"stiffness": STIFFNESS}, example={"stiffness": "onset"}
)
