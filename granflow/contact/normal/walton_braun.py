"""Bilinear model: loading with stiffness k1, unloading and reloading with the larger k2 (Walton & Braun 1986)."""

import math

import numpy as np
import taichi as ti

from granflow.contact.material import PairMaterial
from granflow.contact.model import ContactState, ModelRequest, NormalLaw, ReferenceForce
from granflow.contact.spring import Spring, quarter_period, spring_for, tangential_spring

CONSTANTS = ("modulus_eff", "shear_modulus_eff", "loss_ratio")
"""Pair constants: effective moduli E, G [Pa] and loss ratio 1/e^2 - 1."""


def pair_constants(pair: PairMaterial) -> tuple[float, ...]:
    """Values of CONSTANTS; the loss ratio is 1/e^2 - 1.

    Raises ValueError if the restitution is 0 or depends on velocity.
    """
    if not isinstance(pair.restitution, float) or not 0.0 < pair.restitution <= 1.0:
        raise ValueError("the contact model walton_braun requires one number above 0 as restitution coefficient")
    return pair.modulus_eff, pair.shear_modulus_eff, 1.0 / pair.restitution**2 - 1.0


def law_for(request: ModelRequest) -> NormalLaw:
    """Contact model that a scene requests."""
    given = request.settings["unloading"]
    return build(spring_for(request, history_index=1), None if given == "constant" else given["reference_velocity"])


def build(spring: Spring, reference_velocity: float | None) -> NormalLaw:
    """Build the bilinear model with the loading spring k1.

    spring:              spring k1; its index in the history is 1
    reference_velocity:  velocity [m/s] at which e applies, or None

    Without a reference velocity k2 = k1 / e^2, so that e does not depend on velocity; otherwise k2 = k1 (1 + S F_max)
    with the slope S that gives e at the reference velocity, and e decreases with velocity.
    """
    velocity_dependent = reference_velocity is not None

    @ti.func
    def unloading_stiffness(constants, mass_eff, stiffness, overlap_max):
        """Slope k2 [N/m]: k1 / e^2, or k1 (1 + (1/e^2 - 1) dmax sqrt(k1/M) / v_ref)."""
        excess = constants[2]
        if ti.static(velocity_dependent):
            excess *= overlap_max * ti.sqrt(stiffness / mass_eff) / reference_velocity
        return stiffness * (1.0 + excess)

    @ti.func
    def force(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history):
        """F = k1 d beyond the previous maximum overlap, max(k2 (d - d0), 0) below it [N]."""
        history_new, stiffness = history, spring.stiffness_of(history)
        history_new[0] = ti.max(overlap, history[0])
        unloading_stiffness_now = unloading_stiffness(constants, mass_eff, stiffness, history_new[0])
        normal_force = ti.max(stiffness * history_new[0] - unloading_stiffness_now * (history_new[0] - overlap), 0.0)
        return normal_force, 0.0 * normal_force, history_new

    @ti.func
    def stored_energy(constants, radius_eff, mass_eff, time_step, overlap, history):
        """Energy recovered by unloading [J], F^2 / (2 k2)."""
        stiffness = spring.stiffness_of(history)
        unloading_stiffness_now = unloading_stiffness(constants, mass_eff, stiffness, history[0])
        force = ti.max(stiffness * history[0] - unloading_stiffness_now * (history[0] - overlap), 0.0)
        return 0.5 * force * force / unloading_stiffness_now

    @ti.func
    def lost_energy(constants, radius_eff, mass_eff, time_step, overlap, history):
        """Work of loading minus recoverable energy at the maximum overlap [J], k1 dmax^2 (1 - k1/k2) / 2."""
        stiffness = spring.stiffness_of(history)
        unloading_stiffness_now = unloading_stiffness(constants, mass_eff, stiffness, history[0])
        return 0.5 * stiffness * history[0] * history[0] * (1.0 - stiffness / unloading_stiffness_now)

    @ti.func
    def tangential_stiffness(constants, radius_eff, overlap, history):
        return tangential_spring(constants, spring.stiffness_of(history))

    def restitution(pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """e(v) = 1 / sqrt(1 + (1/e^2 - 1) v / v_ref), or e (Walton & Braun 1986)."""
        share = 1.0 if reference_velocity is None else velocity / reference_velocity
        return 1.0 / math.sqrt(1.0 + pair_constants(pair)[2] * share)

    def phase_durations(pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> tuple[float, float]:
        """Quarter periods [s] of k1 and of k2 = k1 / e(v)^2."""
        quarter = quarter_period(spring.stiffness(pair, radius_eff, mass_eff, velocity), mass_eff)
        return quarter, restitution(pair, radius_eff, mass_eff, velocity) * quarter

    def largest_stiffness(pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Slope k2 [N/m] = k1 / e(v)^2."""
        stiffness = spring.stiffness(pair, radius_eff, mass_eff, velocity)
        return stiffness / restitution(pair, radius_eff, mass_eff, velocity) ** 2

    return NormalLaw(
        name="walton_braun",
        source="Walton & Braun 1986, J. Rheol. 30:949, doi 10.1122/1.549893; spring: Zhou 2011, Eq. 19",
        limits="unloading is 1/e^2 times as stiff as loading, so that the time step is proportional to e; with a given "
        "stiffness the duration, with a constant k2 the restitution, does not depend on velocity",
        constant_names=CONSTANTS,
        history_names=("overlap_max", *spring.history_names),
        rate_dependent=False,
        tangential_stiffness_grows=False,
        branch_free=True,
        pair_constants=pair_constants,
        force=force,
        prepare=spring.prepare,
        stored_energy=stored_energy,
        lost_energy=lost_energy,
        tangential_stiffness=tangential_stiffness,
        reference=_reference(spring, reference_velocity),
        phase_durations=phase_durations,
        unloading_stiffness=largest_stiffness,
        stable_stiffness=largest_stiffness,
        loading_tangent=spring.stiffness,
        restitution=restitution,
    )


def _reference(spring: Spring, reference_velocity: float | None) -> ReferenceForce:
    """Reference implementation of `force` in numpy, with the slope S [1/N] of k2 = k1 (1 + S F_max) as in the paper."""

    def reference(contact: ContactState) -> tuple[float, np.ndarray]:
        (stiffness, spring_history), largest = spring.reference_stiffness(contact), contact.history[0]
        history_new = np.array([max(largest, contact.overlap), *spring_history])
        if contact.overlap >= largest:
            return stiffness * contact.overlap, history_new
        unloading_stiffness_now = stiffness * (1.0 + contact.constants[2])
        if reference_velocity is not None:
            slope = contact.constants[2] / (reference_velocity * math.sqrt(stiffness * contact.mass_eff))
            unloading_stiffness_now = stiffness * (1.0 + slope * stiffness * largest)
        return max(
            unloading_stiffness_now * (contact.overlap - largest * (1.0 - stiffness / unloading_stiffness_now)), 0.0
        ), history_new

    return reference
