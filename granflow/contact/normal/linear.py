"""Linear spring and dashpot. The stiffness is a number, or follows from Eq. 19 of Zhou (2011)."""

import numpy as np
import taichi as ti

from granflow.contact import theory
from granflow.contact.material import PairMaterial
from granflow.contact.model import ContactState, ModelRequest, NormalLaw, ReferenceForce
from granflow.contact.spring import Spring, quarter_period, spring_for, tangential_spring
from granflow.contact.substep_corrections import build_step_mean, reference_step_mean

CONSTANTS = ("modulus_eff", "shear_modulus_eff", "damping_ratio")
"""Pair constants: effective moduli E, G [Pa] and damping ratio zeta [-]."""


def pair_constants(pair: PairMaterial) -> tuple[float, ...]:
    """Values of CONSTANTS; zeta follows from the restitution (Schwager & Poeschel 2007, `theory.damping_ratio_for`).

    Raises ValueError if the restitution is 0 or depends on velocity.
    """
    if not isinstance(pair.restitution, float):
        raise ValueError("the contact model linear requires one number as restitution coefficient")
    return pair.modulus_eff, pair.shear_modulus_eff, theory.damping_ratio_for(pair.restitution)


def law_for(request: ModelRequest) -> NormalLaw:
    """Contact model that a scene requests."""
    return build(spring_for(request, history_index=0))


def build(spring: Spring) -> NormalLaw:
    """Build the linear model.

    spring:  spring whose stiffness K [N/m] is constant during a contact; its history index is 0
    """
    step_mean = build_step_mean(0.0)

    @ti.func
    def force(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history):
        """F = max(K d + 2 zeta sqrt(K M) d', 0); K is constant from first touch on.

        In the first step the dashpot acts for the time since first touch only.
        """
        history_new = history
        stiffness = spring.stiffness_of(history_new)
        elastic = stiffness * overlap
        _overlap_at, share = step_mean(overlap, overlap_rate, time_step)
        viscous = ti.max(2.0 * constants[2] * share * ti.sqrt(stiffness * mass_eff) * overlap_rate, -elastic)
        return elastic + viscous, viscous, history_new

    @ti.func
    def stored_energy(constants, radius_eff, mass_eff, time_step, overlap, history):
        """Energy of the spring [J], K d^2 / 2."""
        return 0.5 * spring.stiffness_of(history) * overlap * overlap

    @ti.func
    def lost_energy(constants, radius_eff, mass_eff, time_step, overlap, history):
        """Zero: all loss is viscous."""
        return 0.0 * overlap

    @ti.func
    def tangential_stiffness(constants, radius_eff, overlap, history):
        """Mindlin's ratio 4 G / E times K [N/m]."""
        return tangential_spring(constants, spring.stiffness_of(history))

    def phase_durations(pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> tuple[float, float]:
        """Two quarter periods of the undamped spring [s]."""
        quarter = quarter_period(spring.stiffness(pair, radius_eff, mass_eff, velocity), mass_eff)
        return quarter, quarter

    def damping(pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Dashpot constant 2 zeta sqrt(K M) [N s/m]."""
        stiffness = spring.stiffness(pair, radius_eff, mass_eff, velocity)
        return 2.0 * pair_constants(pair)[2] * float(np.sqrt(stiffness * mass_eff))

    return NormalLaw(
        name="linear",
        source="Cundall & Strack 1979; spring: Zhou 2011, Eq. 19; damping: Schwager & Poeschel 2007",
        limits="duration and restitution do not depend on velocity; with damping the force is discontinuous at first "
        "touch",
        constant_names=CONSTANTS,
        history_names=spring.history_names,
        rate_dependent=True,
        tangential_stiffness_grows=False,
        branch_free=True,
        pair_constants=pair_constants,
        force=force,
        prepare=spring.prepare,
        stored_energy=stored_energy,
        lost_energy=lost_energy,
        tangential_stiffness=tangential_stiffness,
        reference=_reference(spring),
        phase_durations=phase_durations,
        unloading_stiffness=spring.stiffness,
        stable_stiffness=spring.stiffness,
        damping=damping,
    )


def _reference(spring: Spring) -> ReferenceForce:
    """Reference implementation of `force` in numpy."""

    def reference(contact: ContactState) -> tuple[float, np.ndarray]:
        stiffness, spring_history = spring.reference_stiffness(contact)
        rate = reference_step_mean(0.0, contact.overlap, contact.overlap_rate, contact.time_step) * contact.overlap_rate
        viscous = 2.0 * contact.constants[2] * np.sqrt(stiffness * contact.mass_eff) * rate
        return float(max(stiffness * contact.overlap + viscous, 0.0)), np.array(spring_history or contact.history)

    return reference
