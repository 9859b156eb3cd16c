"""Hertz contact: elastic, or with viscous damping that gives the requested restitution at every velocity."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from granflow.contact import theory
from granflow.contact.law import ContactModel, ContactState, ModelRequest, NormalLaw
from granflow.contact.material import PairMaterial
from granflow.contact.step_corrections import build_step_mean, reference_step_mean
from granflow.device_functions import ti

DAMPING_POWER = 0.25
"""Exponent of the overlap in the viscous force."""

_step_mean = build_step_mean(DAMPING_POWER)


@dataclass(frozen=True)
class HertzSpring(NormalLaw):
    """Base class of viscous models with the elastic force of Hertz."""

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Energy of the Hertz spring [J], (2/5) k d^2.5; exact integral of the elastic force."""
        k = 4.0 / 3.0 * constants.modulus_eff * ti.sqrt(contact.radius_eff)
        return 0.4 * k * contact.overlap * contact.overlap * ti.sqrt(contact.overlap)

    def unloading_stiffness(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> float:
        """Hertz tangent at the maximum overlap [N/m]."""
        return theory.hertz_tangent(pair, radius_eff, mass_eff, velocity)


@dataclass(frozen=True)
class Hertz(HertzSpring):
    """Hertz spring with Tsuji's damping.

    damped:  True if any pair has a restitution below 1; otherwise the viscous force is compiled out
    """

    damped: bool

    name = "hertz"
    source = "Hertz 1882; Tsuji et al. 1992; Antypov & Elliott 2011, doi 10.1209/0295-5075/94/50004"
    limits = "e does not depend on velocity; the viscous force is numerical and has no physical basis"
    constant_names = ("modulus_eff", "shear_modulus_eff", "viscosity")
    """Viscosity: sqrt(5) zeta [-]."""

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "Hertz":
        """The law that a scene requests."""
        return cls(any(pair.restitution != 1.0 for pair in request.pairs))

    @property
    def rate_dependent(self) -> bool:
        """Whether the contact has damping."""
        return self.damped

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Values of `constant_names`; the viscosity is sqrt(5) zeta, see `force`.

        Raises ValueError if the restitution is 0 or depends on velocity.
        """
        if not isinstance(pair.restitution, float):
            raise ValueError("the contact model hertz requires one number as restitution coefficient")
        zeta = theory.damping_ratio_for(pair.restitution)
        return pair.modulus_eff, pair.shear_modulus_eff, float(np.sqrt(5.0)) * zeta

    @ti.func
    def force(self, constants, contact, history):
        """Elastic force with Tsuji's damping, limited so that the total is never attractive.

        F = k d^1.5 + sqrt(5) zeta sqrt(M k) d^(1/4) d'       (Tsuji 1992; Antypov & Elliott 2011)

        where d^(1/4) is averaged over the step.
        """
        stiffness = 4.0 / 3.0 * constants.modulus_eff
        elastic = stiffness * ti.sqrt(contact.radius_eff * contact.overlap) * contact.overlap
        viscous = 0.0 * elastic
        if ti.static(self.damped):
            overlap_at, weight = _step_mean(contact.overlap, contact.overlap_rate, contact.time_step)
            secant = stiffness * ti.sqrt(contact.radius_eff * overlap_at)
            damping = constants.viscosity * weight * ti.sqrt(contact.mass_eff * secant)
            viscous = ti.max(damping * contact.overlap_rate, -elastic)
        return elastic + viscous, viscous, history

    @ti.func
    def damping(self, constants, contact, history):
        """sqrt(5) zeta sqrt(M k) d^(1/4) [N s/m]."""
        secant = 4.0 / 3.0 * constants.modulus_eff * ti.sqrt(contact.radius_eff * contact.overlap)
        return constants.viscosity * ti.sqrt(contact.mass_eff * secant)

    def reference(self, contact: ContactState) -> tuple[float, Mapping[str, float]]:
        """Reference implementation of `force` in numpy."""
        k = theory.hertz_stiffness(contact.constants.modulus_eff, contact.radius_eff)
        viscosity = contact.constants.viscosity
        root = reference_step_mean(DAMPING_POWER, contact.overlap, contact.overlap_rate, contact.time_step)
        viscous = viscosity * np.sqrt(contact.mass_eff * k) * root * contact.overlap_rate
        elastic = k * contact.overlap**1.5
        return float(elastic if viscosity == 0.0 else max(elastic + viscous, 0.0)), {}

    def viscosity(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Viscous force over overlap rate [N s/m], at the maximum overlap without damping."""
        k = float(theory.hertz_stiffness(pair.modulus_eff, radius_eff))
        largest = float(theory.overlap_max(k, mass_eff, velocity))
        return self.pair_constants(pair)[2] * float(np.sqrt(mass_eff * k) * largest**0.25)

    def phase_durations(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> tuple[float, float]:
        """Loading and unloading durations [s] of the undamped contact (Zhou 2011, Eq. 13 with e = 1).

        eta1 Ts,   Ts = (25 M^2 / (16 k^2 v))^(1/5)
        """
        k = float(theory.hertz_stiffness(pair.modulus_eff, radius_eff))
        half = theory.LOADING_DURATION * float(theory.time_scale(k, mass_eff, velocity))
        return half, half


MODEL = ContactModel(
    Hertz, "Hertz spring; viscous damping from the restitution number of each pair (1: elastic)."
)
