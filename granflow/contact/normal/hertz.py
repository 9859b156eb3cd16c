"""Hertz contact: elastic, or with viscous damping that gives the requested restitution at every velocity."""

import numpy as np
import taichi as ti

from granflow.contact import theory
from granflow.contact.material import PairMaterial
from granflow.contact.model import ContactState, ModelRequest, NormalLaw
from granflow.contact.substep_corrections import build_step_mean, reference_step_mean
from granflow.contact.tangential.mindlin import mindlin_stiffness

CONSTANTS = ("modulus_eff", "shear_modulus_eff", "viscosity")
"""Pair constants: effective moduli E, G [Pa] and viscosity sqrt(5) zeta [-]."""
DAMPING_POWER = 0.25
"""Exponent of the overlap in the viscous force."""


def pair_constants(pair: PairMaterial) -> tuple[float, ...]:
    """Values of CONSTANTS; the viscosity is sqrt(5) zeta, see `force`.

    Raises ValueError if the restitution is 0 or depends on velocity.
    """
    if not isinstance(pair.restitution, float):
        raise ValueError("the contact model hertz requires one number as restitution coefficient")
    zeta = theory.damping_ratio_for(pair.restitution)
    return pair.modulus_eff, pair.shear_modulus_eff, float(np.sqrt(5.0)) * zeta


@ti.func
def stored_energy(constants, radius_eff, mass_eff, time_step, overlap, history):
    """Energy of the Hertz spring [J], (2/5) k d^2.5; exact integral of the elastic force."""
    k = 4.0 / 3.0 * constants[0] * ti.sqrt(radius_eff)
    return 0.4 * k * overlap * overlap * ti.sqrt(overlap)


@ti.func
def lost_energy(constants, radius_eff, mass_eff, time_step, overlap, history):
    """Zero: all loss is viscous."""
    return 0.0 * overlap


def build(damped: bool) -> NormalLaw:
    """Build the Hertz model.

    damped:  True if any pair has a restitution below 1; otherwise the viscous force is compiled out
    """
    step_mean = build_step_mean(DAMPING_POWER)

    @ti.func
    def force(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history):
        """Elastic force with Tsuji's damping, limited so that the total is never attractive.

        F = k d^1.5 + sqrt(5) zeta sqrt(M k) d^(1/4) d'       (Tsuji 1992; Antypov & Elliott 2011)

        where d^(1/4) is averaged over the step.
        """
        stiffness = 4.0 / 3.0 * constants[0]
        elastic = stiffness * ti.sqrt(radius_eff * overlap) * overlap
        viscous = 0.0 * elastic
        if ti.static(damped):
            overlap_at, weight = step_mean(overlap, overlap_rate, time_step)
            secant = stiffness * ti.sqrt(radius_eff * overlap_at)
            viscous = ti.max(constants[2] * weight * ti.sqrt(mass_eff * secant) * overlap_rate, -elastic)
        return elastic + viscous, viscous, history

    return NormalLaw(
        name="hertz",
        source="Hertz 1882; Tsuji et al. 1992; Antypov & Elliott 2011, doi 10.1209/0295-5075/94/50004",
        limits="e does not depend on velocity; the viscous force is numerical and has no physical basis",
        constant_names=CONSTANTS,
        history_names=(),
        rate_dependent=damped,
        tangential_stiffness_grows=True,
        branch_free=True,
        pair_constants=pair_constants,
        force=force,
        stored_energy=stored_energy,
        lost_energy=lost_energy,
        tangential_stiffness=mindlin_stiffness,
        reference=reference,
        phase_durations=phase_durations,
        unloading_stiffness=theory.hertz_tangent,
        stable_stiffness=theory.hertz_tangent,
        damping=damping,
    )


def law_for(request: ModelRequest) -> NormalLaw:
    """Contact model that a scene requests."""
    return build(any(pair.restitution != 1.0 for pair in request.pairs))


def reference(contact: ContactState) -> tuple[float, np.ndarray]:
    """Reference implementation of `force` in numpy."""
    k = theory.hertz_stiffness(contact.constants[0], contact.radius_eff)
    root = reference_step_mean(DAMPING_POWER, contact.overlap, contact.overlap_rate, contact.time_step)
    viscous = contact.constants[2] * np.sqrt(contact.mass_eff * k) * root * contact.overlap_rate
    elastic = k * contact.overlap**1.5
    return float(elastic if contact.constants[2] == 0.0 else max(elastic + viscous, 0.0)), contact.history


def damping(pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
    """Ratio of viscous force to overlap rate at the maximum overlap of a collision [N s/m], see `force`.

    Arguments as for `law.PhaseDurations`; the maximum overlap is that of the undamped contact (Zhou 2011, Eq. 5).
    """
    k = float(theory.hertz_stiffness(pair.modulus_eff, radius_eff))
    largest = float(theory.overlap_max(k, mass_eff, velocity))
    return pair_constants(pair)[2] * float(np.sqrt(mass_eff * k) * largest**0.25)


def phase_durations(pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> tuple[float, float]:
    """Loading and unloading durations [s] of the undamped contact (Zhou 2011, Eq. 13 with e = 1).

    eta1 Ts,   Ts = (25 M^2 / (16 k^2 v))^(1/5)
    """
    k = float(theory.hertz_stiffness(pair.modulus_eff, radius_eff))
    half = theory.LOADING_DURATION * float(theory.time_scale(k, mass_eff, velocity))
    return half, half
