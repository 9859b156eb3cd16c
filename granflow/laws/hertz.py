"""Hertz contact, elastic, or with a viscous term that reaches the restitution asked for at every velocity."""

import numpy as np
import taichi as ti

from granflow.laws import theory
from granflow.laws.law import NormalLaw
from granflow.laws.material import PairMaterial
from granflow.laws.mindlin import mindlin_stiffness

CONSTANTS = ("modulus_eff", "shear_modulus_eff", "viscosity")


def pair_constants(pair: PairMaterial) -> tuple[float, ...]:
    """Numbers of CONSTANTS; the viscosity is sqrt(5) zeta, see `force`.

    Raises ValueError where the restitution is 0 or falls with velocity.
    """
    if not isinstance(pair.restitution, float):
        raise ValueError("the hertz law takes one number as restitution coefficient")
    zeta = theory.damping_ratio_for(pair.restitution)
    return pair.modulus_eff, pair.shear_modulus_eff, float(np.sqrt(5.0)) * zeta


def build(damped: bool) -> NormalLaw:
    """Hertz's law; `damped` where any pair has a restitution below 1."""

    @ti.func
    def force(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history):
        """Elastic force with Tsuji's damping, cut where it would pull.

        F = k d^1.5 + sqrt(5) zeta sqrt(M k) d^(1/4) d'       (Tsuji 1992; Antypov & Elliott 2011)
        """
        tangent = 4.0 / 3.0 * constants[0] * ti.sqrt(radius_eff * overlap)
        elastic = tangent * overlap
        viscous = 0.0 * elastic
        if ti.static(damped):
            viscous = ti.max(constants[2] * ti.sqrt(mass_eff * tangent) * overlap_rate, -elastic)
        return elastic + viscous, viscous, history

    @ti.func
    def stored_energy(constants, radius_eff, mass_eff, time_step, overlap, history):
        k = 4.0 / 3.0 * constants[0] * ti.sqrt(radius_eff)
        return 0.4 * k * overlap * overlap * ti.sqrt(overlap)

    @ti.func
    def lost_energy(constants, radius_eff, mass_eff, time_step, overlap, history):
        return 0.0 * overlap

    return NormalLaw(
        name="hertz",
        source="Hertz 1882; Tsuji et al. 1992; Antypov & Elliott 2011, doi 10.1209/0295-5075/94/50004",
        constant_names=CONSTANTS,
        history_names=(),
        rate_dependent=damped,
        lateral_grows=True,
        pair_constants=pair_constants,
        force=force,
        stored_energy=stored_energy,
        lost_energy=lost_energy,
        lateral_stiffness=mindlin_stiffness,
        reference_force=reference_force,
        phase_durations=phase_durations,
        unloading_stiffness=unloading_stiffness,
    )


def reference_force(
    constants: np.ndarray,
    radius_eff: float,
    mass_eff: float,
    time_step: float,
    overlap: float,
    overlap_rate: float,
    history: np.ndarray,
) -> tuple[float, np.ndarray]:
    """Numpy twin of `force`."""
    k = theory.hertz_stiffness(constants[0], radius_eff)
    viscous = constants[2] * np.sqrt(mass_eff * k) * overlap**0.25 * overlap_rate
    elastic = k * overlap**1.5
    return float(elastic if constants[2] == 0.0 else max(elastic + viscous, 0.0)), history


def phase_durations(pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> tuple[float, float]:
    """Loading and unloading duration [s] of the undamped contact (Zhou 2011, Eq. 13 with e = 1)."""
    k = float(theory.hertz_stiffness(pair.modulus_eff, radius_eff))
    half = theory.LOADING_DURATION * float(theory.time_scale(k, mass_eff, velocity))
    return half, half


def unloading_stiffness(pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
    """Hertz tangent at the largest overlap, 1.5 k sqrt(dmax) [N/m]."""
    k = float(theory.hertz_stiffness(pair.modulus_eff, radius_eff))
    return 1.5 * k * float(np.sqrt(theory.overlap_max(k, mass_eff, velocity)))
